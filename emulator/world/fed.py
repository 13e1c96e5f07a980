"""Motions that come from a feed: what a sweep was given of them, else the scenario's own.

Belongs here: tracks of `live` as motions of bodies and of what sensors are mounted on. Not: tracks themselves (live),
who hands them over (runtime).

All motions of one scene read one `FedNow`, which is set before each sweep.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from emulator.live.tracks import NOTHING, Track, World, together
from emulator.world.motion import Floats, Motion, Pose, Vector, matrix_of

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
    _tracks: dict[str, list[Track]] = field(default_factory=dict)
    _poses: dict[bytes, dict[int, tuple[Floats, Floats]]] = field(default_factory=dict)
    "Instants -> where each track is at them: one computation for all, as its beams ask at the same instants."

    def use(self, world: World) -> None:
        """From now on these."""
        if world is self.world:
            return
        self.world, self._tracks, self._poses = world, {}, {}
        for name, track in world.tracks:
            self._tracks.setdefault(name, []).append(track)

    @property
    def has_spawned(self) -> bool:
        """Some actor is there that is not in the scenario."""
        return any(track.shape for _, track in self.world.tracks)

    def of(self, name: str) -> list[Track]:
        """Lives of an actor, in their order."""
        return self._tracks.get(name, [])

    def poses(self, track: Track, t_s: Floats) -> tuple[Floats, Floats]:
        """Positions (n, 3) of its reference point and rotations (n, 3, 3) at instants (n,)."""
        if len(t_s) > MOST_AT_ONCE:
            at, quaternion = track.pose(t_s)
            return at, matrix_of(quaternion)
        key = t_s.tobytes()
        known = self._poses.get(key)
        if known is None:
            while len(self._poses) >= KEPT:
                self._poses.pop(next(iter(self._poses)))
            known = self._poses[key] = self._together(t_s)
        if id(track) not in known:
            at, quaternion = track.pose(t_s)
            known[id(track)] = at, matrix_of(quaternion)
        return known[id(track)]

    def _together(self, t_s: Floats) -> dict[int, tuple[Floats, Floats]]:
        plain = [track for _, track in self.world.tracks if not track.returns.any()]
        if not plain:
            return {}
        at, quaternion = together(plain, t_s)
        rotation, count = matrix_of(quaternion), len(t_s)
        parts = [slice(number * count, (number + 1) * count) for number in range(len(plain))]
        return {id(track): (at[part], rotation[part]) for track, part in zip(plain, parts, strict=True)}


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
        self.now, self._name, self._own, self._box = now, name, own, box
        self._shape, self._mount = shape, mount
        self._known: tuple[World, list[Track], bytes, tuple[Floats, Floats] | None] | None = None
        "Of the present sweep: its tracks, and where it was at the instants asked for last."

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
        return bool(tracks) or (self._own is not None and self._name not in self.now.world.gone)

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
        tracks = self._mine()
        if not tracks:
            return math.inf if self._own is None else self._own.speed_bound_m_s
        if len(tracks) > 1 or tracks[0].begins or math.isfinite(tracks[0].lasts_s):
            return math.inf
        return tracks[0].speed_bound()

    @property
    def slack_m(self) -> float:
        """How far turning takes the origin from a straight path of the point that the feeder tells of, at most."""
        tracks = self._mine()
        return max((2.0 * math.hypot(*self._offset(track)) for track in tracks), default=0.0)

    def _mine(self) -> list[Track]:
        if self._known is None or self._known[0] is not self.now.world:
            mine = [track for track in self.now.of(self._name) if track.shape == self._shape or not self._shape]
            self._known = self.now.world, mine, b"", None
        return self._known[1]

    def _offset(self, track: Track) -> Vector:
        """From the feeder's reference point to the origin (or the mount), in the body's axes."""
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
        tracks = self._mine()
        assert self._known is not None
        key = times.tobytes() if 1 < len(times) <= MOST_AT_ONCE else b""
        if key and self._known[2] == key and self._known[3] is not None:
            return self._known[3]
        found = self._found(tracks, times)
        if key:
            self._known = *self._known[:2], key, found
        return found

    def _found(self, tracks: list[Track], times: Floats) -> tuple[Floats, Floats]:
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
        if self._own is not None and self._name not in self.now.world.gone and free.any():
            rows = np.flatnonzero(free)
            pose = self._own.pose(times[rows])
            position[rows], rotation[rows] = pose.position_m, pose.rotation
        return position, rotation

    def _on(self, track: Track, times: Floats) -> tuple[Floats, Floats]:
        at, rotation = self.now.poses(track, times)
        offset = self._offset(track)
        return (at + rotation @ np.array(offset) if any(offset) else at), rotation

    def pose(self, t_s: Floats) -> Pose:
        return Pose(*self._at(np.atleast_1d(np.asarray(t_s, dtype=np.float64))))

    def position(self, t_s: Floats) -> Floats:
        return self._at(t_s)[0]

    def rotation(self, t_s: Floats) -> Floats:
        return self._at(t_s)[1]

    def velocity(self, t_s: Floats) -> Floats:
        times = np.asarray(t_s, dtype=np.float64)
        return np.asarray((self._at(times + STEP_S)[0] - self._at(times - STEP_S)[0]) / (2.0 * STEP_S))
