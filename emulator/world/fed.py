"""Motions that come from a feed: what a sweep was given of them, else the scenario's own.

Belongs here: tracks of `live` as motions of bodies and of what sensors are mounted on. Not: tracks themselves (live),
who hands them over (runtime).

All motions of one scene read one `FedNow`, which is set before each sweep.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from emulator.live.tracks import NOTHING, Described, Track, World
from emulator.world.fed_straight import Straight, Straights, StraightsNow
from emulator.world.motion import Floats, Motion, Pose, Steady, Vector, matrix_of
from emulator.world.placings import MARGIN_M, Bounds, Longs, Placings

NOWHERE_M = 1e8
"Where something is that is not there: beyond the reach of any beam."
MOST_AT_ONCE = 4096
"Instants that poses of all actors are kept of."
KEPT = 8
STEP_S = 1e-4
"Velocities are differences over twice so long."


@dataclass(eq=False)
class FedNow:
    """What the present sweep knows of fed actors."""

    world: World = NOTHING
    categories: Mapping[str, str] = field(default_factory=dict)
    "The feeder's classes -> those of object lists."
    _placings: list[Placings] = field(default_factory=list)
    "The one used last first."
    _bounds: Bounds | None = None
    _numbers: dict[str, list[int]] = field(default_factory=dict)
    _named: tuple[str, ...] = ()
    "What `_numbers` is of."
    _turned: tuple[Floats, Floats] | None = None
    "First orientations of all tracks: quaternions and matrices."
    _straights: dict[tuple[Motion, ...], StraightsNow] = field(default_factory=dict)
    _fresh: bool = True
    "`_turned` is not of this world yet."

    def use(self, world: World) -> None:
        """From now on these."""
        if world is self.world:
            return
        self.world, self._placings, self._bounds, self._fresh = world, [], None, True
        if world.names != self._named:
            self._named, self._numbers = world.names, {}
            for number, name in enumerate(world.names):
                self._numbers.setdefault(name, []).append(number)

    @property
    def first_turns(self) -> Floats:
        """(m, 3, 3) how each track of the world, which has some, is turned at its first sample."""
        if self._turned is None or self._fresh:
            first = self.world.natures.first_quaternion
            # most actors are turned as they were in the sweep before
            if self._turned is None or not np.array_equal(first, self._turned[0]):
                self._turned = first, matrix_of(first)
            self._fresh = False
        return self._turned[1]

    def straights(self, motions: Sequence[Fed]) -> Straights:
        """Which of these, at least one, are straight in the present sweep."""
        key = tuple(motions)
        known = self._straights.get(key)
        if known is None:
            while len(self._straights) >= KEPT:
                del self._straights[next(iter(self._straights))]
            known = self._straights[key] = StraightsNow(motions)
        return known.found

    def straight(self, number: int, offset: Vector) -> Straight | None:
        """How a point of one track's body moves, where that is straight: `offset` from its reference point."""
        known = self.world.natures
        if not known.straight[number]:
            return None
        begin, end = self.world.straight_s
        rotation, at = self.first_turns[number], known.first_at_m[number]
        at = at + rotation @ np.array(offset) if any(offset) else at
        since, times = float(known.first_s[number]), (float(begin[number]), float(end[number]))
        return Straight(at, known.velocity_m_s[number], since, rotation, *times)

    @property
    def has_spawned(self) -> bool:
        """Some actor is there that is not in the scenario."""
        return any(shape for _, _, _, shape, _ in self.world.described)

    @property
    def names(self) -> Iterable[str]:
        """Actors that are fed in the present sweep."""
        return self._numbers

    def numbers(self, name: str) -> list[int]:
        """Which of the world's tracks are lives of an actor, in their order."""
        return self._numbers.get(name, [])

    def of(self, name: str) -> list[Track]:
        """Lives of an actor, in their order."""
        self.world.look()
        return [self.world.tracks[number][1] for number in self.numbers(name)]

    def category(self, name: str) -> str:
        """What an actor of a pool is, for object lists."""
        for number in reversed(self.numbers(name)):
            *_, shape, class_ = self.world.described[number]
            for word in (class_, shape):
                if word in self.categories:
                    return self.categories[word]
        return "unknown"

    def placings(self, times: Floats) -> tuple[Placings, Longs] | None:
        """Where bodies are at `times` (r,), and the number of each of them there; None: they are too many."""
        for number, known in enumerate(self._placings):
            if (index := known.index(times)) is not None:
                if number:
                    self._placings.insert(0, self._placings.pop(number))
                return known, index
        instants = np.unique(times)
        if len(instants) > MOST_AT_ONCE:
            return None
        if self._bounds is None:
            self._bounds = Bounds(self.world)
        found = Placings(self._bounds, instants)
        self._placings = [found, *self._placings[: KEPT - 1]]
        index = found.index(times)
        assert index is not None
        return found, index


def around(motions: Sequence[Fed], times: Floats) -> tuple[Floats, Floats]:
    """Centres (3, k) and radii (k,) of spheres that hold their origins at all instants; infinite: it is not known."""
    begin, end = float(times.min()), float(times.max())
    middle, radius = np.zeros((3, len(motions))), np.full(len(motions), np.inf)
    found = motions[0].now.straights(motions) if len(motions) else None
    if found is None:
        return middle, radius
    holds = (found.from_s <= begin) & (end < found.until_s)
    rows, velocity = found.rows[holds], found.velocity_m_s[holds]
    middle[:, rows] = (found.at_m[holds] + (0.5 * (begin + end) - found.since_s[holds])[:, None] * velocity).T
    way = np.sqrt(np.einsum("ki,ki->k", velocity, velocity)) * 0.5 * (end - begin)
    radius[rows] = way * (1.0 + MARGIN_M) + MARGIN_M
    others = np.flatnonzero(np.isinf(radius)).tolist()
    placed = motions[others[0]].now.placings(times) if others else None
    if placed is not None:
        middle[:, others], radius[others] = placed[0].around([motions[number] for number in others])
    return middle, radius


@dataclass(frozen=True, eq=False)
class Box:
    """The box of an actor's shape about its own origin: from which points of it feeders count."""

    middle_m: Vector = (0.0, 0.0, 0.0)
    half_m: Vector = (0.0, 0.0, 0.0)

    @classmethod
    def around(cls, vertices: Floats) -> Box:
        """Of points (v, 3)."""
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        return cls(tuple((low + (high - low) / 2.0).tolist()), tuple(((high - low) / 2.0).tolist()))


class Fed(Motion):
    """Of one actor, or of one of the shapes that an actor of a pool may have."""

    def __init__(
        self, now: FedNow, name: str, own: Motion | None, box: Box | None, shape: str = "", mount: str = "origin"
    ) -> None:
        """`own`: where nobody feeds it; None: then it is not there. `box`: None where it has no shape.

        `shape`: it is there only while the actor has this one. `mount`: `rear_axle` where what is mounted on the actor
        counts from there, if the feeder says where that is.
        """
        self.now, self.name, self._own, self._box = now, name, own, box
        self._shape, self._mount = shape, mount
        self._known: tuple[World, list[int]] | None = None
        "Which tracks of the present sweep are its own."
        self._straight: tuple[World | None, Straight | None] = (None, None)
        self._offsets: tuple[object, Vector] = (None, (0.0, 0.0, 0.0))
        "The latest, and what it was made from."

    @property
    def still(self) -> bool:
        return False

    @property
    def turns(self) -> bool:
        return True

    @property
    def may_come(self) -> bool:
        return bool(self._shape)

    @property
    def there(self) -> bool:
        """It may be met in the present sweep."""
        return bool(self.numbers) or (self._own is not None and self.name not in self.now.world.gone)

    @property
    def scale(self) -> Vector:
        """Of its shape along its axes, in the present sweep."""
        mine = self.numbers if self._shape and self._box is not None else []
        size = self.now.world.described[mine[-1]][2] if mine else None
        if size is None or self._box is None:
            return (1.0, 1.0, 1.0)
        # a shape that has no height is not made higher
        return tuple(
            wanted / (2.0 * half) if wanted > 0.0 and half > 0.0 else 1.0
            for wanted, half in zip(size, self._box.half_m, strict=True)
        )  # type: ignore[return-value]

    @property
    def speed_bound_m_s(self) -> float:
        return math.inf

    @property
    def offset(self) -> Vector:
        """From the feeder's reference point to the origin, in the body's axes, where one track is all it has."""
        return self._offset(self.now.world.described[self.numbers[0]])

    @property
    def straight(self) -> Straight | None:
        """How it moves in the present sweep; None: not straight, or there is more to it."""
        if self._straight[0] is not self.now.world:
            self._straight = self.now.world, self._straight_of(self.numbers)
        return self._straight[1]

    def straight_at(self, times: Floats) -> Straight | None:
        """The same if it holds at all of these instants."""
        one = self.straight
        return one if one is not None and len(times) and one.holds(float(times.min()), float(times.max())) else None

    def _straight_of(self, mine: list[int]) -> Straight | None:
        if (one := self.own_straight) is not None:
            return one
        return self.now.straight(mine[0], self.offset) if len(mine) == 1 else None

    @property
    def own_straight(self) -> Straight | None:
        """Its own motion, where nobody has fed it yet and that is straight for ever."""
        own = self._own
        if not isinstance(own, Steady) or own.turns or self.numbers or self.name in self.now.world.gone:
            return None
        zero = np.zeros(1)
        placed = own.position(zero)[0], own.velocity(zero)[0], 0.0, own.rotation(zero)[0]
        return Straight(*placed, -math.inf, math.inf)

    def whole_track(self, times: Floats) -> Track | None:
        """The only one that it has at all of these instants, ascending; None: there is more to it."""
        tracks = self._mine()
        if len(tracks) != 1 or not len(times) or tracks[0].comes_back:
            return None
        return tracks[0] if tracks[0].is_there(float(times[0]), float(times[-1])) else None

    @property
    def present(self) -> FedNow:
        """What is known of the present sweep."""
        return self.now

    @property
    def numbers(self) -> list[int]:
        """Which tracks of the present sweep are its own."""
        if self._known is None or self._known[0] is not self.now.world:
            mine = self.now.numbers(self.name)
            if self._shape:
                mine = [number for number in mine if self.now.world.described[number][3] == self._shape]
            self._known = self.now.world, mine
        return self._known[1]

    def _mine(self) -> list[Track]:
        self.now.world.look()
        return [self.now.world.tracks[number][1] for number in self.numbers]

    def _offset(self, described: Described) -> Vector:
        """From the feeder's reference point to the origin (or the mount), in the body's axes."""
        made_from = described, self.scale if self._shape else None
        if self._offsets[0] != made_from:
            self._offsets = made_from, self._offset_of(described)
        return self._offsets[1]

    def _offset_of(self, described: Described) -> Vector:
        reference, rear, size, _, _ = described
        if self._box is not None:
            scale = self.scale
            middle = tuple(a * s for a, s in zip(self._box.middle_m, scale, strict=True))
            half = tuple(a * s for a, s in zip(self._box.half_m, scale, strict=True))
        else:
            size = size or (0.0, 0.0, 0.0)
            half = (size[0] / 2.0, size[1] / 2.0, size[2] / 2.0)
            middle = (0.0, 0.0, half[2])  # its origin is on the ground
        if reference == "origin":
            centre = middle
        elif reference == "ground":
            centre = (0.0, 0.0, half[2])
        elif reference == "rear_axle":
            rear = rear or (-0.28 * 2.0 * half[0], 0.0, 0.3 - half[2])
            centre = (-rear[0], -rear[1], -rear[2])
        else:
            centre = (0.0, 0.0, 0.0)
        if self._mount == "rear_axle" and rear is not None:
            return (centre[0] + rear[0], centre[1] + rear[1], centre[2] + rear[2])
        return (centre[0] - middle[0], centre[1] - middle[1], centre[2] - middle[2])

    def _at(self, t_s: Floats) -> tuple[Floats, Floats]:
        """Positions (n, 3) and rotations (n, 3, 3)."""
        times = np.asarray(t_s, dtype=np.float64)
        if (one := self.straight_at(times)) is not None:
            return one.position(times), np.broadcast_to(one.rotation, (len(times), 3, 3))
        found = self.now.placings(times) if len(times) > 1 else None
        if found is None:
            return self.found(times)
        placings, index = found
        row = int(placings.rows([self])[0])
        return placings.at[:, row, index].T, placings.turned[:, :, row, index].transpose(2, 0, 1)

    def found(self, times: Floats) -> tuple[Floats, Floats]:
        """The same of it alone, whatever is known."""
        tracks = self._mine()
        if len(tracks) == 1 and bool(tracks[0].there(times).all()):
            return self._on(tracks[0], times)
        position = np.full((len(times), 3), NOWHERE_M)
        rotation = np.zeros((len(times), 3, 3))
        rotation[:] = np.eye(3)
        free = np.ones(len(times), bool)
        for track in tracks:
            rows = np.flatnonzero(track.there(times))
            if len(rows):
                position[rows], rotation[rows] = self._on(track, times[rows])
            free &= times < track.t_s[0] if track.begins else False
        if self._own is not None and self.name not in self.now.world.gone and free.any():
            rows = np.flatnonzero(free)
            pose = self._own.pose(times[rows])
            position[rows], rotation[rows] = pose.position_m, pose.rotation
        return position, rotation

    def _on(self, track: Track, times: Floats) -> tuple[Floats, Floats]:
        at, quaternion = track.pose(times)
        rotation = matrix_of(quaternion)
        told = track.reference, track.rear_m, track.size_m, track.shape, track.class_
        return at + np.einsum("nij,j->ni", rotation, np.array(self._offset(told))), rotation

    def pose(self, t_s: Floats) -> Pose:
        return Pose(*self._at(np.atleast_1d(np.asarray(t_s, dtype=np.float64))))

    def position(self, t_s: Floats) -> Floats:
        return self._at(t_s)[0]

    def rotation(self, t_s: Floats) -> Floats:
        return self._at(t_s)[1]

    def velocity(self, t_s: Floats) -> Floats:
        times = np.asarray(t_s, dtype=np.float64)
        return np.asarray((self._at(times + STEP_S)[0] - self._at(times - STEP_S)[0]) / (2.0 * STEP_S))
