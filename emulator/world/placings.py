"""Where fed bodies are at all instants of a sweep: one table bodies x instants, each row computed when first wanted.

Belongs here: poses of many bodies at once, and bounds of where they may be, of the tracks that a sweep was given. Not:
single poses (fed), tracks (live).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from emulator.live.tracks import World, together
from emulator.physics.arrays import indexes
from emulator.world.motion import Floats, Vector, matrix_of

Longs = NDArray[np.int64]
MARGIN_M = 1e-6
"Against rounding, beside a share as large."


class Body(Protocol):
    """What is asked of a body that is fed."""

    @property
    def offset(self) -> Vector:
        """From the feeder's reference point to the origin, in the body's axes."""

    def whole_track(self, times: Floats) -> int | None:
        """Number of the only track that it has at all of these instants; None: there is more to it."""

    def found(self, times: Floats) -> tuple[Floats, Floats]:
        """Positions (n, 3) and rotations (n, 3, 3)."""


def _poses(world: World, numbers: Sequence[int], t_s: Floats) -> tuple[Floats, Floats]:
    """Reference points (3, m, n) and rotations (3, 3, m, n) of its tracks; what does not turn is turned once."""
    n, known = len(t_s), world.natures
    chosen = np.array(numbers, np.int64)
    place, rotation = np.zeros((3, len(chosen), n)), np.zeros((3, 3, len(chosen), n))
    rotation[:] = matrix_of(known.first_quaternion[chosen]).transpose(1, 2, 0)[..., None]
    moving = indexes(~known.rests[chosen])
    if len(moving) < len(chosen):
        place[:] = known.first_at_m[chosen].T[..., None]
    if not len(moving):
        return place, rotation
    at, quaternion = together(world.knots_of(chosen[moving]), t_s)
    place[:, moving] = at.reshape(-1, n, 3).transpose(2, 0, 1)
    turning = indexes(known.turns[chosen[moving]])
    if len(turning):
        mine = quaternion.reshape(-1, n, 4)[turning].reshape(-1, 4)
        rotation[:, :, moving[turning]] = matrix_of(mine).reshape(-1, n, 3, 3).transpose(2, 3, 0, 1)
    return place, rotation


class Bounds:
    """Of each track of a world: the box of its samples and how far from it the track may be."""

    def __init__(self, world: World) -> None:
        self.world = world
        if not world.names:
            return
        sizes, firsts = world.knots.sizes, world.knots.firsts
        t_s, at, _, velocity, *_ = world.columns
        given = np.nan_to_num(velocity)
        step, way = np.zeros(len(t_s)), np.zeros(len(t_s))
        step[1:], way[1:] = np.diff(t_s), np.linalg.norm(np.diff(at, axis=0), axis=1)
        step[firsts], way[firsts] = 0.0, 0.0
        fastest = np.maximum(np.linalg.norm(given, axis=1), way / np.where(step > 0.0, step, 1.0))
        self._fastest = np.maximum.reduceat(fastest, firsts)
        self._step = np.maximum.reduceat(step, firsts)
        low, high = np.minimum.reduceat(at, firsts), np.maximum.reduceat(at, firsts)
        self._middle = low + (high - low) / 2.0
        self._half = np.linalg.norm(high - low, axis=1) / 2.0
        self._last = t_s[firsts + sizes - 1]
        self._hold = world.knots.hold_s
        self._half[world.natures.comes_back] = np.inf

    def spheres(self, tracks: Sequence[int], end_s: float) -> tuple[Floats, Floats]:
        """Centres (k, 3) and radii (k,) that hold the reference points of tracks until `end_s`."""
        which = np.array(tracks)
        # a cubic leaves its chord by less than what is travelled in its step; beyond the last sample a twist is as fast
        beyond = np.clip(end_s - self._last[which], 0.0, self._hold[which])
        radius = self._half[which] + self._fastest[which] * (self._step[which] + beyond)
        return self._middle[which], radius * (1.0 + MARGIN_M) + MARGIN_M


class Placings:
    """Where bodies are at these instants, as one world has it."""

    def __init__(self, bounds: Bounds, t_s: Floats) -> None:
        """`t_s` : (n,) ascending."""
        self.t_s = t_s
        self._bounds = bounds
        self._rows: dict[int, int] = {}
        self.at: Floats = np.zeros((3, 0, len(t_s)))
        "(3, rows, n) of origins."
        self.turned: Floats = np.zeros((3, 3, 0, len(t_s)))
        "(3, 3, rows, n) body to world."
        self._instants: dict[int, tuple[Floats, Longs]] = {}

    def index(self, times: Floats) -> Longs | None:
        """(r,) number of each time; None where one of them is another instant."""
        begins = np.ones(len(times), bool)
        np.not_equal(times[1:], times[:-1], out=begins[1:])
        found = times[begins]
        number = np.minimum(self.t_s.searchsorted(found), len(self.t_s) - 1)
        if not np.array_equal(self.t_s[number], found):
            return None
        return number if len(number) == len(times) else number[np.cumsum(begins) - 1]

    def rows(self, motions: Sequence[Body]) -> Longs:
        """(k,) where they are in `at` and `turned`."""
        wanted = {id(one): one for one in motions if id(one) not in self._rows}
        if wanted:
            self._add(list(wanted.values()))
        return np.array([self._rows[id(one)] for one in motions], np.int64)

    def _add(self, motions: list[Body]) -> None:
        first, count, n = len(self._rows), len(motions), len(self.t_s)
        at, turned = np.zeros((3, count, n)), np.zeros((3, 3, count, n))
        tracks: dict[int, int] = {}
        whole, whose = [], []
        for number, one in enumerate(motions):
            track = one.whole_track(self.t_s)
            if track is None:
                position, rotation = one.found(self.t_s)
                at[:, number], turned[:, :, number] = position.T, rotation.transpose(1, 2, 0)
                continue
            whole.append(number)
            whose.append(tracks.setdefault(track, len(tracks)))
        if tracks:
            place, rotation = _poses(self._bounds.world, list(tracks), self.t_s)
            turned[:, :, whole], at[:, whole] = rotation[:, :, whose], place[:, whose]
            offset = np.array([motions[number].offset for number in whole]).T
            apart = indexes((offset != 0.0).any(axis=0))
            if len(apart):
                rows = np.array(whole)[apart]
                at[:, rows] += np.einsum("ijkn,jk->ikn", turned[:, :, rows], offset[:, apart])
        self.at = np.concatenate([self.at, at], axis=1) if first else at
        self.turned = np.concatenate([self.turned, turned], axis=2) if first else turned
        self._rows.update((id(one), first + number) for number, one in enumerate(motions))

    def spheres(self, motions: Sequence[Body], centre: Floats) -> tuple[Floats, Floats]:
        """Centres (3, k) and radii (k,) that hold points `centre` (3, k) of bodies at all of these instants."""
        rows = self.rows(motions)
        paths = self.at[:, rows] + np.einsum("ijkn,jk->ikn", self.turned[:, :, rows], centre)
        low, high = paths.min(axis=2), paths.max(axis=2)
        middle = low + (high - low) / 2.0
        off = paths - middle[:, :, None]
        away = np.sqrt(np.einsum("ikn,ikn->kn", off, off).max(axis=1))
        return middle, away * (1.0 + MARGIN_M) + MARGIN_M

    def around(self, motions: Sequence[Body]) -> tuple[Floats, Floats]:
        """Centres (3, k) and radii (k,) that hold origins of bodies meanwhile, without looking where they are."""
        middle, radius = np.zeros((3, len(motions))), np.full(len(motions), np.inf)
        found = [(number, one.whole_track(self.t_s)) for number, one in enumerate(motions)]
        whole = [(number, track) for number, track in found if track is not None]
        if whole:
            where, far = self._bounds.spheres([track for _, track in whole], float(self.t_s[-1]))
            numbers = [number for number, _ in whole]
            middle[:, numbers] = where.T
            radius[numbers] = far + np.array([math.hypot(*motions[number].offset) for number in numbers])
        for number in np.flatnonzero(np.isinf(radius)).tolist():
            where, far = self.spheres([motions[number]], np.zeros((3, 1)))
            middle[:, number], radius[number] = where[:, 0], far[0]
        return middle, radius
