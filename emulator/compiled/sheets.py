"""Bright faces beside beams: which come near, where they are in a beam's own coordinates, which places they cover.

Belongs here: what `sheets.Sheets.near` does with arrays, and `polygons.within` for one place. Not: faces that reach
behind a pupil, which arrays cut, and the light on them.
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numpy as np

from emulator.compiled.jit import FLAGS, FLOATS, INTS, ROWS, TURNS, compiled

NEAR = 1e-3
"As in `polygons`."
ROOM = 512
"Faces for which there is room at first."
MARGIN = 1e-9
"Of metres, and of ways: more than spheres that hold a sheet during a sweep are rounded by."


@compiled()
def _radii(distance, strength, law):
    """As `sheets.Radii`: law from 6 on is its numbers in their order."""
    distance = max(distance, law[6])
    bound = law[7] / (distance * distance + law[8]) * strength
    most = np.exp(2.0 * law[11] * law[11])
    radii = np.sqrt(0.5 * np.log(min(max(bound / law[9], 1.0), most)))
    return max(radii, law[10]) if radii > 0.0 else 0.0


@compiled()
def _offset(u, v):
    """Least distance of a triangle from the axis; 0 around it."""
    least, inner, outer = np.inf, True, True
    for k in range(3):
        a, b, c, d = u[k], v[k], u[(k + 1) % 3], v[(k + 1) % 3]
        x, y = c - a, d - b
        square = max(x * x + y * y, 1e-300)
        part = min(max(-(a * x + b * y) / square, 0.0), 1.0)
        foot_u, foot_v = a + part * x, b + part * y
        least = min(least, foot_u * foot_u + foot_v * foot_v)
        side = x * (0.0 - b) - y * (0.0 - a)
        inner, outer = inner and side >= 0.0, outer and side <= 0.0
    return 0.0 if inner or outer else np.sqrt(least)


@compiled()
def own_frame(axis, cos_roll, sin_roll, own):
    """Rows along u, v and the axis of a beam into `own` (3, 3), as `sheets.across_own` has them."""
    x, y, z = axis[0], axis[1], axis[2]
    level = np.hypot(x, y)
    cosine, sine = (x / level, y / level) if level > 0.0 else (1.0, y)
    left_x, left_y = -sine, cosine
    up_x, up_y, up_z = -z * cosine, -z * sine, level
    own[0, 0], own[0, 1] = cos_roll * left_x + sin_roll * up_x, cos_roll * left_y + sin_roll * up_y
    own[0, 2] = sin_roll * up_z
    own[1, 0], own[1, 1] = cos_roll * up_x - sin_roll * left_x, cos_roll * up_y - sin_roll * left_y
    own[1, 2] = cos_roll * up_z
    own[2, 0], own[2, 1], own[2, 2] = x, y, z


@compiled()
def _widest(nearest, away, size, strength, tangent, w0, law):
    """Least cosine between the way to a sphere's middle and a beam in whose tail it may lie; 2: none."""
    most = _radii(nearest, strength, law)
    if not most > 0.0:
        return 2.0
    wide = (size + most * w0) / max(away, 1e-9)
    angle = np.arcsin(min(wide, 1.0)) + np.arctan(most * tangent)
    return (np.cos(angle) if wide < 1.0 and angle < np.pi else -2.0) - 1e-12


@compiled()
def _whereabouts(t_s, place):
    """Middle and half of the time and of the box of the sensor's places, (2,), (3,) and its half diagonal."""
    first = last = t_s[0]
    low, high = place[0].copy(), place[0].copy()
    for b in range(len(t_s)):
        first, last = min(first, t_s[b]), max(last, t_s[b])
        for i in range(3):
            low[i], high[i] = min(low[i], place[b, i]), max(high[i], place[b, i])
    way = high - low
    slack = 0.5 * np.sqrt(way[0] * way[0] + way[1] * way[1] + way[2] * way[2])
    return 0.5 * (first + last), 0.5 * (last - first), 0.5 * (low + high), slack


@compiled()
def _grown(which, sizes, corners, normals, frames):
    """The same with twice the room."""
    return (
        np.concatenate((which, np.empty_like(which)), axis=1), np.concatenate((sizes, np.empty_like(sizes)), axis=1),
        np.concatenate((corners, np.empty_like(corners))), np.concatenate((normals, np.empty_like(normals))),
        np.concatenate((frames, np.empty_like(frames))),
    )  # fmt: skip


@compiled(
    ROWS, ROWS, FLOATS, TURNS, INTS, ROWS, FLOATS, ROWS, TURNS, ROWS, TURNS, ROWS, ROWS, FLOATS, INTS,
    INTS, INTS, ROWS, FLOATS, FLOATS, TURNS, ROWS, FLOATS, FLAGS, FLOATS, FLOATS,
)  # fmt: skip
def beside(
    at, velocity, since, turned_by, bent, held, held_m, bent_at, bent_turned, place, turn, own_axis, axis, t_s, home,
    first, many, middle, radius, strength, corner, normal, behind, closed, face_strength, law,
):  # fmt: skip
    """Of sheets and beams the pairs with a face that comes into the beam's tail, by sheet and beam.

    `at`, `velocity` : (3, b), `since` : (b,) and `turned_by` : (3, 3, b) of the sheets' bodies, as `Stretch` has them;
    `bent` : (b,) -1, or which of those that do not move straight; `held` : (s, 3) and `held_m` : (s,) spheres that hold
    the sheets of these; `bent_at` : (c n, 3) and `bent_turned` : (c n, 3, 3) their poses as each beam fires; `place`,
    `turn`, `own_axis`, `axis`, `t_s` : of the n beams; `home` : body of each sheet; `first` to `strength` : of the
    sheets; `corner` to `face_strength` : of all faces; `law` : tangents, radius at the pupil, cosine and sine of the
    roll, reach, then the numbers of `Radii`.

    Returns whether a face reaches behind its pupil, then nothing else is whole; beam, sheet and face (3, k); offset and
    height (2, k), corners (k, 3, 2) and normals (k, 3) in the beams' coordinates, the beams' axes (k, 3, 3).
    """
    tan_x, tan_y, w0, cos_roll, sin_roll, reach = law[0], law[1], law[2], law[3], law[4], law[5]
    n, tangent = len(t_s), max(tan_x, tan_y)
    when, half_s, look_from, slack = _whereabouts(t_s, place)
    which, sizes = np.empty((3, ROOM), np.int64), np.empty((2, ROOM))
    corners, normals, frames = np.empty((ROOM, 3, 2)), np.empty((ROOM, 3)), np.empty((ROOM, 3, 3))
    across, turned, shift, eye, base = np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.empty(3), np.empty(3)
    own, spot, u, v = np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.empty(3)
    rotation, position, speed, way = np.empty((3, 3)), np.empty(3), np.empty(3), np.empty(3)
    k, cut = 0, False
    for s in range(len(home)):
        body = home[s]
        row = bent[body]
        size = radius[s] + slack
        if row < 0:
            for i in range(3):
                way[i] = at[i, body] + (when - since[body]) * velocity[i, body] - look_from[i]
                speed[i] = velocity[i, body]
                for j in range(3):
                    rotation[i, j] = turned_by[i, j, body]
                    way[i] += rotation[i, j] * middle[s, j]
            speed_m_s = np.sqrt(speed[0] * speed[0] + speed[1] * speed[1] + speed[2] * speed[2])
            size += speed_m_s * half_s * (1.0 + MARGIN) + MARGIN
        else:
            size += held_m[s] - radius[s]
            for i in range(3):
                way[i] = held[s, i] - look_from[i]
        away = np.sqrt(way[0] * way[0] + way[1] * way[1] + way[2] * way[2])
        nearest = max(away - size, 0.0)
        if not nearest <= reach:
            continue
        least = _widest(nearest, away, size, strength[s], tangent, w0, law) * max(away, 1e-9)
        for b in range(n):
            if not way[0] * axis[b, 0] + way[1] * axis[b, 1] + way[2] * axis[b, 2] >= least:
                continue
            along = square = 0.0
            if row < 0:
                for i in range(3):
                    position[i] = at[i, body] + (t_s[b] - since[body]) * speed[i]
            else:
                for i in range(3):
                    position[i] = bent_at[row * n + b, i]
                    for j in range(3):
                        rotation[i, j] = bent_turned[row * n + b, i, j]
            for i in range(3):
                shift[i] = position[i] - place[b, i]
                here = shift[i]
                for j in range(3):
                    here += rotation[i, j] * middle[s, j]
                along += here * axis[b, i]
                square += here * here
            distance = np.sqrt(square)
            aside = np.sqrt(max(square - along * along, 0.0)) - radius[s]
            nearest, far = max(distance - radius[s], 0.0), max(along + radius[s], 0.0)
            if not (far > 0.0 and nearest <= reach):
                continue
            if not aside <= _radii(nearest, strength[s], law) * (tangent * far + w0):
                continue
            own_frame(own_axis[b], cos_roll, sin_roll, own)
            for i in range(3):
                eye[i] = 0.0
                for j in range(3):
                    across[i, j] = turn[b, j, 0] * own[i, 0] + turn[b, j, 1] * own[i, 1] + turn[b, j, 2] * own[i, 2]
                    eye[i] -= rotation[j, i] * shift[j]
            for i in range(3):
                base[i] = across[i, 0] * shift[0] + across[i, 1] * shift[1] + across[i, 2] * shift[2]
                for j in range(3):
                    turned[i, j] = (
                        across[i, 0] * rotation[0, j] + across[i, 1] * rotation[1, j] + across[i, 2] * rotation[2, j]
                    )
            for face in range(first[s], first[s] + many[s]):
                height = normal[face, 0] * eye[0] + normal[face, 1] * eye[1] + normal[face, 2] * eye[2] - behind[face]
                if not (height > 0.0 or (not closed[face] and height < 0.0)):
                    continue
                high, low = -np.inf, np.inf
                for c in range(3):
                    for i in range(3):
                        spot[c, i] = base[i] + (
                            turned[i, 0] * corner[face, c, 0]
                            + turned[i, 1] * corner[face, c, 1]
                            + turned[i, 2] * corner[face, c, 2]
                        )
                    high, low = max(high, spot[c, 2]), min(low, spot[c, 2])
                if not high > 0.0:
                    continue
                if low < NEAR * high:
                    cut = True
                    break
                for c in range(3):
                    u[c] = spot[c, 0] / max(tan_x * spot[c, 2] + w0, 1e-12)
                    v[c] = spot[c, 1] / max(tan_y * spot[c, 2] + w0, 1e-12)
                offset, nearest = _offset(u, v), max(abs(height), low)
                if not (nearest <= reach and offset <= _radii(nearest, face_strength[face], law)):
                    continue
                if k == len(normals):
                    which, sizes, corners, normals, frames = _grown(which, sizes, corners, normals, frames)
                which[0, k], which[1, k], which[2, k], sizes[0, k], sizes[1, k] = b, s, face, offset, height
                for i in range(3):
                    corners[k, i, 0], corners[k, i, 1] = u[i], v[i]
                    normals[k, i] = (
                        turned[i, 0] * normal[face, 0] + turned[i, 1] * normal[face, 1] + turned[i, 2] * normal[face, 2]
                    )
                    for j in range(3):
                        frames[k, i, j] = across[i, j]
                k += 1
            if cut:
                break
        if cut:
            break
    return cut, which[:, :k].copy(), sizes[:, :k].copy(), corners[:k].copy(), normals[:k].copy(), frames[:k].copy()


@compiled()
def holds(corner, row, u, v):
    """The convex polygon `corner[row]` (e, 2) has that place in it."""
    last = corner.shape[1] - 1
    inner = outer = True
    au, av = corner[row, 0, 0], corner[row, 0, 1]
    for e in range(last + 1):
        after = e + 1 if e < last else 0
        bu, bv = corner[row, after, 0], corner[row, after, 1]
        side = (bu - au) * (v - av) - (bv - av) * (u - au)
        inner, outer = inner and side >= 0.0, outer and side <= 0.0
        if not (inner or outer):
            return False
        au, av = bu, bv
    return True
