"""Sub-echoes of a scan as flat arrays, and how they fall into clusters that can interact.

Here: the container, sorting, splitting into clusters, joining what no receiver can distinguish. Not here: the waveform
that clusters make (waveform) and which echoes are reported (detection).
Amplitudes are in units of the receiver's nominal rms noise: signal current at the peak of the pulse over noise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from types import ModuleType
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from emulator.compiled.pair import OTHERWISE, by_loops
from emulator.physics.arrays import Bools, Floats, Ints, clamped, floats, group_starts, indexes, ramp

NO_SOURCE = -1
NO_BEAMS, NO_SPREAD = np.zeros(0, np.bool_), np.zeros(0)
Number = TypeVar("Number", np.float64, np.int64)


@dataclass(frozen=True, eq=False)
class SubEchoes:
    """k sub-echoes, sorted by beam and, within a beam, by range; several may share a range, none is lost."""

    beam: Ints
    "(k,) ascending"
    range_m: Floats
    "(k,) ascending within a beam"
    amplitude: Floats
    "(k,) >= 0, in noise units"
    blocked: Floats
    "(k,) share of the beam's power that ends here and lights no fog behind; 0 for a drop."
    source: Ints
    "(k,) whatever the caller wants to find again, such as the actor; -1 none."
    spread_m: Floats | None = None
    "(k,) standard deviation of range of a sub-echo that is a whole tilted plane; None: all points."

    def __len__(self) -> int:
        return len(self.range_m)

    @classmethod
    def of(
        cls,
        beam: Ints,
        range_m: Floats,
        amplitude: Floats,
        blocked: Floats | None = None,
        source: Ints | None = None,
        spread_m: Floats | None = None,
    ) -> SubEchoes:
        """Sub-echoes in any order; sorted, those that are not finite or have no amplitude dropped unless they block."""
        beam, range_m, amplitude = np.asarray(beam, np.int64), floats(range_m), floats(amplitude)
        stop = np.zeros(range_m.shape) if blocked is None else floats(blocked)
        tag = np.full(range_m.shape, NO_SOURCE, np.int64) if source is None else np.asarray(source, np.int64)
        kept = np.isfinite(range_m) & np.isfinite(amplitude) & ((amplitude > 0.0) | (stop > 0.0))
        if not bool(kept.all()):
            beam, range_m, amplitude, stop, tag = beam[kept], range_m[kept], amplitude[kept], stop[kept], tag[kept]
            spread_m = None if spread_m is None else spread_m[kept]
        later = (beam[1:] > beam[:-1]) | ((beam[1:] == beam[:-1]) & (range_m[1:] >= range_m[:-1]))
        if not bool(later.all()):
            length = float(range_m.max()) - min(0.0, float(range_m.min())) + 1.0
            order = np.argsort(beam * length + range_m, kind="stable")  # runs already in order cost little
            beam, range_m, amplitude, stop, tag = beam[order], range_m[order], amplitude[order], stop[order], tag[order]
            spread_m = None if spread_m is None else spread_m[order]
        return cls(beam, range_m, amplitude, stop, tag, spread_m)

    @classmethod
    def none(cls) -> SubEchoes:
        """Not one."""
        no = np.zeros(0, np.int64)
        return cls(no, np.zeros(0), np.zeros(0), np.zeros(0), no)

    @classmethod
    def from_grid(
        cls, range_m: Floats, amplitude: Floats, blocked: Floats | None = None, source: Ints | None = None
    ) -> SubEchoes:
        """From arrays (n, m) of n beams with m sub-beams each; NaN ranges are misses. Sorts each row."""
        order = np.argsort(range_m, axis=1)  # NaN goes last
        hit = np.isfinite(np.take_along_axis(range_m, order, 1))
        beam = np.arange(range_m.shape[0]).repeat(np.count_nonzero(hit, axis=1))

        def picked(values: Floats) -> Floats:
            return floats(np.take_along_axis(np.broadcast_to(values, range_m.shape), order, 1)[hit])

        tag = None
        if source is not None:
            tag = np.take_along_axis(np.broadcast_to(source, range_m.shape), order, 1)[hit].astype(np.int64)
        return cls.of(beam, picked(range_m), picked(amplitude), None if blocked is None else picked(blocked), tag)

    def of_beams(self, wanted: Bools) -> SubEchoes:
        """Those of the beams (n,) that are wanted."""
        at = indexes(wanted[self.beam])
        spread = None if self.spread_m is None else self.spread_m[at]
        return SubEchoes(self.beam[at], self.range_m[at], self.amplitude[at], self.blocked[at], self.source[at], spread)

    def replaced(self, beams: Bools, others: SubEchoes) -> SubEchoes:
        """With `others`, which are all of these beams (n,), instead of its own there."""
        return _combined(self, others, beams)

    @classmethod
    def joined(cls, *parts: SubEchoes) -> SubEchoes:
        """All sub-echoes of several sources, surfaces and drops for instance."""
        whole = parts[0]
        for part in parts[1:]:
            if not len(whole) or not len(part):
                whole = whole if len(whole) else part
            else:
                whole = _combined(whole, part, NO_BEAMS)
        return whole


def _combined_by_loops(loops: ModuleType, one: SubEchoes, other: SubEchoes, without: Bools) -> SubEchoes:
    spread, spreads = (NO_SPREAD if part.spread_m is None else part.spread_m for part in (one, other))
    (beam, source), (range_m, amplitude, blocked, spread_m), k = loops.merged(
        one.beam, one.range_m, one.amplitude, one.blocked, one.source, spread,
        other.beam, other.range_m, other.amplitude, other.blocked, other.source, spreads, without,
    )  # fmt: skip
    none = one.spread_m is None and other.spread_m is None
    return SubEchoes(beam[:k], range_m[:k], amplitude[:k], blocked[:k], source[:k], None if none else spread_m[:k])


@by_loops(_combined_by_loops, "merged")
def _combined(one: SubEchoes, other: SubEchoes, without: Bools) -> SubEchoes:
    """Both, sorted as they are; those of the first come first among equals.

    `without`: (n,) beams that lose those of the first, and that all of the other are of; (0,): all are kept.
    """
    if len(without):
        kept = indexes(~without[one.beam])
        places = np.concatenate([one.beam[kept], other.beam]).argsort(kind="stable")  # of two runs: they are merged
        first = np.concatenate([kept, len(one) + np.arange(len(other))])[places]
        return _of_columns(one, other, partial(_taken, first))
    # of numbers so far apart that beams stay apart, the fewer are looked up among the others
    low = min(0.0, float(one.range_m.min()), float(other.range_m.min()))
    length = max(float(one.range_m.max()), float(other.range_m.max())) - low + 1.0
    key, keys = one.beam * length + one.range_m, other.beam * length + other.range_m
    each = np.arange(len(keys))
    place = key.searchsorted(keys, side="right") + each
    of_one = np.ones(len(key) + len(keys), np.bool_)
    of_one[place] = False
    order = of_one.cumsum() - 1  # which of the first is there
    order[place] = len(key) + each
    return _of_columns(one, other, partial(_taken, order))


def _taken(order: Ints, one: NDArray[Number], other: NDArray[Number]) -> NDArray[Number]:
    """Of two columns, one behind the other."""
    both: NDArray[Number] = np.concatenate([one, other])
    return both.take(order)


def _of_columns(one: SubEchoes, other: SubEchoes, column: Callable[[Any, Any], Any]) -> SubEchoes:
    """Made of both, a column at a time."""
    spread = None
    if one.spread_m is not None or other.spread_m is not None:
        spread = column(*(np.zeros(len(part)) if part.spread_m is None else part.spread_m for part in (one, other)))
    return SubEchoes(
        column(one.beam, other.beam),
        column(one.range_m, other.range_m),
        column(one.amplitude, other.amplitude),
        column(one.blocked, other.blocked),
        column(one.source, other.source),
        spread,
    )


def interleaved(parts: list[SubEchoes], beams: int) -> SubEchoes:
    """All sub-echoes of parts that have no beam in common, without spreads; beams are numbered below `beams`."""
    parts = [part for part in parts if len(part)]
    if len(parts) < 2:
        return parts[0] if parts else SubEchoes.none()
    counts = [np.bincount(part.beam, minlength=beams) for part in parts]
    whole = np.sum(counts, axis=0)
    begins, total = whole.cumsum() - whole, sum(len(part) for part in parts)
    sizes = np.zeros((3, total))
    made = SubEchoes(np.zeros(total, np.int64), sizes[0], sizes[1], sizes[2], np.zeros(total, np.int64))
    for part, count in zip(parts, counts, strict=True):
        place = (begins - (count.cumsum() - count))[part.beam] + np.arange(len(part))
        for name in ("beam", "range_m", "amplitude", "blocked", "source"):
            getattr(made, name)[place] = getattr(part, name)
    return made


@dataclass(frozen=True, eq=False)
class Kept:
    """Sub-echoes that come again, sweep after sweep, in most beams."""

    found: SubEchoes
    "Of all beams; the same object each time."
    changed: Bools
    "(n,) beams that have others now."

    def whole(self, others: SubEchoes) -> SubEchoes:
        """With the sub-echoes of those beams."""
        return SubEchoes.joined(self.found.of_beams(~self.changed), others)


@dataclass(frozen=True, eq=False)
class Clusters:
    """Sub-echoes joined where no receiver can distinguish them, and cut into clusters that do not overlap."""

    beam: Ints
    "(g,) of each joined sub-echo"
    range_m: Floats
    "(g,) energy-weighted mean"
    amplitude: Floats
    "(g,) sum"
    blocked: Floats
    "(g,) sum"
    source: Ints
    "(g,) of the strongest member"
    cluster: Ints
    "(g,) number of the cluster, ascending"
    first: Ints
    "(c,) index of the first joined sub-echo of each cluster"
    count: Ints
    "(c,) joined sub-echoes in each cluster"

    def __len__(self) -> int:
        return len(self.first)


def _cluster_by_loops(loops: ModuleType, echoes: SubEchoes, support_m: float, resolution_m: float) -> Clusters:
    if not len(echoes):
        return OTHERWISE
    (beam, source, number), (r, amplitude, blocked), (first, count) = loops.joined(
        echoes.beam, echoes.range_m, echoes.amplitude, echoes.blocked, echoes.source, support_m, 0.25 * resolution_m
    )
    return Clusters(beam, r, amplitude, blocked, source, number, first, count)


@by_loops(_cluster_by_loops, "joined")
def cluster(echoes: SubEchoes, support_m: float, resolution_m: float) -> Clusters:
    """Join sub-echoes within a quarter of the range resolution; cut clusters where the gap exceeds the pulse.

    Joining puts the summed amplitude at the energy-weighted mean; the error of the waveform is second order: half the
    variance times the curvature of the pulse.
    """
    n = len(echoes)
    if n == 0:
        none, nothing = np.zeros(0, np.int64), np.zeros(0)
        return Clusters(none, nothing, nothing, nothing, none, none, none, none)
    beam, r = echoes.beam, echoes.range_m
    cut = np.ones(n, np.bool_)
    cut[1:] = (beam[1:] != beam[:-1]) | (r[1:] - r[:-1] > support_m)
    number = cut.cumsum() - 1
    start = indexes(cut)
    end = np.append(start[1:], n) - 1
    quarter = 0.25 * resolution_m
    narrow = r[end] - r[start] < quarter
    joined = cut.copy()
    if quarter > 0.0:
        cell = np.floor((r - r[start][number]) / quarter)
        joined[1:] |= (cell[1:] != cell[:-1]) & ~narrow[number[1:]]
    else:
        joined[1:] = True
    first = indexes(joined)
    amplitude = np.add.reduceat(echoes.amplitude, first)
    weight = np.where(amplitude > 0.0, amplitude, 1.0)
    near = r[first]
    offset = np.add.reduceat(echoes.amplitude * (r - near.repeat(np.diff(np.append(first, n)))), first) / weight
    source = echoes.source[first]
    turns = indexes((echoes.source[1:] != echoes.source[:-1]) & ~joined[1:])
    if len(turns):
        mixed = np.unique(first.searchsorted(turns, side="right") - 1)
        size = np.diff(np.append(first, n))[mixed]
        at = first[mixed].repeat(size) + ramp(size)
        height = echoes.amplitude[at]
        top = np.maximum.reduceat(height, size.cumsum() - size)
        strongest = indexes(height == top.repeat(size))[::-1]
        source[mixed.repeat(size)[strongest]] = echoes.source[at[strongest]]  # the first of equals wins
    mine = number[first]
    head = group_starts(mine)
    return Clusters(
        beam[first],
        near + offset,
        amplitude,
        np.add.reduceat(echoes.blocked, first),
        source,
        mine,
        head,
        np.diff(np.append(head, first.size)),
    )


def unfold_spread(echoes: SubEchoes, wide: Bools, nodes: int = 20) -> SubEchoes:
    """Replace the chosen sub-echoes, whole tilted planes, by Gauss-Hermite nodes over their spread of ranges.

    Across a plane range goes with 1/(1 - T u) and energy with (1 - T u)^3, T u normal with deviation spread/range: the
    echo is skew. Energy and mean range of the sub-echo are kept exactly.
    """
    if echoes.spread_m is None or not bool(wide.any()):
        return SubEchoes(echoes.beam, echoes.range_m, echoes.amplitude, echoes.blocked, echoes.source)
    z, weight = np.polynomial.hermite.hermgauss(nodes)
    kept = ~wide
    mean = echoes.range_m[wide][:, None]
    slope = clamped(1.0 - np.sqrt(2.0) * z * echoes.spread_m[wide][:, None] / np.maximum(mean, 1e-9), 0.2, 1.8)
    share = weight * slope**3
    share = share / share.sum(axis=1, keepdims=True)
    r = 1.0 / slope
    r = mean * (r - np.sum(share * r, axis=1, keepdims=True) + 1.0)
    times = np.full(int(np.count_nonzero(wide)), nodes)
    return SubEchoes.of(
        np.concatenate([echoes.beam[kept], echoes.beam[wide].repeat(times)]),
        np.concatenate([echoes.range_m[kept], np.maximum(r, 0.0).ravel()]),
        np.concatenate([echoes.amplitude[kept], (echoes.amplitude[wide][:, None] * share).ravel()]),
        np.concatenate([echoes.blocked[kept], (echoes.blocked[wide][:, None] * share).ravel()]),
        np.concatenate([echoes.source[kept], echoes.source[wide].repeat(times)]),
    )
