"""Rays on bodies that move: which may meet, into the frame of each body, through its box, and what they meet there.

Belongs here: what `fleet.may_meet`, `MovingCast.met` and `hits.keep_nearer` do with arrays. Not: the search (packets).
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numpy as np

from emulator.compiled.jit import (
    EMBREE,
    FLOAT,
    FLOATS,
    INT,
    INTS,
    OUT_FLOATS,
    OUT_INTS,
    OUT_LOOSE,
    ROWS,
    TURNS,
    compiled,
)
from emulator.compiled.packets import TFAR, TRIANGLE, put, room, send


@compiled(ROWS)
def extent(columns):
    """Least and largest number of each row of (r, m)."""
    low, high = np.zeros(len(columns)), np.zeros(len(columns))
    for row in range(len(columns)):
        least = most = columns[row, 0]
        for number in columns[row]:
            least = number if number < least else least
            most = number if number > most else most
        low[row], high[row] = least, most
    return low, high


@compiled(ROWS, FLOATS, FLOATS, ROWS, FLOATS, INT, FLOATS, FLOAT)
def pairs(view, away, reach, axis, half, size, known_m, rounding):
    """Pairs of a sphere and a ray of a cone that it touches before what all of the cone's rays have met.

    `view` : (3, b) unit vectors to the spheres; `away`, `reach` : (b,); `axis`, `half` : of cones of `size` rays each.
    """
    which, rays = np.zeros(4 * size, np.int64), np.zeros(4 * size, np.int64)
    count, m = 0, len(known_m)
    cosines, sines = np.cos(half), np.sin(half)
    for b in range(len(away)):
        inside = away[b] <= reach[b]
        sine = 0.0 if inside else min(reach[b] / away[b], 1.0)
        cosine, width = np.sqrt(1.0 - sine * sine), np.pi if inside else np.arcsin(sine)
        for c in range(len(half)):
            towards = view[0, b] * axis[0, c] + view[1, b] * axis[1, c] + view[2, b] * axis[2, c]
            if towards < cosine * cosines[c] - sine * sines[c] - rounding and width + half[c] < np.pi:
                continue
            first, end = c * size, min(c * size + size, m)
            farthest = 0.0
            for k in range(first, end):
                farthest = max(farthest, known_m[k])
            if away[b] - reach[b] > farthest:
                continue
            if count + size > len(which):
                which = np.concatenate((which, np.zeros_like(which)))
                rays = np.concatenate((rays, np.zeros_like(rays)))
            for k in range(first, end):
                which[count], rays[count] = b, k
                count += 1
    return which[:count], rays[:count]


@compiled(OUT_FLOATS, OUT_INTS, OUT_INTS, OUT_LOOSE, OUT_FLOATS, INTS, FLOATS, INTS, INTS, ROWS, FLOATS)
def keep_nearer(
    range_m, triangle, body, normal, facing, rays, met_range_m, met_triangle, met_body, met_normal, met_facing
):
    """Put hits of `rays` (k,), which may repeat, where nothing is nearer; of equals the last stays."""
    for k in range(len(rays)):
        at = rays[k]
        if met_range_m[k] <= range_m[at]:
            range_m[at], facing[at] = met_range_m[k], met_facing[k]
            triangle[at], body[at] = met_triangle[k], met_body[k]
            normal[0, at], normal[1, at], normal[2, at] = met_normal[0, k], met_normal[1, k], met_normal[2, k]


@compiled(
    *EMBREE, INT, INTS, INTS, ROWS, ROWS, FLOATS, FLOAT, FLOATS,
    ROWS, ROWS, FLOATS, TURNS, ROWS, FLOATS, ROWS, ROWS, INTS, INTS, INTS, INTS, ROWS, TURNS, ROWS, FLOAT,
)  # fmt: skip
def moving(
    function, width, scene, arguments, structure, which, rays, origin, ray, times, far, known_m,
    at, velocity, since, turned, centre, reach, half, cell, shift, home, body, bent, bent_offset, bent_turned,
    plane, suspicious,
):  # fmt: skip
    """What pairs (k,) of a body and a ray meet in one structure of rigid bodies.

    `bent` : (k,) -1, or the column of `bent_offset` (3, .) and `bent_turned` (3, 3, .) where the pair's body does not
    move straight; (0,) where all do. `home` : structure of each body. The rest as in `Movers`, `Stretch` and `Table`.

    Returns rays, triangles, bodies, ranges, normals (3, .) in the world and normal . ray of all hits, how many pairs
    were searched for, and how many distances were suspicious.
    """
    k = len(which)
    numbers, values = np.zeros((4 * width, 3), np.int64), np.zeros((4 * width, 5))
    packet, flags, lanes = room(width)
    # of each lane: its pair, origin and direction in the body's frame, where it enters, the body's axes
    mine, start, way = np.zeros(width, np.int64), np.zeros((width, 3)), np.zeros((width, 3))
    entered, axes = np.zeros(width), np.zeros((width, 3, 3))
    hits = cast = wrong = used = 0
    offset = np.zeros(3)
    for pair in range(k + 1):
        if used == width or (pair == k and used > 0):
            send(function, scene, arguments, packet, lanes, used)
            cast += used
            if hits + used > len(numbers):
                numbers = np.concatenate((numbers, np.zeros_like(numbers)))
                values = np.concatenate((values, np.zeros_like(values)))
            for lane in range(used):
                found = flags[TRIANGLE, lane]
                if found < 0 or not lanes[lane]:
                    continue
                mover, begin, along, own = which[mine[lane]], start[lane], way[lane], axes[lane]
                triangle = found + shift[mover]
                distance = packet[TFAR, lane] + entered[lane]
                nx, ny, nz = plane[0, triangle], plane[1, triangle], plane[2, triangle]
                facing = nx * along[0] + ny * along[1] + nz * along[2]
                refined = (plane[3, triangle] - (nx * begin[0] + ny * begin[1] + nz * begin[2])) / facing
                if not abs(refined - distance) <= suspicious * (1.0 + distance):
                    refined = distance
                    wrong += 1
                numbers[hits, 0], numbers[hits, 1], numbers[hits, 2] = rays[mine[lane]], triangle, body[mover]
                values[hits, 0], values[hits, 1] = max(refined, 0.0), facing
                for i in range(3):
                    values[hits, 2 + i] = own[i, 0] * nx + own[i, 1] * ny + own[i, 2] * nz
                hits += 1
            used = 0
        if pair == k:
            break
        mover, r = which[pair], rays[pair]
        if home[mover] != structure:
            continue
        local, along, to_world = start[used], way[used], axes[used]
        if len(bent) and bent[pair] >= 0:
            for i in range(3):
                offset[i] = bent_offset[i, bent[pair]]
                for j in range(3):
                    to_world[i, j] = bent_turned[i, j, bent[pair]]
        else:
            passed = times[r] - since[mover]
            for i in range(3):
                offset[i] = origin[i, r] - at[i, mover] - passed * velocity[i, mover]
                for j in range(3):
                    to_world[i, j] = turned[i, j, mover]
        middle = 0.0
        for i in range(3):
            # of the sphere's centre, seen from the ray's origin
            row = to_world[i]
            local[i] = offset[i] - (row[0] * centre[0, mover] + row[1] * centre[1, mover] + row[2] * centre[2, mover])
            middle -= local[i] * ray[i, r]
        across = 0.0
        for i in range(3):
            across += (local[i] + middle * ray[i, r]) ** 2
        chord = reach[mover] * reach[mover] - across
        wide = np.sqrt(max(chord, 0.0))
        enter, leave = max(middle - wide, 0.0), middle + wide
        if not (chord > 0.0 and leave > 0.0 and enter <= far and enter < known_m[r]):
            continue
        low, high, unknown = -np.inf, np.inf, False
        for j in range(3):
            local[j] = (
                to_world[0, j] * offset[0] + to_world[1, j] * offset[1] + to_world[2, j] * offset[2] - centre[j, mover]
            )
            along[j] = to_world[0, j] * ray[0, r] + to_world[1, j] * ray[1, r] + to_world[2, j] * ray[2, r]
            each = 1.0 / along[j]
            near, deep = local[j] * each, abs(each) * half[j, mover]
            unknown |= np.isnan(-deep - near) or np.isnan(deep - near)
            low, high = max(low, -deep - near), min(high, deep - near)
        if low > high and not unknown:  # a ray along a side excludes nothing
            continue
        put(packet, flags, lanes, used,
            local[0] + enter * along[0] + cell[0, mover], local[1] + enter * along[1] + cell[1, mover],
            local[2] + enter * along[2] + cell[2, mover], along[0], along[1], along[2], leave - enter)  # fmt: skip
        mine[used], entered[used] = pair, enter
        used += 1
    told, sizes = numbers[:hits].T.copy(), values[:hits].T.copy()
    return told[0], told[1], told[2], sizes[0], sizes[2:], sizes[1], cast, wrong
