"""Rays to bright faces: nodes of rings and of bundles that lie on them, into the world; the light on a face.

Belongs here: what `sensing.tails.on_rings`, `sensing.tails.of_bundles` and `polygons.gaussian_share` do with arrays.
Not: what these rays meet.
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import math
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from emulator.compiled.jit import FLAG, FLOAT, FLOATS, INT, INTS, ROWS, TURNS, compiled
from emulator.compiled.sheets import holds, own_frame

ROOM = 256
"Rays for which there is room at first."
LATEST = 5
"Faces of a box that are seen at once, less one: what an edge adds is computed once for both faces that it belongs to."


@compiled()
def _range(u, v, law, normal, behind):
    """How far the plane of a face is on the ray at (u, v), as `Faced.range_m` has it."""
    x, y = law[0] * u, law[1] * v
    along = normal[0] * x + normal[1] * y + normal[2]
    left = behind - law[2] * (normal[0] * u + normal[1] * v)
    return left / (along if along != 0.0 else 1e-300) * np.sqrt(1.0 + x * x + y * y)


@compiled()
def _into_world(count, pair, place, sizes, law, position, beam, across, normal, behind):
    """Of the first rays at `place` (2, .): `sizes` (2, .) gets ranges in its second row; origins and directions."""
    origin, ray = np.empty((count, 3)), np.empty((count, 3))
    for k in range(count):
        face, u, v = pair[k], place[0, k], place[1, k]
        sizes[1, k] = _range(u, v, law, normal[face], behind[face])
        x, y = law[0] * u, law[1] * v
        length = np.sqrt(1.0 + x * x + y * y)
        for i in range(3):
            ray[k, i] = (across[face, 2, i] + x * across[face, 0, i] + y * across[face, 1, i]) / length
            aside = law[2] * (u * across[face, 0, i] + v * across[face, 1, i])
            origin[k, i] = position[beam[face], i] + aside
    return pair[:count].copy(), sizes[:, :count].copy(), origin, ray


@compiled()
def _grown(pair, place, sizes):
    """The same with twice the room."""
    return (
        np.concatenate((pair, np.empty_like(pair))),
        np.concatenate((place, np.empty_like(place)), axis=1),
        np.concatenate((sizes, np.empty_like(sizes)), axis=1),
    )


@compiled()
def _box(corner, face):
    """Least and largest u and v of a polygon, and a little more."""
    left = right = corner[face, 0, 0]
    low = high = corner[face, 0, 1]
    for e in range(1, corner.shape[1]):
        left, right = min(left, corner[face, e, 0]), max(right, corner[face, e, 0])
        low, high = min(low, corner[face, e, 1]), max(high, corner[face, e, 1])
    more = 1e-9 * (abs(left) + abs(right) + abs(low) + abs(high))
    return left - more, right + more, low - more, high + more


@compiled(INTS, ROWS, FLOATS, FLOATS, FLOATS, FLOATS, ROWS, ROWS, TURNS, FLOATS, ROWS, INTS, TURNS, ROWS, FLOATS, FLOAT)
def on_rings(
    pairs, middle, near, far, radius, light, ring_u, ring_v, corner, law, position, beam, across, normal, behind, part,
):  # fmt: skip
    """Rays on rings over the faces `pairs`, after those to the middles (k, 2) of all faces, or (0, 2).

    `near`, `far` : of each face, in beam radii; `radius`, `light` : of each ring; `ring_u`, `ring_v` : (rings, nodes);
    `part` : of a face's light for the ray to its middle, over the rest; the others as in `tails._into_world`.

    Returns the face of each ray; weight and range (2, n); origins and directions (n, 3).
    """
    count = len(middle)
    room = ROOM + count
    pair, place, sizes = np.empty(room, np.int64), np.empty((2, room)), np.empty((2, room))
    for k in range(count):
        pair[k], place[0, k], place[1, k], sizes[0, k] = k, middle[k, 0], middle[k, 1], 0.0
    for face in pairs:
        rest = 0.0
        left, right, low, high = _box(corner, face)
        for ring in range(len(radius)):
            if not radius[ring] >= near[face]:
                continue
            if not radius[ring] < far[face]:
                break
            for node in range(ring_u.shape[1]):
                u, v = ring_u[ring, node], ring_v[ring, node]
                if u < left or u > right or v < low or v > high or not holds(corner, face, u, v):
                    continue
                if count == len(pair):
                    pair, place, sizes = _grown(pair, place, sizes)
                pair[count], place[0, count], place[1, count], sizes[0, count] = face, u, v, light[ring]
                rest += light[ring]
                count += 1
        if len(middle):
            sizes[0, face] = rest * part if rest > 0.0 else 1.0
    return _into_world(count, pair, place, sizes, law, position, beam, across, normal, behind)


@compiled(INTS, TURNS, ROWS, TURNS, FLAG, FLOATS, FLOATS, FLOATS, ROWS, INTS, TURNS, ROWS, FLOATS)
def bundled(
    inner, corner, axis, spread, wide, share, roll, law, position, beam, across, normal, behind
):  # fmt: skip
    """Rays of the beams' own bundles on the faces `inner`; as `on_rings`.

    `spread` : (inner, m, 3) directions of each face's beam, where that is `wide`; else where its rays start.
    """
    own, count = np.empty((3, 3)), 0
    pair, place, sizes = np.empty(ROOM, np.int64), np.empty((2, ROOM)), np.empty((2, ROOM))
    for row in range(len(inner)):
        face = inner[row]
        left, right, low, high = _box(corner, face)
        own_frame(axis[beam[face]], roll[0], roll[1], own)
        for node in range(len(share)):
            x, y, z = spread[row, node, 0], spread[row, node, 1], spread[row, node, 2]
            u = own[0, 0] * x + own[0, 1] * y + own[0, 2] * z
            v = own[1, 0] * x + own[1, 1] * y + own[1, 2] * z
            if wide:
                along = max(own[2, 0] * x + own[2, 1] * y + own[2, 2] * z, 1e-9)
                u, v = u / along / law[0], v / along / law[1]
            else:
                u, v = u / law[2], v / law[2]
            if u < left or u > right or v < low or v > high or not holds(corner, face, u, v):
                continue
            if count == len(pair):
                pair, place, sizes = _grown(pair, place, sizes)
            pair[count], place[0, count], place[1, count], sizes[0, count] = face, u, v, share[node]
            count += 1
    return _into_world(count, pair, place, sizes, law, position, beam, across, normal, behind)


# ---------------------------------------------------------------- light on a face
@intrinsic  # type: ignore[untyped-decorator]
def _of_two(typing: Any, function: Any, first: Any, second: Any) -> Any:
    """double function(double, double, int) at that address; the last is 0."""
    signature = types.float64(types.int64, types.float64, types.float64)

    def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        number, whole = ir.DoubleType(), ir.IntType(32)
        kind = ir.FunctionType(number, [number, number, whole])
        return builder.call(builder.inttoptr(values[0], kind.as_pointer()), [*values[1:], whole(0)])

    return signature, code


@compiled()
def _below(x):
    """Of the normal distribution."""
    return 0.5 * math.erfc(-x / math.sqrt(2.0))


@compiled()
def _put_edge(function, a, b, into):
    """What the edge from `a` to `b` adds to the share, and to the moment of the light."""
    x, y = b[0] - a[0], b[1] - a[1]
    length = math.sqrt(x * x + y * y)
    x, y = x / max(length, 1e-300), y / max(length, 1e-300)
    offset, begin = a[0] * y - a[1] * x, a[0] * x + a[1] * y
    end, away = begin + length, max(abs(offset), 1e-12)
    turn = (math.atan(end / away) - math.atan(begin / away)) / (2.0 * np.pi)
    turn -= _of_two(function, 2.0 * away, end / away) - _of_two(function, 2.0 * away, begin / away)
    into[0] = turn if offset > 0.0 else -turn if offset < 0.0 else 0.0
    # on the side of zero where the tails are small, so that their difference keeps its digits
    tails = _below(-2.0 * begin) - _below(-2.0 * end) if begin > 0.0 else _below(2.0 * end) - _below(2.0 * begin)
    light = math.exp(-2.0 * offset * offset) * tails
    into[1], into[2] = -y * light, x * light


@compiled()
def _met_before(corner, k, e):
    """The face before polygon k, and its edge, that is edge e of k the other way around; -1: none of the latest."""
    edges = corner.shape[1]
    after = e + 1 if e + 1 < edges else 0
    for other in range(k - 1, max(k - 1 - LATEST, -1), -1):
        for f in range(edges):
            g = f + 1 if f + 1 < edges else 0
            if (
                corner[other, g, 0] == corner[k, e, 0]
                and corner[other, f, 0] == corner[k, after, 0]
                and corner[other, g, 1] == corner[k, e, 1]
                and corner[other, f, 1] == corner[k, after, 1]
            ):
                return other, f
    return -1, 0


@compiled(INT, TURNS)
def shares(function, corner):
    """As `polygons.gaussian_share`: share of the power on each polygon (k, e, 2), and the middle of that light, (k, 2).

    `function` : address of Owen's T, `polygons.OWENS_T`.
    """
    count, edges = corner.shape[0], corner.shape[1]
    share, middle = np.empty(count), np.empty((count, 2))
    kept = np.empty((count, edges, 3))
    for k in range(count):
        signed = first = second = 0.0
        for e in range(edges):
            known, other = _met_before(corner, k, e)
            if known >= 0:
                for i in range(3):
                    kept[k, e, i] = -kept[known, other, i]
            else:
                _put_edge(function, corner[k, e], corner[k, e + 1 if e + 1 < edges else 0], kept[k, e])
            signed, first, second = signed + kept[k, e, 0], first + kept[k, e, 1], second + kept[k, e, 2]
        scale = 1.0 / math.sqrt(8.0 * np.pi) / (signed if signed != 0.0 else 1.0)
        share[k], middle[k, 0], middle[k, 1] = abs(signed), first * scale, second * scale
        if not holds(corner, k, middle[k, 0], middle[k, 1]):
            middle[k] = 0.0
            for e in range(edges):
                middle[k, 0] += corner[k, e, 0] / edges
                middle[k, 1] += corner[k, e, 1] / edges
    return share, middle
