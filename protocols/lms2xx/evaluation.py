"""What a device finds in one scan besides its values: objects in fields, smallest distances, places in the plane.

Belongs here: arithmetic over beams, in metres. Not: the words it becomes on the wire (`outputs`), nor the fields
themselves (`fields`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from protocols.lms2xx.fields import RECTANGLE, Field, FieldSet, border_m
from protocols.scan import DAZZLED, Floats

Grid = tuple[int, int, int]
"Wire angle of the first beam and step, in hundredths of a degree, and the number of beams."
Flags = NDArray[np.bool_]


@dataclass(frozen=True)
class Fields:
    """The active set and how it is evaluated."""

    of: FieldSet
    subtractive: bool = False
    "Configuration byte G: what lies in B is taken out of A."
    special: bool = False
    "LMS211/221-S19 and -S20: C is taken out of A and of B."
    dazzle_counts: bool = True
    "A dazzled receiver is an object; not from availability level 2 on."

    def inside(self, range_m: Floats, grid: Grid) -> tuple[Flags, Flags, Flags]:
        """For each field the beams that end in it, 3 x (n,)."""
        a, b, c = (range_m < border_m(field, *grid) for field in self.of)
        if self.subtractive and self.special:
            a, b = a & ~c, b & ~c
        elif self.subtractive:
            a = a & ~b
        return a, b, c

    def infringed(self, range_m: Floats, flags: NDArray[np.uint8], grid: Grid) -> tuple[bool, bool, bool]:
        """Whether something is in A, B and C."""
        a, b, c = (bool(found.any()) for found in self.inside(range_m, grid))
        if self.dazzle_counts and (flags & DAZZLED).any():
            return True, True, True
        return a, b, c

    def verticals(self, range_m: Floats, grid: Grid) -> Floats:
        """Smallest distance ahead within each active field's corridor, NaN where there is nothing, (1..3,).

        A rectangle gives the corridor between its sides, however deep; any other field its own inside (listing 7.5).
        """
        found = []
        ahead, across = _plane(range_m, grid)
        for field in self.of:
            if not field.is_active:
                continue
            if field.shape == RECTANGLE:
                left, right, _ = field.metres
                found.append(_smallest(ahead[(across <= right) & (across >= -left)]))
            else:
                found.append(_smallest(range_m[range_m < border_m(field, *grid)]))
        return np.array(found)

    @property
    def active(self) -> int:
        """Fields that watch something."""
        return sum(field.is_active for field in self.of)


def segment_minima(field: Field, range_m: Floats, grid: Grid) -> Floats:
    """Smallest range in each segment of a field, NaN without an echo, (segments,); a beam on an edge is in both."""
    angle_deg = (grid[0] + grid[1] * np.arange(grid[2])) / 100.0
    edges = field.edges_deg()
    return np.array(
        [_smallest(range_m[(angle_deg >= low - 1e-9) & (angle_deg <= high + 1e-9)]) for low, high in pairwise(edges)]
    )


def group_minima(groups: Sequence[tuple[int, int]], range_m: Floats) -> Floats:
    """Smallest range among beams first..last of each group, counted from 1; NaN without an echo."""
    return np.array([_smallest(range_m[first - 1 : last]) for first, last in groups])


def places_m(range_m: Floats, grid: Grid, first: int, last: int) -> tuple[Floats, Floats]:
    """Right (positive) and ahead of each of the beams first..last, in metres."""
    ahead, across = _plane(range_m, grid)
    return across[first - 1 : last], ahead[first - 1 : last]


def _plane(range_m: Floats, grid: Grid) -> tuple[Floats, Floats]:
    angle = np.radians((grid[0] + grid[1] * np.arange(grid[2])) / 100.0)
    return range_m * np.sin(angle), range_m * np.cos(angle)


def _smallest(range_m: Floats) -> float:
    valid = range_m[range_m == range_m]
    return float(valid.min()) if len(valid) else math.nan
