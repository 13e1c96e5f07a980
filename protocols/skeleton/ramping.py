"""The angle of a head that ramps to its speed, in pieces.

Belongs here: the angle and the speed at an instant. Not: who sets the speed, and corrections of the phase (families).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from protocols.scan import Floats

KNOTS_KEPT = 64


@dataclass(frozen=True)
class Knot:
    """From an instant on, a constant acceleration."""

    at_ns: int
    turns: float
    hz: float
    acceleration: float = 0.0
    "[Hz/s]"
    whole: int = 0
    "Turns before, which `turns` leaves out."


class Ramping:
    """Piecewise: each piece begins at a knot, and is computed from it. Backwards, turns are negative."""

    def __init__(self, at_ns: int) -> None:
        """At rest at azimuth 0."""
        self._knots = [Knot(at_ns, 0.0, 0.0)]

    def _at(self, at_ns: int) -> Knot:
        return next((one for one in reversed(self._knots) if one.at_ns <= at_ns), self._knots[0])

    def turns(self, at_ns: NDArray[np.int64]) -> Floats:
        """Turns since the start, modulo whole ones at knots; any shape, after the first knot kept."""
        knots = self._knots
        begun = np.array([one.at_ns for one in knots])
        place = np.maximum(np.searchsorted(begun, (at_ns.min(), at_ns.max()), side="right") - 1, 0)
        if place[0] == place[1]:  # as nearly always: one piece
            return self._on(knots[place[0]], at_ns)
        pieces = np.maximum(np.searchsorted(begun, at_ns, side="right") - 1, 0)
        found = np.zeros(at_ns.shape)
        for index in range(place[0], place[1] + 1):
            found[pieces == index] = self._on(knots[index], at_ns[pieces == index])
        return found

    def turn(self, at_ns: int) -> int:
        """Whole turns since the start."""
        knot = self._at(at_ns)
        return knot.whole + int(self._on(knot, np.array(at_ns)) // 1.0)

    @staticmethod
    def _on(knot: Knot, at_ns: NDArray[np.int64]) -> Floats:
        after_s = np.asarray(1e-9 * (at_ns - knot.at_ns), np.float64)
        if knot.acceleration == 0.0:
            return knot.turns + knot.hz * after_s
        return knot.turns + after_s * (knot.hz + 0.5 * knot.acceleration * after_s)

    def speed_hz(self, at_ns: int) -> float:
        """Turns per second."""
        knot = self._at(at_ns)
        return knot.hz + knot.acceleration * 1e-9 * (at_ns - knot.at_ns)

    def is_steady(self, at_ns: int) -> bool:
        """Whether it does not ramp."""
        return self._at(at_ns).acceleration == 0.0

    def _put(self, at_ns: int, hz: float, acceleration: float) -> None:
        turns, whole = float(self.turns(np.array(at_ns))) % 1.0, self.turn(at_ns)
        self._knots = [one for one in self._knots if one.at_ns < at_ns][-KNOTS_KEPT:]
        self._knots.append(Knot(at_ns, turns, hz, acceleration, whole))
