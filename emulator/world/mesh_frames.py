"""Meshes that change their shape: frames with the same triangles, and where the vertices are between two of them.

Belongs here: vertices at an instant. Not: what rays meet of them (deforming), reading the frames (scene).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from emulator.world.triangles import Floats, Ints

Longs = NDArray[np.int64]

MOST_OFF_M = 1e-3
"How far a vertex may be off at most where the triangle that a ray meets is decided."
SHORTEST_STEP_S = 5e-5
"Vertices faster than 40 m/s are off by more: their speed times half of this."


@dataclass(frozen=True, eq=False)
class Frames:
    """n shapes of one mesh, one after the other."""

    vertices: Floats
    "(n, v, 3) about the body's own origin. [m]"
    faces: Ints
    "(f, 3)"
    period_s: float
    "Of a loop: from the first frame to the first again; else from the first to the last."
    at_s: float
    "When the first frame is seen."
    loop: bool

    @property
    def segment_s(self) -> float:
        """From one frame to the next."""
        count = len(self.vertices)
        return self.period_s / (count if self.loop else max(count - 1, 1))

    @cached_property
    def speed_m_s(self) -> float:
        """Of the fastest vertex within the body."""
        after = np.roll(self.vertices, -1, axis=0) if self.loop else self.vertices[1:]
        way = after - self.vertices[: len(after)]
        return float(np.sqrt(np.einsum("nvi,nvi->nv", way, way)).max(initial=0.0)) / self.segment_s

    @cached_property
    def step_s(self) -> float:
        """Rays are gathered by multiples of it."""
        if self.speed_m_s == 0.0:
            return self.segment_s
        return max(2.0 * MOST_OFF_M / self.speed_m_s, SHORTEST_STEP_S)

    @cached_property
    def box(self) -> tuple[Floats, Floats]:
        """Least and largest corner (3,) of all frames; between frames nothing is outside."""
        used = self.vertices[:, np.unique(self.faces)]
        return used.min(axis=(0, 1)), used.max(axis=(0, 1))

    def between(self, t_s: Floats) -> tuple[Longs, Longs, Floats]:
        """Frames before and after instants (k,), and the share (k,) of the way from the one to the other."""
        count = len(self.vertices)
        if self.loop:
            turn = (t_s - self.at_s) / self.period_s
            place = (turn - np.floor(turn)) * count
            first = np.minimum(place.astype(np.int64), count - 1)
            return first, (first + 1) % count, place - first
        place = np.clip((t_s - self.at_s) / self.period_s, 0.0, 1.0) * (count - 1)
        first = np.minimum(place.astype(np.int64), max(count - 2, 0))
        return first, np.minimum(first + 1, count - 1), place - first

    def at(self, t_s: float) -> Floats:
        """Vertices (v, 3) at an instant."""
        first, after, share = self.between(np.array([t_s]))
        return np.asarray(self._mixed(self.vertices[first[0]], self.vertices[after[0]], share[0]))

    @staticmethod
    def _mixed(one: Floats, other: Floats, share: Floats) -> Floats:
        return one + share * (other - one)
