"""Bright edges: rays for the tail of beams beside surfaces so bright that the millionth part of a beam is seen.

Belongs here: which beams those are, and nodes on the bright faces themselves, weighted by the beam there. Not:
bundles (rays), what a surface reflects (physics.materials), particles.

A bundle of equal shares ends where its outermost ray goes, and counts an edge in whole rays. Of a beam near a bright
face's edge, what bright faces send back is therefore not taken from its bundle: every face is cut into pieces that are
small in the beam's own coordinates, nodes on them get the power that falls on them, and a ray to each tells whether it
is seen. All else that the beam meets is still its bundle's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from emulator.physics import beams
from emulator.physics.arrays import Bools, Floats, Ints, indexes
from emulator.physics.materials import Material, SurfaceTable
from emulator.physics.subechoes import Kept, SubEchoes
from emulator.sensing.adapt import CellHits
from emulator.sensing.contracts import FacedCaster, Medium
from emulator.sensing.model import SensorModel
from emulator.sensing.paths import Seen, Surfaces, collected, reach_of, returned, windows
from emulator.sensing.rays import Bundles, Rays, cast_rays, part_of, turned
from emulator.world.motion import Pose

if TYPE_CHECKING:
    from emulator.world.scene import Body, Scene

BRIGHT = 10.0
"Equivalent reflectance from which on a surface is bright; paint, metal and snow stay below 2, sheeting begins at 150."
UNSEEN = 0.02
"Of the threshold: what all of a bright surface beyond the outermost nodes may bring back."
MOST_RADII = 4.5
LEAST_RADII = 2.75
"Where any of it is seen: 1e-6 of a half plane's light then keeps its two digits."
INSIDE = 0.25
"A beam of which so much falls on bright faces has them to a few per cent by its bundle: fifteen rays of 61."
ROUGH = 6.0
"Longest edge of a piece where only that is asked."
PIECE = 2.6
"Longest edge of a piece in beam radii, on the axis; shorter outside, where the profile falls faster."
FAINT_NODE = 1e-3
"Of what a beam gets from bright faces: nodes below are left out, and the others take their share."
FINER = 2.0
"Edges of pieces where something stands before a part of a bright face."
MOST_LEVELS = 60
PAIRS_AT_ONCE = 200_000

# degree 4 on a triangle, six points: Strang and Fix 1973
_A, _B = 0.445948490915965, 0.091576213509771
_NODES = np.array([np.roll([1.0 - 2.0 * one, one, one], k) for one in (_A, _B) for k in range(3)])
_WEIGHTS = np.repeat([0.223381589678011, 0.109951743655322], 3)
_BLACK = Material("black", ((0.0, 0.0),))


@dataclass(frozen=True, eq=False)
class Faces:
    """The bright faces of one body, about its origin."""

    body: int
    face: Ints
    "(f,) of the body."
    corner_m: Floats
    "(f, 3, 3)"
    centre_m: Floats
    "(f, 3)"
    radius_m: Floats
    "(f,)"
    strength: Floats
    "(f,) largest equivalent reflectance."
    closed: Bools
    "(f,) of a closed shell."
    middle_m: Floats
    "(3,) centre of a sphere around all."
    reach_m: float
    "Its radius."


@dataclass(frozen=True, eq=False)
class Tails:
    """What was done for bright edges in a sweep."""

    beams: Ints
    "Whose bright faces have their own rays."
    rays: int
    "Cast for it, also to faces that were hidden."


@dataclass(frozen=True, eq=False)
class _Frames:
    """Beams: n centres, axes and the two directions across, in the world."""

    centre_m: Floats
    across: Floats
    "(n, 3, 3): rows are along u, along v, along the axis."
    t_s: Floats


def bright_of(table: SurfaceTable) -> Bools:
    """(materials,) those whose tail is looked after: what they send on is another matter."""
    own = np.array([m.model not in ("glass", "mirror") for m in table.materials], bool)
    return np.asarray(own & (table.largest >= BRIGHT))


def wanted(model: SensorModel, scene: Scene, surfaces: Surfaces) -> bool:
    """Beams of this sensor have a tail, and there is a surface that may show it."""
    if model.beam.is_ray or model.beam.profile != "gauss" or model.rule in ("axis", "adaptive"):
        return False
    bright = bright_of(surfaces.table)
    return bool(bright.any()) and any(len(_faces(k, body, bright, surfaces.table)) for k, body in _rigid(scene))


def _rigid(scene: Scene) -> list[tuple[int, Body]]:
    return [(k, body) for k, body in enumerate(scene.bodies) if body.frames is None]


def _faces(number: int, body: Body, bright: Bools, table: SurfaceTable) -> list[Faces]:
    """Those of a body: none or one."""
    material = body.face_material
    face = indexes(bright[material])
    if not len(face):
        return []
    corner = body.vertices[body.faces[face]].astype(np.float64)
    centre = corner.mean(axis=1)
    radius = np.linalg.norm(corner - centre[:, None], axis=2).max(axis=1)
    low, high = corner.min(axis=(0, 1)), corner.max(axis=(0, 1))
    middle = 0.5 * (low + high)
    reach = float(np.linalg.norm(corner - middle, axis=2).max())
    return [
        Faces(
            number,
            face,
            corner,
            centre,
            radius,
            table.largest[material[face]],
            body.geometry.closed[face],
            middle,
            reach,
        )
    ]


class BrightEdges:
    """Finds the beams of one sensor near the edges of bright surfaces, and what these send back."""

    def __init__(
        self, scene: Scene, model: SensorModel, caster: FacedCaster, surfaces: Surfaces, at_rest: bool
    ) -> None:
        self._model, self._caster, self._scene = model, caster, scene
        self._bright = bright_of(surfaces.table)
        self._faces = [
            one for k, body in _rigid(scene) for one in _faces(k, body, self._bright, surfaces.table)
        ]  # fmt: skip
        self._replaced = np.zeros(len(scene.bodies), bool)
        self._replaced[[one.body for one in self._faces]] = True
        self._all_still = at_rest and model.leave_out.resting and all(body.still for body in scene.bodies)
        self._black: tuple[Surfaces, Surfaces] | None = None
        self._kept: tuple[tuple[object, ...], tuple[object, ...], tuple[SubEchoes, Tails]] | None = None

    def put_into(
        self, seen: Seen, bundles: Bundles, pose: Pose, t_s: Floats, surfaces: Surfaces, air: Medium, gain: float,
        farthest_m: float,
    ) -> tuple[Seen, Tails]:  # fmt: skip
        """What a sweep brings back, the beams near bright edges renewed."""
        key = id(bundles), id(surfaces), id(air), gain, farthest_m
        if self._kept is None or self._kept[0] != key or not self._all_still or air.uneven:
            made = self._made(bundles, pose, t_s, surfaces, air, gain, farthest_m)
            self._kept = key, (bundles, surfaces, air), made
        echoes, tails = self._kept[2]
        if not len(tails.beams):
            return seen, tails
        mine = np.zeros(len(bundles.axis), bool)
        mine[tails.beams] = True
        found = SubEchoes.joined(seen.found.of_beams(~mine), echoes)
        kept = None if seen.kept is None else Kept(seen.kept.found, seen.kept.changed | mine)
        return replace(seen, found=found, kept=kept), tails

    # ------------------------------------------------------------------ which beams
    def _made(
        self, bundles: Bundles, pose: Pose, t_s: Floats, surfaces: Surfaces, air: Medium, gain: float,
        farthest_m: float,
    ) -> tuple[SubEchoes, Tails]:  # fmt: skip
        frames = self._frames(bundles, pose, t_s)
        reach = reach_of(self._model, farthest_m)
        pairs: list[_Pairs] = []
        for one in self._faces:
            for found in self._near(one, frames, reach, gain):
                pairs.append(replace(found, first=_count(pairs)))
        rough = _Nodes.on(pairs, self._model.beam, ROUGH, -0.5 * math.log(FAINT_NODE))
        tail = np.bincount(rough.beam, rough.share, len(t_s)) < INSIDE
        beam_of = np.concatenate([np.zeros(0, np.int64), *(one.beam for one in pairs)])
        nodes = _Nodes.on(
            [one.taken(tail[beam_of]) for one in pairs], self._model.beam, PIECE, -0.5 * math.log(FAINT_NODE)
        )
        if not len(nodes):
            return SubEchoes.none(), Tails(np.zeros(0, np.int64), 0)
        nodes = nodes.without_faint(FAINT_NODE, len(t_s))
        hits = self._seen(nodes, frames, reach)
        seen = np.isfinite(hits.range_m)
        lit = np.bincount(nodes.beam, nodes.share * seen, len(t_s))
        chosen = indexes(lit > 0.0)
        cast = len(nodes)
        if not len(chosen):
            return SubEchoes.none(), Tails(chosen, cast)
        parts = [(nodes, hits)]
        # something stands before a part of a face: its edges want finer nodes
        met, missed = (np.bincount(nodes.pair, which, len(beam_of)) > 0.0 for which in (seen, ~seen))
        partly = met & missed
        if bool(partly.any()):
            kept = indexes(~partly[nodes.pair])
            finer = _Nodes.on(
                [one.taken(partly) for one in pairs], self._model.beam, PIECE / FINER, None, FAINT_NODE * lit
            )
            finer = finer.taken(indexes(finer.share > FAINT_NODE * lit[finer.beam]))
            parts = [(nodes.taken(kept), hits.taken(kept)), (finer, self._seen(finer, frames, reach))]
            cast += len(finer)
        rays = cast_rays(part_of(bundles, chosen), Pose(pose.position_m[chosen], pose.rotation[chosen]), t_s[chosen])
        others = self._others(rays, surfaces, air, gain, farthest_m, reach)
        number = np.full(len(t_s), -1, np.int64)
        number[chosen] = np.arange(len(chosen))
        own = [self._echoes(one, met, number, frames, rays, surfaces, air, gain) for one, met in parts]
        both = SubEchoes.joined(others, *own)
        return replace(both, beam=chosen[both.beam]), Tails(chosen, cast + len(rays.beam))

    def _frames(self, bundles: Bundles, pose: Pose, t_s: Floats) -> _Frames:
        """Beams in the world; u and v as `beams.spread` has them, before its turn about the axis."""
        axis, roll = bundles.axis, self._model.beam.roll_rad
        level = np.hypot(axis[:, 0], axis[:, 1])
        safe = np.where(level > 0.0, level, 1.0)
        cosine, sine = np.where(level > 0.0, axis[:, 0] / safe, 1.0), axis[:, 1] / safe
        left = np.stack([-sine, cosine, np.zeros(len(axis))], axis=1)
        up = np.cross(axis, left)
        u, v = math.cos(roll) * left + math.sin(roll) * up, math.cos(roll) * up - math.sin(roll) * left
        return _Frames(pose.position_m, turned(pose.rotation, np.stack([u, v, axis], axis=1)), t_s)

    def _radii(self, distance_m: Floats, strength: Floats, gain: float) -> Floats:
        """Beam radii beyond which all the light on such a surface cannot be seen."""
        most = math.exp(2.0 * MOST_RADII**2)
        radii = np.sqrt(0.5 * np.log(np.clip(self._bound(distance_m, strength, gain) / UNSEEN, 1.0, most)))
        return np.where(radii > 0.0, np.maximum(radii, LEAST_RADII), 0.0)

    def _bound(self, distance_m: Floats, strength: Floats, gain: float) -> Floats:
        """Amplitude of a whole beam on such a surface, as near or farther, over the threshold, at the most."""
        model = self._model
        distance_m = np.maximum(distance_m, math.sqrt(model.floor_m2 / model.threshold))  # where the floor ends
        white = model.k_m2 * max(gain, 1e-12) / (distance_m**2 + model.aperture_radius_m**2)
        return np.asarray(white * strength / model.threshold)

    def _near(self, one: Faces, frames: _Frames, reach_m: float, gain: float) -> list[_Pairs]:
        """Pairs of a beam and a face that comes into its cone; not those of a closed body that look away."""
        n, motion = len(frames.t_s), self._scene.bodies[one.body].motion
        pose = motion.pose(frames.t_s[:1] if motion.still else frames.t_s)
        place = np.broadcast_to(pose.position_m, (n, 3)) - frames.centre_m
        turn = np.broadcast_to(pose.rotation, (n, 3, 3))
        middle = place + np.einsum("nij,j->ni", turn, one.middle_m)
        every = np.full(n, float(one.strength.max()))
        close, _ = self._in_cone(frames, np.arange(n), middle, np.full(n, one.reach_m), every, reach_m, gain)
        beams_, found = indexes(close), []
        step = max(1, PAIRS_AT_ONCE // len(one.face))
        for begin in range(0, len(beams_), step):
            some = beams_[begin : begin + step]
            beam, face = some.repeat(len(one.face)), np.tile(np.arange(len(one.face)), len(some))
            centre = place[beam] + np.einsum("kij,kj->ki", turn[beam], one.centre_m[face])
            near, radii = self._in_cone(
                frames, beam, centre, one.radius_m[face], one.strength[face], reach_m, gain
            )  # fmt: skip
            beam, face, radii = beam[near], face[near], radii[near]
            corner = place[beam][:, None] + np.einsum("kij,kcj->kci", turn[beam], one.corner_m[face])
            normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
            # of a closed body faces are counter-clockwise seen from outside
            away = one.closed[face] & (np.einsum("ij,ij->i", normal, corner[:, 0]) > 0.0)
            beam, face, radii, corner = (column[~away] for column in (beam, face, radii, corner))
            own = np.einsum("kij,kcj->kci", frames.across[beam], corner)
            found.append(_Pairs(one, beam, face, own, radii))
        return found

    def _in_cone(
        self, frames: _Frames, beam: Ints, centre_m: Floats, radius_m: Floats, strength: Floats, reach_m: float,
        gain: float,
    ) -> tuple[Bools, Floats]:  # fmt: skip
        """Spheres that touch their beam within the radii that count, and these."""
        shape = self._model.beam
        tangent = math.tan(max(shape.half_angle_x_rad, shape.half_angle_y_rad))
        along = np.einsum("ij,ij->i", centre_m, frames.across[beam, 2])
        distance = np.linalg.norm(centre_m, axis=1)
        across = np.sqrt(np.maximum(distance**2 - along**2, 0.0))
        nearest = np.maximum(distance - radius_m, 0.0)
        radii = self._radii(nearest, strength, gain)
        width = radii * (tangent * np.maximum(along + radius_m, 0.0) + shape.exit_radius_m)
        return (along > -radius_m) & (across - radius_m <= width) & (nearest <= reach_m) & (radii > 0.0), radii

    def _is_mine(self, body: Ints, material: Ints) -> Bools:
        return np.asarray((body >= 0) & self._bright[material] & self._replaced[body])

    def _rays(self, frames: _Frames, beam: Ints, u: Floats, v: Floats) -> tuple[Floats, Floats]:
        """Starts and directions of rays at (u, v) of their beams, as `beams.spread` makes them."""
        shape, across = self._model.beam, frames.across[beam]
        x, y = math.tan(shape.half_angle_x_rad) * u, math.tan(shape.half_angle_y_rad) * v
        ray = across[:, 2] + x[:, None] * across[:, 0] + y[:, None] * across[:, 1]
        ray /= np.sqrt(1.0 + x * x + y * y)[:, None]
        origin = frames.centre_m[beam]
        if shape.exit_radius_m >= beams.NO_WIDTH:
            origin = origin + shape.exit_radius_m * (u[:, None] * across[:, 0] + v[:, None] * across[:, 1])
        return origin, ray

    # ------------------------------------------------------------------ what they bring back
    def _others(
        self, rays: Rays, surfaces: Surfaces, air: Medium, gain: float, farthest_m: float, reach_m: float
    ) -> SubEchoes:
        """Of the bundles, where bright faces only stand in the way."""
        hits = CellHits.of(self._caster.first_hits(rays.origin_m, rays.direction, rays.t_s, max_range_m=reach_m))
        mine = self._is_mine(hits.body, hits.material)
        black = len(surfaces.table.materials)
        dark = replace(hits, material=np.where(mine, black, hits.material).astype(np.int32))
        return returned(dark, rays, self._caster, self._with_black(surfaces), air, self._model, gain, farthest_m).echoes

    def _with_black(self, surfaces: Surfaces) -> Surfaces:
        if self._black is None or self._black[0] is not surfaces:
            table = surfaces.table
            more = SurfaceTable((*table.materials, _BLACK), table.wavelength_nm, np.append(table.rho, 0.0))
            self._black = surfaces, Surfaces.of(more, surfaces.solid)
        return self._black[1]

    def _seen(self, nodes: _Nodes, frames: _Frames, reach_m: float) -> CellHits:
        """What rays to the nodes meet; no range where that is something else."""
        origin, ray = self._rays(frames, nodes.beam, nodes.u, nodes.v)
        hits = self._caster.first_hits(origin, ray, frames.t_s[nodes.beam], max_range_m=reach_m)
        there = (hits.body == nodes.body) & (hits.face == nodes.face)
        return replace(CellHits.of(hits), range_m=np.where(there, hits.range_m, np.nan))

    def _echoes(
        self, nodes: _Nodes, hits: CellHits, number: Ints, frames: _Frames, rays: Rays, surfaces: Surfaces, air: Medium,
        gain: float,
    ) -> SubEchoes:  # fmt: skip
        """Of the nodes that are seen; beams are numbered anew, -1 not wanted."""
        met = indexes(np.isfinite(hits.range_m) & (number[nodes.beam] >= 0))
        nodes, hits, mine = nodes.taken(met), hits.taken(met), number[nodes.beam[met]]
        origin, ray = self._rays(frames, nodes.beam, nodes.u, nodes.v)
        depth = air.depth(origin, ray, hits.range_m, frames.t_s[nodes.beam])
        weight = nodes.share * windows(rays, self._model, gain)[mine]
        back = surfaces.table.back(hits.material.astype(np.int64), hits.cosine)
        amplitude = weight * collected(hits.range_m, depth, self._model) * back
        return SubEchoes.of(mine, hits.range_m, amplitude, None, hits.actor.astype(np.int64))


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Beams, and bright faces of one body that come into their cones."""

    of: Faces
    beam: Ints
    face: Ints
    "Rows of `of`."
    corner_m: Floats
    "(k, 3, 3) along u, v and the axis, from the optical centre."
    radii: Floats
    first: int = 0
    "Number of the first pair among those of all bodies."
    number: Ints | None = None
    "(k,) of the pairs, where some were taken."

    def taken(self, wanted: Bools) -> _Pairs:
        """Those that are wanted, by their number."""
        number = self.first + np.arange(len(self.beam)) if self.number is None else self.number
        at = indexes(wanted[number])
        return _Pairs(self.of, self.beam[at], self.face[at], self.corner_m[at], self.radii[at], 0, number[at])


def _count(pairs: list[_Pairs]) -> int:
    return sum(len(one.beam) for one in pairs)


@dataclass(frozen=True, eq=False)
class _Nodes:
    """Points on bright faces, each for a small piece of them."""

    pair: Ints
    "Number of the pair of beam and face."
    beam: Ints
    body: Ints
    face: Ints
    u: Floats
    v: Floats
    share: Floats

    def __len__(self) -> int:
        return len(self.beam)

    def taken(self, index: Ints) -> _Nodes:
        """Some of them."""
        return _Nodes(*(column[index] for column in vars(self).values()))

    @classmethod
    def on(
        cls,
        pairs: list[_Pairs],
        shape: beams.BeamShape,
        piece: float,
        near: float | None = None,
        least: Floats | None = None,
    ) -> _Nodes:
        """Those of all pairs; `near`: only as far out as the profile's exponent falls by twice this."""
        pairs = [one for one in pairs if len(one.beam)]
        if not pairs:
            return cls(*([np.zeros(0, np.int64)] * 4), *([np.zeros(0)] * 3))
        corner, radii = (np.concatenate([getattr(one, name) for one in pairs]) for name in ("corner_m", "radii"))
        number = [one.first + np.arange(len(one.beam)) if one.number is None else one.number for one in pairs]
        beam = np.concatenate([one.beam for one in pairs])
        body = np.repeat([one.of.body for one in pairs], [len(one.beam) for one in pairs])
        face = np.concatenate([one.of.face[one.face] for one in pairs])
        if near is not None:  # farther out than the nearest of them nothing is left beside it
            offset = _offset(corner, shape)
            least_offset = np.full(int(beam.max()) + 1, np.inf)
            np.minimum.at(least_offset, beam, offset)
            radii = np.minimum(radii, np.sqrt(least_offset[beam] ** 2 + near))
            kept = indexes(offset <= radii)
        else:
            kept = np.arange(len(beam))
        below = None if least is None else least[beam[kept]]
        if near is not None:
            below = FAINT_NODE * 0.1 * np.exp(-2.0 * least_offset[beam[kept]] ** 2)
        row, u, v, share = nodes_on(corner[kept], radii[kept], shape, piece, below)
        row = kept[row]
        return cls(np.concatenate(number)[row], beam[row], body[row], face[row], u, v, share)

    def without_faint(self, share: float, beams_: int) -> _Nodes:
        """Without those that have less than this of what falls on their beam's bright faces; the others take it."""
        whole = np.bincount(self.beam, self.share, beams_)
        left = self.taken(indexes(self.share > share * whole[self.beam]))
        kept = np.maximum(np.bincount(left.beam, left.share, beams_), 1e-300)
        return replace(left, share=left.share * (whole / kept)[left.beam])


def nodes_on(
    corner_m: Floats, radii: Floats, shape: beams.BeamShape, piece: float = PIECE, least: Floats | None = None
) -> tuple[Ints, Floats, Floats, Floats]:
    """Nodes on triangles with the share of a Gaussian beam's power that falls on each: triangle, u, v, share.

    Parameters
    ----------
    corner_m : (k, 3, 3) corners along u, v and the beam's axis, from the optical centre. [m]
    radii : (k,) beam radii beyond which nothing is wanted.
    shape : half angles and exit radius.
    piece : longest edge of a piece on the axis, in beam radii.
    least : (k,) share below which a piece is not wanted; None: all are.

    Notes
    -----
    The beam is a linear cone, so triangles stay triangles in (u, v). They are halved at their longest edge until they
    are small against the profile's changes; a rule of degree 4 then integrates it to 1e-3 (a tail) or 1e-2 (half the
    beam).
    """
    grow = np.array([math.tan(shape.half_angle_x_rad), math.tan(shape.half_angle_y_rad)])
    w0, row, parts = shape.exit_radius_m, np.arange(len(corner_m)), []
    least = np.zeros(len(corner_m)) if least is None else least
    for _ in range(MOST_LEVELS):
        if not len(row):
            break
        z = corner_m[:, :, 2]
        ahead = z.min(axis=1) > np.maximum(0.05 * z.max(axis=1), 1e-9)
        width = np.maximum(grow * np.where(ahead[:, None], z, 1.0)[:, :, None] + w0, 1e-12)
        uv = np.where(ahead[:, None, None], corner_m[:, :, :2] / width, 0.0)
        centre = uv.mean(axis=1)
        arm = np.linalg.norm(uv - centre[:, None], axis=2).max(axis=1)
        off = np.linalg.norm(centre, axis=1)
        kept = np.where(ahead, off - arm <= radii, _touches(corner_m, radii, float(grow.max()), w0))
        edge = np.where(ahead[:, None, None], uv, corner_m[:, :, :2])
        edge = np.roll(edge, -1, axis=1) - edge
        along = np.where(ahead[:, None], 0.0, np.roll(z, -1, axis=1) - z)
        length = np.sqrt(np.einsum("kci,kci->kc", edge, edge) + along**2)
        nearest = np.maximum(off - arm, 0.0)
        most = np.exp(-2.0 * nearest**2) * (piece / (1.0 + nearest)) ** 2 / np.pi
        kept &= ~ahead | (most >= least[row])
        small = ahead & (length.max(axis=1) * (1.0 + nearest) <= piece)
        done = indexes(kept & small)
        parts.append((row[done], uv[done]))
        again = indexes(kept & ~small)
        row, radii = row[again], radii[again]
        corner_m, row, radii = _halved(corner_m[again], length[again].argmax(axis=1), row, radii)
    row = np.concatenate([np.zeros(0, np.int64), *(one for one, _ in parts)])
    uv = np.concatenate([np.zeros((0, 3, 2)), *(one for _, one in parts)])
    side, other = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    area = 0.5 * np.abs(side[:, 0] * other[:, 1] - side[:, 1] * other[:, 0])
    place = np.einsum("qc,kci->kqi", _NODES, uv)
    weight = _WEIGHTS * np.exp(-2.0 * np.einsum("kqi,kqi->kq", place, place))
    whole = weight.sum(axis=1)
    mean = np.einsum("kq,kqi->ki", weight, place) / whole[:, None]
    return row, mean[:, 0], mean[:, 1], 2.0 / np.pi * area * whole


def _offset(corner_m: Floats, shape: beams.BeamShape) -> Floats:
    """Least distance of triangles from the beam's axis in beam radii; 0 where they reach beside the optical centre."""
    z = corner_m[:, :, 2]
    ahead = z.min(axis=1) > np.maximum(0.05 * z.max(axis=1), 1e-9)
    grow = np.array([math.tan(shape.half_angle_x_rad), math.tan(shape.half_angle_y_rad)])
    width = np.maximum(grow * np.where(ahead[:, None], z, 1.0)[:, :, None] + shape.exit_radius_m, 1e-12)
    uv = corner_m[:, :, :2] / width
    way = np.roll(uv, -1, axis=1) - uv
    square = np.maximum(np.einsum("kci,kci->kc", way, way), 1e-300)
    part = np.clip(-np.einsum("kci,kci->kc", uv, way) / square, 0.0, 1.0)
    foot = uv + part[:, :, None] * way
    side = uv[:, :, 0] * way[:, :, 1] - uv[:, :, 1] * way[:, :, 0]
    around = (side >= 0.0).all(axis=1) | (side <= 0.0).all(axis=1)
    return np.where(ahead & ~around, np.sqrt(np.einsum("kci,kci->kc", foot, foot)).min(axis=1), 0.0)


def _touches(corner_m: Floats, radii: Floats, grow: float, w0: float) -> Bools:
    """Triangles beside the optical centre whose sphere comes into the cone before it."""
    centre = corner_m.mean(axis=1)
    arm = np.linalg.norm(corner_m - centre[:, None], axis=2).max(axis=1)
    across = np.hypot(centre[:, 0], centre[:, 1])
    along = centre[:, 2] + arm
    return np.asarray((along > 0.0) & (across - arm <= radii * (grow * np.maximum(along, 0.0) + w0)))


def _halved(corner_m: Floats, longest: Ints, row: Ints, radii: Floats) -> tuple[Floats, Ints, Floats]:
    """Every triangle twice, cut at its longest edge (from that corner to the next)."""
    each = np.arange(len(corner_m))
    a, b, c = (corner_m[each, (longest + k) % 3] for k in range(3))
    middle = 0.5 * (a + b)
    both = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
    return both, np.tile(row, 2), np.tile(radii, 2)
