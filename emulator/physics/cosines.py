"""Clusters shorter than half a pulse under a leading edge: crossed exactly, without a sample.

Here: which clusters of a sin^2 pulse are such, their height and place, and where they cross a level. Not here: clusters
that are spread farther, and other ways of timing (waveform, timing).

With s(x) = (1 + cos kx)/2, the sum of the pulses that are under way is ``A/2 + |C|/2 cos(k(x - r))``: A the sum of
their amplitudes a_i, C that of a_i exp(i k r_i), k r its angle. While the pulses of a short cluster begin, none has
passed its maximum, so the sum rises; running sums at the beginnings tell between which two of them a level is crossed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from types import ModuleType

import numpy as np

from emulator.compiled.pair import by_loops
from emulator.physics.arrays import Bools, Floats, Ints, Values, clamped, cos_sin, indexes
from emulator.physics.detector import Detector
from emulator.physics.softprofile import SoftProfile
from emulator.physics.subechoes import SubEchoes

SHORT = 1.0
"Longest cluster that is summed in closed form, in half pulses: beyond it, first pulses fall while last ones rise."


LEAST = 1e-6
"Share of a level that a medium leaves to the pulses at the least."
FAINT = 0.1
"Share of the threshold that a medium may have under a cluster that is crossed in closed form."
TALL = 8.0
"""Times a medium that a cluster swings by, |C|, which has more than a faint one under it.

It then shifts the cluster's maximum by 0.1 / k: what the parabola of `_lifted` leaves out is 1e-3 of the medium there.
"""
EXACT_M = 1e-5
"Crossings are looked for again, with the medium that is under them, until they move by less than this."
MOST_PASSES = 60
"Each leaves the share of the shift that the medium falls by while the pulses rise by as much: a tenth, mostly."
SLIGHT = 1e-4
"Share of a cluster's height that a medium may have for its part in the height to be left out."
VALLEY_PASSES = 2
"Times that a valley is looked for, with the slope that the medium has where it was found before."
NEAR_TOP = 3.0
"Times the shift of a maximum by a medium: what is crossed nearer to the maximum is on a parabola, to 5e-4."
SHIFT = 0.125
"Shift of a crossing, in steps of the range, below which it is left out under such a cluster."


@dataclass(frozen=True, eq=False)
class AirUnder:
    """What a faint medium adds under h clusters while their pulses rise; m sub-echoes in them. See softprofile."""

    soft: SoftProfile
    cluster: Ints
    "(h,) numbers of the clusters."
    before: Ints
    "(h,) index of a sub-echo among all less that in `sums`, less one."
    open: Floats
    "(h,) share of the beam that reaches the cluster."
    begins: Ints
    "(h,) index in `sums` of what lies before each cluster."
    sums: Floats
    "(4, m + 1) running: shares that end at the sub-echoes, and these with the integrals of the medium up to there."

    def chosen(self, at: Ints, cluster: Ints) -> AirUnder:
        """Those of some places, under other numbers of the clusters."""
        return replace(self, cluster=cluster, before=self.before[at], open=self.open[at], begins=self.begins[at])

    def at(self, x_m: Floats, last: Ints) -> Floats:
        """Its part at apparent ranges (h,), where these sub-echoes are the last ones begun; linear between bins."""
        soft = self.soft
        blocked, a, real, imaginary = self.sums.take(last - self.before, axis=1) - self.sums.take(self.begins, axis=1)
        still = np.maximum(self.open - blocked, 0.0)
        bins = np.floor(x_m / soft.bin_m)
        value = []
        for number in (bins, bins + 1.0):
            upper, lower = soft.tables(number.astype(np.int64))
            turn = soft.pulse.wave_number * soft.bin_m * number
            ended = a + np.cos(turn) * real - np.sin(turn) * imaginary
            value.append(np.maximum(0.5 * (still * upper + ended - self.open * lower), 0.0))
        return np.asarray(value[0] + (x_m / soft.bin_m - bins) * (value[1] - value[0]))


@dataclass(frozen=True, eq=False)
class AirDoubted:
    """A medium so faint under h clusters that it is computed only where a crossing may depend on it."""

    cluster: Ints
    "(h,) numbers of the clusters."
    most: Floats
    "(h,) bound of what it adds under each."
    step_m: float
    "Of the range."
    number: Ints
    "(h,) what `under` calls them."
    under: Callable[[Ints, Ints], AirUnder]
    "Of some of these, under numbers of clusters."

    def chosen(self, at: Ints, cluster: Ints) -> AirDoubted:
        """Those of some places, under other numbers of the clusters."""
        return replace(self, cluster=cluster, most=self.most[at], number=self.number[at])


def _cross_under_by_loops(
    loops: ModuleType, whole: Cosines, air: AirUnder, level: Floats, crossing: Floats, of: Ints
) -> None:
    at, sums = air.cluster, (whole.begun, whole.total, whole.real, whole.imaginary)
    crossing[at] = loops.crossed_under(
        *air.soft.flat, level[at], whole.start[at], whole.size[at], whole.first_m[at], *sums, whole.half_m,
        air.before, air.begins, air.open, air.sums, crossing[at], of, LEAST, EXACT_M, MOST_PASSES,
    )  # fmt: skip


def _crossed_by_loops(
    loops: ModuleType, whole: Cosines, level: Floats, start: Ints, size: Ints, at: Ints | None = None
) -> tuple[Floats, Ints]:
    first_m, sums = whole.first_m if at is None else whole.first_m[at], (whole.real, whole.imaginary)
    crossing, last = loops.crossed(
        level, start, size, first_m, whole.begun, whole.total, *sums, whole.half_m, whole.wave_number
    )
    return crossing, last


@dataclass(frozen=True, eq=False)
class Cosines:
    """Short clusters; c of them, s sub-echoes in all clusters of the scan."""

    beam: Ints
    "(c,)"
    centre_m: Floats
    "(c,) place of the maximum"
    height: Floats
    "(c,)"
    source: Ints
    "(c,) of the strongest sub-echo"
    first_m: Floats
    "(c,) range to which phases refer"
    start: Ints
    "(c,) index of the first sub-echo in the arrays below"
    size: Ints
    "(c,)"
    begun: Floats
    "(s,) signal at the instant at which each sub-echo's pulse begins"
    total: Floats
    "(s,) A of the pulses begun by then, its own included"
    real: Floats
    imaginary: Floats
    half_m: float
    wave_number: float
    air: AirUnder | None = None
    doubted: AirDoubted | None = None
    valley: AirDoubted | None = None
    "The medium under those clusters where it may be over a level."
    shift_m: Floats | None = None
    "(c,) how far a medium under them shifts their maxima; None: nowhere."

    def __len__(self) -> int:
        return len(self.beam)

    def crossing(self, level: Floats) -> Floats:
        """Where each first reaches a level > 0, its maximum where it never does. (c,) [m]"""
        if len(self) == 0:
            return np.zeros(0)
        crossing, last = self._crossed(level, self.start, self.size)
        for air in (self.air, self._doubtful(level, crossing)):
            if air is None:
                continue
            self._cross_under(air, level, crossing, last[air.cluster])
        self._out_of_valleys(level, crossing)
        if self.shift_m is not None:
            # so near a maximum the medium falls by more than the pulses rise; the sum is a parabola
            bend = 0.5 * self.wave_number**2 * self.height
            before_m = np.sqrt(2.0 * np.maximum(self.height - level, 0.0) / bend)
            at = indexes(before_m < NEAR_TOP * self.shift_m)
            crossing[at] = (self.centre_m - before_m)[at]
        return crossing

    @by_loops(_cross_under_by_loops, "crossed_under")
    def _cross_under(self, air: AirUnder, level: Floats, crossing: Floats, of: Ints) -> None:
        """Correct the crossings of those clusters that the medium lies under; `of`: the last sub-echo begun by then."""
        for _ in range(MOST_PASSES):
            at = air.cluster
            before = crossing[at]
            left = np.maximum(level[at] - air.at(before, of), LEAST * level[at])
            crossing[at], of = self._crossed(left, self.start[at], self.size[at], at)
            on = indexes(np.abs(crossing[at] - before) > EXACT_M)
            if not len(on):
                break
            air, of = air.chosen(on, at[on]), of[on]

    def _out_of_valleys(self, level: Floats, crossing: Floats) -> None:
        """Correct the crossings of clusters that begin where the medium is over their level.

        As `timing._out_of_valleys`: a valley a noise unit above it, the place is that of a single echo; in between it
        goes from the one to the other.
        """
        if self.valley is None:
            return
        some = indexes(level[self.valley.cluster] < self.valley.most)
        if not len(some):
            return
        at = self.valley.cluster[some]
        air = self.valley.under(self.valley.number[some], at)
        begin, bin_m = self.first_m[at] - self.half_m, air.soft.bin_m
        valley, rise, last = begin, np.zeros(len(at)), self.start[at]
        for _ in range(VALLEY_PASSES):
            fall = (air.at(valley, last) - air.at(valley + bin_m, last)) / bin_m
            valley, rise, last = self._valleys(at, begin, np.maximum(fall, 0.0))
        height = air.at(valley, last) + rise
        above = clamped(height - level[at], 0.0, 1.0)
        lead = self.half_m - 2.0 / self.wave_number * np.arcsin(np.sqrt(clamped(level[at] / self.height[at], 0.0, 1.0)))
        single = self.centre_m[at] - lead
        crossing[at] = np.where(above > 0.0, valley + above * (single - valley), crossing[at])

    def _valleys(self, at: Ints, begin: Floats, fall: Floats) -> tuple[Floats, Floats, Ints]:
        """Valleys before clusters `at`, where their pulses rise as the medium falls: place, height of the pulses alone,
        and the last sub-echo begun.

        `begin`, `fall` : (h,) where they begin, and how steeply the medium falls.
        """
        last, end, k = self.start[at], self.start[at] + self.size[at], self.wave_number
        place, rise = begin.copy(), np.zeros(len(at))
        on = np.arange(len(at))
        while len(on):
            i = last[on]
            swing = np.hypot(self.real[i], self.imaginary[i])
            turn = np.arctan2(self.imaginary[i], self.real[i])
            # the angle from the trough at which they rise so; where they never do, the steepest
            steep, steepest = 2.0 * fall[on], k * swing
            rises = steep < steepest
            angle = np.arcsin(np.divide(steep, steepest, out=np.ones(len(on)), where=rises))
            place[on] = begin[on] + (turn + angle) / k
            rise[on] = 0.5 * (self.total[i] - swing) + swing * np.sin(0.5 * angle) ** 2
            more = i + 1 < end[on]
            on, rises = on[more], rises[more]
            on = on[~rises | (self.begun[last[on] + 1] < rise[on])]  # with one more pulse they rise so elsewhere
            last[on] += 1
        return place, rise, last

    def _doubtful(self, level: Floats, crossing: Floats) -> AirUnder | None:
        """The medium under those clusters whose crossing is elsewhere if all of it is added."""
        doubted = self.doubted
        if doubted is None:
            return None
        at = doubted.cluster
        left = np.maximum(level[at] - doubted.most, LEAST * level[at])
        first, _ = self._crossed(left, self.start[at], self.size[at], at)
        some = indexes(crossing[at] - first > SHIFT * doubted.step_m)
        return doubted.under(doubted.number[some], at[some]) if len(some) else None

    @by_loops(_crossed_by_loops, "crossed")
    def _crossed(self, level: Floats, start: Ints, size: Ints, at: Ints | None = None) -> tuple[Floats, Ints]:
        """Where the pulses of these clusters first reach a level, and the index of the last one begun by then."""
        first_m = self.first_m if at is None else self.first_m[at]
        ends = size.cumsum()
        begun = self.begun
        if ends[-1] < len(begun):
            begun = begun[(start - (ends - size)).repeat(size) + np.arange(ends[-1])]
        below = begun < level.repeat(size)
        passed = np.add.reduceat(below, ends - size, dtype=np.int64)
        last = start + np.maximum(passed, 1) - 1
        total, real, imaginary = self.total[last], self.real[last], self.imaginary[last]
        swing = np.hypot(real, imaginary)
        centre = first_m + np.arctan2(imaginary, real) / self.wave_number
        # the angle from the trough, which keeps its digits for a level far below the maximum
        share = (2.0 * level - total + swing) / (2.0 * swing)
        rise = 2.0 * np.arcsin(np.sqrt(clamped(share, 0.0, 1.0)))
        return centre - self.half_m + rise / self.wave_number, last

    def chosen(self, wanted: Bools) -> Cosines:
        """Some of the clusters, `wanted` (c,)."""
        if bool(wanted.all()):
            return self
        at, air, doubted, valley = indexes(wanted), self.air, self.doubted, self.valley
        renumbered = wanted.cumsum() - 1
        if air is not None:
            left = indexes(wanted[air.cluster])
            air = air.chosen(left, renumbered[air.cluster[left]]) if len(left) else None
        if doubted is not None:
            left = indexes(wanted[doubted.cluster])
            doubted = doubted.chosen(left, renumbered[doubted.cluster[left]]) if len(left) else None
        if valley is not None:
            left = indexes(wanted[valley.cluster])
            valley = valley.chosen(left, renumbered[valley.cluster[left]]) if len(left) else None
        return replace(
            self, beam=self.beam[at], centre_m=self.centre_m[at], height=self.height[at], source=self.source[at],
            first_m=self.first_m[at], start=self.start[at], size=self.size[at], air=air, doubted=doubted,
            valley=valley, shift_m=None if self.shift_m is None else self.shift_m[at],
        )  # fmt: skip

    @classmethod
    def none(cls) -> Cosines:
        """No cluster."""
        n, i = np.zeros(0), np.zeros(0, np.int64)
        return cls(i, n, n, i, n, i, i, n, n, n, n, 1.0, 1.0)


_Air = tuple[AirUnder | None, AirDoubted | None, AirDoubted | None, Floats | None]
_Split = tuple[Ints, Floats, Bools]
_Summed = tuple[Sequence[Floats], Sequence[Ints], Sequence[Floats], Ints]


def split_cosines(
    echoes: SubEchoes, detector: Detector, soft: SoftProfile | None = None, rms: Floats | None = None
) -> tuple[Cosines, SubEchoes]:
    """Short clusters, and the sub-echoes of all others.

    `soft`: a medium that shifts the echoes of clusters that begin before its `until_m`. Beams of which sub-echoes are
    left over, and they alone, need its waveform: in all others its own echo stands free of them. `rms` : (n,) noise of
    each beam over the nominal one; None: 1.
    """
    pulse, n = detector.pulse, len(echoes)
    if n == 0 or not detector.closed_form or echoes.spread_m is not None:
        return Cosines.none(), echoes
    half, k = pulse.half_support_m, pulse.wave_number
    beam, r, a = echoes.beam, echoes.range_m, echoes.amplitude
    whole, first, short = _split(echoes, 2.0 * half, SHORT * half)
    group, start, size = whole
    near, most = None, first
    if soft is not None:
        together = np.add.reduceat(a, start)
        # all angles of C lie between the first and the last
        swing = together * np.cos(0.5 * k * np.minimum(r[start + size - 1] - first, half))
        swing[together >= detector.full_scale] = 0.0
        dark = 1.0 if rms is None else rms[group]
        near, most = _near(soft, detector.threshold, short, group, first - half, swing, dark)
    if not bool(short.any()):
        return Cosines.none(), echoes
    running, (group, source, *where), (centre, height, first), rest = _summed(echoes, whole, short, k)
    begun, total, real, imaginary = running
    air: _Air = None, None, None, None
    if soft is not None and near is not None:
        number = (short.cumsum() - 1)[near]
        air = _under(centre, height, where, number, echoes, soft, detector, start[near], size[near], most, total)
    found = Cosines(
        group, centre, height, source, first, where[0], where[1], begun, total, real, imaginary, half, k, *air
    )  # fmt: skip
    if not len(rest):
        return found, SubEchoes.none()
    return found, SubEchoes(beam[rest], r[rest], a[rest], echoes.blocked[rest], echoes.source[rest])


def _split_by_loops(loops: ModuleType, echoes: SubEchoes, gap_m: float, longest_m: float) -> _Split:
    whole, first, short = loops.split(echoes.beam, echoes.range_m, echoes.amplitude, gap_m, longest_m)
    return whole, first, short


@by_loops(_split_by_loops, "split")
def _split(echoes: SubEchoes, gap_m: float, longest_m: float) -> _Split:
    """Beam, first sub-echo and size of each cluster; where it begins [m]; whether it is short and not dark."""
    beam, r = echoes.beam, echoes.range_m
    cut = (beam[1:] != beam[:-1]) | (r[1:] - r[:-1] > gap_m)
    start = np.concatenate(([0], indexes(cut) + 1))
    size = np.diff(np.append(start, len(echoes)))
    first, end = r[start], start + size - 1
    short = (r[end] - first < longest_m) & (_running(echoes.amplitude, start, size)[end] > 0.0)
    return np.stack([beam[start], start, size]), first, short


def _summed_by_loops(loops: ModuleType, echoes: SubEchoes, whole: Ints, short: Bools, wave_number: float) -> _Summed:
    running, where, maximum, rest = loops.sums(
        echoes.range_m, echoes.amplitude, echoes.source, whole, short, wave_number
    )
    return running, where, maximum, rest


@by_loops(_summed_by_loops, "sums")
def _summed(echoes: SubEchoes, whole: Ints, short: Bools, wave_number: float) -> _Summed:
    """Running sums over all sub-echoes: signal where each pulse begins, amplitudes, and the two parts of C.

    Of the short clusters: beam, source, first sub-echo, size; place and height of the maximum, begin. The others'
    sub-echoes.
    """
    (group, start, size), r, a = whole, echoes.range_m, echoes.amplitude
    total = _running(a, start, size)
    real, imaginary, begun = _sums(r, a, total, start, size, wave_number)
    last, first = (start + size - 1)[short], r[start[short]]
    centre = first + np.arctan2(imaginary[last], real[last]) / wave_number
    height = 0.5 * (total[last] + np.hypot(real[last], imaginary[last]))
    where = group[short], _strongest(echoes, start, size)[short], start[short], size[short]
    return (begun, total, real, imaginary), where, (centre, height, first), indexes((~short).repeat(size))


def _sums(
    r: Floats, a: Floats, total: Floats, start: Ints, size: Ints, wave_number: float
) -> tuple[Floats, Floats, Floats]:
    """Running sums over the sub-echoes of clusters: the two parts of C, and the signal where each pulse begins."""
    cosine, sine = cos_sin(wave_number * (r - r[start].repeat(size)))
    real, imaginary = _running(a * cosine, start, size), _running(a * sine, start, size)
    # a pulse begins half a turn of the cosine before its centre
    return real, imaginary, 0.5 * (total - cosine * real - sine * imaginary)


def _strongest(echoes: SubEchoes, start: Ints, size: Ints) -> Ints:
    """(c,) source of the strongest sub-echo of each cluster; the first of equals wins."""
    strongest = indexes(echoes.amplitude == np.maximum.reduceat(echoes.amplitude, start).repeat(size))[::-1]
    source = np.zeros(len(start), np.int64)
    source[np.arange(len(start)).repeat(size)[strongest]] = echoes.source[strongest]
    return source


def _near(
    soft: SoftProfile, threshold: float, short: Bools, beam: Ints, begin_m: Floats, swing: Floats, dark: Values
) -> tuple[Ints | None, Floats]:
    """The short clusters that begin where the medium shows, and its bound under each of them over the threshold.

    `swing` : (c,) bound of their |C|, 0 of those that may clip; `dark` : noise of their beams.

    A cluster is crossed in closed form where the medium is faint under it, or where it swings by much more, and by more
    than the noise: it is higher than |C|, and the medium falls from its maximum on, so that the valley before the
    cluster is not above what the medium has a sample before it begins. Then the cluster's maximum, and that of the
    medium by the same rule, stand apart from all others in samples too (`candidates`), whatever the medium is beside
    the threshold.

    A beam with such a cluster that is not short has none that is but behind all that are not: its medium is sampled,
    with all that blocks it. What is more than a pulse behind blocks nothing of what is sampled.
    """
    # its own echo stands alone up to its maximum, and a valley behind it
    behind_m = soft.peak_m + 2.0 * soft.bin_m
    alone_m, own = (behind_m, soft.peak) if soft.shows else (-np.inf, np.inf)
    near = indexes(begin_m < max(soft.until_m, alone_m))
    if not len(near):
        return None, begin_m
    begin, swing = begin_m[near], swing[near]
    # of samples the lowest may be one before it begins
    air, before = (soft.wave(np.maximum(begin - back, soft.peak_m)) for back in (0.0, soft.bin_m))
    apart = before + (dark if isinstance(dark, float) else dark[near])
    tall = (swing >= TALL * air) & (swing >= apart) & (own >= apart) & (begin >= behind_m)
    under = air / threshold
    kept = short[near] & ((under < FAINT) | tall) & (begin >= alone_m)
    short[near] = kept
    sampled = beam[near[~kept]]
    if len(sampled):
        other = np.zeros(int(beam[-1]) + 1, bool)
        other[sampled] = True
        last = np.zeros(len(other), np.int64)
        long = indexes(~short)
        last[beam[long]] = long
        short &= ~other[beam] | (np.arange(len(beam)) > last[beam])
        kept = short[near]
    which = near[kept]
    return (which if len(which) else None), under[kept]


def _under(
    centre: Floats, height: Floats, where: Sequence[Ints], number: Ints, echoes: SubEchoes, soft: SoftProfile,
    detector: Detector, start: Ints, size: Ints, share: Floats, total: Floats,
) -> _Air:  # fmt: skip
    """The medium under some short clusters, which adds to their `height`, where it is doubtful, where it may be over a
    level, and (c,) how far it shifts `centre`.

    `centre`, `height`, `where` (start and size) : of all; `total` : of all sub-echoes, see `Cosines`;
    `number` : of those with a medium among them; `start`, `size`, `share` : of these, the last its bound over the
    threshold.
    """
    most = share * detector.threshold
    strong = (most <= SLIGHT * height[number]) & (soft.until_m < np.inf)

    def computed(some: Ints, cluster: Ints) -> AirUnder:
        return _air(echoes, soft, start[some], size[some], cluster)

    weak, slight = indexes(~strong), indexes(strong)
    air = doubted = shift = None
    if len(weak):
        of = number[weak]
        air = computed(weak, of)
        last = where[0][of] + where[1][of] - 1
        shift = _lifted(centre, height, of, air, last, 2.0 * height[of] - total[last])
    if len(slight):
        doubted = AirDoubted(number[slight], most[slight], detector.resolution_m, slight, computed)
    every = np.arange(len(number))
    valley = AirDoubted(number, most, detector.resolution_m, every, computed)
    return air, doubted, valley, shift


def _lifted(centre: Floats, height: Floats, of: Ints, air: AirUnder, last: Ints, swing: Floats) -> Floats:
    """Maxima of pulses with a medium under them: it ends at the surfaces, so it falls there and shifts them.

    The medium is a parabola through three places, the cosine is one at its maximum: what is left out is a share
    (k shift)^2/12 of the lift. `swing` : |C| of each. Returns how far, of all clusters.
    """
    step = air.soft.bin_m
    before, here, behind = (air.at(centre[of] + side * step, last) for side in (-1.0, 0.0, 1.0))
    slope, curve = 0.5 * (behind - before) / step, (behind - 2.0 * here + before) / (step * step)
    bend = 0.5 * air.soft.pulse.wave_number**2 * swing - curve
    shift = np.where(bend > 0.0, slope / np.maximum(bend, 1e-300), 0.0)
    shift = np.where(np.abs(shift) <= step, shift, 0.0)
    centre[of] += shift
    height[of] += here + 0.5 * slope * shift
    every = np.zeros(len(centre))
    every[of] = np.abs(shift)
    return every


def _air(echoes: SubEchoes, soft: SoftProfile, first: Ints, count: Ints, cluster: Ints) -> AirUnder:
    """The medium under clusters of `count` sub-echoes from `first` on, under these numbers."""
    begins = count.cumsum() - count
    sums = _ended(echoes, soft, first, count, begins)
    open_ = np.ones(len(first))
    behind = indexes(echoes.beam[first - 1] == echoes.beam[first])  # in beams of which some is blocked before
    if len(behind):
        passed = np.concatenate(([0.0], echoes.blocked.cumsum()))
        head = echoes.beam.searchsorted(echoes.beam[first[behind]])
        open_[behind] = clamped(1.0 - (passed[first[behind]] - passed[head]), 0.0, 1.0)
    return AirUnder(soft, cluster, first - begins - 1, open_, begins, sums)


def _ended_by_loops(
    loops: ModuleType, echoes: SubEchoes, soft: SoftProfile, first: Ints, count: Ints, begins: Ints
) -> Floats:
    return np.asarray(loops.ended_under(*soft.flat, echoes.range_m, echoes.blocked, first, count))


@by_loops(_ended_by_loops, "ended_under")
def _ended(echoes: SubEchoes, soft: SoftProfile, first: Ints, count: Ints, begins: Ints) -> Floats:
    """`AirUnder.sums` of these clusters."""
    member = (first - begins).repeat(count) + np.arange(count.sum())
    sums = np.zeros((4, len(member) + 1))
    blocked = echoes.blocked.take(member)
    np.cumsum(blocked, out=sums[0, 1:])
    np.cumsum(soft.integrals(echoes.range_m.take(member)) * blocked, axis=1, out=sums[1:, 1:])
    return sums


def _running(values: Floats, start: Ints, size: Ints) -> Floats:
    """Running sums that begin again in every cluster."""
    sums = values.cumsum()
    return np.asarray(sums - (sums[start] - values[start]).repeat(size))
