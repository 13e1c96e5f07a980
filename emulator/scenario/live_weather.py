"""Weather changed while a run lives: an order's table merged into what holds, judged, and put in its place in time.

Belongs here: what an order means. The outcome is a weather with one more entry in its `changes`, so that the same entry
in a scenario gives the same scans. Not: keys and bounds (weather), who orders it (orders, rig).
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from emulator.config.yaml_source import Source, fault_lines
from emulator.errors import ScenarioError
from emulator.scenario.checks import names_in_weather
from emulator.scenario.weather import Change, WeatherConfig

MOST_PAST = 64
"Changes that have been; of more, the oldest become the state at the beginning. No sweep still to come begins there."
LISTS = ("layers", "plumes")
NAME = "weather"


@dataclass(frozen=True)
class Changed:
    """What an order makes of the weather."""

    weather: WeatherConfig
    entry: dict[str, Any]
    "As it would stand in the scenario's `changes`."


def state_of(weather: WeatherConfig, t_s: float) -> dict[str, Any]:
    """What holds at `t_s`, in a scenario's own keys; what is still to come stands in `changes`."""
    state = _table(weather.at(t_s))
    state.pop("changes", None)
    coming = [_entry(change) for change in weather.changes if change.t_s > t_s]
    return state | ({"changes": coming} if coming else {})


def changed(weather: WeatherConfig, table: Mapping[str, Any], from_ns: int, actors: Sequence[str]) -> Changed:
    """The weather from `from_ns` on with `table` merged into what holds then; earlier orders' entries stay.

    A table given is laid over the one that holds, key by key; null ends a table, or a key of one; lists are replaced.
    `actors`: whom `spray.behind` may name. Raises `ScenarioError`, one line a fault.
    """
    t_s = from_ns * 1e-9
    for key in ("t_s", "changes"):
        if key in table:
            raise ScenarioError(f"{NAME}: {key}: {table[key]!r}; want this key omitted: orders take effect at once")
    same = next((change for change in weather.changes if change.t_s == t_s), None)
    fields = {} if same is None else {key: getattr(same, key) for key in same.model_fields_set}
    merged = _merged(weather.at(t_s), table)
    source = Source(Path(NAME), merged, {(): (Path(NAME), 0)})
    try:
        change = Change.model_validate_json(json.dumps({"t_s": t_s} | merged))
    except ValidationError as error:
        raise ScenarioError.of(fault_lines(source, Change, error)) from None
    unknown = [source.fault(*found) for found in names_in_weather(merged, (), actors)]
    if unknown:
        raise ScenarioError.of(unknown)
    fields |= {key: getattr(change, key) for key in change.model_fields_set}
    entry = Change.model_construct(_fields_set=set(fields), **fields)
    past = [one for one in weather.changes if one.t_s < t_s]
    coming = [one for one in weather.changes if one.t_s > t_s]
    if len(past) > MOST_PAST:
        weather = weather.at(past[-MOST_PAST - 1].t_s)
    made = weather.model_copy(update={"changes": (*past[-MOST_PAST:], entry, *coming)})
    return Changed(made, _entry(entry))


def _merged(holds: WeatherConfig, table: Mapping[str, Any]) -> dict[str, Any]:
    merged: dict[str, Any] = {}
    for key, given in table.items():
        before = getattr(holds, key, None) if key in WeatherConfig.model_fields else None
        if given is None:
            merged[key] = [] if key in LISTS else None
        elif isinstance(given, dict) and before is not None and key not in LISTS and hasattr(before, "model_dump"):
            merged[key] = _laid_over(_table(before), given)
        else:
            merged[key] = given
    return merged


def _laid_over(before: dict[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    found = {**before, **given}
    for one, other in (("visibility_m", "mor_m"), ("mor_m", "visibility_m")):
        if given.get(one) is not None and other not in given:
            found.pop(other, None)  # two words for one quantity
    return {key: value for key, value in found.items() if value is not None}


def _table(model: Any) -> dict[str, Any]:
    found: dict[str, Any] = model.model_dump(mode="json", by_alias=True, exclude_none=True)
    return {key: value for key, value in found.items() if key not in LISTS or value}


def _entry(change: Change) -> dict[str, Any]:
    """A change as a scenario has it: what it does not name goes on, null ends."""
    found = change.model_dump(mode="json", by_alias=True, include=set(change.model_fields_set) | {"t_s"})
    return {key: _without_none(value) for key, value in found.items()}


def _without_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_none(below) for key, below in value.items() if below is not None}
    return [_without_none(item) for item in value] if isinstance(value, list) else value
