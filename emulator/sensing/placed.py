"""A measuring function in a scene that somebody else moves: each sweep comes with its poses.

Belongs here: handing them to the scene. Not: what they are (live), what is measured (measure).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from emulator.live.tracks import NOTHING
from emulator.measuring.conditions import NORMAL, Conditions
from emulator.measuring.measuring import Measure
from emulator.measuring.parts import PartOfScan
from emulator.world.fed import FedNow
from protocols.scan import Scan, ScanPlan


class Placed:
    """The same function, reported first where everything is."""

    def __init__(self, measure: Measure, fed: FedNow, turned_ns: Callable[[int], int]) -> None:
        """`turned_ns`: what finished rounds of the scene have taken at an instant: poses are in the run's time."""
        self._measure, self._fed, self._turned_ns = measure, fed, turned_ns

    def __call__(self, plan: ScanPlan, conditions: Conditions = NORMAL) -> Scan:
        self._place(plan, conditions)
        return self._measure(plan, conditions)

    def part(
        self, plan: ScanPlan, conditions: Conditions, number: int, of: int, in_time: bool = False
    ) -> PartOfScan | None:
        """Some beams of one sweep; None: it is not measured in parts."""
        divided = getattr(self._measure, "part", None)
        if divided is None:
            return None
        self._place(plan, conditions)
        found: PartOfScan | None = divided(plan, conditions, number, of, in_time)
        return found

    def _place(self, plan: ScanPlan, conditions: Conditions) -> None:
        world = NOTHING if conditions.world is None else conditions.world
        turned_ns = self._turned_ns(plan.start_ns)
        self._fed.use(world.earlier(turned_ns * 1e-9) if turned_ns else world)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._measure, name)
