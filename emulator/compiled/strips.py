"""Strips of smooth surfaces: how many a beam needs, and their sub-echoes.

Belongs here: what `sensing.strips` does with arrays. Not: how a beam is found to see one surface (narrow).
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numpy as np

from emulator.compiled.arithmetic import exp
from emulator.compiled.jit import FLOAT, FLOATS, INTS, ROWS, TURNS, WORDS, compiled


@compiled()
def reflected(factors, kind, cosine):
    """See `SurfaceTable.back`."""
    c = min(abs(cosine), 1.0)
    back = factors[0, kind] * c + factors[1, kind] * (1.0 - c * c) + factors[2, kind]
    if factors[3, kind] > 0.0:  # see `brdf.ggx_cos`
        rough = factors[5, kind] * factors[5, kind]
        lobe = (1.0 - c * c) + rough * c * c
        back += factors[3, kind] * (
            factors[4, kind] * rough / (4.0 * lobe * lobe * np.sqrt(c * c + rough * (1.0 - c * c)))
        )
    return back


@compiled()
def strips_wanted(lead, size, fwhm, level, foot, allowed, wide, numbers, feet, shift):
    """See `strips.counts`, of one beam."""
    share = min(max(level / max(size, 1e-300), 1e-12), 0.9)
    if np.pi / (16.0 * fwhm) * lead * lead / np.sqrt(share * (1.0 - share)) <= allowed:
        return np.int64(1)
    high, row, last = foot / max(lead * lead * size, 1e-300), 0, len(numbers) - 1
    while row < len(feet) - 1 and high < feet[row]:
        row += 1
    for column in range(last + 1):
        if numbers[column] * fwhm >= wide * lead and (shift[row, column] * lead <= allowed or column == last):
            return numbers[column]
    return np.int64(0)


@compiled(INTS, ROWS, INTS, WORDS, WORDS, FLOATS, ROWS, TURNS, FLOAT, FLOAT, FLOAT, FLOAT, FLOAT)
def strips(at, rows, count, material, actor, weight, factors, nodes, extinction, k_m2, area, start, full):
    """Sub-echoes of the beams `at`: beam and source (2, k), range, amplitude, share (3, k), see `strips.echoes`."""
    total = 0
    for one in range(len(at)):
        total += count[at[one]]
    whole, sizes = np.empty((2, total), np.int64), np.empty((3, total))
    made = 0
    for one in range(len(at)):
        i = at[one]
        own, kind = nodes[count[i]], np.int64(material[i])
        above, leans, facing, turns = rows[0, i], rows[1, i], rows[2, i], rows[3, i]
        beside, cosine, bends = rows[4, i], rows[5, i], rows[6, i]
        for strip in range(count[i]):
            place, share = own[0, strip], own[1, strip]
            r = (above - leans * place) / (facing + turns * place) + beside
            height = weight[i] * k_m2 * share * reflected(factors, kind, cosine + bends * place) / (r * r + area)
            if extinction > 0.0:
                height *= exp(-2.0 * extinction * r)
            if r < start:
                height = 0.0
            elif r < full:
                height *= (r - start) / (full - start)
            whole[0, made], whole[1, made] = i, actor[i]
            sizes[0, made], sizes[1, made], sizes[2, made] = r, height, share
            made += 1
    return whole, sizes
