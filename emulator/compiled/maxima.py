"""Maxima of sampled sin^2 waveforms, and where leading edges cross a level between the samples.

Belongs here: what `candidates.wave_candidates` and `timing.edges` do with arrays for such pulses. Not: samples (waves),
other ways of timing.
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numpy as np

from emulator.compiled.jit import FLAG, FLOAT, FLOATS, INT, INTS, compiled

WAVE = (FLOAT, FLOAT, FLOAT, FLAG, INTS, INTS, INTS, FLOATS, FLOATS, INTS, INTS, FLOATS, FLOATS, FLOATS, FLOATS)
"`Waveform.flat`: bin, half and wave number, hazy, first_bin, start, count, value, soft, the sub-echoes and their sums."


@compiled()
def under_way(x_m, w, bin_m, half_m, first_bin, sub_first, sub_count, sub_range):
    """Sub-echoes, of all windows, whose pulses have begun by x, and those that have ended before."""
    origin = bin_m * first_bin[w]
    offset, head, tail = x_m - origin, sub_first[w], sub_first[w] + sub_count[w]
    begun = _place(offset + half_m, origin, head, tail, sub_range, True)
    return begun, _place(offset - half_m, origin, head, tail, sub_range, False)


@compiled()
def _place(offset, origin, low, high, sub_range, after):
    """First sub-echo from `low` to `high` that is farther from the origin; not `after`: as far or farther."""
    while low < high:
        middle = (low + high) // 2
        here = sub_range[middle] - origin
        if here < offset or (after and here == offset):
            low = middle + 1
        else:
            high = middle
    return low


@compiled()
def terms(begun, ended, a, real, imaginary):
    """The pulses under way: a constant, and factors of cos kx and sin kx from the window's first sample on."""
    return (
        0.5 * (a[begun] - a[ended]), 0.5 * (real[begun] - real[ended]), 0.5 * (imaginary[begun] - imaginary[ended])
    )  # fmt: skip


@compiled()
def medium_at(x_m, w, bin_m, first_bin, start, count, soft):
    """See `Waveform.soft_at`."""
    offset = min(max(x_m / bin_m - first_bin[w], 0.0), count[w] - 1.000001)
    whole = int(np.floor(offset))
    at, part = start[w] + whole, offset - whole
    return (1.0 - part) * soft[at] + part * soft[at + 1]


@compiled()
def _apart(peak, window, value, beam, rms, threshold, full_scale):
    """Those of the maxima that a valley separates from their neighbours in the same beam."""
    lost = np.zeros(len(peak), np.bool_)
    while True:
        lost[:] = False
        count = len(peak)
        for i in range(count - 1):
            one, other, of = peak[i], peak[i + 1], beam[window[i]]
            if beam[window[i + 1]] != of:
                continue
            first, second = min(value[one], full_scale), min(value[other], full_scale)
            valley, lower = np.inf, min(first, second)
            for j in range(one, other):
                valley = min(valley, min(value[j], full_scale))
            if lower - valley >= rms[of] or (lower >= threshold[of] and valley < threshold[of]):
                continue
            lost[i + 1 if second <= first else i] = True
        kept = np.nonzero(~lost[:count])[0]
        if len(kept) == count:
            return peak, window
        peak, window = peak[kept], window[kept]


@compiled(*WAVE, INTS, FLOATS, FLOATS, FLOATS, FLOAT, FLOAT)
def maxima(
    bin_m, half_m, wave_number, hazy, first_bin, start, count, value, soft, sub_first, sub_count, sub_range,
    a, real, imaginary, beam, least, rms, threshold, full_scale, faint,
):  # fmt: skip
    """Maxima that a valley separates, as `wave_candidates`; of clipped ones neither place nor height.

    `beam` : (w,), ascending; `least`, `rms`, `threshold` : (n,). Returns sample, window, place, height and begin.
    """
    peak, window = np.zeros(len(value), np.int64), np.zeros(len(value), np.int64)
    found = 0
    for w in range(len(count)):
        high = 0.99 * least[beam[w]]
        for j in range(start[w] + 1, start[w] + count[w] - 1):
            here = min(value[j], full_scale)
            if not here >= high:  # most of them
                continue
            if here > min(value[j - 1], full_scale) and here >= min(value[j + 1], full_scale):
                peak[found], window[found] = j, w
                found += 1
    peak, window = _apart(peak[:found], window[:found], value, beam, rms, threshold, full_scale)
    found = len(peak)
    centre, height, begin = np.zeros(found), np.zeros(found), np.zeros(found, np.int64)
    for k in range(found):
        p, w = peak[k], window[k]
        left, middle, right = value[p - 1], value[p], value[p + 1]
        curve = left - 2.0 * middle + right
        shift = min(max(0.5 * (left - right) / curve, -0.5), 0.5) if curve < 0.0 else 0.0
        height[k] = middle - 0.25 * (left - right) * shift
        parabola = bin_m * (first_bin[w] + (p - start[w])) + shift * bin_m
        centre[k] = parabola
        begin[k] = start[w]
        if k and window[k - 1] == w:  # from the lowest sample since the last maximum on
            lowest = np.inf
            for j in range(peak[k - 1], p):
                here = min(value[j], full_scale)
                if here <= lowest:
                    lowest, begin[k] = here, j
        if soft[p] > faint * height[k]:
            continue
        # the one cosine that stands there, see `candidates._exact`
        begun, ended = under_way(parabola, w, bin_m, half_m, first_bin, sub_first, sub_count, sub_range)
        even, x, y = terms(begun, ended, a, real, imaginary)
        swing = np.hypot(x, y)
        top = bin_m * first_bin[w] + np.arctan2(y, x) / wave_number
        top += 2.0 * np.pi / wave_number * np.rint((parabola - top) * wave_number / (2.0 * np.pi))
        slope, bend = 0.5 * (soft[p + 1] - soft[p - 1]) / bin_m, swing * wave_number * wave_number
        if not abs(slope) < bend * bin_m:
            continue
        shift = slope / bend
        top += shift
        again, over = under_way(top, w, bin_m, half_m, first_bin, sub_first, sub_count, sub_range)
        if again == begun and over == ended and abs(top - parabola) <= bin_m:
            medium = medium_at(top, w, bin_m, first_bin, start, count, soft)
            centre[k], height[k] = top, even + swing * np.cos(wave_number * shift) + medium
    return peak, window, centre, height, begin


@compiled()
def _rise(level, lo, hi, origin, even, real, imaginary, slope, k, exact_m, steps):
    """Where a cosine on a slope first reaches a level, see `timing._between_samples`."""
    swing, middle = np.hypot(real, imaginary), 0.5 * (lo + hi)
    # from the trough on, whose angle keeps its digits; its turn is the one that is nearest
    left = level - even - slope * middle
    share = 0.5 + 0.5 * left / max(swing, abs(left)) if abs(left) < swing else 1.0 if left > 0.0 else 0.0
    rise = 2.0 * np.arcsin(np.sqrt(min(max(share, 0.0), 1.0))) - np.pi
    x = origin + (np.arctan2(imaginary, real) + rise) / k
    x = min(max(x + 2.0 * np.pi / k * np.rint((middle - x) * k / (2.0 * np.pi)), lo), hi)
    for _ in range(steps):
        cosine, sine = np.cos(k * (x - origin)), np.sin(k * (x - origin))
        rises = slope + k * (cosine * imaginary - sine * real)
        new = x
        if rises > 0.0:
            new = min(max(x + (level - (even + slope * x + cosine * real + sine * imaginary)) / rises, lo), hi)
        done = abs(new - x) < exact_m
        x = new
        if done:
            break
    return x


@compiled(*WAVE, INTS, INTS, INTS, FLOATS, FLOATS, FLOATS, FLOATS, FLOAT, FLOAT, INT)
def edges(
    bin_m, half_m, wave_number, hazy, first_bin, start, count, value, soft, sub_first, sub_count, sub_range,
    a, real, imaginary, index, window, begin, centre, amplitude, level, otherwise, faint, exact_m, steps,
):  # fmt: skip
    """First crossing of each maximum's level between its begin and itself, as `timing.edges`."""
    crossing = otherwise.copy()
    for k in range(len(level)):
        w, wanted = window[k], level[k]
        first = begin[k]
        while first <= index[k] and value[first] < wanted:
            first += 1
        hit = first <= index[k]
        if not hit:  # the maximum between two samples reaches the level, the samples do not
            first = index[k]
        if not ((hit and first > begin[k]) or (not hit and index[k] > begin[k])):
            continue
        hi = bin_m * (first_bin[w] + (first - start[w]))
        before = max(first - 1, start[w])
        if not hit and centre[k] > hi:
            before += 1
        lo = bin_m * (first_bin[w] + (before - start[w]))
        highest = value[first]
        if not hit:
            hi = max(centre[k], lo)
            if soft[first] <= faint * amplitude[k]:
                highest = amplitude[k]
        crossing[k] = hi
        if not (value[before] < wanted and max(highest, wanted) > wanted and hi > lo):
            continue
        slope = (soft[before + 1] - soft[before]) / bin_m
        constant = soft[before] - slope * lo
        # no pulse begins or ends between the bounds that are left, see `timing._without_kinks`
        begun, ended = under_way(lo, w, bin_m, half_m, first_bin, sub_first, sub_count, sub_range)
        begins, ends = under_way(hi, w, bin_m, half_m, first_bin, sub_first, sub_count, sub_range)
        least, most = lo, hi
        while begun < begins or ended < ends:
            starts = sub_range[begun] - half_m if begun < begins else np.inf
            stops = sub_range[ended] + half_m if ended < ends else np.inf
            if starts <= stops:
                begun += 1
            else:
                ended += 1
            place = min(max(min(starts, stops), least), most)
            even, x, y = terms(begun, ended, a, real, imaginary)  # one that begins or ends here adds nothing yet
            turn = wave_number * (place - bin_m * first_bin[w])
            height = max(even + np.cos(turn) * x + np.sin(turn) * y, 0.0)
            if hazy:
                height = max(height + medium_at(place, w, bin_m, first_bin, start, count, soft), 0.0)
            if height >= wanted:
                hi = place
                break
            if place < hi:
                lo = place
        middle, origin = 0.5 * (lo + hi), bin_m * first_bin[w]
        now, over = under_way(middle, w, bin_m, half_m, first_bin, sub_first, sub_count, sub_range)
        even, x, y = terms(now, over, a, real, imaginary)
        even += constant
        crossing[k] = _rise(wanted, lo, hi, origin, even, x, y, slope, wave_number, exact_m, steps)
    return crossing
