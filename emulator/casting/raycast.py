"""First hits of rays on the bodies of a scene.

Belongs here: casting on what rests, what is kept of rays that come again, which hit is the first. Not: bodies that move
(moving_cast), searches themselves (embree), where rays come from (beams), what a hit means (physics), what lies in the
structures (structures).

The caster works in float32 and only decides *which* triangle is met; the distance is then recomputed in float64 from
the float64 plane of that triangle. To keep the decision good, every structure lies about its own float64 origin, and
rays begin where they enter a bounding sphere.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import cache, partial
from types import ModuleType

import numpy as np

from emulator.casting import embree
from emulator.casting.hits import (
    Aim,
    Around,
    Block,
    Counters,
    Fan,
    Hits,
    LateHits,
    Met,
    Nearest,
    Renewed,
    extent,
    keep_nearer,
    rows,
)
from emulator.casting.moving_cast import MovingCast
from emulator.casting.structures import Group, lay_out
from emulator.compiled.pair import OTHERWISE, array_form, by_loops
from emulator.physics.arrays import indexes
from emulator.world.batched_poses import Flags, Longs, through_sphere
from emulator.world.scene import Scene
from emulator.world.triangles import Floats, Ints

LEAK_TURN_RAD = 1e-6
"How far a ray that slipped between two triangles is turned for its second cast."
LONGEST = 1e30
"Stands for an unlimited ray in float32."
LONGER = 1.0 + 1e-6
"So much farther than asked for a search looks: what lies just at the end of a ray is met, and judged in float64."
BLOCK = 32_768
"Rays cast together: more short steps cost more than arrays that leave the processor's cache."
KEEP_NUMBERS = 3_900_000
"An array of so many (31 MB) is made and freed once: glibc then keeps freed memory instead of mapping it again."
SUBSETS_KEPT = 16
FANS_KEPT, FAN_RAYS_KEPT = 32, 400_000
"Fans, and rays in all, of which it is remembered what they meet of resting bodies: about 200 bytes a ray."


def _resting_by_loops(loops: ModuleType, caster: Caster, origin: Floats, aim: Aim, far: float) -> Nearest:
    if not caster._packets:
        return OTHERWISE
    table, groups = caster._table, caster._groups
    if not groups:
        return Nearest.nothing(len(aim))
    range_m, triangle, body, normal, facing = loops.unwritten(len(aim))
    found = Nearest(range_m, triangle, body, normal, facing, table.plane, caster._merged)
    for number, (group, structure) in enumerate(zip(groups, caster._built, strict=True)):
        around = len(groups) == 1 and _norm(origin[:, :1] - group.centre) < group.radius
        cast, wrong = loops.resting(
            *structure.how, origin, aim.ray, aim.order, group.centre[:, 0], np.inf if around else group.radius, far,
            embree.SUSPICIOUS, table.plane, table.body, group.offset, number == 0,
            found.range_m, found.triangle, found.body, found.facing,
        )  # fmt: skip
        caster.counters.cast += cast
        caster.counters.suspicious += wrong
    return found


def _reported_by_loops(loops: ModuleType, caster: Caster, found: Nearest, inner: Flags, far: float) -> LateHits:
    """What few ask for is looked up, with numpy arrays, if somebody does."""
    (actor, material), cosine = loops.reported(
        found.range_m, found.triangle, found.body, found.facing, far, inner, caster._actor_of, caster._material,
        caster._table.part, caster._parts_of, caster._part_material,
    )  # fmt: skip
    later = partial(array_form(Caster._reported), caster, found, inner, far)
    return LateHits(found.range_m, actor, material, inner, cosine, ((found, later),))


@cache
def _keep_freed_memory() -> None:
    """Once a process, for its casters: page faults were half the time of a large cast. Made again, it is all cleared,
    which takes a sixth of a run of one second."""
    np.zeros(KEEP_NUMBERS)


class Caster:
    """Casts rays on a scene. Builds everything once; afterwards several threads may cast at the same time."""

    def __init__(self, scene: Scene, bodies: Iterable[int] | None = None) -> None:
        self._scene = scene
        self.counters = Counters()
        chosen = sorted(set(range(len(scene.bodies)) if bodies is None else bodies))
        layout = lay_out(scene.bodies, chosen)
        self._groups = layout.groups
        self._built = [embree.structure(group.content) for group in layout.groups]
        self._packets = embree.in_packets(self._built)
        self._moving = MovingCast(layout, self.counters)
        self._table = layout.table
        counts = [len(body.part_material) for body in scene.bodies]
        self._actor_of = np.array([body.actor for body in scene.bodies], np.int32)
        self._parts_of = np.cumsum([0, *counts])[: len(counts)].astype(np.int64)
        self._part_material = np.concatenate([np.zeros(0, np.int32), *(body.part_material for body in scene.bodies)])
        self._merged = sum(len(group.content.faces) for group in layout.groups)
        "Triangles that belong to one body each: the first ones."
        self._material = self._material_of(self._table.body[: self._merged], np.arange(self._merged))
        self._subsets: dict[frozenset[int], Caster] = {}
        self._fans: tuple[Fan, ...] = ()
        "The latest last."
        self._aimed: tuple[tuple[Floats, tuple[Aim, ...]], ...] = ()
        "The latest last."
        _keep_freed_memory()

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
        aimed: bool = False,
        order: Longs | None = None,
        inside: Longs | None = None,
    ) -> Hits | LateHits:
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
        aimed : this very array `direction` will come again.
        order : (m,) in which packets of rays are searched for, each `BLOCK` of them apart; neighbours should meet the
            same. None: as they come. What is met does not depend on it.
        inside : (m,) body in which each ray is known to begin, -1 none: one that meets its inside has slipped past
            nothing, and is not cast a second time. None: of none it is known.

        Returns
        -------
        hits : `Hits` of m rays, ranges from `origin_m` also where `tnear_m` is given; by compiled loops `LateHits`,
            with the same columns. The same object, not to be written to, where rays that come again met no moving body.
        """
        if again:
            return self.renewed(origin_m, direction, t_s, max_range_m).hits
        if bodies is not None:
            chosen = self._subset(frozenset(bodies))
            return chosen.first_hits(origin_m, direction, t_s, tnear_m=tnear_m, max_range_m=max_range_m)
        ray = np.asarray(direction, dtype=np.float64)
        count = len(ray)
        origin, times = _spread(origin_m, (count, 3)), _spread(t_s, (count,))
        skip = _spread(tnear_m, (count,)) if np.any(tnear_m) else None
        self.counters.rays += count
        if not len(self._table):
            return Hits.misses(count)
        with np.errstate(under="ignore"):  # components below 1e-38 are nothing in float32
            aims = self._aims(ray, order) if aimed else _aims(ray, order)
            parts = []
            for begin, aim in zip(range(0, count, BLOCK), aims, strict=True):
                here = slice(begin, begin + BLOCK)
                start = np.ascontiguousarray(origin[here].T)
                passed, within = None if skip is None else skip[here], None if inside is None else inside[here]
                parts.append(self._cast(start, aim, times[here], passed, max_range_m, within))
        return _joined(parts)

    def _aims(self, direction: Floats, order: Longs | None) -> tuple[Aim, ...]:
        """These directions in blocks, as they are known from the last time."""
        known = next((aims for given, aims in reversed(self._aimed) if given is direction), None)
        if known is None:
            known = tuple(replace(aim, lasts=True) for aim in _aims(direction, order))
            kept = [*self._aimed, (direction, known)]
            while len(kept) > FANS_KEPT or (len(kept) > 1 and sum(len(given) for given, _ in kept) > FAN_RAYS_KEPT):
                kept.pop(0)
            self._aimed = tuple(kept)
        return known

    def around(self, origin_m: Floats, t_s: Floats, far: float) -> Around | None:
        """What a single pass over rays from (m, 3) at `t_s` (m,) needs; None: they are not among one structure."""
        if not self._packets or len(self._groups) != 1:
            return None
        group, table = self._groups[0], self._table
        origin = origin_m.T
        if not _norm(origin[:, :1] - group.centre) < group.radius:
            return None
        crossing, others = self._moving.around(origin, t_s, far)
        return Around(
            self._built[0].how, group.centre[:, 0], group.offset, table.plane, table.body, table.closed,
            self._actor_of, self._material, embree.SUSPICIOUS, self.counters, crossing, others,
            (table.part, self._parts_of, self._part_material),
        )  # fmt: skip

    @property
    def bare(self) -> Caster:
        """Itself: it knows of faces alone."""
        return self

    @property
    def moves(self) -> bool:
        """Some body moves, or is stored as those that do."""
        return self.movers > 0

    @property
    def movers(self) -> int:
        """How many do."""
        return len(self._moving)

    def may_lie_beyond(self, origin_m: Floats, direction: Floats, t_s: Floats, beyond_m: float) -> Flags:
        """(m,) rays on which something may lie farther than that, by the spheres that hold what rests and what moves.

        `origin_m`, `direction` : (m, 3), `t_s` : (m,), as for `first_hits`.
        """
        origin, ray = origin_m.T, direction.T
        found = np.zeros(len(direction), bool)
        spheres = [(group.centre, group.radius) for group in self._groups]
        if self.moves and len(t_s):
            spheres.append(self._moving.sphere(t_s))
        for centre, radius in spheres:
            _, leave, touch = through_sphere(origin - centre, ray, radius)
            found |= touch & (leave > beyond_m)
        return found

    def renewed(self, origin_m: Floats, direction: Floats, t_s: Floats | float, max_range_m: float = np.inf) -> Renewed:
        """First hits of rays that come again, distinguished: on what rests, and those that differ now.

        The arguments are those of `first_hits` with `again`.
        """
        far = max_range_m
        fan = next((one for one in reversed(self._fans) if one.is_of(origin_m, direction, far)), None)
        with np.errstate(under="ignore"):
            if fan is None:
                fan = self._fan(origin_m, direction, far)
                kept = [*self._fans, fan]
                while len(kept) > FANS_KEPT or (
                    len(kept) > 1 and sum(len(one.direction) for one in kept) > FAN_RAYS_KEPT
                ):
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
        parts, blocks = [Hits.misses(0)], []
        for begin in range(0, count, BLOCK) if len(self._table) else ():
            here = slice(begin, min(begin + BLOCK, count))
            origin, aim = np.ascontiguousarray(origin_m[here].T), replace(_aim(direction[here]), lasts=True)
            found = self._resting(origin, aim, far)
            inner = self._is_inner(found)
            box = extent(origin)
            blocks.append(Block(here, origin, aim, box, found, indexes(inner)))
            if not self.moves and inner.any():
                self._recast_leaks(found, inner, indexes(inner), origin, aim.ray, np.zeros(len(aim)), far)
            parts.append(array_form(Caster._reported)(self, found, inner, far))
        hits = Hits.joined(parts) if blocks else Hits.misses(count)
        for column in vars(hits).values():
            column.flags.writeable = False
        return Fan(origin_m, direction, far, tuple(blocks), hits)

    def _changed(self, fan: Fan, block: Block, times: Floats) -> tuple[Longs, Hits] | None:
        """Rays of a block, ascending, that meet a moving body or may have slipped past one, and their hits."""
        met = self._moving.met(block.origin, block.aim, times, fan.far, block.nearest.range_m, block.box)
        if met is None and not len(block.unsettled):
            return None
        changed = np.zeros(len(block.aim), bool)
        changed[block.unsettled] = True
        if met is not None:
            changed[met.rays] = True
        rays = indexes(changed)
        found = block.nearest.taken(rays)
        if met is not None:
            keep_nearer(found, rays.searchsorted(met.rays), met)
        origin, ray, times = block.origin[:, rays], block.aim.ray[:, rays], times[rays]
        inner = self._is_inner(found)
        if inner.any():
            self._recast_leaks(found, inner, indexes(inner), origin, ray, times, fan.far)
        return rays + block.here.start, array_form(Caster._reported)(self, found, inner, fan.far)

    def _subset(self, bodies: frozenset[int]) -> Caster:
        if bodies not in self._subsets:
            while len(self._subsets) >= SUBSETS_KEPT:
                self._subsets.pop(next(iter(self._subsets)))
            self._subsets[bodies] = Caster(self._scene, bodies)
        return self._subsets[bodies]

    def _cast(
        self, origin: Floats, aim: Aim, times: Floats, skip: Floats | None, far: float, inside: Longs | None = None
    ) -> Hits | LateHits:
        if skip is not None:
            origin = origin + skip * aim.ray
        found = self._nearest(origin, aim, times, far)
        inner = self._is_inner(found)
        doubtful = indexes(inner if inside is None else inner & (found.body != inside))
        if len(doubtful):
            self._recast_leaks(found, inner, doubtful, origin, aim.ray, times, far)
        if skip is not None:
            found.range_m = found.range_m + skip
        return self._reported(found, inner, far)

    @by_loops(_reported_by_loops, "reported")
    def _reported(self, found: Nearest, inner: Flags, far: float) -> Hits | LateHits:
        """What was found, as it is reported; `found` stays as it is."""
        table, body, triangle = self._table, found.body, found.triangle
        missed = triangle < 0
        if far < np.inf:
            missed |= ~(found.range_m <= far)
        index = indexes(missed)
        range_m = found.range_m
        if len(index):
            range_m = range_m.copy()
        side = np.where(found.facing > 0.0, -1.0, 1.0)  # not the sign: a grazing normal must not vanish
        material = self._material.take(triangle, mode="wrap") if self._merged else np.zeros(len(body), np.int32)
        single = indexes(triangle >= self._merged)
        if len(single):
            material[single] = self._material_of(body[single], triangle[single])
        hits = Hits(
            range_m,
            body.astype(np.int32),
            self._actor_of.take(body, mode="wrap"),
            table.face.take(triangle, mode="wrap"),
            material,
            (found.normals() * side).T,
            inner,
            np.abs(found.facing),
        )
        if len(index):
            hits.put(index, Hits.misses(len(index)))
        return hits

    def _material_of(self, body: Longs, triangle: Longs) -> Ints:
        return self._part_material.take(self._parts_of.take(body) + self._table.part.take(triangle))

    def _is_inner(self, found: Nearest) -> Flags:
        inner = found.facing > 0.0
        if inner.any():
            inner &= self._table.closed.take(found.triangle)
        return inner

    def _recast_leaks(
        self, found: Nearest, inner: Flags, index: Longs, origin: Floats, ray: Floats, times: Floats, far: float
    ) -> None:
        """Cast rays `index` that met the inside of a closed shell once more, turned a little.

        Those that meet an inside again are inside; the others had slipped between two triangles and get what the turned
        ray met, with the distance of the original ray to that plane.
        """
        again = self._nearest(origin.take(index, axis=1), Aim(_turned(ray.take(index, axis=1))), times[index], far)
        leaked = indexes(~self._is_inner(again))
        if not len(leaked):
            return
        self.counters.leaks += len(leaked)
        target = index[leaked]
        range_m, turned_facing = again.range_m[leaked], again.facing[leaked]
        normal = again.normals(leaked)
        facing = np.einsum("ik,ik->k", normal, ray.take(target, axis=1))
        with np.errstate(divide="ignore", invalid="ignore"):
            refined = range_m * turned_facing / facing
            good = np.abs(refined - range_m) <= embree.SUSPICIOUS * (1.0 + range_m)
        found.range_m[target] = np.where(good, refined, range_m)
        found.triangle[target] = again.triangle[leaked]
        found.body[target] = again.body[leaked]
        found.normal[:, target] = normal
        found.facing[target] = np.where(good, facing, turned_facing)
        inner[target] = False

    def _nearest(self, origin: Floats, aim: Aim, times: Floats, far: float) -> Nearest:
        found = self._resting(origin, aim, far)
        if self.moves:
            met = self._moving.met(origin, aim, times, far, found.range_m, into=found)
            if met is not None:
                keep_nearer(found, met.rays, met)
        return found

    @by_loops(_resting_by_loops, "resting", "unwritten")
    def _resting(self, origin: Floats, aim: Aim, far: float) -> Nearest:
        if len(self._groups) == 1 and _norm(origin[:, :1] - self._groups[0].centre) < self._groups[0].radius:
            return self._cast_around(origin, aim, far)
        found = Nearest.nothing(len(aim))
        for group, structure in zip(self._groups, self._built, strict=True):
            self._cast_afar(group, structure, origin, aim.ray, far, found)
        return found

    def _cast_around(self, origin: Floats, aim: Aim, far: float) -> Nearest:
        """All rays on the only group of resting bodies, among which they begin."""
        group = self._groups[0]
        local = origin - group.centre
        until = np.full(len(aim), min(far * LONGER, LONGEST), np.float32)
        number, span = embree.run(self._built[0], rows(local), aim.rows, until)
        self.counters.cast += len(until)
        triangle = np.add(number, group.offset, dtype=np.int64)
        hit = number >= 0
        range_m, normal, facing = embree.refined(self._table, self.counters, triangle, local, aim.ray, span, hit)
        body = self._table.body.take(triangle, mode="wrap")
        if not hit.all():
            miss = ~hit
            triangle[miss] = body[miss] = -1
            range_m[miss] = np.inf
            facing[miss] = 0.0
        return Nearest(range_m, triangle, body, normal, facing)

    def _cast_afar(
        self, group: Group, structure: embree.Structure, origin: Floats, ray: Floats, far: float, found: Nearest
    ) -> None:
        """Rays on one of several groups: those that meet its sphere, from where they enter it."""
        local = origin - group.centre
        enter, _, touch = through_sphere(local, ray, group.radius)
        rays = indexes(touch & (enter <= far) & (enter < found.range_m))
        if not len(rays):
            return
        local, along, enter = local[:, rays], ray[:, rays], enter[rays]
        until = np.full(len(rays), LONGEST, np.float32)
        number, span = embree.run(structure, rows(local + enter * along), rows(along), until)
        self.counters.cast += len(until)
        hit = indexes(number >= 0)
        triangle = np.add(number[hit], group.offset, dtype=np.int64)
        range_m, normal, facing = embree.refined(
            self._table, self.counters, triangle, local[:, hit], along[:, hit], span[hit] + enter[hit]
        )
        met = Met(rays[hit], triangle, self._table.body.take(triangle), range_m, normal, facing)
        keep_nearer(found, met.rays, met)


def _spread(values: Floats | float, shape: tuple[int, ...]) -> Floats:
    """The values, or the one that stands for all, in this shape."""
    found = np.asarray(values, dtype=np.float64)
    return found if found.shape == shape else np.broadcast_to(found, shape)


def _joined(parts: list[Hits | LateHits]) -> Hits | LateHits:
    late = [part for part in parts if isinstance(part, LateHits)]
    if late:
        return LateHits.joined(late)
    return Hits.joined([part for part in parts if isinstance(part, Hits)] or [Hits.misses(0)])


def _aim(direction: Floats) -> Aim:
    """Of directions (m, 3)."""
    return Aim(np.ascontiguousarray(direction.T))


def _aims(direction: Floats, order: Longs | None) -> Iterable[Aim]:
    """Of directions (m, 3), a block after the other."""
    for begin in range(0, len(direction), BLOCK):
        aim = _aim(direction[begin : begin + BLOCK])
        yield aim if order is None else Aim(aim.ray, order[begin : begin + BLOCK] - begin)


def _norm(vector: Floats) -> float:
    return float(np.sqrt((vector * vector).sum()))


def _turned(ray: Floats) -> Floats:
    """Each ray turned by `LEAK_TURN_RAD` about an axis across it."""
    least, each = np.abs(ray).argmin(axis=0), np.arange(ray.shape[1])
    across = np.zeros_like(ray)  # the product with the axis along which it has least
    across[(least + 1) % 3, each] = ray[(least + 2) % 3, each]
    across[(least + 2) % 3, each] = -ray[(least + 1) % 3, each]
    across /= np.sqrt(np.einsum("ik,ik->k", across, across))
    turned = ray + LEAK_TURN_RAD * across
    return np.asarray(turned / np.sqrt(np.einsum("ik,ik->k", turned, turned)))
