"""Strips of smooth surfaces: how many a beam needs, and their sub-echoes.

Belongs here: what `sensing.strips` does with arrays, with the sub-echoes of other beams between them. Not: how a beam
is found to see one surface (narrow).
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numpy as np

from emulator.compiled.arithmetic import faded
from emulator.compiled.jit import FLOAT, FLOATS, INTS, ROWS, TURNS, WORDS, compiled


@compiled()
def reflected(lambert, sheen, even, gloss, fresnel, roughness, cosine):
    """See `SurfaceTable.back`: numbers of one material. The references of an array would be counted for every ray."""
    c = min(abs(cosine), 1.0)
    back = lambert * c + sheen * (1.0 - c * c) + even
    if gloss > 0.0:  # see `brdf.ggx_cos`
        rough = roughness * roughness
        lobe = (1.0 - c * c) + rough * c * c
        back += gloss * (fresnel * rough / (4.0 * lobe * lobe * np.sqrt(c * c + rough * (1.0 - c * c))))
    return back


@compiled()
def one_does(lead, size, fwhm, level, allowed):
    """Whether a single strip is enough: see `strips.counts`."""
    share = min(max(level / max(size, 1e-300), 1e-12), 0.9)
    return np.pi / (16.0 * fwhm) * lead * lead / np.sqrt(share * (1.0 - share)) <= allowed


@compiled()
def strips_wanted(lead, size, fwhm, level, foot, allowed, wide, numbers, feet, shift):
    """See `strips.counts`, of one beam."""
    if one_does(lead, size, fwhm, level, allowed):
        return np.int64(1)
    high, row, last = foot / max(lead * lead * size, 1e-300), 0, len(numbers) - 1
    while row < len(feet) - 1 and high < feet[row]:
        row += 1
    for column in range(last + 1):
        if numbers[column] * fwhm >= wide * lead and (shift[row, column] * lead <= allowed or column == last):
            return numbers[column]
    return np.int64(0)


@compiled()
def _copied(begin, beam, range_m, amplitude, blocked, source, whole, sizes, made):
    """Put sub-echoes of the beam that comes next from number `begin` on; its end there, and among all."""
    one = beam[begin]
    while begin < len(beam) and beam[begin] == one:
        whole[0, made], whole[1, made] = one, source[begin]
        sizes[0, made], sizes[1, made], sizes[2, made] = range_m[begin], amplitude[begin], blocked[begin]
        begin, made = begin + 1, made + 1
    return begin, made


@compiled(
    INTS, ROWS, INTS, WORDS, WORDS, FLOATS, ROWS, TURNS, FLOAT, FLOAT, FLOAT, FLOAT, FLOAT,
    INTS, FLOATS, FLOATS, FLOATS, INTS, INTS, FLOATS, FLOATS, FLOATS, INTS,
)  # fmt: skip
def strips(
    at, rows, count, material, actor, weight, factors, nodes, extinction, k_m2, area, start, full,
    beam, range_m, amplitude, blocked, source, beam_too, range_too, amplitude_too, blocked_too, source_too,
):  # fmt: skip
    """Sub-echoes of the beams `at`: beam and source (2, k), range, amplitude, share (3, k), see `strips.echoes`.

    Between them by beam those of others, from `beam` on, and of others again, from `beam_too` on.
    """
    total = len(beam) + len(beam_too)
    for one in range(len(at)):
        total += count[at[one]]
    whole, sizes = np.empty((2, total), np.int64), np.empty((3, total))
    made = first = second = 0
    for one in range(len(at) + 1):
        i = at[one] if one < len(at) else len(count)
        while True:
            this = beam[first] if first < len(beam) else len(count)
            that = beam_too[second] if second < len(beam_too) else len(count)
            if this < that and this < i:
                first, made = _copied(first, beam, range_m, amplitude, blocked, source, whole, sizes, made)
            elif that < i:
                second, made = _copied(
                    second, beam_too, range_too, amplitude_too, blocked_too, source_too, whole, sizes, made
                )  # fmt: skip
            else:
                break
        if one == len(at):
            break
        own, kind = nodes[count[i]], np.int64(material[i])
        above, leans, facing, turns = rows[0, i], rows[1, i], rows[2, i], rows[3, i]
        beside, cosine, bends = rows[4, i], rows[5, i], rows[6, i]
        lambert, sheen, even = factors[0, kind], factors[1, kind], factors[2, kind]
        gloss, fresnel, roughness = factors[3, kind], factors[4, kind], factors[5, kind]
        for strip in range(count[i]):
            place, share = own[0, strip], own[1, strip]
            r = (above - leans * place) / (facing + turns * place) + beside
            back = reflected(lambert, sheen, even, gloss, fresnel, roughness, cosine + bends * place)
            height = weight[i] * k_m2 * share * back / (r * r + area)
            if extinction > 0.0:
                height *= faded(2.0 * extinction * r)
            if r < start:
                height = 0.0
            elif r < full:
                height *= (r - start) / (full - start)
            whole[0, made], whole[1, made] = i, actor[i]
            sizes[0, made], sizes[1, made], sizes[2, made] = r, height, share
            made += 1
    return whole, sizes
