"""One sweep in parts: which beams each of them has, and the scan that they make together.

Belongs here: the beams of a part, its rows of a scan, putting them together. Not: how a part is measured (sensing), who
measures it (sharing).

A sweep is divided where it is wanted at once and several processes are free: of a world that somebody else moves none
can be measured before its poses have come. Or into *slices* of time, beams that fire one after the other, which one
process measures each when its beams are due. Whatever the number of parts, each beam has what it has in the whole
sweep under the conditions of its part.
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
NEAR = 16
"A slice ends at the longest pause within this part of its length of where an even division has it."


@lru_cache(maxsize=64)
def beams_of(count: int, number: int, of: int) -> NDArray[np.int64]:
    """Indexes of the beams of one part of a sweep of `count`: neighbours; not to be written to."""
    at = np.arange(number * count // of, (number + 1) * count // of)
    at.flags.writeable = False
    return at


def slice_of(plan: ScanPlan, number: int, of: int) -> NDArray[np.int64]:
    """Indexes of the beams of one slice of time, ascending: those before the longest pauses near an even division."""
    order = np.argsort(plan.fire_offset_s, kind="stable")
    ends = _ends(plan.fire_offset_s[order], of)
    return np.sort(order[ends[number] : ends[number + 1]])


def _ends(fire_s: Floats, of: int) -> list[int]:
    """Where slices begin and end among ascending instants; of pauses as long as each other the most even one."""
    count, pause_ns = len(fire_s), np.rint(1e9 * np.diff(fire_s))
    room = count // (NEAR * of)
    found = [0]
    for number in range(1, of):
        even = number * count // of
        near = np.arange(max(1, even - room), min(count - 1, even + room) + 1)
        found.append(even if not len(near) else int(near[np.lexsort((np.abs(near - even), -pause_ns[near - 1]))[0]]))
    return [*found, count]


@dataclass(frozen=True, eq=False)
class PartOfScan:
    """The rows of a scan that belong to the beams of one part."""

    at: NDArray[np.int64]
    "Which beams these are."
    range_m: Floats
    intensity: Floats
    flags: NDArray[np.uint8]
    actor: Ints


def part_of_scan(scan: Scan, number: int, of: int, in_time: bool = False) -> PartOfScan:
    """Those of a scan of all beams; `in_time`: of a slice."""
    at = slice_of(scan.plan, number, of) if in_time else beams_of(len(scan.plan), number, of)
    return rows_of(scan, at)


def rows_of(scan: Scan, at: NDArray[np.int64]) -> PartOfScan:
    """Those of some beams of a scan of all."""
    return PartOfScan(at, scan.range_m[at], scan.intensity[at], scan.flags[at], scan.actor[at])


def joined(plan: ScanPlan, parts: Sequence[PartOfScan]) -> Scan:
    """The scan of all parts of a sweep."""
    scan = Scan.empty(plan, parts[0].range_m.shape[1])
    for one in parts:
        at = one.at
        scan.range_m[at], scan.intensity[at], scan.flags[at], scan.actor[at] = (
            one.range_m, one.intensity, one.flags, one.actor
        )  # fmt: skip
    return scan


@dataclass(eq=False)
class Divided:
    """A sweep that is measured in parts: what of it has come."""

    plan: ScanPlan
    of: int
    in_time: bool = False
    "These are slices of time, each under conditions of its own."
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
