"""Angles: the beams of a scan, in which turn of the mirror each is fired, and when.

The wire counts degrees from the right, 90 straight ahead, counter-clockwise seen from above; plans use azimuth 0 ahead,
positive to the left.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from protocols.lms2xx.timing import TURN_S
from protocols.scan import Floats

TURN_DEG = 360.0


@dataclass(frozen=True)
class Variant:
    """Field and step of a complete scan; reply BB, status bytes 106-109."""

    field_deg: int
    step_cdeg: int
    turns: int
    "Of the mirror, for one scan: point i is fired in turn i mod `turns`."

    @property
    def points(self) -> int:
        return self.field_deg * 100 // self.step_cdeg + 1


STANDARD = Variant(180, 50, 2)
VARIANTS = (Variant(180, 100, 1), STANDARD, Variant(100, 100, 1), Variant(100, 50, 2), Variant(100, 25, 4))
"All that 3B takes. 180 deg at 0.25 deg there is only in partial scans."
FAST = Variant(90, 50, 1)
"LMS2x1-S14: 45..135 deg, no 3B (sicktoolbox, MIT driver)."

PARTIAL_SETS = 4
"""Partial scans move on by a quarter of a degree a telegram, whatever the variant (listing, p. 46-47). Always over 180
deg: the MIT driver quotes the listing that the field asked for is ignored."""


def partial_points(part: int) -> int:
    """Values of partial scan 0..3: 181 where 180 deg itself belongs to the set, else 180."""
    return 181 if part == 0 else 180


@dataclass(frozen=True, eq=False)
class Comb:
    """Directions and instants of one scan's beams."""

    azimuth_rad: Floats
    elevation_rad: Floats
    fire_offset_s: Floats
    "After the beginning of the scan's first turn. Neighbours of a finer grid than a turn's lie one turn apart."
    turns: int
    grid: tuple[int, int, int]
    "Wire angle of the first beam and step, in hundredths of a degree, and the number of beams."

    @property
    def points(self) -> int:
        return len(self.azimuth_rad)


@lru_cache(maxsize=16)
def comb(variant: Variant, part: int | None, direct: bool = False) -> Comb:
    """The beams of a complete scan, or of partial scan `part` (steps of 1 deg over 180 deg in one turn).

    `direct`: the beams of the variant itself that the turn of part `part` measures.

    A beam at wire angle a is fired a/360 of a turn after its turn began: 180 deg take half a turn.
    """
    first_cdeg, turns = 9000 - 50 * variant.field_deg, variant.turns
    if part is None:
        grid = (first_cdeg, variant.step_cdeg, variant.points)
    elif direct:
        own = part * variant.turns // PARTIAL_SETS
        step_cdeg = variant.step_cdeg * variant.turns
        grid = (first_cdeg + own * variant.step_cdeg, step_cdeg, len(range(own, variant.points, variant.turns)))
    else:
        grid = (25 * part, 100, partial_points(part))
    index = np.arange(grid[2])
    angle_deg = (grid[0] + index * grid[1]).astype(np.float64) / 100.0
    turn, turns = (index % turns, turns) if part is None else (np.zeros_like(index), 1)
    azimuth_rad = np.radians(angle_deg - 90.0).astype(np.float64)
    elevation_rad = np.zeros(len(index))
    fire_offset_s = ((turn + angle_deg / TURN_DEG) * TURN_S).astype(np.float64)
    for array in (azimuth_rad, elevation_rad, fire_offset_s):
        array.setflags(write=False)
    return Comb(azimuth_rad, elevation_rad, fire_offset_s, turns, grid)
