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


@compiled(INTS, FLOATS, FLOATS, FLOATS, INTS, FLOAT, FLOAT)
def joined(beam, range_m, amplitude, blocked, source, gap_m, quarter_m):
    """Columns of `Clusters`, see `subechoes.cluster`: sub-echoes within `quarter_m` are joined, of sorted ones."""
    n = len(range_m)
    of, place, height, stop = np.zeros(n, np.int64), np.zeros(n), np.zeros(n), np.zeros(n)
    origin, number = np.zeros(n, np.int64), np.zeros(n, np.int64)
    first, count = np.zeros(n, np.int64), np.zeros(n, np.int64)
    clusters = made = 0
    begin = 0
    while begin < n:
        end = begin + 1
        while end < n and beam[end] == beam[begin] and range_m[end] - range_m[end - 1] <= gap_m:
            end += 1
        narrow = range_m[end - 1] - range_m[begin] < quarter_m
        first[clusters] = made
        k = begin
        while k < end:
            near = range_m[k]
            cell = np.floor((near - range_m[begin]) / quarter_m) if quarter_m > 0.0 else 0.0
            total = moment = share = 0.0
            best, j = -1.0, k
            while j < end:
                apart = range_m[j] - range_m[begin]
                if j > k and (quarter_m <= 0.0 or not (narrow or np.floor(apart / quarter_m) == cell)):
                    break
                total += amplitude[j]
                moment += amplitude[j] * (range_m[j] - near)
                share += blocked[j]
                if amplitude[j] > best:  # the first of equals
                    best, origin[made] = amplitude[j], source[j]
                j += 1
            of[made], height[made], stop[made], number[made] = beam[begin], total, share, clusters
            place[made] = near + moment / (total if total > 0.0 else 1.0)
            made, k = made + 1, j
        count[clusters] = made - first[clusters]
        clusters += 1
        begin = end
    return (
        of[:made].copy(), place[:made].copy(), height[:made].copy(), stop[:made].copy(), origin[:made].copy(),
        number[:made].copy(), first[:clusters].copy(), count[:clusters].copy(),
    )  # fmt: skip


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
