"""Designs that look at results: Monte Carlo until precise, boundary by bisection or refined sampling, worst case.

Belongs here: which points come next, and when it is enough. Not: running them: `evaluate` gives the rows of points.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from emulator.campaigns.designs import Drawn, of_unit
from emulator.campaigns.factors import Factor, Floats, Point, Values
from emulator.campaigns.file import Boundary, MonteCarlo, Worst
from emulator.campaigns.store import BROKEN, Row
from emulator.errors import EmulatorError

Evaluate = Callable[[Sequence[Point]], list[list[Row]]]
"Points -> the rows of the repeats of each. It numbers points as they come."
BATCH = 16
"Points asked for at a time by refined sampling: a fixed number, so that the points do not depend on the machine."
MOST_ROUNDS = 60


@dataclass(frozen=True)
class Interval:
    """An estimate with its confidence interval."""

    count: int
    estimate: float
    low: float
    high: float

    @property
    def half_width(self) -> float:
        """Half of it; infinite where there is none."""
        return (self.high - self.low) / 2.0


def wilson(passed: int, count: int, confidence: float = 0.95) -> Interval:
    """Interval of Wilson for a share, by scipy; all of [0, 1] without cases."""
    from scipy.stats import binomtest

    if not count:
        return Interval(0, math.nan, 0.0, 1.0)
    found = binomtest(passed, count).proportion_ci(confidence, "wilson")
    return Interval(count, passed / count, float(found.low), float(found.high))


def mean_interval(values: Floats, confidence: float = 0.95) -> Interval:
    """Student's interval of a mean; infinite below two values."""
    from scipy.stats import t

    count = len(values)
    if count < 2:
        return Interval(count, float(values.mean()) if count else math.nan, -math.inf, math.inf)
    mean, error = float(values.mean()), float(values.std(ddof=1)) / math.sqrt(count)
    reach = float(t.ppf(0.5 + confidence / 2.0, count - 1)) * error
    return Interval(count, mean, mean - reach, mean + reach)


def interval_of(rows: Iterable[Row], of: str, confidence: float) -> Interval:
    """Of the pass rate, or of the mean of a quantity; cases that did not come to their end count for nothing."""
    known = [row for row in rows if row["verdict"] not in BROKEN]
    if of == "pass":
        return wilson(sum(row["verdict"] == "passed" for row in known), len(known), confidence)
    values = [row["quantities"].get(of) for row in known]
    return mean_interval(np.array([one for one in values if one is not None], dtype=np.float64), confidence)


def until_precise(wanted: MonteCarlo, factors: Sequence[Factor], seed: int, evaluate: Evaluate) -> dict[str, Any]:
    """Random points until the interval is narrow enough; looked at only between batches of fixed sizes."""
    assert wanted.precision is not None
    precision, drawn = wanted.precision, Drawn(factors, seed, wanted.most)
    rows: list[Row] = []
    done, size = 0, min(wanted.least, wanted.most)
    while True:
        for one in evaluate(drawn.points(done, done + size)):
            rows += one
        done += size
        found = interval_of(rows, precision.of, precision.confidence)
        reached = found.half_width <= precision.half_width
        if reached or done >= wanted.most:
            break
        size = min(max(wanted.least, done // 4), wanted.most - done)
    return {
        "design": "monte_carlo", "of": precision.of, "confidence": precision.confidence, "reached": reached,
        "points": done, "estimate": found.estimate, "low": found.low, "high": found.high,
    }  # fmt: skip


def _passes(rows: Sequence[Row]) -> bool | None:
    """Whether at least half of the repeats of a point passed; None: one did not come to its end."""
    if any(row["verdict"] in BROKEN for row in rows):
        return None
    return bool(2 * sum(row["verdict"] == "passed" for row in rows) >= len(rows))


@dataclass
class _Bracket:
    """Between which values of the bisected factor the verdict changes, with the other factors as they are."""

    others: tuple[Values, ...]
    low: float | int
    high: float | int
    at_low: bool | None = None
    at_high: bool | None = None
    open: bool = True


def bisect(wanted: Boundary, factors: Sequence[Factor], evaluate: Evaluate) -> dict[str, Any]:
    """Where the verdict changes along one factor, for every combination of the others; a round a batch."""
    at = [one.name for one in factors].index(wanted.of or "")
    factor = factors[at]
    others = [one.grid() for number, one in enumerate(factors) if number != at]
    tolerance = wanted.tolerance or (factor.high - factor.low) / 1000.0
    low, high = factor.clean(factor.low), factor.clean(factor.high)
    brackets = [_Bracket(one, low, high) for one in itertools.product(*others)]

    def point(bracket: _Bracket, value: float) -> Point:
        return (*bracket.others[:at], (value,), *bracket.others[at:])

    ends = evaluate([point(one, value) for one in brackets for value in (low, high)])
    for number, one in enumerate(brackets):
        one.at_low, one.at_high = _passes(ends[2 * number]), _passes(ends[2 * number + 1])
        one.open = None not in (one.at_low, one.at_high) and one.at_low != one.at_high
    for _ in range(MOST_ROUNDS):
        asked: list[tuple[_Bracket, float | int]] = []
        for one in brackets:
            middle = math.sqrt(one.low * one.high) if factor.log else (one.low + one.high) / 2.0
            value = factor.clean(middle)
            if one.open and one.high - one.low > tolerance and one.low < value < one.high:
                asked.append((one, value))
        if not asked:
            break
        for (one, value), rows in zip(asked, evaluate([point(*pair) for pair in asked]), strict=True):
            passes = _passes(rows)
            if passes is None:
                one.open, one.at_low = False, None
            elif passes == one.at_low:
                one.low = value
            else:
                one.high = value
    names = [column for number, one in enumerate(factors) if number != at for column in one.columns]
    rows_: list[dict[str, Any]] = []
    for one in brackets:
        shown = dict(zip(names, [value for values in one.others for value in values], strict=True))
        if None in (one.at_low, one.at_high):
            state = "a case did not come to its end"
        elif one.at_low == one.at_high:
            state = "passes everywhere" if one.at_low else "fails everywhere"
        else:
            state = "passes below" if one.at_low else "passes above"
        rows_.append({"factors": shown, "low": one.low, "high": one.high, "state": state})
    return {"design": "boundary", "of": factor.name, "tolerance": tolerance, "found": rows_}


def refine(wanted: Boundary, factors: Sequence[Factor], evaluate: Evaluate) -> dict[str, Any]:
    """Points that gather where the verdict changes, over all factors: `adaptive`'s LearnerND on the pass rate."""
    try:
        from adaptive import LearnerND
    except ImportError:
        raise EmulatorError(
            "adaptive is missing; this design needs the extra: pip install 'lidaremu[campaign]'"
        ) from None
    learner = LearnerND(lambda unit: 0.0, bounds=[(0.0, 1.0)] * len(factors))
    done = 0
    while done < wanted.points:
        asked, _ = learner.ask(min(BATCH, wanted.points - done))
        points = of_unit(factors, np.array(asked, dtype=np.float64))
        for unit, rows in zip(asked, evaluate(points), strict=True):
            known = [row for row in rows if row["verdict"] not in BROKEN]
            share = sum(row["verdict"] == "passed" for row in known) / len(known) if known else 0.5
            learner.tell(unit, share)
        done += len(asked)
    return {"design": "boundary", "of": None, "points": done}


def worst(wanted: Worst, factors: Sequence[Factor], seed: int, evaluate: Evaluate) -> dict[str, Any]:
    """The smallest or largest quantity found: differential evolution of scipy, a generation a batch."""
    from scipy.optimize import differential_evolution
    from scipy.stats import qmc

    sign = 1.0 if wanted.find == "min" else -1.0
    width = len(factors)
    population = max(5, min(15 * width, wanted.points // 4))
    rounds = max(wanted.points // population - 1, 0)
    best: tuple[float, Row] | None = None

    def costs(units: Iterable[Floats]) -> list[float]:
        nonlocal best
        found = []
        points = of_unit(factors, np.clip(np.array(list(units), dtype=np.float64), 0.0, 1.0))
        for rows in evaluate(points):
            cost = math.inf
            for row in rows:
                value = row["quantities"].get(wanted.of)
                if row["verdict"] not in BROKEN and value is not None:
                    cost = min(cost, sign * value)
                    if best is None or sign * value < best[0]:
                        best = (sign * value, row)
            found.append(min(cost, 1e300))
        return found

    start = qmc.LatinHypercube(width, seed=seed).random(population)
    differential_evolution(
        lambda unit: 0.0, [(0.0, 1.0)] * width, init=start, maxiter=rounds, polish=False, updating="deferred",
        workers=lambda _, units: costs(units), tol=0.0, atol=0.0, seed=np.random.default_rng(seed),
    )  # fmt: skip
    if best is None:
        return {"design": "worst", "of": wanted.of, "find": wanted.find, "case": None}
    row = best[1]
    return {
        "design": "worst", "of": wanted.of, "find": wanted.find, "case": row["name"],
        "value": row["quantities"][wanted.of], "factors": row["factors"], "number": row["number"],
    }  # fmt: skip
