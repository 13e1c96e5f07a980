"""Bright faces: which surfaces of a scene are, and which of them come near a beam.

Belongs here: sheets (bright faces that hang together), the search for beams beside them, faces in the coordinates of
beams. Not: the light on them, and what hides them (bright).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np

from emulator.compiled.pair import OTHERWISE, by_loops
from emulator.physics import polygons
from emulator.physics.arrays import Bools, Floats, Ints, group_starts, indexes, ramp
from emulator.physics.beams import NO_WIDTH, BeamShape
from emulator.physics.materials import SurfaceTable
from emulator.world.batched_poses import BatchedPoses
from emulator.world.connected import pieces_of
from emulator.world.fed import Fed, around
from emulator.world.motion import Motion, Pose

if TYPE_CHECKING:
    from emulator.world.scene import Body, Scene

BRIGHT = 10.0
"Equivalent reflectance from which on a surface is bright; paint, metal and snow stay below 2, sheeting begins at 150."
PAIRS_AT_ONCE = 200_000
_ZERO = np.zeros(1)


@dataclass(frozen=True)
class Radii:
    """Beam radii beyond which the light of a beam on a bright surface cannot be seen."""

    floor_m: float
    "Nearer than this the threshold rises as the light does."
    white_m2: float
    "Of the threshold: amplitude of a whole beam on a white plate at 1 m."
    area_m2: float
    "Square of the lens's radius."
    unseen: float
    "Of the threshold."
    least: float
    "Where any of it is seen."
    most: float

    def bound(self, distance_m: Floats, strength: Floats) -> Floats:
        """Amplitude of a whole beam on such a surface, as near or farther, over the threshold, at the most."""
        distance_m = np.maximum(distance_m, self.floor_m)
        return np.asarray(self.white_m2 / (distance_m**2 + self.area_m2) * strength)

    def __call__(self, distance_m: Floats, strength: Floats) -> Floats:
        """On a surface of this equivalent reflectance at a distance; 0: none."""
        most = math.exp(2.0 * self.most**2)
        radii = np.sqrt(0.5 * np.log(np.clip(self.bound(distance_m, strength) / self.unseen, 1.0, most)))
        return np.where(radii > 0.0, np.maximum(radii, self.least), 0.0)


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
        return np.asarray(np.einsum("nij,nkj->nki", self.pose.rotation[beam], own))

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
    closed: Bools
    middle_m: Floats
    radius_m: float


def _near_by_loops(loops: ModuleType, sheets: Sheets, frames: Frames, radii: Radii, reach_m: float) -> Faced:
    """Where no face reaches behind its pupil."""
    shape, t_s = frames.shape, frames.t_s
    first, last = float(t_s.min()), float(t_s.max())
    now = sheets._poses.during(first, last)
    bent, held, held_m, bent_at, bent_turned = sheets._unbent
    if len(now.curved):
        bent, held, held_m, bent_at, bent_turned = sheets._bent(now.curved, frames, reach_m)
    law = np.array([
        *_tangents(shape), shape.exit_radius_m, math.cos(shape.roll_rad), math.sin(shape.roll_rad), reach_m,
        *vars(radii).values(),
    ])  # fmt: skip
    cut, (beam, sheet, face), (offset, height), corner, normal, across = loops.beside(
        now.at, now.velocity, now.since, now.turned, bent, held, held_m, bent_at, bent_turned, frames.pose.position_m,
        frames.pose.rotation, frames.own_axis, frames.axis, t_s, sheets._home, sheets._first, sheets._faces,
        sheets._middle_m, sheets._radius_m, sheets._strength, sheets._corner_m, sheets._normal, sheets._behind_m,
        sheets._closed, sheets._face_strength, law,
    )  # fmt: skip
    if cut:
        return OTHERWISE
    return Faced(
        beam, sheets._actor[sheet], sheets._material[face], sheets._face_strength[face], across, normal, -height,
        corner, offset,
    )  # fmt: skip


class Sheets:
    """The bright faces of a scene's rigid bodies."""

    @np.errstate(under="ignore")
    def __init__(self, scene: Scene, table: SurfaceTable) -> None:
        bright = bright_of(table)
        rigid = [(k, body) for k, body in enumerate(scene.bodies) if body.frames is None]
        sheets = [one for k, body in rigid for one in _sheets(k, body, bright)]
        self._bodies = scene.bodies
        self._fixed = {
            k: (body.motion.position(_ZERO)[0], body.motion.rotation(_ZERO)[0], body.motion.still)
            for k, body in rigid
            if not body.motion.turns
        }
        "Of bodies that do not turn: where they are at time 0, how they are turned, whether they stay there."
        self._body = np.array([one.body for one in sheets], np.int64)
        homes, self._home = np.unique(self._body, return_inverse=True)
        "(s,) Which of the bodies that have one."
        self._moved = [scene.bodies[number].motion for number in homes.tolist()]
        "Their motions."
        self._poses = BatchedPoses(self._moved)
        nowhere = np.zeros((0, 3))
        self._unbent = np.full(len(homes), -1), nowhere, np.zeros(0), nowhere, np.zeros((0, 3, 3))
        self._actor = np.array([scene.bodies[one.body].actor for one in sheets], np.int64)
        self._middle_m = np.array([one.middle_m for one in sheets]).reshape(-1, 3)
        self._arm_m = self._middle_m.copy()
        "(s, 3) the same turned into the world, of bodies that do not turn."
        for k, number in enumerate(self._body.tolist()):
            if number in self._fixed:
                self._arm_m[k] = self._fixed[number][1] @ self._middle_m[k]
        self._still_m = np.zeros((len(sheets), 3))
        "(s, 3) where they are, of bodies that stay there."
        self._roaming: list[tuple[slice, Motion, bool]] = []
        "Those of other bodies that nobody feeds: their motion, and whether they turn."
        for begin, end in _runs(self._body):
            number, mine = int(self._body[begin]), slice(begin, end)
            motion, fixed = scene.bodies[number].motion, self._fixed.get(number)
            if fixed is not None and fixed[2]:
                self._still_m[mine] = fixed[0] + self._arm_m[mine]
            elif not isinstance(motion, Fed):
                self._roaming.append((mine, motion, fixed is None))
        fed = {number: scene.bodies[number].motion for number in dict.fromkeys(self._body.tolist())}
        moved = {number: motion for number, motion in fed.items() if isinstance(motion, Fed)}
        self._fed_motions = list(moved.values())
        self._fed = np.array([k for k, number in enumerate(self._body.tolist()) if number in moved], np.int64)
        "Sheets of bodies that somebody else moves; which of these motions each has, and how far from its origin it is."
        self._fed_motion = np.array([list(moved).index(number) for number in self._body[self._fed].tolist()], np.int64)
        self._fed_arm_m = np.linalg.norm(self._middle_m[self._fed], axis=1)
        self._radius_m = np.array([one.radius_m for one in sheets])
        self._faces = np.array([len(one.material) for one in sheets], np.int64)
        self._first = self._faces.cumsum() - self._faces
        self._corner_m = np.concatenate([np.zeros((0, 3, 3)), *(one.corner_m for one in sheets)])
        self._material = np.concatenate([np.zeros(0, np.int64), *(one.material for one in sheets)])
        self._closed = np.concatenate([np.zeros(0, bool), *(one.closed for one in sheets)])
        self._face_strength = table.largest[self._material]
        self._strength = np.maximum.reduceat(self._face_strength, self._first) if sheets else np.zeros(0)
        side = self._corner_m[:, 1:] - self._corner_m[:, :1]
        normal = np.cross(side[:, 0], side[:, 1])
        self._normal = normal / np.maximum(np.linalg.norm(normal, axis=1), 1e-300)[:, None]
        self._behind_m = (self._normal * self._corner_m[:, 0]).sum(axis=1)

    @by_loops(_near_by_loops, "beside")
    def near(self, frames: Frames, radii: Radii, reach_m: float) -> Faced:
        """Pairs of a beam and a face that comes into its tail; not those of a closed body that look away."""
        beam, sheet = self._pairs(frames, radii, reach_m)
        if not len(beam):
            return _NONE
        parts = []
        ends = self._faces[sheet].cumsum()
        for begin, end in _portions(ends):
            one = self._faced(beam[begin:end], sheet[begin:end], frames, radii, reach_m)
            parts += [one] if len(one) else []
        if len(parts) <= 1:
            return parts[0] if parts else _NONE
        edges = max(one.corner.shape[1] for one in parts)
        columns = [vars(one) | {"corner": _padded(one.corner, edges)} for one in parts]
        return Faced(*(np.concatenate([one[name] for one in columns]) for name in columns[0]))

    def _pairs(self, frames: Frames, radii: Radii, reach_m: float) -> tuple[Ints, Ints]:
        """Beams, and sheets whose sphere comes into their cones wherever it and the sensor are in this sweep."""
        eye, centre, size = self._spheres(frames)
        away = centre - eye
        distance = np.linalg.norm(away, axis=1)
        nearest = np.maximum(distance - size, 0.0)
        most = radii(nearest, self._strength)
        wide = (size + most * frames.shape.exit_radius_m) / np.maximum(distance, 1e-9)
        angle = np.arcsin(np.minimum(wide, 1.0)) + np.arctan(most * float(_tangents(frames.shape).max()))
        least = np.where((wide < 1.0) & (angle < np.pi), np.cos(np.minimum(angle, np.pi)), -2.0) - 1e-12
        some = indexes((nearest <= reach_m) & (most > 0.0))
        way = away[some] / np.maximum(distance[some], 1e-9)[:, None]
        cosine = way[:, 0, None] * frames.axis[:, 0]
        cosine += way[:, 1, None] * frames.axis[:, 1]
        cosine += way[:, 2, None] * frames.axis[:, 2]
        sheet, beam = np.nonzero(cosine >= least[some, None])
        return beam, some[sheet]

    def _spheres(self, frames: Frames) -> tuple[Floats, Floats, Floats]:
        """The middle of the sensor's places; centres (s, 3) and radii (s,) about which sheets stay, seen from all."""
        t_s, place = frames.t_s, frames.pose.position_m
        first, last = float(t_s.min()), float(t_s.max())
        low = high = place[0]
        if place.strides[0]:
            low, high = place.min(axis=0), place.max(axis=0)
        eye, slack = 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low))
        centre, size = self._still_m.copy(), self._radius_m + slack
        when = np.array([0.5 * (first + last)])
        for mine, motion, turns in self._roaming:
            if turns:
                centre[mine] = motion.position(when)[0]
                size[mine] += np.linalg.norm(self._middle_m[mine], axis=1)
            else:
                centre[mine] = motion.position(when)[0] + self._arm_m[mine]
            if last > first:
                size[mine] += motion.speed_bound_m_s * 0.5 * (last - first)
        if len(self._fed):
            where, far = around(self._fed_motions, t_s)
            centre[self._fed] = where[:, self._fed_motion].T
            size[self._fed] += self._fed_arm_m + far[self._fed_motion]
        return eye, centre, size

    def _bent(self, curved: Ints, frames: Frames, reach_m: float) -> tuple[Ints, Floats, Floats, Floats, Floats]:
        """What loops need of bodies that do not move straight: which, spheres of sheets, poses as each beam fires."""
        eye, centre, size = self._spheres(frames)
        bent = np.full(len(self._moved), -1, np.int64)
        bent[curved] = np.arange(len(curved))
        within = np.linalg.norm(centre - eye, axis=1) - size <= reach_m
        t_s = frames.t_s
        at, turned = np.zeros((len(curved), len(t_s), 3)), np.zeros((len(curved), len(t_s), 3, 3))
        for row in np.unique(bent[self._home[within]]):
            if row >= 0:
                pose = self._moved[curved[row]].pose(t_s)
                at[row], turned[row] = pose.position_m, pose.rotation
        return bent, centre, size, at.reshape(-1, 3), turned.reshape(-1, 3, 3)

    def _faced(self, beam: Ints, sheet: Ints, frames: Frames, radii: Radii, reach_m: float) -> Faced:
        """Those of pairs of a beam and a sheet."""
        position, rotation = np.zeros((len(beam), 3)), np.zeros((len(beam), 3, 3))
        body, t_s = self._body[sheet], frames.t_s[beam]
        since, until = (float(frames.t_s.min()), float(frames.t_s.max())) if len(self._fed) else (0.0, 0.0)
        for begin, end in _runs(body):
            motion, mine = self._bodies[body[begin]].motion, slice(begin, end)
            fixed = self._fixed.get(int(body[begin]))
            one = motion.straight if isinstance(motion, Fed) else None
            if one is not None and one.holds(since, until):
                position[mine], rotation[mine] = one.position(t_s[mine]), one.rotation
            elif fixed is None:
                pose = motion.pose(t_s[mine])
                position[mine], rotation[mine] = pose.position_m, pose.rotation
            else:
                position[mine], rotation[mine] = fixed[0] if fixed[2] else motion.position(t_s[mine]), fixed[1]
        pair, face, offset, height, corner, normal, across = _beside(
            self, beam, sheet, position, rotation, frames, radii, reach_m
        )
        return Faced(
            beam[pair], self._actor[sheet[pair]], self._material[face], self._face_strength[face], across, normal,
            -height, corner, offset,
        )  # fmt: skip


_Beside = tuple[Ints, Ints, Floats, Floats, Floats, Floats, Floats]
"Pair, face; offset, height, corners and normals in the beams' coordinates, the beams' axes."


def _beside(
    sheets: Sheets, beam: Ints, sheet: Ints, position: Floats, rotation: Floats, frames: Frames, radii: Radii,
    reach_m: float,
) -> _Beside:  # fmt: skip
    """Faces of these sheets, whose bodies are there, that come into the tails of these beams."""
    # spheres where they are
    shift = position - frames.pose.position_m[beam]
    middle = shift + np.einsum("nij,nj->ni", rotation, sheets._middle_m[sheet])
    along = np.einsum("ni,ni->n", middle, frames.axis[beam])
    distance = np.sqrt(np.einsum("ni,ni->n", middle, middle))
    radius, tangents, w0 = sheets._radius_m[sheet], _tangents(frames.shape), frames.shape.exit_radius_m
    aside = np.sqrt(np.maximum(distance**2 - along**2, 0.0)) - radius
    nearest, far = np.maximum(distance - radius, 0.0), np.maximum(along + radius, 0.0)
    width = radii(nearest, sheets._strength[sheet]) * (float(tangents.max()) * far + w0)
    near = indexes((far > 0.0) & (aside <= width) & (nearest <= reach_m))
    beam, sheet, shift, rotation = beam[near], sheet[near], shift[near], rotation[near]
    # faces that look here: of a closed body they are counter-clockwise seen from outside
    many = sheets._faces[sheet]
    row, face = np.arange(len(near)).repeat(many), sheets._first[sheet].repeat(many) + ramp(many)
    eye = -np.einsum("nji,nj->ni", rotation, shift)
    height = np.einsum("ki,ki->k", sheets._normal[face], eye[row]) - sheets._behind_m[face]
    at = indexes((height > 0.0) | (~sheets._closed[face] & (height < 0.0)))
    row, face, height = row[at], face[at], height[at]
    # in the coordinates of the beams
    across = frames.across(beam)
    turn = np.einsum("nij,njk->nik", across, rotation)
    corner = np.einsum("kij,kcj->kci", turn[row], sheets._corner_m[face])
    corner += np.einsum("nij,nj->ni", across, shift)[row][:, None]
    at = indexes(corner[:, :, 2].max(axis=1) > 0.0)
    row, face, height, corner = row[at], face[at], height[at], corner[at]
    if len(at):
        corner = polygons.before_pupil(corner)
    flat = corner[:, :, :2] / np.maximum(tangents * corner[:, :, 2:] + w0, 1e-12)
    offset = polygons.offset_of(flat)
    nearest = np.maximum(np.abs(height), corner[:, :, 2].min(axis=1))
    at = indexes((offset <= radii(nearest, sheets._face_strength[face])) & (nearest <= reach_m))
    row, face = row[at], face[at]
    normal = np.einsum("kij,kj->ki", turn[row], sheets._normal[face])
    return near[row], face, offset[at], height[at], flat[at], normal, across[row]


_NONE = Faced(
    np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0), np.zeros((0, 3, 3)),
    np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3, 2)), np.zeros(0),
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


def _runs(numbers: Ints) -> list[tuple[int, int]]:
    """Begins and ends of runs of equal ones."""
    first = group_starts(numbers).tolist()
    return list(zip(first, [*first[1:], len(numbers)], strict=True))


def _portions(ends: Ints) -> list[tuple[int, int]]:
    """Begins and ends of portions with about `PAIRS_AT_ONCE` faces, by the sum of faces up to each."""
    return _runs((ends - 1) // PAIRS_AT_ONCE)


def _sheets(number: int, body: Body, bright: Bools) -> list[_Sheet]:
    """Those of a body: faces that share a corner."""
    material = body.face_material
    face = indexes(bright[material])
    if not len(face):
        return []
    corner = body.vertices[body.faces[face]].astype(np.float64)
    _, point = np.unique(corner.reshape(-1, 3), axis=0, return_inverse=True)
    point, mine = point.ravel(), np.arange(len(face)).repeat(3)
    count = len(face) + int(point.max()) + 1
    group = pieces_of(count, mine, len(face) + point)[1][: len(face)]
    found = []
    for one in np.unique(group):
        at = indexes(group == one)
        part = corner[at]
        middle = 0.5 * (part.min(axis=(0, 1)) + part.max(axis=(0, 1)))
        radius = float(np.linalg.norm(part - middle, axis=2).max())
        kind = material[face[at]].astype(np.int64)
        closed = np.asarray(body.geometry.closed[face[at]], bool)
        found.append(_Sheet(number, part, kind, closed, middle, radius))
    return found
