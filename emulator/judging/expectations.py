"""The `expect` list of a scenario: checked before a run, judged after it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from emulator.config.expressions import ExpressionError, Name, Node, Value, evaluate, names, parse
from emulator.errors import ScenarioError
from emulator.instrument.instrument import Instrument
from emulator.instrument.series import SeriesWatcher, lookup, spans
from emulator.judging.blame import active, blame
from emulator.scenario.quantities import check_name
from emulator.scenario.scenario import Scenario

KEYS = ("within", "equals", "at_least", "at_most", "from_s", "to_s", "name")
"""What an expectation has beside `that`. One of the first four bounds a number, or every value of a series; without it
`that` must be true or false. `from_s`, `to_s`: the part of the run that it looks at."""
BOUNDS = ("within", "equals", "at_least", "at_most")


@dataclass(frozen=True)
class Expected:
    """One expectation, understood."""

    text: str
    tree: Node
    lowest: float
    highest: float
    bounded: bool
    from_ns: int
    to_ns: int
    name: str


@dataclass(frozen=True)
class Judgement:
    """Whether one expectation held."""

    name: str
    held: bool
    found: str
    wanted: str
    value: float | None = None
    "Of one that failed: the value that broke it, and when that was. [s]"
    at_s: float | None = None
    until_s: float | None = None
    "Where it belongs to a time rather than an instant."
    sensor: str = ""
    "Whose value it was."
    active: tuple[str, ...] = ()
    "Faults, changes of the weather and late sweeps at that time."

    @property
    def reported(self) -> str:
        """Why it failed, in one line; of one that held, what was found."""
        text = f"{self.found}; expected {self.wanted}"
        if self.at_s is not None:
            until = "" if self.until_s is None else f" to {self.until_s:.3f} s"
            value = "" if self.value is None else f": {self.value:.6g}"
            text += f"; at {self.at_s:.3f} s{until}{value}"
        return text + (f"; active then: {', '.join(self.active)}" if self.active else "")

    def as_json(self) -> dict[str, Any]:
        """For a report; what is not known is left out."""
        kept = ("name", "held", "found", "wanted")
        return {key: value for key, value in asdict(self).items() if key in kept or value not in (None, (), "")}


class Judgements(list[Judgement]):
    """The verdict on all of them: false when one has failed."""

    def __init__(self, found: Iterable[Judgement] = (), warnings: Iterable[str] = ()) -> None:
        super().__init__(found)
        self.warnings = tuple(warnings)
        "What is doubtful, as a sensor that is silent at the end."

    def __bool__(self) -> bool:
        return all(item.held for item in self)

    def __str__(self) -> str:
        failed = [item for item in self if not item.held]
        lines = [f"failed: {len(failed)} of {len(self)} expectations"] if failed else [f"passed: {len(self)}"]
        lines += [f"  {item.name}: {item.reported}" for item in failed]
        return "\n".join(lines + [f"  warning: {text}" for text in self.warnings])

    __repr__ = __str__

    def check(self) -> None:
        """`AssertionError` that says what failed, when and why; nothing when all hold."""
        if not self:
            raise AssertionError(str(self))


def understand(scenario: Scenario) -> list[Expected]:
    """The expectations of a scenario; `ScenarioError` has a line for each fault."""
    sensors = [sensor.id for sensor in scenario.sensors]
    actors = ["world", *(actor.id for actor in scenario.actors)]
    reported: list[str] = []
    found: list[Expected] = []
    for index, item in enumerate(scenario.expect):
        extra = dict(item.model_extra or {}) | ({} if item.within is None else {"within": item.within})
        for key in set(extra) - set(KEYS):
            reported.append(str(scenario.fault(f"expect.{index}.{key}", extra[key], f"that, {', '.join(KEYS)}")))
        try:
            tree = parse(item.that)
            for name in names(tree):
                check_name(name, sensors, actors)
        except ExpressionError as error:
            reported.append(f"{scenario.label(f'expect.{index}.that')}: {item.that!r}: {error}")
            continue
        try:
            found.append(_expected(item.that, tree, extra))
        except ExpressionError as error:
            reported.append(f"{scenario.label(f'expect.{index}')}: {error}")
    if reported:
        raise ScenarioError.of(reported)
    return found


def _number(extra: Mapping[str, Any], key: str, default: float) -> float:
    value = extra.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ExpressionError(f"{key}: {value!r}; want a number")
    return float(value)


def _expected(text: str, tree: Node, extra: Mapping[str, Any]) -> Expected:
    given = [key for key in BOUNDS if key in extra]
    if len(given) > 1 and given != ["at_least", "at_most"]:
        raise ExpressionError(f"{' and '.join(given)}; want one of {', '.join(BOUNDS)}, or at_least and at_most")
    lowest, highest = _number(extra, "at_least", -np.inf), _number(extra, "at_most", np.inf)
    if "within" in extra:
        lowest, highest = map(float, extra["within"])
    if "equals" in extra:
        lowest = highest = _number(extra, "equals", 0.0)
    if lowest > highest:
        raise ExpressionError(f"{lowest:g} to {highest:g}; want the lower bound first")
    from_s, to_s = _number(extra, "from_s", 0.0), _number(extra, "to_s", 1e9)
    name = extra.get("name", text)
    if not isinstance(name, str):
        raise ExpressionError(f"name: {name!r}; want a text")
    return Expected(text, tree, lowest, highest, bool(given), int(from_s * 1e9), int(to_s * 1e9), name)


def judge(expected: Expected, lookup: Callable[[Name], Value]) -> Judgement:
    """Whether it holds; a value that is missing does not."""
    wanted = _bounds_text(expected)
    try:
        value = np.asarray(evaluate(expected.tree, lookup))
    except ExpressionError as error:
        return Judgement(expected.name, False, str(error), wanted)
    if not expected.bounded:
        if value.dtype != bool:
            return Judgement(
                expected.name, False, _reported(value), "true or false; give within, equals or a comparison"
            )
        return Judgement(expected.name, bool(value.size and value.all()), _reported(value), wanted)
    number = value.astype(np.float64)
    held = bool(number.size) and bool(np.all((number >= expected.lowest) & (number <= expected.highest)))
    return Judgement(expected.name, held, _reported(value), wanted)


def _bounds_text(expected: Expected) -> str:
    if not expected.bounded:
        return "true"
    if expected.lowest == expected.highest:
        return f"{expected.lowest:g}"
    if expected.highest == np.inf:
        return f"at least {expected.lowest:g}"
    if expected.lowest == -np.inf:
        return f"at most {expected.highest:g}"
    return f"{expected.lowest:g} to {expected.highest:g}"


def _reported(value: np.ndarray) -> str:
    if value.dtype == bool:
        return str(bool(value.all())).lower() if value.size else "no values"
    if not value.ndim:
        number = float(value)
        return "no value" if number != number else f"{number:.6g}"
    if not value.size:
        return "no values"
    known = value[~np.isnan(value)]
    span = f"{known.min():.6g} to {known.max():.6g}" if known.size else "all missing"
    return f"{value.size} values, {span}" + (f", {value.size - known.size} missing" if known.size < value.size else "")


@dataclass(frozen=True)
class Run:
    """What a run has left for those who judge it."""

    scenario: Scenario
    watcher: SeriesWatcher
    instruments: Mapping[str, Instrument]
    end_ns: int

    @property
    def actors(self) -> tuple[str, ...]:
        """Names of what beams meet."""
        return ("world", *(actor.id for actor in self.scenario.actors))

    def lookup(self, from_ns: int = 0, to_ns: int | None = None) -> Callable[[Name], Value]:
        """The names' values within a window of time."""
        end_ns = self.end_ns if to_ns is None else min(to_ns, self.end_ns)
        return lookup(self.watcher, self.instruments, self.actors, from_ns, end_ns, self.end_ns)

    def judge(self, expected: Expected) -> Judgement:
        """Whether one expectation held, and why not."""
        values = self.lookup(expected.from_ns, expected.to_ns)
        judged = judge(expected, values)
        if judged.held:
            return judged
        to_ns = min(expected.to_ns, self.end_ns)
        when = spans(self.watcher, self.instruments, self.actors, expected.from_ns, to_ns)
        found = blame(expected.tree, expected.lowest, expected.highest, values, when)
        if found is None:
            return judged
        name = found.name.parts[0]
        known = None if np.isnan(found.value) else found.value
        until_s = None if found.to_ns == found.from_ns else round(found.to_ns * 1e-9, 9)
        around = active(self.scenario, self.watcher, name, found.from_ns, found.to_ns)
        return replace(
            judged, sensor=name, value=known, at_s=round(found.from_ns * 1e-9, 9), until_s=until_s, active=around
        )

    def silences(self) -> list[str]:
        """A line for each sensor that is silent at the end although hosts are owed scans."""
        reported = []
        for sensor in self.watcher.sensors:
            silent_s = float(np.asarray(self.lookup()(Name((sensor, "silent_s")))))
            if silent_s > 0.0:
                end_s = self.end_ns * 1e-9
                around = active(self.scenario, self.watcher, sensor, round((end_s - silent_s) * 1e9), self.end_ns)
                why = f"; active: {', '.join(around)}" if around else ""
                reported.append(f"{sensor}: silent at the end, no scan for {silent_s:.3f} s of {end_s:g} s{why}")
        return reported


def verdicts(expected: Sequence[Expected], run: Run) -> Judgements:
    """All of them, and a warning for each sensor that has died."""
    return Judgements((run.judge(item) for item in expected), run.silences())
