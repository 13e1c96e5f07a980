"""Sub-echoes of two sources put together, beam by beam, in order of range: one pass over both.

Belongs here: what `subechoes._combined` does with arrays. Not: what sub-echoes are, and joining those too near to
distinguish (clusters).
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numpy as np

from emulator.compiled.jit import FLAGS, FLOATS, INTS, compiled


@compiled(
    INTS, FLOATS, FLOATS, FLOATS, INTS, FLOATS, INTS, FLOATS, FLOATS, FLOATS, INTS, FLOATS, FLAGS,
)  # fmt: skip
def merged(
    beam, range_m, amplitude, blocked, source, spread_m,
    beam_2, range_2, amplitude_2, blocked_2, source_2, spread_2, without,
):  # fmt: skip
    """Both, those of the first before equals of the second; `without` : (beams,) that lose those of the first, or (0,).

    `spread_m`, `spread_2` : (0,) where that source has none.

    Returns beam and source (2, room); range, amplitude, blocked share and spread (4, room), the last zeros where
    neither has one; how many of that room are used.
    """
    n, m, fewer = len(beam), len(beam_2), len(without)
    whole, sizes = np.empty((2, n + m), np.int64), np.empty((4, n + m))
    i = j = k = 0
    while True:
        while i < n and fewer and without[beam[i]]:
            i += 1
        if i == n and j == m:
            break
        if j == m or (i < n and (beam[i] < beam_2[j] or (beam[i] == beam_2[j] and range_m[i] <= range_2[j]))):
            whole[0, k], whole[1, k] = beam[i], source[i]
            sizes[0, k], sizes[1, k], sizes[2, k] = range_m[i], amplitude[i], blocked[i]
            sizes[3, k] = spread_m[i] if len(spread_m) else 0.0
            i += 1
        else:
            whole[0, k], whole[1, k] = beam_2[j], source_2[j]
            sizes[0, k], sizes[1, k], sizes[2, k] = range_2[j], amplitude_2[j], blocked_2[j]
            sizes[3, k] = spread_2[j] if len(spread_2) else 0.0
            j += 1
        k += 1
    return whole, sizes, k
