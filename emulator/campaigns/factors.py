"""Factors: which keys of the scenario vary, and the values that a number between 0 and 1 stands for.

Belongs here: levels, ranges, laws, tables from CSV. Not: which numbers are drawn (designs).
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from emulator.campaigns.file import CampaignFile, Distribution, FactorTable, thawed
from emulator.config import yaml_lines
from emulator.errors import ScenarioError

Floats = NDArray[np.float64]
Values = tuple[Any, ...]
"A value for each column of a factor."
Point = tuple[Values, ...]
"Values of every factor."

DIGITS = ".10g"
"Of a continuous value: libraries of two machines may differ in the last place, names of cases must not."
MOST_ROWS = 1_000_000
LAWS: Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "uniform": (("low", "high"), ()),
    "loguniform": (("low", "high"), ()),
    "normal": (("mean", "std"), ("low", "high")),
    "lognormal": (("median", "sigma"), ()),
    "triangular": (("low", "mode", "high"), ()),
    "exponential": (("mean",), ()),
    "weibull": (("scale", "shape"), ()),
}
"Law -> its parameters, and those that may be left out."


@dataclass(frozen=True)
class Factor:
    """One factor, understood."""

    name: str
    columns: tuple[str, ...]
    "Heads of its values in the results."
    keys: tuple[tuple[str, ...], ...]
    "Keys of the scenario that get each of them."
    label: str
    "`file:line: factors.name`."
    levels: tuple[Values, ...] = ()
    "Empty: continuous."
    low: float = 0.0
    high: float = 1.0
    log: bool = False
    law: Any = None
    "A frozen law of scipy.stats."
    steps: int | None = None
    whole: bool = False

    @property
    def continuous(self) -> bool:
        """Whether it has no levels of its own."""
        return not self.levels

    @property
    def numeric(self) -> bool:
        """Whether its values are numbers of one column."""
        return self.continuous or (
            len(self.columns) == 1
            and all(isinstance(one[0], int | float) and not isinstance(one[0], bool) for one in self.levels)
        )

    def at(self, unit: Floats) -> list[Values]:
        """Values of numbers in [0, 1)."""
        if self.levels:
            last = len(self.levels) - 1
            return [self.levels[min(int(one), last)] for one in np.asarray(unit) * len(self.levels)]
        return [(self.clean(one),) for one in self.continuous_at(unit).tolist()]

    def continuous_at(self, unit: Floats) -> Floats:
        """The same as numbers; of a continuous factor."""
        unit = np.asarray(unit, dtype=np.float64)
        if self.law is not None:
            inside = np.clip(unit, 1e-12, 1.0 - 1e-12)
            return np.asarray(self.law.ppf(inside), dtype=np.float64)
        if self.log:
            return np.asarray(self.low * (self.high / self.low) ** unit, dtype=np.float64)
        return np.asarray(self.low + (self.high - self.low) * unit, dtype=np.float64)

    def clean(self, value: float) -> float | int:
        """A continuous value as it is written into the scenario."""
        return round(value) if self.whole else float(format(value, DIGITS))

    def grid(self) -> tuple[Values, ...]:
        """Its levels in a grid; of a law the middles of parts that are equally likely."""
        if self.levels:
            return self.levels
        if self.steps is None:
            raise ScenarioError(f"{self.label}: continuous, without steps; want steps for a grid")
        unit = (np.arange(self.steps) + 0.5) / self.steps if self.law is not None else np.linspace(0, 1, self.steps)
        return (
            tuple(dict.fromkeys(self.at(unit)))
            if self.law is not None
            else tuple(dict.fromkeys((self.clean(one),) for one in self.continuous_at(unit).tolist()))
        )

    def changes(self, values: Values) -> list[tuple[str, Any]]:
        """Keys of the scenario and what they get."""
        return [(key, value) for keys, value in zip(self.keys, values, strict=True) for key in keys]


def factors_of(found: CampaignFile, source: yaml_lines.Source) -> tuple[Factor, ...]:
    """All factors of a file; `ScenarioError` has a line for each fault."""
    reported: list[str] = []
    made: list[Factor] = []
    for name, table in found.factors.items():
        label = f"{source.place(('factors', name))}: factors.{name}"
        try:
            made.append(_factor(name, table, label, source.path.parent))
        except ScenarioError as error:
            reported += error.lines
    columns = [column for one in made for column in one.columns]
    for twice in sorted({one for one in columns if columns.count(one) > 1}):
        reported.append(f"{source.place(('factors',))}: factors: {twice} given twice; want each key in one factor")
    if reported:
        raise ScenarioError.of(reported)
    return tuple(made)


def _factor(name: str, table: FactorTable, label: str, folder: Path) -> Factor:
    keys = (table.keys or (name,),)
    if table.values is not None:
        levels = tuple((thawed(value),) for value in table.values)
        return Factor(name, (name,), keys, label, levels)
    if table.table is not None:
        return _from_csv(name, table, label, folder)
    if table.range is not None:
        low, high = table.range
        return Factor(name, (name,), keys, label, (), low, high, table.scale == "log", None, table.steps, table.whole)
    assert table.distribution is not None
    law = _law(table.distribution, label)
    low, high = map(float, law.ppf([1e-6, 1.0 - 1e-6]))
    return Factor(name, (name,), keys, label, (), low, high, False, law, table.steps, table.whole)


def _law(given: Distribution, label: str) -> Any:
    from scipy import stats

    found = dict(given.model_extra or {})
    needed, optional = LAWS[given.law]
    label = f"{label}.distribution"
    for key, value in found.items():
        if key not in (*needed, *optional):
            raise ScenarioError(f"{label}.{key}: unknown key; want one of {', '.join((*needed, *optional))}")
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ScenarioError(f"{label}.{key}: {value!r}; want a number")
    for key in needed:
        if key not in found:
            raise ScenarioError(f"{label}: {given.law} without {key}; want {', '.join(needed)}")
    low, high = found.get("low", -np.inf), found.get("high", np.inf)
    if not low < high:
        raise ScenarioError(f"{label}: low {low:g}, high {high:g}; want low below high")
    for key in ("std", "median", "sigma", "scale", "shape"):
        if key in found and found[key] <= 0:
            raise ScenarioError(f"{label}.{key}: {found[key]:g}; want a number > 0")
    match given.law:
        case "uniform":
            return stats.uniform(low, high - low)
        case "loguniform":
            if low <= 0:
                raise ScenarioError(f"{label}.low: {low:g}; want a number > 0")
            return stats.loguniform(low, high)
        case "normal":
            mean, std = found["mean"], found["std"]
            return stats.truncnorm((low - mean) / std, (high - mean) / std, loc=mean, scale=std)
        case "lognormal":
            return stats.lognorm(found["sigma"], scale=found["median"])
        case "triangular":
            if not low <= found["mode"] <= high:
                raise ScenarioError(f"{label}.mode: {found['mode']:g}; want it between low and high")
            return stats.triang((found["mode"] - low) / (high - low), loc=low, scale=high - low)
        case "exponential":
            if found["mean"] <= 0:
                raise ScenarioError(f"{label}.mean: {found['mean']:g}; want a number > 0")
            return stats.expon(scale=found["mean"])
    return stats.weibull_min(found["shape"], scale=found["scale"])


def _from_csv(name: str, table: FactorTable, label: str, folder: Path) -> Factor:
    assert table.table is not None
    path = folder / table.table
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            rows = []
            for row in csv.reader(file):
                rows += [row] if row else []
                if len(rows) > MOST_ROWS + 1:
                    raise ScenarioError(f"{label}.table: {path}: more rows than {MOST_ROWS}; want a shorter table")
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        reason = getattr(error, "strerror", None) or error
        raise ScenarioError(f"{label}.table: {path}: {reason}; want a CSV file in UTF-8") from None
    if len(rows) < 2:
        raise ScenarioError(f"{label}.table: {path}: no rows; want a head that names keys, and rows")
    head = [one.strip() for one in rows[0]]
    for number, row in enumerate(rows[1:], 2):
        if len(row) != len(head):
            raise ScenarioError(f"{path}:{number}: {len(row)} cells; want {len(head)}, as the head")
    cells = [
        [yaml_lines.parse_value(cell, f"{path}:{number}", ScenarioError) for cell in row]
        for number, row in enumerate(rows[1:], 2)
    ]
    if table.column is not None:
        if table.column not in head:
            raise ScenarioError(f"{label}.column: {table.column!r}; want one of {', '.join(head)}")
        at = head.index(table.column)
        return Factor(name, (name,), (table.keys or (name,),), label, tuple((row[at],) for row in cells))
    if len(set(head)) != len(head) or not all(head):
        raise ScenarioError(f"{path}:1: {', '.join(head)}; want a different key in each column")
    return Factor(name, tuple(head), tuple((one,) for one in head), label, tuple(map(tuple, cells)))


def shown(factors: Sequence[Factor], point: Point) -> dict[str, Any]:
    """Column -> value, as the results have it."""
    return {
        column: value
        for factor, values in zip(factors, point, strict=True)
        for column, value in zip(factor.columns, values, strict=True)
    }
