"""A CoLa device in virtual time, with a world that answers its plans. No wall clock, no sleep."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from protocols.cola import FAMILY
from protocols.cola.session import ColaSession
from protocols.scan import Scan, ScanPlan
from protocols.session import Address, Dropped, DropReason, Emission, LinkKind
from tests.protocols.cola.reader import ScanRead, ask_a, ask_b, frames, read

MS, SECOND = 1_000_000, 1_000_000_000
LOOK_AHEAD_NS = 250 * MS
"As the emulator's instrument has it."
ONE, TWO = Address(0, 1), Address(1, 1)
"Hosts on 2111 and 2112."

World = Callable[[ScanPlan], Scan]


def scan_of(plan: ScanPlan, *range_m: Any, intensity: Any = 100.0) -> Scan:
    """A scan whose echoes are given one after the other, each for all beams or beam by beam."""
    size = (len(plan), len(range_m))
    ranges = np.stack([np.broadcast_to(np.asarray(one, float), (len(plan),)) for one in range_m], axis=1)
    peaks = np.where(np.isfinite(ranges), np.broadcast_to(np.asarray(intensity, float), size), np.nan)
    return Scan(plan, ranges, peaks, np.zeros(len(plan), np.uint8), np.zeros(size, np.int32))


def ten_metres(plan: ScanPlan) -> Scan:
    return scan_of(plan, 10.0)


class Rig:
    """One session switched on, and its surroundings."""

    def __init__(
        self,
        model: str = "sick-lms111",
        world: World = ten_metres,
        kind: LinkKind = LinkKind.STREAM,
        up: bool = True,
        **device: Any,
    ) -> None:
        self.session: ColaSession = FAMILY.new_session(device, {"model": model})  # type: ignore[assignment]
        self.world, self.now_ns, self.kind = world, 0, kind
        self.plans: list[ScanPlan] = []
        self.sent: list[Emission] = []
        self.events: list[Any] = []
        if kind is not LinkKind.STREAM:
            self.session.connected(0, Address(0, 0), kind)
        self.session.power_on(0)
        if kind is LinkKind.STREAM:
            self.session.connected(0, ONE, kind)
            self.session.connected(0, TWO, kind)
        if up:
            self.run(self.session.up_ns + MS)
            self.sent.clear()

    def step(self) -> int | None:
        """What an instrument does at one instant; when to be called again."""
        session = self.session
        session.advance(self.now_ns)
        while (plan := session.next_plan()) is not None and plan.start_ns <= self.now_ns + LOOK_AHEAD_NS:
            self.plans.append(plan)
            session.submit(self.world(plan))
        self.sent += session.take_emissions(self.now_ns)
        self.events += session.take_events()
        wakes = [session.next_deadline()]
        if (plan := session.next_plan()) is not None:
            wakes.append(plan.start_ns - LOOK_AHEAD_NS)
        return min((wake for wake in wakes if wake is not None), default=None)

    def run(self, duration_ns: int) -> None:
        """Let time pass."""
        until_ns = self.now_ns + duration_ns
        while (wake_ns := self.step()) is not None and wake_ns <= until_ns:
            self.now_ns = max(self.now_ns, wake_ns)
        self.now_ns = until_ns

    def put(self, data: bytes, to: Address = ONE) -> None:
        """Bytes of a host."""
        self.session.receive(data, self.now_ns, to)

    def next(self, to: Address = ONE, within_ns: int = SECOND) -> tuple[str, bytes]:
        """Wait for one telegram to a host, as one that gives up after `within_ns`; dialect and payload."""
        until_ns = self.now_ns + within_ns
        while True:
            for index, emission in enumerate(self.sent):
                if emission.address == to and emission.payload:
                    del self.sent[index]
                    (found,) = frames(emission.payload)
                    return found
            wake_ns = self.step()
            if any(one.address == to and one.payload for one in self.sent):
                continue
            assert wake_ns is not None, "nothing will ever come"
            assert wake_ns <= until_ns, f"no telegram within {within_ns / SECOND} s"
            self.now_ns = max(self.now_ns, wake_ns)

    def a(self, text: str, to: Address = ONE, within_ns: int = SECOND) -> str:
        """Ask in CoLa-A; the text of the next telegram."""
        self.put(ask_a(text), to)
        dialect, payload = self.next(to, within_ns)
        assert dialect == "A"
        return payload.decode("latin-1")

    def b(self, text: str, data: str | bytes = b"", to: Address = ONE, within_ns: int = SECOND) -> bytes:
        """Ask in CoLa-B; the payload of the next telegram."""
        self.put(ask_b(text, data), to)
        dialect, payload = self.next(to, within_ns)
        assert dialect == "B"
        return payload

    def a_last(self, text: str, to: Address = ONE) -> str:
        """The same, passing over events that come first."""
        self.put(ask_a(text), to)
        while (found := self.next(to))[1].startswith(b"sSN"):
            pass
        return found[1].decode("latin-1")

    def b_last(self, text: str, data: str | bytes = b"", to: Address = ONE) -> bytes:
        """The same in CoLa-B."""
        self.put(ask_b(text, data), to)
        while (found := self.next(to))[1].startswith(b"sSN"):
            pass
        return found[1]

    def scan(self, to: Address = ONE, within_ns: int = SECOND) -> ScanRead:
        """The next telegram, which is a scan."""
        return read(*self.next(to, within_ns))

    def log_in(self, to: Address = ONE) -> None:
        assert self.a("sMN SetAccessMode 03 F4724744", to) == "sAN SetAccessMode 1"

    def forget(self) -> None:
        """What was sent and has happened is looked at no more."""
        self.sent.clear()
        self.events.clear()

    def dropped(self) -> list[DropReason]:
        """Reasons of everything dropped since the last call."""
        self.events += self.session.take_events()
        found = [event.reason for event in self.events if isinstance(event, Dropped)]
        self.events.clear()
        return found
