"""Rays through bodies full of leaves.

Belongs here: the loop over rays and the cells on their way. Not: which rays, and what a cell is (physics.foliage).
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import math

import numpy as np

from emulator.compiled.falling import mixed, unit
from emulator.compiled.jit import FLOAT, FLOATS, INT, OUT_FLOATS, OUT_INTS, ROWS, compiled

_STEP = np.uint64(0x9E3779B97F4A7C15)
_X, _Y, _Z = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xC2B2AE3D27D4EB4F), np.uint64(0x165667B19E3779F9)


@compiled(INT, FLOATS, FLOAT, ROWS, ROWS, FLOATS, FLOATS, FLOATS, OUT_FLOATS, OUT_INTS)
def leaves(key, offset, cell_m, origin, along, begin, end, rate, stop, words):
    """Write where each ray meets its first leaf, and the number of its cell; see `foliage.first_leaves`."""
    key_word = np.uint64(key)
    cell, step = np.zeros(3, np.int64), np.zeros(3, np.int64)
    pace, border = np.zeros(3), np.zeros(3)
    for ray in range(len(begin)):
        if not (end[ray] > begin[ray] and rate[ray] > 0.0):
            continue
        at = begin[ray]
        for k in range(3):
            d = along[ray, k]
            start = (origin[ray, k] + at * d) / cell_m + offset[k]
            cell[k] = math.floor(start)
            step[k] = 1 if d > 0.0 else -1
            pace[k] = border[k] = math.inf
            if d != 0.0:
                pace[k] = cell_m / abs(d)
                ahead = cell[k] + 1.0 - start if d > 0.0 else start - cell[k]
                border[k] = at + ahead * pace[k]
        while True:
            k = 0
            if border[1] < border[k]:
                k = 1
            if border[2] < border[k]:
                k = 2
            until = min(border[k], end[ray])
            word = mixed((np.uint64(cell[0]) * _X) ^ key_word)
            word = mixed(word + np.uint64(cell[1]) * _Y)
            word = mixed(word + np.uint64(cell[2]) * _Z)
            place = at - math.log1p(-unit(mixed(word + _STEP))) / rate[ray]
            if place < until:
                stop[ray], words[ray] = place, np.int64(word)
                break
            if until >= end[ray]:
                break
            at = max(at, until)
            cell[k] += step[k]
            border[k] += pace[k]
