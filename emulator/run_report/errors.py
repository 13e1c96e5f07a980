"""Range errors and detections added up, so that a run of any length needs the same memory.

Belongs here: sums and histograms by actor and distance. Not: where true ranges come from (truth).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from emulator.objects.metrics import DISTANCE_BINS_M
from protocols.scan import Floats, Ints

BIN_M = 0.002
HALF_BINS = 500
"Errors up to a metre each way; what lies beyond is counted at the ends."
CURVE_M = 5.0
CURVE_BINS = 80
"Distances of the share of detections: classes of 5 m up to 400 m."

Longs = NDArray[np.int64]
EDGES_M = np.array(DISTANCE_BINS_M[:-1])


def known(value: float) -> float | None:
    """None for NaN and infinity, which neither pages nor JSON can tell."""
    return value if math.isfinite(value) else None


@dataclass
class Errors:
    """Differences between measured and true ranges."""

    count: int = 0
    total_m: float = 0.0
    squares_m2: float = 0.0
    least_m: float = math.inf
    most_m: float = -math.inf
    bins: Longs = field(default_factory=lambda: np.zeros(2 * HALF_BINS + 2, dtype=np.int64))

    def add(self, error_m: Floats) -> None:
        """Some more, (n,)."""
        if not len(error_m):
            return
        self.count += len(error_m)
        self.total_m += float(error_m.sum())
        self.squares_m2 += float(np.square(error_m).sum())
        self.least_m = min(self.least_m, float(error_m.min()))
        self.most_m = max(self.most_m, float(error_m.max()))
        places = np.clip(np.floor(error_m / BIN_M).astype(np.int64) + HALF_BINS + 1, 0, 2 * HALF_BINS + 1)
        self.bins += np.bincount(places, minlength=len(self.bins))

    def join(self, other: Errors) -> None:
        """Those of another sum too."""
        self.count += other.count
        self.total_m += other.total_m
        self.squares_m2 += other.squares_m2
        self.least_m = min(self.least_m, other.least_m)
        self.most_m = max(self.most_m, other.most_m)
        self.bins += other.bins

    @property
    def mean_m(self) -> float:
        """NaN without any."""
        return self.total_m / self.count if self.count else math.nan

    @property
    def sigma_m(self) -> float:
        """Standard deviation of the errors; NaN below two."""
        if self.count < 2:
            return math.nan
        return math.sqrt(max(0.0, (self.squares_m2 - self.total_m**2 / self.count) / (self.count - 1)))

    @property
    def rms_m(self) -> float:
        """Root mean square."""
        return math.sqrt(self.squares_m2 / self.count) if self.count else math.nan

    def percentile_m(self, share: float) -> float:
        """Upper edge of the bin below which that share of the errors lies, to `BIN_M`; NaN without any."""
        if not self.count:
            return math.nan
        place = int(np.searchsorted(np.cumsum(self.bins), share * self.count))
        return (place - HALF_BINS) * BIN_M


@dataclass
class Aimed:
    """What became of the beams whose axis meets a thing."""

    beams: int = 0
    seen: int = 0
    "An echo of that thing."
    other: int = 0
    "Only echoes of something else: beside or in front of it, within the beam's width."
    air: int = 0
    "Only echoes of the weather or of noise."
    missed: int = 0
    "No echo."


class RangeTally:
    """Errors and detections of one sensor."""

    def __init__(self, actors: Sequence[str]) -> None:
        self.actors = tuple(actors)
        self.sweeps = 0
        self.by_actor: dict[int, Errors] = {}
        self.by_class: dict[tuple[int, int], Errors] = {}
        "Actor and class of distance, an index into `DISTANCE_BINS_M`."
        self.aimed: dict[int, Aimed] = {}
        self.aimed_by_class: dict[tuple[int, int], Aimed] = {}
        self.beside = 0
        "Echoes of beams whose axis meets nothing."
        self.farthest_m: dict[int, float] = {}
        self.farthest_at_s: dict[int, float] = {}
        self.could: dict[int, Longs] = {}
        "Actor -> sweeps in which a beam's axis met it, by class of the nearest such distance."
        self.did: dict[int, Longs] = {}
        "The same of sweeps that had an echo of it."

    def add(
        self, starts_s: Floats, range_m: Floats, actor: Ints, true_m: Floats, true_actor: Ints, sweep: Longs
    ) -> None:
        """Some sweeps at once.

        Parameters
        ----------
        starts_s : (s,) of the sweeps.
        range_m, actor : (b, k) echoes of all their beams, NaN and -1 where there is none.
        true_m, true_actor : (b,) what each beam's axis meets.
        sweep : (b,) which of the sweeps each beam is of.
        """
        self.sweeps += len(starts_s)
        echo = np.isfinite(range_m)
        meets = np.isfinite(true_m)
        own = echo & (actor == true_actor[:, None]) & meets[:, None]
        seen = own.any(axis=1)
        first = own.argmax(axis=1)
        error = range_m[np.arange(len(range_m)), first] - true_m
        thing = (echo & (actor >= 0)).any(axis=1)
        any_echo = echo.any(axis=1)
        self.beside += int(np.count_nonzero(any_echo & ~meets))
        classes = np.searchsorted(EDGES_M, np.nan_to_num(true_m), side="right")
        for number in np.unique(true_actor[meets]).tolist():
            of_it = meets & (true_actor == number)
            self.by_actor.setdefault(number, Errors()).add(error[of_it & seen])
            for index in np.unique(classes[of_it]).tolist():
                part = of_it & (classes == index)
                self.by_class.setdefault((number, index), Errors()).add(error[part & seen])
                counted = (
                    int(np.count_nonzero(part)),
                    int(np.count_nonzero(part & seen)),
                    int(np.count_nonzero(part & ~seen & thing)),
                    int(np.count_nonzero(part & ~seen & any_echo & ~thing)),
                    int(np.count_nonzero(part & ~any_echo)),
                )
                for aimed in (
                    self.aimed.setdefault(number, Aimed()),
                    self.aimed_by_class.setdefault((number, index), Aimed()),
                ):
                    aimed.beams += counted[0]
                    aimed.seen += counted[1]
                    aimed.other += counted[2]
                    aimed.air += counted[3]
                    aimed.missed += counted[4]
            self._detect(number, starts_s, range_m, echo & (actor == number), of_it, true_m, sweep)

    def by_distance(self) -> dict[int, Errors]:
        """Errors on all actors together by class of distance; classes without any are left out."""
        found: dict[int, Errors] = {}
        for (_, index), errors in sorted(self.by_class.items()):
            if errors.count:
                found.setdefault(index, Errors()).join(errors)
        return dict(sorted(found.items()))

    def _detect(
        self, number: int, starts_s: Floats, range_m: Floats, mine: NDArray[np.bool_], of_it: NDArray[np.bool_],
        true_m: Floats, sweep: Longs,
    ) -> None:  # fmt: skip
        nearest = np.full(len(starts_s), np.inf)
        np.minimum.at(nearest, sweep[of_it], true_m[of_it])
        could = np.isfinite(nearest)
        did = np.bincount(sweep[mine.any(axis=1)], minlength=len(starts_s)) > 0
        places = np.minimum(np.nan_to_num(nearest, posinf=0.0) / CURVE_M, CURVE_BINS - 1).astype(np.int64)
        for table, held in ((self.could, could), (self.did, could & did)):
            counts = table.setdefault(number, np.zeros(CURVE_BINS, dtype=np.int64))
            counts += np.bincount(places[held], minlength=CURVE_BINS)
        if mine.any():
            far = np.where(mine, range_m, -np.inf).max(axis=1)
            best = int(far.argmax())
            if far[best] > self.farthest_m.get(number, -math.inf):
                self.farthest_m[number] = float(far[best])
                self.farthest_at_s[number] = float(starts_s[sweep[best]])
