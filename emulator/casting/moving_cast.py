"""Rays on moving bodies: each ray is moved into the frame of every body that it may meet, at its own time.

Belongs here: which bodies come near, rays in their frames, hits there. Not: what rests (raycast), where bodies are
(batched_poses), shapes that change (deforming).

A moving body is not moved: its rays are, by its pose at each ray's own time, into the slot of its shape. So nothing is
ever rebuilt, a call costs the same few casts however many bodies move, and a thousand equal cars are stored once.
Meshes that change their shape are cast by slices (deforming).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial
from types import ModuleType

import numpy as np

from emulator.casting import embree
from emulator.casting.deforming import Slices
from emulator.casting.embree import Singles
from emulator.casting.hits import MISS, Aim, Counters, Crossing, Met, Nearest, Passing, all_met, extent, rows
from emulator.casting.structures import Layout, Movers
from emulator.compiled.pair import OTHERWISE, array_form, by_loops
from emulator.physics.arrays import indexes
from emulator.world.batched_poses import Flags, Longs, Stretch, few, may_meet, through_sphere
from emulator.world.broad_phase import KEPT, BroadPhase
from emulator.world.fed import Fed, FedNow
from emulator.world.motion import Motion
from emulator.world.placings import Placings
from emulator.world.triangles import Floats, Ints

NOWHERE = 0, 1, 0, 0
"A search that is never asked for."
NO_SPHERES: Floats = np.zeros((4, 0))
NEARBY_M = 0.1
"A sphere that is passed at this distance is looked at: no lens is larger."


@dataclass(eq=False)
class Near:
    """Fed ones of some bodies at the instants of some rays."""

    placings: Placings
    fed: Longs
    "(f,) which of the bodies."
    motions: list[Fed]
    place: Floats
    "(3, f) centres of spheres that hold those of the bodies meanwhile; (f,) their radii."
    swept: Floats
    exact: Flags
    "(f,) of the body's path; others are wider, and nothing was computed for them."
    base: Longs
    "(b,) column of each body's first instant in the table; -1: it has none."

    def fill(self, place: Floats, swept: Floats) -> None:
        """Put the spheres among those of all bodies."""
        place[:, self.fed], swept[self.fed] = self.place, self.swept

    def look(self, movers: Movers, met: Longs) -> bool:
        """Find out where those are that rays may meet; whether any of them was not known."""
        near = np.zeros(len(self.base), bool)
        near[met] = True
        fresh = indexes(near[self.fed] & ~self.exact)
        if not len(fresh):
            return False
        motions, which = [self.motions[number] for number in fresh], self.fed[fresh]
        self.place[:, fresh], self.swept[fresh] = self.placings.spheres(motions, movers.centre[:, which])
        self.base[which] = self.placings.rows(motions) * len(self.placings.t_s)
        self.exact[fresh] = True
        return True


@dataclass(frozen=True, eq=False)
class Bent:
    """Poses of bodies that do not move straight, for pairs of a body and a ray."""

    column: Longs
    "(k,) of each pair; -1: its body moves straight. (0,): all do."
    at: Floats
    "(3, c)"
    turned: Floats
    "(3, 3, c)"


NONE_BENT = Bent(np.zeros(0, np.int64), np.zeros((3, 0)), np.zeros((3, 3, 0)))
"All pairs are of bodies that move straight."


def _bent(
    movers: Movers, near: tuple[Near, Longs] | None, curved: Longs, which: Longs, rays: Longs, times: Floats
) -> Bent:
    if not len(curved):
        return NONE_BENT
    column, at, turned = np.full(len(which), -1), np.zeros((3, 0)), np.zeros((3, 3, 0))
    if near is not None:
        table, instant = near
        base = table.base.take(which)
        column = np.where(base >= 0, base + instant.take(rays), -1)
        at, turned = table.placings.at.reshape(3, -1), table.placings.turned.reshape(3, 3, -1)
        curved = curved[table.base[curved] < 0]
    parts = [(pairs, movers.batched.motions[mover]) for mover in curved if len(pairs := indexes(which == mover))]
    if not parts:
        return Bent(column, at, turned)
    pairs = np.concatenate([some for some, _ in parts])
    column[pairs] = at.shape[1] + np.arange(len(pairs))
    poses = [_poses(motion, times[rays[some]]) for some, motion in parts]
    at = np.concatenate([at, *(position.T for position, _ in poses)], axis=1)
    turned = np.concatenate([turned, *(rotation.transpose(1, 2, 0) for _, rotation in poses)], axis=2)
    return Bent(column, at, turned)


def _poses(motion: Motion, when: Floats) -> tuple[Floats, Floats]:
    """Positions (k, 3) and rotations (k, 3, 3) at instants."""
    if not isinstance(motion, Fed):
        return motion.position(when), np.broadcast_to(motion.rotation(when), (len(when), 3, 3))
    instants, number = np.unique(when, return_inverse=True)
    position, rotation = motion.found(instants)
    return position[number], rotation[number]


def _crossed_by_loops(
    loops: ModuleType, cast: MovingCast, movers: Movers, now: Stretch, bent: Bent, which: Longs, rays: Longs,
    origin: Floats, aim: Aim, times: Floats, far: float, known_m: Floats, into: Nearest | None,
) -> Met | None:  # fmt: skip
    """Where all bodies are rigid; what is met is put among the nearest at once, if these are given."""
    if not cast._packets:
        return OTHERWISE
    found = into
    if found is None or not all(column.flags.c_contiguous for column in found.written):
        found = Nearest(*loops.unwritten(len(aim)))
        found.range_m[:], found.triangle[:] = known_m, -1
    for number in np.unique(movers.structure) if len(cast._slots) > 1 else (0,):
        sent, wrong = loops.moving(
            *cast._slots[number].how, number, which, rays, origin, aim.ray, times, far,
            now.at, now.velocity, now.since, now.turned, movers.centre, movers.reach, movers.half, movers.cell,
            movers.shift, movers.structure, movers.body, bent.column, bent.at, bent.turned, cast._table.plane,
            embree.SUSPICIOUS, *found.written,
        )  # fmt: skip
        cast.counters.cast += sent
        cast.counters.suspicious += wrong
    if found is into:
        return None
    at = indexes(found.triangle >= 0)
    if not len(at):
        return None
    return Met(at, found.triangle[at], found.body[at], found.range_m[at], found.normal[:, at], found.facing[at])


class MovingCast:
    """The moving bodies of a scene."""

    def __init__(self, layout: Layout, counters: Counters) -> None:
        self.counters = counters
        self._all, self._table = layout.movers, layout.table
        self._slots = [embree.structure(content) for content in layout.slots]
        self._packets = embree.in_packets(self._slots) and not layout.frames
        self._slices = [Slices(frames, centre) for frames, centre in layout.frames]
        self._broad_phase = BroadPhase(self._all.batched.motions, self._all.reach + self._all.arm)
        self._kept: tuple[tuple[Longs, Movers], ...] = ()
        self._chosen: dict[tuple[int, ...], Movers] = {}
        "Of fed scenes: what has been there lately, the newest last."
        motions = self._all.batched.motions
        self._fed: FedNow | None = next((one.now for one in motions if isinstance(one, Fed)), None)
        "None: nobody moves any of them from outside."
        self._now: object = None
        "The world that what is kept holds for."
        self._nears: tuple[tuple[Movers, Near], ...] = ()
        self._slots_of: dict[str, list[int]] = {}
        "Actors that a feed may bring -> their bodies."
        for row, motion in enumerate(motions):
            if isinstance(motion, Fed) and motion.may_come:
                self._slots_of.setdefault(motion.name, []).append(row)
        may_come = {row for rows_ in self._slots_of.values() for row in rows_}
        self._lasting = [row for row in range(len(motions)) if row not in may_come]

    def __len__(self) -> int:
        return len(self._all.body)

    def sphere(self, times: Floats) -> tuple[Floats, float]:
        """Centre (3, 1) and radius of a sphere that holds all of them at these instants."""
        begin_s, end_s = float(times.min()), float(times.max())
        movers = self._all if self._fed is None else self._there(np.arange(len(self._all.body)))
        if not len(movers.body):
            return np.zeros((3, 1)), 0.0
        _, place, swept, curved = _whereabouts(movers, begin_s, end_s)
        if self._fed is not None and len(curved):
            near = self._looked(movers, times, curved)
            if near is not None:
                near[0].fill(place, swept)
            elif any(isinstance(movers.batched.motions[row], Fed) for row in curved):
                return place[:, :1], np.inf
        low = place.min(axis=1, keepdims=True)
        centre = low + (place.max(axis=1, keepdims=True) - low) / 2.0
        away = np.sqrt(((place - centre) ** 2).sum(axis=0))
        return centre, float((away + movers.reach + swept).max())

    def around(self, origin: Floats, times: Floats, far: float) -> tuple[Crossing, Floats]:
        """What a pass needs that casts itself on all that may come within reach of (3, m) at these instants; centres
        and radii (4, b) of spheres that hold those that it cannot cast on."""
        begin, end = float(times.min()), float(times.max())
        movers = self._near(*extent(origin), begin, end, far + NEARBY_M) if len(self) else self._all
        if not len(movers.body):
            return self._nothing, NO_SPHERES
        now, place, swept, curved = _whereabouts(movers, begin, end)
        if self._fed is not None and len(curved):
            near = self._looked(movers, times, curved)
            if near is None:
                swept[curved] = np.inf
            else:
                near[0].fill(place, swept)
        spheres = np.concatenate([place, (movers.reach + swept + NEARBY_M)[None]])
        if not self._packets or len(self._slots) != 1 or movers.scale is not None or len(curved):
            return self._nothing, spheres
        return Crossing(spheres, self._slots[0].how, _columns(movers, now)), NO_SPHERES

    @cached_property
    def _nothing(self) -> Crossing:
        """For a pass that casts on none of them."""
        return Crossing(NO_SPHERES, NOWHERE, _columns(self._all.chosen(np.zeros(0, np.int64))))

    def met(
        self,
        origin: Floats,
        aim: Aim,
        times: Floats,
        far: float,
        known_m: Floats,
        box: tuple[Floats, Floats] | None = None,
        into: Nearest | None = None,
    ) -> Met | None:
        """Each ray on the moving bodies whose spheres it meets before `known_m`, in their own frames.

        `into`: the nearest hits so far, whose ranges `known_m` are. Loops put what is nearer there, and None is left.
        """
        begin, end = float(times.min()), float(times.max())
        box = extent(origin) if box is None else box
        movers = self._near(*box, begin, end, far)
        if not len(movers.body):
            return None
        now = movers.batched.during(begin, end)
        if not len(now.curved) and (all_ := few(len(movers.body), aim.ray)) is not None:
            return self._cross(movers, now, NONE_BENT, *all_, origin, aim, times, far, known_m, into)
        now, place, swept, curved = _whereabouts(movers, begin, end)
        near = None if self._fed is None or not len(curved) else self._looked(movers, times, curved)
        if near is not None:
            near[0].fill(place, swept)
        cones = (lambda: aim.cones) if aim.lasts else None
        which, rays = may_meet(place, movers.reach + swept, box, aim.ray, far, known_m, cones)
        if near is not None and near[0].look(movers, which):
            near[0].fill(place, swept)
            which, rays = may_meet(place, movers.reach + swept, box, aim.ray, far, known_m, cones)
        if not len(which):
            return None
        bent = _bent(movers, near, curved, which, rays, times)
        return self._cross(movers, now, bent, which, rays, origin, aim, times, far, known_m, into)

    def _cross(
        self, movers: Movers, now: Stretch, bent: Bent, which: Longs, rays: Longs,
        origin: Floats, aim: Aim, times: Floats, far: float, known_m: Floats, into: Nearest | None,
    ) -> Met | None:  # fmt: skip
        crossed = self._crossed if movers.scale is None else partial(array_form(MovingCast._crossed), self)
        return crossed(movers, now, bent, which, rays, origin, aim, times, far, known_m, into)

    @by_loops(_crossed_by_loops, "moving")
    def _crossed(
        self, movers: Movers, now: Stretch, bent: Bent, which: Longs, rays: Longs,
        origin: Floats, aim: Aim, times: Floats, far: float, known_m: Floats, into: Nearest | None,
    ) -> Met | None:  # fmt: skip
        """Rays on the moving bodies that they may meet; arrays leave it to others to put hits among the nearest."""
        # the ray's origin seen from the body's first: large coordinates cancel there
        when = times.take(rays)
        offset = origin.take(rays, axis=1) - now.at.take(which, axis=1)
        offset -= (when - now.since.take(which)) * now.velocity.take(which, axis=1)
        turned = now.turned.take(which, axis=2)
        pairs = indexes(bent.column >= 0)
        if len(pairs):
            column = bent.column[pairs]
            offset[:, pairs] = origin.take(rays[pairs], axis=1) - bent.at.take(column, axis=1)
            turned[:, :, pairs] = bent.turned.take(column, axis=2)
        along = aim.ray.take(rays, axis=1)
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
        if movers.scale is not None:
            # the shape itself is met: range stays the parameter of the ray, whose direction is not of unit length there
            local, along, enter, leave = _in_shape(movers, which, local, along)
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
            return self._rigid(movers, passing)
        home = movers.structure[which]
        parts = [self._rigid(movers, passing.taken(indexes(home >= 0)))]
        for number in np.unique(home[home < 0]):
            parts.append(self._frames(movers, passing.taken(indexes(home == number)), times, -1 - number))
        return all_met([part for part in parts if part is not None])

    def _rigid(self, movers: Movers, near: Passing) -> Met | None:
        which, rays = near.which, near.rays
        if not len(which):
            return None
        start = rows(near.local + near.enter * near.along + movers.cell.take(which, axis=1))
        until = (near.leave - near.enter).astype(np.float32)
        number, span = self._run_slots(movers.structure[which], start, rows(near.along), until)
        hit = indexes(number >= 0)
        if not len(hit):
            return None
        which, rays = which[hit], rays[hit]
        triangle = number[hit] + movers.shift[which]
        range_m, normal, facing = embree.refined(
            self._table, self.counters, triangle, near.local[:, hit], near.along[:, hit], span[hit] + near.enter[hit]
        )
        if movers.scale is not None:
            normal = normal / movers.scale.take(which, axis=1)
            length = np.sqrt(np.einsum("ik,ik->k", normal, normal))
            normal, facing = normal / length, facing / length
        normal = np.einsum("ijk,jk->ik", near.turned[:, :, hit], normal)
        return Met(rays, triangle, movers.body[which], range_m, normal, facing)

    def _frames(self, movers: Movers, near: Passing, times: Floats, number: int) -> Met | None:
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

    def _near(self, low: Floats, high: Floats, begin_s: float, end_s: float, far: float) -> Movers:
        """Those that can come within reach; built again once a second, or where the sensor comes to another cell."""
        which = self._broad_phase.within(low, high, far, begin_s, end_s)
        if self._fed is not None:
            return self._there(which)
        if len(which) == len(self._all.body):
            return self._all
        for known, movers in self._kept:
            if known is which:
                return movers
        movers = self._all.chosen(which)
        self._kept = ((which, movers), *self._kept[: KEPT - 1])
        return movers

    def _there(self, which: Longs) -> Movers:
        """Those of them that are there in the present sweep, as large and fast as it says."""
        assert self._fed is not None
        if self._now is not self._fed.world:
            self._now, self._kept, self._nears = self._fed.world, (), ()
        for known, movers in self._kept:
            if known is which or (len(known) == len(which) and np.array_equal(known, which)):
                return movers
        motions = self._all.batched.motions
        come = [row for name in self._fed.names for row in self._slots_of.get(name, ())]
        wanted = np.zeros(len(motions), bool)
        wanted[which] = True
        found = [row for row in (*self._lasting, *come) if wanted[row]]
        found = sorted(row for row in found if not isinstance(each := motions[row], Fed) or each.there)
        movers = _as_fed(self._of(tuple(found)))
        self._kept = ((which, movers), *self._kept[: KEPT - 1])
        return movers

    def _of(self, rows_: tuple[int, ...]) -> Movers:
        """Some of them, the same again as long as the same ones are there."""
        found = self._chosen.pop(rows_, None)
        if found is None:
            while len(self._chosen) >= KEPT:
                del self._chosen[next(iter(self._chosen))]
            found = self._all.chosen(np.array(rows_, np.int64))
        self._chosen[rows_] = found
        return found

    def _looked(self, movers: Movers, times: Floats, curved: Longs) -> tuple[Near, Longs] | None:
        """What is known of fed ones at these times, of those that do not move straight, and the number of each time;
        None: they are too many, or there is none."""
        assert self._fed is not None
        motions = movers.batched.motions
        fed = np.array([row for row in curved if isinstance(motions[row], Fed)], np.int64)
        found = self._fed.placings(times) if len(fed) else None
        if found is None:
            return None
        placings, instant = found
        for known in self._nears:
            if known[0] is movers and known[1].placings is placings and np.array_equal(known[1].fed, fed):
                return known[1], instant
        mine = [motion for row in fed if isinstance(motion := motions[row], Fed)]
        place, radius = placings.around(mine)
        none = np.zeros(len(fed), bool)
        near = Near(placings, fed, mine, place, radius + movers.arm[fed], none, np.full(len(motions), -1))
        self._nears = ((movers, near), *self._nears[: KEPT - 1])
        return near, instant

    def _run_slots(self, home: Longs, start: Singles, along: Singles, until: Singles) -> tuple[Ints, Singles]:
        if len(self._slots) == 1:
            return embree.run(self._slots[0], start, along, until)
        number: Ints = np.full(len(home), MISS, np.int32)
        span = np.zeros(len(home), np.float32)
        for slots in np.unique(home):
            here = indexes(home == slots)
            number[here], span[here] = embree.run(self._slots[slots], start[here], along[here], until[here])
        return number, span


def _columns(movers: Movers, now: Stretch | None = None) -> tuple[Floats | Longs, ...]:
    """What `compiled.moving` wants of them."""
    now = movers.batched.during(0.0, 0.0) if now is None else now
    return (
        now.at, now.velocity, now.since, now.turned, movers.centre, movers.reach, movers.half, movers.cell,
        movers.shift, movers.structure, movers.body,
    )  # fmt: skip


def _as_fed(movers: Movers) -> Movers:
    """Sizes as the present sweep has them."""
    motions = enumerate(movers.batched.motions)
    fed = [(row, motion) for row, motion in motions if isinstance(motion, Fed) and motion.may_come]
    if not fed:  # none but those of a pool are scaled
        return movers
    scale = np.ones((3, len(movers.body)))
    for row, motion in fed:
        scale[:, row] = motion.scale
    if not bool((scale != 1.0).any()):
        return movers
    centre = movers.centre * scale
    arm = np.sqrt(np.einsum("ib,ib->b", centre, centre))
    return replace(
        movers, arm=arm, centre=centre, reach=movers.reach * scale.max(axis=0), scale=scale, shape_reach=movers.reach
    )


def _in_shape(movers: Movers, which: Longs, local: Floats, along: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Origins and directions (3, k) in the frames of scaled shapes, and where the rays are in their spheres."""
    assert movers.scale is not None
    assert movers.shape_reach is not None
    scale = movers.scale.take(which, axis=1)
    local, along = local / scale, along / scale
    length = np.sqrt(np.einsum("ik,ik->k", along, along))
    enter, leave, _ = through_sphere(local, along / length, movers.shape_reach.take(which))
    return local, along, enter / length, leave / length


def _straight(now: Stretch, centre: Floats, begin: float, end: float) -> tuple[Floats, Floats]:
    """Centres (3, b) in the middle of a stretch, and how far they come from there, of bodies that move straight."""
    place = now.at + (begin + (end - begin) / 2.0 - now.since) * now.velocity
    place += np.einsum("ijb,jb->ib", now.turned, centre)
    return place, np.sqrt(np.einsum("ib,ib->b", now.velocity, now.velocity)) * ((end - begin) / 2.0)


def _whereabouts(movers: Movers, begin: float, end: float) -> tuple[Stretch, Floats, Floats, Longs]:
    """Motions from `begin` to `end`; centres (3, b), how far they may be from there, and which do not move straight."""
    now, middle = movers.batched.during(begin, end), begin + (end - begin) / 2.0
    place, swept = _straight(now, movers.centre, begin, end)
    curved = now.curved
    if len(curved):  # anywhere around where the body's origin is, as far as it can have come
        for mover in curved:
            motion = movers.batched.motions[mover]
            if not isinstance(motion, Fed):  # of those it is known all at once
                place[:, mover] = motion.position(np.array([middle]))[0]
        swept[curved] = movers.arm[curved] + (movers.speed[curved] * ((end - begin) / 2.0) if end > begin else 0.0)
    return now, place, swept, curved


def _may_cross(origin: Floats, ray: Floats, half: Floats) -> Flags:
    """Rays (3, k) whose lines may meet boxes of these half sides about (0, 0, 0)."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        each = 1.0 / ray
        middle, wide = origin * each, np.abs(each) * half
        # a ray along a side gives NaN there, which excludes nothing
        outside = np.fmax.reduce(-wide - middle, axis=0) > np.fmin.reduce(wide - middle, axis=0)
    return np.asarray(~outside)
