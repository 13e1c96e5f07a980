"""Bundles of narrow beams on what rests or moves straight, in one pass: cast, followed through panes and from mirrors.

Belongs here: what `paths.returned` and `through.Ways` do with arrays, of beams all of whose rays meet bodies at rest,
from outside, of materials without a law of their own. All others are left to arrays. Not: the search (packets).
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numpy as np

from emulator.compiled.arithmetic import faded
from emulator.compiled.casting import LONGER, LONGEST
from emulator.compiled.jit import EMBREE, FLAG, FLAGS, FLOATS, INT, INTS, ROWS, TURNS, WORDS, compiled
from emulator.compiled.moving import cross
from emulator.compiled.packets import DIRECTION, GEOMETRY, TFAR, TRIANGLE, put, room, send
from emulator.compiled.strips import reflected, strips_wanted

LEAK_TURN_RAD = 1e-6
"As of `raycast`."
TOGETHER = 288
"Rays whose beams are followed together, about."
LEFT, DONE, UNEVEN = 0, 1, 2
"What becomes of a beam: arrays do it; it is done; its probes do not stand for what they see through a pane."
PLAIN, GLASS, MIRROR, REFUSED = 0, 1, 2, 3
"Materials, by what happens to a ray on them; on the last it is left."
PLACE_BITS, RANGE_BITS = 12, 34
"Of numbers that sort as range and place in the beam: ranges are distinguished to 2^-34 of the reach."
MOST_COUNTED = 256
"Sub-echoes of a beam up to which to count those that come before each, eight at a time, is faster than to sort."
X, Y, Z, AHEAD, LEFTWARD, UP, WEIGHT, LENGTH, DEPTH, AIR, TIME = range(11)
"Columns of a ray under way: origin about the structure's, direction, those of `paths._Front`, its instant."


@compiled()
def _shares(kind, n, internal, specular, cosine):
    """Mirrored and let through, one way: see `SurfaceTable.sent_on`."""
    c = min(cosine, 1.0)
    slant = 1.0 - (1.0 - c * c) / (n * n)
    inside = np.sqrt(slant)
    s_sum, p_sum = c + n * inside, n * c + inside
    rs = ((c - n * inside) / s_sum) ** 2 if s_sum > 0.0 else 1.0
    rp = ((n * c - inside) / p_sum) ** 2 if p_sum > 0.0 else 1.0
    if kind == MIRROR:
        return 0.5 * (rs + rp) if specular != specular else specular, 0.0
    t = internal ** (1.0 / np.sqrt(max(slant, 1e-18))) if internal < 1.0 else 1.0
    mirrored = through = 0.0
    for r in (rs, rp):
        back, passed = r * t, (1.0 - r) * (1.0 - r) * t
        passed /= max(1.0 - back * back, 1e-300)
        mirrored += 0.5 * (r + back * passed)
        through += 0.5 * passed
    return mirrored, through


@compiled()
def _back_into_the_lens(nx, ny, nz, ax, ay, az, length, wide_x, wide_y, exit_m, aperture_m):
    """Whether a flat mirror may send the beam back into the lens: see `paths._face_on`."""
    x, y, z = ny * az - nz * ay, nz * ax - nx * az, nx * ay - ny * ax
    offset = 2.0 * length * np.sqrt(x * x + y * y + z * z) / max(abs(nx * ax + ny * ay + nz * az), 1e-6)
    return offset < 6.0 * (max(wide_x, wide_y) * 2.0 * length + exit_m) + aperture_m


@compiled()
def _meets(sphere, x, y, z, dx, dy, dz, until):
    """Whether a ray comes into one of these spheres (4, s) before its end."""
    for s in range(sphere.shape[1]):
        to_x, to_y, to_z, radius = sphere[0, s] - x, sphere[1, s] - y, sphere[2, s] - z, sphere[3, s]
        along = to_x * dx + to_y * dy + to_z * dz
        if along <= -radius or along - radius > until:
            continue
        if to_x * to_x + to_y * to_y + to_z * to_z - along * along <= radius * radius:
            return True
    return False


@compiled()
def _meeting(sphere, rays, range_m, count, square, which):
    """Numbers of those of the first `count` rays that come into one sphere before their ends, and how many they are."""
    cx, cy, cz, radius = sphere[0], sphere[1], sphere[2], sphere[3]
    x, y, z, dx, dy, dz = rays[X], rays[Y], rays[Z], rays[AHEAD], rays[LEFTWARD], rays[UP]
    limit = radius * radius
    for i in range(count):
        to_x, to_y, to_z = cx - x[i], cy - y[i], cz - z[i]
        along = to_x * dx[i] + to_y * dy[i] + to_z * dz[i]
        off = to_x * to_x + to_y * to_y + to_z * to_z - along * along
        square[i] = off if along > -radius and along - radius <= range_m[i] else np.inf
    found = 0
    for i in range(count):
        which[found] = i
        found += square[i] <= limit
    return found


@compiled()
def _is_inside(function, scene, arguments, packet, flags, lanes, plane, closed, offset, spheres, x, y, z, dx, dy, dz,
               until):  # fmt: skip
    """Whether a ray meets the inside of a closed shell at rest again that is turned a little: see
    `Caster._recast_leaks`. False also where something moves."""
    way = np.array([dx, dy, dz])
    least = np.argmin(np.abs(way))
    one, other = (least + 1) % 3, (least + 2) % 3
    length = np.sqrt(way[one] * way[one] + way[other] * way[other])
    turned = way.copy()
    turned[one] += LEAK_TURN_RAD * way[other] / length
    turned[other] -= LEAK_TURN_RAD * way[one] / length
    turned /= np.sqrt((turned * turned).sum())
    put(packet, flags, lanes, 0, x, y, z, turned[0], turned[1], turned[2], min(until * LONGER, LONGEST))
    send(function, scene, arguments, packet, lanes, 1)
    face = np.int64(flags[TRIANGLE, 0])
    if face < 0 or lanes[0] == 0:
        return False
    face += offset
    facing = plane[face, 0] * turned[0] + plane[face, 1] * turned[1] + plane[face, 2] * turned[2]
    if not (facing > 0.0 and closed[face]):
        return False
    return not _meets(spheres, x, y, z, turned[0], turned[1], turned[2], np.float64(packet[TFAR, 0]))


@compiled()
def _even(r, light, places, judge, numbers, feet, shift, most_strips):
    """Ranges (k,) of one smooth surface, of which a few strips would do: see `through._even`."""
    step, square, count = judge[0], judge[1], len(r)
    middle = u = v = 0.0
    least = np.inf
    for p in range(count):
        inverse = places[0, p] / r[p]
        middle += inverse / count
        u += inverse * places[1, p] / square
        v += inverse * places[2, p] / square
        least = min(least, r[p])
    for p in range(count):
        if not abs(r[p] - places[0, p] / (middle + u * places[1, p] + v * places[2, p])) <= step:
            return False
    wanted = strips_wanted(
        max(r[0] - least, 0.0), light, judge[2], judge[3], judge[4], judge[5], judge[6], numbers, feet, shift
    )
    return 0 < wanted <= most_strips


@compiled()
def _all_even(begin, end, way, branches, seen, kind, places, judge, numbers, feet, shift, most_strips):
    """The same of the rays `begin` to `end` of a beam, way by way, all of whose probes must have taken it."""
    count = places.shape[1]
    r = np.empty(count)
    for branch in range(branches):
        found, light, same = 0, 0.0, True
        first = -1
        for i in range(begin, end):
            if way[i] != branch:
                continue
            if found == count:
                return False
            first = i if found == 0 else first
            same = same and kind[0, i] == kind[0, first] and kind[1, i] == kind[1, first]
            r[found] = seen[0, i]
            light += seen[1, i]
            found += 1
        if found == 0:
            continue
        if found < count or not same:
            return False
        if kind[0, first] >= 0 and not _even(r, light, places, judge, numbers, feet, shift, most_strips):
            return False
    return True


@compiled(
    *EMBREE, ROWS, TURNS, INTS, FLOATS, ROWS, FLOATS, INT, FLOATS, FLOATS, ROWS, INTS, INT, FLAGS, WORDS, WORDS, FLAGS,
    ROWS, ROWS, INTS, ROWS, FLOATS, INT, FLAG, ROWS, FLOATS, INTS, FLOATS, ROWS, INT,
    FLOATS, ROWS, *EMBREE, ROWS, ROWS, FLOATS, TURNS, ROWS, FLOATS, ROWS, ROWS, INTS, INTS, INTS, INTS, INTS, WORDS,
)  # fmt: skip
def traced(
    function, width, scene, arguments, place, frame, at, phase, nodes, share, first_node, centre, limits,
    plane, body_of, offset, closed, actor_of, material_of, solid, movers, factors, kinds_of, optics, weight, bounces,
    judged, places, judge, numbers, feet, shift, most_strips,
    t_s, around, their_function, their_width, their_scene, their_arguments,
    there, velocity, since, turned_by, middle, radius, half, cell, from_slot, home, their_body, part_of, parts_of,
    part_material,
):  # fmt: skip
    """What becomes of the beams `at`, see `DONE`; nearest ranges; material at the axis and normal (3, .) there; beam
    and actor (2, k) and range, amplitude, blocked share (3, k) of their sub-echoes by beam and range, of beams that are
    done; how many rays were cast, how many distances were suspicious.

    `place` : (3, n) and `frame` : (3, 3, n) axis, left and up of each beam; `phase` : of those `at`, by which their
    bundles of `nodes` : (2, m) and `share` are turned; `limits` : numbers in the order of `sensing.traced`; `optics` :
    (3, materials) index, internal transmission, specular share; `judged` : whether the probes must see smooth surfaces
    only, by `places` : (3, m) of them; `t_s` : (n,); `around` : (4, b) spheres that hold the moving bodies meanwhile;
    from `their_function` on as of `moving.cross` and `casting.reported`; the rest as of `narrow`. Beams that come into
    spheres of `movers` are left.
    """
    tan_x, tan_y, exit_m, turn, tilt, far, reach = (
        limits[0], limits[1], limits[2], limits[3], limits[4], limits[5], limits[6]
    )  # fmt: skip
    alpha, clear_depth, k_m2, area, start, full = limits[7], limits[8], limits[9], limits[10], limits[11], limits[12]
    strongest, least, behind, suspicious = limits[13], limits[14], limits[15], limits[16]
    aperture_m, wide_x, wide_y = np.sqrt(area), limits[17], limits[18]
    n, m = len(at), nodes.shape[1]
    verdict, nearest = np.full(n, DONE), np.full(n, np.inf)
    what, normal = np.full(n, -1, np.int32), np.zeros((3, n))
    spheres, aim = movers.copy(), np.empty((5, m))
    for i in range(3):
        spheres[i] -= centre[i]
    packet, flags, lanes = room(width)
    group = max(1, TOGETHER // m)
    most = (group * m * 2**bounces + 2 * width - 1) // (2 * width) * 2 * width  # halves of whole packets
    theirs, their_at = around.copy(), there.copy()
    for i in range(3):
        theirs[i] -= centre[i]
        their_at[i] -= centre[i]
    rays, later = np.empty((11, most)), np.empty((11, most))
    body, turned_normal = np.empty(most, np.int64), np.empty((3, most))
    which, touched = np.empty(most, np.int64), np.empty(most, np.int64)
    squares, some_left = np.empty(most), spheres.shape[1] > 0
    no_bend, no_place, no_turn = np.zeros(0, np.int64), np.zeros((3, 0)), np.zeros((3, 3, 0))
    tags, later_tags = np.empty((3, most), np.int64), np.empty((3, most), np.int64)  # beam, way, body it is inside of
    range_m, facing, triangle = np.empty(most), np.empty(most), np.empty(most, np.int64)
    ranges, turns = range_m.reshape(most // width, width), facing.reshape(most // width, width)
    faces, bodies = triangle.reshape(most // width, width), body.reshape(most // width, width)
    seen, kind_of = np.empty((2, most)), np.empty((2, most), np.int64)
    own = np.empty((3, 2 * most))  # sub-echoes of a group
    own_tag = np.empty((2, 2 * most), np.int64)
    whole, sizes = np.empty((2, 2 * n * m), np.int64), np.empty((3, 2 * n * m))
    key, place_of, scale = np.empty(2 * most, np.int64), np.empty(2 * most, np.int64), (2.0**RANGE_BITS - 1.0) / reach
    ranked = np.empty(2 * most, np.int64)
    starts, filled = np.zeros(group + 1, np.int64), np.zeros(group, np.int64)
    made = cast = wrong = 0
    for begin in range(0, n, group):
        count = min(group, n - begin)
        for one in range(count):
            i, base = at[begin + one], one * m
            cos_p, sin_p = np.cos(phase[begin + one]), np.sin(phase[begin + one])
            for p in range(m):
                u, v = cos_p * nodes[0, p] - sin_p * nodes[1, p], sin_p * nodes[0, p] + cos_p * nodes[1, p]
                across, upward = turn * tan_x * u - tilt * tan_y * v, tilt * tan_x * u + turn * tan_y * v
                length = np.sqrt(1.0 + across * across + upward * upward)
                aim[0, p], aim[1, p], aim[2, p] = 1.0 / length, across / length, upward / length
                aim[3, p], aim[4, p] = exit_m * (turn * u - tilt * v), exit_m * (tilt * u + turn * v)
            for axis in range(3):
                forward, left, up = frame[0, axis, i], frame[1, axis, i], frame[2, axis, i]
                here, mine = place[axis, i] - centre[axis], slice(base, base + m)
                starts_of, ways_of = rays[X + axis, mine], rays[AHEAD + axis, mine]
                for p in range(m):
                    starts_of[p] = here + left * aim[3, p] + up * aim[4, p]
                for p in range(m):
                    ways_of[p] = forward * aim[0, p] + left * aim[1, p] + up * aim[2, p]
            for p in range(m):
                rays[WEIGHT, base + p], rays[LENGTH, base + p], rays[DEPTH, base + p] = weight[i] * share[p], 0.0, 0.0
                rays[AIR, base + p], rays[TIME, base + p] = share[p], t_s[i]
                tags[0, base + p], tags[1, base + p], tags[2, base + p] = one, 0, -1
        under_way, echoes = count * m, 0
        for bounce in range(bounces + 1):
            # by packets: an index that is a sum is looked at for being negative, ray by ray
            of_packets = rays.reshape(11, most // width, width)
            for block in range((under_way + width - 1) // width):
                used = min(width, under_way - block * width)
                for axis in range(3):
                    for lane in range(used):
                        packet[axis, lane] = of_packets[X + axis, block, lane]
                    for lane in range(used):
                        packet[DIRECTION + axis, lane] = of_packets[AHEAD + axis, block, lane]
                for lane in range(used):
                    longest = far if bounce == 0 else reach - of_packets[LENGTH, block, lane]
                    packet[TFAR, lane] = min(longest * LONGER, LONGEST)
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
                    face = np.int64(flags[TRIANGLE, lane])
                    ranges[block, lane], turns[block, lane], faces[block, lane] = np.inf, 0.0, -1
                    if face < 0 or lanes[lane] == 0:
                        continue
                    face += offset
                    nx, ny, nz = plane[face, 0], plane[face, 1], plane[face, 2]
                    x, y, z = of_packets[X, block, lane], of_packets[Y, block, lane], of_packets[Z, block, lane]
                    dx, dy = of_packets[AHEAD, block, lane], of_packets[LEFTWARD, block, lane]
                    dz = of_packets[UP, block, lane]
                    turned, above = nx * dx + ny * dy + nz * dz, nx * x + ny * y + nz * z
                    refined, distance = (plane[face, 3] - above) / turned, packet[TFAR, lane]
                    if not abs(refined - distance) <= suspicious * (1.0 + distance):
                        refined = np.float64(distance)
                        wrong += 1
                    if bounce == 0 and refined > far:
                        continue
                    ranges[block, lane], turns[block, lane], faces[block, lane] = max(refined, 0.0), turned, face
                    bodies[block, lane] = body_of[face]
            limit = far if bounce == 0 else reach
            for mover in range(theirs.shape[1]):
                pairs = _meeting(theirs[:, mover], rays, range_m, under_way, squares, touched)
                if pairs > 0:
                    which[:pairs] = mover
                    sent, odd = cross(
                        their_function, their_width, their_scene, their_arguments, home[mover], which[:pairs],
                        touched[:pairs], rays[X : Z + 1], rays[AHEAD : UP + 1], rays[TIME], limit,
                        their_at, velocity, since, turned_by, middle, radius, half, cell, from_slot, home, their_body,
                        no_bend, no_place, no_turn, plane, suspicious, range_m, triangle, body, turned_normal, facing,
                    )  # fmt: skip
                    cast, wrong = cast + sent, wrong + odd
            cast += under_way
            going, passing = 0, most // 2  # mirrored ones, and those through panes: each sort shares its searches
            for ray in range(under_way):
                one = tags[0, ray]
                of, face, r = begin + one, triangle[ray], range_m[ray]
                seen[0, ray] = seen[1, ray] = np.inf
                kind_of[0, ray] = kind_of[1, ray] = -1
                if verdict[of] != DONE:
                    continue
                x, y, z = rays[X, ray], rays[Y, ray], rays[Z, ray]
                dx, dy, dz = rays[AHEAD, ray], rays[LEFTWARD, ray], rays[UP, ray]
                before = rays[LENGTH, ray]
                until = min(r, far if bounce == 0 else reach - before)
                beyond = bounce == 0 and r > far
                if some_left and _meets(spheres, x, y, z, dx, dy, dz, until):
                    verdict[of] = LEFT
                    continue
                if face < 0 or beyond:
                    continue
                inner = facing[ray] > 0.0 and closed[face]
                if inner and (bounce == 0 or body[ray] != tags[2, ray]):  # it may have slipped into a shell
                    if face >= len(material_of) or not _is_inside(
                        function, scene, arguments, packet, flags, lanes, plane, closed, offset, theirs,
                        x, y, z, dx, dy, dz, limit - before,
                    ):  # fmt: skip
                        verdict[of] = LEFT
                        continue
                met, side = body[ray], -1.0 if facing[ray] > 0.0 else 1.0
                if face < len(material_of):
                    kind = np.int64(material_of[face])
                    nx, ny, nz = side * plane[face, 0], side * plane[face, 1], side * plane[face, 2]
                else:
                    kind = np.int64(part_material[parts_of[met] + part_of[face]])
                    nx, ny, nz = (
                        side * turned_normal[0, ray],
                        side * turned_normal[1, ray],
                        side * turned_normal[2, ray],
                    )
                if bounce == 0:
                    nearest[of] = min(nearest[of], r)
                    if ray - one * m == first_node:
                        what[of], normal[0, of], normal[1, of], normal[2, of] = kind, nx, ny, nz
                length = before + r
                if length > reach:
                    continue
                if kinds_of[kind] == REFUSED:
                    verdict[of] = LEFT
                    continue
                cosine, depth = abs(facing[ray]), rays[DEPTH, ray] + alpha * r
                stopped = rays[AIR, ray]
                if kinds_of[kind] != PLAIN and bounce < bounces:
                    mirrored, through = _shares(
                        kinds_of[kind], optics[0, kind], optics[1, kind], optics[2, kind], cosine
                    )
                    i = at[of]
                    if through > 0.0 and solid[met] and not inner:
                        verdict[of] = LEFT  # it is bent
                        continue
                    if bounce == 0 and mirrored > 0.0 and _back_into_the_lens(
                        nx, ny, nz, frame[0, 0, i], frame[0, 1, i], frame[0, 2, i], length, wide_x, wide_y, exit_m,
                        aperture_m,
                    ):  # fmt: skip
                        verdict[of] = LEFT
                        continue
                    stopped -= rays[AIR, ray] * through * through if through > 0.0 else 0.0
                    bound = m * strongest * k_m2 * rays[WEIGHT, ray] / (length * length + area)
                    step = behind * (1.0 + length / 1000.0)
                    for passed in range(2):
                        part = through if passed else mirrored
                        if not (part > 0.0 and bound * part * part > least and length < reach):
                            continue
                        onward, to = 2.0 * cosine, going
                        if passed:
                            onward, to, passing = 0.0, passing, passing + 1
                        else:
                            going += 1
                        tx, ty, tz = dx + onward * nx, dy + onward * ny, dz + onward * nz
                        later[X, to], later[Y, to], later[Z, to] = (
                            x + r * dx + step * tx, y + r * dy + step * ty, z + r * dz + step * tz
                        )  # fmt: skip
                        later[AHEAD, to], later[LEFTWARD, to], later[UP, to] = tx, ty, tz
                        later[WEIGHT, to], later[LENGTH, to] = rays[WEIGHT, ray] * part * part, length + step
                        later[DEPTH, to], later[TIME, to] = depth, rays[TIME, ray]
                        later[AIR, to] = rays[AIR, ray] * part * part if passed else 0.0
                        later_tags[0, to], later_tags[1, to] = one, 2 * tags[1, ray] + passed
                        later_tags[2, to] = -1 if inner == (passed == 1) else met
                lost = 1.0 - 2.0 * depth * (1.0 - depth) if 2.0 * depth < clear_depth else faded(2.0 * depth)
                back = reflected(
                    factors[0, kind], factors[1, kind], factors[2, kind], factors[3, kind], factors[4, kind],
                    factors[5, kind], cosine,
                )  # fmt: skip
                height = rays[WEIGHT, ray] * k_m2 * lost * back / (length * length + area)
                if length < start:
                    height = 0.0
                elif length < full:
                    height *= (length - start) / (full - start)
                seen[0, ray], seen[1, ray] = length, height
                kind_of[0, ray], kind_of[1, ray] = kind, actor_of[met]
                own[0, echoes], own[1, echoes], own[2, echoes] = length, height, stopped
                own_tag[0, echoes], own_tag[1, echoes] = one, kind_of[1, ray]
                echoes += 1
            if judged:
                ray = 0
                while ray < under_way:
                    end, of = ray, begin + tags[0, ray]
                    while end < under_way and tags[0, end] == tags[0, ray]:
                        end += 1
                    if bounce == 0:  # the panes themselves
                        back, kind = 0.0, np.int64(what[of])
                        if kind >= 0:
                            back = reflected(
                                factors[0, kind], factors[1, kind], factors[2, kind], factors[3, kind],
                                factors[4, kind], factors[5, kind], abs(facing[ray]),
                            )  # fmt: skip
                        light = weight[at[of]] * k_m2 / (nearest[of] * nearest[of] + area) * back
                        if verdict[of] == DONE and not _even(
                            seen[0, ray:end], light, places, judge, numbers, feet, shift, most_strips
                        ):
                            verdict[of] = UNEVEN
                    elif verdict[of] == DONE and not _all_even(
                        ray, end, tags[1], 2**bounce, seen, kind_of, places, judge, numbers, feet, shift, most_strips
                    ):
                        verdict[of] = UNEVEN
                    ray = end
            for ray in range(most // 2, passing):
                for row in range(11):  # a column as a whole would be copied into memory of its own first
                    later[row, going] = later[row, ray]
                for row in range(3):
                    later_tags[row, going] = later_tags[row, ray]
                going += 1
            if going == 0:
                break
            rays, later, tags, later_tags, under_way = later, rays, later_tags, tags, going
        if made + echoes > whole.shape[1]:
            more, larger = np.empty((2, 2 * (made + echoes)), np.int64), np.empty((3, 2 * (made + echoes)))
            more[:, :made], larger[:, :made] = whole[:, :made], sizes[:, :made]
            whole, sizes = more, larger
        starts[:] = 0
        for k in range(echoes):
            if verdict[begin + own_tag[0, k]] == DONE:
                starts[own_tag[0, k] + 1] += 1
        for one in range(count):
            starts[one + 1] += starts[one]
            filled[one] = 0
        for k in range(echoes):
            one = own_tag[0, k]
            if verdict[begin + one] == DONE:
                key[starts[one] + filled[one]] = (np.int64(own[0, k] * scale) << PLACE_BITS) + filled[one]
                place_of[starts[one] + filled[one]] = k
                filled[one] += 1
        for one in range(count):
            first, last = starts[one], starts[one + 1]
            if last - first > MOST_COUNTED:
                key[first:last].sort()
                for to in range(first, last):
                    ranked[to] = place_of[first + (key[to] & ((1 << PLACE_BITS) - 1))]
            else:
                keys = key[first:last]
                for place_ in range(last - first):
                    this, earlier = keys[place_], 0
                    for other in range(last - first):
                        earlier += keys[other] < this
                    ranked[first + earlier] = place_of[first + place_]
            for to in range(first, last):
                k = ranked[to]
                whole[0, made + to], whole[1, made + to] = at[begin + one], own_tag[1, k]
                sizes[0, made + to], sizes[1, made + to], sizes[2, made + to] = own[0, k], own[1, k], own[2, k]
        made += starts[count]
    return verdict, nearest, what, normal, whole[:, :made], sizes[:, :made], cast, wrong
