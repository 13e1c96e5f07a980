"""One sweep in parts: which beams each of them has, and the scan that they make together.

Belongs here: the beams of a part, its rows of a scan, putting them together. Not: how a part is measured (sensing), who
measures it (sharing).

A sweep is divided where it is wanted at once and several processes are free: of a world that somebody else moves none
can be measured before its poses have come. Whatever the number of parts, each beam has what it has in the whole sweep.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from protocols.scan import Floats, Ints, Scan, ScanPlan

FEWEST_BEAMS = 64
"Of fewer no part is worth the way there and back."


@lru_cache(maxsize=64)
def beams_of(count: int, number: int, of: int) -> NDArray[np.int64]:
    """Indexes of the beams of one part of a sweep of `count`: neighbours; not to be written to."""
    at = np.arange(number * count // of, (number + 1) * count // of)
    at.flags.writeable = False
    return at


@dataclass(frozen=True, eq=False)
class PartOfScan:
    """The rows of a scan that belong to the beams of one part."""

    number: int
    of: int
    range_m: Floats
    intensity: Floats
    flags: NDArray[np.uint8]
    actor: Ints


def part_of_scan(scan: Scan, number: int, of: int) -> PartOfScan:
    """Those of a scan of all beams."""
    at = beams_of(len(scan.plan), number, of)
    return PartOfScan(number, of, scan.range_m[at], scan.intensity[at], scan.flags[at], scan.actor[at])


def joined(plan: ScanPlan, parts: Sequence[PartOfScan]) -> Scan:
    """The scan of all parts of a sweep."""
    scan = Scan.empty(plan, parts[0].range_m.shape[1])
    for one in parts:
        at = beams_of(len(plan), one.number, one.of)
        scan.range_m[at], scan.intensity[at], scan.flags[at], scan.actor[at] = (
            one.range_m, one.intensity, one.flags, one.actor
        )  # fmt: skip
    return scan


@dataclass(eq=False)
class Divided:
    """A sweep that is measured in parts: what of it has come."""

    plan: ScanPlan
    of: int
    came: dict[int, PartOfScan | Scan | None] = field(default_factory=dict)
    "By number; the first part of a sweep that cannot be divided is all of it, the others are None."
    is_over: bool = False
    "It has been delivered, or given up."

    def take(self, number: int, result: PartOfScan | Scan | None) -> Scan | None:
        """The scan, once all is there; at once where a part says what becomes of the whole."""
        if self.is_over:
            return None
        self.came[number] = result
        if isinstance(result, Scan):
            self.is_over = True
            return result
        parts = [one for one in self.came.values() if isinstance(one, PartOfScan)]
        if len(parts) < self.of:
            return None
        self.is_over = True
        return joined(self.plan, parts)
