"""A Hesai in virtual time: three datagram links, a control channel, and a world that answers its plans."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from protocols.hesai import FAMILY
from protocols.hesai.session import HesaiSession, frame
from protocols.scan import Scan, ScanPlan
from protocols.session import Address, Dropped, Emission, LinkKind

MS, SECOND = 1_000_000, 1_000_000_000
LOOK_AHEAD_NS = 15 * MS
DATA, GPS, FAULT, PTC = Address(0, 0), Address(1, 0), Address(2, 0), Address(3, 7)


def wall(plan: ScanPlan) -> Scan:
    """Ten metres everywhere; nothing else."""
    scan = Scan.empty(plan, 2)
    scan.range_m[:, 0], scan.intensity[:, 0] = 10.0, 200.0
    return scan


class Rig:
    """Drives the session as an instrument does."""

    def __init__(self, model: str = "hesai-xt32", device: Mapping[str, Any] | None = None, on: bool = True) -> None:
        quick = {"boot_s": 0.0, "spin_up_s": 0.0}
        self.session: HesaiSession = FAMILY.new_session(quick | dict(device or {}), {"model": model})
        self.world: Callable[[ScanPlan], Scan] = wall
        self.now_ns = 0
        self.sent: list[Emission] = []
        self.dropped: list[Dropped] = []
        self.plans: list[ScanPlan] = []
        for address in (DATA, GPS, FAULT):
            self.session.connected(0, address, LinkKind.DATAGRAM)
        if on:
            self.power_on()

    def power_on(self) -> None:
        self.session.power_on(self.now_ns)
        self.session.connected(self.now_ns, PTC, LinkKind.STREAM)

    def run(self, seconds: float) -> list[Emission]:
        """So much time passes; what was sent meanwhile."""
        end_ns, before = self.now_ns + round(1e9 * seconds), len(self.sent)
        while True:
            self._serve()
            wake = self.session.next_deadline()
            plan = self.session.next_plan()
            ahead = None if plan is None else plan.start_ns - LOOK_AHEAD_NS
            later = [one for one in (wake, ahead) if one is not None and one > self.now_ns]
            if not later or min(later) > end_ns:
                break
            self.now_ns = min(later)
        self.now_ns = end_ns
        self._serve()
        return self.sent[before:]

    def _serve(self) -> None:
        self.session.advance(self.now_ns)
        while (plan := self.session.next_plan()) is not None and plan.start_ns - LOOK_AHEAD_NS <= self.now_ns:
            self.plans.append(plan)
            self.session.submit(self.world(plan))
        self.sent += self.session.take_emissions(self.now_ns)
        self.dropped += [one for one in self.session.take_events() if isinstance(one, Dropped)]

    def raw(self, request: bytes, seconds: float = 0.002) -> bytes:
        """A request's bytes and what comes back."""
        self.session.receive(request, self.now_ns, PTC)
        return b"".join(one.payload for one in self.run(seconds) if one.address == PTC)

    def ptc(self, command: int, payload: bytes = b"") -> tuple[int, bytes]:
        """Return code and payload of a reply."""
        reply = self.raw(frame(command, payload))
        assert reply[:3] == bytes((0x47, 0x74, command))
        assert int.from_bytes(reply[4:8], "big") == len(reply) - 8
        return reply[3], reply[8:]

    def ok(self, command: int, payload: bytes = b"") -> bytes:
        code, said = self.ptc(command, payload)
        assert code == 0
        return said


def clouds(sent: list[Emission]) -> list[Emission]:
    """Point-cloud packets."""
    return [one for one in sent if one.label == "data"]
