"""The received waveform of a scan, sampled only where something can be: one flat array over all clusters.

Here: windows around clusters, exact sums of pulses in them, what a medium adds, exact values between the samples. Not
here: how sub-echoes fall into clusters (subechoes) and what counts as an echo (detection).

Sub-echoes keep their exact positions. A pulse is a short series of cosines (sin^2: a constant and one cosine), so
between the instants at which pulses start and end their sum is one too, and running sums give it at every sample,
however many sub-echoes there are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from types import ModuleType
from typing import Any

import numpy as np

from emulator.compiled.pair import OTHERWISE, by_loops
from emulator.physics.arrays import Bools, Floats, Ints, clamped, cos_sin, floats, indexes, ramp
from emulator.physics.pulse import Pulse
from emulator.physics.softprofile import NO_MEDIUM, SoftProfile
from emulator.physics.subechoes import Clusters


@dataclass(frozen=True, eq=False)
class Medium:
    """What scatters back in w windows with s sub-echoes."""

    soft: SoftProfile
    clear: Floats
    "(w,) share of the beam that nothing before the window blocks."
    sums: tuple[Floats, ...]
    "(s + 1,) running over the sub-echoes: shares that end at them, and these with the integrals up to there."

    @classmethod
    def of(cls, clusters: Clusters, chosen: Bools, soft: SoftProfile, clear_share: Floats) -> Medium:
        """That of the windows that `sample` makes of the same."""
        kept = indexes(chosen[clusters.cluster])
        blocked = clusters.blocked[kept]
        whole = soft.integrals(clusters.range_m[kept]) * blocked
        return cls(soft, clear_share[chosen], (_sums(blocked), *(_sums(one) for one in whole)))


@dataclass(frozen=True, eq=False)
class Waveform:
    """Samples of w windows in one flat array of s; apparent range counts from the centre of the pulse."""

    pulse: Pulse
    bin_m: float
    beam: Ints
    "(w,)"
    first_bin: Ints
    "(w,) number of the first sample on the global grid"
    start: Ints
    "(w,) index of the first sample in the flat array"
    count: Ints
    "(w,) samples of the window; the first and the last lie outside every pulse"
    value: Floats
    "(s,) noise units, surfaces and medium"
    soft: Floats
    "(s,) the medium's part"
    sub_first: Ints
    "(w,) index of the window's first sub-echo in the arrays below"
    sub_count: Ints
    "(w,)"
    sub_range: Floats
    sub_amplitude: Floats
    sub_source: Ints
    sums: tuple[Floats, ...]
    """Running sums over the sub-echoes, from 0 on: of their amplitudes, and for each further term of the pulse's series
    of the amplitudes times the cosine and the sine of their distance from the window's first sample."""
    hazy: bool = True
    "There is a medium in it."
    medium: Callable[[], Medium] | None = None
    "What it is, where a value between the samples is asked for."

    @property
    def flat(self) -> tuple[Any, ...]:
        """A sin^2 pulse's samples and sub-echoes as compiled loops want them."""
        return (
            self.bin_m, self.pulse.half_support_m, self.pulse.wave_number, self.hazy, self.first_bin, self.start,
            self.count, self.value, self.soft, self.sub_first, self.sub_count, self.sub_range, *self.sums,
        )  # fmt: skip

    @property
    def window(self) -> Ints:
        """(s,) window of each sample."""
        return np.arange(self.start.size).repeat(self.count)

    def position(self, index: Ints, window: Ints) -> Floats:
        """Apparent range of samples by flat index and window. [m]"""
        return self.bin_m * (self.first_bin[window] + (index - self.start[window])).astype(np.float64)

    def under_way(self, x_m: Floats, window: Ints) -> tuple[Ints, Ints]:
        """Of the sub-echoes of windows: how many pulses have begun by apparent ranges, and how many ended before."""
        key, length = self._keys
        half = self.pulse.half_support_m
        offset = x_m - self.bin_m * self.first_bin[window]
        begin, most = window * length, length - 4.0 * half
        begun = key.searchsorted(begin + clamped(offset + half, -2.0 * half, most), side="right")
        ended = key.searchsorted(begin + clamped(offset - half, -2.0 * half, most), side="left")
        return begun, ended

    def surfaces_at(self, x_m: Floats, window: Ints) -> Floats:
        """Exact value of the surfaces' part at any apparent range inside windows; same shape as x."""
        if not x_m.size:
            return np.zeros(0)
        turn = self.pulse.wave_number * (x_m - self.bin_m * self.first_bin[window])
        (constant,), *terms = self.terms(*self.under_way(x_m, window))
        value = constant
        for m, (real, imaginary) in enumerate(terms, 1):
            value += np.cos(m * turn) * real + np.sin(m * turn) * imaginary
        return np.maximum(value, 0.0)

    def terms(self, begun: Ints, ended: Ints) -> Iterator[tuple[Floats, ...]]:
        """The sum of the pulses under way as a series: the constant, then factors of cos mkx and sin mkx, m = 1, 2, ...

        x counts from the first sample of the window.
        """
        series = self.pulse.series
        yield (series[0] * _between(self.sums[0], begun, ended),)
        for m in range(1, series.size):
            yield tuple(series[m] * _between(sums, begun, ended) for sums in self.sums[2 * m - 1 : 2 * m + 1])

    @cached_property
    def _keys(self) -> tuple[Floats, float]:
        """One ascending number for each sub-echo: `length` times its window, and its distance from the first sample."""
        window = np.arange(self.sub_first.size).repeat(self.sub_count)
        offset = self.sub_range - (self.bin_m * self.first_bin)[window]
        length = float(offset.max(initial=0.0)) + 8.0 * self.pulse.half_support_m
        return np.asarray(window * length + offset, np.float64), length

    def soft_at(self, x_m: Floats, window: Ints) -> Floats:
        """The medium's part at any apparent range inside windows, linear between the samples."""
        last = self.count[window].astype(np.float64) - 1.000001
        offset = clamped(x_m / self.bin_m - self.first_bin[window], 0.0, last)
        whole = np.floor(offset).astype(np.int64)
        at = self.start[window] + whole
        part = offset - whole
        return floats((1.0 - part) * self.soft[at] + part * self.soft[at + 1])

    @cached_property
    def air(self) -> tuple[Any, ...]:
        """The medium of a sin^2 pulse's waveform as compiled loops want it: tables, shares of windows, running sums."""
        air = self._medium
        assert air is not None
        return *air.soft.flat, air.clear, np.array(air.sums)

    @cached_property
    def _medium(self) -> Medium | None:
        return None if self.medium is None else self.medium()

    def exact_at(self, x_m: Floats, window: Ints) -> Floats:
        """Value at any apparent range inside windows, the medium's part from its integrals and not from the samples."""
        air = self._medium
        if air is None:
            return self.at(x_m, window)
        begun, ended = self.under_way(x_m, window)
        soft, turn = air.soft, self.pulse.wave_number * x_m
        cosine, sine = np.cos(turn), np.sin(turn)
        far, near = (soft.integrals(x_m + side * self.pulse.half_support_m) for side in (1.0, -1.0))
        stopped, *ending = air.sums
        before = stopped.take(self.sub_first[window])
        open_far = np.maximum(air.clear[window] - (stopped.take(begun) - before), 0.0)
        open_near = np.maximum(air.clear[window] - (stopped.take(ended) - before), 0.0)
        a, real, imaginary = (
            open_far * one - open_near * other + _between(sums, begun, ended)
            for one, other, sums in zip(far, near, ending, strict=True)
        )
        part = np.maximum(0.5 * (a + cosine * real - sine * imaginary), 0.0)
        return floats(np.maximum(self.surfaces_at(x_m, window) + part, 0.0))

    def at(self, x_m: Floats, window: Ints) -> Floats:
        """Value at any apparent range inside windows."""
        if not self.hazy:
            return self.surfaces_at(x_m, window)
        return np.maximum(self.surfaces_at(x_m, window) + self.soft_at(x_m, window), 0.0)


def _sample_by_loops(
    loops: ModuleType,
    clusters: Clusters,
    chosen: Bools,
    pulse: Pulse,
    bin_m: float,
    soft: SoftProfile | None,
    clear_share: Floats,
) -> Waveform:
    if pulse.shape != "sin2":
        return OTHERWISE
    medium, end_m = (NO_MEDIUM, 0.0) if soft is None else (soft.flat, soft.end_m)
    whole, (value, part), (r, amplitude), source, sums = loops.sampled(
        *medium, soft is not None, end_m, pulse.half_support_m, bin_m, pulse.wave_number, chosen, clear_share,
        clusters.first, clusters.count, clusters.beam, clusters.range_m, clusters.amplitude, clusters.blocked,
        clusters.source,
    )  # fmt: skip
    beam, first_bin, start, count, sub_first, sub_count = whole
    return Waveform(
        pulse, bin_m, beam, first_bin, start, count, value, part, sub_first, sub_count, r, amplitude, source,
        tuple(sums), soft is not None, _medium_of(clusters, chosen, soft, clear_share),
    )  # fmt: skip


@by_loops(_sample_by_loops, "sampled")
def sample(
    clusters: Clusters, chosen: Bools, pulse: Pulse, bin_m: float, soft: SoftProfile | None, clear_share: Floats
) -> Waveform:
    """Waveform of the chosen clusters.

    Parameters
    ----------
    clusters : of the whole scan
    chosen : (c,) which of them are sampled
    soft : the medium, None for none; only with a sin^2 pulse, a Gaussian one takes its `nodes` as sub-echoes
    clear_share : (c,) share of the beam that nothing before the cluster blocks
    """
    half = pulse.half_support_m
    kept = chosen[clusters.cluster]
    r, amplitude, blocked = clusters.range_m[kept], clusters.amplitude[kept], clusters.blocked[kept]
    sub_count = clusters.count[chosen]
    sub_first = sub_count.cumsum() - sub_count
    low, high = r[sub_first], r[sub_first + sub_count - 1]
    first_bin = np.floor((low - half) / bin_m).astype(np.int64) - 1
    count = np.ceil((high + half) / bin_m).astype(np.int64) - first_bin + 2
    start = count.cumsum() - count
    k, terms = pulse.wave_number, pulse.series.size
    real, imaginary = cos_sin(k * (r - (bin_m * first_bin).repeat(sub_count)))
    sums, turned = [_sums(amplitude)], (amplitude * real, amplitude * imaginary)
    for m in range(1, terms):
        sums += [_sums(turned[0]), _sums(turned[1])]
        if m + 1 < terms:
            turned = _product(turned, (real, imaginary))
    grid = first_bin, start, count, sub_first, sub_count
    value, part = _samples(pulse, bin_m, soft, *grid, r, blocked, clear_share[chosen], sums)
    return Waveform(
        pulse,
        bin_m,
        clusters.beam[clusters.first[chosen]],
        first_bin,
        start,
        count,
        value,
        part,
        sub_first,
        sub_count,
        r,
        amplitude,
        clusters.source[kept],
        tuple(sums),
        soft is not None,
        _medium_of(clusters, chosen, soft, clear_share),
    )


def _medium_of(
    clusters: Clusters, chosen: Bools, soft: SoftProfile | None, clear_share: Floats
) -> Callable[[], Medium] | None:
    return None if soft is None else partial(Medium.of, clusters, chosen, soft, clear_share)


def _samples(
    pulse: Pulse, bin_m: float, soft: SoftProfile | None, first_bin: Ints, start: Ints, count: Ints, sub_first: Ints,
    sub_count: Ints, r: Floats, blocked: Floats, clear: Floats, sums: Sequence[Floats],
) -> tuple[Floats, Floats]:  # fmt: skip
    """All that stands at the samples, and the medium's part of it; `clear` : (w,), the rest as in `Waveform`."""
    half, k, series, total = pulse.half_support_m, pulse.wave_number, pulse.series, int(count.sum())
    window = np.arange(sub_count.size).repeat(sub_count)
    base = (start - first_bin)[window]
    on = base + np.ceil((r - half) / bin_m).astype(np.int64)
    off = base + np.floor((r + half) / bin_m).astype(np.int64) + 1
    local = ramp(count)
    # between two samples begins and ends what lies between these numbers of sub-echoes
    begun, ended = (np.bincount(edge, minlength=total).cumsum() for edge in (on, off))
    angle = k * bin_m * np.arange(int(count.max(initial=1)))
    cosine, sine = np.cos(angle).take(local), np.sin(angle).take(local)
    value = series[0] * _between(sums[0], begun, ended)
    for m in range(1, series.size):
        cos_m, sin_m = (cosine, sine) if m == 1 else (np.cos(m * angle).take(local), np.sin(m * angle).take(local))
        value += series[m] * cos_m * _between(sums[2 * m - 1], begun, ended)
        value += series[m] * sin_m * _between(sums[2 * m], begun, ended)
    np.maximum(value, 0.0, out=value)
    part = np.zeros(total)
    if soft is not None and pulse.shape == "sin2" and total:
        upper, lower = soft.tables(first_bin.repeat(count) + local)
        open_far = clear.repeat(count)
        open_near = open_far
        stops = (blocked > 0.0) & (r < soft.end_m + 2.0 * half)
        near = indexes(stops)
        if len(near):
            passed = np.concatenate(([0], stops.cumsum()))
            if len(near) < len(r):
                begun, ended = passed.take(begun), passed.take(ended)
            share, of = blocked.take(near), window.take(near)
            stopped = _sums(share)
            before = stopped.take(passed.take(sub_first)).repeat(count)
            open_far = open_far - (stopped.take(begun) - before)
            open_near = open_near - (stopped.take(ended) - before)
            a, *parts = soft.integrals(r.take(near)) * share
            turn = k * bin_m * first_bin
            b = _product(parts, (np.cos(turn).take(of), np.sin(turn).take(of)))
            part += _between(_sums(a), begun, ended)
            part += cosine * _between(_sums(b[0]), begun, ended)
            part -= sine * _between(_sums(b[1]), begun, ended)
        part += np.maximum(open_far, 0.0) * upper
        part -= np.maximum(open_near, 0.0) * lower
        part *= 0.5
        np.maximum(part, 0.0, out=part)
        value += part
    return value, part


def _sums(weight: Floats) -> Floats:
    """Running sums from 0 on, one more than there are weights."""
    sums = np.zeros(len(weight) + 1)
    np.cumsum(weight, out=sums[1:])
    return sums


def _between(sums: Floats, begun: Ints, ended: Ints) -> Floats:
    """Sum of what has begun and not yet ended; exactly 0 where that is nothing."""
    return sums.take(begun) - sums.take(ended)


def _product(one: Sequence[Floats], other: Sequence[Floats]) -> tuple[Floats, Floats]:
    """Of complex numbers as real and imaginary parts."""
    return one[0] * other[0] - one[1] * other[1], one[0] * other[1] + one[1] * other[0]
