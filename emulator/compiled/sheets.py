"""Bright faces beside beams: which come near, where they are in a beam's own coordinates, which places they cover.

Belongs here: what `sheets._beside` does with arrays, and `polygons.within` for one place. Not: faces that reach behind
a pupil, which arrays cut, and the light on them.
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numpy as np

from emulator.compiled.jit import FLAGS, FLOATS, INTS, ROWS, TURNS, compiled

NEAR = 1e-3
"As in `polygons`."


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


@compiled(
    INTS, INTS, ROWS, TURNS, ROWS, TURNS, ROWS, ROWS, INTS, INTS, ROWS, FLOATS, FLOATS, TURNS, ROWS, FLOATS, FLAGS,
    FLOATS, FLOATS,
)  # fmt: skip
def beside(
    beam, sheet, position, rotation, place, turn, own_axis, axis, first, many, middle, radius, strength, corner,
    normal, behind, closed, face_strength, law,
):  # fmt: skip
    """Of pairs (n,) of a beam and a sheet those with a face that comes into the beam's tail.

    `position`, `rotation` : (n, 3), (n, 3, 3) of the sheets' bodies; `place`, `turn`, `own_axis`, `axis` : of the
    beams; `first` to `strength` : of the sheets; `corner` to `face_strength` : of all faces; `law` : tangents, radius
    at the pupil, cosine and sine of the roll, reach, then the numbers of `Radii`.

    Returns whether a face reaches behind its pupil, then nothing else is whole; pair and face (2, k); offset and height
    (2, k), corners (k, 3, 2) and normals (k, 3) in the beams' coordinates, the beams' axes (k, 3, 3).
    """
    tan_x, tan_y, w0, cos_roll, sin_roll, reach = law[0], law[1], law[2], law[3], law[4], law[5]
    n, room = len(beam), 0
    for p in range(n):
        room += many[sheet[p]]
    which, sizes = np.empty((2, room), np.int64), np.empty((2, room))
    corners, normals, frames = np.empty((room, 3, 2)), np.empty((room, 3)), np.empty((room, 3, 3))
    across, turned, shift, eye, base = np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.empty(3), np.empty(3)
    own, spot, u, v = np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.empty(3)
    k, cut = 0, False
    for p in range(n):
        b, s = beam[p], sheet[p]
        along = square = 0.0
        for i in range(3):
            shift[i] = position[p, i] - place[b, i]
            here = shift[i]
            for j in range(3):
                here += rotation[p, i, j] * middle[s, j]
            along += here * axis[b, i]
            square += here * here
        distance = np.sqrt(square)
        aside = np.sqrt(max(square - along * along, 0.0)) - radius[s]
        nearest, far = max(distance - radius[s], 0.0), max(along + radius[s], 0.0)
        if not (far > 0.0 and nearest <= reach):
            continue
        if not aside <= _radii(nearest, strength[s], law) * (max(tan_x, tan_y) * far + w0):
            continue
        own_frame(own_axis[b], cos_roll, sin_roll, own)
        for i in range(3):
            eye[i] = 0.0
            for j in range(3):
                across[i, j] = turn[b, j, 0] * own[i, 0] + turn[b, j, 1] * own[i, 1] + turn[b, j, 2] * own[i, 2]
                eye[i] -= rotation[p, j, i] * shift[j]
        for i in range(3):
            base[i] = across[i, 0] * shift[0] + across[i, 1] * shift[1] + across[i, 2] * shift[2]
            for j in range(3):
                turned[i, j] = (
                    across[i, 0] * rotation[p, 0, j]
                    + across[i, 1] * rotation[p, 1, j]
                    + across[i, 2] * rotation[p, 2, j]
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
            which[0, k], which[1, k], sizes[0, k], sizes[1, k] = p, face, offset, height
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
