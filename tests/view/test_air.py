"""Weather in the scene, the fog field, a page that waits for its controls: by numbers, without eyes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from emulator.view import air, sky


def light(weather: Mapping[str, Any]) -> int:
    return sum(map(sum, air.sky(weather)))


def test_the_fog_field_is_metres_of_visibility_and_its_buttons_say_what_they_set() -> None:
    assert sky.fog_table(120.0) == {"visibility_m": 120.0}
    assert sky.fog_table(sky.CLEAR_M) is None
    assert sky.fog_table(float("nan")) is None
    assert sky.fog_table(0.0) == {"visibility_m": sky.THICK_M}
    for metres in (10.0, 35.5, 120.0, 9999.0):
        assert sky.fog_field_m({"fog": sky.fog_table(metres)}) == metres
    assert sky.fog_field_m({}) == sky.fog_field_m({"fog": {"visibility_m": 5e4}}) == sky.CLEAR_M
    assert sky.fog_field_m({"visibility_m": 2000.0}) == 2000.0
    for label, metres in sky.FOG_CHOICES.items():
        number, _, unit = label.partition(" ")
        reported = {"m": 1.0, "km": 1000.0}.get(unit, 0.0) * float(number) if unit else sky.CLEAR_M
        assert reported == metres


def test_the_sky_follows_the_sun_and_thick_air_hides_it() -> None:
    heights = [{"sun": {"elevation_deg": height}} for height in (0.0, 8.0, 15.0, 60.0)]
    assert light({}) < light(heights[0]) < light(heights[1]) < light(heights[2]) == light(heights[3])
    assert air.sun_m({}) is None
    place = air.sun_m({"sun": {"elevation_deg": 30.0, "azimuth_deg": 90.0}})
    np.testing.assert_allclose(place, air.SUN_M * np.array([0.0, np.sqrt(0.75), 0.5]), atol=1e-9)
    low, high = air.sky(heights[3] | {"fog": {"visibility_m": 50.0}})
    assert low == high  # nothing but fog
    assert low != air.sky({"fog": {"visibility_m": 50.0}})[0]  # by night it is dark
    picture = air.backdrop(heights[3])
    assert picture[-1, 0].tolist() == list(air.sky(heights[3])[0])
    assert picture[0, 0].tolist() == list(air.sky(heights[3])[1])


def test_haze_ends_at_the_visibility_counted_from_the_scene() -> None:
    assert air.haze_m({}, 20.0) is None
    assert air.haze_m({"fog": {"visibility_m": 9000.0}}, 20.0) is None
    assert air.haze_m({"fog": {"visibility_m": 10.0}}, 20.0) == (10.0, 30.0)
    assert air.haze_m({"dust": {"mor_m": 40.0}, "fog": {"visibility_m": 100.0}}, 20.0) == (10.0, 60.0)


def test_the_more_it_rains_the_more_drops_and_they_fall_with_time() -> None:
    assert air.drops({}, 1.0, 20.0).shape == (0, 2, 3)
    few, many = (air.drops({"rain": {"rate_mm_h": rate}}, 1.0, 20.0) for rate in (2.0, 30.0))
    assert 0 < len(few) < len(many) <= air.MOST_DROPS
    assert np.abs(many[:, 0, :2]).max() <= 20.0
    later = air.drops({"rain": {"rate_mm_h": 2.0}}, 1.1, 20.0)
    fallen = (few - later)[:, 0, 2]
    assert np.median(fallen) == pytest.approx(0.1 * air.FALL_M_S["rain"])
    assert len(air.flakes({"snow": {"rate_mm_h": 1.0}}, 0.0, 20.0)) > 0
    np.testing.assert_array_equal(later, air.drops({"rain": {"rate_mm_h": 2.0}}, 1.1, 20.0))  # a page that stands still


def test_names_that_come_together_are_parted() -> None:
    pytest.importorskip("viser", reason="extra `view` is not installed")
    from emulator.scenario.tables import Mount
    from emulator.view.page import name_heights, stacked

    at = np.array([[0, 0, 2.0], [1, 0, 2.0], [0, 1, 2.1], [50, 0, 2.0]])
    raised = stacked(at, 1.0)
    assert raised[3] == 0.0
    assert np.diff(np.sort((at[:, 2] + raised)[:3])).min() >= 1.0 - 1e-12
    assert not stacked(np.zeros((0, 3)), 1.0).size
    heights = name_heights({"front": Mount(actor="ego", at_m=(2, 0, 0.7))}, 1.0, {"ego": 1.0, "car": 9.0})
    assert 0.7 + heights["front"] == pytest.approx(2.0)


def test_a_scenario_of_our_own_begins_again_and_the_old_one_ends_after(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("viser", reason="extra `view` is not installed")
    from emulator.view import own

    reported: list[str] = []

    @contextmanager
    def daemon(name: str, options: list[str], links: Callable[[Path], object], heard: object) -> Iterator[Any]:
        number = sum(row.startswith("begin") for row in reported)
        reported.append(f"begin {number}")
        yield SimpleNamespace(ready={"sensors": []}, control=Path(f"{number}"))
        reported.append(f"end {number}")

    class Live:
        title, scenario, failed = "x", None, False

        def __init__(self, path: Path, daemon: object) -> None:
            self.path = path

        def stand_at_end(self) -> None:
            reported.append(f"stand {self.path}")

        def order(self, method: str, params: Mapping[str, Any]) -> str:
            return f"{method} {self.path}"

    monkeypatch.setattr(own, "own_daemon", daemon)
    monkeypatch.setattr(own, "LiveSource", Live)
    source = own.OwnSource("x.yaml", reported.append)
    assert source.can_restart
    assert source.order("pause", {}) == "pause 0"
    assert source.order("restart", {}) == {"now_s": 0.0}
    assert source.order("pause", {}) == "pause 1"
    source.close()
    assert reported == ["begin 0", "stand 0", "begin 1", "stand 1", "end 0", "end 1"]
