"""Sampled waveforms with a medium under them, between the samples: maxima, valleys and crossings.

Belongs here: what `candidates._in_medium` and `timing._bent` do with arrays for sin^2 pulses. Not: what is found by the
samples alone (maxima), samples (waves).
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import math

import numpy as np

from emulator.compiled.arithmetic import cos_sin
from emulator.compiled.jit import FLOAT, FLOATS, INT, INTS, OUT_FLOATS, ROWS, compiled, inlined
from emulator.compiled.maxima import WAVE, terms, under_way
from emulator.compiled.media import MEDIUM, cell_of, cubic

UNDER = (*MEDIUM, FLOATS, ROWS)
"A medium, the share of the beam before each window, and running sums: see `Waveform.air`."


@inlined
def _under_pulse(x, clear, begun, ended, head, half_m, wave_number, knots, cubics, cells, cell, sums):
    """What the medium has at a place of a window, see `Waveform.exact_at`."""
    far, far_t = cell_of(x + half_m, knots, cells, cell)
    near, near_t = cell_of(x - half_m, knots, cells, cell)
    open_far = max(clear - (sums[0, begun] - sums[0, head]), 0.0)
    open_near = max(clear - (sums[0, ended] - sums[0, head]), 0.0)
    a = open_far * cubic(0, far, far_t, cubics) - open_near * cubic(0, near, near_t, cubics)
    real = open_far * cubic(1, far, far_t, cubics) - open_near * cubic(1, near, near_t, cubics)
    imaginary = open_far * cubic(2, far, far_t, cubics) - open_near * cubic(2, near, near_t, cubics)
    a += sums[1, begun] - sums[1, ended]
    real += sums[2, begun] - sums[2, ended]
    imaginary += sums[3, begun] - sums[3, ended]
    cosine, sine = cos_sin(wave_number * x)
    return max(0.5 * (a + cosine * real - sine * imaginary), 0.0)


@inlined
def exact(x, w, wave, medium, clear, sums):
    """Value at a place of a window, see `Waveform.exact_at`."""
    bin_m, half_m, wave_number, first_bin, sub_first, sub_count, sub_range, a, real, imaginary = wave
    knots, cubics, cells, cell = medium
    begun, ended = under_way(x, w, bin_m, half_m, first_bin, sub_first, sub_count, sub_range)
    even, p, q = terms(begun, ended, a, real, imaginary)
    cosine, sine = cos_sin(wave_number * (x - bin_m * first_bin[w]))
    surfaces = max(even + cosine * p + sine * q, 0.0)
    soft = _under_pulse(
        x, clear[w], begun, ended, sub_first[w], half_m, wave_number, knots, cubics, cells, cell, sums
    )  # fmt: skip
    return surfaces + soft


@compiled(*WAVE, *UNDER, INTS, INTS, OUT_FLOATS, OUT_FLOATS, FLOAT, FLOATS)
def lifted(
    bin_m, half_m, wave_number, hazy, first_bin, start, count, value, soft, sub_first, sub_count, sub_range,
    a, real, imaginary, edged, first, medium_bin, medium_number, ends, knots, cubics, cells, cell, clear, sums,
    peak, window, centre, height, faint, closer,
):  # fmt: skip
    """`candidates._in_medium`: writes place and height of maxima to which a medium adds more than a little."""
    wave = (bin_m, half_m, wave_number, first_bin, sub_first, sub_count, sub_range, a, real, imaginary)
    medium = (knots, cubics, cells, cell)
    for k in range(len(peak)):
        p, w = peak[k], window[k]
        if not soft[p] > faint * height[k]:
            continue
        x = centre[k]
        lowest = bin_m * (first_bin[w] + (p - start[w])) - bin_m
        for part in closer:
            step = part * bin_m
            left = exact(x - step, w, wave, medium, clear, sums)
            middle = exact(x, w, wave, medium, clear, sums)
            right = exact(x + step, w, wave, medium, clear, sums)
            curve = left - 2.0 * middle + right
            shift = 0.5 * (left - right) / curve if curve < 0.0 else 0.0
            x = min(max(x + min(max(shift, -1.0), 1.0) * step, lowest), lowest + 2.0 * bin_m)
        now = exact(x, w, wave, medium, clear, sums)
        if now >= value[p]:
            centre[k], height[k] = x, now


@compiled()
def _zero(lo, hi, f_lo, f_hi, wanted, w, exact_m, wave, medium, clear, sums):
    """Where the root of the value first is `wanted`, see `timing._crossing`: from f_lo < 0 to f_hi > 0."""
    x, fa, fb, side, before = hi, f_lo, f_hi, 0, np.inf
    slope = (fb - fa) / (hi - lo)
    for step in range(60):
        width = hi - lo
        middle = min(max(lo - fa * width / (fb - fa), lo), hi)
        if step % 3 == 2:
            if width > 0.5 * before:
                middle = 0.5 * (lo + hi)
            before = width
        f = math.sqrt(exact(middle, w, wave, medium, clear, sums)) - wanted
        x = middle
        up = f >= 0.0
        old = fb if up else fa
        less = 1.0 - f / old
        if not less > 0.0:
            less = 0.5
        moved = middle - (hi if up else lo)
        if moved != 0.0:
            slope = (f - old) / moved
        if up:
            fa = less * fa if side == 1 else fa
            fb, hi, side = f, middle, 1
        else:
            fb = less * fb if side == -1 else fb
            fa, lo, side = f, middle, -1
        if not (hi - lo > exact_m and abs(f) > 0.1 * exact_m * slope and fa < 0.0 and fb > 0.0):
            break
    return x


@compiled()
def _lowest(low, high, w, golden, steps, wave, medium, clear, sums):
    """Where a valley is lowest, by a golden section."""
    one, other = high - golden * (high - low), low + golden * (high - low)
    f_one, f_other = exact(one, w, wave, medium, clear, sums), exact(other, w, wave, medium, clear, sums)
    for _ in range(steps - 1):
        if f_one <= f_other:
            high, other, f_other = other, one, f_one
            one = high - golden * (high - low)
            f_one = exact(one, w, wave, medium, clear, sums)
        else:
            low, one, f_one = one, other, f_other
            other = low + golden * (high - low)
            f_other = exact(other, w, wave, medium, clear, sums)
    if f_one <= f_other:
        high = other
    else:
        low = one
    return 0.5 * (low + high)


@compiled(
    *WAVE, *UNDER, INTS, INTS, INTS, FLOATS, FLOATS, FLOATS, FLOATS, FLOAT, FLOAT, FLOAT, FLOAT, INT
)  # fmt: skip
def bent(
    bin_m, half_m, wave_number, hazy, first_bin, start, count, value, soft, sub_first, sub_count, sub_range,
    a, real, imaginary, edged, first, medium_bin, medium_number, ends, knots, cubics, cells, cell, clear, sums,
    index, window, begin, centre, amplitude, level, crossing, faint, straight_m, exact_m, golden, valley_steps,
):  # fmt: skip
    """`timing._bent`: crossings where the medium is not as straight between samples as they were found with."""
    wave = (bin_m, half_m, wave_number, first_bin, sub_first, sub_count, sub_range, a, real, imaginary)
    medium = (knots, cubics, cells, cell)
    new = crossing.copy()
    for k in range(len(level)):
        w, root, was = window[k], math.sqrt(level[k]), crossing[k]
        origin, end = bin_m * first_bin[w], centre[k]
        local = math.floor(was / bin_m) - first_bin[w]
        at = start[w] + min(max(local, 1), count[w] - 3)
        bend = max(abs(soft[at + 1] - 2.0 * soft[at] + soft[at - 1]), abs(soft[at + 2] - 2.0 * soft[at + 1] + soft[at]))
        rises = max(value[at + 1] - value[at], 0.0)
        top = was == end and soft[index[k]] > faint * amplitude[k] and level[k] < amplitude[k]
        some = 0 <= local < count[w] - 1 and (top or 0.125 * bend * bin_m > straight_m * rises)
        # an echo that rises from a valley whose samples are over its level, see `timing._out_of_valleys`
        if value[begin[k]] >= level[k] and soft[begin[k]] > faint * level[k] and index[k] > begin[k]:
            deepest = begin[k]
            for j in range(begin[k] + 1, index[k] + 1):
                if value[j] < value[deepest]:
                    deepest = j
            middle = bin_m * (first_bin[w] + (deepest - start[w]))
            lowest = _lowest(
                max(middle - bin_m, origin), middle + bin_m, w, golden, valley_steps, wave, medium, clear, sums
            )  # fmt: skip
            f_lo = math.sqrt(exact(lowest, w, wave, medium, clear, sums)) - root
            f_hi = math.sqrt(exact(end, w, wave, medium, clear, sums)) - root
            if f_lo < 0.0 and f_hi > 0.0 and end > lowest:
                new[k] = _zero(lowest, end, f_lo, f_hi, root, w, exact_m, wave, medium, clear, sums)
            elif not f_lo < 0.0:
                above = min(max((f_lo + root) ** 2 - level[k], 0.0), 1.0)
                new[k] = lowest + above * (was - lowest)
        if not some:
            continue
        x = new[k]
        lo = bin_m * (first_bin[w] + max(local, 0))
        hi = lo + bin_m
        if x - lo < exact_m and local > 0:
            lo -= bin_m
        if end > lo:
            hi = min(hi, end)
        f_lo = math.sqrt(exact(lo, w, wave, medium, clear, sums)) - root
        f_hi = math.sqrt(exact(hi, w, wave, medium, clear, sums)) - root
        if f_lo < 0.0 and f_hi > 0.0:
            new[k] = _zero(lo, hi, f_lo, f_hi, root, w, exact_m, wave, medium, clear, sums) if hi > lo else hi
    return new
