"""Echoes on a leading edge of sin^2 pulses: their order by height, levels and readings.

Belongs here: what `detection._measure` does with arrays. Not: crossings (clusters, maxima, media).
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numpy as np

from emulator.compiled.jit import FLAG, FLAGS, FLOAT, FLOATS, INT, INTS, compiled

FEW = 64
"Echoes of a beam that are compared with each other; more are sorted."


@compiled()
def grouped(beam, beams):
    """Indexes by beam, as they come, and where each beam's begin, (beams + 1,)."""
    begin = np.zeros(beams + 1, np.int64)
    for k in range(len(beam)):
        begin[beam[k] + 1] += 1
    for b in range(beams):
        begin[b + 1] += begin[b]
    order, free = np.empty(begin[beams], np.int64), begin.copy()
    for k in range(len(beam)):
        order[free[beam[k]]] = k
        free[beam[k]] += 1
    return order, begin


@compiled()
def _sort(order, begin, end, keys):
    """Put indexes from begin to end in the order of their keys, equal ones as they come."""
    if end - begin > FEW:
        some = order[begin:end].copy()
        order[begin:end] = some[np.argsort(keys[some], kind="mergesort")]
        return
    for i in range(begin + 1, end):
        one, j = order[i], i - 1
        while j >= begin and keys[order[j]] > keys[one]:
            order[j + 1] = order[j]
            j -= 1
        order[j + 1] = one


@compiled()
def tall(centre, height, floor_m2):
    near = max(centre, 1e-3)
    return height * (near * near) >= floor_m2


@compiled(INTS, FLOATS, FLOATS, INT, FLOAT, INT)
def ranks(beam, centre, height, beams, floor_m2, columns):
    """(k,) place of each echo in its beam, the highest first, those under the floor last; modulo columns."""
    count = len(beam)
    keys, place = np.empty(count), np.empty(count, np.int64)
    for k in range(count):
        keys[k] = -height[k] if tall(centre[k], height[k], floor_m2) else 0.0
    order, begin = grouped(beam, beams)
    for b in range(beams):
        _sort(order, begin[b], begin[b + 1], keys)
        for i in range(begin[b], begin[b + 1]):
            place[order[i]] = (i - begin[b]) % columns
    return place


@compiled()
def lead(amplitude_over_level, fwhm_m):
    """See `Pulse.lead`, of a sin^2 pulse."""
    q = max(amplitude_over_level, 1.0)
    root = np.sqrt(1.0 / q)
    return fwhm_m - 2.0 * fwhm_m / np.pi * np.arctan2(root, np.sqrt(q - 1.0) * root)


@compiled(INTS, FLOATS, FLOATS, FLOATS, FLOATS, FLOATS, FLOAT, FLOAT, FLOAT, FLOAT, INT)
def levels(beam, centre, height, z, rms, threshold, full_scale, shot_factor, floor_m2, fwhm_m, single):
    """Of echoes (k,): the level that is crossed, which are seen, and from number `single` on where pulses cross it.

    `z` : (k,) normal numbers; `rms`, `threshold` : (n,) of beams.
    """
    count = len(beam)
    level, crossing, seen = np.empty(count), np.empty(count), np.empty(count, np.bool_)
    for k in range(count):
        dark, least, shown = rms[beam[k]], threshold[beam[k]], min(height[k], full_scale)
        high = least - z[k] * np.sqrt(dark * dark + shot_factor * height[k])
        seen[k] = shown >= high and tall(centre[k], height[k], floor_m2)
        if shot_factor > 0.0:  # at the crossing the signal is as high as the threshold, however high it rises
            high = least - z[k] * np.sqrt(dark * dark + shot_factor * min(height[k], least))
        level[k] = min(max(high, 0.02 * least), max(shown, 1e-12))
        crossing[k] = centre[k] - lead(height[k] / level[k], fwhm_m) if k >= single else 0.0
    return level, seen, crossing


@compiled(INTS, FLOATS, FLOATS, FLOATS, INTS, FLAGS, FLOATS, FLOATS, FLOAT, FLOAT, FLOAT, FLAG, FLOAT)
def readings(
    beam, height, z, crossing, source, seen, rms, threshold, full_scale, shot_factor, fwhm_m, walk_table, offset_m
):
    """Of the echoes seen: beam and source (2, s), range and amplitude (2, s), and which are clipped."""
    count = 0
    for k in range(len(seen)):
        count += seen[k]
    whole, sizes, clipped = np.empty((2, count), np.int64), np.empty((2, count)), np.empty(count, np.bool_)
    at = 0
    for k in range(len(seen)):
        if not seen[k]:
            continue
        dark, least, shown = rms[beam[k]], threshold[beam[k]], min(height[k], full_scale)
        if walk_table:
            range_m = crossing[k] + lead(shown / least, fwhm_m)
        else:
            range_m = crossing[k] + fwhm_m - offset_m
        amplitude = height[k] + z[k] * np.sqrt(dark * dark + shot_factor * height[k])
        whole[0, at], whole[1, at], clipped[at] = beam[k], source[k], height[k] >= full_scale
        # a touching target is at 0, whatever the noise
        sizes[0, at], sizes[1, at] = max(range_m, 0.0), min(max(amplitude, least), max(full_scale, least))
        at += 1
    return whole, sizes, clipped
