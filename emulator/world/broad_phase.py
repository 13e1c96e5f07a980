"""Which of many moving bodies can come near a place during a short time, without looking at the others again.

Belongs here: bounds of whole motions over windows of time, and the choice of those in reach. Not: where bodies are at
an instant (batched_poses), what a ray meets (raycast).

Time is cut into windows of a second and space into cells. Of each window and cell it is found once which bodies can
be within reach at any time; sweeps of the same second from the same place take that choice. It never leaves out a
body that comes into reach, however fast: the bound is the whole stretch of its path, its greatest speed where it passes
a waypoint, and the sphere about all of its waypoints.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from emulator.world.batched_poses import BatchedPoses, Longs
from emulator.world.fed import Fed
from emulator.world.motion import Floats, Motion, Waypoints

WINDOW_S = 1.0
CELL_M = 64.0
REACH_M = 16.0
"Reaches are rounded up to a multiple of it: what is left of them behind mirrors and panes differs in every sweep."
MARGIN = 1e-6
"Share, and metres, against rounding; times of 1e9 s and coordinates of 1e9 m are resolved to 1e-7 of their units."
KEPT = 16
"Choices kept: one for each sensor that looks at the scene."
FEW = 4
"So few bodies are not worth a choice."


class BroadPhase:
    """The motions of b bodies, each with a sphere around its origin that holds it."""

    @np.errstate(under="ignore")
    def __init__(self, motions: Sequence[Motion], radius_m: Floats) -> None:
        self._batched = BatchedPoses(motions)
        self._radius = np.asarray(radius_m, dtype=np.float64)
        self._speed = np.array([_fastest(motion) for motion in motions], np.float64)
        self._home, self._roam = _homes(motions)
        self._all = np.arange(len(motions))
        self._kept: tuple[tuple[tuple[object, ...], Longs], ...] = ()

    def within(self, low_m: Floats, high_m: Floats, reach_m: float, begin_s: float, end_s: float) -> Longs:
        """Indexes, ascending, of all that may be nearer than `reach_m` to the box of `low_m`, `high_m`, each (3,).

        The same array as long as the choice is the same.
        """
        if len(self._all) <= FEW or not math.isfinite(reach_m):
            return self._all
        reach_m = REACH_M * math.ceil(reach_m / REACH_M)
        window = math.floor(begin_s / WINDOW_S), math.floor(end_s / WINDOW_S)
        # cells as numbers of Python: there are six of them, and somebody asks several times a sweep
        key = *[at / CELL_M // 1.0 for at in (*low_m.tolist(), *high_m.tolist())], *window, reach_m
        for known, chosen in self._kept:
            if known == key:
                return chosen
        first, last = np.floor(low_m / CELL_M), np.floor(high_m / CELL_M)
        begin, end = window[0] * WINDOW_S, (window[1] + 1) * WINDOW_S
        chosen = self._chosen(CELL_M * first, CELL_M * (last + 1.0), reach_m, begin, end)
        self._kept = ((key, chosen), *self._kept[: KEPT - 1])
        return chosen

    def _chosen(self, low: Floats, high: Floats, reach_m: float, begin_s: float, end_s: float) -> Longs:
        spare_room = MARGIN * (1.0 + max(abs(begin_s), abs(end_s)))
        begin, end = begin_s - spare_room, end_s + spare_room
        now = self._batched.lasting(begin, end)
        start = now.at + (begin - now.since) * now.velocity
        half = now.velocity * ((end - begin) / 2.0)
        along = np.sqrt(np.einsum("ib,ib->b", half, half))
        middle = np.where(now.linear, start + half, start)
        swept = np.where(now.linear, along, self._speed * (end - begin))
        eye, room = 0.5 * (low + high)[:, None], float(np.linalg.norm(high - low)) / 2.0
        limit = (reach_m + room + self._radius) * (1.0 + MARGIN) + MARGIN * (1.0 + float(np.abs(eye).max()))
        near = np.linalg.norm(middle - eye, axis=0) - swept <= limit
        near &= np.linalg.norm(self._home - eye, axis=0) - self._roam <= limit
        return np.flatnonzero(near)


def _fastest(motion: Motion) -> float:
    """Of the whole run. [m/s]"""
    return math.inf if isinstance(motion, Fed) else motion.speed_bound_m_s


def _homes(motions: Sequence[Motion]) -> tuple[Floats, Floats]:
    """Centre (3, b) and radius (b,) of spheres that hold all waypoints; of others infinite."""
    home, roam = np.zeros((3, len(motions))), np.full(len(motions), np.inf)
    for index, motion in enumerate(motions):
        if isinstance(motion, Waypoints):
            low, high = motion.at_m.min(axis=0), motion.at_m.max(axis=0)
            home[:, index] = low + (high - low) / 2.0
            roam[index] = np.linalg.norm(motion.at_m - home[:, index], axis=1).max()
        elif motion.still:
            home[:, index], roam[index] = motion.position(np.zeros(1))[0], 0.0
    return home, roam
