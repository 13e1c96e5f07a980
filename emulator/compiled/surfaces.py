"""Light that comes back from surfaces: incidence and strength of hits, and sub-echoes in order.

Belongs here: what `paths._meet`, `rays.rays_of` and `order.in_order` do with arrays, where each ray can be taken alone.
Not: Phong's model, and what goes on through glass, which few hits have.
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numpy as np

from emulator.compiled.jit import FLOAT, FLOATS, INT, INT_ROWS, INTS, ROWS, WORDS, compiled

NOTHING = -575.0
"Exponent below which light is nothing, see `physics.arrays`."


@compiled(
    ROWS, ROWS, FLOATS, WORDS, WORDS, INTS, FLOATS, FLOATS, INT, FLOAT,
    ROWS, FLOAT, FLOAT, FLOAT, FLOAT, FLOAT, FLOAT,
)  # fmt: skip
def lit(
    normal, direction, range_m, material, actor, beam, weight, share, beams, reach_m,
    factors, extinction, clear_depth, strength, aperture_m, overlap_start_m, overlap_full_m,
):  # fmt: skip
    """Of hits within `reach_m`: beam, range, cosine of incidence, what a white plate there would return, reflectance
    but for Phong's, share of the beam, actor, material, their numbers; and (`beams`,) the nearest range of each beam.

    `normal`, `direction` : (3, m), others (m,); `factors` : (6, materials), see `SurfaceTable.factors`; `clear_depth` :
    optical depth there and back below which three terms stand for the exponential.
    """
    count, nearest = 0, np.full(beams, np.inf)
    for k in range(len(range_m)):
        if range_m[k] < nearest[beam[k]]:
            nearest[beam[k]] = range_m[k]
        count += range_m[k] <= reach_m
    chosen = np.zeros(count, np.int64)
    of, actors, kinds = np.zeros(count, np.int64), np.zeros(count, np.int32), np.zeros(count, np.int32)
    length, cosine, plate, reflectance, stop = (
        np.zeros(count), np.zeros(count), np.zeros(count), np.zeros(count), np.zeros(count)
    )  # fmt: skip
    nx, ny, nz = normal[0], normal[1], normal[2]
    dx, dy, dz = direction[0], direction[1], direction[2]
    closest, farthest = np.inf, 0.0
    k = 0
    for i in range(len(range_m)):
        r = range_m[i]
        if r <= reach_m:
            length[k], stop[k], plate[k] = r, share[i], weight[i]
            of[k], actors[k], kinds[k], chosen[k] = beam[i], actor[i], material[i], i
            cosine[k] = -(nx[i] * dx[i] + ny[i] * dy[i] + nz[i] * dz[i])
            closest = r if r < closest else closest
            farthest = r if r > farthest else farthest
            k += 1
    area = aperture_m * aperture_m
    for k in range(count):
        plate[k] *= strength / (length[k] * length[k] + area)
    if 2.0 * extinction * farthest < clear_depth:
        for k in range(count):
            depth = extinction * length[k]
            plate[k] *= 1.0 - 2.0 * depth * (1.0 - depth)
    else:
        for k in range(count):
            depth = 2.0 * extinction * length[k]
            plate[k] *= np.exp(-depth) if -depth >= NOTHING else 0.0
    if closest < max(overlap_start_m, overlap_full_m):
        for k in range(count):
            if length[k] < overlap_start_m:
                plate[k] = 0.0
            elif length[k] < overlap_full_m:
                plate[k] *= (length[k] - overlap_start_m) / (overlap_full_m - overlap_start_m)
    flat, rough, retro, lobe, mirror, roughness = (
        factors[0], factors[1], factors[2], factors[3], factors[4], factors[5]
    )  # fmt: skip
    for k in range(count):
        kind, c = kinds[k], min(abs(cosine[k]), 1.0)
        square = c * c
        back = flat[kind] * c + rough[kind] * (1.0 - square) + retro[kind]
        if lobe[kind] > 0.0:  # see `brdf.ggx_cos`
            wide = roughness[kind] * roughness[kind]
            spread = (1.0 - square) + wide * square
            back += lobe[kind] * (
                mirror[kind] * wide / (4.0 * spread * spread * np.sqrt(square + wide * (1.0 - square)))
            )
        reflectance[k] = back
    if count == 0:
        nearest[:] = np.inf
    return of, length, cosine, plate, reflectance, stop, actors, kinds, chosen, nearest


@compiled(ROWS, INT)
def repeated(position, times):
    """(3, n times) of (n, 3): each row as often, a coordinate at a time."""
    n = len(position)
    out = np.zeros((3, n * times))
    for i in range(3):
        row = out[i]
        for k in range(n):
            value = position[k, i]
            for at in range(k * times, (k + 1) * times):
                row[at] = value
    return out


@compiled()
def _place_bits(most):
    """The last bits of a key, which tell the place in a beam of so many."""
    places = 1
    while places < most:
        places *= 2
    return places - 1


@compiled(INTS, FLOATS, INT)
def keys(beam, range_m, most_empty):
    """Numbers (n, most) that sort as the ranges of each beam, and whose last bits are the place in the beam.

    `beam` : (m,), ascending; n of them, with at most so many each. Ranges are told apart to 1e-10 of themselves. (0, 0)
    where beams do not ascend, or where there would be more than `most_empty` places to each range.
    """
    m = len(beam)
    groups = most = size = 0
    for k in range(m):
        if k == 0 or beam[k] > beam[k - 1]:
            groups, size = groups + 1, 0
        elif beam[k] < beam[k - 1]:
            return np.zeros((0, 0), np.int64)
        size += 1
        most = size if size > most else most
    if groups * most > most_empty * m:
        return np.zeros((0, 0), np.int64)
    out = np.full((groups, most), np.iinfo(np.int64).max)
    bits, place = range_m.view(np.int64), _place_bits(most)
    row, column = -1, 0
    for k in range(m):
        if k == 0 or beam[k] != beam[k - 1]:
            row, column = row + 1, 0
        out[row, column] = (bits[k] & ~place) | column
        column += 1
    return out


@compiled(INT_ROWS, INTS, FLOATS, FLOATS, FLOATS, WORDS)
def in_order(ranks, beam, range_m, amplitude, blocked, actor):
    """Sub-echoes by the sorted `keys`: range, amplitude, blocked share and source."""
    m, most = len(beam), ranks.shape[1]
    length, height, stop, source = np.zeros(m), np.zeros(m), np.zeros(m), np.zeros(m, np.int64)
    row, first, place = -1, 0, _place_bits(most)
    for k in range(m):
        if k == 0 or beam[k] != beam[k - 1]:
            row, first = row + 1, k
        i = first + (ranks[row, k - first] & place)
        length[k], height[k], stop[k], source[k] = range_m[i], amplitude[i], blocked[i], actor[i]
    return length, height, stop, source
