"""Short clusters of sub-echoes in closed form: running sums, heights, crossings.

Belongs here: what `cosines.split_cosines` and `Cosines._crossed` do with arrays. Not: media under clusters, and those
that are sampled.
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numpy as np

from emulator.compiled.arithmetic import short_cos_sin
from emulator.compiled.jit import FLAGS, FLOAT, FLOATS, INT_ROWS, INTS, compiled


@compiled(INTS, FLOATS, FLOATS, FLOAT, FLOAT)
def split(beam, range_m, amplitude, gap_m, longest_m):
    """Clusters (c,) of sorted sub-echoes: beam, first sub-echo, how many, first range, and which of them are short."""
    n = len(range_m)
    first = np.empty(n, np.int64)
    count = 0
    for k in range(n):
        if k == 0 or beam[k] != beam[k - 1] or range_m[k] - range_m[k - 1] > gap_m:
            first[count] = k
            count += 1
    whole, near_m, short = np.empty((3, count), np.int64), np.empty(count), np.empty(count, np.bool_)
    for c in range(count):
        begin, end = first[c], first[c + 1] if c + 1 < count else n
        whole[0, c], whole[1, c], whole[2, c], near_m[c] = beam[begin], begin, end - begin, range_m[begin]
        short[c] = range_m[end - 1] - range_m[begin] < longest_m
        if short[c]:
            total = 0.0
            for k in range(begin, end):
                total += amplitude[k]
            short[c] = total > 0.0
    return whole, near_m, short


@compiled(INTS, FLOATS, FLOATS, FLOATS, INTS, FLOAT, FLOAT)
def joined(beam, range_m, amplitude, blocked, source, gap_m, quarter_m):
    """Columns of `Clusters`, see `subechoes.cluster`: sub-echoes within `quarter_m` are joined, of sorted ones.

    Beam, source and cluster (3, g), range, amplitude and blocked share (3, g), first and count (2, c).
    """
    n = len(range_m)
    whole, sizes, groups = np.empty((3, n), np.int64), np.empty((3, n)), np.empty((2, n), np.int64)
    of, origin, number, first, count = whole[0], whole[1], whole[2], groups[0], groups[1]
    place, height, stop = sizes[0], sizes[1], sizes[2]
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
    return whole[:, :made].copy(), sizes[:, :made].copy(), groups[:, :clusters].copy()


@compiled(FLOATS, FLOATS, INTS, INT_ROWS, FLAGS, FLOAT)
def sums(range_m, amplitude, source, whole, short, wave_number):
    """Of the short ones of these clusters, none of them longer than half a turn, see `Cosines`: running sums over the
    sub-echoes (4, n), defined for theirs; beam, source, start and size (4, c); place of the maximum, height and first
    range (3, c). And the numbers of the sub-echoes of all others.
    """
    n, count = len(range_m), 0
    for c in range(len(short)):
        count += short[c]
    running, reported, size = np.empty((4, n)), np.empty((4, count), np.int64), np.empty((3, count))
    begun, total, real, imaginary = running[0], running[1], running[2], running[3]
    left = np.empty(n, np.int64)
    made = others = 0
    for c in range(len(short)):
        first, end = whole[1, c], whole[1, c] + whole[2, c]
        mine, angle = range_m[first:end], real[first:end]
        for k in range(len(mine)):
            angle[k] = wave_number * (mine[k] - mine[0]) if short[c] else 0.0
    for k in range(n):  # over all at once, so that several are computed together
        real[k], imaginary[k] = short_cos_sin(real[k])
    for c in range(len(short)):
        first, end = whole[1, c], whole[1, c] + whole[2, c]
        if not short[c]:
            for k in range(first, end):
                left[others] = k
                others += 1
            continue
        a = x = y = 0.0
        best, strongest = -1.0, 0
        for k in range(first, end):
            here, cosine, sine = amplitude[k], real[k], imaginary[k]
            a += here
            x += here * cosine
            y += here * sine
            total[k], real[k], imaginary[k] = a, x, y
            # a pulse begins half a turn of the cosine before its centre
            begun[k] = 0.5 * (a - cosine * x - sine * y)
            if here > best:  # the first of equals
                best, strongest = here, source[k]
        reported[0, made], reported[1, made], reported[2, made], reported[3, made] = (
            whole[0, c],
            strongest,
            first,
            end - first,
        )
        size[0, made] = range_m[first] + np.arctan2(y, x) / wave_number
        size[1, made], size[2, made] = 0.5 * (a + np.hypot(x, y)), range_m[first]
        made += 1
    return running, reported, size, left[:others].copy()


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
    swing, turn = total[at], 0.0
    if at > start:
        swing, turn = np.hypot(real[at], imaginary[at]), np.arctan2(imaginary[at], real[at])
    # the angle from the trough, which keeps its digits for a level far below the maximum
    share = min(max((2.0 * level - total[at] + swing) / (2.0 * swing), 0.0), 1.0)
    rise = 2.0 * np.arcsin(np.sqrt(share))  # as numpy rounds it: near the maximum what is taken off again must match
    return first_m + turn / wave_number - half_m + rise / wave_number, at


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
