"""Where surfaces of a scene end or bend: the edges of its meshes, and the boxes of their connected pieces.

Belongs here: what follows of the meshes alone. Not: which beams they touch (sensing.plain). An edge counts when it has
not exactly two faces, when these are not one plane, or when they differ in material.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from emulator.world.connected import pieces_of
from emulator.world.scene import Body, Scene
from emulator.world.triangles import Floats, Geometry

Longs = NDArray[np.int64]

FLAT_RAD = 1e-5
"Faces that differ by less are one plane: a circle of so flat facets has half a million of them."
MOST_PIECES = 512
"Connected pieces of a mesh that are distinguished; a mesh with more counts as one that may cross itself."


@dataclass(frozen=True, eq=False)
class Outline:
    """Of one shape with its materials, in its own frame."""

    start_m: Floats
    "(e, 3)"
    end_m: Floats
    "(e, 3)"
    piece: Longs
    "(f,) connected piece of each face."
    low_m: Floats
    "(p, 3) box of each piece."
    high_m: Floats
    crosses: bool
    "Too many pieces to distinguish."


def outline(geometry: Geometry, face_material: NDArray[np.integer]) -> Outline:
    """Edges and pieces of a shape."""
    welded, points = _welded(geometry.vertices)
    corners = welded[geometry.faces]
    start, end = corners.ravel(), corners[:, [1, 2, 0]].ravel()
    low, high = np.minimum(start, end), np.maximum(start, end)
    order = np.lexsort((high, low))
    low, high = low[order], high[order]
    fresh = np.ones(len(order), bool)
    fresh[1:] = (low[1:] != low[:-1]) | (high[1:] != high[:-1])
    begin = np.flatnonzero(fresh)
    size = np.diff(np.append(begin, len(order)))
    face = order // 3
    twice = begin[size == 2]
    f, g = face[twice], face[twice + 1]
    opposite = start[order[twice]] != start[order[twice + 1]]
    one, two = geometry.normals[f], geometry.normals[g] * np.where(opposite, 1.0, -1.0)[:, None]
    bend = np.linalg.norm(one - two, axis=1)
    flat = (bend < FLAT_RAD) & (face_material[f] == face_material[g])
    kept = np.ones(len(begin), bool)
    kept[np.flatnonzero(size == 2)[flat]] = False
    at = begin[kept]
    again = np.flatnonzero(~fresh)
    count = len(geometry.faces)
    pieces, piece = pieces_of(count, face[again - 1], face[again])
    crosses = pieces > MOST_PIECES
    if crosses:
        pieces, piece = 1, np.zeros(count, np.int64)
    bottom, top = np.full((pieces, 3), np.inf), np.full((pieces, 3), -np.inf)
    for column in range(3):
        vertex = geometry.vertices[geometry.faces[:, column]]
        np.minimum.at(bottom, piece, vertex)
        np.maximum.at(top, piece, vertex)
    return Outline(points[low[at]], points[high[at]], piece.astype(np.int64), bottom, top, bool(crosses))


def _welded(vertices: Floats) -> tuple[Longs, Floats]:
    """Number of each vertex's place, and the places."""
    order = np.lexsort(vertices.T)
    step = np.ones(len(vertices), np.int64)
    step[1:] = (vertices[order][1:] != vertices[order][:-1]).any(axis=1)
    welded = np.zeros(len(vertices), np.int64)
    welded[order] = np.cumsum(step) - 1
    return welded, vertices[order][step == 1]


@dataclass(frozen=True, eq=False)
class Outlines:
    """Of all bodies of a scene: flat arrays, each body's rows together, in the bodies' own frames."""

    bodies: tuple[Body, ...]
    start_m: Floats
    "(e, 3)"
    end_m: Floats
    body: Longs
    "(e,)"
    low_m: Floats
    "(p, 3) boxes of pieces."
    high_m: Floats
    piece_body: Longs
    "(p,)"
    piece_crosses: NDArray[np.bool_]
    first_piece: Longs
    "(b,)"
    face_piece: Longs
    "Piece within its body of the faces of every shape, one after the other."
    first_face: Longs
    "(b,) where the faces of each body's shape begin there."

    def __len__(self) -> int:
        return len(self.body)

    def piece_of(self, body: NDArray[np.integer], face: NDArray[np.integer]) -> Longs:
        """Number of the piece that these faces of these bodies belong to."""
        return np.asarray(self.first_piece[body] + self.face_piece[self.first_face[body] + face])


def outlines_of(scene: Scene) -> Outlines:
    """Edges and pieces of a scene; shapes that occur several times are looked at once."""
    made: dict[tuple[int, bytes], tuple[Outline, int]] = {}
    faces: list[Longs] = [np.zeros(0, np.int64)]
    count = 0
    each = []
    for body in scene.bodies:
        key = id(body.geometry), body.part_material.tobytes()
        if key not in made:
            made[key] = outline(body.geometry, body.face_material), count
            faces.append(made[key][0].piece)
            count += len(faces[-1])
        each.append(made[key])
    none = np.zeros((0, 3))
    numbers = np.arange(len(each))
    pieces = np.array([len(one.low_m) for one, _ in each], np.int64)
    return Outlines(
        scene.bodies,
        np.concatenate([none, *(one.start_m for one, _ in each)]),
        np.concatenate([none, *(one.end_m for one, _ in each)]),
        np.repeat(numbers, [len(one.start_m) for one, _ in each]),
        np.concatenate([none, *(one.low_m for one, _ in each)]),
        np.concatenate([none, *(one.high_m for one, _ in each)]),
        np.repeat(numbers, pieces),
        np.repeat(np.array([one.crosses for one, _ in each], bool), pieces),
        np.cumsum(pieces) - pieces,
        np.concatenate(faces),
        np.array([first for _, first in each], np.int64),
    )
