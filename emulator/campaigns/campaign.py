"""A campaign from its file to its last row: planned, checked, run, resumed, counted.

Belongs here: the order of things. Not: how a case is run (case), where (engines), what is shown of it (page, table).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from emulator.campaigns import searching
from emulator.campaigns.designs import Plan, chunks, plan_of
from emulator.campaigns.engines import Engine
from emulator.campaigns.factors import Factor, Point, factors_of
from emulator.campaigns.file import CampaignFile, read, thawed
from emulator.campaigns.naming import OF_DRIVER, Case, Job, cases_of, digest_of, version
from emulator.campaigns.store import Row, Store
from emulator.config import overrides
from emulator.config.expressions import ExpressionError, names, parse
from emulator.config.yaml_lines import Source
from emulator.errors import EmulatorError, ScenarioError
from emulator.judging.expectations import understand
from emulator.judging.trial import rehearse
from emulator.scenario.quantities import check_name
from emulator.scenario.scenario import builtin_names, dump, read_source

MOST_TRIED = 24
"Levels of a factor that are checked before the first case."
MB = 1e6


@dataclass(frozen=True)
class Campaign:
    """What a file asks for."""

    path: Path
    file: CampaignFile
    factors: tuple[Factor, ...]
    job: Job
    plan: Plan | None
    "None: later points depend on the results of earlier ones."
    expect: tuple[str, ...]
    "Names of what every case is judged by."

    @property
    def count(self) -> int | None:
        """Cases of the plan; None: not known before the end."""
        return None if self.plan is None else self.plan.count * self.file.repeats

    def cases(self) -> Iterator[Case]:
        """All of the plan, in its order."""
        assert self.plan is not None
        for first, points in chunks(self.plan):
            yield from cases_of(self.job, first, points)

    def names(self) -> set[str]:
        """Of the plan's cases."""
        return {case.name for case in self.cases()}


def load(path: Path, out: Path, driver: Sequence[str] = (), points: int | None = None) -> Campaign:
    """The campaign of a file, checked; `ScenarioError` has a line for each fault.

    `driver`: the command of a host that is run against each case. `points`: instead of those of the file's design.
    """
    found, source = read(path)
    if points is not None:
        found = _resized(found, points)
    reported: list[str] = []
    base: Source | None = None
    try:
        base = _base(found, source)
    except ScenarioError as error:
        reported += [
            f"{source.place(('scenario',))}: scenario: {line}" if ":" not in line else line for line in error.lines
        ]
    factors: tuple[Factor, ...] = ()
    plan: Plan | None = None
    try:
        factors = factors_of(found, source)
        plan = plan_of(found, factors, f"{source.place(('design',))}: design.{found.design.kind}")
    except ScenarioError as error:
        reported += error.lines
    if base is not None:
        reported += _lost(found, factors, base, source)
    if reported or base is None:
        raise ScenarioError.of(reported)
    job = Job(
        base, factors, found.seed, found.repeats, _salted(found, plan),
        tuple(found.quantities.items()), tuple(driver), found.record, found.limits.seconds, out.absolute(), version(),
    )  # fmt: skip
    job = replace(job, digest=digest_of(job))
    return Campaign(path, found, factors, job, plan, _check(found, source, job))


def _salted(found: CampaignFile, plan: Plan | None) -> bool:
    return plan.salted if plan is not None else found.design.kind == "monte_carlo"


def _resized(found: CampaignFile, points: int) -> CampaignFile:
    kind = found.design.kind
    table = getattr(found.design, kind)
    if "points" not in type(table).model_fields:
        raise ScenarioError(f"--points {points}: design {kind} has no number of points; want one that has")
    return found.model_copy(
        update={"design": found.design.model_copy(update={kind: table.model_copy(update={"points": points})})}
    )


def _base(found: CampaignFile, source: Source) -> Source:
    """The scenario with what every case has; label of each change is its line in the campaign."""
    near = source.path.parent / found.scenario
    name = found.scenario if not near.exists() and found.scenario in builtin_names() else str(near)
    values: list[tuple[str, Any, str]] = [
        (key, thawed(value), f"{source.place(('set', key))}: set.{key}") for key, value in found.set_.items()
    ]
    if found.expect is not None:
        values.append(("expect", thawed(found.expect), f"{source.place(('expect',))}"))
    return overrides.placed(read_source(name), values)


def _lost(found: CampaignFile, factors: Sequence[Factor], base: Source, source: Source) -> list[str]:
    """Keys that are given, and then given again, or with all that holds them: the first value would never be used."""
    given = [(key, f"{source.place(('set', key))}: set.{key}") for key in found.set_]
    given += [("expect", f"{source.place(('expect',))}: expect")] if found.expect is not None else []
    given += [(key, one.label) for one in factors for key in dict.fromkeys(key for keys in one.keys for key in keys)]
    reported = [
        f"{source.place(('set', key))}: set.{key}: each case has a seed of its own; want seed beside scenario"
        for key in found.set_
        if key == "seed"
    ]
    before: list[tuple[tuple[str | int, ...], str]] = []
    for key, label in given:
        place = overrides.location(base.data, key)
        reported += [
            f"{label}: {'' if label.endswith(key) else key + ' '}replaces {where.rpartition(': ')[2]}; want one of them"
            for other, where in before
            if other[: len(place)] == place
        ]
        before.append((place, label))
    return reported


def _check(found: CampaignFile, source: Source, job: Job) -> tuple[str, ...]:
    """What a case would refuse, before the first: each factor's levels and ends; names of what is judged."""
    usual = tuple(_tried(one)[0] for one in job.factors)
    reported: list[str] = []

    def attempt(point: Point) -> Any:
        try:
            loaded = job.changed(point, 0)
            rehearse(loaded)
            return loaded
        except EmulatorError as error:
            reported.extend(line for line in error.lines if line not in reported)
            return None

    loaded = attempt(usual)
    for at, factor in enumerate(job.factors):
        if any(line.startswith(f"{factor.label}:") for line in reported):
            continue
        for values in _tried(factor)[1:]:
            attempt((*usual[:at], values, *usual[at + 1 :]))
    if reported:
        raise ScenarioError.of(reported)
    sensors = [sensor.id for sensor in loaded.sensors]
    actors = ["world", *(actor.id for actor in loaded.actors)]
    for name, text in found.quantities.items():
        if text.startswith(OF_DRIVER):
            if not job.driver:
                place = source.place(("quantities", name))
                reported.append(f"{place}: quantities.{name}: {text!r} without a driver; want --driver COMMAND")
            continue
        try:
            for one in names(parse(text)):
                check_name(one, sensors, actors)
        except ExpressionError as error:
            reported.append(f"{source.place(('quantities', name))}: quantities.{name}: {text!r}: {error}")
    expected = tuple(dict.fromkeys(one.name for one in understand(loaded)))
    kind = found.design.kind
    judged = kind == "boundary" or (
        found.design.monte_carlo is not None
        and found.design.monte_carlo.precision is not None
        and found.design.monte_carlo.precision.of == "pass"
    )
    if judged and not expected and not job.driver:
        reported.append(f"{source.place(('design', kind))}: design.{kind}: nothing is expected; want expect")
    if reported:
        raise ScenarioError.of(reported)
    return expected


def _tried(factor: Factor) -> list[tuple[Any, ...]]:
    if factor.continuous:
        return factor.at(np.array([0.0, 1.0])) if factor.law is None else factor.at(np.array([0.5, 1e-6, 1.0 - 1e-6]))
    return list(factor.levels[:: -(-len(factor.levels) // MOST_TRIED)])


@dataclass(frozen=True)
class Shard:
    """One part of several, by the names of cases."""

    number: int = 1
    of: int = 1

    def has(self, name: str) -> bool:
        """Whether a case is its."""
        return self.of == 1 or int(name[:12], 16) % self.of == self.number - 1


@dataclass
class Progress:
    """How far it is."""

    planned: int | None
    before: int = 0
    "Done by earlier runs."
    now: int = 0
    verdicts: Counter[str] = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        self.verdicts = Counter()


class Runner:
    """Runs what is not done yet."""

    def __init__(
        self,
        campaign: Campaign,
        store: Store,
        engine: Engine,
        shard: Shard | None = None,
        again: bool = False,
        tell: Callable[[Progress], None] = lambda progress: None,
    ) -> None:
        """`again`: those that did not come to their end are run again. `tell`: after each case."""
        self.campaign, self._store, self._engine = campaign, store, engine
        self._shard, self._again, self._tell = shard or Shard(), again, tell
        self.progress = Progress(campaign.count)
        self._bytes = store.recorded_bytes()
        self._number = 0
        self._searched: set[str] = set()
        self._planned: set[str] | None = None
        "Names of the whole plan, once it was gone through."
        if campaign.plan is None and self._shard.of > 1:
            raise EmulatorError(
                f"--shard: design {campaign.file.design.kind} looks at results as they come; want a design whose points"
                " are known before, or one run with more --jobs"
            )

    def _may_record(self) -> bool:
        return self.campaign.file.record != "none" and self._bytes < self.campaign.file.limits.disk_mb * MB

    def _run(self, cases: Iterator[Case]) -> Iterator[Row]:
        for row in self._engine.run(self.campaign.job, cases, self._may_record):
            self.progress.now += 1
            self.progress.verdicts[row["verdict"]] += 1
            self._bytes += row["recording_bytes"]
            self._tell(self.progress)
            yield row

    def run(self) -> dict[str, Any] | None:
        """Run all; what the design found, None where it only has points."""
        if self.campaign.plan is None:
            return self._search()
        done = self._store.done(self._again)
        if self._shard.of > 1:
            self.progress.planned = sum(map(self._shard.has, self.campaign.names()))
        for _ in self._run(self._left(done)):
            pass
        return None

    def _left(self, done: set[str]) -> Iterator[Case]:
        planned: set[str] = set()
        for case in self.campaign.cases():
            planned.add(case.name)
            if not self._shard.has(case.name):
                continue
            if case.name in done:
                self.progress.before += 1
                continue
            done.add(case.name)
            yield case
        self._planned = planned

    def evaluate(self, points: Sequence[Point]) -> list[list[Row]]:
        """The rows of points, those that are done read, the others run."""
        job = self.campaign.job
        cases = list(cases_of(job, self._number, points))
        self._number += len(points)
        rows: dict[str, Row] = {}
        left: dict[str, Case] = {}
        for case in cases:
            known = self._store.row(case.name)
            if known is None or (self._again and known["verdict"] in ("error", "crashed", "hung")):
                left[case.name] = case
            else:
                rows[case.name] = known
                self.progress.before += case.name not in self._searched
        for row in self._run(iter(left.values())):
            rows[row["name"]] = row
        self._searched |= set(rows)
        size = job.repeats
        return [[rows[case.name] for case in cases[at : at + size]] for at in range(0, len(cases), size)]

    def _search(self) -> dict[str, Any]:
        found, factors = self.campaign.file, self.campaign.factors
        design = found.design
        if design.monte_carlo is not None:
            return searching.until_precise(design.monte_carlo, factors, found.seed, self.evaluate)
        if design.worst is not None:
            outcome = searching.worst(design.worst, factors, found.seed, self.evaluate)
            if outcome["case"] is not None:
                outcome["scenario"] = str(self.write_scenario(outcome["case"], self.campaign.job.out / "worst.yaml"))
            return outcome
        assert design.boundary is not None
        if design.boundary.of is not None:
            return searching.bisect(design.boundary, factors, self.evaluate)
        return searching.refine(design.boundary, factors, self.evaluate)

    def names(self) -> set[str]:
        """Of the cases that this campaign is made of, as far as known."""
        if self.campaign.plan is None:
            return self._searched
        return self.campaign.names() if self._planned is None else self._planned

    def write_scenario(self, name: str, path: Path) -> Path:
        """The scenario of a case that is done, as a file that `lidaremu test` runs to the same sha256."""
        return write_scenario(self.campaign, self._store, name, path)


def write_scenario(campaign: Campaign, store: Store, name: str, path: Path) -> Path:
    """As `Runner.write_scenario`; raises `EmulatorError`."""
    row = store.row(name)
    if row is None:
        raise EmulatorError(f"{name}: no such case in {store.root}; want a name from results")
    values = row["factors"]
    try:
        point = tuple(tuple(values[column] for column in one.columns) for one in campaign.factors)
    except KeyError as error:
        raise EmulatorError(
            f"{name}: of a campaign without factor {error}; want the file that it was run with"
        ) from None
    loaded = campaign.job.changed(point, row["seed"])
    head = f"# Case {name}: {row['verdict']}, sha256 {row['sha256']}\n"
    try:
        path.write_text(head + dump(loaded), encoding="utf-8")
    except OSError as error:
        raise EmulatorError(f"{path}: cannot be written: {error.strerror}") from None
    return path
