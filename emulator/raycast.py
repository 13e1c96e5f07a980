"""First hits of rays on the bodies of a scene; with deforming the only user of embreex.

Belongs here: casting, moving rays into the frames of moving bodies, refining what comes back in float64. Not: where
rays come from (beams), what a hit means (physics), what lies in the structures (structures).

The caster works in float32 and only decides *which* triangle is met; the distance is then recomputed in float64 from
the float64 plane of that triangle. To keep the decision good, every structure lies about its own float64 origin, and
rays begin where they enter a bounding sphere.

A moving body is not moved: its rays are, by its pose at each ray's own time, into the slot of its shape. So nothing is
ever rebuilt, a call costs the same few casts however many bodies move, and a thousand equal cars are stored once.
Meshes that change their shape are cast by slices (deforming).
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from emulator.deforming import Slices
from emulator.fleet import Flags, Longs, Stretch, may_meet, through_sphere
from emulator.hits import MISS, Block, Counters, Fan, Hits, Met, Nearest, Passing, Renewed, all_met, keep_nearer
from emulator.nearby import KEPT, Nearby
from emulator.physics.arrays import indexes
from emulator.scene import Scene
from emulator.structures import Content, Group, Movers, lay_out
from emulator.triangles import Floats, Ints

Singles = NDArray[np.float32]

SUSPICIOUS = 1e-3
"Refined and float32 distance differ by more than this times (1 + distance): the plane is not to be trusted."
LEAK_TURN_RAD = 1e-6
"How far a ray that slipped between two triangles is turned for its second cast."
LONGEST = 1e30
"Stands for an unlimited ray in float32."
BLOCK = 8192
"Rays cast together on what rests, so that their arrays stay in the processor's cache."
TOGETHER = 4 * BLOCK
"Rays that come again, for which moving bodies are looked for together: a hundred short steps, however few they are."
KEEP_NUMBERS = 3_900_000
"An array of so many (31 MB) is made and freed once: glibc then keeps freed memory instead of mapping it anew."
SUBSETS_KEPT = 16
FAN_RAYS_KEPT = 400_000
"Rays of which it is remembered what they meet of resting bodies: about 200 bytes each."


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
        self._slices = [Slices(frames, centre) for frames, centre in layout.frames]
        self._table = layout.table
        counts = [len(body.part_material) for body in scene.bodies]
        self._actor_of = np.array([body.actor for body in scene.bodies], np.int32)
        self._parts_of = np.cumsum([0, *counts])[: len(counts)].astype(np.int64)
        self._part_material = np.concatenate([np.zeros(0, np.int32), *(body.part_material for body in scene.bodies)])
        self._subsets: dict[frozenset[int], Caster] = {}
        self._nearby = Nearby(self._movers.fleet.motions, self._movers.reach + self._movers.arm)
        self._chosen_movers: tuple[tuple[Longs, Movers], ...] = ()
        self._fans: tuple[Fan, ...] = ()
        "The latest last."
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
        again: bool = False,
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
        again : these very arrays `origin_m` and `direction`, both (m, 3) in float64, will come again, unchanged: what
            they meet of resting bodies is kept, and only moving ones are cast on. Not together with the two before.

        Returns
        -------
        hits : `Hits` of m rays, ranges from `origin_m` also where `tnear_m` is given. The same object, not to be
            written to, where rays that come again met no moving body.
        """
        if again:
            return self.renewed(origin_m, direction, t_s, max_range_m).hits
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

    @property
    def moves(self) -> bool:
        """Some body moves, or is stored as those that do."""
        return len(self._movers.body) > 0

    def may_lie_beyond(self, origin_m: Floats, direction: Floats, t_s: Floats, beyond_m: float) -> Flags:
        """(m,) rays on which something may lie farther than that, by the spheres that hold what rests and what moves.

        `origin_m`, `direction` : (m, 3), `t_s` : (m,), as for `first_hits`.
        """
        origin, ray = origin_m.T, direction.T
        found = np.zeros(len(direction), bool)
        spheres = [(group.centre, group.radius) for group in self._groups]
        if self.moves and len(t_s):
            _, place, swept, _ = _whereabouts(self._movers, float(t_s.min()), float(t_s.max()))
            low = place.min(axis=1, keepdims=True)
            centre = low + (place.max(axis=1, keepdims=True) - low) / 2.0
            away = np.sqrt(((place - centre) ** 2).sum(axis=0))
            spheres.append((centre, float((away + self._movers.reach + swept).max())))
        for centre, radius in spheres:
            _, leave, touch = through_sphere(origin - centre, ray, radius)
            found |= touch & (leave > beyond_m)
        return found

    def renewed(self, origin_m: Floats, direction: Floats, t_s: Floats | float, max_range_m: float = np.inf) -> Renewed:
        """First hits of rays that come again, told apart: on what rests, and those that differ now.

        The arguments are those of `first_hits` with `again`.
        """
        far = max_range_m
        fan = next((one for one in reversed(self._fans) if one.is_of(origin_m, direction, far)), None)
        with np.errstate(under="ignore"):
            if fan is None:
                fan = self._fan(origin_m, direction, far)
                kept = [*self._fans, fan]
                while len(kept) > 1 and sum(len(one.direction) for one in kept) > FAN_RAYS_KEPT:
                    kept.pop(0)
                self._fans = tuple(kept)
            self.counters.rays += len(direction)
            parts = []
            if self.moves:
                times = np.broadcast_to(np.asarray(t_s, dtype=np.float64), (len(direction),))
                parts = [self._changed(fan, block, times[block.here]) for block in fan.blocks]
        return Renewed.of(fan.hits, [part for part in parts if part is not None])

    def _fan(self, origin_m: Floats, direction: Floats, far: float) -> Fan:
        count = len(direction)
        hits, blocks = Hits.misses(count), []
        for begin in range(0, count, TOGETHER) if len(self._table) else ():
            here = slice(begin, min(begin + TOGETHER, count))
            origin, ray = np.ascontiguousarray(origin_m[here].T), np.ascontiguousarray(direction[here].T)
            found = self._resting(origin, ray, far)
            inner = self._is_inner(found)
            box = origin.min(axis=1), origin.max(axis=1)
            blocks.append(Block(here, origin, ray, box, found, indexes(inner)))
            if not self.moves and inner.any():
                self._recast_leaks(found, inner, origin, ray, np.zeros(ray.shape[1]), far)
            self._enter(found, inner, far, hits, here)
        for column in vars(hits).values():
            column.flags.writeable = False
        return Fan(origin_m, direction, far, tuple(blocks), hits)

    def _changed(self, fan: Fan, block: Block, times: Floats) -> tuple[Longs, Hits] | None:
        """Rays of a block, ascending, that meet a moving body or may have slipped past one, and their hits."""
        met = self._movers_met(block.origin, block.ray, times, fan.far, block.nearest.range_m, block.box)
        if met is None and not len(block.unsettled):
            return None
        changed = np.zeros(block.ray.shape[1], bool)
        changed[block.unsettled] = True
        if met is not None:
            changed[met.rays] = True
        rays = indexes(changed)
        found = block.nearest.taken(rays)
        if met is not None:
            keep_nearer(found, rays.searchsorted(met.rays), met)
        origin, ray, times = block.origin[:, rays], block.ray[:, rays], times[rays]
        inner = self._is_inner(found)
        if inner.any():
            self._recast_leaks(found, inner, origin, ray, times, fan.far)
        hits = Hits.misses(len(rays))
        self._enter(found, inner, fan.far, hits, slice(0, len(rays)))
        return rays + block.here.start, hits

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
        self._enter(found, inner, far, hits, here)

    def _enter(self, found: Nearest, inner: Flags, far: float, hits: Hits, here: slice) -> None:
        """Write what was found of the rays `here`, which are misses so far."""
        table, body, triangle = self._table, found.body, found.triangle
        hit = triangle >= 0
        if far < np.inf:
            hit &= found.range_m <= far
        side = np.where(found.facing > 0.0, -1.0, 1.0)  # not the sign: a grazing normal must not vanish
        where: slice | Longs
        if hit.all():
            where = here
            range_m, normal = found.range_m, found.normal
        else:
            index = indexes(hit)
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

    def _is_inner(self, found: Nearest) -> Flags:
        inner = found.facing > 0.0
        if inner.any():
            inner &= self._table.closed.take(found.triangle)
        return inner

    def _recast_leaks(
        self, found: Nearest, inner: Flags, origin: Floats, ray: Floats, times: Floats, far: float
    ) -> None:
        """Cast rays that met the inside of a closed shell once more, turned a little.

        Those that meet an inside again are inside; the others had slipped between two triangles and get what the turned
        ray met, with the distance of the original ray to that plane.
        """
        index = indexes(inner)
        again = self._nearest(origin[:, index], _turned(ray[:, index]), times[index], far)
        leaked = indexes(~self._is_inner(again))
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

    def _nearest(self, origin: Floats, ray: Floats, times: Floats, far: float) -> Nearest:
        found = self._resting(origin, ray, far)
        if self.moves:
            met = self._movers_met(origin, ray, times, far, found.range_m)
            if met is not None:
                keep_nearer(found, met.rays, met)
        return found

    def _resting(self, origin: Floats, ray: Floats, far: float) -> Nearest:
        count = ray.shape[1]
        if count <= BLOCK:
            return self._resting_of(origin, ray, far)
        found = Nearest.nothing(count)
        for begin in range(0, count, BLOCK):
            here = slice(begin, begin + BLOCK)
            found.put(here, self._resting_of(origin[:, here], ray[:, here], far))
        return found

    def _resting_of(self, origin: Floats, ray: Floats, far: float) -> Nearest:
        if len(self._groups) == 1 and _norm(origin[:, :1] - self._groups[0].centre) < self._groups[0].radius:
            return self._cast_around(origin, ray, far)
        found = Nearest.nothing(ray.shape[1])
        for group, structure in zip(self._groups, self._built, strict=True):
            self._cast_afar(group, structure, origin, ray, far, found)
        return found

    def _cast_around(self, origin: Floats, ray: Floats, far: float) -> Nearest:
        """All rays on the only group of resting bodies, among which they begin."""
        group = self._groups[0]
        local = origin - group.centre
        until = np.full(ray.shape[1], min(far, LONGEST), np.float32)
        number, span = _run(self._built[0], _rows(local), _rows(ray), until)
        self.counters.cast += len(until)
        triangle = np.add(number, group.offset, dtype=np.int64)
        hit = number >= 0
        range_m, normal, facing = self._refined(triangle, local, ray, span, hit)
        body = self._table.body.take(triangle, mode="wrap")
        if not hit.all():
            miss = ~hit
            triangle[miss] = body[miss] = -1
            range_m[miss] = np.inf
            facing[miss] = 0.0
        return Nearest(range_m, triangle, body, normal, facing)

    def _cast_afar(
        self, group: Group, structure: EmbreeScene, origin: Floats, ray: Floats, far: float, found: Nearest
    ) -> None:
        """Rays on one of several groups: those that meet its sphere, from where they enter it."""
        local = origin - group.centre
        enter, _, touch = through_sphere(local, ray, group.radius)
        rays = indexes(touch & (enter <= far) & (enter < found.range_m))
        if not len(rays):
            return
        local, along, enter = local[:, rays], ray[:, rays], enter[rays]
        until = np.full(len(rays), LONGEST, np.float32)
        number, span = _run(structure, _rows(local + enter * along), _rows(along), until)
        self.counters.cast += len(until)
        hit = indexes(number >= 0)
        triangle = np.add(number[hit], group.offset, dtype=np.int64)
        range_m, normal, facing = self._refined(triangle, local[:, hit], along[:, hit], span[hit] + enter[hit])
        met = Met(rays[hit], triangle, self._table.body.take(triangle), range_m, normal, facing)
        keep_nearer(found, met.rays, met)

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

    def _movers_met(
        self,
        origin: Floats,
        ray: Floats,
        times: Floats,
        far: float,
        known_m: Floats,
        box: tuple[Floats, Floats] | None = None,
    ) -> Met | None:
        """Each ray on the moving bodies whose spheres it meets before `known_m`, in their own frames."""
        begin, end = float(times.min()), float(times.max())
        low, high = (origin.min(axis=1), origin.max(axis=1)) if box is None else box
        movers = self._near_movers(low, high, begin, end, far)
        if not len(movers.body):
            return None
        now, place, swept, curved = _whereabouts(movers, begin, end)
        which, rays = may_meet(place, movers.reach + swept, origin, ray, far)
        if not len(which):
            return None

        # the ray's origin seen from the body's first: large coordinates cancel there
        when = times.take(rays)
        offset = origin.take(rays, axis=1) - now.at.take(which, axis=1)
        offset -= (when - now.since.take(which)) * now.velocity.take(which, axis=1)
        turned = now.turned.take(which, axis=2)
        for mover in curved:
            pairs = indexes(which == mover)
            if len(pairs):
                motion = movers.fleet.motions[mover]
                offset[:, pairs] = origin[:, rays[pairs]] - motion.position(when[pairs]).T
                turned[:, :, pairs] = motion.rotation(when[pairs]).transpose(1, 2, 0)
        along = ray.take(rays, axis=1)
        centre = movers.centre.take(which, axis=1)
        sphere = offset - np.einsum("ijk,jk->ik", turned, centre)
        enter, leave, touch = through_sphere(sphere, along, movers.reach.take(which))
        kept = indexes(touch & (enter <= far) & (enter < known_m.take(rays)))
        if not len(kept):
            return None

        which, rays, enter, leave = which[kept], rays[kept], enter[kept], leave[kept]
        turned = turned.take(kept, axis=2)
        local = np.einsum("jik,jk->ik", turned, offset.take(kept, axis=1)) - centre.take(kept, axis=1)
        along = np.einsum("jik,jk->ik", turned, along.take(kept, axis=1))
        through = indexes(_may_cross(local, along, movers.half.take(which, axis=1)))
        if not len(through):
            return None
        if len(through) < len(which):
            which, rays, enter, leave = which[through], rays[through], enter[through], leave[through]
            turned, local = turned.take(through, axis=2), local.take(through, axis=1)
            along = along.take(through, axis=1)
        self.counters.cast += len(which)
        passing = Passing(which, rays, enter, leave, turned, local, along)
        if not self._slices:
            return self._rigid_met(movers, passing)
        home = movers.structure[which]
        parts = [self._rigid_met(movers, passing.taken(indexes(home >= 0)))]
        for number in np.unique(home[home < 0]):
            parts.append(self._frames_met(movers, passing.taken(indexes(home == number)), times, -1 - number))
        return all_met([part for part in parts if part is not None])

    def _rigid_met(self, movers: Movers, near: Passing) -> Met | None:
        which, rays = near.which, near.rays
        if not len(which):
            return None
        start = _rows(near.local + near.enter * near.along + movers.cell.take(which, axis=1))
        until = (near.leave - near.enter).astype(np.float32)
        number, span = self._run_slots(movers.structure[which], start, _rows(near.along), until)
        hit = indexes(number >= 0)
        if not len(hit):
            return None
        which, rays = which[hit], rays[hit]
        triangle = number[hit] + movers.shift[which]
        range_m, normal, facing = self._refined(
            triangle, near.local[:, hit], near.along[:, hit], span[hit] + near.enter[hit]
        )
        normal = np.einsum("ijk,jk->ik", near.turned[:, :, hit], normal)
        return Met(rays, triangle, movers.body[which], range_m, normal, facing)

    def _frames_met(self, movers: Movers, near: Passing, times: Floats, number: int) -> Met | None:
        """On bodies that change their shape, all of the same one."""
        face, range_m, normal, facing = self._slices[number].meet(
            near.local, near.along, near.enter, near.leave, times.take(near.rays)
        )
        hit = indexes(face >= 0)
        if not len(hit):
            return None
        which = near.which[hit]
        normal = np.einsum("ijk,jk->ik", near.turned[:, :, hit], normal[:, hit])
        triangle = face[hit] + movers.shift[which]
        return Met(near.rays[hit], triangle, movers.body[which], range_m[hit], normal, facing[hit])

    def _near_movers(self, low: Floats, high: Floats, begin_s: float, end_s: float, far: float) -> Movers:
        """Those that can come within reach; built anew once a second, or where the sensor comes to another cell."""
        which = self._nearby.within(low, high, far, begin_s, end_s)
        if len(which) == len(self._movers.body):
            return self._movers
        for known, movers in self._chosen_movers:
            if known is which:
                return movers
        movers = self._movers.chosen(which)
        self._chosen_movers = ((which, movers), *self._chosen_movers[: KEPT - 1])
        return movers

    def _run_slots(self, home: Longs, start: Singles, along: Singles, until: Singles) -> tuple[Ints, Singles]:
        if len(self._slots) == 1:
            return _run(self._slots[0], start, along, until)
        number: Ints = np.full(len(home), MISS, np.int32)
        span = np.zeros(len(home), np.float32)
        for slots in np.unique(home):
            here = indexes(home == slots)
            number[here], span[here] = _run(self._slots[slots], start[here], along[here], until[here])
        return number, span


def _whereabouts(movers: Movers, begin: float, end: float) -> tuple[Stretch, Floats, Floats, Longs]:
    """Motions from `begin` to `end`; centres (3, b), how far they may be from there, and which do not move straight."""
    now = movers.fleet.during(begin, end)
    middle = begin + (end - begin) / 2.0
    place = now.at + (middle - now.since) * now.velocity + np.einsum("ijb,jb->ib", now.turned, movers.centre)
    swept = np.sqrt(np.einsum("ib,ib->b", now.velocity, now.velocity)) * ((end - begin) / 2.0)
    curved = indexes(~now.straight)
    if len(curved):  # anywhere around where the body's origin is, as far as it can have come
        for mover in curved:
            place[:, mover] = movers.fleet.motions[mover].position(np.array([middle]))[0]
        swept[curved] = movers.arm[curved] + (movers.speed[curved] * ((end - begin) / 2.0) if end > begin else 0.0)
    return now, place, swept, curved


def _may_cross(origin: Floats, ray: Floats, half: Floats) -> Flags:
    """Rays (3, k) whose lines may meet boxes of these half sides about (0, 0, 0)."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        each = 1.0 / ray
        middle, wide = origin * each, np.abs(each) * half
        # a ray along a side gives NaN, which excludes nothing
        outside = np.max(-wide - middle, axis=0) > np.min(wide - middle, axis=0)
    return np.asarray(~outside)


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
