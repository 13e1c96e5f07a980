"""How much of a result's variance each factor explains: Sobol indices by SALib.

Belongs here: first-order and total indices. Not: their drawing (page).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from emulator.campaigns.campaign import Campaign
from emulator.campaigns.factors import Floats
from emulator.campaigns.table import Results

LEAST, LEAST_GIVEN = 64, 256
"Points below which nothing is said: of Saltelli's design, and of others, whose estimates are noisier."
MOST_POINTS = 16_384
"Of other designs than Saltelli's, for which the intervals are found by 100 resamplings."


@dataclass(frozen=True)
class Index:
    """Of one factor for one result, with half widths of 95 % intervals; NaN: not known from this design."""

    factor: str
    first: float
    first_error: float
    total: float = math.nan
    total_error: float = math.nan


def indices(campaign: Campaign, results: Results, of: str) -> list[Index]:
    """One for each factor; none where the design or the library does not allow it.

    From a Saltelli design first-order and total indices; from other random designs the first-order ones by RBD-FAST.
    """
    try:
        from SALib.analyze import rbd_fast, sobol
    except ImportError:
        return []
    kind, names = campaign.file.design.kind, [one.name for one in campaign.factors]
    random = kind in ("lhs", "sobol", "saltelli") or (kind == "monte_carlo" and bool(names))
    if not random or len(results) < LEAST:
        return []
    numbers, values = _means(results, of)
    if len(values) < LEAST or np.isnan(values).all() or float(np.nanstd(values)) == 0.0:
        return []
    problem = {"num_vars": len(names), "names": names, "bounds": [[0.0, 1.0]] * len(names)}
    if kind == "saltelli":
        plan = campaign.plan
        if plan is None or len(numbers) != plan.count or np.isnan(values).any():
            return []
        found = sobol.analyze(problem, values, calc_second_order=False, seed=0)
        return [
            Index(name, *map(float, (found["S1"][at], found["S1_conf"][at], found["ST"][at], found["ST_conf"][at])))
            for at, name in enumerate(names)
        ]
    if len(numbers) > MOST_POINTS:
        chosen = np.linspace(0, len(numbers) - 1, MOST_POINTS).astype(np.int64)
        numbers, values = numbers[chosen], values[chosen]
    columns = [one.columns[0] for one in campaign.factors]
    first = np.searchsorted(results.number, numbers)
    points = np.column_stack([results.factors[one][first] for one in columns])
    known = ~np.isnan(values) & ~np.isnan(points).any(axis=1)
    if known.sum() < LEAST_GIVEN:
        return []
    found = rbd_fast.analyze(problem, points[known], values[known], M=10, seed=0)
    return [Index(name, float(found["S1"][at]), float(found["S1_conf"][at])) for at, name in enumerate(names)]


def _means(results: Results, of: str) -> tuple[Floats, Floats]:
    """Number of each point, and the mean over its repeats."""
    numbers, at = np.unique(results.number, return_inverse=True)
    values = results.value(of)
    sums = np.bincount(at, weights=values)
    return numbers.astype(np.float64), sums / np.bincount(at)
