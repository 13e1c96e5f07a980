"""A checked triangle mesh: float64 vertices, faces, named parts; and the primitives as such meshes.

Belongs here: what can be said of triangles alone (finite, closed, wound outwards, bounding sphere). Not: files
(mesh_files), materials and motion (scene), rays (raycast).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from emulator.errors import SceneError
from emulator.world.connected import pieces_of
from emulator.world.mesh_maps import MeshMaps

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

MOST_M = 1e10
"Of a coordinate: float64 resolves 1e-6 m there."
SLICE = 1 << 18
"Triangles that are worked on at a time."
MOST_SHELLS_NESTED = 2000
"Above so many closed shells in one mesh none is taken for a cavity of another: the test is quadratic."


@dataclass(frozen=True, eq=False)
class Geometry:
    """A triangle mesh about its own origin; shared by all bodies of the same shape."""

    vertices: Floats
    "(v, 3) [m]"
    faces: Ints
    "(f, 3) indexes of vertices; counter-clockwise seen from outside where the face belongs to a closed shell."
    face_part: Ints
    "(f,) index into `parts`."
    parts: tuple[str, ...]
    normals: Floats
    "(f, 3) unit, by the winding."
    closed: NDArray[np.bool_]
    "(f,) belongs to a shell without border that is wound consistently."
    centre: Floats
    "(3,) of the bounding sphere."
    radius: float
    dropped: int = 0
    "Triangles of no area that were left out."
    coplanar: int = 0
    "Triangles that lie on another one of a different part: which of them a beam meets is arbitrary."
    maps: MeshMaps | None = None
    "Colours and normals by texel and vertex, where they were asked for."


@np.errstate(under="ignore")  # products of lengths below 1e-150 are no area
def checked(
    vertices: Floats, faces: NDArray[np.integer], face_part: NDArray[np.integer], parts: tuple[str, ...], where: str
) -> Geometry:
    """Check a raw mesh and prepare it; `where` begins the message of a `SceneError`."""
    vertices = np.ascontiguousarray(vertices, dtype=np.float64)
    indices = np.asarray(faces, dtype=np.int64)
    part = np.asarray(face_part, dtype=np.int32)
    if len(indices) == 0:
        raise SceneError(f"{where}: no triangles; want a mesh with at least one")
    if indices.min() < 0 or indices.max() >= len(vertices):
        bad = int(np.flatnonzero(((indices < 0) | (indices >= len(vertices))).any(axis=1))[0])
        raise SceneError(f"{where}: triangle {bad} names vertex {indices[bad].tolist()}; want 0..{len(vertices) - 1}")
    low, high = vertices.min(axis=0), vertices.max(axis=0)  # NaN if one is
    if not (np.abs([low, high]) <= MOST_M).all():
        vertices = _with_sound_corners(vertices, indices, where)
    used = np.zeros(len(vertices), dtype=bool)
    used[indices] = True
    if not used.all():
        low, high = vertices[used].min(axis=0), vertices[used].max(axis=0)
    if (low == high).sum() > 1:  # all on one line: reported before any of them is looked at
        raise SceneError(f"{where}: all {len(indices)} triangles have no area; want a surface")
    centre = low + (high - low) / 2.0
    local = vertices - centre
    cross, double_area, keep = _areas(local, indices)
    dropped = int(len(keep) - keep.sum())
    if dropped:
        indices, part, cross, double_area = indices[keep], part[keep], cross[keep], double_area[keep]
        if len(indices) == 0:
            raise SceneError(f"{where}: all {dropped} triangles have no area; want a surface")
    normals = np.divide(cross, double_area[:, None], out=cross)
    closed, flip, coplanar = _shells(local, indices, part)
    if flip.any():
        indices[flip] = indices[flip][:, ::-1]
        normals[flip] = -normals[flip]
    radius = float(np.sqrt((local[used] ** 2).sum(axis=1).max()))
    return Geometry(vertices, indices.astype(np.int32), part, parts, normals, closed, centre, radius, dropped, coplanar)


def _with_sound_corners(vertices: Floats, indices: NDArray[np.int64], where: str) -> Floats:
    """The vertices, unused ones made finite; `SceneError` for a corner that is not finite, or too far."""
    finite = np.asarray(np.isfinite(vertices).all(axis=1))
    if not finite.all():
        bad_faces = np.flatnonzero(~finite[indices].all(axis=1))
        if len(bad_faces):
            bad = int(bad_faces[0])
            corner = vertices[indices[bad]][~finite[indices[bad]]][0].tolist()
            raise SceneError(
                f"{where}: triangle {bad} has the vertex {corner} ({len(bad_faces)} such in all); want finite numbers"
            )
        vertices = np.where(finite[:, None], vertices, 0.0)  # not used by any triangle
    far = np.asarray((np.abs(vertices) > MOST_M).any(axis=1))
    if far.any() and far[indices].any():
        bad = int(np.flatnonzero(far[indices].any(axis=1))[0])
        corner = vertices[indices[bad]][far[indices[bad]]][0].tolist()
        raise SceneError(f"{where}: triangle {bad} has the vertex {corner}; want coordinates within {MOST_M:g} m")
    return vertices


def _areas(local: Floats, faces: NDArray[np.int64]) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Of each triangle its cross product (f, 3), that one's length, and whether it has an area."""
    cross, double_area, keep = np.zeros((len(faces), 3)), np.zeros(len(faces)), np.zeros(len(faces), dtype=bool)
    for some in _slices(len(faces)):
        a, b, c = (local[faces[some, k]] for k in range(3))
        cross[some] = np.cross(b - a, c - a)
        double_area[some] = np.linalg.norm(cross[some], axis=1)
        longest = np.sqrt(
            np.maximum.reduce([((b - a) ** 2).sum(axis=1), ((c - b) ** 2).sum(axis=1), ((a - c) ** 2).sum(axis=1)])
        )
        keep[some] = double_area[some] > 1e-14 * longest * longest  # a height below 1e-14 of it: rounding, no surface
    return cross, double_area, keep


def _slices(count: int) -> Iterator[slice]:
    """Parts of what is many: what is made on the way of all at once would take ten times the mesh."""
    return (slice(first, first + SLICE) for first in range(0, count, SLICE))


def _shells(local: Floats, faces: NDArray[np.int64], part: Ints) -> tuple[NDArray[np.bool_], NDArray[np.bool_], int]:
    """Which faces belong to closed shells, which to turn so that they face outwards, and how many lie on others."""
    order = np.lexsort(local.T)
    step = np.ones(len(local), dtype=np.int64)
    for some in _slices(len(local) - 1):
        place = local[order[some.start : some.stop + 1]]
        step[1:][some] = (place[1:] != place[:-1]).any(axis=1)
    welded = np.zeros(len(local), dtype=np.int64)
    welded[order] = np.cumsum(step) - 1
    corners = welded[faces]
    count = int(welded.max()) + 1
    coplanar = _count_coplanar(corners, part)

    start, end = corners.ravel(), corners[:, [1, 2, 0]].ravel()
    key = np.minimum(start, end) * count + np.maximum(start, end)
    way = np.where(start < end, np.int8(1), np.int8(-1))
    del start, end, corners
    order = np.argsort(key, kind="stable")
    key = key[order]
    begins = np.flatnonzero(np.diff(key, prepend=-1))
    balanced = np.add.reduceat(way[order], begins, dtype=np.int64) == 0  # as often one way as the other: no border
    sizes = np.diff(begins, append=len(order))
    good = np.zeros(len(order), dtype=bool)
    good[order] = np.repeat(balanced, sizes)
    linked = np.flatnonzero(np.repeat(balanced, sizes)[1:] & (key[1:] == key[:-1]))
    face = (order // 3).astype(np.int32)
    del key, order, begins, sizes, balanced
    shells, shell = pieces_of(len(faces), face[linked], face[linked + 1])
    whole = np.ones(shells, dtype=bool)
    whole[shell[~good.reshape(-1, 3).all(axis=1)]] = False

    del linked, face
    wedge = np.zeros(len(faces))
    for some in _slices(len(faces)):
        a, b, c = (local[faces[some, k]] for k in range(3))
        wedge[some] = np.einsum("ij,ij->i", a, np.cross(b, c))
    volume = np.bincount(shell, weights=wedge, minlength=shells)
    inwards = whole & (volume < 0.0)
    if inwards.any() and shells <= MOST_SHELLS_NESTED:
        low = np.full((shells, 3), np.inf)
        high = np.full((shells, 3), -np.inf)
        for corner in (local[faces[:, k]] for k in range(3)):
            np.minimum.at(low, shell, corner)
            np.maximum.at(high, shell, corner)
        outer = np.flatnonzero(whole)
        for k in np.flatnonzero(inwards):
            holds = (low[outer] < low[k]).all(axis=1) & (high[outer] > high[k]).all(axis=1)
            inwards[k] = not holds.any()  # a cavity faces its own inside
    return whole[shell], inwards[shell], coplanar


def _count_coplanar(corners: NDArray[np.int64], part: Ints) -> int:
    """Pairs of triangles on the same three corners with different parts."""
    sets = np.sort(corners, axis=1)
    mixed = sets.astype(np.uint64) * np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], np.uint64)
    code = np.bitwise_xor.reduce(mixed, axis=1)
    order = np.argsort(code, kind="stable")
    alike = np.diff(code[order]) == 0  # few, so that only they are looked at closely
    members = order[np.append(alike, False) | np.append(False, alike)]
    if not len(members):
        return 0
    rows = members[np.lexsort((part[members], *sets[members].T[::-1]))]
    same = (sets[rows][1:] == sets[rows][:-1]).all(axis=1)
    return int((same & (part[rows][1:] != part[rows][:-1])).sum())


# ---------------------------------------------------------------- primitives


def _geometry(vertices: Floats, faces: NDArray[np.integer]) -> Geometry:
    return checked(vertices, faces, np.zeros(len(faces), np.int32), ("surface",), "primitive")


def plane(length_m: float, width_m: float) -> Geometry:
    """A rectangle centred on the origin, `length_m` along x, `width_m` along y, normal +z."""
    x, y = length_m / 2.0, width_m / 2.0
    return _geometry(np.array([[-x, -y, 0], [x, -y, 0], [x, y, 0], [-x, y, 0]]), np.array([[0, 1, 2], [0, 2, 3]]))


def box(length_m: float, width_m: float, height_m: float) -> Geometry:
    """A closed box standing on the origin."""
    x, y, z = length_m / 2.0, width_m / 2.0, height_m
    corners = np.array([[i * x, j * y, k] for k in (0.0, z) for j in (-1, 1) for i in (-1, 1)])
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    faces = [face for p, q, r, s in quads for face in ((p, q, r), (p, r, s))]
    return _geometry(corners, np.array(faces))


def cylinder(radius_m: float, height_m: float, segments: int) -> Geometry:
    """A closed upright cylinder standing on the origin; its edges lie on the circle."""
    around = 2.0 * math.pi * np.arange(segments) / segments
    ring = np.column_stack([radius_m * np.cos(around), radius_m * np.sin(around)])
    vertices = np.zeros((2 * segments + 2, 3))
    vertices[:segments, :2] = ring
    vertices[segments : 2 * segments, :2] = ring
    vertices[segments : 2 * segments, 2] = vertices[-1, 2] = height_m
    i = np.arange(segments)
    j = (i + 1) % segments
    faces = np.concatenate(
        [
            np.column_stack([i, j, j + segments]),
            np.column_stack([i, j + segments, i + segments]),
            np.column_stack([np.full(segments, 2 * segments), j, i]),
            np.column_stack([np.full(segments, 2 * segments + 1), i + segments, j + segments]),
        ]
    )
    return _geometry(vertices, faces)


def sphere(radius_m: float, segments: int) -> Geometry:
    """A closed sphere standing on the origin: `segments` meridians, half as many rings; vertices lie on the sphere."""
    rings = max(2, segments // 2)
    polar = math.pi * np.arange(1, rings) / rings
    around = 2.0 * math.pi * np.arange(segments) / segments
    grid = np.stack(
        [
            np.outer(np.sin(polar), np.cos(around)),
            np.outer(np.sin(polar), np.sin(around)),
            np.outer(-np.cos(polar), np.ones(segments)),
        ],
        axis=-1,
    ).reshape(-1, 3)
    unit = np.concatenate([[[0.0, 0.0, -1.0]], grid, [[0.0, 0.0, 1.0]]])
    i = np.arange(segments)
    j = (i + 1) % segments
    top = 1 + (rings - 2) * segments
    pieces = [np.column_stack([np.zeros(segments, int), 1 + j, 1 + i])]
    for ring in range(rings - 2):
        low, high = 1 + ring * segments, 1 + (ring + 1) * segments
        pieces += [np.column_stack([low + i, low + j, high + j]), np.column_stack([low + i, high + j, high + i])]
    pieces.append(np.column_stack([top + i, top + j, np.full(segments, len(unit) - 1)]))
    return _geometry(radius_m * (unit + np.array([0.0, 0.0, 1.0])), np.concatenate(pieces))
