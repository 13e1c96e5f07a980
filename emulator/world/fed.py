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

from emulator.live.tracks import NOTHING, Track, World, look_at
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
    _tracks: dict[str, list[Track]] = field(default_factory=dict)
    _placings: list[Placings] = field(default_factory=list)
    "The one used last first."
    _bounds: Bounds | None = None
    _turns: dict[int, Floats] | None = None

    def use(self, world: World) -> None:
        """From now on these."""
        if world is self.world:
            return
        self.world, self._tracks, self._placings, self._bounds = world, {}, [], None
        self._turns = None
        for name, track in world.tracks:
            self._tracks.setdefault(name, []).append(track)

    def look(self) -> None:
        """Find out at once what kind of motions these are."""
        if self._turns is None:
            tracks = [track for _, track in self.world.tracks]
            look_at(tracks, self.world.columns if tracks else None)
            first = matrix_of(np.array([track.quaternion[0] for track in tracks]).reshape(-1, 4))
            self._turns = {id(track): matrix for track, matrix in zip(tracks, first, strict=True)}

    def first_turn(self, track: Track) -> Floats:
        """(3, 3) how one of these tracks is turned at its first sample."""
        self.look()
        assert self._turns is not None
        return self._turns[id(track)]

    @property
    def has_spawned(self) -> bool:
        """Some actor is there that is not in the scenario."""
        return any(track.shape for _, track in self.world.tracks)

    @property
    def names(self) -> Iterable[str]:
        """Actors that are fed in the present sweep."""
        return self._tracks

    def of(self, name: str) -> list[Track]:
        """Lives of an actor, in their order."""
        return self._tracks.get(name, [])

    def category(self, name: str) -> str:
        """What an actor of a pool is, for object lists."""
        for track in reversed(self.of(name)):
            for word in (track.class_, track.shape):
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
    others = []
    for number, motion in enumerate(motions):
        one = motion.straight
        if one is None or not one.holds(begin, end):
            others.append(number)
            continue
        middle[:, number] = one.at_m + (0.5 * (begin + end) - one.since_s) * one.velocity_m_s
        radius[number] = math.hypot(*one.velocity_m_s) * 0.5 * (end - begin) * (1.0 + MARGIN_M) + MARGIN_M
    found = motions[others[0]].now.placings(times) if others else None
    if found is not None:
        middle[:, others], radius[others] = found[0].around([motions[number] for number in others])
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


@dataclass(frozen=True, eq=False)
class Straight:
    """A motion without turns, straight and even: position = at + velocity (t - since)."""

    at_m: Floats
    "(3,)"
    velocity_m_s: Floats
    "(3,)"
    since_s: float
    rotation: Floats
    "(3, 3)"
    from_s: float
    until_s: float

    def holds(self, begin_s: float, end_s: float) -> bool:
        """All the time."""
        return self.from_s <= begin_s and end_s < self.until_s

    def position(self, t_s: Floats) -> Floats:
        """(n, 3)"""
        return np.asarray(self.at_m + (t_s - self.since_s)[:, None] * self.velocity_m_s)


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
        self._known: tuple[World, list[Track]] | None = None
        "Of the present sweep."
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
        tracks = self._mine()
        return bool(tracks) or (self._own is not None and self.name not in self.now.world.gone)

    @property
    def scale(self) -> Vector:
        """Of its shape along its axes, in the present sweep."""
        tracks = self._mine()
        size = tracks[-1].size_m if tracks else None
        if not self._shape or size is None or self._box is None:
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
        return self._offset(self._mine()[0])

    @property
    def straight(self) -> Straight | None:
        """How it moves in the present sweep; None: not straight, or there is more to it."""
        if self._straight[0] is not self.now.world:
            self._straight = self.now.world, self._straight_of(self._mine())
        return self._straight[1]

    def straight_at(self, times: Floats) -> Straight | None:
        """The same if it holds at all of these instants."""
        one = self.straight
        return one if one is not None and len(times) and one.holds(float(times.min()), float(times.max())) else None

    def _straight_of(self, tracks: list[Track]) -> Straight | None:
        if (
            not tracks
            and isinstance(self._own, Steady)
            and not self._own.turns
            and self.name not in self.now.world.gone
        ):
            zero, own = np.zeros(1), self._own
            placed = own.position(zero)[0], own.velocity(zero)[0], 0.0, own.rotation(zero)[0]
            return Straight(*placed, -math.inf, math.inf)
        self.now.look()
        velocity = tracks[0].straight_m_s if len(tracks) == 1 else None
        if velocity is None:
            return None
        track, (begin, end) = tracks[0], tracks[0].straight_s
        rotation = self.now.first_turn(track)
        offset = self._offset(track)
        at = track.at_m[0] + rotation @ np.array(offset) if any(offset) else track.at_m[0]
        return Straight(at, velocity, float(track.t_s[0]), rotation, begin, end)

    def whole_track(self, times: Floats) -> Track | None:
        """The only one that it has at all of these instants, ascending; None: there is more to it."""
        tracks = self._mine()
        if len(tracks) != 1 or not len(times) or tracks[0].comes_back:
            return None
        return tracks[0] if tracks[0].is_there(float(times[0]), float(times[-1])) else None

    def _mine(self) -> list[Track]:
        if self._known is None or self._known[0] is not self.now.world:
            mine = self.now.of(self.name)
            if self._shape:
                mine = [track for track in mine if track.shape == self._shape]
            self._known = self.now.world, mine
        return self._known[1]

    def _offset(self, track: Track) -> Vector:
        """From the feeder's reference point to the origin (or the mount), in the body's axes."""
        made_from = track.reference, track.rear_m, track.size_m, self.scale if self._shape else None
        if self._offsets[0] != made_from:
            self._offsets = made_from, self._offset_of(track)
        return self._offsets[1]

    def _offset_of(self, track: Track) -> Vector:
        if self._box is not None:
            scale = self.scale
            middle = tuple(a * s for a, s in zip(self._box.middle_m, scale, strict=True))
            half = tuple(a * s for a, s in zip(self._box.half_m, scale, strict=True))
        else:
            size = track.size_m or (0.0, 0.0, 0.0)
            half = (size[0] / 2.0, size[1] / 2.0, size[2] / 2.0)
            middle = (0.0, 0.0, half[2])  # its origin is on the ground
        rear = track.rear_m
        if track.reference == "origin":
            centre = middle
        elif track.reference == "ground":
            centre = (0.0, 0.0, half[2])
        elif track.reference == "rear_axle":
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
        return at + np.einsum("nij,j->ni", rotation, np.array(self._offset(track))), rotation

    def pose(self, t_s: Floats) -> Pose:
        return Pose(*self._at(np.atleast_1d(np.asarray(t_s, dtype=np.float64))))

    def position(self, t_s: Floats) -> Floats:
        return self._at(t_s)[0]

    def rotation(self, t_s: Floats) -> Floats:
        return self._at(t_s)[1]

    def velocity(self, t_s: Floats) -> Floats:
        times = np.asarray(t_s, dtype=np.float64)
        return np.asarray((self._at(times + STEP_S)[0] - self._at(times - STEP_S)[0]) / (2.0 * STEP_S))
