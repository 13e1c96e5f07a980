"""Which of several fed bodies move straight in the present sweep, and how: all of them at once.

Belongs here: columns of straight motions by body. Not: single motions (fed), where bodies that turn are (placings).

Whose tracks there are and what they report of their actors changes seldom: what follows from that is kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from emulator.live.tracks import World
from emulator.world.motion import Floats, Vector

Longs = NDArray[np.int64]


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


class Present(Protocol):
    """What is known of the present sweep."""

    @property
    def world(self) -> World:
        """All tracks."""

    @property
    def first_turns(self) -> Floats:
        """(m, 3, 3) how each of them is turned at its first sample."""


class Body(Protocol):
    """What is asked of a body that is fed."""

    @property
    def present(self) -> Present:
        """Of its scene."""

    @property
    def numbers(self) -> list[int]:
        """Which tracks are its own."""

    @property
    def offset(self) -> Vector:
        """From the feeder's reference point to the origin, in the body's axes."""

    @property
    def own_straight(self) -> Straight | None:
        """Its own motion, where nobody has fed it yet and that is straight for ever."""


@dataclass(frozen=True, eq=False)
class Straights:
    """Those of m motions that are straight: position = at + velocity (t - since)."""

    rows: Longs
    "(k,) which of the motions."
    at_m: Floats
    "(k, 3)"
    velocity_m_s: Floats
    "(k, 3)"
    rotation: Floats
    "(k, 3, 3) body to world."
    since_s: Floats
    "(k,)"
    from_s: Floats
    "(k,)"
    until_s: Floats
    "(k,)"

    def after(self, other: Straights) -> Straights:
        """Those of `other`, then these."""
        pairs = ((getattr(other, one.name), getattr(self, one.name)) for one in fields(self))
        return Straights(*(np.concatenate(pair) for pair in pairs))


class StraightsNow:
    """The same in whatever is the present sweep."""

    def __init__(self, motions: Sequence[Body]) -> None:
        """At least one, all of one scene."""
        self._motions = tuple(motions)
        self._now = self._motions[0].present
        self._told: object = None
        "Whose tracks there are, and what they report."
        self._world: World | None = None
        self._found: Straights | None = None
        self._turned_by = np.zeros((0, 4)), np.zeros((0, 3))
        "First orientations, and how far the origins are from the points that are reported."

    @property
    def found(self) -> Straights:
        """Rows count these motions."""
        world = self._now.world
        if self._found is None or world is not self._world:
            self._world, self._found = world, self._look(world)
        return self._found

    def _look(self, world: World) -> Straights:
        told = world.names, world.described, world.gone
        if told != self._told:
            self._learn()
            self._told = told
        if not len(self._numbers):
            return self._own
        known, (begin_s, until_s) = world.natures, world.straight_s
        straight = known.straight[self._numbers]
        rows, mine = self._rows[straight], self._numbers[straight]
        at, turned = known.first_at_m[mine], self._now.first_turns[mine]
        if self._offsets.any():
            at = at + self._from_reported(known.first_quaternion[self._numbers])[straight]
        found = Straights(rows, at, known.velocity_m_s[mine], turned, known.first_s[mine], begin_s[mine], until_s[mine])
        return found.after(self._own) if len(self._own.rows) else found

    def _learn(self) -> None:
        """Which of them have one track, which still move as the scenario says."""
        fed = [(row, mine[0]) for row, one in enumerate(self._motions) if len(mine := one.numbers) == 1]
        self._rows = np.array([row for row, _ in fed], np.int64)
        self._numbers = np.array([number for _, number in fed], np.int64)
        self._offsets = np.array([self._motions[row].offset for row, _ in fed]).reshape(-1, 3)
        self._turned_by = np.zeros((0, 4)), np.zeros((0, 3))
        own = [(row, one) for row, motion in enumerate(self._motions) if (one := motion.own_straight) is not None]
        ones = [one for _, one in own]
        self._own = Straights(
            np.array([row for row, _ in own], np.int64),
            np.array([one.at_m for one in ones]).reshape(-1, 3),
            np.array([one.velocity_m_s for one in ones]).reshape(-1, 3),
            np.array([one.rotation for one in ones]).reshape(-1, 3, 3),
            np.array([one.since_s for one in ones]),
            np.array([one.from_s for one in ones]),
            np.array([one.until_s for one in ones]),
        )

    def _from_reported(self, quaternion: Floats) -> Floats:
        """(k, 3) from the points that are reported to the origins, in the world."""
        known, moved = self._turned_by
        if not np.array_equal(known, quaternion):
            turned, moved = self._now.first_turns, np.zeros((len(quaternion), 3))
            for row in np.flatnonzero(self._offsets.any(axis=1)):
                moved[row] = turned[self._numbers[row]] @ self._offsets[row]
            self._turned_by = quaternion, moved
        return moved
