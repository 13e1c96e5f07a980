"""A session in virtual time, with a world that answers its plans. No wall clock, no sleep."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from protocols.ld import FAMILY
from protocols.ld.session import LdSession
from protocols.scan import Scan, ScanPlan
from protocols.session import Address, CommandHandled, Dropped, DropReason, Emission, LinkKind, ModeChanged
from tests.protocols.ld.reader import ProfileRead, read_frames, read_profile, request

MS = 1_000_000
SECOND = 1_000_000_000
LOOK_AHEAD_NS = 250 * MS
"As the emulator's instrument has it."

FACTS = {"model": "sick-ld-lrs1000"}
TCP = Address(0, 1)

World = Callable[[ScanPlan], Scan]


def scan_of(plan: ScanPlan, range_m: Any, intensity: Any = 100.0) -> Scan:
    """A scan with one echo a beam."""
    size = (len(plan), 1)
    ranges = np.broadcast_to(np.asarray(range_m, np.float64).reshape(-1, 1), size).copy()
    peaks = np.broadcast_to(np.asarray(intensity, np.float64).reshape(-1, 1), size).copy()
    return Scan(plan, ranges, peaks, np.zeros(len(plan), np.uint8), np.zeros(size, np.int32))


def ten_metres(plan: ScanPlan) -> Scan:
    return scan_of(plan, 10.0)


class Rig:
    """One session switched on, and its surroundings."""

    def __init__(
        self,
        device: Mapping[str, Any] | None = None,
        world: World = ten_metres,
        kind: LinkKind = LinkKind.STREAM,
        address: Address = TCP,
        facts: Mapping[str, Any] = FACTS,
    ) -> None:
        self.session: LdSession = FAMILY.new_session(device or {}, facts)
        self.world = world
        self.now_ns = 0
        self.kind = kind
        self.address = address
        self.plans: list[ScanPlan] = []
        self.sent: list[Emission] = []
        self.events: list[Any] = []
        if kind is not LinkKind.STREAM:
            self.session.connected(0, Address(address.link, 0), kind)
        self.session.power_on(0)
        if kind is LinkKind.STREAM:
            self.session.connected(0, address, kind)

    # the world around

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

    def take(self, address: Address | None = None) -> list[Emission]:
        """What was sent to an address (None: anywhere) since the last call."""
        mine = [emission for emission in self.sent if address is None or emission.address == address]
        self.sent = [emission for emission in self.sent if emission not in mine]
        return mine

    # a host on TCP

    def put(self, data: bytes, address: Address | None = None) -> None:
        """Bytes of a host."""
        self.session.receive(data, self.now_ns, address or self.address)

    def ask(self, *message: int, within_ns: int = 5 * SECOND, address: Address | None = None) -> bytes:
        """Send a request and wait for one telegram; its payload."""
        self.put(request(*message), address)
        return self.next_payload(within_ns, address)

    def next_payload(self, within_ns: int, address: Address | None = None) -> bytes:
        """Wait for one telegram, as a host that gives up after `within_ns`."""
        payload, _ = self.next_telegram(within_ns, address)
        return payload

    def next_telegram(self, within_ns: int, address: Address | None = None) -> tuple[bytes, int]:
        """The same, with the instant at which it left."""
        address = address or self.address
        until_ns = self.now_ns + within_ns
        while True:
            for index, emission in enumerate(self.sent):
                if emission.address == address and emission.payload:
                    del self.sent[index]
                    (payload,) = read_frames(emission.payload)
                    return payload, emission.due_ns
            wake_ns = self.step()
            if any(emission.address == address and emission.payload for emission in self.sent):
                continue
            assert wake_ns is not None, "nothing will ever come"
            assert wake_ns <= until_ns, f"no telegram within {within_ns / SECOND} s"
            self.now_ns = max(self.now_ns, wake_ns)

    # what was noted

    def dropped(self) -> list[DropReason]:
        """Reasons of everything dropped since the last call."""
        self.events += self.session.take_events()
        reasons = [event.reason for event in self.events if isinstance(event, Dropped)]
        self.events = [event for event in self.events if not isinstance(event, Dropped)]
        return reasons

    def handled(self) -> list[tuple[str, str]]:
        """Commands and outcomes."""
        self.events += self.session.take_events()
        return [(event.command, event.outcome) for event in self.events if isinstance(event, CommandHandled)]

    def modes(self) -> list[str]:
        """Modes entered."""
        self.events += self.session.take_events()
        return [event.mode for event in self.events if isinstance(event, ModeChanged)]


def measuring(device: Mapping[str, Any] | None = None, **options: Any) -> Rig:
    """A rig whose device is found measuring."""
    return Rig({"delays": "fast", "mode": "measure", **(device or {})}, **options)


def profiles(rig: Rig, address: Address | None = None, points: list[int] | None = None) -> list[ProfileRead]:
    """Profiles sent on TCP or by datagram since the last call."""
    sent = [emission for emission in rig.take(address) if emission.sweep is not None]
    return [read_profile(payload, points) for emission in sent for payload in read_frames(emission.payload)]
