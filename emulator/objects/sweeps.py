"""Sweeps that a scanner makes when it measures all the time, whatever its hosts ask of it.

Belongs here: which sweep of a source is the newest at an instant. Its plans come from a session of its own, with the
scenario's `device:` table, switched on at the start of the run: lists made of them depend on no host. Not: measuring.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np

from emulator.errors import ScenarioError
from emulator.sensing.table import table_plan
from emulator.sensors.spec import SensorSpec
from protocols.scan import Scan, ScanPlan
from protocols.session import Address, Dropped, DropReason, Session
from protocols.timebase import Timebase
from protocols.wire import Wire, wire_of

KEPT_NS = 1_000_000_000
"Sweeps before a change are remembered for so long: lists are made again after a changed setting."
SOON_NS, LATER_NS = 100_000_000, 5_000_000_000
"Time to the next request while the device starts; after one that it has taken."
MAX_ROUNDS = 64


BLOCK = 16
"Sweeps after which directions and instants repeat, those of interlaced combs included."
MOST_KEPT = 1024


class Sweeps(Protocol):
    """Whoever knows a source's sweeps."""

    def newest(self, at_ns: int) -> ScanPlan | None:
        """The last sweep that the device has evaluated by `at_ns`; instants rise, or go back by less than a second."""


def end_ns(plan: ScanPlan) -> int:
    """When a sweep has been evaluated."""
    return plan.start_ns + round(1e9 * plan.duration_s)


class TableSweeps:
    """A model without a protocol: its table of beams, over and over."""

    def __init__(self, spec: SensorSpec) -> None:
        self._spec = spec
        self._first = table_plan(spec, 0)
        self._last: ScanPlan | None = None

    def newest(self, at_ns: int) -> ScanPlan | None:
        period_ns = round(1e9 * self._first.duration_s)
        number = at_ns // period_ns - 1
        if number < 0:
            return None
        if self._last is None or self._last.sweep != number:
            self._last = table_plan(self._spec, number)
        return self._last


class OwnTimeSweeps:
    """A model on a quartz of its own: its sweeps repeat by its own time, and come out by the run's."""

    def __init__(self, session: Timebase, wire: Wire) -> None:
        self._session = session
        self._sweeps = SessionSweeps(session.inner, wire)

    def newest(self, at_ns: int) -> ScanPlan | None:
        found = self._sweeps.newest(self._session.quartz.own_ns(at_ns))
        return None if found is None else self._session.given_out(found)


class SessionSweeps:
    """A model with a protocol: what a session without hosts wants measured.

    Once its sweeps repeat, block after block, the session is let go and the blocks are continued by number: hours
    without a list cost nothing.
    """

    def __init__(self, session: Session, wire: Wire) -> None:
        self._session = session
        self._requests = wire.requests
        self._plans: list[ScanPlan] = []
        "From the last change on."
        self._wake_ns: int | None = 0
        self._ask_ns = 0
        self._block_ns = 0
        "Duration of the block that repeats for ever, the last one of `_plans`; 0: not yet."
        self._block_sweeps = 0
        "By which its sweeps are counted on: a device may count turns of its mirror."
        assert wire.asked_on is not None
        session.connected(0, Address(0, 0), wire.asked_on)
        session.power_on(0)

    def newest(self, at_ns: int) -> ScanPlan | None:
        while not self._block_ns and self._wake_ns is not None and self._wake_ns <= at_ns:
            self._wake_ns = self._step(self._wake_ns)
        blocks = (at_ns - self._plans[-BLOCK].start_ns) // self._block_ns if self._block_ns else 0
        for number in (blocks, blocks - 1):
            if number > 0:
                shift_ns = number * self._block_ns
                found = next(
                    (plan for plan in self._plans[: -BLOCK - 1 : -1] if end_ns(plan) <= at_ns - shift_ns), None
                )
                if found is not None:
                    return _later(found, number * self._block_sweeps, shift_ns)
        return next((plan for plan in reversed(self._plans) if end_ns(plan) <= at_ns), None)

    def _note(self, plan: ScanPlan) -> None:
        """Keep a sweep; look whether the last block is the one before it again."""
        if self._plans and plan.epoch != self._plans[-1].epoch:
            self._plans = [one for one in self._plans if one.start_ns > plan.start_ns - KEPT_NS]
        self._plans.append(plan)
        last, before = self._plans[-BLOCK:], self._plans[-2 * BLOCK : -BLOCK]
        if len(before) < BLOCK:
            return
        shift_ns, sweeps = last[0].start_ns - before[0].start_ns, last[0].sweep - before[0].sweep
        if all(_repeats(one, other, shift_ns, sweeps) for one, other in zip(before, last, strict=True)):
            self._block_ns, self._block_sweeps = shift_ns, sweeps
        elif len(self._plans) > MOST_KEPT:
            del self._plans[: MOST_KEPT // 2]

    def _step(self, now_ns: int) -> int | None:
        """All that can be done by now; when to look again."""
        session = self._session
        plan: ScanPlan | None = None
        for _ in range(MAX_ROUNDS):
            session.advance(now_ns)
            moved = bool(session.take_emissions(now_ns))
            plan = session.next_plan()
            if plan is not None and plan.start_ns <= now_ns:
                self._note(plan)
                session.submit(Scan.empty(plan))
                moved = True
            if not moved:
                break
        session.take_events()
        wakes = [session.next_deadline()]
        if plan is not None:
            wakes.append(plan.start_ns)
        elif self._requests:
            if now_ns >= self._ask_ns:
                self._ask(now_ns)
            wakes += [session.next_deadline(), self._ask_ns]
        due = [wake for wake in wakes if wake is not None]
        # a deadline that stays where it is must not stop time
        return max(min(due), now_ns + 1) if due else None

    def _ask(self, now_ns: int) -> None:
        for telegram in self._requests:
            self._session.receive(telegram, now_ns, Address(0, 0))
        events = self._session.take_events()
        booting = any(isinstance(event, Dropped) and event.reason is DropReason.BOOTING for event in events)
        self._ask_ns = now_ns + (SOON_NS if booting else LATER_NS)


def _later(plan: ScanPlan, sweeps: int, shift_ns: int) -> ScanPlan:
    return replace(plan, sweep=plan.sweep + sweeps, start_ns=plan.start_ns + shift_ns)


def _repeats(one: ScanPlan, other: ScanPlan, shift_ns: int, sweeps: int) -> bool:
    """Whether one sweep is the other, a block later; instants are rounded to nanoseconds."""
    return (
        abs(other.start_ns - one.start_ns - shift_ns) <= 1
        and other.sweep - one.sweep == sweeps
        and other.epoch == one.epoch
        and all(
            np.array_equal(getattr(one, name), getattr(other, name))
            for name in ("azimuth_rad", "elevation_rad", "fire_offset_s")
        )
    )


def sweeps_of(spec: SensorSpec, session: Session | None) -> Sweeps:
    """The sweeps of one source; `session` of a model that has a protocol, switched off."""
    if spec.family is None or session is None:
        return TableSweeps(spec)
    wire = wire_of(spec.family)
    if wire is None or wire.asked_on is None:
        raise ScenarioError(f"{spec.model}: no objects from this model: its family {spec.family} has no known sweep")
    return OwnTimeSweeps(session, wire) if isinstance(session, Timebase) else SessionSweeps(session, wire)
