"""The weather of a run over time, as numbers: the scenario's own changes, and those ordered while it ran.

Belongs here: from tables to steps. Not: what weather does (sensing), how steps are drawn (figures).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from emulator.errors import EmulatorError
from emulator.run_report.gather import Happening
from emulator.scenario.scenario import Scenario
from emulator.scenario.weather import WeatherConfig

QUANTITIES: Mapping[str, tuple[str, tuple[str, ...], str]] = {
    "fog": ("fog_visibility_m", ("visibility_m", "mor_m"), "visibility in fog [m]"),
    "dust": ("dust_visibility_m", ("visibility_m", "mor_m"), "visibility in dust [m]"),
    "smoke": ("smoke_visibility_m", ("visibility_m", "mor_m"), "visibility in smoke [m]"),
    "rain": ("rain_mm_h", ("rate_mm_h",), "rain [mm/h]"),
    "snow": ("snow_mm_h", ("rate_mm_h",), "snow, melted [mm/h]"),
    "sun": ("sun_w_m2", ("total_w_m2",), "sun [W/m²]"),
    "sun's height": ("sun_elevation_deg", ("elevation_deg",), "sun's height [deg]"),
    "spray": ("spray_extinction_per_m", ("extinction_per_m",), "extinction of spray [1/m]"),
    "visibility_m": ("air_visibility_m", (), "visibility of the air [m]"),
    "layers": ("layers", (), "layers"),
    "plumes": ("plumes", (), "plumes"),
}
"Key of the weather -> head of its column, keys of its table that may hold the number, words. Of volumes their number."


MOST_ROUNDS = 1000
"Of a scenario that begins again: so many are reported."


@dataclass(frozen=True)
class Step:
    """What holds from an instant on."""

    t_s: float
    ordered: bool
    "By whoever drove the run; False: the scenario's own."
    values: Mapping[str, float | None]
    "By head of column; None: there is none of it."


def steps(scenario: Scenario, orders: Sequence[Happening], end_s: float) -> list[Step]:
    """Every state of the weather up to the end of the run, in order of time."""
    actors = [actor.id for actor in scenario.actors]
    weather, round_s = scenario.weather, scenario.round_s
    found = _states(weather, 0.0, min(end_s, round_s or end_s), False)
    if round_s and weather.changes:
        for number in range(1, min(MOST_ROUNDS, math.ceil(end_s / round_s))):
            until_s = min(end_s, (number + 1) * round_s)
            more = _states(weather.later(number * round_s), number * round_s, until_s, False)
            found += more[1:] if more and found and more[0].values == found[-1].values else more
    for order in orders:
        table = order.row.get("change")
        if not isinstance(table, Mapping):
            continue
        from_ns = round(float(table.get("t_s", order.at_ns * 1e-9)) * 1e9)
        from_s = from_ns * 1e-9  # to the bit as the change has it
        if round_s and weather is scenario.weather:  # an order ends the rounds of the weather, in the one that it is in
            weather = weather.later(from_ns // round(round_s * 1e9) * round_s)
        weather = _ordered(weather, table, from_ns, actors)
        found = [step for step in found if step.t_s < from_s] + _states(weather, from_s, end_s, True)
    return found


def _ordered(weather: WeatherConfig, table: Mapping[str, Any], from_ns: int, actors: Sequence[str]) -> WeatherConfig:
    from emulator.scenario.live_weather import changed

    plain = {key: value for key, value in table.items() if key not in ("t_s", "changes")}
    try:
        return changed(weather, plain, from_ns, actors).weather
    except EmulatorError:  # of another version
        return weather


def _states(weather: WeatherConfig, from_s: float, end_s: float, ordered: bool) -> list[Step]:
    times = [from_s, *(change.t_s for change in weather.changes if from_s < change.t_s <= end_s)]
    return [Step(t_s, ordered and t_s == from_s, _values(weather.at(t_s))) for t_s in times]


def _values(weather: WeatherConfig) -> dict[str, float | None]:
    values: dict[str, float | None] = {}
    for name, (head, keys, _) in QUANTITIES.items():
        table = getattr(weather, "sun" if name == "sun's height" else name)
        if not keys:
            values[head] = (float(len(table)) or None) if isinstance(table, tuple) else table
            continue
        numbers = [] if table is None else [getattr(table, key, None) for key in keys]
        values[head] = next((float(number) for number in numbers if number is not None), None)
    return values
