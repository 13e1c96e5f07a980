"""Tracks as columns: what is remembered of every object from scan to scan. World frame, SI.

Belongs here: the store and its bookkeeping. Not: filter equations and association.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from emulator.objects.points import Floats, Integers


@dataclass(eq=False)
class Tracks:
    """n tracks."""

    number: Integers
    state: Floats
    "(n, 4) x, y, vx, vy of the box's centre."
    covariance: Floats
    "(n, 4, 4)"
    yaw_rad: Floats
    yaw_variance: Floats
    length_m: Floats
    width_m: Floats
    length_known: NDArray[np.bool_]
    "It has been seen from the side."
    width_known: NDArray[np.bool_]
    low_m: Floats
    high_m: Floats
    existence: Floats
    hits: Integers
    born_s: Floats
    seen_s: Floats
    reflectance: Floats
    actor: Integers
    group: Integers
    "Number of the group that it was seen as in the last scan, -1 when it was not."

    def __len__(self) -> int:
        return len(self.number)

    def keep(self, index: NDArray[np.bool_]) -> None:
        """Forget the others."""
        for entry in fields(self):
            setattr(self, entry.name, getattr(self, entry.name)[index])

    def add(self, other: Tracks) -> None:
        """Take up more tracks."""
        for entry in fields(self):
            setattr(self, entry.name, np.concatenate([getattr(self, entry.name), getattr(other, entry.name)]))

    @classmethod
    def none(cls) -> Tracks:
        """No track."""
        floats, numbers = np.zeros(0), np.zeros(0, dtype=np.int64)
        return cls(
            number=numbers,
            state=np.zeros((0, 4)),
            covariance=np.zeros((0, 4, 4)),
            yaw_rad=floats,
            yaw_variance=floats,
            length_m=floats,
            width_m=floats,
            length_known=np.zeros(0, dtype=np.bool_),
            width_known=np.zeros(0, dtype=np.bool_),
            low_m=floats,
            high_m=floats,
            existence=floats,
            hits=numbers,
            born_s=floats,
            seen_s=floats,
            reflectance=floats,
            actor=numbers,
            group=numbers,
        )
