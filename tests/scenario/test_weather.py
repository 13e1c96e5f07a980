"""The weather table of a scenario."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from emulator.config.yaml_source import fault_lines, parse
from emulator.errors import ScenarioError
from emulator.scenario.weather import WeatherConfig


def frozen(data: Any) -> Any:
    """Lists as tuples, as the scenario hands them over."""
    if isinstance(data, dict):
        return {key: frozen(value) for key, value in data.items()}
    return tuple(map(frozen, data)) if isinstance(data, list) else data


def faults(text: str) -> str:
    source = parse(text, Path("fog.yaml"), ScenarioError)
    with pytest.raises(ValidationError) as caught:
        WeatherConfig.model_validate(frozen(source.data))
    return "\n".join(fault_lines(source, WeatherConfig, caught.value))


def weather(text: str) -> WeatherConfig:
    return WeatherConfig.model_validate(frozen(parse(text, Path("fog.yaml"), ScenarioError).data))


@pytest.mark.parametrize(
    ("text", "reported"),
    [
        ("fog: {visibility_m: -20.0}", "fog.yaml:1: fog.visibility_m: -20.0; want a number > 0"),
        ("fog: {visibility_m: 0}", "fog.yaml:1: fog.visibility_m: 0; want a number > 0"),
        ("fog: {visibility_m: .nan}", "nan; want a finite number"),
        ('fog: {visibility_m: "20"}', "fog.visibility_m: '20'; want a number"),
        ("fog: {visibility_m: .inf}", "inf; want a finite number"),
        ("fog: {visibility_m: 20, mor_m: 15}", "want either visibility_m or mor_m"),
        ("fog: {}", "want either visibility_m or mor_m"),
        ("fog: {visibility_m: 20, law: kimm}", "fog.law: 'kimm'; want 'kim', 'kruse'"),
        ("rain:\n  rate_mm_h: -1", "fog.yaml:2: rain.rate_mm_h: -1; want a number >= 0"),
        ("rain: {rate_mm_h: 10, law: one_size}", "law one_size without drop_radius_mm"),
        ("rain: {rate_mm_h: 10, drop_radius_mm: 3.1}", "rain.drop_radius_mm: 3.1; want a number <= 3"),
        ("snow: {rate_mm_h: 1, kind: grey}", "snow.kind: 'grey'; want 'wet' or 'dry'"),
        ("rains: {rate_mm_h: 1}", "fog.yaml:1: rains: unknown key; did you mean rain?"),
        ("sun: {elevation_deg: 100}", "sun.elevation_deg: 100; want a number <= 90"),
        ("layers: [{top_m: 3}]", "empty; want"),
        ("layers: [{bottom_m: 4, top_m: 3, extinction_per_m: 0.1}]", "not above bottom_m"),
        ("plumes: [{at_m: [0, 0, 0], size_m: [1, 0, 1], smoke: {visibility_m: 5}}]", "plumes[0].size_m[1]: 0; want"),
        ("changes: [{t_s: 3}, {t_s: 3}]", "want rising t_s"),
        ("changes: [{fog: null}]", "changes[0].t_s: missing"),
    ],
)
def test_a_wrong_value_is_refused_by_file_line_and_key(text: str, reported: str) -> None:
    assert reported in faults(text)


def test_a_change_holds_from_its_time_on_and_what_it_does_not_name_goes_on() -> None:
    config = weather(
        "fog: {visibility_m: 200}\nrain: {rate_mm_h: 10}\nchanges:\n"
        "  - {t_s: 12, fog: {visibility_m: 50}}\n  - {t_s: 20, fog: null}\n"
    )
    seen = [state.fog.visibility_m if state.fog else None for state in map(config.at, (-5, 0, 11.999, 12, 19, 20, 99))]
    assert seen == [200, 200, 200, 50, 50, None, None]
    assert all(config.at(t_s).rain == config.rain for t_s in (0, 12, 20))


def test_a_drop_radius_alone_means_the_law_of_one_size() -> None:
    assert weather("rain: {rate_mm_h: 10, drop_radius_mm: 3}").rain.law_used == "one_size"  # type: ignore[union-attr]
    assert weather("rain: {rate_mm_h: 10}").rain.law_used == "carbonneau"  # type: ignore[union-attr]
