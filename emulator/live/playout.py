"""The feeder's clock against ours: from samples' stamps and arrivals, the run's instant at which each one holds.

Belongs here: the lower envelope of offsets, drift, the play-out delay, steps and restarts of the feeder's clock. Not:
what a sample says (samples), reading a clock (runtime).

The least delayed samples tell the offset: their lower envelope is a line through the least offset of each second. What
is used of it moves by at most `SLEW`, so that the scene's time advances evenly whatever the feed does.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from emulator.live.rotations import Floats

WINDOW_NS = 5_000_000_000
"The play-out delay is of the samples of so long."
MINIMA = 30
"Seconds whose least offsets make the line."
DRIFT = 500e-6
"Most that the feeder's clock may run away; faster is a feed that does not keep real time."
SLEW = 1e-3
"Seconds a second by which offset and delay move at most."
EASE_NS = 1_000_000_000
"The nearer they are to where they belong the slower: less than a millisecond is left to a third in this time."
RESTART_NS = 1_000_000_000
"A stamp so far before the newest one: the feeder has started again."
LEAST_DELAY_NS, MOST_DELAY_NS = 2_000_000, 250_000_000
STEP_COUNT = 10
"Samples in a row that are away from the envelope before it is believed that the clock has stepped."
STEP_NS = 500_000_000
"And they span so long."
PACED = 1.5
"A feeder that is faster than this against ours does not keep real time: it is played by its stamps."
SETTLE = 20
"Of so few samples the offset is their least one at once."
KEPT = 20_000


@dataclass(frozen=True)
class Mapped:
    """A sample's instant."""

    run_ns: int
    "In the run's time, the play-out delay included."
    event: str = ""
    "`restart`: the feeder's clock began again; `step`: it jumped. All that was mapped before is of another time."


class PlayoutClock:
    """Maps stamps of one feeder to the run's time."""

    def __init__(self, delay_ns: int | None = None, latency_ns: int = 0, max_offset_ns: int = 50_000_000) -> None:
        """`delay_ns` None: as much as nearly all samples need. `max_offset_ns`: samples further off are of a step."""
        self._fixed_delay_ns = delay_ns
        self._latency_ns, self._most_off_ns = latency_ns, max_offset_ns
        self.events = 0
        self._clear()

    def _clear(self) -> None:
        self._minima: deque[tuple[int, int, int]] = deque(maxlen=MINIMA)
        "Second of arrival, arrival and offset of the least delayed sample in it."
        self._recent: deque[tuple[int, int]] = deque(maxlen=KEPT)
        "Arrival and offset."
        self._steps: deque[int] = deque(maxlen=1000)
        "Between stamps of neighbours."
        self._away: list[tuple[int, int]] = []
        "Stamp and arrival of samples in a row that are off the envelope."
        self._newest_ns: int | None = None
        self._count = 0
        self._target_at = -WINDOW_NS
        self._base: tuple[int, float, float] | None = None
        self._used: tuple[int, float, float] | None = None
        "Arrival, offset and delay that were used last."

    @property
    def offset_ns(self) -> float:
        """Run's time minus stamp, as it is used now; 0 before the first sample."""
        return 0.0 if self._used is None else self._used[1]

    @property
    def delay_ns(self) -> float:
        """The play-out delay, as it is used now, and the feeder's latency."""
        return 0.0 if self._used is None else self._used[2] + self._latency_ns

    @property
    def drift_ppm(self) -> float:
        """By how much the run's clock gains on the feeder's."""
        return 0.0 if self._base is None else self._base[2] * 1e6

    def map(self, stamp_ns: int, arrival_ns: int) -> Mapped:
        """One sample that has come."""
        event = ""
        if self._newest_ns is not None and stamp_ns < self._newest_ns - RESTART_NS:
            self._clear()
            event = "restart"
        elif self._has_stepped(stamp_ns, arrival_ns):
            self._clear()
            event = "step"
        self.events += bool(event)
        offset = arrival_ns - stamp_ns
        if self._newest_ns is not None and stamp_ns > self._newest_ns:
            self._steps.append(stamp_ns - self._newest_ns)
        self._newest_ns = stamp_ns if self._newest_ns is None else max(stamp_ns, self._newest_ns)
        self._count += 1
        self._note(offset, arrival_ns)
        self._slew(arrival_ns)
        return Mapped(round(stamp_ns + self.offset_ns + self.delay_ns), event)

    def _has_stepped(self, stamp_ns: int, arrival_ns: int) -> bool:
        """Whether samples have been off the envelope for so long that it is not their delay."""
        if self._used is None:
            return False
        off = arrival_ns - stamp_ns - self._used[1]
        if abs(off) <= self._most_off_ns:
            self._away.clear()
            return False
        if self._away and (off > 0) != (self._away[0][1] - self._away[0][0] - self._used[1] > 0):
            self._away.clear()
        self._away.append((stamp_ns, arrival_ns))
        first_stamp, first_arrival = self._away[0]
        span = arrival_ns - first_arrival
        if len(self._away) < STEP_COUNT or span < STEP_NS:
            return False
        rate = (stamp_ns - first_stamp) / span
        if 1.0 / PACED < rate < PACED:
            return True
        del self._away[: len(self._away) // 2]  # it does not keep real time: it is played by its stamps
        return False

    def _note(self, offset: int, arrival_ns: int) -> None:
        if self._away:
            return
        self._recent.append((arrival_ns, offset))
        while self._recent[0][0] < arrival_ns - WINDOW_NS:
            self._recent.popleft()
        second = arrival_ns // 1_000_000_000
        if not self._minima or self._minima[-1][0] != second:
            self._minima.append((second, arrival_ns, offset))
        elif offset < self._minima[-1][2]:
            self._minima[-1] = (second, arrival_ns, offset)

    def _line(self, now_ns: int) -> tuple[float, float]:
        """The envelope at an instant, and its slope."""
        when = np.array([one[1] for one in self._minima], np.float64) - now_ns
        least = np.array([one[2] for one in self._minima], np.float64)
        base = least.min()
        if len(when) < 4:
            return float(base), 0.0
        slope = min(max(_lower_slope(when, least), -DRIFT), DRIFT)
        return float((least - slope * when).min()), slope

    def _delay(self, offset: float) -> float:
        if self._fixed_delay_ns is not None:
            return float(self._fixed_delay_ns)
        late = np.array([one[1] for one in self._recent], np.float64) - offset
        period = float(np.median(self._steps)) if self._steps else 0.0
        wanted = float(np.percentile(late, 99.0)) + period if len(late) else period
        return min(max(wanted, float(LEAST_DELAY_NS)), float(MOST_DELAY_NS))

    def _slew(self, now_ns: int) -> None:
        young = self._count <= SETTLE
        if self._base is None or young or now_ns - self._target_at > 100_000_000:
            if self._minima:
                offset, slope = self._line(now_ns)
                self._target_at = now_ns
                self._base = (now_ns, offset, slope)
                self._wanted_delay = self._delay(offset)
        if self._base is None:
            return
        offset = self._base[1] + self._base[2] * (now_ns - self._base[0])
        if self._used is None or young:
            self._used = (now_ns, offset, self._wanted_delay)
            return
        since = max(0, now_ns - self._used[0])
        share, most = min(1.0, since / EASE_NS), SLEW * since
        _, old, delay = self._used
        drifted = old + self._base[2] * since
        eased = drifted + share * (offset - drifted), delay + share * (self._wanted_delay - delay)
        self._used = now_ns, _towards(old, eased[0], most), _towards(delay, eased[1], most)


def _lower_slope(when: Floats, least: Floats) -> float:
    """Of the line below all points that is nearest to them in the mean: that side of their hull below the middle."""
    hull: list[tuple[float, float]] = []
    for x, y in zip(when.tolist(), least.tolist(), strict=True):
        while len(hull) > 1 and _turns_down(hull[-2], hull[-1], (x, y)):
            hull.pop()
        hull.append((x, y))
    middle = float(when.mean())
    (x0, y0), (x1, y1) = next(pair for pair in pairwise(hull) if pair[1][0] >= middle)
    return (y1 - y0) / (x1 - x0)


def _turns_down(one: tuple[float, float], other: tuple[float, float], last: tuple[float, float]) -> bool:
    """`other` is not below the line from `one` to `last`."""
    return (other[0] - one[0]) * (last[1] - one[1]) <= (last[0] - one[0]) * (other[1] - one[1])


def _towards(old: float, new: float, most: float) -> float:
    return old + min(max(new - old, -most), most)
