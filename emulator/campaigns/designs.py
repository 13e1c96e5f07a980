"""Designs whose points are known before the first case: grid, Latin hypercube, Sobol, Saltelli, Monte Carlo.

Belongs here: the points, by number, made when asked for. Not: designs that look at results (searching).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import prod
from typing import Protocol

import numpy as np

from emulator.campaigns.factors import Factor, Floats, Point, Values
from emulator.campaigns.file import MOST_CASES, CampaignFile
from emulator.errors import ScenarioError

CHUNK = 4096
"Points made at a time; random ones have a stream for each, so that any of them can be made alone."


class Plan(Protocol):
    """Points by number."""

    @property
    def count(self) -> int:
        """How many."""

    @property
    def salted(self) -> bool:
        """Whether the number of a point is part of its seed: two equal points are two draws."""

    def points(self, start: int, stop: int) -> list[Point]:
        """Those from `start` to before `stop`."""


@dataclass(frozen=True)
class Grid:
    """Every combination of levels, the last factor fastest."""

    levels: Sequence[tuple[Values, ...]]
    salted: bool = False

    @property
    def count(self) -> int:
        """How many."""
        return prod(len(one) for one in self.levels)

    def points(self, start: int, stop: int) -> list[Point]:
        """Combinations by number."""
        found: list[Point] = []
        for number in range(start, stop):
            point = []
            for levels in reversed(self.levels):
                number, at = divmod(number, len(levels))
                point.append(levels[at])
            found.append(tuple(reversed(point)))
        return found


@dataclass(frozen=True)
class Cube:
    """Points of a unit cube that were all drawn at once."""

    factors: Sequence[Factor]
    unit: Floats
    salted: bool = True

    @property
    def count(self) -> int:
        """How many."""
        return len(self.unit)

    def points(self, start: int, stop: int) -> list[Point]:
        """Values of the rows."""
        return of_unit(self.factors, self.unit[start:stop])


@dataclass(frozen=True)
class Drawn:
    """Independent random points."""

    factors: Sequence[Factor]
    seed: int
    count: int
    salted: bool = True

    def points(self, start: int, stop: int) -> list[Point]:
        """Drawn by the chunk."""
        found: list[Point] = []
        for chunk in range(start // CHUNK, -(-stop // CHUNK)):
            stream = np.random.default_rng([self.seed, chunk])
            unit = stream.random((CHUNK, len(self.factors)))
            first = chunk * CHUNK
            found += of_unit(self.factors, unit[max(start - first, 0) : stop - first])
        return found


def of_unit(factors: Sequence[Factor], unit: Floats) -> list[Point]:
    """Points of rows of a unit cube."""
    if not len(factors):
        return [()] * len(unit)
    return list(zip(*(factor.at(unit[:, at]) for at, factor in enumerate(factors)), strict=True))


def plan_of(found: CampaignFile, factors: Sequence[Factor], label: str) -> Plan | None:
    """The points of a file's design; None where they depend on results. `label`: of its design."""
    design, kind = found.design, found.design.kind
    made: Plan
    if kind == "grid":
        made = Grid([one.grid() for one in factors])
    elif design.monte_carlo is not None:
        if design.monte_carlo.points is None:
            return None
        made = Drawn(factors, found.seed, design.monte_carlo.points)
    elif kind in ("lhs", "sobol", "saltelli"):
        wanted = getattr(design, kind).points
        runs = wanted * (len(factors) + 2) if kind == "saltelli" else wanted
        if runs * found.repeats > MOST_CASES:
            raise ScenarioError(f"{label}: {runs * found.repeats} cases; want at most {MOST_CASES}")
        made = Cube(factors, _cube(kind, wanted, len(factors), found.seed, label))
    else:
        return None
    if made.count * found.repeats > MOST_CASES:
        raise ScenarioError(f"{label}: {made.count * found.repeats} cases; want at most {MOST_CASES}")
    return made


def _cube(kind: str, points: int, factors: int, seed: int, label: str) -> Floats:
    from scipy.stats import qmc

    if kind == "lhs":
        return np.asarray(qmc.LatinHypercube(factors, seed=seed).random(points))
    if points & (points - 1):
        low = 1 << (points.bit_length() - 1)
        raise ScenarioError(f"{label}: {points} points; want a power of two for {kind}, as {low} or {2 * low}")
    if kind == "sobol":
        return np.asarray(qmc.Sobol(factors, seed=seed).random(points))
    both = np.asarray(qmc.Sobol(2 * factors, seed=seed).random(points))
    first, second = both[:, :factors], both[:, factors:]
    crossed = []
    for at in range(factors):  # SALib's order: A, A with column i of B, B, for each base point
        one = first.copy()
        one[:, at] = second[:, at]
        crossed.append(one)
    return np.stack([first, *crossed, second], axis=1).reshape(-1, factors)


def chunks(plan: Plan) -> Iterator[tuple[int, list[Point]]]:
    """All points, some at a time, with the number of the first."""
    for start in range(0, plan.count, CHUNK):
        yield start, plan.points(start, min(start + CHUNK, plan.count))
