"""Narrow beams on what rests: their probes cast, and what becomes of each beam, in one pass.

Belongs here: what `probing._judged` does with arrays, of beams that meet nothing, or one smooth surface, or several.
All others are left: those that may meet a moving body, insides of shells, surfaces that need their rays. Not: the
search (packets).
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numpy as np

from emulator.compiled.arithmetic import exp
from emulator.compiled.casting import LONGER, LONGEST
from emulator.compiled.jit import EMBREE, FLAGS, FLOAT, FLOATS, INT, INTS, ROWS, TURNS, WORDS, compiled
from emulator.compiled.packets import DIRECTION, GEOMETRY, TFAR, TRIANGLE, room, send

TOGETHER = 32
"Beams whose rays are held together."
NOTHING, CLOSED, BUNDLE, LEFT = 0, 1, 3, 4
"As in `probing`."


@compiled()
def _touched(ox, oy, oz, ax, ay, az, spheres, spread, pupil, farthest):
    """Whether a beam's cone comes into one of these spheres (4, s) before the farthest that its probes have met."""
    for s in range(spheres.shape[1]):
        x, y, z, radius = spheres[0, s] - ox, spheres[1, s] - oy, spheres[2, s] - oz, spheres[3, s]
        along = x * ax + y * ay + z * az
        wide = radius + pupil + spread * max(along, 0.0)
        if along <= -wide or along - wide > farthest:
            continue
        if x * x + y * y + z * z - along * along <= wide * wide:
            return True
    return False


@compiled(
    *EMBREE, ROWS, TURNS, INTS, ROWS, ROWS, FLOATS, FLOATS, FLOAT, FLOAT, FLOAT, ROWS, INTS, INT, FLAGS, WORDS, WORDS,
    INTS, ROWS, FLOATS, ROWS, ROWS, FLOATS,
)  # fmt: skip
def narrow(
    function, width, scene, arguments, place, frame, order, aim, places, share, centre, far, reach, suspicious,
    plane, body_of, offset, closed, actor_of, material_of, treated, factors, weight, movers, bright, law,
):  # fmt: skip
    """What becomes of n beams: kinds (n,), numbers (5, n), as of `_judged` and ranges along the axis, material
    and actor at the axis (2, n), normals (3, n) there, how many rays were cast, how many distances were suspicious.

    `place` : (3, n) and `frame` : (3, 3, n) axis, left and up of each beam; `order` : (n,) in which they are done;
    `aim` : (5, k) and `places` : (3, k) of the probes; `movers`, `bright` : (4, .) spheres; `law` : (11,) as of
    `Probing`; the rest as in `Around`.
    """
    n, k = place.shape[1], aim.shape[1]
    spread, pupil, square, step, k_m2, area, extinction, start, full, foot, widest = (
        law[0], law[1], law[2], law[3], law[4], law[5], law[6], law[7], law[8], law[9], law[10]
    )  # fmt: skip
    kinds, made = np.empty(n, np.int64), np.zeros((5, n))
    what, normal = np.empty((2, n), np.int32), np.zeros((3, n))
    packet, flags, lanes = room(width)
    most = TOGETHER * k
    origin, way = np.empty((3, most)), np.empty((3, most))
    range_m, facing, triangle = np.empty(most), np.empty(most), np.empty(most, np.int64)
    cast = wrong = 0
    for begin in range(0, n, TOGETHER):
        count = min(TOGETHER, n - begin)
        rays = count * k
        for one in range(count):
            i = order[begin + one]
            for axis in range(3):
                forward, left, up = frame[0, axis, i], frame[1, axis, i], frame[2, axis, i]
                here = place[axis, i] - centre[axis]
                to, by = origin[axis, one * k : one * k + k], way[axis, one * k : one * k + k]
                for p in range(k):
                    by[p] = forward * aim[0, p] + left * aim[1, p] + up * aim[2, p]
                    to[p] = here + left * aim[3, p] + up * aim[4, p]
        for first in range(0, rays, width):
            used = min(width, rays - first)
            for axis in range(3):
                to, by, here, forth = packet[axis], packet[DIRECTION + axis], origin[axis], way[axis]
                for lane in range(used):
                    to[lane] = here[first + lane]
                for lane in range(used):
                    by[lane] = forth[first + lane]
            for lane in range(used):
                packet[TFAR, lane] = min(far * LONGER, LONGEST)
                flags[TRIANGLE, lane] = -1
                flags[GEOMETRY, lane] = -1
                total = packet[0, lane] + packet[1, lane] + packet[2, lane]
                total += packet[DIRECTION, lane] + packet[DIRECTION + 1, lane] + packet[DIRECTION + 2, lane]
                lanes[lane] = -1 if total - total == np.float32(0.0) else 0
            send(function, scene, arguments, packet, lanes, used)
            for lane in range(used):
                ray, at = first + lane, np.int64(flags[TRIANGLE, lane])
                if at < 0 or lanes[lane] == 0:
                    range_m[ray], facing[ray], triangle[ray] = np.inf, 0.0, -1
                    continue
                at += offset
                nx, ny, nz = plane[at, 0], plane[at, 1], plane[at, 2]
                turned = nx * way[0, ray] + ny * way[1, ray] + nz * way[2, ray]
                above = nx * origin[0, ray] + ny * origin[1, ray] + nz * origin[2, ray]
                refined, distance = (plane[at, 3] - above) / turned, packet[TFAR, lane]
                if not abs(refined - distance) <= suspicious * (1.0 + distance):
                    refined = np.float64(distance)
                    wrong += 1
                range_m[ray], facing[ray], triangle[ray] = max(refined, 0.0), turned, at
                if refined > far:
                    range_m[ray], facing[ray], triangle[ray] = np.inf, 0.0, -1
        cast += rays
        for one in range(count):
            i, base = order[begin + one], one * k
            ox, oy, oz = place[0, i], place[1, i], place[2, i]
            ax, ay, az = frame[0, 0, i], frame[0, 1, i], frame[0, 2, i]
            at = triangle[base]
            what[0, i] = what[1, i] = -1
            if at >= 0:
                side = -1.0 if facing[base] > 0.0 else 1.0
                normal[0, i], normal[1, i], normal[2, i] = side * plane[at, 0], side * plane[at, 1], side * plane[at, 2]
                what[0, i], what[1, i] = material_of[at], actor_of[body_of[at]]
            nearest, farthest, met, inner, same = np.inf, -1.0, 0, False, True
            for p in range(k):
                at, r = triangle[base + p], range_m[base + p]
                farthest = max(farthest, r)
                if at < 0:
                    same = False
                    continue
                nearest = min(nearest, r)
                met += r <= reach
                inner |= facing[base + p] > 0.0 and closed[at]
                same = same and material_of[at] == what[0, i] and actor_of[body_of[at]] == what[1, i]
            made[3, i], made[4, i] = nearest if met else np.inf, range_m[base]
            if inner or _touched(ox, oy, oz, ax, ay, az, movers, spread, pupil, farthest):
                kinds[i] = LEFT
                continue
            if _touched(ox, oy, oz, ax, ay, az, bright, spread, pupil, np.inf):
                kinds[i] = BUNDLE
                continue
            if met == 0:
                kinds[i] = NOTHING
                continue
            kinds[i] = BUNDLE
            if met < k or not same:
                continue
            middle = across = upward = 0.0
            for p in range(k):
                inverse = places[0, p] / range_m[base + p]
                middle += inverse / k
                across += inverse * places[1, p] / square
                upward += inverse * places[2, p] / square
            off, axis_m = 0.0, range_m[base]
            for p in range(k):
                here = places[0, p] / range_m[base + p]
                off = max(off, abs(here - middle - across * places[1, p] - upward * places[2, p]))
            if not off * axis_m * axis_m <= step:
                continue
            kind = what[0, i]
            if treated[kind] != CLOSED:
                kinds[i] = BUNDLE if treated[kind] == BUNDLE else LEFT
                continue
            total = mean = least = 0.0
            for p in range(k):
                r, c = range_m[base + p], min(abs(facing[base + p]), 1.0)
                back = factors[0, kind] * c + factors[1, kind] * (1.0 - c * c) + factors[2, kind]
                if factors[3, kind] > 0.0:  # see `brdf.ggx_cos`
                    rough = factors[5, kind] * factors[5, kind]
                    lobe = (1.0 - c * c) + rough * c * c
                    back += factors[3, kind] * (
                        factors[4, kind] * rough / (4.0 * lobe * lobe * np.sqrt(c * c + rough * (1.0 - c * c)))
                    )
                one_height = share[p] * back / (r * r + area)
                if extinction > 0.0:
                    one_height *= exp(-2.0 * extinction * r)
                if r < start:
                    one_height = 0.0
                elif r < full:
                    one_height *= (r - start) / (full - start)
                total += one_height
                mean += one_height * (r - axis_m)
                least = min(least, r - axis_m)
            mean /= total if total > 0.0 else 1.0
            size, lead = weight[i] * k_m2 * total, mean - least
            if not (lead <= 4.0 * step or lead * lead * size <= foot):
                continue
            variance = 0.0
            for p in range(k):
                away = range_m[base + p] - axis_m - mean
                variance += share[p] * away * away
            wide = np.sqrt(variance)
            if wide > widest:
                kinds[i] = LEFT
                continue
            kinds[i] = CLOSED
            made[0, i], made[1, i] = axis_m + mean - wide, axis_m + mean + wide
            made[2, i] = 0.5 * size
    return kinds, made, what, normal, cast, wrong
