"""Who turns plans into scans: what all of them have in common, and measuring in place (virtual time, tests).

Not: worker processes (`worker`), how they are started, judged and replaced (`supervision`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from typing import Protocol, runtime_checkable

from emulator.measuring.conditions import NORMAL, Conditions
from emulator.measuring.parts import PartOfScan
from emulator.scenario.weather import WeatherConfig
from protocols.scan import Scan, ScanPlan

Measure = Callable[..., Scan]
"Of a plan, and of the conditions where they are not `NORMAL`."
BuildMeasures = Callable[[], Mapping[str, Measure]]
"Builds the measuring function of every sensor; must be picklable or inherited by fork."


class Measures(dict[str, Measure]):
    """Measuring functions by sensor, and what their scene warns of."""

    def __init__(self, functions: Mapping[str, Measure], warnings: Sequence[str] = ()) -> None:
        super().__init__(functions)
        self.warnings = tuple(warnings)


def warnings_of(measures: Mapping[str, Measure]) -> tuple[str, ...]:
    """What is computed all the same but outside the range where it is known to hold, one line each, by sensor."""
    found = dict.fromkeys(getattr(measures, "warnings", ()))
    for sensor, measure in measures.items():
        found |= dict.fromkeys(f"{sensor}: {text}" for text in getattr(measure, "warnings", ()))
    return tuple(found)


class Reported:
    """Passes on every warning once."""

    def __init__(self) -> None:
        self._known: set[str] = set()

    def new(self, texts: Sequence[str]) -> list[str]:
        fresh = [text for text in texts if text not in self._known]
        self._known.update(fresh)
        return fresh


def measured(measure: Measure, plan: ScanPlan, conditions: Conditions) -> Scan:
    """One sweep under its conditions."""
    return measure(plan) if conditions is NORMAL or conditions == NORMAL else measure(plan, conditions)


def part_measured(
    measure: Measure, plan: ScanPlan, conditions: Conditions, number: int, of: int, in_time: bool = False
) -> PartOfScan | Scan | None:
    """One of several parts of a sweep, or slices of it; where there are no parts, the first is all of it and the others
    are nothing, while each slice is all of it: what holds may be another thing by then."""
    in_parts = getattr(measure, "part", None)
    found: PartOfScan | None = None if in_parts is None else in_parts(plan, conditions, number, of, in_time)
    if found is not None:
        return found
    return None if number and not in_time else measured(measure, plan, conditions)


def refusals(measures: Mapping[str, Measure], sensors: Sequence[str], weather: WeatherConfig) -> dict[str, str]:
    """Which of these sensors cannot compute such weather, and why; one that lists objects is as its sources."""
    found = {name: getattr(measures[name], "refuses", lambda _: "")(weather) for name in sensors}
    return {name: why for name, why in found.items() if why}


def states(measures: Mapping[str, Measure]) -> dict[str, object]:
    """What measuring functions remember from sweep to sweep, by sensor: of those that remember anything."""
    return {name: measure.state() for name, measure in measures.items() if hasattr(measure, "state")}


def restore(measures: Mapping[str, Measure], found: Mapping[str, object]) -> None:
    """Have them go on from what others of the same scenario remembered."""
    for name, state in found.items():
        measures[name].restore(state)  # type: ignore[attr-defined]


class NotMeasured(Scan):
    """Stands for a sweep that was asked for and will not come: its device may choose another one."""


@runtime_checkable
class Judges(Protocol):
    """Who measures and can say what it cannot."""

    def judge(self, weather: WeatherConfig) -> Sequence[Future[dict[str, str]]]:
        """`refusals` of all sensors, in parts that come when whoever measures gets round to it."""


class InPlace:
    """Measures when asked, in the caller's own time."""

    def __init__(self, measures: Mapping[str, Measure]) -> None:
        self._measures = measures
        self._done: dict[str, list[Scan]] = {}
        self._reported = Reported()
        self.warnings: list[str] = self._reported.new(warnings_of(measures))
        "What is not yet passed on; whoever does empties it."

    def request(self, sensor: str, plan: ScanPlan, conditions: Conditions = NORMAL) -> None:
        self._done.setdefault(sensor, []).append(measured(self._measures[sensor], plan, conditions))
        self.warnings += self._reported.new(warnings_of({sensor: self._measures[sensor]}))

    def collect(self, sensor: str) -> list[Scan]:
        return self._done.pop(sensor, [])

    def judge(self, weather: WeatherConfig) -> list[Future[dict[str, str]]]:
        found: Future[dict[str, str]] = Future()
        found.set_result(refusals(self._measures, list(self._measures), weather))
        return [found]
