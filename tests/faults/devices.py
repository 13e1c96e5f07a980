"""Devices in virtual time with clocks of their own, and a world that answers their plans. No wall clock, no sleep."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from emulator.instrument.device_clock import with_clock
from emulator.scenario.clock_options import ClockOptions
from protocols import family
from protocols.scan import DetectedObject, Scan, ScanPlan
from protocols.session import Address, Emission, Event, LinkKind, Session
from protocols.timebase import inside

SECOND = 1_000_000_000
LOOK_AHEAD_NS = 250_000_000
CAR = DetectedObject(1, (20.0, 0.0, 0.0), (0.0, 0.0, 0.0), (4.4, 1.8, 1.5), 0.0, "car")


def scan_of(plan: ScanPlan) -> Scan:
    """Every beam sees a wall in ten metres; every list has one car."""
    n = len(plan)
    scan = Scan(plan, np.full((n, 1), 10.0), np.full((n, 1), 50.0), np.zeros(n, np.uint8), np.zeros((n, 1), np.int32))
    return replace(scan, objects=(CAR,)) if plan.wants_objects else scan


@dataclass
class Device:
    """One device, switched on at 0."""

    session: Session
    kind: LinkKind
    now_ns: int = 0
    sent: list[Emission] = field(default_factory=list)
    plans: list[ScanPlan] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)

    def step(self) -> int | None:
        session = self.session
        session.advance(self.now_ns)
        while (plan := session.next_plan()) is not None and plan.start_ns <= self.now_ns + LOOK_AHEAD_NS:
            self.plans.append(plan)
            session.submit(scan_of(plan))
        self.sent += session.take_emissions(self.now_ns)
        self.events += session.take_events()
        wakes = [session.next_deadline()]
        if (plan := session.next_plan()) is not None:
            wakes.append(plan.start_ns - LOOK_AHEAD_NS)
        return min((wake for wake in wakes if wake is not None), default=None)

    def run(self, until_s: float) -> list[Emission]:
        """Let time pass; what was sent meanwhile."""
        before, until_ns = len(self.sent), round(until_s * SECOND)
        while (wake_ns := self.step()) is not None and wake_ns <= until_ns:
            self.now_ns = max(self.now_ns, wake_ns)
        self.now_ns = until_ns
        return self.sent[before:]

    def put(self, data: bytes, peer: int = 0) -> None:
        """Bytes of a host."""
        self.session.receive(data, self.now_ns, Address(0, peer))

    @property
    def own(self) -> Any:
        """The family's session."""
        return inside(self.session, 0)[0]


KINDS = {"lms2xx": LinkKind.SERIAL, "ld": LinkKind.DATAGRAM, "can_objects": LinkKind.CAN}
FACTS = {"lms2xx": {"model": "sick-lms291-s05"}, "ld": {"model": "sick-ld-lrs1000"}, "can_objects": {}}


def device(name: str, table: dict[str, Any] | None = None, **clock: Any) -> Device:
    """A device of a family with a `device` table, and a `clock` table."""
    session = family(name).new_session(table or {}, FACTS[name])
    session = with_clock(session, ClockOptions.model_validate(clock) if clock else None)
    found = Device(session, KINDS[name])
    session.connected(0, Address(0, 0), found.kind)
    session.power_on(0)
    return found
