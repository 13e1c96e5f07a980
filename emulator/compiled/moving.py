"""Rays on bodies that move: which may meet, into the frame of each body, through its box, and what they meet there.

Belongs here: what `batched_poses.may_meet` and `MovingCast.met` do with arrays.
Not: the search (packets).
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numpy as np

from emulator.compiled.casting import LONGER
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

NEARLY_M = 1e-5
"So much behind what a ray has met a search looks: what lies there is judged in float64."


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


@compiled(ROWS, INT)
def cones(ray, size):
    """Of each `size` neighbours among rays (3, m) the middle (3, c), and the half angle, as `Cones.of` has them."""
    m = ray.shape[1]
    count = (m + size - 1) // size
    axis, half = np.empty((3, count)), np.empty(count)
    for c in range(count):
        first, end = c * size, min(c * size + size, m)
        more = c * size + size - end  # the last ray so many times again
        x = y = z = 0.0
        for k in range(first, end):
            x, y, z = x + ray[0, k], y + ray[1, k], z + ray[2, k]
        x, y, z = x + more * ray[0, m - 1], y + more * ray[1, m - 1], z + more * ray[2, m - 1]
        length = max(np.sqrt(x * x + y * y + z * z), 1e-30)
        x, y, z, least = x / length, y / length, z / length, 1.0
        for k in range(first, end):
            least = min(least, ray[0, k] * x + ray[1, k] * y + ray[2, k] * z)
        axis[0, c], axis[1, c], axis[2, c], half[c] = x, y, z, np.arccos(max(least, -1.0)) + 1e-6
    return axis, half


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


TOGETHER = 64
"Rays that are brought into the frame of a body together: rows of them leave no cache, and are done by four."


@compiled()
def _narrowed(low, high, place, along, half):
    """Where rays enter and leave the slab of a box, if that is less; one along a side is not narrowed there."""
    for i in range(len(low)):
        each = 1.0 / along[i]
        middle, deep = place[i] * each, abs(each) * half
        first, last = -deep - middle, deep - middle
        number = first == first and last == last
        low[i] = first if number and first > low[i] else low[i]
        high[i] = last if number and last < high[i] else high[i]


@compiled()
def _even(rows, r, n, times, origin, at, velocity, since, mover):
    """Origins of rays r to r + n as seen from that of a body that moves straight, in the world."""
    when, moment = times[r : r + n], since[mover]
    for axis in range(3):
        to, start, place, speed = rows[axis, :n], origin[axis, r : r + n], at[axis, mover], velocity[axis, mover]
        for i in range(n):
            to[i] = start[i] - place - (when[i] - moment) * speed


@compiled()
def _placed(rows, r, n, origin, at, column):
    """The same of a body that is there at the instant of them all."""
    for axis in range(3):
        to, start, place = rows[axis, :n], origin[axis, r : r + n], at[axis, column]
        for i in range(n):
            to[i] = start[i] - place


@compiled()
def _through(rows, ray, r, n, known_m, turned, column, centre, reach, half, far, mover):
    """Whether rays r to r + n come into the sphere and the box of a body before what they met; `column` of its pose.

    Rows of (15, .): origins about the body's, in the world; where they enter and leave the sphere, less than nothing
    where they do not; origins and directions in its frame.
    """
    x, y, z, middle, chord, enter, leave = (
        rows[0, :n], rows[1, :n], rows[2, :n], rows[3, :n], rows[4, :n], rows[5, :n], rows[6, :n]
    )  # fmt: skip
    dx, dy, dz = ray[0, r : r + n], ray[1, r : r + n], ray[2, r : r + n]
    xx, xy, xz = turned[0, 0, column], turned[0, 1, column], turned[0, 2, column]
    yx, yy, yz = turned[1, 0, column], turned[1, 1, column], turned[1, 2, column]
    zx, zy, zz = turned[2, 0, column], turned[2, 1, column], turned[2, 2, column]
    cx, cy, cz = centre[0, mover], centre[1, mover], centre[2, mover]
    # of the sphere's centre, seen from the body's origin
    sx, sy, sz = xx * cx + xy * cy + xz * cz, yx * cx + yy * cy + yz * cz, zx * cx + zy * cy + zz * cz
    for i in range(n):
        middle[i] = -((x[i] - sx) * dx[i] + (y[i] - sy) * dy[i] + (z[i] - sz) * dz[i])
    square = reach[mover] * reach[mover]
    for i in range(n):
        ax, ay, az = x[i] - sx + middle[i] * dx[i], y[i] - sy + middle[i] * dy[i], z[i] - sz + middle[i] * dz[i]
        chord[i] = square - (ax * ax + ay * ay + az * az)
    for i in range(n):
        wide = np.sqrt(chord[i] if chord[i] > 0.0 else 0.0)
        first = middle[i] - wide
        enter[i] = first if first > 0.0 else 0.0
    known, some = known_m[r : r + n], False
    for i in range(n):
        last = middle[i] + np.sqrt(chord[i] if chord[i] > 0.0 else 0.0)
        good = chord[i] > 0.0 and last > 0.0 and enter[i] <= far and enter[i] < known[i]
        leave[i] = last if good else -1.0
    for i in range(n):
        some |= leave[i] >= 0.0
    if not some:
        return False
    for axis in range(3):
        place, along = rows[7 + axis, :n], rows[10 + axis, :n]
        a, b, c, d = turned[0, axis, column], turned[1, axis, column], turned[2, axis, column], centre[axis, mover]
        for i in range(n):
            place[i] = a * x[i] + b * y[i] + c * z[i] - d
        for i in range(n):
            along[i] = a * dx[i] + b * dy[i] + c * dz[i]
    low, high = rows[13, :n], rows[14, :n]
    low[:], high[:] = -np.inf, np.inf
    for axis in range(3):
        _narrowed(low, high, rows[7 + axis, :n], rows[10 + axis, :n], half[axis, mover])
    return True


@compiled()
def _put_nearer(packet, flags, lanes, used, mine, frames, turned, bent_turned, shift, body_of, plane, suspicious,
                range_m, triangle, body, normal, facing):  # fmt: skip
    """What the lanes of a packet have met, where nothing is nearer; how many distances were suspicious."""
    wrong = 0
    for lane in range(used):
        found = flags[TRIANGLE, lane]
        if found < 0 or not lanes[lane]:
            continue
        mover, r, column = mine[0, lane], mine[1, lane], mine[2, lane]
        at = found + shift[mover]
        distance = packet[TFAR, lane] + frames[6, lane]
        nx, ny, nz = plane[at, 0], plane[at, 1], plane[at, 2]
        turn = nx * frames[3, lane] + ny * frames[4, lane] + nz * frames[5, lane]
        height = nx * frames[0, lane] + ny * frames[1, lane] + nz * frames[2, lane]
        refined = (plane[at, 3] - height) / turn
        if not abs(refined - distance) <= suspicious * (1.0 + distance):
            refined = distance
            wrong += 1
        refined = max(refined, 0.0)
        if not refined <= range_m[r]:
            continue
        range_m[r], triangle[r], body[r], facing[r] = refined, at, body_of[mover], turn
        for axis in range(3):
            if column >= 0:
                a, b, c = bent_turned[axis, 0, column], bent_turned[axis, 1, column], bent_turned[axis, 2, column]
            else:
                a, b, c = turned[axis, 0, mover], turned[axis, 1, mover], turned[axis, 2, mover]
            normal[axis, r] = a * nx + b * ny + c * nz
    return wrong


@compiled()
def cross(
    function, width, scene, arguments, structure, which, rays, origin, ray, times, far,
    at, velocity, since, turned, centre, reach, half, cell, shift, home, body_of, bent, bent_at, bent_turned,
    plane, suspicious, range_m, triangle, body, normal, facing,
):  # fmt: skip
    """Put what pairs (k,) of a body and a ray meet in one structure of rigid bodies where nothing is nearer.

    `bent` : (k,) -1, or the column of `bent_at` (3, .) and `bent_turned` (3, 3, .) where the pair's body does not
    move straight; (0,) where all do. `home` : structure of each body. Columns from `range_m` on are those of `Nearest`.
    The rest as in `Movers`, `Stretch` and `Table`.

    Returns how many pairs were searched for, and how many distances were suspicious.
    """
    k = len(which)
    packet, flags, lanes = room(width)
    # of each lane: body, ray and column of its pose; origin and direction in the body's frame, where it enters
    mine, frames, rows = np.zeros((3, width), np.int64), np.zeros((7, width)), np.empty((15, TOGETHER))
    cast = wrong = used = pair = 0
    while pair < k:
        mover, r, n = which[pair], rays[pair], 1
        column = bent[pair] if len(bent) else -1
        if home[mover] != structure:
            pair += 1
            continue
        while n < TOGETHER and pair + n < k and which[pair + n] == mover and rays[pair + n] == r + n:
            if len(bent) and bent[pair + n] != column:
                break
            n += 1
        if column >= 0:
            _placed(rows, r, n, origin, bent_at, column)
            some = _through(rows, ray, r, n, range_m, bent_turned, column, centre, reach, half, far, mover)
        else:
            _even(rows, r, n, times, origin, at, velocity, since, mover)
            some = _through(rows, ray, r, n, range_m, turned, mover, centre, reach, half, far, mover)
        pair += n
        for i in range(n if some else 0):
            enter, leave = rows[5, i], rows[6, i]
            if not (leave >= 0.0 and rows[13, i] <= rows[14, i]):
                continue
            dx, dy, dz = rows[10, i], rows[11, i], rows[12, i]
            until = min(leave - enter, (range_m[r + i] - enter) * LONGER + NEARLY_M)
            put(packet, flags, lanes, used, rows[7, i] + enter * dx + cell[0, mover],
                rows[8, i] + enter * dy + cell[1, mover], rows[9, i] + enter * dz + cell[2, mover], dx, dy, dz,
                until)  # fmt: skip
            mine[0, used], mine[1, used], mine[2, used], frames[6, used] = mover, r + i, column, enter
            for axis in range(6):
                frames[axis, used] = rows[7 + axis, i]
            used += 1
            if used == width:
                send(function, scene, arguments, packet, lanes, used)
                wrong += _put_nearer(packet, flags, lanes, used, mine, frames, turned, bent_turned, shift,
                                     body_of, plane, suspicious, range_m, triangle, body, normal, facing)  # fmt: skip
                cast, used = cast + used, 0
    if used > 0:
        send(function, scene, arguments, packet, lanes, used)
        wrong += _put_nearer(packet, flags, lanes, used, mine, frames, turned, bent_turned, shift, body_of, plane,
                             suspicious, range_m, triangle, body, normal, facing)  # fmt: skip
    return cast + used, wrong


@compiled(
    *EMBREE, INT, INTS, INTS, ROWS, ROWS, FLOATS, FLOAT,
    ROWS, ROWS, FLOATS, TURNS, ROWS, FLOATS, ROWS, ROWS, INTS, INTS, INTS, INTS, ROWS, TURNS, ROWS, FLOAT,
    OUT_FLOATS, OUT_INTS, OUT_INTS, OUT_LOOSE, OUT_FLOATS,
)  # fmt: skip
def moving(
    function, width, scene, arguments, structure, which, rays, origin, ray, times, far,
    at, velocity, since, turned, centre, reach, half, cell, shift, home, body_of, bent, bent_at, bent_turned,
    plane, suspicious, range_m, triangle, body, normal, facing,
):  # fmt: skip
    """See `cross`."""
    return cross(
        function, width, scene, arguments, structure, which, rays, origin, ray, times, far,
        at, velocity, since, turned, centre, reach, half, cell, shift, home, body_of, bent, bent_at, bent_turned,
        plane, suspicious, range_m, triangle, body, normal, facing,
    )  # fmt: skip
