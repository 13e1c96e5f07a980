"""Whole sweeps: motion while the beams fire, the same numbers in whatever order, points on a car, bundles by name."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from emulator.compiled import switch
from emulator.physics import counting, radiometry
from emulator.sensing.rays import KEPT_PLANS
from emulator.sensing.table import table_plan
from emulator.sensors.spec import load_spec
from protocols.scan import Scan
from tests.draws import cases
from tests.sensing.rig import QUIET, build, grey, plan, plate

SCAN_DEG = np.arange(-90.0, 90.5, 0.5)
TURN_S = 1.0 / 75.0
CLEAR: dict[str, Any] = {"visibility_m": 1e9}


def same(one: Scan, two: Scan) -> bool:
    names = ("range_m", "intensity", "flags", "actor")
    return all(np.array_equal(getattr(one, n), getattr(two, n), equal_nan=n in names[:2]) for n in names)


def test_each_beam_of_a_plate_that_recedes_at_100_m_s_has_its_own_range(tmp_path: Path) -> None:
    target = {"id": "target", "shape": {"plane": {"size_m": [100.0, 100.0]}}, "material": "white",
              "motion": {"at_m": [20.0, 0.0, 0.0], "pitch_deg": -90.0, "velocity_m_s": [100.0, 0.0, 0.0]}}  # fmt: skip
    measure = build(tmp_path, actors=[target], model="sick-lms291-s05", physics={**QUIET, "rule": "axis"})
    fire = np.arange(181) / 360.0 * TURN_S
    scan = measure(plan(np.zeros(181), fire_s=fire, start_s=0.1))
    assert scan.range_m[:, 0] == pytest.approx(20.0 + 100.0 * (0.1 + fire), abs=1e-6)


def test_a_moving_sensor_sees_a_resting_world_move(tmp_path: Path) -> None:
    ego = {"id": "ego", "motion": {"at_m": [0.0, 0.0, 0.0], "velocity_m_s": [50.0, 0.0, 0.0], "yaw_rate_deg_s": 0.0}}
    measure = build(
        tmp_path, [plate(40.0, "white")], actors=[ego], mount={"actor": "ego", "at_m": [2.0, 0.0, 0.0]},
        model="sick-lms291-s05", physics={**QUIET, "rule": "axis"},
    )  # fmt: skip
    fire = np.arange(181) / 360.0 * TURN_S
    scan = measure(plan(np.zeros(181), fire_s=fire))
    assert scan.range_m[:, 0] == pytest.approx(38.0 - 50.0 * fire, abs=1e-6)


def test_a_sensor_at_rest_whose_angles_never_repeat_keeps_a_handful_of_sweeps(tmp_path: Path) -> None:
    measure = build(tmp_path, [plate(10.0, "white")], model="sick-lms291-s05", physics={**QUIET, "rule": "axis"})
    for sweep in range(3 * KEPT_PLANS):
        scan = measure(plan(0.1 * np.arange(20) + 0.001 * sweep, sweep=sweep))
        assert np.isfinite(scan.range_m[:, 0]).all()
    assert len(measure._at_rest) == KEPT_PLANS


def test_a_turning_sensor_fires_each_beam_where_it_points_then(tmp_path: Path) -> None:
    ego = {"id": "ego", "motion": {"at_m": [0.0, 0.0, 0.0], "yaw_rate_deg_s": 90.0}}
    measure = build(
        tmp_path, [plate(10.0, "white")], actors=[ego], mount={"actor": "ego"},
        model="sick-lms291-s05", physics={**QUIET, "rule": "axis"},
    )  # fmt: skip
    fire = np.linspace(0.0, 0.5, 46)
    scan = measure(plan(np.zeros(46), fire_s=fire))
    assert scan.range_m[:, 0] == pytest.approx(10.0 / np.cos(np.radians(90.0 * fire)), abs=1e-6)


def test_a_resting_scene_is_the_same_with_the_machinery_of_motion(tmp_path: Path) -> None:
    wall, ball = plate(12.0, "half", 20.0), {"shape": {"sphere": {"radius_m": 1.0}}, "material": "dark"}
    still = {**ball, "id": "ball", "motion": {"at_m": [8.0, 1.0, -1.0]}}
    waypoints = [{"t_s": t, "at_m": [8.0, 1.0, -1.0]} for t in (0.0, 100.0)]
    driven = {**ball, "id": "ball", "motion": {"waypoints": waypoints}}
    fire = np.tile(np.arange(181), 2)[:361] / 360.0 * TURN_S
    scans = [
        build(tmp_path, [wall], actors=[actor], model="sick-lms291-s05", physics=QUIET)(plan(SCAN_DEG, fire_s=fire))
        for actor in (still, driven)
    ]
    assert scans[0].range_m == pytest.approx(scans[1].range_m, abs=1e-9, nan_ok=True)
    assert np.array_equal(scans[0].actor, scans[1].actor)


FULL: dict[str, Any] = {
    "fog": {"visibility_m": 300.0},
    "rain": {"rate_mm_h": 20.0, "echoes": "drops"},
    "sun": {"azimuth_deg": 10.0, "elevation_deg": 2.0},
}


def test_scans_do_not_depend_on_the_order_in_which_they_are_measured(tmp_path: Path) -> None:
    world = [plate(12.0, "half", 20.0)]
    one = build(tmp_path, world, weather=FULL, model="sick-lms291-s05")
    two = build(tmp_path, world, weather=FULL, model="sick-lms291-s05")
    plans = [plan(SCAN_DEG, sweep=k, start_s=k * TURN_S, max_echoes=1) for k in range(4)]
    forward = [one(p) for p in plans]
    backward = [two(p) for p in reversed(plans)][::-1]
    assert all(same(a, b) for a, b in zip(forward, backward, strict=True))
    assert not same(forward[0], replace(forward[1], plan=plans[0]))


def test_another_seed_gives_other_noise_on_the_same_scene(tmp_path: Path) -> None:
    world = [plate(12.0, "half", 20.0)]
    first = build(tmp_path, world, model="sick-lms291-s05", seed=1)(plan([0.0, 1.0]))
    second = build(tmp_path, world, model="sick-lms291-s05", seed=2)(plan([0.0, 1.0]))
    assert not np.array_equal(first.range_m, second.range_m)


def test_sub_beams_in_another_order_give_the_same_scan(tmp_path: Path) -> None:
    """Sorting by range, then sums in float64: below 1e-9 m."""
    from emulator.physics.subechoes import SubEchoes

    measure = build(tmp_path, [plate(12.0, "half", 20.0)], model="sick-lms291-s05", physics=QUIET)
    found = measure.view(plan(SCAN_DEG)).echoes
    order = np.random.default_rng(1).permutation(len(found))
    mixed = SubEchoes.of(
        found.beam[order], found.range_m[order], found.amplitude[order], found.blocked[order], found.source[order]
    )
    one = measure._receiver.receive(plan(SCAN_DEG), found)
    two = measure._receiver.receive(plan(SCAN_DEG), mixed)
    assert one.range_m == pytest.approx(two.range_m, abs=1e-9, nan_ok=True)


@pytest.mark.parametrize("range_m", [10.0, 20.0, 40.0])
@pytest.mark.parametrize("rho", [0.3, 0.6])
def test_points_on_a_plate_follow_the_law_of_fig_6(tmp_path: Path, range_m: float, rho: float) -> None:
    """Mean over 100 phases of the grid within 0.1 of `beams_on_target`; LMS291 at 0.5 degrees, 1.75 m wide."""
    width_m, step = 1.75, np.radians(0.5)
    physics = {**QUIET, "sub_beams": 256, "exit_diameter_mm": 0.0}
    measure = build(
        tmp_path, [plate(range_m, "car", width_m)], materials={"car": grey(rho)}, weather=CLEAR,
        model="sick-lms291-s05", physics=physics,
    )  # fmt: skip
    half = np.ceil(np.degrees(np.arctan(1.5 / range_m)) * 2.0) / 2.0
    phases = (np.arange(100) + 0.5) / 100 * 0.5
    beams = (np.arange(-half, half + 0.5, 0.5)[None, :] + phases[:, None]).ravel()
    count = np.isfinite(measure(plan(beams, max_echoes=1)).range_m).sum() / 100
    w_m = float(np.tan(measure.model.beam.half_angle_x_rad) * range_m)
    full_m = float(radiometry.max_range_extended(9000.0, rho, 0.0, 1.0))
    edge_m = counting.edge_extension(w_m, counting.needed_share(range_m, full_m, 0.0))
    expected = float(counting.beams_on_target(width_m, edge_m, range_m, step))
    assert count == pytest.approx(expected, abs=0.1)


@pytest.mark.parametrize("rule", ["axis", "laguerre", "spiral", "grid", "adaptive"])
@pytest.mark.parametrize("profile", ["gauss", "tophat"])
def test_every_bundle_gives_a_filled_beam_all_its_power(tmp_path: Path, rule: str, profile: str) -> None:
    physics = {**QUIET, "rule": rule, "sub_beams": 64, "profile": profile}
    measure = build(tmp_path, [plate(20.0, "half")], weather=CLEAR, physics=physics)
    model = measure.model
    found = measure.view(plan([0.0, 3.0])).echoes
    total = np.bincount(found.beam, found.amplitude * (found.range_m**2 + model.aperture_radius_m**2))
    assert total[0] == pytest.approx(model.k_m2 * 0.5, rel=1e-5)
    assert np.bincount(found.beam, found.blocked) == pytest.approx([1.0, 1.0], rel=1e-12)


def test_no_divergence_is_the_axis_ray(tmp_path: Path) -> None:
    world = [plate(20.0, "half", 10.0)]
    thin = build(tmp_path, world, physics={**QUIET, "divergence_deg": 0.0, "rule": "spiral"})
    axis = build(tmp_path, world, physics={**QUIET, "rule": "axis"})
    assert same(thin(plan(np.arange(-20.0, 21.0))), axis(plan(np.arange(-20.0, 21.0))))


def test_an_elliptical_beam_is_wide_where_it_should_be(tmp_path: Path) -> None:
    """1 degree across, 0.01 up: a vertical edge cuts it in half, a horizontal one 5 mm off takes all or nothing."""
    physics = {**QUIET, "rule": "spiral", "sub_beams": 512, "divergence_deg": [1.0, 0.01]}
    across = build(tmp_path, [plate(20.0, "half", 100.0, 50.05)], weather=CLEAR, physics=physics).view(plan())
    upward = plate(20.0, "half", 100.0, 0.0, 100.0)
    upward["at_m"] = [20.0, 0.0, 50.005]
    none = build(tmp_path, [upward], weather=CLEAR, physics=physics).view(plan())
    w_m = 20.0 * np.tan(np.radians(0.5))
    assert across.echoes.blocked.sum() == pytest.approx(float(radiometry.fill_edge(-0.05, w_m)), abs=0.02)
    assert none.echoes.blocked.sum() < 1e-2
    rolled = build(tmp_path, [upward], weather=CLEAR, physics={**physics, "roll_deg": 90.0}).view(plan())
    assert rolled.echoes.blocked.sum() == pytest.approx(float(radiometry.fill_edge(-0.005, w_m)), abs=0.02)


def test_the_exit_aperture_widens_the_spot_and_leaves_the_range(tmp_path: Path) -> None:
    world = [plate(20.0, "half", 100.0, 50.01)]
    physics = {**QUIET, "rule": "spiral", "sub_beams": 512}
    point = build(tmp_path, world, weather=CLEAR, physics=physics).view(plan()).echoes
    wide = build(tmp_path, world, weather=CLEAR, physics={**physics, "exit_diameter_mm": 40.0}).view(plan()).echoes
    w_m = 20.0 * np.tan(np.radians(0.035))
    assert point.blocked.sum() == pytest.approx(float(radiometry.fill_edge(-0.01, w_m)), abs=0.02)
    assert wide.blocked.sum() == pytest.approx(float(radiometry.fill_edge(-0.01, w_m + 0.02)), abs=0.02)
    assert wide.range_m == pytest.approx(np.full(len(wide), 20.0), abs=1e-4)


def test_the_papers_lidar_fires_its_eleven_beams_from_its_own_table() -> None:
    table = table_plan(load_spec("paper-905nm"), 3)
    assert np.degrees(table.azimuth_rad) == pytest.approx(np.arange(-5.0, 6.0))
    assert table.start_ns == 120_000_000
    assert table.sweep == 3


def test_several_layers_are_a_table_like_any_other(tmp_path: Path) -> None:
    directions = plan(np.repeat([0.0, 10.0], 4))
    layered = replace(directions, elevation_rad=np.radians(np.tile([-2.0, -1.0, 1.0, 2.0], 2)))
    physics = {**QUIET, "rule": "axis", "weather_echoes": False}
    scan = build(tmp_path, [plate(20.0, "half")], physics=physics)(layered)
    expected = 20.0 / (np.cos(layered.azimuth_rad) * np.cos(layered.elevation_rad))
    assert scan.range_m[:, 0] == pytest.approx(expected, abs=1e-6)


@settings(max_examples=cases(25), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    range_m=st.floats(0.05, 400.0),
    tilt_deg=st.floats(0.0, 89.9),
    visibility_m=st.floats(1.0, 1e6),
    rate_mm_h=st.floats(0.0, 300.0),
    divergence_deg=st.floats(0.0, 20.0),
    fwhm_ns=st.floats(0.1, 1000.0),
    method=st.sampled_from(["leading_edge", "constant_fraction", "peak", "centroid"]),
    pulse=st.sampled_from(["sin2", "gauss"]),
    rule=st.sampled_from(["axis", "spiral", "laguerre", "adaptive"]),
)
def test_whatever_is_allowed_gives_a_scan_of_numbers(tmp_path: Path, **drawn: Any) -> None:
    world = [{**plate(drawn["range_m"], "half", 50.0), "yaw_deg": drawn["tilt_deg"]}]
    weather = {"fog": {"visibility_m": drawn["visibility_m"]}, "rain": {"rate_mm_h": drawn["rate_mm_h"]}, "sun": {}}
    physics = {
        "divergence_deg": drawn["divergence_deg"], "pulse_fwhm_ns": drawn["fwhm_ns"], "detection": drawn["method"],
        "pulse": drawn["pulse"], "rule": drawn["rule"], "sub_beams": 16, "depth": 1, "echoes": "all", "max_echoes": 3,
    }  # fmt: skip
    scan = build(tmp_path, world, weather=weather, physics=physics)(plan(np.linspace(-30, 30, 7)))
    seen = np.isfinite(scan.range_m)
    assert scan.range_m.shape == scan.intensity.shape == scan.actor.shape
    assert np.array_equal(seen, np.isfinite(scan.intensity))
    assert (scan.range_m[seen] >= 0.0).all()
    assert (scan.intensity[seen] >= 1.0).all()
    assert (np.diff(np.where(seen, scan.range_m, 1e9), axis=1)[seen[:, 1:]] >= 0.0).all()


def test_sub_beams_are_searched_for_by_rows() -> None:
    """Some beams at a time, upper and lower halves apart, each from one side to the other."""
    from emulator.casting.raycast import BLOCK
    from emulator.sensing.rays import TILE, in_bands

    rng = np.random.default_rng(3)
    azimuth = np.radians(np.arange(-90.0, 90.5, 0.5))
    axis = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(len(azimuth))], axis=1)
    direction = axis[:, None, :] + 0.005 * rng.normal(size=(len(axis), 61, 3))
    order = in_bands(axis, direction)
    flat = direction.reshape(-1, 3)
    assert BLOCK % TILE == 0
    np.testing.assert_array_equal(order // TILE, np.arange(len(flat)) // TILE)
    np.testing.assert_array_equal(np.sort(order), np.arange(len(flat)))
    row = flat[order[:TILE]]
    upper = row[:, 2] >= 0.0
    assert np.count_nonzero(upper[1:] != upper[:-1]) == 1
    for half in (row[upper], row[~upper]):
        assert (np.diff(np.arctan2(half[:, 1], half[:, 0])) >= 0.0).all()


@pytest.mark.parametrize("loops", [False, True])
def test_an_order_is_found_for_angles_that_come_again_and_for_packets_alone(tmp_path: Path, loops: bool) -> None:
    """A plan that never comes again, as one whose angles a fault moves, is not worth it."""
    if loops:
        pytest.importorskip("numba")
    drive = [{"id": "ego", "motion": {"velocity_m_s": [1.0, 0.0, 0.0]}}]
    with switch.switched(loops):
        physics = {"rule": "spiral", "sub_beams": 16, "leave_out": {"closed_form": "never"}}
        measure = build(tmp_path, [plate(60.0, "white")], actors=drive, mount={"actor": "ego"}, physics=physics)
        first, again = (measure.view(plan(sweep=number)).rays for number in range(2))
    assert first.order is None
    assert (again.order is not None) == loops


def test_what_nothing_moves_in_is_looked_at_once_and_every_sweep_has_its_own_noise(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    what: dict[str, Any] = {"model": "sick-lms291-s05", "weather": {"fog": {"visibility_m": 60.0}}}
    measure = build(tmp_path, [plate(20.0, "white")], **what)
    plans = [plan(SCAN_DEG, sweep=sweep, start_s=0.04 * sweep, fire_s=np.arange(361) / 9e4) for sweep in range(3)]
    first = measure(plans[0])

    def never(*given: Any) -> Any:
        raise AssertionError("cast again")

    monkeypatch.setattr(type(measure._caster), "renewed", never)
    scans = [first, *(measure(one) for one in plans[1:])]
    assert not same(scans[1], scans[2])
    rays = measure.view(plans[2]).rays
    assert np.array_equal(rays.t_s[rays.nearest_axis], 0.08 + np.arange(361) / 9e4)
    other = replace(plans[2], azimuth_rad=plans[2].azimuth_rad[::2], elevation_rad=plans[2].elevation_rad[::2],
                    fire_offset_s=plans[2].fire_offset_s[::2])  # fmt: skip
    for changed in (other, replace(plans[2], gain=0.5), replace(plans[2], max_range_m=15.0)):
        with pytest.raises(AssertionError, match="cast again"):
            measure(changed)
    monkeypatch.undo()
    for one, scan in zip(plans, scans, strict=True):
        assert same(build(tmp_path, [plate(20.0, "white")], **what)(one), scan)


def test_where_something_moves_it_is_looked_at_in_every_sweep(tmp_path: Path) -> None:
    target = {"id": "target", "shape": {"plane": {"size_m": [9.0, 9.0]}}, "material": "white",
              "motion": {"at_m": [20.0, 0.0, 0.0], "pitch_deg": -90.0, "velocity_m_s": [-9.0, 0.0, 0.0]}}  # fmt: skip
    measure = build(tmp_path, [plate(40.0, "white")], actors=[target], model="sick-lms291-s05", physics=QUIET)
    nearest = [np.nanmin(measure(plan(SCAN_DEG, sweep=s, start_s=0.1 * s)).range_m) for s in range(3)]
    assert nearest == pytest.approx([20.0, 19.1, 18.2], abs=0.05)
