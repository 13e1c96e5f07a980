"""The received waveform of a scan, sampled only where something can be: one flat array over all clusters.

Here: windows around clusters, exact sums of pulses in them, what a medium adds, exact values between the samples. Not
here: how sub-echoes fall into clusters (subechoes) and what counts as an echo (detection).

Sub-echoes keep their exact positions. A pulse is a short series of cosines (sin^2: a constant and one cosine), so
between the instants at which pulses start and end their sum is one too, and running sums give it at every sample,
however many sub-echoes there are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from emulator.physics.arrays import Bools, Complexes, Floats, Ints, clamped, cos_sin, floats, indexes, ramp
from emulator.physics.pulse import Pulse
from emulator.physics.softprofile import SoftProfile
from emulator.physics.subechoes import Clusters


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
    hazy: bool = True
    "There is a medium in it."

    @property
    def window(self) -> Ints:
        """(s,) window of each sample."""
        return np.arange(self.start.size).repeat(self.count)

    def position(self, index: Ints, window: Ints) -> Floats:
        """Apparent range of samples by flat index and window. [m]"""
        return self.bin_m * (self.first_bin[window] + (index - self.start[window])).astype(np.float64)

    def surfaces_at(self, x_m: Floats, window: Ints) -> Floats:
        """Exact value of the surfaces' part at any apparent range inside windows; same shape as x."""
        return self._sums.at(x_m, window) if x_m.size else np.zeros(0)

    def soft_at(self, x_m: Floats, window: Ints) -> Floats:
        """The medium's part at any apparent range inside windows, linear between the samples."""
        last = self.count[window].astype(np.float64) - 1.000001
        offset = clamped(x_m / self.bin_m - self.first_bin[window], 0.0, last)
        whole = np.floor(offset).astype(np.int64)
        at = self.start[window] + whole
        part = offset - whole
        return floats((1.0 - part) * self.soft[at] + part * self.soft[at + 1])

    def at(self, x_m: Floats, window: Ints) -> Floats:
        """Value at any apparent range inside windows."""
        if not self.hazy:
            return self.surfaces_at(x_m, window)
        return np.maximum(self.surfaces_at(x_m, window) + self.soft_at(x_m, window), 0.0)

    @cached_property
    def _sums(self) -> _RunningSums:
        return _RunningSums.of(self)


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
    window = np.arange(sub_count.size).repeat(sub_count)
    low, high = r[sub_first], r[sub_first + sub_count - 1]
    first_bin = np.floor((low - half) / bin_m).astype(np.int64) - 1
    count = np.ceil((high + half) / bin_m).astype(np.int64) - first_bin + 2
    start = count.cumsum() - count
    total = int(count.sum())
    base = (start - first_bin)[window]
    on = base + np.ceil((r - half) / bin_m).astype(np.int64)
    off = base + np.floor((r + half) / bin_m).astype(np.int64) + 1
    local = ramp(count)
    k, series = pulse.wave_number, pulse.series
    # between two samples begins and ends what lies between these numbers of sub-echoes
    begun, ended = (np.bincount(edge, minlength=total).cumsum() for edge in (on, off))
    origin = bin_m * first_bin
    real, imaginary = cos_sin(k * (r - origin.repeat(sub_count)))
    angle = k * bin_m * np.arange(int(count.max(initial=1)))
    cosine, sine = np.cos(angle).take(local), np.sin(angle).take(local)
    value = series[0] * _between(_sums(amplitude), begun, ended)
    turned = amplitude * real, amplitude * imaginary
    for m in range(1, series.size):
        cos_m, sin_m = (cosine, sine) if m == 1 else (np.cos(m * angle).take(local), np.sin(m * angle).take(local))
        value += series[m] * cos_m * _between(_sums(turned[0]), begun, ended)
        value += series[m] * sin_m * _between(_sums(turned[1]), begun, ended)
        if m + 1 < series.size:
            turned = _product(turned, (real, imaginary))
    np.maximum(value, 0.0, out=value)
    part = np.zeros(total)
    if soft is not None and pulse.shape == "sin2" and total:
        upper, lower = soft.tables(first_bin.repeat(count) + local)
        open_far = clear_share[chosen].repeat(count)
        open_near = open_far
        stops = (blocked > 0.0) & (r < soft.end_m + 2.0 * half)
        near = indexes(stops)
        if len(near):
            passed = np.concatenate(([0], stops.cumsum()))
            if len(near) < len(r):
                begun, ended = passed.take(begun), passed.take(ended)
            share, of = blocked.take(near), window.take(near)
            sums = _sums(share)
            before = sums.take(passed.take(sub_first)).repeat(count)
            open_far = open_far - (sums.take(begun) - before)
            open_near = open_near - (sums.take(ended) - before)
            a, *b = soft.integrals(r.take(near)) * share
            b = _product(b, (np.cos(k * origin).take(of), np.sin(k * origin).take(of)))
            part += _between(_sums(a), begun, ended)
            part += cosine * _between(_sums(b[0]), begun, ended)
            part -= sine * _between(_sums(b[1]), begun, ended)
        part += np.maximum(open_far, 0.0) * upper
        part -= np.maximum(open_near, 0.0) * lower
        part *= 0.5
        np.maximum(part, 0.0, out=part)
        value += part
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
        soft is not None,
    )


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


@dataclass(frozen=True, eq=False)
class _RunningSums:
    """Running sums over the sub-echoes of a waveform, one for each term of the pulse's series."""

    origin: Floats
    key: Floats
    length: float
    sums: tuple[Complexes, ...]
    half: float
    k: float

    @classmethod
    def of(cls, wave: Waveform) -> _RunningSums:
        window = np.arange(wave.sub_first.size).repeat(wave.sub_count)
        origin = wave.sub_range[wave.sub_first]
        offset = wave.sub_range - origin[window]
        half, k = wave.pulse.half_support_m, wave.pulse.wave_number
        length = float(offset.max(initial=0.0)) + 8.0 * half
        turn = np.exp(-1j * k * offset)
        weight = wave.sub_amplitude.astype(np.complex128)
        sums = []
        for term in wave.pulse.series:
            sums.append(np.concatenate([np.zeros(1, np.complex128), (term * weight).cumsum()]))
            weight = weight * turn
        return cls(origin, window * length + offset, length, tuple(sums), half, k)

    def at(self, x_m: Floats, window: Ints) -> Floats:
        offset = x_m - self.origin[window]
        low = window * self.length + clamped(offset - self.half, -2.0 * self.half, self.length - 4.0 * self.half)
        high = window * self.length + clamped(offset + self.half, -2.0 * self.half, self.length - 4.0 * self.half)
        lo, hi = self.key.searchsorted(low, side="left"), self.key.searchsorted(high, side="right")
        turn = np.exp(1j * self.k * offset)
        value = np.zeros(offset.shape, np.complex128)
        for total in reversed(self.sums):
            value = value * turn + (total[hi] - total[lo])
        return np.maximum(value.real, 0.0)
