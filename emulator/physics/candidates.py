"""Candidates for echoes: single clusters in closed form, and the maxima of the sampled waveform.

Here: where maxima are, how high, which of them a valley separates, and where the rise of each begins. Not here: the
range that a method reads off them (timing) and whether they are seen (detection).
"""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType

import numpy as np

from emulator.compiled.pair import OTHERWISE, by_loops
from emulator.physics.arrays import Bools, Floats, Ints, clamped, indexes, ramp
from emulator.physics.detector import Detector
from emulator.physics.subechoes import Clusters
from emulator.physics.waveform import Waveform

FAINT = 1e-3
"Share of a maximum that a medium may have for it to be that of a cosine."
CLOSER = (0.25, 0.0625)
"Of a bin: steps of the parabolas that find a maximum in a medium."


@dataclass(frozen=True, eq=False)
class Candidates:
    """Possible echoes of a scan, flat arrays."""

    beam: Ints
    centre_m: Floats
    "Place of the maximum, apparent range from the centre of the pulse."
    amplitude: Floats
    "Height before clipping."
    index: Ints
    "Cluster (single) or flat sample of the maximum (mixed)."
    window: Ints
    "Mixed: window; single: -1."
    begin: Ints
    "Mixed: sample from which the rise of this echo is looked for."

    def of_beams(self, wanted: Bools) -> Candidates:
        """Those in the beams (n,) that are wanted."""
        left = wanted[self.beam]
        return Candidates(*(column[left] for column in vars(self).values()))


def single_candidates(clusters: Clusters, chosen: Bools, least: Floats) -> Candidates:
    at = indexes(chosen)
    sub = clusters.first[at]
    beam = clusters.beam[sub]
    seen = clusters.amplitude[sub] >= least[beam]
    at, sub, beam = at[seen], sub[seen], beam[seen]
    minus = np.full(at.size, -1, np.int64)
    return Candidates(beam, clusters.range_m[sub], clusters.amplitude[sub], sub, minus, minus)


def _wave_candidates_by_loops(
    loops: ModuleType, wave: Waveform, least: Floats, rms: Floats, threshold: Floats, detector: Detector
) -> Candidates:
    if wave.pulse.shape != "sin2" or wave.value.size == 0:
        return OTHERWISE
    peak, window, centre, height, begin = loops.maxima(
        *wave.flat, wave.beam, least, rms, threshold, detector.full_scale, FAINT
    )
    value = np.minimum(wave.value, detector.full_scale)
    _in_medium(wave, peak, window, centre, height)
    _clip(wave, value, peak, window, detector.full_scale, centre, height)
    return Candidates(wave.beam[window], centre, height, peak, window, begin)


@by_loops(_wave_candidates_by_loops, "maxima")
def wave_candidates(wave: Waveform, least: Floats, rms: Floats, threshold: Floats, detector: Detector) -> Candidates:
    """Maxima of the clipped waveform, joined where no valley separates them.

    `least`, `rms`, `threshold` : (n,) of each beam: what is worth a look, its noise, and the level to be reached.
    """
    n = wave.value.size
    none = np.zeros(0, np.int64)
    if n == 0:
        return Candidates(none, np.zeros(0), np.zeros(0), none, none, none)
    value = np.minimum(wave.value, detector.full_scale)
    top = np.zeros(n, np.bool_)
    top[1:-1] = (value[1:-1] > value[:-2]) & (value[1:-1] >= value[2:])
    top[wave.start] = False
    top[wave.start + wave.count - 1] = False
    peak = indexes(top)
    window = wave.start.searchsorted(peak, side="right") - 1
    beam = wave.beam[window]
    seen = value[peak] >= 0.99 * least[beam]
    peak, window, beam = peak[seen], window[seen], beam[seen]
    while peak.size > 1:
        valley = np.minimum.reduceat(value, peak)[:-1]  # between a maximum and the next
        lower = np.minimum(value[peak[1:]], value[peak[:-1]])
        level = threshold[beam[1:]]
        apart = (lower - valley >= rms[beam[1:]]) | ((lower >= level) & (valley < level))
        apart |= beam[1:] != beam[:-1]
        if bool(apart.all()):
            break
        second = value[peak[1:]] <= value[peak[:-1]]
        lost = np.zeros(peak.size, np.bool_)
        lost[1:] |= ~apart & second
        lost[:-1] |= ~apart & ~second
        peak, window, beam = peak[~lost], window[~lost], beam[~lost]
    if peak.size == 0:
        return Candidates(none, np.zeros(0), np.zeros(0), none, none, none)
    centre, height = _parabola(wave, value, peak, window, detector)
    begin = wave.start[window]
    inside = indexes(window[1:] == window[:-1])
    if inside.size:  # from the lowest sample since the last maximum of the window on
        count = peak[inside + 1] - peak[inside]
        flat = peak[inside].repeat(count) + ramp(count)
        edge = count.cumsum() - count
        lowest = np.minimum.reduceat(value[flat], edge)
        at = indexes(value[flat] == lowest.repeat(count))
        owner = np.arange(inside.size).repeat(count)[at]
        place = np.zeros(inside.size, np.int64)
        place[owner] = flat[at]  # the last of equals
        begin[inside + 1] = place
    return Candidates(beam, centre, height, peak, window, begin)


def _parabola(wave: Waveform, value: Floats, peak: Ints, window: Ints, detector: Detector) -> tuple[Floats, Floats]:
    """Place and height of maxima by a parabola through three samples; of a clipped one the middle of its run."""
    left, mid, right = wave.value[peak - 1], wave.value[peak], wave.value[peak + 1]
    if detector.pulse.shape == "gauss":
        tiny = 1e-9 * mid
        left, mid, right = (np.log(np.maximum(v, tiny)) for v in (left, mid, right))
    curve = left - 2.0 * mid + right
    shift = np.where(curve < 0.0, 0.5 * (left - right) / np.where(curve < 0.0, curve, -1.0), 0.0)
    shift = clamped(shift, -0.5, 0.5)
    height = mid - 0.25 * (left - right) * shift
    if detector.pulse.shape == "gauss":
        height = np.exp(height)
    centre = wave.position(peak, window) + shift * wave.bin_m
    if detector.pulse.shape == "sin2":
        _exact(wave, peak, window, centre, height)
        _in_medium(wave, peak, window, centre, height)
    _clip(wave, value, peak, window, detector.full_scale, centre, height)
    return centre, height


def _clip(
    wave: Waveform, value: Floats, peak: Ints, window: Ints, limit: float, centre: Floats, height: Floats
) -> None:
    """Maxima that are clipped at a limit lie in the middle of their run."""
    clipped = value[peak] >= limit
    if not bool(clipped.any()):
        return
    below = indexes(value < limit)
    last = (wave.start + wave.count - 1)[window[clipped]]  # a medium can clip beyond the window
    after = np.append(below, value.size)[below.searchsorted(peak[clipped], side="right")]
    after = np.minimum(after, last)
    before = peak[clipped] - 1
    v = wave.value
    up = before + (limit - v[before]) / np.maximum(v[before + 1] - v[before], 1e-300)
    down = after - np.maximum(limit - v[after], 0.0) / np.maximum(v[after - 1] - v[after], 1e-300)
    start, first = wave.start[window[clipped]], wave.first_bin[window[clipped]]
    centre[clipped] = wave.bin_m * (0.5 * (up + down) - start + first)
    height[clipped] = np.maximum(height[clipped], limit)


def _in_medium_by_loops(
    loops: ModuleType, wave: Waveform, peak: Ints, window: Ints, centre: Floats, height: Floats
) -> None:
    if wave.medium is None or not len(peak):
        return
    loops.lifted(*wave.flat, *wave.air, peak, window, centre, height, FAINT, np.array(CLOSER))


@by_loops(_in_medium_by_loops, "lifted")
def _in_medium(wave: Waveform, peak: Ints, window: Ints, centre: Floats, height: Floats) -> None:
    """Maxima to which a medium adds more than a little: parabolas through values ever closer together."""
    if wave.medium is None:
        return
    at = indexes(wave.soft[peak] > FAINT * height)
    if not len(at):
        return
    window, x = window[at], centre[at]
    lowest = wave.position(peak[at], window) - wave.bin_m
    for part in CLOSER:
        step = part * wave.bin_m
        left, mid, right = (wave.exact_at(x + side * step, window) for side in (-1.0, 0.0, 1.0))
        curve = left - 2.0 * mid + right
        shift = np.where(curve < 0.0, 0.5 * (left - right) / np.where(curve < 0.0, curve, -1.0), 0.0)
        x = clamped(x + clamped(shift, -1.0, 1.0) * step, lowest, lowest + 2.0 * wave.bin_m)
    # two samples that are higher than what was found have a kink between them
    now, kept = wave.exact_at(x, window), wave.value[peak[at]]
    good = indexes(now >= kept)
    centre[at[good]], height[at[good]] = x[good], now[good]


def _exact(wave: Waveform, peak: Ints, window: Ints, centre: Floats, height: Floats) -> None:
    """Maxima of the one cosine that stands there, where no pulse begins or ends between it and the parabola's.

    Where a medium is more than a thousandth of it, its own bend shifts them: `_in_medium`.
    """
    at = indexes(wave.soft[peak] <= FAINT * height)
    if not len(at):
        return
    peak, window, parabola = peak[at], window[at], centre[at]
    begun, ended = wave.under_way(parabola, window)
    (even,), (real, imaginary) = wave.terms(begun, ended)
    swing, k = np.hypot(real, imaginary), wave.pulse.wave_number
    found = wave.bin_m * wave.first_bin[window] + np.arctan2(imaginary, real) / k
    found += 2.0 * np.pi / k * np.rint((parabola - found) * k / (2.0 * np.pi))
    slope, bend = 0.5 * (wave.soft[peak + 1] - wave.soft[peak - 1]) / wave.bin_m, swing * k * k
    bends = np.abs(slope) < bend * wave.bin_m
    shift = np.where(bends, slope, 0.0) / np.where(bends, bend, 1.0)
    found += shift  # a medium that falls shifts it towards the sensor
    same = (np.array(wave.under_way(found, window)) == np.array((begun, ended))).all(axis=0)
    good = indexes(same & bends & (np.abs(found - parabola) <= wave.bin_m))
    centre[at[good]] = found[good]
    height[at[good]] = (even + swing * np.cos(k * shift) + wave.soft_at(found, window))[good]
