"""The echo that a medium makes of its own in beams of which nothing else is seen where it is strongest.

Here: its place and height, and where it crosses a level: the same in all these beams, read off the medium's table. Not
here: beams in which surfaces stand in the medium's maximum; they are sampled (waveform).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from emulator.physics.arrays import Bools, Floats, Ints, indexes
from emulator.physics.softprofile import SoftProfile


@dataclass(frozen=True, eq=False)
class OwnEchoes:
    """One echo of the medium in each of a beams."""

    beam: Ints
    "(a,)"
    centre_m: float
    "Place of the maximum, apparent range from the centre of the pulse."
    height: float
    rise_m: Floats
    "(r,) apparent ranges up to the maximum, close where the rise bends."
    rise: Floats
    "(r,) the medium's return there, ascending."

    def crossing(self, level: Floats) -> Floats:
        """Where it first reaches levels (a,) > 0, its maximum where it never does; linear between these. [m]"""
        found = np.interp(level, self.rise, self.rise_m)
        return np.asarray(np.where(level > self.rise[-1], self.centre_m, found))

    @classmethod
    def of(cls, soft: SoftProfile | None, beams: Bools) -> OwnEchoes:
        """Those of `beams` (n,)."""
        if soft is None or not bool(beams.any()):
            return cls(np.zeros(0, np.int64), 0.0, 0.0, np.zeros(1), np.zeros(1))
        centre, height = soft.top
        rise_m, rise = soft.rise
        return cls(indexes(beams), centre, height, rise_m, rise)
