"""Light that comes back from surfaces: strength of hits, and sub-echoes in order.

Belongs here: what `paths._meet`, `rays.rays_of` and `order.in_order` do with arrays. Not: Phong's model, mirrors and
glass, which few hits have.
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numpy as np

from emulator.compiled.arithmetic import exp
from emulator.compiled.jit import FLAGS, FLOAT, FLOATS, INT, INT_ROWS, INTS, ROWS, WORDS, compiled


@compiled()
def _end(beam, begin):
    """Where another beam begins."""
    end = begin + 1
    while end < len(beam) and beam[end] == beam[begin]:
        end += 1
    return end


@compiled()
def _places(beam, range_m, reach_m, most_empty, nearest):
    """Numbers (n, most) that sort as the ranges of each beam, and whose last bits are the place in the beam; of hits
    beyond reach the largest. `nearest` is filled.

    Ranges are distinguished to 1e-10 of themselves. (0, 0) where there would be more than `most_empty` places to each.
    """
    m = len(beam)
    ends = np.empty(len(nearest), np.int64)
    groups = most = begin = 0
    while begin < m:
        end = _end(beam, begin)
        ends[groups], most, begin = end, max(most, end - begin), end
        groups += 1
    room = groups * most <= most_empty * m
    none = np.iinfo(np.int64).max
    keys = np.full((groups, most) if room else (0, 0), none)
    # numbers of no sign are in the order of their bits, that which is none behind infinity: whole ones are faster
    bits, limits, least = range_m.view(np.int64), np.array([reach_m, np.inf]).view(np.int64), nearest.view(np.int64)
    reach, place = limits[0], _place_bits(most)
    begin, seen = 0, False
    for row in range(groups):
        end = ends[row]
        own = bits[begin:end]
        lowest = limits[1]
        for column in range(len(own)):
            lowest = min(lowest, own[column])
        least[beam[begin]] = lowest
        if lowest <= reach:
            seen = True
            for column in range(len(own) if room else 0):
                keys[row, column] = (own[column] & ~place) | column if own[column] <= reach else none
        begin = end
    if not seen:
        nearest[:] = np.inf
    return keys, seen


@compiled()
def _place_bits(most):
    """The last bits of a key, which tell the place in a beam of so many."""
    places = 1
    while places < most:
        places *= 2
    return places - 1


@compiled(
    FLOATS, WORDS, FLOATS, INTS, FLOATS, INT, FLOAT, INT,
    ROWS, FLOAT, FLOAT, FLOAT, FLOAT, FLOAT, FLOAT, INTS, FLOATS,
)  # fmt: skip
def strengths(
    range_m, material, cosine, beam, weight, beams, reach_m, most_empty,
    factors, extinction, clear_depth, strength, aperture_m, overlap_start_m, overlap_full_m, more_at, more,
):  # fmt: skip
    """Amplitude (m,) of hits; `_places` of those within `reach_m`, if there are any; each beam's nearest range.

    Columns are (m,), `beam` ascends; `factors` : (6, materials), see `SurfaceTable.factors`; `clear_depth` : optical
    two-way optical depth below which three terms stand for the exponential; `more` : reflectance of the hits `more_at`
    beyond what their materials' factors give.
    """
    nearest = np.full(beams, np.inf)
    keys, seen = _places(beam, range_m, reach_m, most_empty, nearest)
    m = len(range_m) if seen else 0
    flat, rough, retro, lobe, mirror, roughness = (
        factors[0], factors[1], factors[2], factors[3], factors[4], factors[5]
    )  # fmt: skip
    amplitude = np.empty(m)
    for k in range(m):
        kind, c = max(material[k], 0), min(cosine[k], 1.0)
        square = c * c
        back = flat[kind] * c + rough[kind] * (1.0 - square) + retro[kind]
        if lobe[kind] > 0.0:  # see `brdf.ggx_cos`
            wide = roughness[kind] * roughness[kind]
            spread = (1.0 - square) + wide * square
            back += lobe[kind] * (
                mirror[kind] * wide / (4.0 * spread * spread * np.sqrt(square + wide * (1.0 - square)))
            )
        amplitude[k] = back
    for k in range(len(more_at) if m else 0):
        amplitude[more_at[k]] += more[k]
    area = aperture_m * aperture_m
    for k in range(m):
        amplitude[k] *= weight[k] * strength / (range_m[k] * range_m[k] + area)
    for k in range(m):  # each by its own depth: what it brings back does not depend on the others
        depth = extinction * range_m[k]
        if 2.0 * depth < clear_depth:
            amplitude[k] *= 1.0 - 2.0 * depth * (1.0 - depth)
        else:
            amplitude[k] *= exp(-2.0 * depth)
    if m and nearest.min() < max(overlap_start_m, overlap_full_m):
        for k in range(m):
            if range_m[k] < overlap_start_m:
                amplitude[k] = 0.0
            elif range_m[k] < overlap_full_m:
                amplitude[k] *= (range_m[k] - overlap_start_m) / (overlap_full_m - overlap_start_m)
    return amplitude, keys, seen, nearest


@compiled(INT_ROWS, INTS, FLOATS, FLOATS, FLOATS, WORDS)
def in_order(ranks, beam, range_m, amplitude, blocked, actor):
    """Sub-echoes whose sorted `_places` these are: beam and source (2, k), range, amplitude, blocked share (3, k)."""
    none, count = np.iinfo(np.int64).max, 0
    sizes = np.empty(len(ranks), np.int64)
    for row in range(len(ranks)):
        sizes[row] = ranks.shape[1]
        while sizes[row] and ranks[row, sizes[row] - 1] == none:
            sizes[row] -= 1
        count += sizes[row]
    whole, sizes_m = np.empty((2, count), np.int64), np.empty((3, count))
    of, source = whole[0], whole[1]
    length, height, stop = sizes_m[0], sizes_m[1], sizes_m[2]
    place = _place_bits(ranks.shape[1])
    begin = made = 0
    for row in range(len(ranks)):
        for column in range(sizes[row]):
            i = begin + (ranks[row, column] & place)
            of[made], length[made], height[made], stop[made], source[made] = (
                beam[i], range_m[i], amplitude[i], blocked[i], actor[i]
            )  # fmt: skip
            made += 1
        begin = _end(beam, begin)
    return whole, sizes_m


@compiled(FLOATS, WORDS, FLAGS, FLOAT)
def special(range_m, material, of_interest, reach_m):
    """Indexes of hits within reach on these materials (materials,)."""
    found = np.empty(len(range_m), np.int64)
    count = 0
    for k in range(len(range_m)):
        if material[k] >= 0 and of_interest[material[k]] and range_m[k] <= reach_m:
            found[count] = k
            count += 1
    return found[:count].copy()
