"""Bright faces: which surfaces of a scene are, and which of them come near a beam.

Belongs here: sheets (bright faces that hang together), the search for beams beside them, faces in the coordinates of
beams. Not: the light on them, and what hides them (bright).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import coo_matrix, csgraph

from emulator.physics import polygons
from emulator.physics.arrays import Bools, Floats, Ints, indexes
from emulator.physics.beams import NO_WIDTH, BeamShape
from emulator.physics.materials import SurfaceTable
from emulator.world.motion import Pose

if TYPE_CHECKING:
    from emulator.world.scene import Body, Scene

BRIGHT = 10.0
"Equivalent reflectance from which on a surface is bright; paint, metal and snow stay below 2, sheeting begins at 150."
PAIRS_AT_ONCE = 200_000

Radii = Callable[[Floats, Floats], Floats]
"Beam radii that count at a distance on a surface of this equivalent reflectance; 0: none."


def bright_of(table: SurfaceTable) -> Bools:
    """(materials,) those whose tail is looked after: what they send on is another matter."""
    own = np.array([m.model not in ("glass", "mirror") for m in table.materials], bool)
    return np.asarray(own & (table.largest >= BRIGHT))


@dataclass(frozen=True, eq=False)
class Frames:
    """The beams of a sweep in the world."""

    pose: Pose
    "Of the sensor at their instants."
    own_axis: Floats
    axis: Floats
    "(n, 3) in the sensor's frame, and in the world."
    t_s: Floats
    shape: BeamShape

    def across(self, beam: Ints) -> Floats:
        """(k, 3, 3) of some beams: rows are along u, along v, along the axis, in the world."""
        own = across_own(self.own_axis[beam], self.shape)
        return np.einsum("nij,nkj->nki", self.pose.rotation[beam], own)

    def rays(self, beam: Ints, across: Floats, u: Floats, v: Floats) -> tuple[Floats, Floats]:
        """Starts and directions of rays at (u, v) of their beams, as `beams.spread` makes them."""
        x, y = _tangents(self.shape)[:, None] * np.stack([u, v])
        ray = across[:, 2] + x[:, None] * across[:, 0] + y[:, None] * across[:, 1]
        ray /= np.sqrt(1.0 + x * x + y * y)[:, None]
        origin = self.pose.position_m[beam]
        if self.shape.exit_radius_m >= NO_WIDTH:
            origin = origin + self.shape.exit_radius_m * (u[:, None] * across[:, 0] + v[:, None] * across[:, 1])
        return origin, ray


@dataclass(frozen=True, eq=False)
class Faced:
    """k pairs of a beam and a bright face that comes into its tail."""

    beam: Ints
    actor: Ints
    material: Ints
    strength: Floats
    "Largest equivalent reflectance."
    across: Floats
    "(k, 3, 3) of the beam."
    normal: Floats
    "(k, 3) unit vectors in its coordinates: along u, v and the axis."
    behind_m: Floats
    "(k,) distance of the face's plane from the optical centre along that."
    corner: Floats
    "(k, e, 2) in beam radii."
    offset: Floats
    "(k,) least distance from the axis, in beam radii."

    def __len__(self) -> int:
        return len(self.beam)

    def taken(self, at: Ints) -> Faced:
        """Some of them."""
        return Faced(*(column[at] for column in vars(self).values()))

    def range_m(self, pair: Ints, u: Floats, v: Floats, shape: BeamShape) -> Floats:
        """How far the plane of each is on the ray at (u, v), from the pupil."""
        x, y = _tangents(shape)[:, None] * np.stack([u, v])
        normal, w0 = self.normal[pair], shape.exit_radius_m
        along = normal[:, 0] * x + normal[:, 1] * y + normal[:, 2]
        left = self.behind_m[pair] - w0 * (normal[:, 0] * u + normal[:, 1] * v)
        return np.asarray(left / np.where(along == 0.0, 1e-300, along) * np.sqrt(1.0 + x * x + y * y))


@dataclass(frozen=True, eq=False)
class _Sheet:
    """Bright faces of one body that hang together, about its origin."""

    body: int
    corner_m: Floats
    "(f, 3, 3)"
    material: Ints
    strength: Floats
    closed: Bools
    middle_m: Floats
    radius_m: float


class Sheets:
    """The bright faces of a scene's rigid bodies."""

    def __init__(self, scene: Scene, table: SurfaceTable) -> None:
        self._bodies = scene.bodies
        bright = bright_of(table)
        rigid = [(k, body) for k, body in enumerate(scene.bodies) if body.frames is None]
        self._sheets = [one for k, body in rigid for one in _sheets(k, body, bright, table)]
        self._body = np.array([one.body for one in self._sheets], np.int64)
        self._strength = np.array([one.strength.max() for one in self._sheets])

    def near(self, frames: Frames, radii: Radii, reach_m: float) -> Faced:
        """Pairs of a beam and a face that comes into its tail; not those of a closed body that look away."""
        beam, sheet = self._pairs(frames, radii, reach_m)
        parts = [_NONE]
        for number in np.unique(sheet):
            mine, one = beam[sheet == number], self._sheets[number]
            across = frames.across(mine)
            step = max(1, PAIRS_AT_ONCE // len(one.material))
            for begin in range(0, len(mine), step):
                some = slice(begin, begin + step)
                parts.append(self._faced(one, mine[some], across[some], frames, radii, reach_m))
        parts = [one for one in parts if len(one)]
        if not parts:
            return _NONE
        edges = max(one.corner.shape[1] for one in parts)
        columns = [vars(one) | {"corner": _padded(one.corner, edges)} for one in parts]
        return Faced(*(np.concatenate([one[name] for one in columns]) for name in columns[0]))

    def _pairs(self, frames: Frames, radii: Radii, reach_m: float) -> tuple[Ints, Ints]:
        """Beams, and sheets whose sphere comes into their cones wherever it and the sensor are in this sweep."""
        t_s, place = frames.t_s, frames.pose.position_m
        first, last = float(t_s.min()), float(t_s.max())
        if place.strides[0]:
            low, high = place.min(axis=0), place.max(axis=0)
        else:
            low = high = place[0]
        eye, slack = 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low))
        centre, size = np.zeros((len(self._sheets), 3)), np.zeros(len(self._sheets))
        when, body = np.array([0.5 * (first + last)]), -1
        for k, one in enumerate(self._sheets):
            if one.body != body:
                body = one.body
                motion = self._bodies[body].motion
                pose, moved = motion.pose(when), 0.0
                if not motion.still and last > first:
                    moved = motion.speed_bound_m_s * 0.5 * (last - first)
            if motion.turns:
                centre[k], size[k] = pose.position_m[0], one.radius_m + float(np.linalg.norm(one.middle_m)) + moved
            else:
                centre[k] = pose.position_m[0] + pose.rotation[0] @ one.middle_m
                size[k] = one.radius_m + moved
        away, size = centre - eye, size + slack
        distance = np.linalg.norm(away, axis=1)
        nearest = np.maximum(distance - size, 0.0)
        most = radii(nearest, self._strength)
        wide = (size + most * frames.shape.exit_radius_m) / np.maximum(distance, 1e-9)
        angle = np.arcsin(np.minimum(wide, 1.0)) + np.arctan(most * float(_tangents(frames.shape).max()))
        least = np.where((wide < 1.0) & (angle < np.pi), np.cos(np.minimum(angle, np.pi)), -2.0) - 1e-12
        some = indexes((nearest <= reach_m) & (most > 0.0))
        way = away[some] / np.maximum(distance[some], 1e-9)[:, None]
        cosine = sum(way[:, k, None] * frames.axis[None, :, k] for k in range(3))
        sheet, beam = np.nonzero(cosine >= least[some, None])
        return beam, some[sheet]

    def _faced(
        self, one: _Sheet, beam: Ints, across: Floats, frames: Frames, radii: Radii, reach_m: float
    ) -> Faced:
        """Those of a sheet."""
        body = self._bodies[one.body]
        still = body.motion.still
        pose = body.motion.pose(frames.t_s[beam[:1]] if still else frames.t_s[beam])
        # from the body's frame into those of the beams
        turn = np.einsum("nij,njk->nik", across, np.broadcast_to(pose.rotation, (len(beam), 3, 3)))
        shift = np.einsum("nij,nj->ni", across, pose.position_m - frames.pose.position_m[beam])
        corner = np.einsum("nij,fcj->nfci", turn, one.corner_m) + shift[:, None, None]
        normal = np.cross(corner[:, :, 1] - corner[:, :, 0], corner[:, :, 2] - corner[:, :, 0])
        behind = np.einsum("nfi,nfi->nf", normal, corner[:, :, 0])
        # of a closed body faces are counter-clockwise seen from outside
        row, face = np.nonzero((corner[:, :, :, 2].max(axis=2) > 0.0) & ~(one.closed & (behind > 0.0)) & (behind != 0.0))
        if not len(row):
            return _NONE
        own, normal, behind = polygons.before_pupil(corner[row, face]), normal[row, face], behind[row, face]
        length = np.linalg.norm(normal, axis=1)
        tangents, w0 = _tangents(frames.shape), frames.shape.exit_radius_m
        flat = own[:, :, :2] / np.maximum(tangents * own[:, :, 2:] + w0, 1e-12)
        offset = polygons.offset_of(flat)
        nearest = np.maximum(np.abs(behind) / length, own[:, :, 2].min(axis=1))
        strength = one.strength[face]
        at = indexes((offset <= radii(nearest, strength)) & (nearest <= reach_m))
        row, face, length = row[at], face[at], length[at]
        return Faced(
            beam[row], np.full(len(row), body.actor), one.material[face], strength[at], across[row],
            normal[at] / length[:, None], behind[at] / length, flat[at], offset[at],
        )  # fmt: skip


_NONE = Faced(
    *[np.zeros(0, np.int64)] * 3, np.zeros(0), np.zeros((0, 3, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3, 2)),
    np.zeros(0),
)  # fmt: skip


def across_own(axis: Floats, shape: BeamShape) -> Floats:
    """(k, 3, 3) rows along u, v and the axis in the sensor's frame: as `beams.spread` has them, before its turn."""
    level = np.hypot(axis[:, 0], axis[:, 1])
    safe = np.where(level > 0.0, level, 1.0)
    cosine, sine = np.where(level > 0.0, axis[:, 0] / safe, 1.0), axis[:, 1] / safe
    left = np.stack([-sine, cosine, np.zeros(len(axis))], axis=1)
    up = np.stack([-axis[:, 2] * cosine, -axis[:, 2] * sine, level], axis=1)
    roll = math.cos(shape.roll_rad), math.sin(shape.roll_rad)
    return np.stack([roll[0] * left + roll[1] * up, roll[0] * up - roll[1] * left, axis], axis=1)


def _tangents(shape: BeamShape) -> Floats:
    return np.array([math.tan(shape.half_angle_x_rad), math.tan(shape.half_angle_y_rad)])


def _padded(corner: Floats, edges: int) -> Floats:
    """Polygons with their first corner repeated up to so many."""
    return np.concatenate([corner, *[corner[:, :1]] * (edges - corner.shape[1])], axis=1)


def _sheets(number: int, body: Body, bright: Bools, table: SurfaceTable) -> list[_Sheet]:
    """Those of a body: faces that share a corner."""
    material = body.face_material
    face = indexes(bright[material])
    if not len(face):
        return []
    corner = body.vertices[body.faces[face]].astype(np.float64)
    _, point = np.unique(corner.reshape(-1, 3), axis=0, return_inverse=True)
    point, mine = point.ravel(), np.arange(len(face)).repeat(3)
    count = len(face) + int(point.max()) + 1
    graph = coo_matrix((np.ones(len(point), bool), (mine, len(face) + point)), (count, count))
    group = csgraph.connected_components(graph, directed=False)[1][: len(face)]
    found = []
    for one in np.unique(group):
        at = indexes(group == one)
        part = corner[at]
        middle = 0.5 * (part.min(axis=(0, 1)) + part.max(axis=(0, 1)))
        radius = float(np.linalg.norm(part - middle, axis=2).max())
        kind = material[face[at]].astype(np.int64)
        closed = np.asarray(body.geometry.closed[face[at]], bool)
        found.append(_Sheet(number, part, kind, table.largest[kind], closed, middle, radius))
    return found
