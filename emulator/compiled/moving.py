"""Rays on bodies that move: which may meet, into the frame of each body, through its box, and what they meet there.

Belongs here: what `batched_poses.may_meet` and `MovingCast.met` do with arrays.
Not: the search (packets).
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
    ROWS,
    TURNS,
    compiled,
)
from emulator.compiled.packets import TFAR, TRIANGLE, put, room, send


@compiled()
def _away(place, b, low, high):
    """From the middle of a box to a sphere, (4,): a vector and its length."""
    x = place[0, b] - (low[0] + (high[0] - low[0]) / 2.0)
    y = place[1, b] - (low[1] + (high[1] - low[1]) / 2.0)
    z = place[2, b] - (low[2] + (high[2] - low[2]) / 2.0)
    return x, y, z, np.sqrt(x * x + y * y + z * z)


@compiled()
def _room(low, high):
    """From the middle of a box to its corners."""
    x, y, z = (high[0] - low[0]) / 2.0, (high[1] - low[1]) / 2.0, (high[2] - low[2]) / 2.0
    return np.sqrt(x * x + y * y + z * z)


@compiled(ROWS, FLOATS, FLOATS, FLOATS, FLOAT)
def near(place, reach, low, high, far):
    """How many spheres are not out of reach."""
    room, count = _room(low, high), 0
    for b in range(len(reach)):
        count += _away(place, b, low, high)[3] - (reach[b] + room) <= far
    return count


@compiled(ROWS, FLOATS, FLOATS, FLOATS, FLOAT, ROWS, FLOATS, INT, FLOATS, FLOAT)
def pairs(place, reach, low, high, far, axis, half, size, known_m, rounding):
    """Pairs of a sphere and a ray of a cone that it touches before what all of the cone's rays have met, (2, k).

    `place` : (3, b) and `reach` : (b,) of the spheres; `low`, `high` : (3,) box of the rays' origins; `axis`, `half` :
    of cones of `size` rays each.
    """
    found = np.empty((2, 4 * size), np.int64)
    count, m = 0, len(known_m)
    cosines, sines, farthest = np.cos(half), np.sin(half), np.full(len(half), -1.0)
    room = _room(low, high)
    for b in range(len(reach)):
        x, y, z, away = _away(place, b, low, high)
        radius = reach[b] + room
        if away - radius > far:
            continue
        inside = away <= radius
        sine = 0.0 if inside else radius / away
        cosine, width = np.sqrt(1.0 - sine * sine), np.pi if inside else np.arcsin(sine)
        if not inside:
            x, y, z = x / away, y / away, z / away
        for c in range(len(half)):
            towards = x * axis[0, c] + y * axis[1, c] + z * axis[2, c]
            if towards < cosine * cosines[c] - sine * sines[c] - rounding and width + half[c] < np.pi:
                continue
            first, end = c * size, min(c * size + size, m)
            if farthest[c] < 0.0:
                for k in range(first, end):
                    farthest[c] = max(farthest[c], known_m[k])
            if away - radius > farthest[c]:
                continue
            if count + size > found.shape[1]:
                found = np.concatenate((found, np.empty_like(found)), axis=1)
            for k in range(first, end):
                found[0, count], found[1, count] = b, k
                count += 1
    return found[:, :count].copy()


@compiled()
def _crosses(place, along, half):
    """Where a ray enters and leaves the slab of a box; nothing is excluded along a side, where that is no number."""
    each = 1.0 / along
    middle, deep = place * each, abs(each) * half
    low, high = -deep - middle, deep - middle
    if np.isnan(low) or np.isnan(high):
        return -np.inf, np.inf
    return low, high


@compiled(
    *EMBREE, INT, INTS, INTS, ROWS, ROWS, FLOATS, FLOAT, FLOATS,
    ROWS, ROWS, FLOATS, TURNS, ROWS, FLOATS, ROWS, ROWS, INTS, INTS, INTS, INTS, ROWS, TURNS, ROWS, FLOAT,
)  # fmt: skip
def moving(
    function, width, scene, arguments, structure, which, rays, origin, ray, times, far, known_m,
    at, velocity, since, turned, centre, reach, half, cell, shift, home, body, bent, bent_at, bent_turned,
    plane, suspicious,
):  # fmt: skip
    """What pairs (k,) of a body and a ray meet in one structure of rigid bodies.

    `bent` : (k,) -1, or the column of `bent_at` (3, .) and `bent_turned` (3, 3, .) where the pair's body does not
    move straight; (0,) where all do. `home` : structure of each body. The rest as in `Movers`, `Stretch` and `Table`.

    Returns rays, triangles and bodies (3, .), ranges, normal . ray and normals (5, .) in the world of all hits, how
    many pairs were searched for, and how many distances were suspicious.
    """
    k = len(which)
    numbers, values = np.zeros((4 * width, 3), np.int64), np.zeros((4 * width, 5))
    packet, flags, lanes = room(width)
    # of each lane: its pair, where it enters, and origin, direction and the body's axes in the body's frame
    mine, entered, frames = np.zeros(width, np.int64), np.zeros(width), np.zeros((width, 15))
    hits = cast = wrong = used = 0
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
                mover = which[mine[lane]]
                triangle = found + shift[mover]
                distance = packet[TFAR, lane] + entered[lane]
                nx, ny, nz = plane[triangle, 0], plane[triangle, 1], plane[triangle, 2]
                facing = nx * frames[lane, 3] + ny * frames[lane, 4] + nz * frames[lane, 5]
                height = nx * frames[lane, 0] + ny * frames[lane, 1] + nz * frames[lane, 2]
                refined = (plane[triangle, 3] - height) / facing
                if not abs(refined - distance) <= suspicious * (1.0 + distance):
                    refined = distance
                    wrong += 1
                numbers[hits, 0], numbers[hits, 1], numbers[hits, 2] = rays[mine[lane]], triangle, body[mover]
                values[hits, 0], values[hits, 1] = max(refined, 0.0), facing
                values[hits, 2] = frames[lane, 6] * nx + frames[lane, 7] * ny + frames[lane, 8] * nz
                values[hits, 3] = frames[lane, 9] * nx + frames[lane, 10] * ny + frames[lane, 11] * nz
                values[hits, 4] = frames[lane, 12] * nx + frames[lane, 13] * ny + frames[lane, 14] * nz
                hits += 1
            used = 0
        if pair == k:
            break
        mover, r = which[pair], rays[pair]
        if home[mover] != structure:
            continue
        dx, dy, dz = ray[0, r], ray[1, r], ray[2, r]
        column = bent[pair] if len(bent) else -1
        if column >= 0:
            ox = origin[0, r] - bent_at[0, column]
            oy = origin[1, r] - bent_at[1, column]
            oz = origin[2, r] - bent_at[2, column]
            xx, xy, xz = bent_turned[0, 0, column], bent_turned[0, 1, column], bent_turned[0, 2, column]
            yx, yy, yz = bent_turned[1, 0, column], bent_turned[1, 1, column], bent_turned[1, 2, column]
            zx, zy, zz = bent_turned[2, 0, column], bent_turned[2, 1, column], bent_turned[2, 2, column]
        else:
            passed = times[r] - since[mover]
            ox = origin[0, r] - at[0, mover] - passed * velocity[0, mover]
            oy = origin[1, r] - at[1, mover] - passed * velocity[1, mover]
            oz = origin[2, r] - at[2, mover] - passed * velocity[2, mover]
            xx, xy, xz = turned[0, 0, mover], turned[0, 1, mover], turned[0, 2, mover]
            yx, yy, yz = turned[1, 0, mover], turned[1, 1, mover], turned[1, 2, mover]
            zx, zy, zz = turned[2, 0, mover], turned[2, 1, mover], turned[2, 2, mover]
        cx, cy, cz = centre[0, mover], centre[1, mover], centre[2, mover]
        # of the sphere's centre, seen from the ray's origin
        sx, sy = ox - (xx * cx + xy * cy + xz * cz), oy - (yx * cx + yy * cy + yz * cz)
        sz = oz - (zx * cx + zy * cy + zz * cz)
        middle = -(sx * dx + sy * dy + sz * dz)
        ax, ay, az = sx + middle * dx, sy + middle * dy, sz + middle * dz
        chord = reach[mover] * reach[mover] - (ax * ax + ay * ay + az * az)
        if not chord > 0.0:
            continue
        wide = np.sqrt(chord)
        enter, leave = max(middle - wide, 0.0), middle + wide
        if not (leave > 0.0 and enter <= far and enter < known_m[r]):
            continue
        x, y, z = (
            xx * ox + yx * oy + zx * oz - cx, xy * ox + yy * oy + zy * oz - cy, xz * ox + yz * oy + zz * oz - cz
        )  # fmt: skip
        dx, dy, dz = xx * dx + yx * dy + zx * dz, xy * dx + yy * dy + zy * dz, xz * dx + yz * dy + zz * dz
        x_in, x_out = _crosses(x, dx, half[0, mover])
        y_in, y_out = _crosses(y, dy, half[1, mover])
        z_in, z_out = _crosses(z, dz, half[2, mover])
        if max(x_in, y_in, z_in) > min(x_out, y_out, z_out):
            continue
        put(packet, flags, lanes, used, x + enter * dx + cell[0, mover], y + enter * dy + cell[1, mover],
            z + enter * dz + cell[2, mover], dx, dy, dz, leave - enter)  # fmt: skip
        mine[used], entered[used] = pair, enter
        frames[used, 0], frames[used, 1], frames[used, 2] = x, y, z
        frames[used, 3], frames[used, 4], frames[used, 5] = dx, dy, dz
        frames[used, 6], frames[used, 7], frames[used, 8] = xx, xy, xz
        frames[used, 9], frames[used, 10], frames[used, 11] = yx, yy, yz
        frames[used, 12], frames[used, 13], frames[used, 14] = zx, zy, zz
        used += 1
    return numbers[:hits].T.copy(), values[:hits].T.copy(), cast, wrong
