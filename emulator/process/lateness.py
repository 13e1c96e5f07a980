"""How late sends were, of a whole run in bounded space: exact counts, sum and worst, percentiles to half a per cent.

Noting a send takes the same short time however many there were, and so does asking: the sending thread does both.
"""

from __future__ import annotations

from array import array
from bisect import bisect_left
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

EDGES_US = (10, 20, 50, 100, 200, 500, 1_000, 1_500, 2_000, 5_000, 10_000, 20_000, 50_000, 100_000, 1_000_000)
"Upper edges. 50 us and 1.5 ms are what an idle machine is asked to hold: median and 99 of 100."
_EDGES_NS = tuple(1000 * edge for edge in EDGES_US)
RECENT = 65_536
"Sends that are kept one by one, for expressions over a run: 512 kB a sensor, all of it from the beginning."
_PARTS_BITS = 7
"Classes an octave: 128, each 0.8 % wide."


class LatenessLog:
    """Actual minus scheduled instants. [ns]"""

    def __init__(self) -> None:
        self.count = 0
        self.sum_ns = 0
        self.worst_ns = 0
        self._ring = array("q", bytes(8 * RECENT))
        "The newest; the n-th of a run stands at n % RECENT."
        self._up_to = [0] * (len(_EDGES_NS) + 1)
        self._classes: dict[int, int] = {}

    def extend(self, late_ns: Iterable[int]) -> None:
        """Note sends; one before its instant counts as in time."""
        for late in late_ns:
            late = max(0, late)
            self._ring[self.count % RECENT] = late
            self.count += 1
            self.sum_ns += late
            self.worst_ns = max(self.worst_ns, late)
            self._up_to[bisect_left(_EDGES_NS, late)] += 1
            shift = max(0, late.bit_length() - _PARTS_BITS - 1)
            place = (shift << _PARTS_BITS) + (late >> shift)
            self._classes[place] = self._classes.get(place, 0) + 1

    def latest_ns(self, most: int = RECENT) -> NDArray[np.int64]:
        """(n,) the newest, newest last; at most `RECENT` are kept."""
        places = np.arange(max(0, self.count - min(most, RECENT)), self.count) % RECENT
        return np.frombuffer(self._ring, dtype=np.int64)[places]

    def percentile_ns(self, percent: float) -> float:
        """Lateness that so many of a hundred sends do not exceed; NaN of none."""
        wanted, passed = max(1.0, self.count * percent / 100.0), 0
        for place in sorted(self._classes):
            passed += self._classes[place]
            if passed >= wanted:
                shift = max(0, (place >> _PARTS_BITS) - 1)
                low = (place - (shift << _PARTS_BITS)) << shift
                return float(min(self.worst_ns, low + ((1 << shift) - 1) / 2))
        return float("nan")

    def histogram(self) -> list[tuple[int, int]]:
        """(upper edge in us, sends up to it and beyond the edge before); later than the last edge: edge 0."""
        return [*zip((*EDGES_US, 0), self._up_to, strict=True)]
