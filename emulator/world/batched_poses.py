"""Many motions at once: where bodies are during a short time, as straight lines, without a call for each of them.

Belongs here: looking up the stretch of each motion, finding pairs of moving spheres and rays that may meet. Not: single
motions (motion), meeting triangles (raycast). Vectors are (3, n): one long row a coordinate is what numpy is fast at.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from emulator.compiled.pair import OTHERWISE, by_loops
from emulator.physics.arrays import clamped, indexes
from emulator.world.fed import Fed
from emulator.world.fed_straight import Straights, StraightsNow
from emulator.world.motion import Floats, Motion, Steady, Waypoints, matrix_of, whole_turns

Longs = NDArray[np.int64]
Flags = NDArray[np.bool_]

CHUNK = 8
"Least number of neighbouring rays that are tested as one cone."
MOST_CHUNKS = 512
REMEMBER_S = 1e-9
"A stretch is looked up again so long before its end, and as a share of the time."
ROUNDING = 1e-9
"Of cosines: far more than their rounding, and 4e-5 rad about the middle of a distant sphere."
MANY = 4096
"So many pairs are looked at once more, ray by ray, before anything is computed of them."
DIRECT = 1024
"So few pairs are not worth a first choice."


@dataclass(frozen=True, eq=False)
class Stretch:
    """Motions during a time in which most of them are straight: position = at + velocity (t - since)."""

    at: Floats
    "(3, b)"
    velocity: Floats
    "(3, b)"
    since: Floats
    "(b,)"
    turned: Floats
    "(3, 3, b) orientation, body to world."
    straight: Flags
    "(b,) all of this holds through the whole time; the others pass a waypoint, jump or turn in it."
    linear: Flags
    "(b,) position holds through the whole time, whether they turn or not."

    @cached_property
    def curved(self) -> Longs:
        """Those that are not straight."""
        return indexes(~self.straight)


class BatchedPoses:
    """The motions of b bodies."""

    def __init__(self, motions: Sequence[Motion]) -> None:
        self.motions = tuple(motions)
        knots = [_knots(motion) for motion in self.motions]
        sizes = [len(one.time) for one in knots]
        self._starts = np.cumsum([0, *sizes])[:-1]
        self._sizes = np.array(sizes, np.int64)
        self._time = np.concatenate([np.zeros(0), *(one.time for one in knots)])
        self._until = np.concatenate([np.zeros(0), *(one.until for one in knots)])
        self._at = np.concatenate([np.zeros((3, 0)), *(one.at.T for one in knots)], axis=1)
        self._velocity = np.concatenate([np.zeros((3, 0)), *(one.velocity.T for one in knots)], axis=1)
        rotation = np.concatenate([np.zeros((0, 3, 3)), *(one.rotation for one in knots)])
        self._turned = np.ascontiguousarray(rotation.transpose(1, 2, 0))
        self._steady_turn = np.concatenate([np.zeros(0, bool), *(one.straight for one in knots)])
        self._first = np.array([one.loop[0] for one in knots], np.float64)
        self._span = np.array([one.loop[1] for one in knots], np.float64)
        self._loops = indexes(self._span > 0.0)
        ever = Stretch(self._at, self._velocity, self._time, self._turned, self._steady_turn, np.isposinf(self._until))
        self._last = (np.inf, -np.inf, ever)
        "From when to when the stretch last found holds."
        if bool((self._sizes == 1).all()):
            self._last = (-np.inf, np.inf, self._last[2])
        fed = [number for number, motion in enumerate(self.motions) if isinstance(motion, Fed)]
        self._fed = _FedNow(self.motions, fed) if fed else None

    def during(self, begin_s: float, end_s: float) -> Stretch:
        """All motions from `begin_s` to `end_s`; of those that are fed as the present sweep has them."""
        found = self.lasting(begin_s, end_s)
        return found if self._fed is None else self._fed.shown(found, begin_s, end_s)

    def lasting(self, begin_s: float, end_s: float) -> Stretch:
        """The same of what holds in any sweep: those that are fed may be anywhere."""
        valid_from, valid_until, known = self._last
        if valid_from <= begin_s and end_s < valid_until:
            return known
        # whole turns of a loop are counted, so that the same instant gives the same bits whenever it is asked for
        passed_s = np.zeros(len(self.motions))
        passed_s[self._loops] = whole_turns(begin_s, self._first[self._loops], self._span[self._loops])
        local = begin_s - passed_s
        passed = np.add.reduceat(self._time <= local.repeat(self._sizes), self._starts, dtype=np.int64)
        knot = self._starts + np.maximum(passed - 1, 0)
        time = self._time[knot]
        since = np.where(np.isfinite(time), passed_s + time, 0.0)
        left = self._until[knot] - local
        linear = end_s - begin_s < left
        straight = self._steady_turn[knot] & linear
        at, velocity, turned = (column.take(knot, axis=-1) for column in (self._at, self._velocity, self._turned))
        found = Stretch(at, velocity, since, turned, straight, linear)
        # not to the last instant: what rounds there must not depend on what was asked before
        # a motion that is never straight ends no stretch
        left = left[left > -np.inf]
        until = begin_s + float(left.min(initial=np.inf)) - REMEMBER_S * (1.0 + abs(begin_s))
        if end_s < until:
            self._last = (begin_s, until, found)
        return found


class _FedNow:
    """Those of the motions that are fed and move straight in the present sweep."""

    def __init__(self, motions: Sequence[Motion], fed: Sequence[int]) -> None:
        self._numbers = np.array(fed, np.int64)
        self._straights = StraightsNow([motion for number in fed if isinstance(motion := motions[number], Fed)])
        self._known: Straights | None = None
        self._last: tuple[Stretch | None, float, float, Stretch | None] = (None, np.inf, -np.inf, None)
        "What was shown last, and of what and from when to when that holds."

    def shown(self, base: Stretch, begin_s: float, end_s: float) -> Stretch:
        """All motions, these as they are now."""
        found = self._straights.found
        if found is not self._known:
            self._known, self._last = found, (None, np.inf, -np.inf, None)
        if not len(found.rows):
            return base
        known, valid_from, valid_until, made = self._last
        if made is not None and known is base and valid_from <= begin_s and end_s < valid_until:
            return made
        holds = (found.from_s <= begin_s) & (end_s < found.until_s)
        rows, mine = self._numbers[found.rows[holds]], indexes(holds)
        at, velocity, since = base.at.copy(), base.velocity.copy(), base.since.copy()
        turned, straight, linear = base.turned.copy(), base.straight.copy(), base.linear.copy()
        at[:, rows], velocity[:, rows], since[rows] = (
            found.at_m[mine].T,
            found.velocity_m_s[mine].T,
            found.since_s[mine],
        )
        turned[:, :, rows], straight[rows], linear[rows] = found.rotation[mine].transpose(1, 2, 0), True, True
        made = Stretch(at, velocity, since, turned, straight, linear)
        if bool(holds.all()):
            self._last = (base, float(found.from_s.max()), float(found.until_s.min()), made)
        return made


@dataclass(frozen=True, eq=False)
class _Knots:
    """One motion as stretches: each begins at `time` and ends at `until`."""

    time: Floats
    until: Floats
    at: Floats
    velocity: Floats
    rotation: Floats
    straight: Flags
    loop: tuple[float, float] = (0.0, 0.0)
    "First time and span of a loop; span 0: none."


def _knots(motion: Motion) -> _Knots:
    zero, ever = np.zeros(1), np.full(1, np.inf)
    if isinstance(motion, Fed):  # never straight: what it is depends on the sweep
        nowhere, turned = np.zeros((1, 3)), np.eye(3)[None]
        return _Knots(zero, -ever, nowhere, nowhere, turned, np.zeros(1, bool))
    if isinstance(motion, Steady) or motion.still:
        still = np.array([not motion.turns])
        return _Knots(zero, ever, motion.position(zero), motion.velocity(zero), motion.rotation(zero)[:1], still)
    if not isinstance(motion, Waypoints):
        return _Knots(zero, ever, motion.position(zero), motion.velocity(zero), motion.rotation(zero)[:1], zero > 0.0)
    rotation = matrix_of(motion.quaternion)
    return _Knots(
        np.concatenate([-ever, motion.t_s]),
        np.concatenate([motion.t_s, ever]),
        np.concatenate([motion.at_m[:1], motion.at_m]),
        np.concatenate([np.zeros((1, 3)), motion.velocity(motion.t_s[:-1]), np.zeros((1, 3))]),
        np.concatenate([rotation[:1], rotation]),
        np.concatenate([[True], motion.turning == 0.0, [True]]),
        (float(motion.t_s[0]), float(motion.t_s[-1] - motion.t_s[0])) if motion.loop else (0.0, 0.0),
    )


# ---------------------------------------------------------------- spheres and rays


def through_sphere(origin: Floats, ray: Floats, reach: Floats | float) -> tuple[Floats, Floats, Flags]:
    """Where rays enter (>= 0) and leave a sphere of radius `reach` about (0, 0, 0), and whether they meet it.

    `origin`, `ray` : (3, k), `reach` : (k,) or one number.
    """
    middle = -np.einsum("ik,ik->k", origin, ray)
    # distance of the line by its perpendicular: the difference of squares loses digits far away
    across = origin + middle * ray
    chord = reach * reach - np.einsum("ik,ik->k", across, across)
    half = np.sqrt(np.maximum(chord, 0.0))
    leave = middle + half
    return np.maximum(middle - half, 0.0), leave, (chord > 0.0) & (leave > 0.0)


@dataclass(frozen=True, eq=False)
class Cones:
    """Neighbouring rays of m, `size` to each of c cones, the last of them as many times as there is room."""

    size: int
    axis: Floats
    "(3, c) unit."
    half: Floats
    "(c,) [rad]"

    @classmethod
    def of(cls, ray: Floats) -> Cones:
        """Around the rays (3, m)."""
        count = ray.shape[1]
        size = _neighbours(count)
        chunks = -(-count // size)
        if chunks * size != count:
            ray = ray.take(np.minimum(np.arange(chunks * size), count - 1), axis=1)
        ray = ray.reshape(3, chunks, size)
        axis = ray.sum(axis=2)
        axis /= np.maximum(np.sqrt(np.einsum("ic,ic->c", axis, axis)), 1e-30)
        half = np.arccos(clamped(np.einsum("ics,ic->cs", ray, axis).min(axis=1), -1.0, 1.0)) + 1e-6
        return cls(size, axis, half)

    def most(self, values: Floats) -> Floats:
        """(c,) largest of the values (m,) of the rays in each."""
        return np.maximum.reduceat(values, np.arange(0, len(values), self.size))


def _neighbours(rays: int) -> int:
    """How many of them a cone has."""
    return max(CHUNK, -(-rays // MOST_CHUNKS))


def _may_meet_by_loops(
    loops: ModuleType,
    centre: Floats,
    reach: Floats,
    box: tuple[Floats, Floats],
    ray: Floats,
    far: float,
    known_m: Floats,
    cones: Callable[[], Cones] | None,
) -> tuple[Longs, Longs]:
    if len(reach) * ray.shape[1] <= DIRECT:
        return _all_pairs(len(reach), ray.shape[1])
    spheres = loops.near(centre, reach, *box, far)
    if not spheres:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    size = _neighbours(ray.shape[1])
    axis, half = loops.cones(ray, size) if cones is None else (cones().axis, cones().half)
    if spheres * len(half) > 4 * MANY:
        return OTHERWISE
    which, rays = loops.pairs(centre, reach, *box, far, axis, half, size, known_m, ROUNDING)
    return which, rays


@lru_cache(maxsize=256)
def _all_pairs(spheres: int, rays: int) -> tuple[Longs, Longs]:
    which, each = np.arange(spheres).repeat(rays), np.tile(np.arange(rays), spheres)
    which.flags.writeable = each.flags.writeable = False
    return which, each


def few(spheres: int, ray: Floats) -> tuple[Longs, Longs] | None:
    """All pairs, where so few of them are not worth a first choice by `may_meet`; None: they are."""
    count = ray.shape[1]
    return _all_pairs(spheres, count) if spheres * count <= DIRECT else None


@by_loops(_may_meet_by_loops, "near", "cones", "pairs")
def may_meet(
    centre: Floats,
    reach: Floats,
    box: tuple[Floats, Floats],
    ray: Floats,
    far: float,
    known_m: Floats,
    cones: Callable[[], Cones] | None,
) -> tuple[Longs, Longs]:
    """Pairs of a sphere and a ray that may meet before `known_m`; neighbouring rays are tested together, as a cone.

    `centre` : (3, b), `reach` : (b,), `box` : least and largest origin of the rays, each (3,), `ray` : (3, m), `far` :
    largest range of all of them, `known_m` : (m,) of each, `cones` : those around these rays, where they are kept.
    Some of the pairs do not meet; none that do is missing.
    """
    count = ray.shape[1]
    if len(reach) * count <= DIRECT:
        return _all_pairs(len(reach), count)
    low, high = box
    eye = low + (high - low) / 2.0
    reach = reach + float(np.linalg.norm(high - eye))
    view = centre - eye[:, None]
    away = np.sqrt(np.einsum("ib,ib->b", view, view))
    near = indexes(away - reach <= far)
    if not len(near):
        return near, near
    view, away, reach = view.take(near, axis=1), away[near], reach[near]
    inside = away <= reach
    view = view / np.where(inside, 1.0, away)
    width = np.where(inside, np.pi, np.arcsin(np.minimum(reach / np.where(inside, 1.0, away), 1.0)))
    around = Cones.of(ray) if cones is None else cones()
    size = around.size
    sphere, chunk = _in_cones(view, width, around.axis, around.half)
    before = indexes((away - reach).take(sphere) <= around.most(known_m).take(chunk))
    sphere, chunk = sphere.take(before), chunk.take(before)
    rays = (chunk[:, None] * size + np.arange(size)).ravel()
    which = sphere.repeat(size)
    if len(around.half) * size != count:
        real = rays < count
        which, rays = which[real], rays[real]
    if len(which) > MANY:
        towards = np.einsum("ik,ik->k", view.take(which, axis=1), ray.take(rays, axis=1))
        kept = indexes((towards >= np.cos(width).take(which) - ROUNDING) | inside.take(which))
        which, rays = which[kept], rays[kept]
    return near[which], rays


def _in_cones(view: Floats, width: Floats, axis: Floats, half: Floats) -> tuple[Longs, Longs]:
    """Pairs of spheres, seen in directions `view` (3, b) under half angles `width`, and of cones that they touch.

    Many cones are first put together to wider ones.
    """
    count = len(half)
    if len(width) * count <= 4 * MANY or count < 9:
        return _touching(view, width, axis, half)
    size = int(np.ceil(np.sqrt(count)))
    groups = -(-count // size)
    member = np.minimum(np.arange(groups * size), count - 1).reshape(groups, size)
    middle = axis[:, member].sum(axis=2)
    middle /= np.maximum(np.sqrt(np.einsum("ig,ig->g", middle, middle)), 1e-30)
    off = np.arccos(clamped(np.einsum("igs,ig->gs", axis[:, member], middle), -1.0, 1.0))
    wide, group = _touching(view, width, middle, (off + half[member]).max(axis=1) + 1e-6)
    chunk = (group[:, None] * size + np.arange(size)).ravel()
    sphere = wide.repeat(size)
    real = indexes(chunk < count)
    sphere, chunk = sphere[real], chunk[real]
    angle = width.take(sphere) + half.take(chunk)
    towards = np.einsum("ik,ik->k", view.take(sphere, axis=1), axis.take(chunk, axis=1))
    kept = indexes(towards >= np.cos(np.minimum(angle, np.pi)) - ROUNDING)
    return sphere[kept], chunk[kept]


def _touching(view: Floats, width: Floats, axis: Floats, half: Floats) -> tuple[Longs, Longs]:
    """The same, each with each: cosines instead of angles, where their sums are less than half a turn."""
    least = np.multiply.outer(np.cos(width), np.cos(half)) - np.multiply.outer(np.sin(width), np.sin(half))
    touch = (view.T @ axis >= least - ROUNDING) | (np.add.outer(width, half) >= np.pi)
    sphere, cone = np.nonzero(touch)
    return sphere, cone
