"""Short clusters of sub-echoes in closed form: running sums, heights, crossings.

Belongs here: what `cosines.split_cosines` and `Cosines._crossed` do with arrays. Not: media under clusters, and those
that are sampled.
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import math

import numpy as np

from emulator.compiled.jit import FLOAT, FLOATS, INTS, compiled

_COSINE = tuple((-1.0) ** n / math.factorial(2 * n) for n in range(11))
_SINE = tuple((-1.0) ** n / math.factorial(2 * n + 1) for n in range(11))


@compiled(INTS, FLOATS, FLOATS, FLOAT)
def split(beam, range_m, amplitude, gap_m):
    """Clusters (c,) of sorted sub-echoes: first sub-echo, how many, span of ranges, sum of amplitudes."""
    n = len(range_m)
    first = np.zeros(n, np.int64)
    count = 0
    for k in range(n):
        if k == 0 or beam[k] != beam[k - 1] or range_m[k] - range_m[k - 1] > gap_m:
            first[count] = k
            count += 1
    start, size, total, span = first[:count].copy(), np.zeros(count, np.int64), np.zeros(count), np.zeros(count)
    for c in range(count):
        end = start[c + 1] if c + 1 < count else n
        size[c] = end - start[c]
        span[c] = range_m[end - 1] - range_m[start[c]]
        for k in range(start[c], end):
            total[c] += amplitude[k]
    return start, size, span, total


@compiled(FLOATS, FLOATS, INTS, INTS, INTS, FLOAT)
def sums(range_m, amplitude, source, start, size, wave_number):
    """Running sums over the sub-echoes (n,) of these clusters, none of them longer than half a turn; 0 elsewhere.

    Returns A, the two parts of C, the signal where each pulse begins, see `Cosines`, and of each cluster the source of
    its strongest sub-echo, the first of equals.
    """
    n, count = len(range_m), len(start)
    total, real, imaginary, begun = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    strongest = np.zeros(count, np.int64)
    for c in range(count):
        first, end = start[c], start[c] + size[c]
        for k in range(first, end):
            # series about half the angle, as `arrays.cos_sin` has them
            half = 0.5 * wave_number * (range_m[k] - range_m[first])
            square = half * half
            sine, cosine = _SINE[10], _COSINE[10]
            for term in range(9, -1, -1):
                sine = sine * square + _SINE[term]
                cosine = cosine * square + _COSINE[term]
            sine *= half
            real[k], imaginary[k] = 1.0 - 2.0 * sine * sine, 2.0 * sine * cosine
        a = x = y = 0.0
        best = -1.0
        for k in range(first, end):
            here, cosine, sine = amplitude[k], real[k], imaginary[k]
            a += here
            x += here * cosine
            y += here * sine
            total[k], real[k], imaginary[k] = a, x, y
            # a pulse begins half a turn of the cosine before its centre
            begun[k] = 0.5 * (a - cosine * x - sine * y)
            if here > best:
                best, strongest[c] = here, source[k]
    return total, real, imaginary, begun, strongest


@compiled()
def cross(level, start, size, first_m, begun, total, real, imaginary, half_m, wave_number):
    """Where the pulses of one cluster first reach a level, and the index of the last one begun by then."""
    low, high = start, start + size  # the sum rises while they begin
    while low < high:
        middle = (low + high) // 2
        if begun[middle] < level:
            low = middle + 1
        else:
            high = middle
    at = max(low - 1, start)
    swing = np.hypot(real[at], imaginary[at])
    # the angle from the trough, which keeps its digits for a level far below the maximum
    share = min(max((2.0 * level - total[at] + swing) / (2.0 * swing), 0.0), 1.0)
    rise = 2.0 * np.arcsin(np.sqrt(share))
    centre = first_m + np.arctan2(imaginary[at], real[at]) / wave_number
    return centre - half_m + rise / wave_number, at


@compiled(FLOATS, INTS, INTS, FLOATS, FLOATS, FLOATS, FLOATS, FLOATS, FLOAT, FLOAT)
def crossed(level, start, size, first_m, begun, total, real, imaginary, half_m, wave_number):
    """The same of clusters (c,)."""
    count = len(level)
    crossing, last = np.zeros(count), np.zeros(count, np.int64)
    for c in range(count):
        crossing[c], last[c] = cross(
            level[c], start[c], size[c], first_m[c], begun, total, real, imaginary, half_m, wave_number
        )
    return crossing, last
