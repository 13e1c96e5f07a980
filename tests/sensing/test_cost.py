"""What a sweep need not compute: counts and bounds instead of times."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from emulator.casting import hits, moving_cast, raycast
from emulator.sensing.daylight import Shadows
from protocols.scan import Scan
from tests.sensing.rig import QUIET, build, plan, plate

AZIMUTH = np.linspace(-60.0, 60.0, 121)


def same(one: Scan, other: Scan) -> None:
    """Two scans are equal to the last bit."""
    for name in ("range_m", "intensity", "flags", "actor"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)


@pytest.mark.parametrize("shape", ["sin2", "gauss"])
def test_a_long_pulse_is_sampled_as_coarsely_as_its_shape_allows(tmp_path: Path, shape: str) -> None:
    ranges, pulse_ns = [], 10_000.0
    for bin_ns in (None, pulse_ns / 1024.0):
        physics = {**QUIET, "pulse": shape, "pulse_fwhm_ns": pulse_ns, "bin_ns": bin_ns, "detection": "peak",
                   "system_constant_m2": 1e7}  # fmt: skip
        world = [plate(20.0, "half", width_m=10.0, y_m=5.0), plate(60.0, "half")]
        measure = build(tmp_path, world, physics=physics, model="sick-lms291-s05")
        ranges.append(measure(plan(np.linspace(-1.0, 1.0, 3))).range_m[:, 0])
        if bin_ns is None:
            assert measure.model.bin_m <= measure.model.pulse.fwhm_m / 250.0
    assert np.isfinite(ranges[0]).all()
    np.testing.assert_allclose(ranges[0], ranges[1], rtol=0.0, atol=1e-4)


WEATHER: list[dict[str, Any]] = [{}, {"fog": {"visibility_m": 300.0}, "rain": {"rate_mm_h": 20.0, "wets": True}},
    {"sun": {"elevation_deg": 30.0}, "changes": [{"t_s": 0.15, "fog": {"visibility_m": 100.0}}]}]  # fmt: skip


@pytest.mark.parametrize("weather", WEATHER)
@pytest.mark.parametrize("moving", [False, True])
def test_a_sensor_at_rest_sees_what_it_would_see_for_the_first_time(
    tmp_path: Path, weather: dict[str, Any], moving: bool
) -> None:
    motion = {"at_m": [6.0, -4.0, -1.0], "velocity_m_s": [0.0, 20.0 * moving, 0.0]}
    actors = [{"id": "it", "shape": {"box": {"size_m": [1.0, 1.0, 2.0]}}, "material": "windscreen", "motion": motion}]
    world = [plate(20.0, "half"), plate(9.0, "dark", width_m=2.0, y_m=3.0)]

    def fresh(resting: bool = True) -> Any:
        return build(tmp_path, world, actors=actors, weather=weather, model="sick-lms291-s05",
                     physics={"leave_out": {"closed_form": "never", "resting": resting}})  # fmt: skip

    kept, once_more = fresh(), fresh(resting=False)
    changed = []
    for number, start_s in enumerate((0.0, 0.1, 0.2, 0.1, 5.0)):
        one = plan(AZIMUTH, sweep=number, start_s=start_s, fire_s=np.linspace(0.0, 0.006, len(AZIMUTH)))
        same(kept(one), fresh()(one))
        now, whole = kept(one), once_more(one)
        np.testing.assert_allclose(now.range_m, whole.range_m, rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(now.intensity, whole.intensity, rtol=1e-9)
        np.testing.assert_array_equal(now.actor, whole.actor)
        view = kept.view(one)
        np.testing.assert_allclose(view.echoes.range_m, once_more.view(one).echoes.range_m, rtol=0.0, atol=1e-12)
        changed.append(-1 if view.kept is None else int(np.count_nonzero(view.kept.changed)))
    assert not moving or weather or (0 < changed[0] < len(AZIMUTH) and changed[-1] == 0), "some beams, and none at last"


@pytest.mark.parametrize("yaw_rate_deg_s", [0.0, 20.0])
def test_directions_are_kept_while_a_car_drives_straight(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, yaw_rate_deg_s: float
) -> None:
    ego = {"id": "ego", "motion": {"velocity_m_s": [8.0, 0.5, 0.0], "yaw_rate_deg_s": yaw_rate_deg_s}}
    other = {"id": "car", "shape": {"box": {"size_m": [4.0, 1.8, 1.5]}}, "material": "half",
             "motion": {"at_m": [15.0, 2.0, -0.7], "velocity_m_s": [4.0, 0.0, 0.0]}}  # fmt: skip
    rooms = [plate(30.0, "half"), {"box": {"size_m": [2.0, 2.0, 2.0]}, "at_m": [9.0, -3.0, -1.0], "material": "dark"}]
    settings: dict[str, Any] = {"actors": [ego, other], "mount": {"actor": "ego"}, "model": "sick-lms291-s05"}
    measure = build(tmp_path, rooms, **settings)
    made: list[int] = []
    cones_of = hits.Cones.of
    monkeypatch.setattr(hits.Cones, "of", lambda ray: made.append(ray.shape[1]) or cones_of(ray))
    may_meet = moving_cast.may_meet

    def noted(*given: Any) -> Any:
        if given[-1] is None:  # loops make them of rays that are cast once
            made.append(0)
        return may_meet(*given)

    monkeypatch.setattr(moving_cast, "may_meet", noted)
    for sweep in range(4):
        fresh = build(tmp_path, rooms, **settings)
        made.clear()
        one = plan(AZIMUTH, sweep=sweep, start_s=0.2 * sweep, fire_s=np.linspace(0.0, 0.01, len(AZIMUTH)))
        got = measure(one)
        assert bool(made) == (sweep < 2 or yaw_rate_deg_s != 0.0)  # the second sweep tells that they come again
        same(got, fresh(one))


def test_a_sweep_of_what_has_not_moved_casts_nothing(tmp_path: Path) -> None:
    measure = build(tmp_path, [plate(20.0, "half")], physics={"leave_out": {"closed_form": "never"}})
    assert isinstance(measure._caster, raycast.Caster)
    for number in range(5):
        measure(plan(AZIMUTH, sweep=number))
    assert measure._caster.counters.cast == 121 * measure.model.sub_beams


def test_in_the_sun_a_single_ray_a_beam_looks_beyond_reach(tmp_path: Path) -> None:
    far = [{"id": "far", "shape": {"box": {"size_m": [2.0, 900.0, 90.0]}}, "material": "white",
            "motion": {"at_m": [400.0, 0.0, -40.0], "velocity_m_s": [0.0, 0.5, 0.0]}}]  # fmt: skip
    sun = {"sun": {"azimuth_deg": 180.0, "elevation_deg": 20.0}}
    scans = []
    for far_objects in (True, False):
        physics = {"leave_out": {"closed_form": "never", "far_objects": far_objects}}
        measure = build(tmp_path, [plate(30.0, "half", width_m=10.0)], actors=far, weather=sun,
                        model="sick-lms291-s05", physics=physics)  # fmt: skip
        scans.append(measure(plan(AZIMUTH)))
        seen = measure.view(plan(AZIMUTH)).seen.axis_material
    same(*scans)
    assert (seen >= 0).sum() > 60


@pytest.fixture
def no_shadows(monkeypatch: pytest.MonkeyPatch) -> None:
    """No ray of what beams look at to the sun: others are counted."""

    def all_lit(self: Shadows, sun: Any, rays: Any, found: Any, lit_w: Any, *_: Any) -> Any:
        return np.ones(len(lit_w))

    monkeypatch.setattr(Shadows, "share", all_lit)


@pytest.mark.usefixtures("no_shadows")
@pytest.mark.parametrize("movers", [1, 40])
def test_in_the_sun_all_rays_look_beyond_reach_where_one_more_for_many_beams_costs_more(
    tmp_path: Path, movers: int
) -> None:
    far = [{"id": f"far{k}", "shape": {"box": {"size_m": [9.0, 90.0, 60.0]}}, "material": "white",
            "motion": {"at_m": [400.0 + 20.0 * k, 0.0, -20.0], "velocity_m_s": [0.0, 1.0, 0.0]}}
           for k in range(movers)]  # fmt: skip
    settings: dict[str, Any] = {
        "actors": far, "model": "sick-lms291-s05", "physics": {"leave_out": {"closed_form": "never"}},
        "weather": {"sun": {"azimuth_deg": 180.0, "elevation_deg": 20.0}},
    }  # fmt: skip
    world = [plate(30.0, "half", width_m=10.0)]
    measure = build(tmp_path, world, **settings)
    assert isinstance(measure._caster, raycast.Caster)
    asked, scans = [0], []
    for sweep in range(3):
        scans.append(measure(plan(AZIMUTH, sweep=sweep, start_s=0.1 * sweep)))
        asked.append(measure._caster.counters.rays - sum(asked))
    bundles = 121 * measure.model.sub_beams
    assert asked[1] > bundles
    assert (asked[2] == asked[3] == bundles) == (movers == 1)
    for sweep in (2, 1):
        same(build(tmp_path, world, **settings)(plan(AZIMUTH, sweep=sweep, start_s=0.1 * sweep)), scans[sweep])


@pytest.mark.usefixtures("no_shadows")
def test_in_the_sun_no_ray_looks_beyond_reach_where_nothing_is(tmp_path: Path) -> None:
    near = [{"id": "near", "shape": {"box": {"size_m": [2.0, 2.0, 2.0]}}, "material": "white",
             "motion": {"at_m": [20.0, 9.0, -1.0], "velocity_m_s": [0.0, 0.5, 0.0]}}]  # fmt: skip
    measure = build(tmp_path, [plate(30.0, "half", width_m=10.0, height_m=10.0)], actors=near, model="sick-lms291-s05",
                    weather={"sun": {"azimuth_deg": 180.0, "elevation_deg": 20.0}},
                    physics={"leave_out": {"closed_form": "never"}})  # fmt: skip
    measure(plan(AZIMUTH))
    assert isinstance(measure._caster, raycast.Caster)
    assert measure._caster.counters.rays == 121 * measure.model.sub_beams


def test_spray_behind_far_vehicles_is_not_looked_at(tmp_path: Path) -> None:
    box = {"box": {"size_m": [4.0, 2.0, 1.5]}}
    actors = [{"id": f"car{k}", "class": "car", "shape": box, "material": "half",
               "motion": {"at_m": [15.0 + (k > 0) * 900.0, 20.0 * k, -1.0], "velocity_m_s": [20.0, 0.0, 0.0]}}
              for k in range(40)]  # fmt: skip
    measures = [
        build(tmp_path, [plate(60.0, "half")], actors=actors, weather={"spray": {"extinction_per_m": 0.017}},
              model="sick-lms291-s05", physics={"leave_out": {"closed_form": "never", "far_objects": far}})
        for far in (True, False)
    ]  # fmt: skip
    one, whole = (measure.view(plan(AZIMUTH)) for measure in measures)
    assert (len(one.air.volumes), len(whole.air.volumes)) == (1, 40)
    np.testing.assert_array_equal(one.echoes.range_m, whole.echoes.range_m)
    np.testing.assert_array_equal(one.echoes.amplitude, whole.echoes.amplitude)
    assert measures[0].view(plan(AZIMUTH, sweep=1, start_s=0.01)).air is one.air
