"""A device whose schedule follows its own quartz: a session that runs in device time instead of run time.

Belongs here: conversion of instants to device time and back. The inner session does not know of it: it is called with
device time, and its deadlines, plans, emissions and events are converted to run time. Not: time stamps
(device_clock).
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from typing import Any

from protocols.device_clock import BILLION, SECOND_NS, DeviceClock
from protocols.quartz import Quartz
from protocols.scan import Floats, Scan, ScanPlan
from protocols.session import Address, Announcement, Emission, Event, LinkKind, Session

MOST_PLANS = 64
"Plans whose scans may still be submitted."


class Timebase(Session):
    """A session with its own quartz."""

    def __init__(self, inner: Session, quartz: Quartz) -> None:
        self.inner = inner
        self.quartz = quartz
        self._plans: OrderedDict[tuple[int, int], ScanPlan] = OrderedDict()
        "Own plans given out, by epoch and sweep."
        self._shown: tuple[ScanPlan, Quartz, ScanPlan] | None = None
        "The last one, and as what it was given out."
        inner.keep_time(lambda own_ns: self.quartz.true_ns(own_ns), lambda true_ns: self.quartz.own_ns(true_ns))

    def __getattr__(self, name: str) -> Any:
        return getattr(self.inner, name)  # of one family alone: its device, its line

    @property
    def clock(self) -> DeviceClock:
        """In the device's own time."""
        return self.inner.clock

    @clock.setter
    def clock(self, clock: DeviceClock) -> None:
        self.inner.clock = clock

    @property
    def clock_tick_ns(self) -> Fraction | None:  # type: ignore[override]
        return self.inner.clock_tick_ns

    @property
    def announced(self) -> Announcement | None:  # type: ignore[override]
        return self.inner.announced

    @property
    def can_bitrate(self) -> int | None:  # type: ignore[override]
        return self.inner.can_bitrate

    def power_on(self, now_ns: int) -> None:
        self.inner.power_on(self.quartz.own_ns(now_ns))

    def connected(self, now_ns: int, address: Address, kind: LinkKind) -> None:
        self.inner.connected(self.quartz.own_ns(now_ns), address, kind)

    def disconnected(self, now_ns: int, address: Address) -> None:
        self.inner.disconnected(self.quartz.own_ns(now_ns), address)

    def placed(self, address: Address, host: str, port: int) -> None:
        self.inner.placed(address, host, port)

    @property
    def minds_delivery(self) -> bool:  # type: ignore[override]
        return self.inner.minds_delivery

    def undelivered(self, now_ns: int, address: Address, refused: bool) -> None:
        self.inner.undelivered(self.quartz.own_ns(now_ns), address, refused)

    def feel(self, motion: Callable[[int], tuple[Floats, Floats]]) -> None:
        self.inner.feel(lambda own_ns: motion(self.quartz.true_ns(own_ns)))

    def receive(self, data: bytes, now_ns: int, address: Address | None = None) -> None:
        self.inner.receive(data, self.quartz.own_ns(now_ns), address)

    def advance(self, now_ns: int) -> None:
        self.inner.advance(self.quartz.own_ns(now_ns))

    def next_deadline(self) -> int | None:
        own_ns = self.inner.next_deadline()
        return None if own_ns is None else self.quartz.true_ns(own_ns)

    def next_plan(self) -> ScanPlan | None:
        own = self.inner.next_plan()
        if own is None:
            return None
        if self._shown is None or self._shown[0] is not own or self._shown[1] is not self.quartz:
            self._shown = own, self.quartz, self.given_out(own)
            self._plans[own.epoch, own.sweep] = own
            while len(self._plans) > MOST_PLANS:
                self._plans.popitem(last=False)
        return self._shown[2]

    def given_out(self, own: ScanPlan) -> ScanPlan:
        """A plan in device time, converted to run time."""
        start_ns = self.quartz.true_ns(own.start_ns)
        # the rate at the beginning of the sweep: one that changes within it counts from the next one on
        scale = BILLION / (BILLION + self.quartz.ppb(start_ns))
        return replace(
            own,
            start_ns=start_ns,
            fire_offset_s=own.fire_offset_s * scale,
            duration_s=own.duration_s * scale,
            period_ns=None if own.period_ns is None else round(own.period_ns * scale),
        )

    def submit(self, scan: Scan) -> None:
        self.inner.submit(replace(scan, plan=self._own(scan.plan)))

    def plan_after(self, plan: ScanPlan) -> ScanPlan | None:
        own = self.inner.plan_after(self._own(plan))
        return None if own is None else self.given_out(own)

    def begun(self, plan: ScanPlan) -> None:
        self.inner.begun(self._own(plan))

    def missed(self, plan: ScanPlan, now_ns: int) -> bool:
        return self.inner.missed(self._own(plan), self.quartz.own_ns(now_ns))

    def _own(self, plan: ScanPlan) -> ScanPlan:
        """The device's own plan; of one long withdrawn something that the session refuses."""
        own = self._plans.get((plan.epoch, plan.sweep))
        return replace(plan, start_ns=self.quartz.own_ns(plan.start_ns)) if own is None else own

    def take_emissions(self, now_ns: int) -> list[Emission]:
        return [self._sent(one) for one in self.inner.take_emissions(self.quartz.own_ns(now_ns))]

    def _sent(self, own: Emission) -> Emission:
        reported = own.reported
        if reported is not None:
            reported = replace(reported, true_ns=self.quartz.true_ns(reported.true_ns))
        return replace(own, due_ns=self.quartz.true_ns(own.due_ns), reported=reported)

    def modem_lines(self, dtr: bool, rts: bool, now_ns: int, address: Address) -> None:
        self.inner.modem_lines(dtr, rts, self.quartz.own_ns(now_ns), address)

    def impair(self, now_ns: int, what: str, degree: float) -> bool:
        return self.inner.impair(self.quartz.own_ns(now_ns), what, degree)

    def take_events(self) -> list[Event]:
        return [replace(event, at_ns=self.quartz.true_ns(event.at_ns)) for event in self.inner.take_events()]


def inside(session: Session, now_ns: int) -> tuple[Session, int]:
    """The session of the family, and an instant of the run in its time."""
    if isinstance(session, Timebase):
        return inside(session.inner, session.quartz.own_ns(now_ns))
    return session, now_ns


def change_clock(session: Session, now_ns: int, change: Callable[[DeviceClock, int], DeviceClock]) -> None:
    """Replace a device's clock by `change(clock, instant in device time)`."""
    own, own_ns = inside(session, now_ns)
    own.clock = change(own.clock, own_ns)


def pace(session: Session, now_ns: int, by_ppb: int) -> Session:
    """The session with its quartz faster by `by_ppb` from an instant on; the same object if it has a quartz already.

    A session gets its quartz when it first drifts: until then the device's instants are the run's.
    """
    base = session if isinstance(session, Timebase) else Timebase(session, Quartz())
    base.quartz = base.quartz.at_rate(now_ns, base.quartz.ppb(now_ns) + by_ppb)
    return base


def seconds_ns(seconds: float) -> int:
    """To the nearest nanosecond."""
    return round(seconds * SECOND_NS)
