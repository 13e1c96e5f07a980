"""Rays on what rests: where they enter, what they meet, and how far that is, in one pass.

Belongs here: what `Caster._cast_around`, `_cast_afar` and `_told` do with arrays, but for what few ask for. Not: the
search (packets), moving bodies (moving).
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numpy as np

from emulator.compiled.jit import (
    EMBREE,
    FLAG,
    FLOAT,
    FLOATS,
    INT,
    INTS,
    OUT_FLAGS,
    OUT_FLOATS,
    OUT_INTS,
    ROWS,
    WORDS,
    compiled,
)
from emulator.compiled.packets import TFAR, TRIANGLE, put, put_all, room, send

LONGEST = 1e30
"Stands for an unlimited ray in float32."
LONGER = 1.0 + 1e-6
"So much farther than asked for a search looks: what lies just at the end of a ray is met, and judged in float64."


@compiled(
    *EMBREE, ROWS, ROWS, INTS, FLOATS, FLOAT, FLOAT, FLOAT, ROWS, INTS, INT, FLAG,
    OUT_FLOATS, OUT_INTS, OUT_INTS, OUT_FLOATS,
)  # fmt: skip
def resting(
    function, width, scene, arguments, origin, ray, order, centre, radius, far, suspicious,
    plane, body_of, offset, first, range_m, triangle, body, facing,
):  # fmt: skip
    """Put what rays meet of one group where nothing is nearer. How many were searched for, and how many suspicious.

    `origin`, `ray` : (3, m) in the world; `order` : (m,) in which they are searched for, (0,): as they come; `radius` :
    of the group's sphere, infinite where rays begin in it; `plane` : (F, 4) and `body_of` : (F,) of all triangles;
    `first` : nothing is known yet; the rest as in `Nearest`.
    """
    packet, flags, lanes = room(width)
    which, entered = np.zeros(width, np.int64), np.zeros(width)
    cast = wrong = used = 0
    m = len(range_m)
    around = radius == np.inf
    if first:
        range_m[:], triangle[:], body[:], facing[:] = np.inf, -1, -1, 0.0
    k = 0
    while k < m:
        if around:
            used = min(width, m - k)
            for lane in range(used):
                which[lane] = order[k + lane] if len(order) else k + lane
            put_all(packet, flags, lanes, which, used, origin, ray, centre, min(far * LONGER, LONGEST))
            k += used
        else:
            used = 0
            while k < m and used < width:
                i = order[k] if len(order) else k
                x, y, z = origin[0, i] - centre[0], origin[1, i] - centre[1], origin[2, i] - centre[2]
                dx, dy, dz = ray[0, i], ray[1, i], ray[2, i]
                middle = -(x * dx + y * dy + z * dz)
                ax, ay, az = x + middle * dx, y + middle * dy, z + middle * dz
                chord = radius * radius - (ax * ax + ay * ay + az * az)
                half = np.sqrt(max(chord, 0.0))
                enter = max(middle - half, 0.0)
                if chord > 0.0 and middle + half > 0.0 and enter <= far and enter < range_m[i]:
                    put(packet, flags, lanes, used,
                        x + enter * dx, y + enter * dy, z + enter * dz, dx, dy, dz, LONGEST)  # fmt: skip
                    which[used], entered[used] = i, enter
                    used += 1
                k += 1
            if used == 0:
                break
        send(function, scene, arguments, packet, lanes, used)
        cast += used
        for lane in range(used):
            found = flags[TRIANGLE, lane]
            if found < 0 or not lanes[lane]:
                continue
            i, at = which[lane], found + offset
            distance = packet[TFAR, lane] + entered[lane]
            nx, ny, nz = plane[at, 0], plane[at, 1], plane[at, 2]
            turned = nx * ray[0, i] + ny * ray[1, i] + nz * ray[2, i]
            height = nx * (origin[0, i] - centre[0]) + ny * (origin[1, i] - centre[1]) + nz * (origin[2, i] - centre[2])
            refined = (plane[at, 3] - height) / turned
            if not abs(refined - distance) <= suspicious * (1.0 + distance):
                refined = distance
                wrong += 1
            refined = max(refined, 0.0)
            if refined <= range_m[i]:
                range_m[i], triangle[i], body[i], facing[i] = refined, at, body_of[at], turned
    return cast, wrong


def unwritten(count):
    """Columns of `Nearest`, for `resting` to write; normals are written and read of hits on moving bodies alone."""
    return np.empty(count), np.empty(count, np.int64), np.empty(count, np.int64), np.empty((3, count)), np.empty(count)


@compiled(OUT_FLOATS, INTS, INTS, FLOATS, FLOAT, OUT_FLAGS, WORDS, WORDS, INTS, INTS, WORDS)
def reported(range_m, triangle, body, facing, far, inner, actor_of, material_of, part_of, parts_of, part_material):
    """Actor and material (2, m), and cosine (m,) of hits. Ranges and `inner` are made those of hits, in place.

    `material_of` : of the merged triangles, the first ones; for others it is looked up by body and part.
    """
    m = len(triangle)
    whole, cosine = np.empty((2, m), np.int32), np.empty(m)
    actor, material = whole[0], whole[1]
    for k in range(m):
        at = triangle[k]
        if at < 0 or range_m[k] > far:
            range_m[k], inner[k] = np.nan, False
            actor[k], material[k], cosine[k] = -1, -1, 0.0
            continue
        actor[k], cosine[k] = actor_of[body[k]], abs(facing[k])
        material[k] = material_of[at] if at < len(material_of) else part_material[parts_of[body[k]] + part_of[at]]
    return whole, cosine
