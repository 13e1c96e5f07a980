"""What kind of motion fed actors have in one sweep: straight, turning, at rest, coming back; of all of them at once.

Belongs here: one table of facts by track, of columns of samples. Not: where a track is (tracks), whose it is (world).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from emulator.live.rotations import Floats

Columns = tuple[NDArray[Any], ...]
Flags = NDArray[np.bool_]
STRAIGHT_M = 1e-9
"A track that is nowhere farther from a straight line, evenly passed, is one."


@dataclass(frozen=True, eq=False)
class Nature:
    """What kind of motion a track is."""

    comes_back: bool
    turns: bool
    rests: bool
    straight_m_s: Floats | None


@dataclass(frozen=True, eq=False)
class Natures:
    """The same of m tracks, and their first and last samples."""

    comes_back: Flags
    "(m,)"
    turns: Flags
    "(m,)"
    rests: Flags
    "(m,)"
    straight: Flags
    "(m,) moves straight and evenly, or rests, and does not turn."
    velocity_m_s: Floats
    "(m, 3) of those that are straight."
    first_s: Floats
    "(m,)"
    last_s: Floats
    "(m,)"
    first_at_m: Floats
    "(m, 3)"
    first_quaternion: Floats
    "(m, 4)"
    known_last: Flags
    "(m,) the newest sample has a velocity."

    def each(self) -> list[Nature]:
        """One by one."""
        return [
            Nature(back, turns, rests, velocity if straight else None)
            for back, turns, rests, straight, velocity in zip(
                self.comes_back.tolist(),
                self.turns.tolist(),
                self.rests.tolist(),
                self.straight.tolist(),
                self.velocity_m_s,
                strict=True,
            )
        ]


def natures_of(columns: Columns, sizes: Sequence[int], interpolated: Flags) -> Natures:
    """Of tracks of so many samples each, one after the other; `interpolated`: (m,) between samples."""
    t_s, at, quaternion, velocity, spin, jump, returns = columns
    counts = np.array(sizes, np.int64)
    ends = counts.cumsum()
    firsts = ends - counts
    began = firsts.repeat(counts)
    start, last_s, none = t_s[firsts], t_s[ends - 1], np.zeros(len(counts), bool)
    first_at, first_turn = at[firsts], quaternion[firsts]

    # what is so of no sample at all, as most of this is, is not asked of each track
    def of_any(facts: Flags) -> Flags:
        return np.asarray(np.logical_or.reduceat(facts, firsts)) if facts.any() else none

    def of_any_row(facts: Flags) -> Flags:
        return of_any(np.asarray(facts.any(axis=1))) if facts.any() else none

    back = of_any(returns)
    turns = of_any_row(quaternion != quaternion[began]) | of_any_row(np.abs(spin) > 0.0)  # of a comparison NaN is not
    from_at = at[began]
    rests = ~(turns | of_any_row((at != from_at) | (velocity != 0.0) & (velocity == velocity)))
    unknown = velocity != velocity
    some = of_any_row(unknown)
    steady = velocity[firsts]
    straight = ~turns
    if some.any():
        span = last_s - start
        mean = (at[ends - 1] - first_at) / np.where(span > 0.0, span, 1.0)[:, None]
        steady = np.where(some[:, None], mean, steady)
        straight &= ~some | ~of_any_row(~unknown) & (counts > 1)
    evenly = steady.repeat(counts, axis=0)
    off = np.abs(at - (from_at + (t_s - t_s[began])[:, None] * evenly)) > STRAIGHT_M
    off |= np.abs(velocity - evenly) * (last_s - start).repeat(counts)[:, None] > STRAIGHT_M
    straight &= ~of_any_row(off)
    if jump.any():
        jumps = jump.copy()
        jumps[firsts] = False
        straight &= ~of_any(jumps)
    straight = (straight & interpolated | rests) & ~back
    velocity_m_s = np.where(rests[:, None], 0.0, steady)
    known_last = ~unknown[ends - 1, 0]
    return Natures(back, turns, rests, straight, velocity_m_s, start, last_s, first_at, first_turn, known_last)
