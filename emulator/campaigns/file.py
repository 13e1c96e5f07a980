"""A campaign's YAML file: keys, limits, and every error as `file:line: key: found; want allowed`.

Belongs here: the models of the file and its reading. Not: what factors give (factors), which cases there are (designs).
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, ValidationError, model_validator

from emulator.config import yaml_lines
from emulator.config.tables import DescribedTable, Positive, Table
from emulator.config.yaml_source import fault_lines
from emulator.errors import ScenarioError

MOST_CASES = 10_000_000
MOST_FACTORS = 64

Count = Annotated[int, Field(gt=0, le=MOST_CASES)]
Share = Annotated[float, Field(gt=0.0, lt=1.0)]
Scalar = float | int | str | bool | None


class Distribution(Table):
    """A law by its name and parameters; see `factors.LAWS`."""

    model_config = ConfigDict(extra="allow")

    law: Literal["uniform", "loguniform", "normal", "lognormal", "triangular", "exponential", "weibull"]


class FactorTable(DescribedTable):
    """What is varied, and over what: one of values, range, distribution, table."""

    values: Annotated[tuple[Any, ...], Field(min_length=1, max_length=1_000_000)] | None = None
    range: Annotated[tuple[float, float], Field()] | None = None
    distribution: Distribution | None = None
    table: str | None = None
    "A CSV file, relative to this one, whose head names keys; with `column` one column of it."
    column: str | None = None
    steps: Annotated[int, Field(gt=1, le=1_000_000)] | None = None
    "Levels of a range or distribution in a grid."
    scale: Literal["linear", "log"] = "linear"
    whole: bool = False
    "Rounded to whole numbers."
    keys: tuple[str, ...] = ()
    "The keys that get the value, where the factor's name is none."

    @model_validator(mode="after")
    def _one_kind(self) -> FactorTable:
        given = [name for name in ("values", "range", "distribution", "table") if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(f"{' and '.join(given) or 'nothing'}; want one of values, range, distribution, table")
        if self.range is not None and not self.range[0] < self.range[1]:
            raise ValueError(f"range {list(self.range)}; want the lower bound first")
        if self.range is not None and self.scale == "log" and self.range[0] <= 0.0:
            raise ValueError(f"range {list(self.range)}; want bounds > 0 with scale: log")
        if self.column is not None and self.table is None:
            raise ValueError("column without table; want a table")
        if self.steps is not None and (self.values is not None or self.table is not None):
            raise ValueError("steps; want them with range or distribution alone")
        return self


class Points(Table):
    """A design of so many points."""

    points: Count


class Precision(Table):
    """Runs until a confidence interval is narrow enough."""

    of: str
    "`pass`, or the name of a quantity."
    half_width: Positive
    confidence: Share = 0.95


class MonteCarlo(Table):
    """Random points, until the precision is met or `most` are done; without a precision `points` of them."""

    points: Count | None = None
    precision: Precision | None = None
    least: Count = 32
    most: Count = 100_000

    @model_validator(mode="after")
    def _ends(self) -> MonteCarlo:
        if (self.points is None) is (self.precision is None):
            raise ValueError("want one of points, precision")
        return self


class Boundary(Table):
    """Where `expect` begins to fail."""

    of: str | None = None
    "The factor that is bisected, for every combination of the others; None: sampling refined over all ranges."
    tolerance: Positive | None = None
    "Width of the bracket at the end, in the factor's unit; by default a thousandth of its range."
    points: Count = 200
    "Without `of`: how many points are sampled."


class Worst(Table):
    """The case with the smallest or largest quantity."""

    of: str
    find: Literal["min", "max"] = "min"
    points: Count = 200


class Design(Table):
    """One of them."""

    grid: Table | None = None
    lhs: Points | None = None
    sobol: Points | None = None
    saltelli: Points | None = None
    monte_carlo: MonteCarlo | None = None
    boundary: Boundary | None = None
    worst: Worst | None = None

    @model_validator(mode="after")
    def _one(self) -> Design:
        given = sorted(self.model_fields_set)
        if len(given) != 1:
            raise ValueError(f"{' and '.join(given) or 'nothing'}; want one of {', '.join(DESIGNS)}")
        return self

    @property
    def kind(self) -> str:
        """Its name."""
        return next(iter(self.model_fields_set))


DESIGNS = tuple(Design.model_fields)
ADAPTIVE = ("boundary", "worst")
"Designs whose cases depend on earlier ones; so do those of monte_carlo with a precision."


class Limits(DescribedTable):
    """What one case, and all of them, may take."""

    seconds: Positive = 300.0
    "Real time of one case; then it counts as hung. [s]"
    disk_mb: Annotated[float, Field(ge=0.0)] = 256.0
    "Of all recordings together. [MB]"


class CampaignFile(DescribedTable):
    """Everything that a campaign is made of."""

    scenario: str
    "A path relative to this file, or a built-in name."
    set_: dict[str, Any] = Field(default_factory=dict, alias="set")
    "Keys of the scenario that are changed in every case."
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    repeats: Annotated[int, Field(gt=0, le=100_000)] = 1
    "Runs of each point, each with a seed of its own."
    factors: Annotated[dict[str, FactorTable], Field(max_length=MOST_FACTORS)] = Field(default_factory=dict)
    design: Design
    expect: tuple[dict[str, Any], ...] | None = None
    "In place of the scenario's own."
    quantities: dict[str, str] = Field(default_factory=dict)
    "Numbers of each case, as expressions of the expectations' language."
    record: Literal["failed", "all", "none"] = "failed"
    limits: Limits = Field(default_factory=Limits)


def read(path: Path) -> tuple[CampaignFile, yaml_lines.Source]:
    """The file's model, and where its keys stand; `ScenarioError` has a line for each fault."""
    source = yaml_lines.read(path, ScenarioError)
    data = source.data
    if not isinstance(data, dict):
        raise ScenarioError(
            f"{path}:1: file: {'empty' if data is None else 'no table'}; want scenario, factors, design"
        )
    data = {**data, "design": _whole(data["design"])} if "design" in data else data
    source = yaml_lines.Source(source.path, data, source.places)
    try:
        found = CampaignFile.model_validate(_frozen(data))
    except ValidationError as error:
        raise ScenarioError.of(fault_lines(source, CampaignFile, error)) from None
    reported = [
        _reported(source, ("quantities", name), name, "a name, not `pass`")
        for name in found.quantities
        if name == "pass"
    ]
    for name, factor in found.factors.items():
        if factor.whole and factor.values is not None:
            reported.append(_reported(source, ("factors", name, "whole"), "true", "it with range or distribution"))
    reported += list(_references(found, source))
    if reported:
        raise ScenarioError.of(reported)
    return found, source


def _reported(source: yaml_lines.Source, loc: yaml_lines.Loc, found: str, want: str) -> str:
    return source.fault(loc, found, want)


def _references(found: CampaignFile, source: yaml_lines.Source) -> list[str]:
    """What a design names must be there."""
    reported, design, kind = [], found.design, found.design.kind
    known = ", ".join(found.quantities) or "a quantity: there is none, see quantities"
    if design.monte_carlo is not None and design.monte_carlo.precision is not None:
        wanted_of = design.monte_carlo.precision.of
        if wanted_of != "pass" and wanted_of not in found.quantities:
            reported.append(source.fault(("design", kind, "precision", "of"), repr(wanted_of), f"pass or {known}"))
        if design.monte_carlo.most < design.monte_carlo.least:
            reported.append(source.fault(("design", kind, "most"), str(design.monte_carlo.most), "least or more"))
    if design.worst is not None and design.worst.of not in found.quantities:
        reported.append(source.fault(("design", kind, "of"), repr(design.worst.of), known))
    ranges = [name for name, one in found.factors.items() if one.range is not None or one.distribution is not None]
    if design.boundary is not None:
        of = design.boundary.of
        if of is not None and (of not in found.factors or found.factors[of].range is None):
            wanted = ", ".join(name for name, one in found.factors.items() if one.range is not None)
            reported.append(
                source.fault(("design", kind, "of"), repr(of), wanted or "a factor with a range: there is none")
            )
    searched = design.worst is not None or (design.boundary is not None and design.boundary.of is None)
    if searched and (len(ranges) != len(found.factors) or not ranges):
        other = next((name for name in found.factors if name not in ranges), None)
        loc: yaml_lines.Loc = ("factors",) if other is None else ("factors", other)
        reported.append(source.fault(loc, "not a range", f"ranges or distributions alone for design {kind}"))
    if design.boundary is not None and of is None and len(ranges) == 1 and len(found.factors) == 1:
        reported.append(source.fault(("design", kind), "no of", f"of: {ranges[0]}, which is bisected"))
    if not found.factors and design.monte_carlo is None:
        reported.append(source.fault(("factors",), "none", "at least one factor, or design monte_carlo over seeds"))
    return reported


def _whole(design: Any) -> Any:
    """`grid` and `{lhs: 200}` in their long forms."""
    if isinstance(design, str):
        return {design: {}}
    if isinstance(design, dict):
        return {
            key: {"points": value} if isinstance(value, int) and not isinstance(value, bool) else value or {}
            for key, value in design.items()
        }
    return design


def _frozen(data: Any) -> Any:
    if isinstance(data, dict):
        return {key: _frozen(value) for key, value in data.items()}
    return tuple(_frozen(value) for value in data) if isinstance(data, list) else data


def thawed(data: Any) -> Any:
    """Plain lists again, as a scenario has them."""
    if isinstance(data, dict):
        return {key: thawed(value) for key, value in data.items()}
    return [thawed(value) for value in data] if isinstance(data, tuple | list) else data
