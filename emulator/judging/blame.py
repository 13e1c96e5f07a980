"""Why an expectation failed: the value that broke it, when that was, and what was active then.

Belongs here: the way from an expression's tree to one value of one name. Not: when the values of a name were
(`instrument.series`), what an expectation wants (expectations).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from emulator.config.expressions import Binary, Call, ExpressionError, Name, Node, Unary, Value, evaluate, names, truth
from emulator.faults.catalogue import kinds
from emulator.instrument.series import SensorSeries, SeriesWatcher
from emulator.scenario.scenario import Scenario
from protocols.session import Dropped, DropReason

Lookup = Callable[[Name], Value]
Mask = np.ndarray[tuple[int, ...], np.dtype[Any]]
Culprit = tuple[Name, int | None]
"A name, and which of its values; None: it has one."

NEAR_NS = 50_000_000
"What hit a scan so shortly before or after an instant belongs to it: a scan is on its way for some time."
MOST_ACTIVE = 8
"Things that a message names; of more, how many there were."


@dataclass(frozen=True)
class Blamed:
    """One value that broke an expectation."""

    name: Name
    value: float
    from_ns: int
    to_ns: int
    "The same where it belongs to an instant."


def blame(
    tree: Node,
    lowest: float,
    highest: float,
    lookup: Lookup,
    span_of: Callable[[Name, int | None, int], tuple[int, int] | None],
) -> Blamed | None:
    """The value to which a failed expectation is due; None where no instant can be reported.

    `span_of(name, index, lean)`: when a value was; `lean` > 0: the name's value is too high, < 0: too low.
    """
    try:
        value = np.asarray(evaluate(tree, lookup))
        found, lean = _first(tree, value, lowest, highest, lookup)
    except (ExpressionError, ValueError):
        return None
    if found is None:
        return None
    name, index = found
    values = np.asarray(lookup(name), dtype=np.float64)
    span = span_of(name, index, lean)
    if span is None:
        return None
    return Blamed(name, float(values if index is None else values[index]), *span)


def _first(tree: Node, value: Mask, lowest: float, highest: float, lookup: Lookup) -> tuple[Culprit | None, int]:
    if value.dtype == bool:
        found = _search(tree, 0, lookup, ~value if value.ndim else None)
        return found, _lean_of(tree, lookup)
    number = value.astype(np.float64)
    if number.ndim:
        return _search(tree, 0, lookup, ~((number >= lowest) & (number <= highest))), 0
    lean = 1 if number > highest else -1
    return _search(tree, lean, lookup), lean


def _lean_of(tree: Node, lookup: Lookup) -> int:
    """Whether the left side of a comparison is too high or too low."""
    if not isinstance(tree, Binary) or tree.sign in ("and", "or", "+", "-", "*", "/"):
        return 0
    left, right = (np.asarray(evaluate(side, lookup), dtype=np.float64) for side in (tree.left, tree.right))
    lean = 1 if left.ndim == 0 and right.ndim == 0 and left > right else -1
    return lean if isinstance(tree.left, Name | Call) else -lean


def _search(node: Node, lean: int, lookup: Lookup, mask: Mask | None = None) -> Culprit | None:
    """The name in a tree, and the place in its series. `mask`: places of which the first is meant."""
    if mask is not None:
        if not mask.any():
            return None
        for name in names(node):
            if np.shape(lookup(name)) == mask.shape:
                return name, int(np.argmax(mask))
        mask = None  # of a name that has been reduced
    if isinstance(node, Name):
        values = np.asarray(lookup(node), dtype=np.float64)
        return (node, None) if not values.ndim else _picked(node, values, _extreme(values, lean), lookup)
    if isinstance(node, Call):
        return _in_call(node, lean, lookup)
    if isinstance(node, Unary):
        return _search(node.operand, -lean if node.sign == "-" else 0, lookup)
    if isinstance(node, Binary):
        return _in_pair(node, lean, lookup)
    return None


def _in_pair(node: Binary, lean: int, lookup: Lookup) -> Culprit | None:
    if node.sign in ("and", "or"):
        for side in (node.left, node.right):
            value = np.asarray(evaluate(side, lookup))
            if not truth(evaluate(side, lookup)):
                return _search(side, 0, lookup, ~value if value.ndim else None)
        return _search(node.left, 0, lookup)
    if node.sign in ("+", "-", "*", "/"):
        return _search(node.left, lean, lookup) or _search(
            node.right, -lean if node.sign in ("-", "/") else lean, lookup
        )
    value = np.asarray(evaluate(node, lookup))
    if value.ndim:
        return _search(node, 0, lookup, ~value)
    left, right = (float(np.asarray(evaluate(side, lookup))) for side in (node.left, node.right))
    lean = 1 if left > right else -1
    return _search(node.left, lean, lookup) or _search(node.right, -lean, lookup)


def _in_call(node: Call, lean: int, lookup: Lookup) -> Culprit | None:
    inner = node.arguments[0]
    value = np.asarray(evaluate(inner, lookup))
    if not value.ndim or not value.size:
        return _search(inner, lean, lookup)
    if value.dtype == bool:
        return _search(inner, 0, lookup, value if node.function == "count" and lean > 0 else ~value)
    numbers = value.astype(np.float64)
    known = np.flatnonzero(~np.isnan(numbers))
    if not len(known):
        return _picked(inner, numbers, 0, lookup)
    place = {
        "max": lambda: _extreme(numbers, 1),
        "min": lambda: _extreme(numbers, -1),
        "first": lambda: int(known[0]),
        "last": lambda: int(known[-1]),
        "abs": lambda: _extreme(np.abs(numbers), 1),
    }.get(node.function, lambda: _extreme(numbers, lean))()
    return _picked(inner, numbers, place, lookup)


def _extreme(values: Mask, lean: int) -> int:
    if not values.size or np.all(np.isnan(values)):
        return 0
    return int(np.nanargmin(values) if lean < 0 else np.nanargmax(values))


def _picked(node: Node, values: Mask, place: int, lookup: Lookup) -> Culprit | None:
    mask = np.zeros(values.shape, dtype=bool)
    if not mask.size:
        found = next(iter(names(node)), None)
        return None if found is None else (found, None)
    mask[place] = True
    return _search(node, 0, lookup, mask)


# ---------------------------------------------------------------- what was active


def active(scenario: Scenario, watcher: SeriesWatcher, sensor: str, from_ns: int, to_ns: int) -> tuple[str, ...]:
    """Faults of a sensor and of those it has its objects from, sweeps that came late, and the weather's last change."""
    sources = next((one.from_ for one in scenario.sensors if one.id == sensor), ())
    found: list[str] = []
    for one in (sensor, *sources):
        reported = [*_faults(watcher.sensors[one], from_ns, to_ns), *_late(watcher.sensors[one], from_ns, to_ns)]
        found += reported if one == sensor else [f"{one}: {text}" for text in reported]
    changes = [change for change in scenario.weather.changes if change.t_s * 1e9 <= to_ns]
    if changes:
        keys = ", ".join(sorted(changes[-1].model_fields_set - {"t_s"}))
        found.append(f"weather changed at {changes[-1].t_s:g} s ({keys})")
    left = len(found) - MOST_ACTIVE
    return (*found[:MOST_ACTIVE], f"{left} more") if left > 0 else tuple(found)


def _faults(series: SensorSeries, from_ns: int, to_ns: int) -> list[str]:
    reported = []
    for number, fault in series.faults.items():
        if fault.begun_ns > to_ns or (fault.ended_ns is not None and fault.ended_ns < from_ns):
            continue
        kind = kinds().get(fault.name)
        if kind is not None and kind.lasts == "telegrams":
            hits = [at for at, of in series.hits if of == number and from_ns - NEAR_NS <= at <= to_ns + NEAR_NS]
            reported += [f"fault {fault.name}, hit at {hits[0] * 1e-9:.3f} s"] if hits else []
            continue
        until = "" if fault.ended_ns is None else f" to {fault.ended_ns * 1e-9:.3f} s"
        reported.append(f"fault {fault.name} from {fault.begun_ns * 1e-9:.3f} s{until}")
    return reported


def _late(series: SensorSeries, from_ns: int, to_ns: int) -> list[str]:
    count = sum(
        event.count
        for event in series.events
        if isinstance(event, Dropped)
        and event.reason is DropReason.LATE
        and from_ns - NEAR_NS <= event.at_ns <= to_ns + NEAR_NS
    )
    return [f"{count} sweep{'s' * (count != 1)} measured too late"] if count else []
