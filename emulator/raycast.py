"""First hits of rays on the bodies of a scene; the only user of embreex.

Belongs here: structures for the caster, moving rays into them, refining what comes back in float64. Not: where rays
come from (beams) and what a hit means (physics).

The caster works in float32 and only decides *which* triangle is met; the distance is then recomputed in float64 from
the float64 plane of that triangle. To keep the decision good, every structure lies about its own float64 origin, and
rays begin where they enter its bounding sphere.

Bodies that never move are merged into a few structures, by place. All others share structures in another way: each
shape once, in a slot of its own, far enough from its neighbours that a ray which begins and ends at the slot's bounding
sphere cannot meet another; a ray is moved into the slot by the pose of the body at the ray's own time. So nothing is
ever rebuilt, a call costs the same few casts however many bodies move, and a thousand equal cars are stored once.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from emulator.motion import Motion, Steady
from emulator.scene import Body, Scene
from emulator.triangles import Geometry

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
Longs = NDArray[np.int64]
Flags = NDArray[np.bool_]

CELL_M = 1000.0
"Side of the cells by which resting bodies are merged: 500 m off the origin costs float32 3e-5 m."
MOST_MERGED = 500_000
"Triangles of resting bodies beyond which shapes that occur more than once are stored once instead of merged."
SLOTS = 64
"Shapes a structure: 4 x 4 x 4 keep the slots within a few radii of the origin."
SLOT_PITCH = 2.25
"Distance of neighbouring slots over the largest bounding radius in the structure; > 2."
SUSPICIOUS = 1e-3
"Refined and float32 distance differ by more than this times (1 + distance): the plane is not to be trusted."
LEAK_TURN_RAD = 1e-6
"How far a ray that slipped between two triangles is turned for its second cast."
SPHERE_MARGIN = 1e-4
"Share and metres by which bounding spheres are enlarged against rounding."
LONGEST = 1e30
"Stands for an unlimited ray in float32."
CHUNK = 8
"Least number of neighbouring rays that are tested as one cone."
MOST_CHUNKS = 128
SUBSETS_KEPT = 16
MISS = np.int32(-1)


@dataclass(frozen=True, eq=False)
class Hits:
    """What m rays met first."""

    range_m: Floats
    "(m,) along the ray from its origin; NaN for a miss."
    body: Ints
    "(m,) index into `Scene.bodies`, -1 for a miss."
    actor: Ints
    "(m,) index into `Scene.actors`, -1 for a miss."
    face: Longs
    "(m,) index into the body's faces, -1 for a miss."
    material: Ints
    "(m,) index into `Scene.materials`, -1 for a miss."
    normal: Floats
    "(m, 3) unit, in the world, on the side the ray came from; zeros for a miss."
    inner: Flags
    "(m,) met from inside of a closed shell."

    def __len__(self) -> int:
        return len(self.range_m)


@dataclass
class Counters:
    """What happened in all casts so far."""

    rays: int = 0
    suspicious: int = 0
    "Hits whose float32 distance was kept because the refined one did not agree."
    leaks: int = 0
    "Rays that had slipped between triangles into a closed shell and were cast again."


@dataclass(frozen=True, eq=False)
class _Table:
    """Facts of triangles by their global number."""

    plane: Floats
    "(F, 4) unit normal n and n . v of the triangle's plane."
    body: Ints
    "(F,) -1 where a slot's shape belongs to several bodies."
    face: Longs
    part: Ints
    closed: Flags


@dataclass(frozen=True, eq=False)
class _Group:
    """Merged resting bodies; axes as the world's."""

    centre: Floats
    radius: float
    offset: int
    "Global number of its first triangle."
    structure: EmbreeScene


@dataclass(frozen=True, eq=False)
class _Movers:
    """Bodies that are not merged: one row each."""

    body: Longs
    "(b,)"
    slots: Longs
    "(b,) number of the structure."
    cell: Floats
    "(b, 3) origin of the slot in its structure."
    first: Longs
    "(b,) global number of the shape's first triangle."
    start: Longs
    "(b,) number of that triangle within the structure."
    centre: Floats
    "(b, 3) of the bounding sphere about the body's origin."
    radius: Floats
    simple: Flags
    "(b,) constant velocity and orientation: `at`, `velocity` and `turned` tell all."
    at: Floats
    velocity: Floats
    turned: Floats
    "(b, 3, 3) orientation of a body that does not turn."
    turns: Flags
    speed: Floats
    motions: tuple[Motion, ...]


@dataclass(eq=False)
class _Nearest:
    """The nearest hits so far."""

    range_m: Floats
    triangle: Longs
    body: Ints
    normal: Floats
    "By the winding, not yet turned to the ray's side."
    facing: Floats
    "normal . direction"

    @classmethod
    def nothing(cls, count: int) -> _Nearest:
        return cls(
            np.full(count, np.inf),
            np.full(count, -1, np.int64),
            np.full(count, MISS),
            np.zeros((count, 3)),
            np.zeros(count),
        )


class Caster:
    """Casts rays on a scene. Builds everything once; afterwards several threads may cast at the same time."""

    def __init__(self, scene: Scene, bodies: Iterable[int] | None = None) -> None:
        self._scene = scene
        self.counters = Counters()
        self._tables: list[_Table] = []
        self._offset = 0
        chosen = sorted(set(range(len(scene.bodies)) if bodies is None else bodies))
        merged, single = _divide(scene.bodies, chosen)
        self._groups = [self._merge(members) for members in _cells(scene.bodies, merged)]
        self._slots: list[EmbreeScene] = []
        self._movers = self._place(single)
        self._table = _joined(self._tables)
        self._tables = []
        counts = [len(body.part_material) for body in scene.bodies]
        self._actor_of = np.array([body.actor for body in scene.bodies], np.int32)
        self._parts_of = np.cumsum([0, *counts])[: len(counts)].astype(np.int64)
        self._part_material = np.concatenate([np.zeros(0, np.int32), *(body.part_material for body in scene.bodies)])
        self._subsets: dict[frozenset[int], Caster] = {}

    # ------------------------------------------------------------ building

    def _add_table(self, table: _Table) -> int:
        self._tables.append(table)
        first = self._offset
        self._offset += len(table.plane)
        return first

    def _merge(self, members: Sequence[int]) -> _Group:
        bodies = [self._scene.bodies[index] for index in members]
        zero = np.zeros(1)
        poses = [body.motion.pose(zero) for body in bodies]
        places = [pose.to_world(body.geometry.centre)[0] for pose, body in zip(poses, bodies, strict=True)]
        reach = np.array([[body.radius_m] for body in bodies])
        low, high = (np.array(places) - reach).min(axis=0), (np.array(places) + reach).max(axis=0)
        centre = np.round(low + (high - low) / 2.0)
        vertices, faces, planes, part, closed = [], [], [], [], []
        count = 0
        for body, pose in zip(bodies, poses, strict=True):
            shape, rotation = body.geometry, pose.rotation[0]
            # about the sphere's centre first: a mesh with UTM coordinates keeps its digits
            place = (pose.position_m[0] - centre) + rotation @ shape.centre
            local = (shape.vertices - shape.centre) @ rotation.T + place
            normals = shape.normals @ rotation.T
            vertices.append(local)
            faces.append(shape.faces + count)
            planes.append(_planes(normals, local[shape.faces[:, 0]]))
            part.append(shape.face_part)
            closed.append(shape.closed)
            count += len(local)
        sizes = [len(body.faces) for body in bodies]
        offset = self._add_table(
            _Table(
                np.concatenate(planes),
                np.repeat(np.array(members, np.int32), sizes),
                np.concatenate([np.arange(size, dtype=np.int64) for size in sizes]),
                np.concatenate(part),
                np.concatenate(closed),
            )
        )
        points = np.concatenate(vertices)
        radius = max(
            float(np.linalg.norm(place - centre)) + body.radius_m for place, body in zip(places, bodies, strict=True)
        )
        return _Group(centre, radius, offset, _structure(points, np.concatenate(faces)))

    def _place(self, single: Sequence[int]) -> _Movers:
        bodies = [self._scene.bodies[index] for index in single]
        shapes = sorted({id(body.geometry): body.geometry for body in bodies}.values(), key=lambda one: one.radius)
        home: dict[int, tuple[int, Floats, int, int]] = {}
        for begin in range(0, len(shapes), SLOTS):
            batch = shapes[begin : begin + SLOTS]
            side = int(np.ceil(len(batch) ** (1 / 3) - 1e-9))
            pitch = SLOT_PITCH * max(shape.radius for shape in batch)
            vertices, faces = [], []
            points = triangles = 0
            for number, shape in enumerate(batch):
                cell = (np.array([number % side, number // side % side, number // side**2]) - (side - 1) / 2) * pitch
                first = self._add_table(_table_of(shape))
                home[id(shape)] = (len(self._slots), cell, first, triangles)
                vertices.append(shape.vertices - shape.centre + cell)
                faces.append(shape.faces + points)
                points += len(shape.vertices)
                triangles += len(shape.faces)
            self._slots.append(_structure(np.concatenate(vertices), np.concatenate(faces)))
        homes = [home[id(body.geometry)] for body in bodies]
        simple = [isinstance(body.motion, Steady) and not body.motion.turns for body in bodies]
        zero = np.zeros(1)
        return _Movers(
            np.array(single, np.int64),
            np.array([one[0] for one in homes], np.int64),
            np.array([one[1] for one in homes], np.float64).reshape(-1, 3),
            np.array([one[2] for one in homes], np.int64),
            np.array([one[3] for one in homes], np.int64),
            np.array([body.geometry.centre for body in bodies], np.float64).reshape(-1, 3),
            np.array([body.geometry.radius for body in bodies], np.float64),
            np.array(simple, bool),
            np.array([body.motion.position(zero)[0] for body in bodies], np.float64).reshape(-1, 3),
            np.array([body.motion.velocity(zero)[0] for body in bodies], np.float64).reshape(-1, 3),
            np.array([body.motion.rotation(zero)[0] for body in bodies], np.float64).reshape(-1, 3, 3),
            np.array([body.motion.turns for body in bodies], bool),
            np.array([body.motion.speed_bound_m_s for body in bodies], np.float64),
            tuple(body.motion for body in bodies),
        )

    # ------------------------------------------------------------ casting

    def first_hits(
        self,
        origin_m: Floats,
        direction: Floats,
        t_s: Floats,
        *,
        bodies: Iterable[int] | None = None,
        tnear_m: Floats | float = 0.0,
        max_range_m: float = np.inf,
    ) -> Hits:
        """What each ray meets first.

        Parameters
        ----------
        origin_m : (m, 3) in the world. [m]
        direction : (m, 3) unit.
        t_s : (m,) when each ray is cast; moving bodies are where they are at that time. [s]
        bodies : only these indexes of `Scene.bodies`; None: all.
        tnear_m : (m,) or one number; nearer hits are passed by. [m]
        max_range_m : hits farther from the origin are misses. [m]

        Returns
        -------
        hits : `Hits` of m rays, ranges from `origin_m` also where `tnear_m` is given.
        """
        if bodies is not None:
            return self._subset(frozenset(bodies)).first_hits(
                origin_m, direction, t_s, tnear_m=tnear_m, max_range_m=max_range_m
            )
        ray = np.asarray(direction, dtype=np.float64).reshape(-1, 3)
        origin = np.broadcast_to(np.asarray(origin_m, dtype=np.float64), ray.shape)
        times = np.broadcast_to(np.asarray(t_s, dtype=np.float64), len(ray))
        self.counters.rays += len(ray)
        if np.isscalar(tnear_m) and tnear_m == 0.0:
            found, inner = self._found(origin, ray, times, max_range_m)
            return self._hits(found, inner)
        near = np.broadcast_to(np.asarray(tnear_m, dtype=np.float64), len(ray))
        found, inner = self._found(origin + near[:, None] * ray, ray, times, max_range_m)
        found.range_m += near
        found.triangle[found.range_m > max_range_m] = -1
        return self._hits(found, inner)

    def _subset(self, bodies: frozenset[int]) -> Caster:
        if bodies not in self._subsets:
            while len(self._subsets) >= SUBSETS_KEPT:
                self._subsets.pop(next(iter(self._subsets)))
            self._subsets[bodies] = Caster(self._scene, bodies)
        return self._subsets[bodies]

    def _found(self, origin: Floats, ray: Floats, times: Floats, far: float) -> tuple[_Nearest, Flags]:
        found = self._nearest(origin, ray, times, far)
        inner = self._is_inner(found)
        if inner.any():
            self._recast_leaks(found, inner, origin, ray, times, far)
        return found, inner

    def _is_inner(self, found: _Nearest) -> Flags:
        inner = found.facing > 0.0
        if inner.any():
            inner &= self._table.closed[found.triangle]
        return inner

    def _hits(self, found: _Nearest, inner: Flags) -> Hits:
        hit = found.triangle >= 0
        if hit.all():
            triangle, body = found.triangle, found.body
            normal = found.normal * np.where(found.facing > 0.0, -1.0, 1.0)[:, None]
            material = self._part_material[self._parts_of[body] + self._table.part[triangle]]
            face = self._table.face[triangle]
            return Hits(found.range_m, body, self._actor_of[body], face, material, normal, inner)
        count = len(hit)
        hits = Hits(
            np.full(count, np.nan),
            np.full(count, MISS),
            np.full(count, MISS),
            np.full(count, -1, np.int64),
            np.full(count, MISS),
            np.zeros((count, 3)),
            inner & hit,
        )
        index = np.flatnonzero(hit)
        if len(index):
            triangle, body = found.triangle[index], found.body[index]
            hits.range_m[index] = found.range_m[index]
            hits.body[index] = body
            hits.actor[index] = self._actor_of[body]
            hits.face[index] = self._table.face[triangle]
            hits.material[index] = self._part_material[self._parts_of[body] + self._table.part[triangle]]
            hits.normal[index] = found.normal[index] * np.where(found.facing[index] > 0.0, -1.0, 1.0)[:, None]
        return hits

    def _recast_leaks(
        self, found: _Nearest, inner: Flags, origin: Floats, ray: Floats, times: Floats, far: float
    ) -> None:
        """Cast rays that met the inside of a closed shell once more, turned a little.

        Those that meet an inside again are inside; the others had slipped between two triangles and get what the turned
        ray met, with the distance of the original ray to that plane.
        """
        index = np.flatnonzero(inner)
        again = self._nearest(origin[index], _turned(ray[index]), times[index], far)
        leaked = np.flatnonzero(~self._is_inner(again))
        if not len(leaked):
            return
        self.counters.leaks += len(leaked)
        target = index[leaked]
        range_m, turned_facing = again.range_m[leaked], again.facing[leaked]
        facing = np.einsum("ij,ij->i", again.normal[leaked], ray[target])
        with np.errstate(divide="ignore", invalid="ignore"):
            refined = range_m * turned_facing / facing
            good = np.abs(refined - range_m) <= SUSPICIOUS * (1.0 + range_m)
        found.range_m[target] = np.where(good, refined, range_m)
        found.triangle[target] = again.triangle[leaked]
        found.body[target] = again.body[leaked]
        found.normal[target] = again.normal[leaked]
        found.facing[target] = np.where(good, facing, turned_facing)
        inner[target] = False

    def _nearest(self, origin: Floats, ray: Floats, times: Floats, far: float) -> _Nearest:
        found = None
        if len(ray):
            ray32 = ray.astype(np.float32)
            for group in self._groups:
                found = self._cast_group(group, origin, ray, ray32, far, found)
        if found is None:
            found = _Nearest.nothing(len(ray))
        if len(ray) and len(self._movers.body):
            self._cast_movers(origin, ray, times, far, found)
        return found

    def _cast_group(
        self,
        group: _Group,
        origin: Floats,
        ray: Floats,
        ray32: NDArray[np.float32],
        far: float,
        found: _Nearest | None,
    ) -> _Nearest:
        local = origin - group.centre
        rays: Longs | None = None
        begin: Floats | None = None
        if len(self._groups) > 1 or float(local[0] @ local[0]) > group.radius**2:
            enter, _, touch = _through_sphere(local, ray, group.radius)
            rays = np.flatnonzero(touch & (enter <= far))
            if len(rays) == 0:
                return found or _Nearest.nothing(len(ray))
            local, ray, ray32, begin = local[rays], ray[rays], ray32[rays], enter[rays]
            local32 = (local + begin[:, None] * ray).astype(np.float32)
        else:
            local32 = local.astype(np.float32)
        tfar = np.full(len(ray), min(far, LONGEST) if begin is None else LONGEST, np.float32)
        number, span = _run(group.structure, local32, ray32, tfar)
        distance = np.add(span, 0.0 if begin is None else begin, dtype=np.float64)
        hit = number >= 0
        if rays is None and found is None and hit.all():
            triangle = np.add(number, group.offset, dtype=np.int64)
            range_m, normal, facing = self._refined(triangle, local, ray, distance)
            return _Nearest(range_m, triangle, self._table.body[triangle], normal, facing)
        found = found or _Nearest.nothing(len(origin))
        index = np.flatnonzero(hit)
        if len(index):
            triangle = np.add(number[index], group.offset, dtype=np.int64)
            range_m, normal, facing = self._refined(triangle, local[index], ray[index], distance[index])
            target = index if rays is None else rays[index]
            _keep_nearer(found, target, range_m, triangle, self._table.body[triangle], normal, facing)
        return found

    def _refined(
        self, triangle: Longs, origin: Floats, ray: Floats, distance: NDArray[np.floating]
    ) -> tuple[Floats, Floats, Floats]:
        """Distance to the plane of each triangle, its normal and normal . ray, all in float64."""
        plane = self._table.plane[triangle]
        normal = plane[:, :3]
        facing = np.einsum("ij,ij->i", normal, ray)
        with np.errstate(divide="ignore", invalid="ignore"):
            range_m = (plane[:, 3] - np.einsum("ij,ij->i", normal, origin)) / facing
            good = np.abs(range_m - distance) <= SUSPICIOUS * (1.0 + distance)
        if not good.all():
            self.counters.suspicious += int(len(good) - np.count_nonzero(good))
            range_m = np.where(good, range_m, distance)
        return range_m, normal, facing

    def _cast_movers(self, origin: Floats, ray: Floats, times: Floats, far: float, found: _Nearest) -> None:
        which, rays = self._candidates(origin, ray, times, far)
        if not len(which):
            return
        movers = self._movers
        # body's origin, then the sphere's centre, seen from the ray's origin: large coordinates cancel first
        offset, turned = self._places(which, rays, origin, times)
        centre = movers.centre[which]
        towards = np.einsum("kij,kj->ki", turned, centre)
        enter, leave, touch = _through_sphere(offset - towards, ray[rays], movers.radius[which])
        kept = np.flatnonzero(touch & (enter <= far) & (enter < found.range_m[rays]))
        if not len(kept):
            return
        which, rays, enter, leave, turned = which[kept], rays[kept], enter[kept], leave[kept], turned[kept]
        local = np.einsum("kji,kj->ki", turned, offset[kept]) - centre[kept]
        along = np.einsum("kji,kj->ki", turned, ray[rays])
        start32 = (local + enter[:, None] * along + movers.cell[which]).astype(np.float32)
        along32 = along.astype(np.float32)
        until = (leave - enter).astype(np.float32)
        home = movers.slots[which]
        prim = np.full(len(which), -1, np.int32)
        distance = np.zeros(len(which))
        for number in np.unique(home) if len(self._slots) > 1 else (0,):
            here = np.flatnonzero(home == number) if len(self._slots) > 1 else np.arange(len(home))
            prim[here], distance[here] = _run(self._slots[number], start32[here], along32[here], until[here])
        hit = np.flatnonzero(prim >= 0)
        if not len(hit):
            return
        which, rays, turned = which[hit], rays[hit], turned[hit]
        triangle = prim[hit] - movers.start[which] + movers.first[which]
        range_m, normal, facing = self._refined(triangle, local[hit], along[hit], distance[hit] + enter[hit])
        normal = np.einsum("kij,kj->ki", turned, normal)
        _keep_nearer(found, rays, range_m, triangle, movers.body[which].astype(np.int32), normal, facing)

    def _places(self, which: Longs, rays: Longs, origin: Floats, times: Floats) -> tuple[Floats, Floats]:
        """For each pair of a mover and a ray: the ray's origin from the body's, and how the body is turned then."""
        movers = self._movers
        when = times[rays]
        offset = (origin[rays] - movers.at[which]) - when[:, None] * movers.velocity[which]
        turned = movers.turned[which]
        special = np.flatnonzero(~movers.simple[which])
        if len(special):
            order = special[np.argsort(which[special], kind="stable")]
            ends = np.flatnonzero(np.diff(which[order])) + 1
            for pairs in np.split(order, ends):
                motion = movers.motions[which[pairs[0]]]
                offset[pairs] = origin[rays[pairs]] - motion.position(when[pairs])
                if motion.turns:
                    turned[pairs] = motion.rotation(when[pairs])
        return offset, turned

    def _candidates(self, origin: Floats, ray: Floats, times: Floats, far: float) -> tuple[Longs, Longs]:
        """Pairs of a mover and a ray that may meet: first by chunks of neighbouring rays, which are narrow cones."""
        movers = self._movers
        low, high = origin.min(axis=0), origin.max(axis=0)
        eye = low + (high - low) / 2.0
        spread = float(np.linalg.norm(high - eye))
        first, last = float(times.min()), float(times.max())
        middle = first + (last - first) / 2.0
        at = movers.at + middle * movers.velocity
        towards = np.einsum("kij,kj->ki", movers.turned, movers.centre)
        arm = np.where(movers.turns, np.linalg.norm(movers.centre, axis=1), 0.0)
        for number in np.flatnonzero(~movers.simple):
            at[number] = movers.motions[number].position(np.array([middle]))[0]
        towards[movers.turns] = 0.0  # anywhere around the body's origin
        with np.errstate(invalid="ignore"):
            slack = np.nan_to_num(movers.speed * (last - first) / 2.0, nan=0.0, posinf=np.inf)
        reach = movers.radius + arm + slack + spread
        view = at + towards - eye
        away = np.linalg.norm(view, axis=1)
        bodies = np.flatnonzero(away - reach <= far)
        if not len(bodies):
            return np.zeros(0, np.int64), np.zeros(0, np.int64)
        view, away, reach = view[bodies], away[bodies], reach[bodies]

        size = max(CHUNK, -(-len(ray) // MOST_CHUNKS))
        chunks = -(-len(ray) // size)
        padded = np.concatenate([ray, np.broadcast_to(ray[-1], (chunks * size - len(ray), 3))]).reshape(chunks, size, 3)
        axis = padded.sum(axis=1)
        norm = np.linalg.norm(axis, axis=1)
        axis = np.where(norm[:, None] > 0.0, axis / np.where(norm > 0.0, norm, 1.0)[:, None], ray[::size])
        half = np.arccos(np.clip(np.einsum("csj,cj->cs", padded, axis).min(axis=1), -1.0, 1.0))
        inside = away <= reach
        safe = np.where(inside, 1.0, away)
        width = np.where(inside, np.pi, np.arcsin(np.clip(reach / safe, 0.0, 1.0)))
        angle = np.arccos(np.clip(view @ axis.T / safe[:, None], -1.0, 1.0))
        body, chunk = np.nonzero(angle <= width[:, None] + half + 1e-6)
        rays = (chunk[:, None] * size + np.arange(size)).ravel()
        which = np.repeat(bodies[body], size)
        real = rays < len(ray)
        return which[real], rays[real]


# ---------------------------------------------------------------- helpers


def _divide(bodies: Sequence[Body], chosen: Sequence[int]) -> tuple[list[int], list[int]]:
    """Indexes of the bodies to merge, and of those that get a slot for their shape."""
    still = [index for index in chosen if bodies[index].motion.still]
    moving = [index for index in chosen if not bodies[index].motion.still]
    if sum(len(bodies[index].faces) for index in still) > MOST_MERGED:
        uses = Counter(id(bodies[index].geometry) for index in chosen)
        repeated = [index for index in still if uses[id(bodies[index].geometry)] > 1]
        once = [index for index in still if uses[id(bodies[index].geometry)] == 1]
        return once, sorted(moving + repeated)
    return still, moving


def _cells(bodies: Sequence[Body], members: Sequence[int]) -> list[list[int]]:
    """Groups of resting bodies that lie near each other."""
    zero = np.zeros(1)
    cells: dict[tuple[int, ...], list[int]] = {}
    for index in members:
        place = bodies[index].motion.pose(zero).to_world(bodies[index].geometry.centre)[0]
        cells.setdefault(tuple(np.floor(place / CELL_M + 0.5).astype(int).tolist()), []).append(index)
    return list(cells.values())


def _structure(vertices: Floats, faces: NDArray[np.integer]) -> EmbreeScene:
    structure = EmbreeScene(robust=True)
    TriangleMesh(structure, vertices.astype(np.float32), np.ascontiguousarray(faces, dtype=np.int32))
    _run(structure, np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32), np.ones(1, np.float32))  # builds it
    return structure


def _run(
    structure: EmbreeScene, origin: NDArray[np.float32], ray: NDArray[np.float32], until: NDArray[np.float32]
) -> tuple[Ints, NDArray[np.float32]]:
    """Triangle (-1: none) and distance of each ray's first hit; `until` is overwritten."""
    answer = structure.run(origin, ray, dists=until, output=1)
    return answer["primID"], answer["tfar"]


def _planes(normals: Floats, points: Floats) -> Floats:
    return np.column_stack([normals, np.einsum("ij,ij->i", normals, points)])


def _table_of(shape: Geometry) -> _Table:
    local = shape.vertices[shape.faces[:, 0]] - shape.centre
    count = len(shape.faces)
    return _Table(
        _planes(shape.normals, local),
        np.full(count, MISS),
        np.arange(count, dtype=np.int64),
        shape.face_part,
        shape.closed,
    )


def _joined(tables: Sequence[_Table]) -> _Table:
    return _Table(
        np.concatenate([np.zeros((0, 4)), *(table.plane for table in tables)]),
        np.concatenate([np.zeros(0, np.int32), *(table.body for table in tables)]),
        np.concatenate([np.zeros(0, np.int64), *(table.face for table in tables)]),
        np.concatenate([np.zeros(0, np.int32), *(table.part for table in tables)]),
        np.concatenate([np.zeros(0, bool), *(table.closed for table in tables)]),
    )


def _through_sphere(origin: Floats, ray: Floats, radius: Floats | float) -> tuple[Floats, Floats, Flags]:
    """Where rays enter (>= 0) and leave a sphere about (0, 0, 0), a little enlarged, and whether they meet it."""
    reach = np.asarray(radius) * (1.0 + SPHERE_MARGIN) + SPHERE_MARGIN
    middle = -np.einsum("ij,ij->i", origin, ray)
    # distance of the line by its perpendicular: the usual discriminant loses digits far away
    across = origin + middle[:, None] * ray
    half = np.sqrt(np.maximum(reach * reach - np.einsum("ij,ij->i", across, across), 0.0))
    leave = middle + half
    return np.maximum(middle - half, 0.0), leave, (half > 0.0) & (leave > 0.0)


def _turned(ray: Floats) -> Floats:
    """Each ray turned by `LEAK_TURN_RAD` about an axis across it."""
    helper = np.zeros_like(ray)
    helper[np.arange(len(ray)), np.argmin(np.abs(ray), axis=1)] = 1.0
    across = np.cross(ray, helper)
    across /= np.linalg.norm(across, axis=1)[:, None]
    turned = ray + LEAK_TURN_RAD * across
    return np.asarray(turned / np.linalg.norm(turned, axis=1)[:, None])


def _keep_nearer(
    found: _Nearest, rays: Longs, range_m: Floats, triangle: Longs, body: Ints, normal: Floats, facing: Floats
) -> None:
    """Put hits of `rays` (which may repeat) where they are nearer than what is there; the first of equals stays."""
    order = np.lexsort((np.arange(len(rays)), range_m, rays))
    first = np.ones(len(rays), bool)
    first[1:] = rays[order][1:] != rays[order][:-1]
    chosen = order[first]
    chosen = chosen[range_m[chosen] < found.range_m[rays[chosen]]]
    target = rays[chosen]
    found.range_m[target] = range_m[chosen]
    found.triangle[target] = triangle[chosen]
    found.body[target] = body[chosen]
    found.normal[target] = normal[chosen]
    found.facing[target] = facing[chosen]
