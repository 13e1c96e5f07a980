"""Fog, rain, snow, dust, smoke, spray, layers and plumes, and their changes, through the whole path."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from emulator.physics import atmosphere
from emulator.physics.subechoes import SubEchoes
from emulator.sensing.measure import Measure
from emulator.sensing.particles import RARE
from tests.sensing.rig import QUIET, Floats, build, plan, plate

AXIS: dict[str, Any] = {**QUIET, "rule": "axis", "echoes": "all", "max_echoes": 8}
WALL = [plate(30.0, "half")]
NM = 905e-9
CLEAR = float(atmosphere.clear_air(NM))


def extinction(measure: Measure, t_s: float = 0.0) -> float:
    """One way, from the amplitude of the wall at 30 m."""
    found = measure.view(plan(start_s=t_s)).echoes
    wall = found.amplitude[np.abs(found.range_m - 30.0) < 1e-6].sum()
    model = measure.model
    return float(-np.log(wall / (model.k_m2 * 0.5 / (900.0 + model.aperture_radius_m**2))) / 60.0)


@pytest.mark.parametrize(
    ("weather", "alpha"),
    [
        ({}, CLEAR),
        ({"visibility_m": 5000.0}, atmosphere.fog_kim(5000.0, NM)),
        ({"fog": {"visibility_m": 400.0}}, atmosphere.fog_kim(400.0, NM)),
        ({"fog": {"mor_m": 400.0}}, atmosphere.fog_kim(400.0 / 0.765775657, NM)),
        ({"fog": {"visibility_m": 400.0, "law": "kruse"}}, atmosphere.fog_kruse(400.0, NM)),
        ({"fog": {"visibility_m": 400.0, "law": "naboulsi_advection"}}, atmosphere.fog_naboulsi_advection(400.0, NM)),
        ({"fog": {"visibility_m": 400.0, "law": "naboulsi_radiation"}}, atmosphere.fog_naboulsi_radiation(400.0, NM)),
        ({"fog": {"visibility_m": 400.0, "law": "ijaz"}}, atmosphere.fog_ijaz(400.0, NM)),
        ({"smoke": {"visibility_m": 400.0}}, atmosphere.smoke_ijaz(400.0, NM)),
        ({"dust": {"visibility_m": 400.0}}, atmosphere.fog_koschmieder(400.0)),
        ({"dust": {"visibility_m": 400.0, "law": "esmail"}}, atmosphere.dust_esmail(400.0)),
        ({"rain": {"rate_mm_h": 10.0}}, CLEAR + atmosphere.rain_carbonneau(10.0)),
        ({"rain": {"rate_mm_h": 10.0, "law": "japan"}}, CLEAR + atmosphere.rain_japan(10.0)),
        ({"rain": {"rate_mm_h": 10.0, "law": "itu"}}, CLEAR + atmosphere.rain_itu_mu0(10.0)),
        (
            {"rain": {"rate_mm_h": 10.0, "law": "marshall_palmer", "forward_scatter": False}},
            CLEAR + atmosphere.rain_marshall_palmer(10.0),
        ),
        (
            {"rain": {"rate_mm_h": 10.0, "law": "marshall_palmer"}},
            CLEAR + 0.70 * atmosphere.rain_marshall_palmer(10.0),
        ),
        ({"rain": {"rate_mm_h": 70.0, "drop_radius_mm": 3.0}}, CLEAR + atmosphere.rain_one_size(70.0, 3e-3)),
        ({"snow": {"rate_mm_h": 3.0}}, CLEAR + atmosphere.snow_dry(3.0, NM)),
        ({"snow": {"rate_mm_h": 3.0, "kind": "wet"}}, CLEAR + atmosphere.snow_wet(3.0, NM)),
        (
            {"fog": {"visibility_m": 400.0}, "rain": {"rate_mm_h": 10.0}},
            atmosphere.fog_kim(400.0, NM) + atmosphere.rain_carbonneau(10.0),
        ),
    ],
)
def test_extinction_is_that_of_the_law_and_adds_up_once(tmp_path: Path, weather: dict[str, Any], alpha: float) -> None:
    # shadows of single particles would make one beam flicker about the law
    smooth = {key: {**one, "echoes": "off"} if key in ("rain", "snow") else one for key, one in weather.items()}
    measure = build(tmp_path, WALL, weather=smooth, physics=AXIS)
    rel = 5e-3 if weather.get("rain", {}).get("law") == "marshall_palmer" else 1e-6
    assert extinction(measure) == pytest.approx(float(alpha), rel=rel)


def test_weather_changes_when_the_scenario_says_so(tmp_path: Path) -> None:
    weather = {
        "fog": {"visibility_m": 400.0},
        "changes": [{"t_s": 12.0, "fog": {"visibility_m": 200.0}}, {"t_s": 20.0, "fog": None}],
    }
    measure = build(tmp_path, WALL, weather=weather, physics=AXIS)
    seen = [extinction(measure, t_s) for t_s in (0.0, 11.99, 12.0, 19.0, 20.0)]
    fogs = [float(atmosphere.fog_kim(v, NM)) for v in (400.0, 400.0, 200.0, 200.0)]
    assert seen == pytest.approx([*fogs, CLEAR], rel=1e-6)


def test_a_layer_and_a_plume_count_where_the_beam_is_inside_them(tmp_path: Path) -> None:
    alpha = float(atmosphere.fog_kim(100.0, NM))
    plume = {"at_m": [15.0, 0.0, -1.0], "size_m": [4.0, 2.0, 2.0], "fog": {"visibility_m": 100.0}}
    measure = build(tmp_path, WALL, weather={"plumes": [plume]}, physics=AXIS)
    assert extinction(measure) * 30.0 == pytest.approx(CLEAR * 26.0 + alpha * 4.0, rel=1e-6)
    layer = {"bottom_m": -1.0, "top_m": 1.0, "fog": {"visibility_m": 100.0}}
    measure = build(tmp_path, WALL, weather={"layers": [layer]}, physics=AXIS)
    assert extinction(measure) == pytest.approx(alpha, rel=1e-6)
    above = {"bottom_m": 1.0, "top_m": 9.0, "fog": {"visibility_m": 100.0}}
    measure = build(tmp_path, WALL, weather={"layers": [above]}, physics=AXIS)
    assert extinction(measure) == pytest.approx(CLEAR, rel=1e-6)


def test_a_plume_drifts(tmp_path: Path) -> None:
    plume = {"at_m": [15.0, -10.0, -1.0], "size_m": [4.0, 2.0, 2.0], "extinction_per_m": 0.05,
             "velocity_m_s": [0.0, 1.0, 0.0]}  # fmt: skip
    measure = build(tmp_path, WALL, weather={"plumes": [plume]}, physics=AXIS)
    depths = [extinction(measure, t_s) * 30.0 - CLEAR * 30.0 for t_s in (0.0, 8.9, 9.1, 10.9, 11.1)]
    assert depths == pytest.approx([0.0, 0.0, 0.2, 0.2, 0.0], abs=1e-9)


def test_spray_stands_behind_a_moving_car_and_grows_with_the_square_of_its_speed(tmp_path: Path) -> None:
    """A car that drives away at 100 km/h: the beam meets ten metres of its wake, then its rear."""
    for speed, strength in ((100 / 3.6, 1.0), (50 / 3.6, 0.25)):
        car = {"id": "car", "class": "car", "shape": {"box": {"size_m": [4.0, 1.8, 1.5]}}, "material": "half",
               "motion": {"at_m": [20.0, 0.0, -0.5], "velocity_m_s": [speed, 0.0, 0.0]}}  # fmt: skip
        weather = {"spray": {"extinction_per_m": 0.017}}
        dry = build(tmp_path, actors=[car], physics=AXIS).view(plan()).echoes
        wet = build(tmp_path, actors=[car], weather=weather, physics=AXIS).view(plan()).echoes
        # the wake begins at the rear axle, 0.8 m before the rear end: 9.2 m of it lie in the open
        wall = wet.amplitude[np.abs(wet.range_m - 18.0) < 1e-3].sum() / dry.amplitude.sum()
        assert -0.5 * np.log(wall) == pytest.approx(0.017 * strength * 9.2, rel=1e-6)


def test_a_parked_car_whirls_nothing_up(tmp_path: Path) -> None:
    car = {"id": "car", "class": "car", "shape": {"box": {"size_m": [4.0, 1.8, 1.5]}}, "material": "half",
           "motion": {"at_m": [20.0, 0.0, -0.5]}}  # fmt: skip
    measure = build(tmp_path, actors=[car], weather={"spray": {}}, physics=AXIS)
    assert measure.air.at(0.0).volumes == ()


def waves(measure: Measure, beams: Floats) -> Any:
    return measure(plan(beams))


@pytest.mark.parametrize("into_the_sun", [False, True])
def test_a_plume_as_points_and_fog_as_a_table_give_the_same_echo(tmp_path: Path, into_the_sun: bool) -> None:
    """Fog everywhere against a plume of the same fog that holds everything, before a wall and before the sun."""
    physics = {**AXIS, "detection": "peak", "threshold_to_noise": 2.0, "background": into_the_sun}
    world = [] if into_the_sun else [plate(12.0, "half")]
    sky = {"sun": {"azimuth_deg": 0.0, "elevation_deg": 0.001, "total_w_m2": 20_000.0}}  # through 38 air masses
    fog = {"fog": {"visibility_m": 60.0}}
    everywhere = build(tmp_path, world, weather={**fog, **sky}, physics=physics)(plan())
    box = {"at_m": [0.0, 0.0, -500.0], "size_m": [1e3, 1e3, 1e3], **fog}
    points = build(tmp_path, world, weather={"plumes": [box], **sky}, physics=physics)(plan())
    assert np.isfinite(everywhere.range_m).sum() == (1 if into_the_sun else 2)
    assert points.range_m == pytest.approx(everywhere.range_m, abs=5e-3, nan_ok=True)
    assert points.intensity == pytest.approx(everywhere.intensity, rel=5e-3, nan_ok=True)
    if into_the_sun:
        dark = build(tmp_path, world, weather=fog, physics=physics)(plan())
        assert everywhere.intensity[0, 0] < 0.8 * dark.intensity[0, 0]


@pytest.mark.parametrize("wall_m", [5.0, 12.0, 18.5, 19.0, 19.5, 20.0, 21.0, 25.0])
def test_fog_does_not_lift_a_wall_that_stands_where_the_fog_is_no_longer_seen(tmp_path: Path, wall_m: float) -> None:
    """The table of the fog ends near 19 m here; a wall about its end must find what it takes away."""
    world, physics = [plate(wall_m, "half")], {**AXIS, "threshold_to_noise": 0.5, "detection": "peak"}
    found = build(tmp_path, world, weather={"fog": {"visibility_m": 50.0}}, physics=physics, model="sick-lms291-s05")
    scan, expected = found(plan()), found.view(plan()).echoes.amplitude.sum()
    wall = np.nanargmin(np.abs(scan.range_m[0] - wall_m))
    assert scan.range_m[0, wall] == pytest.approx(wall_m, abs=0.15)
    assert scan.intensity[0, wall] * 0.5 == pytest.approx(expected, rel=0.05)


def test_smoke_from_a_fire_is_an_echo_of_its_own_before_the_wall(tmp_path: Path) -> None:
    fire = {"at_m": [15.0, 0.0, -2.0], "size_m": [3.0, 3.0, 4.0], "extinction_per_m": 0.3, "lidar_ratio_sr": 18.8}
    scan = build(tmp_path, WALL, weather={"plumes": [fire]}, physics={**AXIS, "detection": "peak"})(plan())
    assert 13.0 < scan.range_m[0, 0] < 16.5
    assert scan.actor[0, 0] == -1
    assert scan.range_m[0, 1] == pytest.approx(30.0, abs=0.05)


def test_clear_air_and_distant_haze_leave_the_soft_target_out(tmp_path: Path) -> None:
    for weather in ({}, {"fog": {"visibility_m": 200_000.0}}):
        measure = build(tmp_path, WALL, weather=weather, physics={**AXIS, "near_gate_m": 10.0})
        made = measure._soft.everywhere(measure.air.at(0.0))
        assert made is None or made.until_m < 30.0  # no echo, and it shifts the nearest ones alone


def test_rain_drops_that_are_seen_alone_come_as_often_as_their_closed_form_says(tmp_path: Path) -> None:
    """Oracle `rain_false_echo_mean`: 0.023 a shot at 10 mm/h from 1 to 30 m, reference receiver, TNR 5."""
    physics = {
        **AXIS, "threshold_to_noise": 5.0, "near_gate_m": 1.0, "exit_diameter_mm": 0.0, "profile": "tophat",
    }  # fmt: skip
    weather = {"visibility_m": 1e9, "rain": {"rate_mm_h": 10.0, "echoes": "drops", "law": "carbonneau"}}
    measure = build(tmp_path, WALL, weather=weather, physics=physics)
    parts = [measure.view(plan(np.arange(-60, 60), sweep=k, start_s=20.0 * k)).echoes for k in range(170)]
    found = SubEchoes.joined(*(replace(one, beam=one.beam + 120 * k) for k, one in enumerate(parts)))
    drops = (found.range_m < 29.99) & (found.amplitude >= 5.0) & (found.range_m >= 1.0)
    mean = 0.0230 * 120 * len(parts)
    assert drops.sum() == pytest.approx(mean, abs=4 * np.sqrt(mean) + 0.02 * mean)
    assert (found.range_m[drops] >= 1.0).all()
    assert (found.source[drops] == -1).all()
    assert RARE < 1e-2


def test_single_drops_make_false_echoes_before_the_wall(tmp_path: Path) -> None:
    physics = {"rule": "axis", "noise": False, "range_noise_mm": 0.0, "echoes": "first", "max_echoes": 1}
    weather = {"rain": {"rate_mm_h": 70.0, "echoes": "drops"}}
    scan = build(tmp_path, WALL, weather=weather, physics=physics)(plan(np.zeros(3000), fire_s=0.5 * np.arange(3000)))
    ahead = scan.range_m[:, 0] < 29.0
    assert 50 < ahead.sum() < 600
    assert (scan.actor[ahead] == -1).all()
    calm = {"rain": {"rate_mm_h": 70.0, "echoes": "off"}}
    still = build(tmp_path, WALL, weather=calm, physics=physics)(plan(np.zeros(3000), fire_s=0.5 * np.arange(3000)))
    assert still.range_m[:, 0] == pytest.approx(30.0, abs=1e-3)


def test_drops_of_one_size_and_flakes_are_seen_too(tmp_path: Path) -> None:
    physics = {"rule": "axis", "noise": False, "range_noise_mm": 0.0, "echoes": "first", "max_echoes": 1}
    for weather in (
        {"rain": {"rate_mm_h": 300.0, "drop_radius_mm": 1.0, "echoes": "drops"}},
        {"snow": {"rate_mm_h": 3.0, "kind": "wet", "echoes": "drops"}},
    ):
        scan = build(tmp_path, WALL, weather=weather, physics=physics)(
            plan(np.zeros(3000), fire_s=0.5 * np.arange(3000))
        )
        assert (scan.range_m[:, 0] < 29.0).sum() > 30


def test_a_wide_beam_takes_rain_as_a_continuum_and_a_thin_one_as_drops(tmp_path: Path) -> None:
    weather = {"rain": {"rate_mm_h": 70.0}}
    thin = build(tmp_path, WALL, weather=weather, physics=AXIS)
    wide = build(tmp_path, WALL, weather=weather, physics={**AXIS, "divergence_deg": 5.0})
    assert len(thin.air.at(0.0).particles) == 1
    assert len(wide.air.at(0.0).particles) == 0
    assert wide.air.at(0.0).everywhere.backscatter_per_m_sr > thin.air.at(0.0).everywhere.backscatter_per_m_sr


@pytest.mark.parametrize(
    ("weather", "reported"),
    [
        ({"fog": {"visibility_m": 20.0, "law": "naboulsi_advection"}}, "outside 50 to 1000 m"),
        ({"fog": {"visibility_m": 0.5}}, "no law is physical below about 1 m"),
        ({"changes": [{"t_s": 5.0, "dust": {"visibility_m": 10.0, "law": "esmail"}}]}, "dust: law esmail"),
    ],
)
def test_a_law_outside_its_range_is_computed_and_told(tmp_path: Path, weather: dict[str, Any], reported: str) -> None:
    measure = build(tmp_path, WALL, weather=weather, physics=AXIS)
    assert any(reported in line for line in measure.warnings)
    measure(plan())


def test_weather_inside_its_laws_gives_no_warning(tmp_path: Path) -> None:
    weather = {"fog": {"visibility_m": 300.0}, "rain": {"rate_mm_h": 10.0}}
    assert build(tmp_path, WALL, weather=weather, physics=AXIS).warnings == ()


@pytest.mark.parametrize("visibility_m", [1.0, 3.0, 1e6])
@pytest.mark.parametrize("model", ["paper-905nm", "sick-lms291-s05", "sick-ld-lrs1000"])
def test_extreme_fog_stays_finite_and_silent(tmp_path: Path, visibility_m: float, model: str) -> None:
    weather = {"fog": {"visibility_m": visibility_m}, "rain": {"rate_mm_h": 300.0}}
    scan = build(tmp_path, [plate(80.0, "white")], weather=weather, model=model)(plan(np.linspace(-40, 40, 41)))
    seen = np.isfinite(scan.range_m)
    assert (scan.range_m[seen] >= 0.0).all()
    assert (scan.intensity[seen] >= 1.0).all()
    assert np.array_equal(seen, np.isfinite(scan.intensity))


def test_more_fog_rain_or_distance_never_gives_more_signal_from_a_wall(tmp_path: Path) -> None:
    """Below 6 km, where the law of Kim has no jump."""
    for weathers in (
        [{"fog": {"visibility_m": v}} for v in (5900, 2000, 1000, 700, 500, 200, 50, 10)],
        [{"rain": {"rate_mm_h": r, "echoes": "off"}} for r in (0, 0.1, 1, 10, 50, 150, 300)],
        [{"snow": {"rate_mm_h": r, "echoes": "off"}} for r in (0, 0.1, 1, 5, 10)],
    ):
        alphas = [extinction(build(tmp_path, WALL, weather=weather, physics=AXIS)) for weather in weathers]
        assert all(late >= early for early, late in itertools.pairwise(alphas))
    echo = [
        float(build(tmp_path, [plate(r, "half")], physics=AXIS).view(plan()).echoes.amplitude.sum())
        for r in (1.0, 1.5, 3.0, 10.0, 40.0, 90.0, 200.0)
    ]
    assert all(late < early for early, late in itertools.pairwise(echo))


@pytest.mark.parametrize("count", [1, 2, 3])
def test_volumes_clearer_than_the_air_never_make_light_and_say_so(tmp_path: Path, count: int) -> None:
    layer = {"bottom_m": -50.0, "top_m": 50.0, "fog": {"visibility_m": 90_000.0}}
    measure = build(tmp_path, WALL, weather={"layers": [layer] * count}, physics=AXIS)
    assert extinction(measure) == pytest.approx(CLEAR, rel=1e-6)
    assert "layer or plume: clearer than the surrounding air; has no effect" in measure.warnings
