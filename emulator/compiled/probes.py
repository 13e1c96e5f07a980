"""Probing rays of narrow beams, and what comes of them where a beam sees one smooth surface.

Belongs here: what `probing` does with arrays. Not: bundles, mirrors and glass.
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numpy as np

from emulator.compiled.arithmetic import exp
from emulator.compiled.jit import FLOAT, FLOATS, INTS, ROWS, TURNS, WORDS, compiled

NOTHING, CLOSED, PROBED, BUNDLE = 0, 1, 2, 3
"What becomes of a beam, see `probing`."


@compiled(TURNS, ROWS, ROWS)
def aimed(frame, place, nodes):
    """Origins and directions (2, 3, n k) of k probes of each beam.

    `frame` : (3, 3, n) forward, left and up of beams in the world; `place` : (3, n); `nodes` : (5, k) shares of the
    three in a direction, and metres to the left and up on the pupil.
    """
    n, k = place.shape[1], nodes.shape[1]
    made = np.empty((2, 3, n * k))
    for axis in range(3):
        origin, direction = made[0, axis], made[1, axis]
        for i in range(n):
            f, left, up, at = frame[0, axis, i], frame[1, axis, i], frame[2, axis, i], place[axis, i]
            for j in range(k):
                direction[i * k + j] = f * nodes[0, j] + left * nodes[1, j] + up * nodes[2, j]
                origin[i * k + j] = at + left * nodes[3, j] + up * nodes[4, j]
    return made


@compiled()
def _back(factors, kind, c):
    """`SurfaceTable.back` of materials that do not stand apart, for a cosine up to 1."""
    square = c * c
    back = factors[0, kind] * c + factors[1, kind] * (1.0 - square) + factors[2, kind]
    if factors[3, kind] > 0.0:  # see `brdf.ggx_cos`
        wide = factors[5, kind] * factors[5, kind]
        spread = (1.0 - square) + wide * square
        lobe = factors[4, kind] * wide / (4.0 * spread * spread * np.sqrt(square + wide * (1.0 - square)))
        back += factors[3, kind] * lobe
    return back


@compiled(
    FLOATS, WORDS, WORDS, FLOATS, FLOATS, ROWS, FLOATS, INTS, FLOAT, FLOAT, FLOAT, FLOAT,
    ROWS, FLOAT, FLOAT, FLOAT, FLOAT, FLOAT,
)  # fmt: skip
def judged(
    range_m, material, actor, cosine, weight, nodes, share, treated, reach_m, off_m, widest_m, foot_m2,
    factors, extinction, strength, aperture_m, overlap_start_m, overlap_full_m,
):  # fmt: skip
    """What becomes of beams (n,), and two ranges with their common amplitude, and the nearest range (4, n).

    `weight` : (n,); `nodes` : (3, k) length, u and v of probes; `treated` : (materials,) the least of what becomes of a
    beam on it; `off_m` : how far a probe may be from a plane; `widest_m` : spread up to which two ranges do;
    `foot_m2` : square of the way from the mean to the nearest range, times the amplitude, up to which they do.
    """
    n, k = len(weight), len(share)
    kinds, made = np.zeros(n, np.int64), np.zeros((4, n))
    square = 0.0
    for j in range(k):
        square += nodes[1, j] * nodes[1, j]
    for i in range(n):
        at = i * k
        met, same, nearest = 0, True, np.inf
        for j in range(at, at + k):
            if range_m[j] <= reach_m:
                met += 1
                nearest = min(nearest, range_m[j])
            same &= (material[j] == material[at]) & (actor[j] == actor[at])
        made[3, i] = nearest
        if met == 0:
            continue
        if met < k or not same:
            kinds[i] = BUNDLE
            continue
        middle = across = upward = 0.0
        for j in range(k):
            inverse = nodes[0, j] / range_m[at + j]
            middle += inverse
            across += inverse * nodes[1, j]
            upward += inverse * nodes[2, j]
        middle, across, upward = middle / k, across / square, upward / square
        off = 0.0
        for j in range(k):
            inverse = nodes[0, j] / range_m[at + j]
            off = max(off, abs(inverse - middle - across * nodes[1, j] - upward * nodes[2, j]))
        kinds[i] = max(CLOSED, treated[material[at]])
        if off * range_m[at] * range_m[at] > off_m:
            kinds[i] = BUNDLE
        if kinds[i] != CLOSED:
            continue
        total = first = 0.0
        for j in range(k):
            r = range_m[at + j]
            height = share[j] * _back(factors, material[at], min(cosine[at + j], 1.0)) / (r * r + aperture_m**2)
            if extinction > 0.0:
                height *= exp(-2.0 * extinction * r)
            if r < overlap_start_m:
                height = 0.0
            elif r < overlap_full_m:
                height *= (r - overlap_start_m) / (overlap_full_m - overlap_start_m)
            total += height
            first += height * (r - range_m[at])
        mean = first / total if total > 0.0 else 0.0
        height, lead = weight[i] * strength * total, range_m[at] + mean - nearest
        if lead > 4.0 * off_m and lead * lead * height > foot_m2:
            kinds[i] = BUNDLE
            continue
        second = 0.0
        for j in range(k):
            r = range_m[at + j]
            second += share[j] * (r - range_m[at] - mean) ** 2
        spread = np.sqrt(second)
        if spread > widest_m:
            kinds[i] = PROBED
            continue
        made[0, i], made[1, i] = range_m[at] + mean - spread, range_m[at] + mean + spread
        made[2, i] = 0.5 * height
    return kinds, made
