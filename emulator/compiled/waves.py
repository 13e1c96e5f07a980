"""Samples of clusters of sin^2 pulses, with the medium under them.

Belongs here: what `waveform.sample` does with arrays for such pulses. Not: which clusters are sampled (detection).
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numpy as np

from emulator.compiled.arithmetic import cos_sin
from emulator.compiled.jit import FLAG, FLAGS, FLOAT, FLOATS, INTS, compiled
from emulator.compiled.media import MEDIUM, bounds, cell_of, cubic


@compiled(*MEDIUM, FLAG, FLOAT, FLOAT, FLOAT, FLOAT, FLAGS, FLOATS, INTS, INTS, INTS, FLOATS, FLOATS, FLOATS, INTS)
def sampled(
    edged, first, bin_m, medium_number, ends, knots, cubics, cells, cell, hazy, end_m, half_m, step_m, wave_number,
    chosen, clear_share, cluster_first, cluster_count, all_beam, all_range, all_amplitude, all_blocked, all_source,
):  # fmt: skip
    """Columns of `Waveform` of the chosen clusters (c,); `hazy`: there is a medium.

    `step_m` : of the samples; `end_m`: end of the medium; `clear_share` : (c,) of the beam that reaches each cluster;
    the rest are columns of `Clusters`. Returns beam, first bin, start, count, first sub-echo and their number (6, w);
    value and medium's part (2, s); range and amplitude (2, m), source (m,) and running sums (3, m + 1) of sub-echoes.
    """
    windows = m = total = 0
    most = 1
    for c in range(len(chosen)):
        windows += chosen[c]
        m += cluster_count[c] if chosen[c] else 0
    whole, clear = np.empty((6, windows), np.int64), np.empty(windows)
    sub, blocked, source = np.empty((2, m)), np.empty(m), np.empty(m, np.int64)
    w = m = 0
    for c in range(len(chosen)):
        if not chosen[c]:
            continue
        head, size = cluster_first[c], cluster_count[c]
        near = np.floor((all_range[head] - half_m) / step_m)
        far = np.ceil((all_range[head + size - 1] + half_m) / step_m)
        whole[0, w], whole[1, w], whole[2, w], whole[3, w] = all_beam[head], int(near) - 1, total, int(far - near) + 3
        whole[4, w], whole[5, w], clear[w] = m, size, clear_share[c]
        for k in range(head, head + size):
            sub[0, m], sub[1, m], blocked[m], source[m] = all_range[k], all_amplitude[k], all_blocked[k], all_source[k]
            m += 1
        total, most = total + whole[3, w], max(most, whole[3, w])
        w += 1
    first_bin, start, count, sub_first, sub_count = whole[1], whole[2], whole[3], whole[4], whole[5]
    range_m, amplitude = sub[0], sub[1]
    waves, sums = np.zeros((2, total)), np.zeros((3, m + 1))
    value, part = waves[0], waves[1]
    a, real, imaginary = np.zeros(m + 1), np.zeros(m + 1), np.zeros(m + 1)
    stop, ended = np.zeros(m + 1), np.zeros((3, m + 1))
    cosine, sine = np.zeros(most), np.zeros(most)
    for j in range(most):
        cosine[j], sine[j] = cos_sin(wave_number * step_m * j)
    for w in range(windows):
        for k in range(sub_first[w], sub_first[w] + sub_count[w]):
            real[k + 1] = wave_number * (range_m[k] - step_m * first_bin[w])
    for k in range(m + 1):  # over all at once, so that several are computed together
        real[k], imaginary[k] = cos_sin(real[k])
    for w in range(windows):
        head, tail = sub_first[w], sub_first[w] + sub_count[w]
        origin = step_m * first_bin[w]
        shown_cosine, shown_sine = cos_sin(wave_number * origin)
        for k in range(head, tail):
            here, x, y = amplitude[k], amplitude[k] * real[k + 1], amplitude[k] * imaginary[k + 1]
            sums[0, k + 1], sums[1, k + 1], sums[2, k + 1] = sums[0, k] + here, sums[1, k] + x, sums[2, k] + y
            # running sums from the window's first sub-echo on
            before = k > head
            a[k + 1] = (a[k] if before else 0.0) + here
            real[k + 1] = (real[k] if before else 0.0) + x
            imaginary[k + 1] = (imaginary[k] if before else 0.0) + y
            if hazy:
                share = blocked[k] if range_m[k] < end_m + 2.0 * half_m else 0.0
                stop[k + 1] = (stop[k] if before else 0.0) + share
                knot, behind = cell_of(range_m[k], knots, cells, cell)
                for i in range(3):
                    more = share * cubic(i, knot, behind, cubics) if share > 0.0 else 0.0
                    ended[i, k + 1] = (ended[i, k] if before else 0.0) + more
        begun = over = head
        for j in range(count[w]):
            number = first_bin[w] + j
            while begun < tail and np.ceil((range_m[begun] - half_m) / step_m) <= number:
                begun += 1
            while over < tail and np.floor((range_m[over] + half_m) / step_m) + 1.0 <= number:
                over += 1
            at = start[w] + j
            sum_a, sum_real, sum_imaginary = a[begun], real[begun], imaginary[begun]
            if begun == head:
                sum_a = sum_real = sum_imaginary = 0.0
            if over > head:
                sum_a, sum_real, sum_imaginary = sum_a - a[over], sum_real - real[over], sum_imaginary - imaginary[over]
            value[at] = max(0.5 * (sum_a + cosine[j] * sum_real + sine[j] * sum_imaginary), 0.0)
            if not hazy:
                continue
            upper, lower = bounds(number, edged, first, bin_m, medium_number, ends)
            open_far = open_near = clear[w]
            medium = 0.0
            x = y = 0.0
            if begun > head:
                open_far -= stop[begun]
                medium, x, y = ended[0, begun], ended[1, begun], ended[2, begun]
            if over > head:
                open_near -= stop[over]
                medium, x, y = medium - ended[0, over], x - ended[1, over], y - ended[2, over]
            b_real, b_imaginary = x * shown_cosine - y * shown_sine, x * shown_sine + y * shown_cosine
            medium += cosine[j] * b_real - sine[j] * b_imaginary
            medium += max(open_far, 0.0) * upper - max(open_near, 0.0) * lower
            part[at] = max(0.5 * medium, 0.0)
            value[at] += part[at]
    return whole, waves, sub, source, sums
