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
    "(r,) bins up to the maximum."
    rise: Floats
    "(r,) the medium's return there, ascending."

    def crossing(self, level: Floats) -> Floats:
        """Where it first reaches levels (a,) > 0, its maximum where it never does; linear between the bins. [m]"""
        found = np.interp(level, self.rise, self.rise_m)
        return np.asarray(np.where(level > self.rise[-1], self.centre_m, found))

    @classmethod
    def of(cls, soft: SoftProfile | None, beams: Bools) -> OwnEchoes:
        """Those of `beams` (n,)."""
        if soft is None or not bool(beams.any()):
            return cls(np.zeros(0, np.int64), 0.0, 0.0, np.zeros(1), np.zeros(1))
        top = int(np.argmax(soft.free))
        rise_m = soft.bin_m * np.arange(soft.first, soft.first + top + 1, dtype=np.float64)
        rise = np.maximum.accumulate(soft.free[: top + 1])
        # a parabola through three bins, as the maxima of samples are found
        left, middle, right = np.concatenate([np.zeros(1), soft.free, np.zeros(1)])[top : top + 3].tolist()
        curve = left - 2.0 * middle + right
        shift = min(max(0.5 * (left - right) / curve, -0.5), 0.5) if curve < 0.0 else 0.0
        centre, height = float(rise_m[-1]) + shift * soft.bin_m, middle - 0.25 * (left - right) * shift
        return cls(indexes(beams), centre, height, rise_m, rise)
