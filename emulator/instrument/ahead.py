"""Sweeps of one sensor that are measured before they are asked for, while earlier ones are under way.

Belongs here: which sweeps may be begun early, and whether one that was is the one that is asked for. Not: the
processes that measure (measuring), the order in which scans are taken (instrument: as they are asked for).

Nothing is taken on trust: what was measured early counts only if the session asks for the same sweep and the same holds
for it then, else it is measured again. So a run sends the same bytes with any number of processes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import Protocol, runtime_checkable

import numpy as np

from emulator.measuring.conditions import Conditions
from protocols.scan import ScanPlan
from protocols.session import Session

MOST_EARLY = 32
"Sweeps under way or waiting at once, beside the one that is asked for."
NAMES = ("epoch", "stream", "stride", "period_ns")
"Fields of a plan that say to what it belongs, not what is measured."
MEASURED = tuple(one.name for one in fields(ScanPlan) if one.name not in NAMES)


@runtime_checkable
class Several(Protocol):
    """Whoever may measure several sweeps of a sensor at once."""

    @property
    def in_virtual_time(self) -> bool: ...

    def spare(self, sensor: str, behind: bool = True) -> int: ...

    def request_ahead(self, sensor: str, plan: ScanPlan, conditions: Conditions) -> None: ...

    def claim(self, sensor: str, early: ScanPlan, plan: ScanPlan) -> bool: ...

    def drop(self, sensor: str, plans: Sequence[ScanPlan]) -> None: ...


class Ahead:
    """Of one sensor."""

    def __init__(self, sensor: str, several: Several) -> None:
        self._sensor, self._several = sensor, several
        self._early: list[tuple[ScanPlan, Conditions]] = []
        "In the order in which they will be asked for."

    def claim(self, plan: ScanPlan, conditions: Conditions) -> bool:
        """Ask for a sweep that has been begun early; False: none has, or other conditions hold by now."""
        place = next((at for at, (early, _) in enumerate(self._early) if same_sweep(early, plan)), None)
        if place is None:
            self.drop()
            return False
        early, then = self._early[place]
        passed = [one for one, _ in self._early[:place]]
        del self._early[: place + 1]
        if not same_conditions(self._sensor, plan, then, conditions):
            passed.append(early)
        if passed:
            self._several.drop(self._sensor, passed)
        return early not in passed and self._several.claim(self._sensor, early, plan)

    def drop(self) -> None:
        """None of them will be asked for."""
        if self._early:
            self._several.drop(self._sensor, [one for one, _ in self._early])
            self._early.clear()

    def begin(
        self,
        session: Session,
        asked: ScanPlan,
        now_ns: int,
        ask_ns: Callable[[ScanPlan], int],
        conditions: Callable[[ScanPlan], Conditions],
        may_wait: bool,
        may_queue: Callable[[ScanPlan], bool] = lambda plan: True,
    ) -> int | None:
        """Begin what processes are free for, behind the sweep that is asked for; when the next one may be begun.

        `may_wait`: in virtual time sweeps may be begun before their instant, as nothing that holds then is known later.
        `may_queue`: not one that is asked for as late as it can be, in a world that somebody else moves.
        """
        while len(self._early) < MOST_EARLY and self._several.spare(self._sensor):
            last = self._early[-1][0] if self._early else asked
            plan = session.plan_after(last)
            if plan is None or plan.start_ns <= last.start_ns:
                return None
            begin_ns = ask_ns(plan)
            if begin_ns > now_ns and not (may_wait and self._several.in_virtual_time):
                return begin_ns
            if plan.start_ns < now_ns or not may_queue(plan):  # it waits for a process, not behind another sweep
                if not self._several.spare(self._sensor, behind=False):
                    return None
            held = conditions(plan)
            self._early.append((plan, held))
            session.begun(plan)
            self._several.request_ahead(self._sensor, plan, held)
        return None


def same_sweep(one: ScanPlan, other: ScanPlan) -> bool:
    """Whether both measure the same: whoever measures one has measured the other."""
    return one.sweep == other.sweep and all(_same(getattr(one, name), getattr(other, name)) for name in MEASURED)


def _same(one: object, other: object) -> bool:
    if isinstance(one, np.ndarray) and isinstance(other, np.ndarray):
        return one is other or np.array_equal(one, other)
    return one is other or (type(one) is type(other) and one == other)


def same_conditions(sensor: str, plan: ScanPlan, then: Conditions, now: Conditions) -> bool:
    """Whether the same holds for a sweep; of a fed world each sweep has what was known when it was begun."""
    if then is now:
        return True
    at_ns = plan.start_ns
    return then.weather == now.weather and then.of(sensor, at_ns) == now.of(sensor, at_ns)
