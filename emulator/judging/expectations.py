"""The `expect` list of a scenario: checked before a run, judged after it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from emulator.config.expressions import ExpressionError, Name, Node, Value, evaluate, names, parse
from emulator.errors import ScenarioError
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


def understand(scenario: Scenario) -> list[Expected]:
    """The expectations of a scenario; `ScenarioError` has a line for each fault."""
    sensors = [sensor.id for sensor in scenario.sensors]
    actors = ["world", *(actor.id for actor in scenario.actors)]
    told: list[str] = []
    found: list[Expected] = []
    for index, item in enumerate(scenario.expect):
        extra = dict(item.model_extra or {}) | ({} if item.within is None else {"within": item.within})
        for key in set(extra) - set(KEYS):
            told.append(str(scenario.fault(f"expect.{index}.{key}", extra[key], f"that, {', '.join(KEYS)}")))
        try:
            tree = parse(item.that)
            for name in names(tree):
                check_name(name, sensors, actors)
        except ExpressionError as error:
            told.append(f"{scenario.label(f'expect.{index}.that')}: {item.that!r}: {error}")
            continue
        try:
            found.append(_expected(item.that, tree, extra))
        except ExpressionError as error:
            told.append(f"{scenario.label(f'expect.{index}')}: {error}")
    if told:
        raise ScenarioError.of(told)
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
    wanted = _told_bounds(expected)
    try:
        value = np.asarray(evaluate(expected.tree, lookup))
    except ExpressionError as error:
        return Judgement(expected.name, False, str(error), wanted)
    if not expected.bounded:
        if value.dtype != bool:
            return Judgement(expected.name, False, _told(value), "true or false; give within, equals or a comparison")
        return Judgement(expected.name, bool(value.size and value.all()), _told(value), wanted)
    number = value.astype(np.float64)
    held = bool(number.size) and bool(np.all((number >= expected.lowest) & (number <= expected.highest)))
    return Judgement(expected.name, held, _told(value), wanted)


def _told_bounds(expected: Expected) -> str:
    if not expected.bounded:
        return "true"
    if expected.lowest == expected.highest:
        return f"{expected.lowest:g}"
    if expected.highest == np.inf:
        return f"at least {expected.lowest:g}"
    if expected.lowest == -np.inf:
        return f"at most {expected.highest:g}"
    return f"{expected.lowest:g} to {expected.highest:g}"


def _told(value: np.ndarray) -> str:
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


def verdicts(expected: Sequence[Expected], lookup_in: Callable[[int, int], Callable[[Name], Value]]) -> list[Judgement]:
    """All of them; `lookup_in` gives the names' values within a window of time."""
    return [judge(item, lookup_in(item.from_ns, item.to_ns)) for item in expected]
