"""Full against pruned where a stranger found them apart: walls near in haze, in the sun, at the end of sight; spray."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from emulator.sensing.measure import Measure
from tests.sensing.error_budget.scenes import LD, LMS, PAPER, plan, same, tally
from tests.sensing.rig import build, plate

SPREAD: dict[str, Any] = {"leave_out": {"closed_form": "always"}}


def both(folder: Path, world: list[dict[str, Any]], physics: dict[str, Any], **more: Any) -> tuple[Measure, Measure]:
    """With every rule, and with none."""
    rays_saved = build(folder, world, physics={**SPREAD, **physics}, **more)
    return rays_saved, build(folder, world, physics={**physics, "full": True}, **more)


def differing(rays_saved: Measure, whole: Measure, sweeps: int = 2, beams: int = 61) -> int:
    """Beams, of several sweeps, that differ by more than a step."""
    plans = (replace(plan(beams, 20.0, sweep=k), start_ns=30_000_000 * k) for k in range(sweeps))
    return sum(tally(*same(rays_saved, whole, one)).differ for one in plans)


@pytest.mark.parametrize(
    ("model", "wall_m", "visibility_m"),
    [(LD, 2.0, 2e3), (LD, 1.5, 2e3), (LD, 2.0, 4e3), (LD, 2.0, 23e3), (LMS, 1.0, 1e3), (PAPER, 3.0, 800.0)],
)
def test_a_near_wall_in_haze_is_first_crossed_by_the_haze(
    tmp_path: Path, model: str, wall_m: float, visibility_m: float
) -> None:
    world, haze = [plate(wall_m, "half")], {"visibility_m": visibility_m}
    rays_saved, whole = both(tmp_path, world, {}, model=model, weather=haze)
    assert differing(rays_saved, whole) == 0
    sampled = build(tmp_path, world, physics={"leave_out": {"waveform": False}}, model=model, weather=haze)
    assert differing(sampled, whole) == 0
    clipped = {"full_scale_snr": 60.0}  # the air clips, too
    assert differing(*both(tmp_path, world, clipped, model=model, weather=haze)) == 0


@pytest.mark.parametrize(
    ("physics", "model", "wall_m"),
    [
        ({"pulse": "gauss"}, LD, 2.5),
        ({"pulse": "gauss"}, PAPER, 5.0),
        ({"detection": "centroid"}, PAPER, 5.0),
        ({"pulse": "gauss", "detection": "constant_fraction"}, LMS, 4.0),
    ],
)
def test_other_pulses_and_other_timing_are_shifted_by_clear_air_as_in_full(
    tmp_path: Path, physics: dict[str, Any], model: str, wall_m: float
) -> None:
    assert differing(*both(tmp_path, [plate(wall_m, "half")], physics, model=model), sweeps=1) == 0


@pytest.mark.parametrize("pulse", ["sin2", "gauss"])
def test_the_centroid_of_a_far_wall_is_not_drawn_towards_the_sensor_by_clear_air(tmp_path: Path, pulse: str) -> None:
    physics = {"pulse": pulse, "detection": "centroid", "noise": False, "rule": "axis"}
    scan = build(tmp_path, [plate(30.0, "half")], physics=physics, model=LD)(plan(1, 0.0))
    assert scan.range_m[0, 0] == pytest.approx(30.0, abs=2e-3)


@pytest.mark.parametrize(("model", "wall_m"), [(LMS, 50.0), (LMS, 53.0), (PAPER, 60.0)])
@pytest.mark.parametrize("sunny", [False, True])
def test_a_wall_at_the_end_of_sight_is_the_same_in_full(tmp_path: Path, model: str, wall_m: float, sunny: bool) -> None:
    weather = {"sun": {"azimuth_deg": 180.0, "elevation_deg": 20.0}} if sunny else {}
    materials = {"grey": {"rho": 0.3, "model": "lambert"}}
    pair = both(tmp_path, [plate(wall_m, "grey")], {}, model=model, weather=weather, materials=materials)
    assert differing(*pair, sweeps=3, beams=181) == 0


def test_a_driving_sensor_measures_behind_a_car_that_throws_spray(tmp_path: Path) -> None:
    ego = {"id": "ego", "motion": {"velocity_m_s": [20.0, 0.0, 0.0]}}
    car = {"id": "car", "class": "car", "shape": {"box": {"size_m": [4.0, 1.8, 1.5]}}, "material": "half",
           "motion": {"at_m": [20.0, 0.0, 0.1], "velocity_m_s": [20.0, 0.0, 0.0]}}  # fmt: skip
    world = [{"plane": {"size_m": [400.0, 400.0]}, "material": "dark"}]
    pair = both(tmp_path, world, {}, model=LD, actors=[ego, car], weather={"spray": {}},
                mount={"actor": "ego", "at_m": [0.0, 0.0, 0.7]})  # fmt: skip
    assert differing(*pair) == 0
    assert np.isfinite(pair[0](plan(61, 20.0)).range_m).any()
