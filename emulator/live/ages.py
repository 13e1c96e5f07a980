"""How old poses were at the beams, how many were extrapolated, and how wrong that was.

Belongs here: histograms of bounded size. Not: whose beams (runtime).
"""

from __future__ import annotations

from bisect import bisect_right

import numpy as np
from numpy.typing import NDArray

from emulator.live.rotations import Floats

EDGES_S = np.concatenate([[0.0], np.geomspace(1e-5, 100.0, 561)])
"8 % from one to the next: what a median says is within half of that."
_EDGES = EDGES_S.tolist()


class Histogram:
    """Counts of values >= 0 in cells of a few per cent."""

    def __init__(self) -> None:
        self._counts = np.zeros(len(EDGES_S), np.int64)
        self.worst = 0.0

    def add(self, values: Floats) -> None:
        """Below 0 counts as 0."""
        if not len(values):
            return
        self._counts += np.bincount(
            np.maximum(np.searchsorted(EDGES_S, np.maximum(values, 0.0), side="right") - 1, 0), minlength=len(EDGES_S)
        )
        self.worst = max(self.worst, float(values.max()))

    def add_one(self, value: float) -> None:
        """The same of one."""
        self._counts[max(bisect_right(_EDGES, max(value, 0.0)) - 1, 0)] += 1
        self.worst = max(self.worst, value)

    @property
    def count(self) -> int:
        return int(self._counts.sum())

    def share(self, share: float) -> float:
        """The value that so many are not above; NaN of none."""
        if not self.count:
            return float("nan")
        cell = int(np.searchsorted(np.cumsum(self._counts), share * self.count))
        if cell == 0:
            return 0.0
        middle = float(np.sqrt(EDGES_S[cell] * EDGES_S[min(cell + 1, len(EDGES_S) - 1)]))
        return min(middle, self.worst)


class Ages:
    """Of one feed."""

    def __init__(self) -> None:
        self.age = Histogram()
        self.beams = 0
        self.extrapolated = 0
        self.error_m, self.error_rad = Histogram(), Histogram()
        self.newest, self.ahead, self.took = Histogram(), Histogram(), Histogram()
        "In real time: the newest sample's age when a sweep is begun; from then to each beam; what measuring takes."

    def begun(self, newest_s: float, ahead_s: Floats) -> None:
        """A sweep is begun: how old the newest sample is, and how long it is to each beam; fired ones are below 0."""
        self.newest.add_one(newest_s)
        self.ahead.add(ahead_s)

    def note(self, age_s: Floats, beyond: NDArray[np.bool_]) -> None:
        """Beams of a sweep: how old the newest sample used was, and which lie beyond the newest sample."""
        self.age.add(age_s)
        self.beams += len(age_s)
        self.extrapolated += int(beyond.sum())

    def truth_came(self, off_m: float, off_rad: float) -> None:
        """A sample has come for an instant that beams were extrapolated to."""
        self.error_m.add_one(off_m)
        self.error_rad.add_one(off_rad)

    def report(self) -> dict[str, object]:
        """Milliseconds, millimetres, milliradians; None where nothing was measured."""

        return {
            "beams": self.beams,
            "age_ms": reported(self.age),
            "extrapolated": self.extrapolated,
            "error_mm": reported(self.error_m),
            "error_mrad": reported(self.error_rad),
            "newest_ms": reported(self.newest),
            "ahead_ms": reported(self.ahead),
            "measuring_ms": reported(self.took),
        }


def reported(found: Histogram) -> dict[str, float] | None:
    """Thousandths of its unit; None where nothing was measured."""
    if not found.count:
        return None
    return {
        "median": round(1e3 * found.share(0.5), 3),
        "p99": round(1e3 * found.share(0.99), 3),
        "worst": round(1e3 * found.worst, 3),
    }
