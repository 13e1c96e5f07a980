"""First hits of rays on the bodies of a scene; the only user of embreex.

Belongs here: casting, moving rays into the frames of moving bodies, refining what comes back in float64. Not: where
rays come from (beams), what a hit means (physics), what lies in the structures (structures).

The caster works in float32 and only decides *which* triangle is met; the distance is then recomputed in float64 from
the float64 plane of that triangle. To keep the decision good, every structure lies about its own float64 origin, and
rays begin where they enter a bounding sphere.

A moving body is not moved: its rays are, by its pose at each ray's own time, into the slot of its shape. So nothing is
ever rebuilt, a call costs the same few casts however many bodies move, and a thousand equal cars are stored once.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from emulator.fleet import Flags, Longs, may_meet, through_sphere
from emulator.scene import Scene
from emulator.structures import Content, Group, lay_out
from emulator.triangles import Floats, Ints

Singles = NDArray[np.float32]

SUSPICIOUS = 1e-3
"Refined and float32 distance differ by more than this times (1 + distance): the plane is not to be trusted."
LEAK_TURN_RAD = 1e-6
"How far a ray that slipped between two triangles is turned for its second cast."
LONGEST = 1e30
"Stands for an unlimited ray in float32."
BLOCK = 8192
"Rays cast together, so that their arrays stay in the processor's cache."
KEEP_NUMBERS = 3_900_000
"An array of so many (31 MB) is made and freed once: glibc then keeps freed memory instead of mapping it anew."
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

    @classmethod
    def misses(cls, count: int) -> Hits:
        """Hits of rays that met nothing."""
        body, actor, material = (np.full(count, MISS) for _ in range(3))
        return cls(
            np.full(count, np.nan),
            body,
            actor,
            np.full(count, -1, np.int64),
            material,
            np.zeros((count, 3)),
            np.zeros(count, bool),
        )


@dataclass
class Counters:
    """What happened in all casts so far; approximate when several threads cast."""

    rays: int = 0
    suspicious: int = 0
    "Hits whose float32 distance was kept because the refined one did not agree."
    leaks: int = 0
    "Rays that had slipped between triangles into a closed shell and were cast again."


@dataclass(eq=False)
class _Nearest:
    """The nearest hits so far."""

    range_m: Floats
    triangle: Longs
    body: Longs
    normal: Floats
    "(3, m) by the winding, not yet turned to the ray's side."
    facing: Floats
    "normal . direction; 0 for a miss."

    @classmethod
    def nothing(cls, count: int) -> _Nearest:
        no = np.full(count, -1, np.int64)
        return cls(np.full(count, np.inf), no, no.copy(), np.zeros((3, count)), np.zeros(count))


class Caster:
    """Casts rays on a scene. Builds everything once; afterwards several threads may cast at the same time."""

    def __init__(self, scene: Scene, bodies: Iterable[int] | None = None) -> None:
        self._scene = scene
        self.counters = Counters()
        chosen = sorted(set(range(len(scene.bodies)) if bodies is None else bodies))
        layout = lay_out(scene.bodies, chosen)
        self._groups = layout.groups
        self._built = [_structure(group.content) for group in layout.groups]
        self._slots = [_structure(content) for content in layout.slots]
        self._movers = layout.movers
        self._table = layout.table
        counts = [len(body.part_material) for body in scene.bodies]
        self._actor_of = np.array([body.actor for body in scene.bodies], np.int32)
        self._parts_of = np.cumsum([0, *counts])[: len(counts)].astype(np.int64)
        self._part_material = np.concatenate([np.zeros(0, np.int32), *(body.part_material for body in scene.bodies)])
        self._subsets: dict[frozenset[int], Caster] = {}
        np.zeros(KEEP_NUMBERS)  # page faults were half the time of a large cast

    def first_hits(
        self,
        origin_m: Floats,
        direction: Floats,
        t_s: Floats | float,
        *,
        bodies: Iterable[int] | None = None,
        tnear_m: Floats | float = 0.0,
        max_range_m: float = np.inf,
    ) -> Hits:
        """What each ray meets first.

        Parameters
        ----------
        origin_m : (m, 3), or (3,) for all, in the world. [m]
        direction : (m, 3) unit.
        t_s : (m,), or one number, when each ray is cast; moving bodies are where they are at that time. [s]
        bodies : only these indexes of `Scene.bodies`; None: all. Structures of the latest subsets are kept.
        tnear_m : (m,) or one number; nearer hits are passed by. [m]
        max_range_m : hits farther from the origin are misses; bodies beyond cost nothing. [m]

        Returns
        -------
        hits : `Hits` of m rays, ranges from `origin_m` also where `tnear_m` is given.
        """
        if bodies is not None:
            chosen = self._subset(frozenset(bodies))
            return chosen.first_hits(origin_m, direction, t_s, tnear_m=tnear_m, max_range_m=max_range_m)
        ray = np.asarray(direction, dtype=np.float64)
        count = len(ray)
        origin = np.broadcast_to(np.asarray(origin_m, dtype=np.float64), (count, 3))
        times = np.broadcast_to(np.asarray(t_s, dtype=np.float64), (count,))
        near = np.asarray(tnear_m, dtype=np.float64)
        skip = np.broadcast_to(near, (count,)) if near.any() else None
        hits = Hits.misses(count)
        self.counters.rays += count
        if not len(self._table):
            return hits
        with np.errstate(under="ignore"):  # components below 1e-38 are nothing in float32
            for begin in range(0, count, BLOCK):
                here = slice(begin, begin + BLOCK)
                self._cast(
                    np.ascontiguousarray(origin[here].T),
                    np.ascontiguousarray(ray[here].T),
                    times[here],
                    None if skip is None else skip[here],
                    max_range_m,
                    hits,
                    here,
                )
        return hits

    def _subset(self, bodies: frozenset[int]) -> Caster:
        if bodies not in self._subsets:
            while len(self._subsets) >= SUBSETS_KEPT:
                self._subsets.pop(next(iter(self._subsets)))
            self._subsets[bodies] = Caster(self._scene, bodies)
        return self._subsets[bodies]

    def _cast(
        self, origin: Floats, ray: Floats, times: Floats, skip: Floats | None, far: float, hits: Hits, here: slice
    ) -> None:
        if skip is not None:
            origin = origin + skip * ray
        found = self._nearest(origin, ray, times, far)
        inner = self._is_inner(found)
        if inner.any():
            self._recast_leaks(found, inner, origin, ray, times, far)
        if skip is not None:
            found.range_m = found.range_m + skip
        table, body, triangle = self._table, found.body, found.triangle
        hit = triangle >= 0
        if far < np.inf:
            hit &= found.range_m <= far
        side = np.where(found.facing > 0.0, -1.0, 1.0)  # not the sign: a grazing normal must not vanish
        if hit.all():
            where: slice | Longs = here
            range_m, normal = found.range_m, found.normal
        else:
            index = np.flatnonzero(hit)
            where = index + here.start
            body, triangle = body[index], triangle[index]
            range_m, normal, side, inner = found.range_m[index], found.normal[:, index], side[index], inner[index]
        hits.range_m[where] = range_m
        hits.body[where] = body
        hits.actor[where] = self._actor_of.take(body)
        hits.face[where] = table.face.take(triangle)
        hits.material[where] = self._part_material.take(self._parts_of.take(body) + table.part.take(triangle))
        hits.normal[where] = (normal * side).T
        hits.inner[where] = inner

    def _is_inner(self, found: _Nearest) -> Flags:
        inner = found.facing > 0.0
        if inner.any():
            inner &= self._table.closed.take(found.triangle)
        return inner

    def _recast_leaks(
        self, found: _Nearest, inner: Flags, origin: Floats, ray: Floats, times: Floats, far: float
    ) -> None:
        """Cast rays that met the inside of a closed shell once more, turned a little.

        Those that meet an inside again are inside; the others had slipped between two triangles and get what the turned
        ray met, with the distance of the original ray to that plane.
        """
        index = np.flatnonzero(inner)
        again = self._nearest(origin[:, index], _turned(ray[:, index]), times[index], far)
        leaked = np.flatnonzero(~self._is_inner(again))
        if not len(leaked):
            return
        self.counters.leaks += len(leaked)
        target = index[leaked]
        range_m, turned_facing = again.range_m[leaked], again.facing[leaked]
        facing = np.einsum("ik,ik->k", again.normal[:, leaked], ray[:, target])
        with np.errstate(divide="ignore", invalid="ignore"):
            refined = range_m * turned_facing / facing
            good = np.abs(refined - range_m) <= SUSPICIOUS * (1.0 + range_m)
        found.range_m[target] = np.where(good, refined, range_m)
        found.triangle[target] = again.triangle[leaked]
        found.body[target] = again.body[leaked]
        found.normal[:, target] = again.normal[:, leaked]
        found.facing[target] = np.where(good, facing, turned_facing)
        inner[target] = False

    def _nearest(self, origin: Floats, ray: Floats, times: Floats, far: float) -> _Nearest:
        count = ray.shape[1]
        found = None
        if len(self._groups) == 1 and _norm(origin[:, :1] - self._groups[0].centre) < self._groups[0].radius:
            found = self._cast_around(origin, ray, far)
        else:
            found = _Nearest.nothing(count)
            for group, structure in zip(self._groups, self._built, strict=True):
                self._cast_afar(group, structure, origin, ray, far, found)
        if len(self._movers.body):
            self._cast_movers(origin, ray, times, far, found)
        return found

    def _cast_around(self, origin: Floats, ray: Floats, far: float) -> _Nearest:
        """All rays on the only group of resting bodies, among which they begin."""
        group = self._groups[0]
        local = origin - group.centre
        until = np.full(ray.shape[1], min(far, LONGEST), np.float32)
        number, span = _run(self._built[0], _rows(local), _rows(ray), until)
        triangle = np.add(number, group.offset, dtype=np.int64)
        hit = number >= 0
        range_m, normal, facing = self._refined(triangle, local, ray, span, hit)
        body = self._table.body.take(triangle, mode="wrap")
        if not hit.all():
            miss = ~hit
            triangle[miss] = body[miss] = -1
            range_m[miss] = np.inf
            facing[miss] = 0.0
        return _Nearest(range_m, triangle, body, normal, facing)

    def _cast_afar(
        self, group: Group, structure: EmbreeScene, origin: Floats, ray: Floats, far: float, found: _Nearest
    ) -> None:
        """Rays on one of several groups: those that meet its sphere, from where they enter it."""
        local = origin - group.centre
        enter, _, touch = through_sphere(local, ray, group.radius)
        rays = np.flatnonzero(touch & (enter <= far) & (enter < found.range_m))
        if not len(rays):
            return
        local, along, enter = local[:, rays], ray[:, rays], enter[rays]
        until = np.full(len(rays), LONGEST, np.float32)
        number, span = _run(structure, _rows(local + enter * along), _rows(along), until)
        hit = np.flatnonzero(number >= 0)
        triangle = np.add(number[hit], group.offset, dtype=np.int64)
        range_m, normal, facing = self._refined(triangle, local[:, hit], along[:, hit], span[hit] + enter[hit])
        _keep_nearer(found, rays[hit], triangle, self._table.body.take(triangle), range_m, normal, facing)

    def _refined(
        self,
        triangle: Longs,
        origin: Floats,
        ray: Floats,
        distance: NDArray[np.floating],
        hit: Flags | None = None,
    ) -> tuple[Floats, Floats, Floats]:
        """Distance to the plane of each triangle, its normal and normal . ray, all in float64; misses as they come."""
        plane = self._table.plane.take(triangle, axis=1, mode="wrap")
        normal = plane[:3]
        facing = np.einsum("ik,ik->k", normal, ray)
        with np.errstate(divide="ignore", invalid="ignore"):
            range_m = (plane[3] - np.einsum("ik,ik->k", normal, origin)) / facing
            good = np.abs(range_m - distance) <= SUSPICIOUS * (1.0 + distance)
        if hit is not None:
            good |= ~hit
        if not good.all():
            self.counters.suspicious += int(len(good) - np.count_nonzero(good))
            range_m = np.where(good, range_m, distance)
        return np.maximum(range_m, 0.0), normal, facing  # a surface that the ray begins on may lie a hair behind

    def _cast_movers(self, origin: Floats, ray: Floats, times: Floats, far: float, found: _Nearest) -> None:
        """Each ray on the moving bodies whose spheres it meets, in their own frames."""
        movers = self._movers
        begin, end = float(times.min()), float(times.max())
        now = movers.fleet.during(begin, end)
        middle = begin + (end - begin) / 2.0
        place = now.at + (middle - now.since) * now.velocity + np.einsum("ijb,jb->ib", now.turned, movers.centre)
        swept = np.sqrt(np.einsum("ib,ib->b", now.velocity, now.velocity)) * ((end - begin) / 2.0)
        curved = np.flatnonzero(~now.straight)
        if len(curved):  # anywhere around where the body's origin is, as far as it can have come
            for mover in curved:
                place[:, mover] = movers.fleet.motions[mover].position(np.array([middle]))[0]
            swept[curved] = movers.arm[curved] + (movers.speed[curved] * ((end - begin) / 2.0) if end > begin else 0.0)
        which, rays = may_meet(place, movers.reach + swept, origin, ray, far)
        if not len(which):
            return

        # the ray's origin seen from the body's first: large coordinates cancel there
        when = times.take(rays)
        offset = origin.take(rays, axis=1) - now.at.take(which, axis=1)
        offset -= (when - now.since.take(which)) * now.velocity.take(which, axis=1)
        turned = now.turned.take(which, axis=2)
        for mover in curved:
            pairs = np.flatnonzero(which == mover)
            if len(pairs):
                motion = movers.fleet.motions[mover]
                offset[:, pairs] = origin[:, rays[pairs]] - motion.position(when[pairs]).T
                turned[:, :, pairs] = motion.rotation(when[pairs]).transpose(1, 2, 0)
        along = ray.take(rays, axis=1)
        centre = movers.centre.take(which, axis=1)
        sphere = offset - np.einsum("ijk,jk->ik", turned, centre)
        enter, leave, touch = through_sphere(sphere, along, movers.reach.take(which))
        kept = np.flatnonzero(touch & (enter <= far) & (enter < found.range_m.take(rays)))
        if not len(kept):
            return

        which, rays, enter, leave = which[kept], rays[kept], enter[kept], leave[kept]
        turned = turned.take(kept, axis=2)
        local = np.einsum("jik,jk->ik", turned, offset.take(kept, axis=1)) - centre.take(kept, axis=1)
        along = np.einsum("jik,jk->ik", turned, along.take(kept, axis=1))
        start = _rows(local + enter * along + movers.cell.take(which, axis=1))
        until = (leave - enter).astype(np.float32)
        number, span = self._run_slots(movers.structure[which], start, _rows(along), until)
        hit = np.flatnonzero(number >= 0)
        if not len(hit):
            return
        which, rays = which[hit], rays[hit]
        triangle = number[hit] + movers.shift[which]
        range_m, normal, facing = self._refined(triangle, local[:, hit], along[:, hit], span[hit] + enter[hit])
        normal = np.einsum("ijk,jk->ik", turned[:, :, hit], normal)
        _keep_nearer(found, rays, triangle, movers.body[which], range_m, normal, facing)

    def _run_slots(self, home: Longs, start: Singles, along: Singles, until: Singles) -> tuple[Ints, Singles]:
        if len(self._slots) == 1:
            return _run(self._slots[0], start, along, until)
        number: Ints = np.full(len(home), MISS, np.int32)
        span = np.zeros(len(home), np.float32)
        for slots in np.unique(home):
            here = np.flatnonzero(home == slots)
            number[here], span[here] = _run(self._slots[slots], start[here], along[here], until[here])
        return number, span


def _structure(content: Content) -> EmbreeScene:
    structure = EmbreeScene(robust=True)  # without it 8 % of rays aimed at shared edges slip through
    TriangleMesh(structure, content.vertices, content.faces)
    _run(structure, np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32), np.ones(1, np.float32))  # builds it
    return structure


def _run(structure: EmbreeScene, origin: Singles, ray: Singles, until: Singles) -> tuple[Ints, Singles]:
    """Triangle (-1: none) and distance of each ray's first hit; `until` is overwritten."""
    answer = structure.run(origin, ray, dists=until, output=1)
    return answer["primID"], answer["tfar"]


def _rows(vectors: Floats) -> Singles:
    """(3, m) in float64 to (m, 3) in float32."""
    return vectors.T.astype(np.float32, order="C")


def _norm(vector: Floats) -> float:
    return float(np.sqrt((vector * vector).sum()))


def _turned(ray: Floats) -> Floats:
    """Each ray turned by `LEAK_TURN_RAD` about an axis across it."""
    helper = np.zeros_like(ray)
    helper[np.argmin(np.abs(ray), axis=0), np.arange(ray.shape[1])] = 1.0
    across = np.cross(ray, helper, axis=0)
    across /= np.sqrt(np.einsum("ik,ik->k", across, across))
    turned = ray + LEAK_TURN_RAD * across
    return np.asarray(turned / np.sqrt(np.einsum("ik,ik->k", turned, turned)))


def _keep_nearer(
    found: _Nearest, rays: Longs, triangle: Longs, body: Longs, range_m: Floats, normal: Floats, facing: Floats
) -> None:
    """Put hits of `rays` (which may repeat) where nothing is nearer."""
    best = found.range_m.copy()
    np.minimum.at(best, rays, range_m)
    wins = np.flatnonzero(range_m == best[rays])
    target = rays[wins]
    found.range_m[target] = range_m[wins]
    found.triangle[target] = triangle[wins]
    found.body[target] = body[wins]
    found.normal[:, target] = normal[:, wins]
    found.facing[target] = facing[wins]
