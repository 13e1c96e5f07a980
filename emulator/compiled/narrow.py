"""Narrow beams: their probes cast on what rests and on what moves straight, and what becomes of each beam, in one pass.

Belongs here: what `probing._judged` does with arrays, of beams that meet nothing, or one smooth surface, or several.
All others are left: those that may meet a body that turns or is fed, insides of shells, surfaces that need their rays.
Not: the search (packets), rays on what moves (moving).
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numpy as np

from emulator.compiled.casting import LONGER, LONGEST
from emulator.compiled.jit import EMBREE, FLAGS, FLOAT, FLOATS, INT, INTS, ROWS, TURNS, WORDS, compiled
from emulator.compiled.moving import cross
from emulator.compiled.packets import DIRECTION, GEOMETRY, TFAR, TRIANGLE, room, send
from emulator.compiled.strips import one_does, reflected, strips_wanted

TOGETHER = 32
"Beams whose rays are held together."
NOTHING, CLOSED, BUNDLE, LEFT, PANE = 0, 1, 3, 4, 5
"As in `probing`."


@compiled()
def _entered(x, y, z, radius, ax, ay, az, spread, pupil):
    """How far along its axis a beam's cone comes into a sphere that is so far from it; infinite: it does not."""
    along = x * ax + y * ay + z * az
    wide = radius + pupil + spread * max(along, 0.0)
    if along <= -wide or not x * x + y * y + z * z - along * along <= wide * wide:
        return np.inf
    return along - wide


@compiled(
    *EMBREE, ROWS, TURNS, INTS, ROWS, ROWS, FLOATS, FLOATS, FLOAT, FLOAT, FLOAT, ROWS, INTS, INT, FLAGS, WORDS, WORDS,
    INTS, ROWS, FLOATS, ROWS, ROWS, FLOATS, INTS, FLOATS, ROWS,
    FLOATS, ROWS, *EMBREE, ROWS, ROWS, FLOATS, TURNS, ROWS, FLOATS, ROWS, ROWS, INTS, INTS, INTS, INTS, INTS, WORDS,
)  # fmt: skip
def narrow(
    function, width, scene, arguments, place, frame, order, aim, places, share, centre, far, reach, suspicious,
    plane, body_of, offset, closed, actor_of, material_of, treated, factors, weight, movers, bright, law, numbers, feet,
    shift,
    t_s, around, their_function, their_width, their_scene, their_arguments,
    there, velocity, since, turned_by, middle, radius, half, cell, from_slot, home, their_body, part_of, parts_of,
    part_material,
):  # fmt: skip
    """What becomes of n beams: kinds (n,), nearest ranges and those along the axis (2, n), rows (7, n) and counts (n,)
    of their faces, see `strips.Faces`, material and actor at the axis (2, n), normals (3, n) there, how many rays were
    cast, how many of these were searched for in moving bodies, how many distances were suspicious.

    `place` : (3, n) and `frame` : (3, 3, n) axis, left and up of each beam; `order` : (n,) in which they are done;
    `aim` : (5, k) and `places` : (3, k) of the probes; `movers`, `bright` : (4, .) spheres; `law` : numbers as of
    `Probing`; `numbers`, `feet`, `shift` : of strips; from `t_s` on as of `tracing.traced`; the rest as in `Around`.
    Beams that come into spheres of `movers` are left.
    """
    n, k = place.shape[1], aim.shape[1]
    spread, pupil, square, step, k_m2, area = law[0], law[1], law[2], law[3], law[4], law[5]
    wide_x, wide_y, exit_m, turn, tilt, length = law[6], law[7], law[8], law[9], law[10], law[11]
    steepest, fwhm, level, foot, allowed, ripple = law[12], law[13], law[14], law[15], law[16], law[17]
    kinds, made, count_of = np.empty(n, np.int64), np.zeros((2, n)), np.zeros(n, np.int64)
    rows = np.zeros((7, n))
    what, normal = np.empty((2, n), np.int32), np.zeros((3, n))
    packet, flags, lanes = room(width)
    most = TOGETHER * k  # whole packets: a width is a power of two, 16 at the most
    origin, way = np.empty((3, most)), np.empty((3, most))
    range_m, facing, triangle, body = np.empty(most), np.empty(most), np.empty(most, np.int64), np.empty(most, np.int64)
    # the same by packets and by beams: an index that is a sum is looked at for being negative, ray by ray
    starts, ways = origin.reshape(3, most // width, width), way.reshape(3, most // width, width)
    own_starts, own_ways = origin.reshape(3, TOGETHER, k), way.reshape(3, TOGETHER, k)
    ranges, turns_of = range_m.reshape(most // width, width), facing.reshape(most // width, width)
    faces, bodies = triangle.reshape(most // width, width), body.reshape(most // width, width)
    own_ranges, own_turns = range_m.reshape(TOGETHER, k), facing.reshape(TOGETHER, k)
    own_faces, own_bodies = triangle.reshape(TOGETHER, k), body.reshape(TOGETHER, k)
    longest = np.float32(min(far * LONGER, LONGEST))
    rests, they = len(material_of), around.shape[1]
    their_at, turned_normal, times = there.copy(), np.empty((3, most)), np.empty(most)
    which, touched = np.empty(most, np.int64), np.empty(most, np.int64)
    no_bend, no_place, no_turn = np.zeros(0, np.int64), np.zeros((3, 0)), np.zeros((3, 3, 0))
    for axis in range(3):
        their_at[axis] -= centre[axis]
    cast = crossed = wrong = 0
    for begin in range(0, n, TOGETHER):
        count = min(TOGETHER, n - begin)
        rays = count * k
        for one in range(count):
            i = order[begin + one]
            for axis in range(3):
                forward, left, up = frame[0, axis, i], frame[1, axis, i], frame[2, axis, i]
                here = place[axis, i] - centre[axis]
                for p in range(k):
                    own_ways[axis, one, p] = forward * aim[0, p] + left * aim[1, p] + up * aim[2, p]
                    own_starts[axis, one, p] = here + left * aim[3, p] + up * aim[4, p]
        for block in range((rays + width - 1) // width):
            used = min(width, rays - block * width)
            for axis in range(3):
                for lane in range(used):
                    packet[axis, lane] = starts[axis, block, lane]
                for lane in range(used):
                    packet[DIRECTION + axis, lane] = ways[axis, block, lane]
            for lane in range(used):
                packet[TFAR, lane] = longest
            for lane in range(used):
                flags[TRIANGLE, lane] = -1
            for lane in range(used):
                flags[GEOMETRY, lane] = -1
            for lane in range(used):
                total = packet[0, lane] + packet[1, lane] + packet[2, lane]
                total += packet[DIRECTION, lane] + packet[DIRECTION + 1, lane] + packet[DIRECTION + 2, lane]
                lanes[lane] = -1 if total - total == np.float32(0.0) else 0
            send(function, scene, arguments, packet, lanes, used)
            for lane in range(used):
                at = np.int64(flags[TRIANGLE, lane])
                if at < 0 or lanes[lane] == 0:
                    ranges[block, lane], turns_of[block, lane], faces[block, lane] = np.inf, 0.0, -1
                    continue
                at += offset
                nx, ny, nz = plane[at, 0], plane[at, 1], plane[at, 2]
                turned = nx * ways[0, block, lane] + ny * ways[1, block, lane] + nz * ways[2, block, lane]
                above = nx * starts[0, block, lane] + ny * starts[1, block, lane] + nz * starts[2, block, lane]
                refined, distance = (plane[at, 3] - above) / turned, packet[TFAR, lane]
                if not abs(refined - distance) <= suspicious * (1.0 + distance):
                    refined = np.float64(distance)
                    wrong += 1
                beyond = refined > far
                ranges[block, lane] = np.inf if beyond else max(refined, 0.0)
                turns_of[block, lane] = 0.0 if beyond else turned
                faces[block, lane], bodies[block, lane] = -1 if beyond else at, body_of[at]
        cast += rays
        for mover in range(they):
            pairs = 0
            for one in range(count):
                i = order[begin + one]
                entered = _entered(
                    around[0, mover] - place[0, i], around[1, mover] - place[1, i], around[2, mover] - place[2, i],
                    around[3, mover], frame[0, 0, i], frame[0, 1, i], frame[0, 2, i], spread, pupil,
                )  # fmt: skip
                if entered == np.inf:
                    continue
                farthest = -1.0
                for p in range(k):
                    farthest = max(farthest, own_ranges[one, p])
                if entered <= farthest:
                    for p in range(k):
                        which[pairs], touched[pairs], times[one * k + p] = mover, one * k + p, t_s[i]
                        pairs += 1
            if pairs > 0:
                sent, odd = cross(
                    their_function, their_width, their_scene, their_arguments, home[mover], which[:pairs],
                    touched[:pairs], origin, way, times, far,
                    their_at, velocity, since, turned_by, middle, radius, half, cell, from_slot, home, their_body,
                    no_bend, no_place, no_turn, plane, suspicious, range_m, triangle, body, turned_normal, facing,
                )  # fmt: skip
                crossed, wrong = crossed + sent, wrong + odd
                for pair in range(pairs):
                    ray = touched[pair]
                    if range_m[ray] > far:
                        range_m[ray], facing[ray], triangle[ray] = np.inf, 0.0, -1
        for one in range(count):
            i, base = order[begin + one], one * k
            ox, oy, oz = place[0, i], place[1, i], place[2, i]
            ax, ay, az = frame[0, 0, i], frame[0, 1, i], frame[0, 2, i]
            at = own_faces[one, 0]
            what[0, i] = what[1, i] = -1
            if at >= 0:
                side = -1.0 if facing[base] > 0.0 else 1.0
                for axis in range(3):
                    normal[axis, i] = side * (plane[at, axis] if at < rests else turned_normal[axis, base])
                what[0, i] = material_of[at] if at < rests else part_material[parts_of[body[base]] + part_of[at]]
                what[1, i] = actor_of[body[base]]
            nearest, farthest, met, inner, same = np.inf, -1.0, 0, False, True
            for p in range(k):
                at, r = own_faces[one, p], own_ranges[one, p]
                farthest = max(farthest, r)
                if at < 0:
                    same = False
                    continue
                nearest = min(nearest, r)
                met += r <= reach
                inner |= own_turns[one, p] > 0.0 and closed[at]
                whose = own_bodies[one, p]
                own = material_of[at] if at < rests else part_material[parts_of[whose] + part_of[at]]
                same = same and own == what[0, i] and actor_of[whose] == what[1, i]
            made[0, i], made[1, i] = nearest if met else np.inf, own_ranges[one, 0]
            unsure = inner
            for s in range(0 if inner else movers.shape[1]):
                entered = _entered(
                    movers[0, s] - ox, movers[1, s] - oy, movers[2, s] - oz, movers[3, s], ax, ay, az, spread, pupil
                )
                unsure |= entered < np.inf and entered <= farthest
            if unsure:
                kinds[i] = LEFT
                continue
            entered = np.inf
            for s in range(bright.shape[1]):
                entered = min(entered, _entered(
                    bright[0, s] - ox, bright[1, s] - oy, bright[2, s] - oz, bright[3, s], ax, ay, az, spread, pupil
                ))  # fmt: skip
            if entered < np.inf:
                kinds[i] = BUNDLE
                continue
            if met == 0:
                kinds[i] = NOTHING
                continue
            kinds[i] = BUNDLE
            if met < k or not same:
                continue
            kind = np.int64(what[0, i])
            if treated[kind] == BUNDLE:
                continue
            # the plane that the axis meets: see `probing._planes`
            nx, ny, nz = normal[0, i], normal[1, i], normal[2, i]
            left = nx * frame[1, 0, i] + ny * frame[1, 1, i] + nz * frame[1, 2, i]
            up = nx * frame[2, 0, i] + ny * frame[2, 1, i] + nz * frame[2, 2, i]
            one_u, one_v = turn * left + tilt * up, turn * up - tilt * left
            facing_0 = nx * ax + ny * ay + nz * az
            above, above_u, above_v = facing_0 * own_ranges[one, 0], exit_m * one_u, exit_m * one_v
            turns_u, turns_v = wide_x * one_u, wide_y * one_v
            bias, off = 0.0, np.inf  # mean and largest distance of the probes behind it, along them
            for smooth in range(2):
                if smooth:  # the smooth surface through the probes
                    above, above_u, above_v, facing_0, turns_u, turns_v = 1.0, 0.0, 0.0, 0.0, 0.0, 0.0
                    for p in range(k):
                        inverse = places[0, p] / own_ranges[one, p]
                        facing_0 += inverse / k
                        turns_u += inverse * places[1, p] / square
                        turns_v += inverse * places[2, p] / square
                bias = off = 0.0
                for p in range(k):
                    top = above - above_u * places[1, p] - above_v * places[2, p]
                    away = own_ranges[one, p] - places[0, p] * (
                        top / (facing_0 + turns_u * places[1, p] + turns_v * places[2, p])
                    )
                    off = away if away > off else -away if -away > off else off if away == away else np.inf
                    bias += share[p] * away
                if off <= step:
                    break
            if not off <= step:
                continue
            if treated[kind] != CLOSED:
                kinds[i] = PANE if treated[kind] == PANE else LEFT
                continue
            slope_u, slope_v = turns_u / facing_0 + above_u / above, turns_v / facing_0 + above_v / above
            slope = np.hypot(slope_u, slope_v)
            if not slope <= steepest:
                continue
            to_u, to_v = (slope_u / slope, slope_v / slope) if slope > 0.0 else (1.0, 0.0)
            cosine = bends = 0.0
            for p in range(k):
                c = abs(own_turns[one, p])
                cosine += c / k
                bends += c * (places[1, p] * to_u + places[2, p] * to_v) / square
            leans, turns = above_u * to_u + above_v * to_v, turns_u * to_u + turns_v * to_v
            near = length * (above - leans) / (facing_0 + turns)
            back = reflected(
                factors[0, kind], factors[1, kind], factors[2, kind], factors[3, kind], factors[4, kind],
                factors[5, kind], cosine,
            )  # fmt: skip
            size = weight[i] * k_m2 * back / (near * near + area)
            lead = max(length * above / facing_0 - near, 0.0)
            count_of[i] = 1
            if not one_does(lead, size, fwhm, level, allowed):  # tables are handed over for few
                count_of[i] = strips_wanted(lead, size, fwhm, level, foot, allowed, ripple, numbers, feet, shift)
            if count_of[i] == 0:
                continue
            kinds[i] = CLOSED
            rows[0, i], rows[1, i], rows[2, i], rows[3, i] = length * above, length * leans, facing_0, turns
            rows[4, i], rows[5, i], rows[6, i] = bias, cosine, bends
    return kinds, made, rows, count_of, what, normal, cast, crossed, wrong
