"""Each rule of leaving out by itself: with its bound nothing is seen of it, with a wrong one it turns red."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import scenarios
from emulator.casting import raycast
from emulator.physics import cosines
from emulator.physics.pulse import Pulse
from emulator.physics.softprofile import SoftProfile
from emulator.physics.softtarget import fog_shape
from emulator.physics.subechoes import SubEchoes
from emulator.scenario import scenario
from emulator.scenario.weather import WeatherConfig
from emulator.sensing import (
    closed,
    daylight,
    faint,
    measure,
    particles,
    paths,
    probing,
    pruning,
    receiver,
    receiving,
    soft,
)
from emulator.sensing.measure import Measure
from emulator.sensing.measure import build as build_measure
from emulator.sensing.model import SensorModel
from emulator.sensors.physics_options import LeaveOut
from emulator.world import scene, triangles
from emulator.world.motion import Steady
from emulator.world.scene import Body, Scene
from protocols.scan import ScanPlan
from tests.sensing.error_budget.scenes import (
    LD,
    LMS,
    PAPER,
    PUCK,
    Tally,
    body,
    full_against_pruned,
    measure_of,
    plan,
    random_scene,
    same,
    tally,
)

KEYS = tuple(LeaveOut.model_fields)


def scene_of(*bodies: Body, materials: tuple[str, ...] = ("asphalt", "window_glass", "white_plaster")) -> Scene:
    return Scene(("world",), ("unknown",), (Steady(),), materials, bodies)


def wall(x_m: float, kind: int = 0, yaw_deg: float = 0.0, thick_m: float = 0.1) -> Body:
    shape = triangles.box(thick_m, 100.0, 100.0)
    return body(0, shape, kind, Steady(at_m=(x_m, 0.0, -50.0), yaw_deg=yaw_deg))


def only(key: str) -> LeaveOut:
    """One rule on, all others off."""
    return LeaveOut.nothing().model_copy(update={key: "always" if key == "closed_form" else True})


def differing(
    key: str, world: Scene, model: str, weather: WeatherConfig | None = None, sweeps: int = 2, **options: object
) -> Tally:
    one = measure_of(world, model, weather, leave_out=only(key), **options)
    full = measure_of(world, model, weather, full=True, **options)
    return sum(
        (tally(*same(one, full, replace(plan(), sweep=k, start_ns=200_000_000 * k))) for k in range(sweeps)), Tally()
    )


SUN = WeatherConfig.model_validate({"sun": {"azimuth_deg": 180.0, "elevation_deg": 30.0}})
LOW_SUN = WeatherConfig.model_validate({"sun": {"azimuth_deg": 0.2, "elevation_deg": 0.1}})
FOG = WeatherConfig.model_validate({"fog": {"visibility_m": 200.0}})
HAZE = WeatherConfig.model_validate({"fog": {"visibility_m": 1000.0}})
RAIN = WeatherConfig.model_validate({"rain": {"rate_mm_h": 150.0, "echoes": "drops"}})
MIXED = random_scene(3)
STEEP = scene_of(wall(12.0, yaw_deg=40.0))
_POSTS = [body(0, triangles.box(0.05, 0.05, 4.0), 2, Steady(at_m=(10.0, 0.3 * y, -2.0))) for y in range(-40, 41)]
FENCE = scene_of(wall(11.0), *_POSTS)
POLE = scene_of(body(0, triangles.cylinder(0.02, 4.0, 12), 2, Steady(at_m=(10.0, 0.0, -2.0))))
BEHIND_GLASS = scene_of(wall(5.0, kind=1, thick_m=0.01), wall(15.0, kind=2))
STEP = scene_of(wall(11.0, kind=2), *_POSTS)
_DRIVES = Steady(at_m=(15.0, 0.0, -1.0), velocity_m_s=(0.0, 30.0, 0.0))
PASSING = Scene(("world", "a"), ("unknown",) * 2, (Steady(), _DRIVES), ("asphalt",),
                (body(1, triangles.box(4.0, 2.0, 3.0), 0, _DRIVES),))  # fmt: skip
ALWAYS = property(lambda self: 1e9)

Wrong = Callable[[pytest.MonkeyPatch], None]


def wrongly(*patches: tuple[object, str, object]) -> Wrong:
    return lambda patch: [patch.setattr(*one) for one in patches] and None


CASES: dict[str, tuple[Scene, str, WeatherConfig | None, dict[str, object], Wrong]] = {
    "clear_air": (scene_of(wall(30.0)), LMS, HAZE, {"weather_echoes": False}, wrongly(
        (SensorModel, "clear_depth", ALWAYS))),
    "plane_moments": (STEEP, LMS, None, {}, wrongly((closed, "SPREAD_LSB", 1e9), (closed, "SHIFT_LSB", 1e9))),
    "narrow_beams": (STEP, PUCK, None, {"noise": False}, wrongly((probing, "OFF_PLANE_LSB", 1e9))),
    "resting": (PASSING, LD, None, {}, wrongly((raycast.Caster, "_changed", lambda *_: None))),
    "far_objects": (MIXED, LD, None, {}, wrongly(
        (measure, "reach_of", lambda *_: 8.0), (pruning, "reach_of", lambda *_: 8.0))),
    "background_light": (POLE, LMS, LOW_SUN, {}, wrongly((daylight, "_unseen_share", lambda model: 1e9))),
    "noise_echoes": (MIXED, LD, None, {"threshold_to_noise": 4.0}, wrongly((receiver, "RARE", 1e9))),
    "backscatter": (MIXED, PAPER, FOG, {}, wrongly(
        (soft, "UNSEEN", 1e9), (SensorModel, "unseen_amplitude", ALWAYS),
        (SensorModel, "unseen_under", lambda self, a: 1e9 * a))),
    "particles": (POLE, LMS, RAIN, {"floor_reflectance": "off"}, wrongly((particles, "RARE", 1e9))),
    "waveform": (FENCE, LMS, None, {"walk_table": True, "system_constant_m2": 2e4, "weather_echoes": False}, wrongly(
        (cosines, "SHORT", 3.0), (receiving, "SHORT", 3.0))),
    "second_rays": (BEHIND_GLASS, PAPER, None, {"echoes": "last"}, wrongly((paths, "UNSEEN", 1e9))),
    "faint": (MIXED, PAPER, None, {"weather_echoes": False}, wrongly(
        (faint, "ALONE", 1.0), (faint, "WORTH", 0.0), (faint, "most_dropped", lambda model: 1e9))),
}  # fmt: skip


@pytest.mark.parametrize("key", CASES)
def test_a_rule_is_not_seen_and_its_bound_made_wrong_is(key: str, monkeypatch: pytest.MonkeyPatch) -> None:
    world, model, weather, options, wrong = CASES[key]
    if key == "plane_moments":  # works on plain beams alone
        options = {**options, "noise": False}
        rules = only(key).model_copy(update={"closed_form": "always"})
        full = measure_of(world, model, weather, full=True, **options)
        right = tally(*same(measure_of(world, model, weather, leave_out=rules, **options), full, plan()))
        wrong(monkeypatch)
        red = tally(*same(measure_of(world, model, weather, leave_out=rules, **options), full, plan()))
    else:
        right = differing(key, world, model, weather, **options)
        wrong(monkeypatch)
        red = differing(key, world, model, weather, **options)
    assert right.differ == 0
    assert red.differ > 0


def test_every_rule_with_a_bound_is_in_that_table() -> None:
    """Plain beams have a test of their own; the table of a medium is exact."""
    assert set(KEYS) - set(CASES) == {"closed_form", "soft_table"}


def test_full_switches_every_rule_off_and_a_key_one_of_them() -> None:
    assert measure_of(STEEP, LD, full=True).model.leave_out == LeaveOut.nothing()
    for key in KEYS:
        off = LeaveOut.model_validate({key: "never" if key == "closed_form" else False})
        assert getattr(measure_of(STEEP, LD, leave_out=off).model.leave_out, key) in (False, "never")


# ------------------------------------------------------------------------------- the numbers of the decision table
def codes(scan_m: np.ndarray, step_m: float) -> np.ndarray:
    return np.floor(scan_m / step_m + 0.5)


def test_a_room_of_five_metres_has_the_same_codes_without_clear_air(monkeypatch: pytest.MonkeyPatch) -> None:
    room = scene_of(wall(2.5), wall(-2.5), body(0, triangles.box(100.0, 0.1, 10.0), 0, Steady(at_m=(0.0, 2.5, -5.0))))
    there = measure_of(room, LMS, full=True, noise=False, weather_echoes=False)(plan()).range_m
    monkeypatch.setattr(SensorModel, "clear_depth", property(lambda self: 1.0))
    gone = measure_of(room, LMS, noise=False, weather_echoes=False)(plan()).range_m
    assert np.isfinite(there).any()
    assert np.array_equal(codes(there, 0.01), codes(gone, 0.01), equal_nan=True)


def test_plain_beams_on_a_car_are_those_of_4096_sub_beams() -> None:
    text = """{"schema": 1, "world": [{"mesh": "meshes/car.glb", "at_m": [12, 0, 0], "yaw_deg": 35, "materials": {
        "body": "car_paint_grey", "glass": "windscreen", "bumper": "bumper_plastic", "tyre": "tyre_rubber",
        "plate": "number_plate"}}],
        "sensors": [{"id": "s", "model": "sick-ld-lrs1000", "mount": {"at_m": [0, 0, 0.7]}}]}"""
    loaded = scenario.loads(text, Path(scenarios.__file__).parent / "car.yaml")
    world = scene.build(loaded)
    caster = raycast.Caster(world)

    def sensor(**physics: object) -> Measure:
        one = loaded.sensors[0]
        one = one.model_copy(update={"physics": one.physics.model_copy(update=physics)})
        return build_measure(loaded.model_copy(update={"sensors": (one,)}), world, caster, "s")

    rng = np.random.default_rng(4)
    azimuth = np.sort(rng.uniform(-0.2, 0.2, 120))
    beams = ScanPlan(0, 0, 0, azimuth, rng.uniform(-0.04, 0.04, 120), np.zeros(120))
    rays_saved = sensor(sub_beams=4096, noise=False, leave_out=LeaveOut(closed_form="always"))
    equal, plain = same(rays_saved, sensor(sub_beams=4096, noise=False, full=True), beams)
    assert np.count_nonzero(plain) > 20
    assert bool(equal[plain].all())


def test_a_moving_box_is_where_a_box_built_there_is() -> None:
    motion = Steady(at_m=(15.0, 2.0, -1.0), yaw_deg=20.0, velocity_m_s=(-9.0, 4.0, 0.0), yaw_rate_deg_s=30.0)
    at_s = 0.37
    pose = motion.pose(np.array([at_s]))
    box = triangles.box(4.0, 2.0, 3.0)
    moved = Scene(("world", "a"), ("unknown",) * 2, (Steady(), motion), ("asphalt",), (body(1, box, 0, motion),))
    rays = np.stack([np.cos(np.linspace(-0.3, 0.6, 400)), np.sin(np.linspace(-0.3, 0.6, 400)), np.zeros(400)], axis=1)
    found = raycast.Caster(moved).first_hits(np.zeros(3), rays, at_s)
    yaw = float(np.degrees(np.arctan2(pose.rotation[0, 1, 0], pose.rotation[0, 0, 0])))
    there = Steady(at_m=tuple(pose.position_m[0].tolist()), yaw_deg=yaw)
    built = raycast.Caster(scene_of(body(0, box, 0, there))).first_hits(np.zeros(3), rays, at_s)
    met = np.isfinite(found.range_m)
    assert met.sum() > 50
    assert np.array_equal(met, np.isfinite(built.range_m))
    assert np.abs(found.range_m[met] - built.range_m[met]).max() < 1e-9


def test_a_hundred_far_objects_do_not_change_a_scan() -> None:
    near = wall(20.0)
    cube = triangles.box(1.0, 1.0, 1.0)
    far = [body(0, cube, 0, Steady(at_m=(900.0, 10.0 * k - 500.0, 0.0))) for k in range(100)]
    alone = measure_of(scene_of(near), LD)(plan()).range_m
    assert np.array_equal(alone, measure_of(scene_of(near, *far), LD)(plan()).range_m, equal_nan=True)


def test_a_sunlit_wall_keeps_its_signal_to_noise() -> None:
    world = scene_of(wall(20.0, kind=2))
    kept = measure_of(world, LD, SUN, full=True, noise=False)(plan()).intensity
    left = measure_of(world, LD, SUN, noise=False)(plan()).intensity
    assert kept == pytest.approx(left, rel=1e-3)


def test_a_threshold_of_eight_rms_has_no_noise_echo_in_a_hundred_thousand_beams() -> None:
    empty = measure_of(scene_of(wall(-20.0)), LD, full=True, threshold_to_noise=8.0, weather_echoes=False)
    wide = replace(plan(), azimuth_rad=np.zeros(5000), elevation_rad=np.zeros(5000), fire_offset_s=np.zeros(5000))
    assert not any(np.isfinite(empty(replace(wide, sweep=sweep)).range_m).any() for sweep in range(20))


def test_haze_of_five_kilometres_behind_a_gate_of_ten_metres_is_not_seen() -> None:
    haze = WeatherConfig.model_validate({"fog": {"visibility_m": 5000.0}})
    found = differing("backscatter", MIXED, PAPER, haze, near_gate_m=10.0)
    assert found.differ == 0


def test_the_table_of_a_medium_is_its_closed_form() -> None:
    pulse, alpha, beta, start, full = Pulse(16e-9, "sin2"), 0.02, 1e-3, 0.5, 3.0
    made = SoftProfile.of_medium(pulse, 0.15, 1e4, alpha, beta, start, full, 60.0)
    assert made is not None
    x = made.bin_m * np.arange(made.first + 8, made.first + 200)
    # apparent range here counts from the pulse's centre, there from its start; energy 1 over the FWHM
    exact = fog_shape(x + pulse.half_support_m, alpha, start, full, 1e9, pulse.fwhm_s) * pulse.fwhm_s * 1e4 * beta
    assert made.wave(x) == pytest.approx(exact, rel=1e-9, abs=1e-10 * float(exact.max()))


def test_tables_made_anew_in_every_sweep_change_nothing() -> None:
    found = differing("soft_table", MIXED, PAPER, FOG)
    assert found.differ == 0


def test_a_plane_in_closed_form_has_the_code_of_a_waveform_of_a_quarter_of_a_nanosecond() -> None:
    options = {"noise": False, "weather_echoes": False, "bin_ns": 0.25}
    short = measure_of(STEEP, LMS, leave_out=only("waveform"), **options)(plan()).range_m
    sampled = measure_of(STEEP, LMS, full=True, **options)(plan()).range_m
    assert np.isfinite(short).sum() > 20
    assert np.nanmax(np.abs(short - sampled)) < 1e-4


def test_a_third_of_a_metre_a_second_moves_nothing_by_half_a_centimetre_within_a_sweep() -> None:
    motion = Steady(at_m=(20.0, 0.0, -50.0), velocity_m_s=(-0.3, 0.0, 0.0))
    box = body(1, triangles.box(1.0, 100.0, 100.0), 0, motion)
    world = Scene(("world", "a"), ("unknown",) * 2, (Steady(), motion), ("asphalt",), (box,))
    sweep = plan(seconds=0.0133)
    moved = measure_of(world, LMS, noise=False)(sweep).range_m
    frozen = measure_of(world, LMS, noise=False)(replace(sweep, fire_offset_s=np.full(len(sweep), 0.0133 / 2))).range_m
    cosine = np.cos(sweep.azimuth_rad)
    assert np.nanmax(np.abs(moved - frozen)[:, 0] * cosine) <= 0.3 * 0.0133 / 2 * 1.01


def test_faint_reflections_are_dropped_until_their_sum_would_show() -> None:
    beam = np.repeat([0, 1], [30, 4])
    amplitude = np.concatenate([np.full(30, 4e-3), [4e-3, 4e-3, 50.0, 4e-3]])
    found = SubEchoes.of(beam, np.arange(34.0) + 5.0, amplitude, np.full(34, 0.01))
    kept = faint.without_faint(found, 5.0, 0.05)
    lost = np.bincount(found.beam, found.amplitude) - np.bincount(kept.beam, kept.amplitude)
    assert lost == pytest.approx([0.048, 0.012])
    assert kept.amplitude.max() == 50.0
    assert faint.without_faint(SubEchoes.of(beam, np.arange(34.0), np.full(34, 9.0)), 5.0, 0.05).amplitude.size == 34
    assert len(faint.without_faint(found, 5.0, 0.05, beyond_m=1e3)) == len(found)
    points = replace(found, blocked=np.zeros(34))  # of a medium: faint each, an echo together
    assert faint.without_faint(points, 5.0, 0.05) is points


def test_under_a_fog_that_crosses_the_threshold_itself_clusters_are_sampled() -> None:
    """Fog of 860 m is kept back by the floor alone: it is above the threshold where near surfaces begin."""
    assert full_against_pruned(799).differ == 0
