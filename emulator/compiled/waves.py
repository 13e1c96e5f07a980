"""Samples of clusters of sin^2 pulses, with the medium under them.

Belongs here: what `waveform.sample` does with arrays for such pulses. Not: which clusters are sampled (detection).
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numpy as np

from emulator.compiled.jit import FLAG, FLOAT, FLOATS, INTS, compiled
from emulator.compiled.media import MEDIUM, bounds, integral


@compiled(*MEDIUM, FLAG, FLOAT, FLOAT, FLOAT, FLOAT, INTS, INTS, INTS, INTS, INTS, FLOATS, FLOATS, FLOATS, FLOATS)
def sampled(
    edged, first, bin_m, medium_number, ends, knots, cubics, cells, cell, hazy, end_m, half_m, step_m, wave_number,
    first_bin, start, count, sub_first, sub_count, range_m, amplitude, blocked, clear,
):  # fmt: skip
    """Surfaces' and medium's parts of the samples (s,) of windows (w,); `hazy`: there is a medium.

    `step_m` : of the samples; `end_m`: end of the medium; `clear` : (w,) share of the beam that reaches each window.
    """
    total = 0
    for w in range(len(count)):
        total += count[w]
    value, part = np.zeros(total), np.zeros(total)
    m = len(range_m)
    a, real, imaginary = np.zeros(m + 1), np.zeros(m + 1), np.zeros(m + 1)
    stop, ended = np.zeros(m + 1), np.zeros((3, m + 1))
    most = 1
    for w in range(len(count)):
        most = max(most, count[w])
    cosine, sine = np.zeros(most), np.zeros(most)
    for j in range(most):
        cosine[j], sine[j] = np.cos(wave_number * step_m * j), np.sin(wave_number * step_m * j)
    for w in range(len(count)):
        head, tail = sub_first[w], sub_first[w] + sub_count[w]
        origin = step_m * first_bin[w]
        shown_cosine, shown_sine = np.cos(wave_number * origin), np.sin(wave_number * origin)
        for k in range(head, tail):
            turn = wave_number * (range_m[k] - origin)
            # running sums from the window's first sub-echo on
            before = k > head
            a[k + 1] = (a[k] if before else 0.0) + amplitude[k]
            real[k + 1] = (real[k] if before else 0.0) + amplitude[k] * np.cos(turn)
            imaginary[k + 1] = (imaginary[k] if before else 0.0) + amplitude[k] * np.sin(turn)
            if hazy:
                share = blocked[k] if range_m[k] < end_m + 2.0 * half_m else 0.0
                stop[k + 1] = (stop[k] if before else 0.0) + share
                for i in range(3):
                    more = share * integral(i, range_m[k], knots, cubics, cells, cell) if share > 0.0 else 0.0
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
            upper, lower = bounds(number, edged, first, bin_m, wave_number, ends)
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
    return value, part
