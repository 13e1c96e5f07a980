"""A measuring function in a scene that somebody else moves: each sweep comes with its poses.

Belongs here: handing them to the scene. Not: what they are (live), what is measured (measure).
"""

from __future__ import annotations

from typing import Any

from emulator.live.tracks import NOTHING
from emulator.measuring.conditions import NORMAL, Conditions
from emulator.measuring.measuring import Measure
from emulator.world.fed import FedNow
from protocols.scan import Scan, ScanPlan


class Placed:
    """The same function, told first where everything is."""

    def __init__(self, measure: Measure, fed: FedNow) -> None:
        self._measure, self._fed = measure, fed

    def __call__(self, plan: ScanPlan, conditions: Conditions = NORMAL) -> Scan:
        self._fed.use(NOTHING if conditions.world is None else conditions.world)
        return self._measure(plan, conditions)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._measure, name)
