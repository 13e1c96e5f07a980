"""Echoes of a receiver whose electronics are computed: shaped pulses, correlated noise, clipping with what follows.

Here: waveforms of the windows in which an echo can be, their noise, crossings, and the echoes in them. Not here: the
filter itself (response), the choice of the echoes that are reported (detection).

Windows are sampled at the receiver's step. A crossing is looked for between the samples with the exact sum of the
shaped pulses; noise and what a clipping takes away are straight lines there.
"""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import special

from emulator.physics.arrays import Bools, Floats, Ints, clamped, indexes, ramp
from emulator.physics.constants import SPEED_OF_LIGHT_M_S
from emulator.physics.detection import Found, report
from emulator.physics.detector import BASE_OF_ECHO, BASE_OF_THRESHOLD, Detector, Echoes
from emulator.physics.response import Response, ShapedPulse
from emulator.physics.softprofile import SoftProfile
from emulator.physics.subechoes import NO_SOURCE, SubEchoes, cluster, unfold_spread

SIGMAS = 6.0
"Windows whose light is so many noise rms below the threshold are left to the law of false alarms."
UNSEEN = 0.02
"Of the threshold: what a tail or an undershoot is followed down to."
MOST_SAMPLES = 2_000_000
"Held in memory together."
HALVINGS = 18
"Of a bracket of a few steps around a crossing: to micrometres."
BRIGHT, CALIBRATED = 1e5, 33
"Over the threshold, and how many: lone echoes by which other methods than the leading edge are calibrated."


@dataclass(frozen=True, eq=False)
class Windows:
    """Pieces of beams in which something can be seen."""

    beam: Ints
    "(w,)"
    low_m: Floats
    high_m: Floats
    first: Ints
    "(w,) of its sub-echoes"
    count: Ints

    def hold(self, beam: Ints, range_m: Floats) -> Bools:
        """Whether places in beams lie in one of them."""
        if not len(self.beam):
            return np.zeros(len(beam), np.bool_)
        length = float(max(self.high_m.max(), range_m.max(initial=0.0)) - min(self.low_m.min(), 0.0)) + 1.0
        at = (self.beam * length + self.low_m).searchsorted(beam * length + range_m, side="right") - 1
        inside = np.maximum(at, 0)
        return np.asarray((at >= 0) & (self.beam[inside] == beam) & (range_m <= self.high_m[inside]))


@dataclass(frozen=True, eq=False)
class _Block:
    """Windows of like length; all arrays but the last two (r, n), whose first and last columns are never an echo."""

    linear: Floats
    "The shaped pulses on the grid, nothing clipped."
    clean: Floats
    "Without noise, clipped."
    full: Floats
    "With noise; clipped only before the filter."
    shown: Floats
    "With noise, clipped."
    origin: Ints
    "(r,) number of the first column on the sensor's grid of ranges."
    window: Ints
    "(r,)"


class Shaped:
    """Finds the echoes of scans behind one sensor's electronics."""

    def __init__(self, detector: Detector, response: Response, key: int) -> None:
        self._detector = detector
        self.pulse = ShapedPulse(detector.pulse, response, min(detector.far_gate_m, 1e6))
        self._calibrating = False
        self._key = np.uint64(key & (2**64 - 1))
        self._bin_m = detector.bin_m
        self._taps = response.taps(2.0 * self._bin_m / SPEED_OF_LIGHT_M_S)

    def detect(
        self, echoes: SubEchoes, beams: int, detector: Detector, *, sweep: int, noisy: bool, noise: Floats | None,
        soft: SoftProfile | None, dazzled: Bools | None, noise_echoes: tuple[Ints, Floats, Floats] | None,
    ) -> Echoes:  # fmt: skip
        """Echoes that the receiver reports for every beam of a scan, as `detection.detect`.

        `noise_echoes` : false alarms of the whole gate; those within windows are made by the waveforms' own noise.
        """
        rms = np.ones(beams) if noise is None else noise
        with np.errstate(under="ignore"):
            points = self._points(echoes, beams, soft)
            windows = self._windows(points, rms, noisy)
            parts = [
                self._found(block, windows, points, rms) for block in self._blocks(windows, points, rms, sweep, noisy)
            ]
        if noise_echoes is not None and noise_echoes[0].size:
            beam, range_m, height = noise_echoes
            free = indexes(~windows.hold(beam, range_m))
            least = np.maximum(height[free], self._detector.threshold * rms[beam[free]])
            none = np.full(len(free), NO_SOURCE, np.int64)
            parts += [Found(beam[free], range_m[free], least, np.zeros(len(free), np.bool_), none)]
        return report(Found.joined(parts) if parts else Found.none(), beams, detector, dazzled)

    # ------------------------------------------------------------------ what is looked at
    def _points(self, echoes: SubEchoes, beams: int, soft: SoftProfile | None) -> SubEchoes:
        """All that sends light back as points, those that no receiver can distinguish as one."""
        if echoes.spread_m is not None:
            echoes = unfold_spread(echoes, echoes.spread_m > 0.05 * self._detector.resolution_m)
        if soft is not None:
            echoes = SubEchoes.joined(echoes, _medium(echoes, soft, beams))
        made = cluster(echoes, 2.0 * self._detector.pulse.half_support_m, self._detector.resolution_m)
        return SubEchoes(made.beam, made.range_m, made.amplitude, made.blocked, made.source)

    def _windows(self, points: SubEchoes, rms: Floats, noisy: bool) -> Windows:
        """Where a beam's light can be seen, its tails and undershoot included."""
        none = np.zeros(0, np.int64)
        if not len(points):
            return Windows(none, np.zeros(0), np.zeros(0), none, none)
        detector, beam = self._detector, points.beam
        level = detector.thresholds(rms)[beam]
        reach = self.pulse.reach_m(UNSEEN * level / np.maximum(points.amplitude, 1e-12))
        low = points.range_m - self.pulse.lead_m
        high = points.range_m + np.maximum(reach, 2.0 * detector.pulse.half_support_m)
        length = float(high.max() - low.min()) + 1.0
        latest = np.maximum.accumulate(beam * length + high)
        head = np.concatenate(([True], (beam * length + low)[1:] > latest[:-1]))
        first = indexes(head)
        count = np.diff(np.append(first, len(points)))
        end = np.maximum.reduceat(high, first)
        light = np.add.reduceat(points.amplitude, first) * max(1.0, self.pulse.peak)
        least = level[first] - (SIGMAS * rms[beam[first]] if noisy else 0.0)
        seen = indexes(light >= np.maximum(least, UNSEEN * level[first]))
        first, count = first[seen], count[seen]
        most = max(min(detector.far_gate_m, 1e6), 0.0) + 4.0 * detector.pulse.half_support_m
        start = low[first]
        return Windows(beam[first], start, np.maximum(np.minimum(end[seen], most), start), first, count)

    # ------------------------------------------------------------------ waveforms
    def _blocks(self, windows: Windows, points: SubEchoes, rms: Floats, sweep: int, noisy: bool) -> Iterator[_Block]:
        if not len(windows.beam):
            return
        columns = np.ceil((windows.high_m - windows.low_m) / self._bin_m).astype(np.int64) + 6
        size = np.ceil(2.0 * np.log2(columns)).astype(np.int64)
        for one in np.unique(size):
            rows = indexes(size == one)
            n = int(columns[rows].max())
            step = max(1, MOST_SAMPLES // n)
            for begin in range(0, len(rows), step):
                mine = rows[begin : begin + step]
                yield self._block(windows, mine, n, columns[mine], points, rms, sweep, noisy)

    def _block(
        self, windows: Windows, rows: Ints, n: int, columns: Ints, points: SubEchoes, rms: Floats, sweep: int,
        noisy: bool,
    ) -> _Block:  # fmt: skip
        detector, width = self._detector, self._bin_m
        origin = np.floor(windows.low_m[rows] / width).astype(np.int64) - 2
        row, at = _members(windows, rows)
        place = points.range_m[at] / width - origin[row]
        linear = _spread(row, place, points.amplitude[at], len(rows), n, self._kernel)
        clean = linear
        if self.pulse.response.clips == "before":
            current = _spread(row, place, points.amplitude[at], len(rows), n, self._bare)
            over = np.maximum(current - detector.full_scale, 0.0)
            clipped = indexes(over.max(axis=1) > 0.0)
            if len(clipped):
                clean = linear.copy()
                clean[clipped] -= self.pulse.whole(over[clipped], width)
        full, own = clean, rms[windows.beam[rows]][:, None]
        if noisy:
            shot = own**2 + detector.shot_factor * np.maximum(clean, 0.0)
            full = clean + self._noise(windows.beam[rows], origin, n, sweep) * np.sqrt(shot)
        beyond = (np.arange(n) >= columns[:, None] - 1) | (np.arange(n) == 0)
        full = np.where(beyond, -np.inf, full)
        limit = detector.full_scale
        return _Block(linear, np.minimum(clean, limit), full, np.minimum(full, limit), origin, rows)

    @cached_property
    def _kernel(self) -> tuple[int, Floats]:
        """The shaped pulse on the grid: how many steps before its centre it begins, and its samples."""
        early, late = (int(np.ceil(x / self._bin_m)) for x in (self.pulse.lead_m, self.pulse.trail_m))
        return early, self.pulse.at(self._bin_m * np.arange(-early, late + 1, dtype=np.float64))

    @cached_property
    def _bare(self) -> tuple[int, Floats]:
        """The same of the current that comes in."""
        reach = int(np.ceil(self._detector.pulse.half_support_m / self._bin_m))
        return reach, self._detector.pulse.profile(self._bin_m * np.arange(-reach, reach + 1, dtype=np.float64))

    def _noise(self, beam: Ints, origin: Ints, n: int, sweep: int) -> Floats:
        """Noise of rms 1 in columns of beams, the same whatever else is looked at; correlated as the filter says."""
        taps = len(self._taps)
        number = origin[:, None] + np.arange(-(taps - 1), n)
        white = _normals(self._key, sweep, beam[:, None], number)
        return _convolved(white, self._taps)[:, taps - 1 : taps - 1 + n]

    # ------------------------------------------------------------------ echoes
    def _found(self, block: _Block, windows: Windows, points: SubEchoes, rms: Floats) -> Found:
        detector, n = self._detector, block.shown.shape[1]
        beam = windows.beam[block.window]
        own, level = rms[beam], detector.thresholds(rms)[beam]
        shown = block.shown.ravel()
        start, end, risen = self._pieces(block, own, level)
        if not start.size:
            return Found.none()
        row = start // n
        count = end - start
        flat = start.repeat(count) + ramp(count)
        edge = count.cumsum() - count
        height = np.maximum.reduceat(block.full.ravel()[flat], edge)
        owner = np.arange(len(start)).repeat(count)
        tops = indexes(block.full.ravel()[flat] == height[owner])[::-1]
        top = start.copy()
        top[owner[tops]] = flat[tops]
        clipped = np.maximum.reduceat(np.maximum(block.linear.ravel(), block.full.ravel())[flat], edge)
        clipped = clipped >= detector.full_scale
        left, middle, right = (shown[np.clip(top + k, 0, len(shown) - 1)] for k in (-1, 0, 1))
        bend = left - 2.0 * middle + right
        good = np.isfinite(bend) & (bend < 0.0)
        shift = np.where(good, 0.5 * (left - right) / np.where(good, bend, -1.0), 0.0)
        shift = clamped(shift, -0.5, 0.5)
        column = top - row * n + shift
        height = height - 0.25 * np.where(good, left - right, 0.0) * shift
        flat_top = indexes(clipped & (height >= detector.full_scale))
        if flat_top.size:  # the middle of the run
            most = indexes((shown[flat] >= detector.full_scale) & clipped[owner])
            runs = np.bincount(owner[most], minlength=len(start))
            middle_of = np.bincount(owner[most], (flat[most] % n).astype(np.float64), len(start))
            column[flat_top] = (middle_of / np.maximum(runs, 1))[flat_top]
        peak_m = self._bin_m * (block.origin[row] + column)
        height = np.minimum(height, detector.full_scale)
        if detector.method == "leading_edge":
            range_m = self._edges(block, start, risen, height, peak_m, windows, points, level[row])
        else:
            if detector.method == "centroid":
                column = self._centroids(block, start, end, height, level[row])
            elif detector.method == "constant_fraction":
                column = self._fractions(block, start, end, column)
            range_m = self._bin_m * (block.origin[row] + column) - self._offset_m(height / level[row])
        range_m = np.maximum(range_m - detector.offset_m, 0.0)
        tall = height * np.maximum(range_m, 1e-3) ** 2 >= detector.floor_m2
        source = self._sources(windows, block.window[row], points, peak_m, own[row])
        amplitude = np.maximum(height, level[row])
        return Found(beam[row][tall], range_m[tall], amplitude[tall], clipped[tall], source[tall])

    def _pieces(self, block: _Block, rms: Floats, level: Floats) -> tuple[Ints, Ints, Bools]:
        """Runs over the threshold, each until it falls a noise rms under it, cut at valleys so deep of the clean light.

        First flat sample of each, the one behind its last, and whether it begins by rising through the threshold.
        """
        n = block.shown.shape[1]
        over = (block.shown >= level[:, None]).ravel()
        under = (block.shown < (level - rms)[:, None]).ravel()
        said = np.where(over | under, np.arange(over.size), 0)
        state = over[np.maximum.accumulate(said)]
        edge = np.diff(state.astype(np.int8), prepend=0)
        start, end = indexes(edge == 1), indexes(edge == -1)
        if not start.size:
            return start, end, np.zeros(0, np.bool_)
        clean = block.clean.ravel()
        inner = np.zeros(clean.size, np.bool_)
        inner[1:-1] = (clean[1:-1] > clean[:-2]) & (clean[1:-1] >= clean[2:]) & state[1:-1]
        top = indexes(inner)
        run = start.searchsorted(top, side="right") - 1
        while top.size > 1:
            valley = np.minimum.reduceat(clean, top)[:-1]
            lower = np.minimum(clean[top[1:]], clean[top[:-1]])
            apart = (lower - valley >= rms[top[1:] // n]) | (run[1:] != run[:-1])
            if bool(apart.all()):
                break
            second = clean[top[1:]] <= clean[top[:-1]]
            lost = np.zeros(top.size, np.bool_)
            lost[1:] |= ~apart & second
            lost[:-1] |= ~apart & ~second
            top, run = top[~lost], run[~lost]
        cut = np.zeros(0, np.int64)
        pairs = indexes(run[1:] == run[:-1]) if top.size > 1 else cut
        if pairs.size:
            cut = np.array([a + int(np.argmin(clean[a:b])) for a, b in zip(top[pairs], top[pairs + 1], strict=True)])
        every = np.concatenate([start, cut])
        order = np.argsort(every)
        risen = np.concatenate([np.ones(start.size, np.bool_), np.zeros(cut.size, np.bool_)])[order]
        first = every[order]
        last = end[start.searchsorted(first, side="right") - 1]
        follows = indexes(~risen[1:])
        last[follows] = first[follows + 1]
        return first, last, risen

    def _edges(
        self, block: _Block, start: Ints, risen: Bools, height: Floats, peak_m: Floats, windows: Windows,
        points: SubEchoes, level: Floats,
    ) -> Floats:  # fmt: skip
        """Ranges of leading edges; an echo that rises from a valley over the threshold has that of its maximum."""
        n, width = block.shown.shape[1], self._bin_m
        top_m = float(self.pulse.x_m[int(np.argmax(self.pulse.value))])
        lead = self.pulse.lead(height / level)
        crossing = peak_m - top_m - lead
        at = indexes(risen)
        row = start[at] // n
        owner, member = _members(windows, block.window[row])
        place, amplitude = points.range_m[member], points.amplitude[member]
        rest = (block.shown - block.linear).ravel()

        def over(column: Floats) -> Floats:
            """Signal less threshold at columns of the rows."""
            x = width * (block.origin[row] + column)
            light = np.bincount(owner, amplitude * self.pulse.at(x[owner] - place), len(row))
            low = np.floor(column).astype(np.int64)
            flat = row * n + np.clip(low, 1, n - 3)
            part = column - low
            more = (1.0 - part) * rest[flat] + part * rest[flat + 1]
            return light + np.where(np.isfinite(more), more, 0.0) - level[at]

        column = (start[at] - row * n).astype(np.float64)
        lo, hi, open_ = column - 1.0, column.copy(), np.ones(len(at), np.bool_)
        # the light on the grid is not exact to the last digit of a bright echo: its crossing may be a step off
        value = over(np.maximum(column - 3.0, 1.0))
        for k in (-2.0, -1.0, 0.0, 1.0):
            new = over(np.clip(column + k, 1.0, n - 2.0))
            rises = open_ & (value < 0.0) & (new >= 0.0)
            lo, hi, open_ = np.where(rises, column + k - 1.0, lo), np.where(rises, column + k, hi), open_ & ~rises
            value = new
        for _ in range(HALVINGS):
            mid = 0.5 * (lo + hi)
            up = over(mid) >= 0.0
            lo, hi = np.where(up, lo, mid), np.where(up, mid, hi)
        crossing[at] = width * (block.origin[row] + 0.5 * (lo + hi))
        return crossing + (lead if self._detector.walk_table else self._detector.pulse.start_lead_m)

    def _centroids(self, block: _Block, start: Ints, end: Ints, height: Floats, level: Floats) -> Floats:
        """First moments, weighted as `timing.centroids`, a pulse beyond the run on either side."""
        n, more = block.shown.shape[1], int(np.ceil(self._detector.pulse.fwhm_m / self._bin_m))
        row = start // n
        before = np.concatenate([[0], end[:-1]])
        begin = np.maximum(np.maximum(start - more, row * n + 1), np.where(before // n == row, before, 0))
        after = np.concatenate([start[1:], [n * block.shown.shape[0]]])
        stop = np.minimum(np.minimum(end + more, after), (row + 1) * n - 1)
        count = np.maximum(stop - begin, 1)
        flat, edge = begin.repeat(count) + ramp(count), count.cumsum() - count
        base = np.minimum(BASE_OF_THRESHOLD * level, BASE_OF_ECHO * height).repeat(count)
        value = block.shown.ravel()[flat]
        value = np.where(np.isfinite(value), value, 0.0)
        value = value * (value / np.maximum(np.hypot(value, base), 1e-300)) ** 4
        total = np.add.reduceat(value, edge)
        moment = np.add.reduceat(value * ramp(count), edge)
        return np.asarray(begin - row * n + np.where(total > 0.0, moment / np.where(total > 0.0, total, 1.0), 0.0))

    def _fractions(self, block: _Block, start: Ints, end: Ints, otherwise: Floats) -> Floats:
        """Columns at which the delayed signal overtakes the attenuated one after the threshold is reached."""
        n, detector = block.shown.shape[1], self._detector
        delay = 0.5 * SPEED_OF_LIGHT_M_S * detector.cfd_delay_s / self._bin_m
        whole = int(np.floor(delay))
        shown = np.where(np.isfinite(block.shown), block.shown, 0.0)
        late = np.zeros_like(shown)
        late[:, whole + 1 :] = (1.0 - (delay - whole)) * shown[:, 1 : n - whole] + (delay - whole) * shown[
            :, : n - whole - 1
        ]
        y = (detector.fraction * shown - late).ravel()
        falls = np.zeros(y.size, np.bool_)
        falls[:-1] = (y[:-1] > 0.0) & (y[1:] <= 0.0)
        at = indexes(falls)
        column = otherwise.copy()
        if not at.size:
            return column
        found = np.minimum(at.searchsorted(start), at.size - 1)
        hit = at[found]
        good = (hit >= start) & (hit < end + whole + 1) & (hit // n == start // n)
        drop = np.where(y[hit] > y[np.minimum(hit + 1, y.size - 1)], y[hit] - y[np.minimum(hit + 1, y.size - 1)], 1.0)
        return np.where(good, hit % n + y[hit] / drop, column)

    def _offset_m(self, height_over_threshold: Floats) -> Floats:
        """By how much the method finds a lone echo behind its place, without noise: as a device is calibrated."""
        if self._calibrating:
            return np.zeros(len(height_over_threshold))
        height, offset = self._calibration
        return np.interp(np.log(np.maximum(height_over_threshold, 1.0)), height, offset)

    @cached_property
    def _calibration(self) -> tuple[Floats, Floats]:
        """Logarithms of heights over the threshold, and offsets there."""
        detector, n = self._detector, CALIBRATED
        place = self.pulse.lead_m + 10.0 * self._bin_m
        most = min(detector.full_scale, BRIGHT * detector.threshold) / self.pulse.peak
        bright = np.geomspace(1.02 * detector.threshold / self.pulse.peak, 0.999 * most, n)
        points = SubEchoes.of(np.arange(n), np.full(n, place), bright)
        calm, rms = copy(self), np.ones(n)
        calm._detector, calm._calibrating = replace(detector, floor_m2=0.0, offset_m=0.0), True
        windows = calm._windows(points, rms, False)
        parts = [calm._found(block, windows, points, rms) for block in calm._blocks(windows, points, rms, 0, False)]
        found = Found.joined(parts)
        order = np.lexsort((-found.amplitude, found.beam))
        beam, first = np.unique(found.beam[order], return_index=True)
        tall = np.log(np.maximum(bright[beam] * self.pulse.peak / detector.threshold, 1.0))
        return tall, found.range_m[order][first] - place

    def _sources(self, windows: Windows, window: Ints, points: SubEchoes, place_m: Floats, rms: Floats) -> Ints:
        """What most of the light at these places comes from; -1 where that is less than the noise."""
        if not len(window):
            return np.zeros(0, np.int64)
        top_m = float(self.pulse.x_m[int(np.argmax(self.pulse.value))])
        owner, member = _members(windows, window)
        near = np.maximum(self._detector.pulse.profile(place_m[owner] - top_m - points.range_m[member]), 0.0)
        pull = points.amplitude[member] * near
        best = np.zeros(len(window))
        np.maximum.at(best, owner, pull)
        strongest = indexes((pull == best[owner]) & (best >= rms)[owner])[::-1]
        source = np.full(len(window), NO_SOURCE, np.int64)
        source[owner[strongest]] = points.source[member[strongest]]
        return source


def _medium(echoes: SubEchoes, soft: SoftProfile, beams: int) -> SubEchoes:
    """The medium as points in all beams, behind what stops the light."""
    node, piece = soft.nodes()
    first = echoes.beam.searchsorted(np.arange(beams))
    passed = np.concatenate([[0.0], echoes.blocked.cumsum()])
    length = float(max(soft.end_m, echoes.range_m.max(initial=0.0))) + 1.0
    key = echoes.beam * length + echoes.range_m
    at = key.searchsorted((np.arange(beams) * length)[:, None] + node, side="left")
    clear = clamped(1.0 - (passed[at] - passed[first][:, None]), 0.0, 1.0)
    return SubEchoes.of(np.arange(beams).repeat(node.size), np.tile(node, beams), (clear * piece).ravel())


def _members(windows: Windows, rows: Ints) -> tuple[Ints, Ints]:
    """Sub-echoes of windows: number of the row, and index."""
    count = windows.count[rows]
    return np.arange(len(rows)).repeat(count), windows.first[rows].repeat(count) + ramp(count)


def _spread(row: Ints, place: Floats, amplitude: Floats, rows: int, n: int, kernel: tuple[int, Floats]) -> Floats:
    """Sums of pulses at places between the samples: shares of four neighbours (Lagrange), under the kernel."""
    early, pulse = kernel
    low = np.floor(place).astype(np.int64)
    u = place - low
    grid = np.zeros(rows * (n + 3))
    shares = (
        -u * (u - 1.0) * (u - 2.0) / 6.0, (u * u - 1.0) * (u - 2.0) / 2.0,
        -u * (u + 1.0) * (u - 2.0) / 2.0, u * (u * u - 1.0) / 6.0,
    )  # fmt: skip
    for k, share in enumerate(shares):
        inside = (low >= 0) & (low < n)
        at = (row * (n + 3) + low + k)[inside]
        grid += np.bincount(at, (share * amplitude)[inside], len(grid))
    # column k of the grid stands for place k - 1
    made = _convolved(grid.reshape(rows, n + 3), pulse[: n + early + 4])
    padded = np.pad(made, ((0, 0), (0, max(0, early + 1 + n - made.shape[1]))))
    return padded[:, early + 1 : early + 1 + n]


def _convolved(rows: Floats, kernel: Floats) -> Floats:
    """Full convolution along rows."""
    from scipy.signal import fftconvolve  # takes long to import, and few receivers are shaped

    return np.asarray(fftconvolve(rows, kernel[None, :], axes=1), np.float64)


def _normals(key: np.uint64, sweep: int, beam: Ints, number: Ints) -> Floats:
    """Standard normal numbers of places on the grid of beams: one of each, in whatever order (SplitMix64, twice)."""
    with np.errstate(over="ignore"):
        own = _mixed(beam.astype(np.uint64) ^ _mixed(np.array(key ^ _mixed(np.array(sweep % 2**64, np.uint64)))))
        word = _mixed(own ^ number.astype(np.uint64))
    return np.asarray(special.ndtri(((word >> np.uint64(11)).astype(np.float64) + 0.5) * 2.0**-53), np.float64)


def _mixed(word: np.ndarray[tuple[int, ...], np.dtype[np.uint64]]) -> np.ndarray[tuple[int, ...], np.dtype[np.uint64]]:
    z = word + np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))
