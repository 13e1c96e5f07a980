"""Weather changed by an order: merged, judged, and the same run as one whose file has the change."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from emulator.errors import ScenarioError
from emulator.instrument.observer import Observer
from emulator.judging.trial import Trial
from emulator.measuring.conditions import NORMAL, Conditions
from emulator.runtime.control import Later
from emulator.runtime.orders import Orders
from emulator.scenario import scenario
from emulator.scenario.live_weather import MOST_PAST, changed, state_of
from emulator.scenario.weather import WeatherConfig
from protocols.scan import Scan, ScanPlan

CASE = """\
schema: 1
seed: 5
duration_s: 1.15
world:
  - {plane: {size_m: [9, 60]}, at_m: [12, 0, 1], pitch_deg: -90, material: white_plaster}
actors:
  - {id: van, class: car, shape: {box: {size_m: [3, 2, 2]}}, material: white_plaster, motion: {at_m: [9, 4, 0]}}
weather: {fog: {visibility_m: 400, law: kruse}, sun: {elevation_deg: 30}, changes: [{t_s: 1.1, sun: null}]}
sensors:
  - {id: front, model: sick-lms291-s05, mount: {at_m: [0, 0, 1]}, device: {resolution_deg: 1, field_deg: 100, unit: cm}}
  - {id: list, model: can-ars408, mount: {at_m: [0, 0, 1]}, from: [front]}
"""
ORDER = {"fog": {"visibility_m": 20}, "rain": {"rate_mm_h": 5}}


def trial(text: str = CASE, workers: int = 0) -> Trial:
    return Trial(scenario.loads(text, Path("case.yaml")), workers)


def orders_of(made: Trial) -> Orders:
    """Orders to a trial; only its instruments and its time are asked for."""

    class Stand:
        now_ns = property(lambda self: made.run.clock.now_ns())

    orders = Orders(Stand(), made.instruments, made.run.clock, made.scenario)  # type: ignore[arg-type]
    return orders


def weather(**tables: Any) -> WeatherConfig:
    return WeatherConfig.model_validate_json(json.dumps(tables))


class Plans(Observer):
    """Keeps the plans of scans."""

    def __init__(self, plans: list[ScanPlan]) -> None:
        self.plans = plans

    def scan(self, sensor: str, scan: Scan) -> None:
        self.plans.append(scan.plan)


@pytest.mark.parametrize("workers", [0, 2])
def test_an_order_gives_the_same_bytes_as_its_entry_among_the_changes_of_a_file(workers: int) -> None:
    live = trial(workers=workers)
    live.run.advance(500_000_000)
    reported: Any = orders_of(live).weather(ORDER)
    live.run.advance(800_000_000)
    orders = orders_of(live)
    orders._weather = live.instruments[0].conditions.weather or WeatherConfig()
    second: Any = orders.weather({"fog": {"mor_m": 15}})
    one = live.finish()
    live.close()

    entries: list[dict[str, Any]] = []
    for instrument in live.instruments:
        assert instrument.conditions.weather is not None
    for change in live.instruments[0].conditions.weather.changes:  # type: ignore[union-attr]
        entries.append(change.model_dump(mode="json", exclude_unset=True, exclude_none=change.t_s < 1.1))
    assert [entry["t_s"] for entry in entries] == [reported["from_s"], second["from_s"], 1.1]
    assert 0.5 <= reported["from_s"] <= 0.76
    start, _, rest = CASE.partition("changes: [{t_s: 1.1, sun: null}]")
    again = trial(start + f"changes: {json.dumps(entries)}" + rest)
    assert again.finish().sha256 == one.sha256
    again.close()
    never = trial()
    assert never.finish().sha256 != one.sha256
    never.close()


def test_what_a_sensor_sees_changes_with_the_next_sweep_asked_for() -> None:
    made = trial()
    made.run.advance(500_000_000)
    asked_ns = max(one.asked_ns for one in made.instruments)
    reported: Any = orders_of(made).weather({"fog": {"visibility_m": 8}})
    assert reported["from_s"] == (asked_ns + 1) * 1e-9
    made.finish()
    sweeps = made.series.sensors["front"].measured.values()
    before = [np.isfinite(one.range_m).mean() for one in sweeps if one.at_ns <= asked_ns]
    after = [(one.range_m > 8.5).sum() for one in sweeps if one.at_ns > asked_ns]
    assert min(before) > 0.9
    assert max(after) < 3
    made.close()


def test_the_air_is_made_again_only_when_the_weather_differs(monkeypatch: pytest.MonkeyPatch) -> None:
    from emulator.runtime.assembly import build_measures
    from emulator.sensing import measure as module

    measure: Any = build_measures(scenario.loads(CASE, Path("case.yaml")))["front"]
    made: list[WeatherConfig] = []
    whole = module.Air
    plans: list[ScanPlan] = []
    run = trial()
    run.instruments[0].watch(Plans(plans))
    run.run.advance(400_000_000)
    run.close()
    monkeypatch.setattr(module, "Air", lambda config, *rest: made.append(config) or whole(config, *rest))
    plan = plans[0]
    own = measure(plan)
    for _ in range(2):
        foggy = measure(plan, Conditions(changed(weather(), {"fog": {"visibility_m": 9}}, 0, ()).weather))
    assert len(made) == 1
    assert np.isfinite(foggy.range_m).sum() < 5 < 90 < np.isfinite(own.range_m).sum()
    assert np.array_equal(measure(plan).range_m, own.range_m, equal_nan=True)
    refused = Conditions(weather(rain={"rate_mm_h": 150, "echoes": "drops", "drop_radius_mm": 0.25}))
    dense: Scan = measure(plan, refused)
    if any("changed weather is not used" in text for text in measure.warnings):
        assert np.array_equal(dense.range_m, own.range_m, equal_nan=True)


def test_a_table_is_laid_over_the_one_that_holds() -> None:
    start = weather(fog={"mor_m": 100, "law": "kruse"}, rain={"rate_mm_h": 4, "wets": True}, snow={"rate_mm_h": 1})
    found = changed(start, {"fog": {"visibility_m": 50}, "rain": {"rate_mm_h": 9}, "snow": None}, 2_000_000_000, ())
    assert found.weather.at(1.9) == start.at(1.9)
    now = state_of(found.weather, 2.0)
    assert now["fog"]["visibility_m"] == 50
    assert now["fog"]["law"] == "kruse"
    assert "mor_m" not in now["fog"]
    assert (now["rain"]["rate_mm_h"], now["rain"]["wets"]) == (9, True)
    assert "snow" not in now
    assert found.entry["t_s"] == 2.0
    assert found.entry["snow"] is None
    assert set(found.entry) == {"t_s", "fog", "rain", "snow"}


def test_two_orders_at_one_instant_are_one_entry_and_what_the_file_has_later_stays() -> None:
    start = weather(changes=[{"t_s": 3.0, "rain": {"rate_mm_h": 1}}])
    found = changed(start, {"fog": {"visibility_m": 50}}, 10**9, ())
    found = changed(
        found.weather, {"rain": {"rate_mm_h": 2}, "layers": [{"top_m": 2, "extinction_per_m": 0.1}]}, 10**9, ()
    )
    found = changed(found.weather, {"layers": None}, 10**9, ())
    assert [one.t_s for one in found.weather.changes] == [1.0, 3.0]
    assert set(found.entry) == {"t_s", "fog", "rain", "layers"}
    assert found.entry["layers"] == []
    state = state_of(found.weather, 1.0)
    assert [one["t_s"] for one in state["changes"]] == [3.0]


def test_a_thousand_orders_do_not_grow_what_goes_with_a_plan() -> None:
    found = weather()
    for number in range(1_000):
        found = changed(found, {"fog": {"visibility_m": 10 + number}}, number, ()).weather
    assert len(found.changes) == MOST_PAST + 1
    assert found.at(999e-9).fog.visibility_m == 1009  # type: ignore[union-attr]
    assert found.at(0.0).fog is not None


@pytest.mark.parametrize(
    ("table", "reported"),
    [
        ({"fog": {"visibility_m": -20.0}}, "weather: fog.visibility_m: -20.0; want a number > 0"),
        ({"fog": {"visibilty_m": 20.0}}, "did you mean visibility_m?"),
        ({"fogg": {"visibility_m": 20.0}}, "weather: fogg: unknown key; did you mean fog?"),
        ({"fog": 3}, "weather: fog: 3; want keys with values"),
        ({"rain": {"rate_mm_h": "much"}}, "weather: rain.rate_mm_h: 'much'; want a number"),
        ({"rain": {"rate_mm_h": float("nan")}}, "weather: rain.rate_mm_h: nan; want a finite number"),
        ({"rain": {"law": "one_size", "rate_mm_h": 2}}, "drop_radius_mm"),
        ({"spray": {"behind": ["lorry"]}}, "weather: spray.behind[0]: 'lorry'; want one of van"),
        ({"t_s": 4}, "weather: t_s: 4; want this key omitted"),
        ({"changes": []}, "weather: changes: []; want this key omitted"),
        ({"layers": [{"top_m": 1}]}, "empty; want"),
        ({"fog": {"visibility_m": 10, "mor_m": 10}}, "either visibility_m or mor_m"),
    ],
)
def test_an_order_that_cannot_be_is_told_and_changes_nothing(table: dict[str, Any], reported: str) -> None:
    made = trial()
    orders = orders_of(made)
    with pytest.raises(ScenarioError) as caught:
        orders.weather(table)
    assert reported in str(caught.value)
    assert all(one.conditions == NORMAL for one in made.instruments)
    made.close()


@pytest.mark.parametrize("workers", [0, 2])
def test_weather_that_a_sensor_cannot_compute_is_in_the_answer_and_the_run_goes_on(
    workers: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("emulator.sensing.particles.MOST_A_BEAM", -1.0)  # no drop is drawn alone
    made = trial(workers=workers)
    made.run.advance(300_000_000)
    orders = orders_of(made)

    def answer(**tables: Any) -> dict[str, Any]:
        found: Any = orders.methods()["weather"](tables)
        made.run.advance(made.run.clock.now_ns() + 1_000_000)
        reported: dict[str, Any] = found.make() if isinstance(found, Later) else found
        return reported

    assert "not_computed" not in answer(rain={"rate_mm_h": 5})
    reported = answer(rain={"rate_mm_h": 70, "echoes": "drops"})
    assert list(reported["not_computed"]) == ["front"]
    assert "weather.rain.echoes: drops" in reported["not_computed"]["front"]
    assert "want continuum or auto" in reported["not_computed"]["front"]
    assert "not_computed" not in answer(rain=None)
    assert "not_computed" not in answer()
    assert made.finish().held
    made.close()
