"""Threshold, noise, false alarms, background light, choice of echoes, on scenes of one plate."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from emulator.physics import noise, pulse, radiometry, sunlight
from protocols.scan import DAZZLED, SATURATED
from tests.sensing.rig import QUIET, build, grey, plan, plate

CLEAR: dict[str, Any] = {"visibility_m": 1e9}
AXIS: dict[str, Any] = {"rule": "axis", "range_noise_mm": 0.0, "false_alarms": False, "full_scale_snr": "off"}
MANY = np.zeros(4000)


def at_snr(snr: float, k_m2: float = 75000.0) -> dict[str, Any]:
    """A plate at 10 m whose echo has this signal to noise."""
    return {"world": [plate(10.0, "chosen")], "materials": {"chosen": grey(snr * 100.0 / k_m2)}, "weather": CLEAR}


@pytest.mark.parametrize("snr", [3.5, 4.5, 5.0, 5.5, 7.0])
def test_an_echo_is_seen_with_the_probability_of_its_signal_over_the_threshold(tmp_path: Path, snr: float) -> None:
    physics = {**AXIS, "threshold_to_noise": 5.0, "system_constant_m2": 75000.0}
    measure = build(tmp_path, physics=physics, **at_snr(snr))
    seen = np.isfinite(measure(plan(MANY)).range_m[:, 0]).mean()
    expected = float(noise.detection_probability(5.0, snr))
    assert seen == pytest.approx(expected, abs=4 * np.sqrt(expected * (1 - expected) / len(MANY)) + 2e-3)


@pytest.mark.parametrize("snr", [20.0, 100.0])
def test_range_noise_of_a_leading_edge_follows_its_closed_form(tmp_path: Path, snr: float) -> None:
    physics = {**AXIS, "threshold_to_noise": 5.0, "system_constant_m2": 75000.0}
    measure = build(tmp_path, physics=physics, **at_snr(snr))
    ranges = measure(plan(MANY)).range_m[:, 0]
    expected = float(pulse.edge_range_sigma_sin2(16e-9, 5.0, snr))
    assert ranges.std() == pytest.approx(expected, rel=0.1)
    assert ranges.mean() == pytest.approx(10.0, abs=0.5 * expected)


def test_the_lms291_has_its_ten_millimetres_on_top(tmp_path: Path) -> None:
    measure = build(tmp_path, [plate(8.0, "white")], model="sick-lms291-s05", physics={"rule": "axis"})
    ranges = measure(plan(MANY)).range_m[:, 0]
    snr = measure.model.k_m2 / 64.0
    edge = float(pulse.edge_range_sigma_sin2(4e-9, 5.0, snr))
    assert ranges.std() == pytest.approx(np.hypot(0.010, edge), rel=0.05)
    assert ranges.mean() == pytest.approx(8.0, abs=1e-3)


def test_in_seed_mode_an_object_is_seen_up_to_signal_to_noise_one_and_nothing_is_drawn(tmp_path: Path) -> None:
    """Table 2 of the base paper, row car body: 232 m; the receiver of the spec gives 232.3 m."""
    limit_m = float(radiometry.max_range_extended(74989.8, 0.75, 8.90229347919e-5, 1.0))
    assert limit_m == pytest.approx(232.316, abs=0.02)
    for range_m, seen in ((limit_m - 0.05, True), (limit_m + 0.05, False)):
        measure = build(
            tmp_path, [plate(range_m, "paint")], materials={"paint": grey(0.75)}, mode="seed", physics={"rule": "axis"}
        )
        scan = measure(plan(np.zeros(3)))
        assert np.isfinite(scan.range_m).all() == seen
        if seen:
            assert np.ptp(scan.range_m) == 0.0
            assert scan.intensity == pytest.approx(1.0, abs=1e-2)


@pytest.mark.parametrize(
    ("row", "target", "limit_m", "printed_m"),
    [
        ("container truck", grey(0.80), 239.776, 237.0),
        ("car body", grey(0.75), 232.316, 232.0),
        ("road sign", grey(0.30), 148.036, 142.0),
        ("pedestrian", grey(0.05), 60.906, 58.0),
        ("bicycle, side", 28.6e-3, 45.882, 45.0),
        ("bicycle, front", 3.0e-3, 22.524, 22.0),
    ],
)
def test_table_2_of_the_base_paper_follows_from_one_receiver(
    tmp_path: Path, row: str, target: Any, limit_m: float, printed_m: float
) -> None:
    """Largest ranges of section 5.2 (model column) through meshes and embreex; the paper's own within 10 %."""
    assert limit_m == pytest.approx(printed_m, rel=0.10)
    for factor, seen in ((0.985, True), (1.015, False)):
        range_m = factor * limit_m
        if isinstance(target, float):
            tube = {"cylinder": {"radius_m": 0.5 * target, "height_m": 10.0, "segments": 512}}
            world = [{**tube, "at_m": [range_m + 0.5 * target, 0.0, -5.0], "material": "chosen"}]
            material = grey(0.05)
        else:
            world, material = [plate(range_m, "chosen", 20.0)], target
        physics = {"rule": "spiral", "sub_beams": 8192 if isinstance(target, float) else 61}
        measure = build(tmp_path, world, materials={"chosen": material}, mode="seed", physics=physics)
        assert np.isfinite(measure(plan()).range_m[0, 0]) == seen, row


def test_noise_alone_makes_as_many_echoes_as_rices_formula_says(tmp_path: Path) -> None:
    physics = {"rule": "axis", "threshold_to_noise": 3.5, "range_noise_mm": 0.0}
    measure = build(tmp_path, physics=physics)
    scan = measure(plan(MANY, max_echoes=1))
    expected = float(noise.false_alarm_rice(3.5, 31.25e6, 250.0))
    count = np.isfinite(scan.range_m).sum()
    mean = -np.expm1(-expected) * len(MANY)
    assert count == pytest.approx(mean, abs=4 * np.sqrt(mean))
    assert (scan.actor[np.isfinite(scan.range_m)] == -1).all()
    assert (scan.intensity[np.isfinite(scan.range_m)] >= 1.0).all()


def test_a_wanted_rate_of_false_alarms_sets_the_threshold(tmp_path: Path) -> None:
    measure = build(tmp_path, physics={"false_alarms_per_gate": 1e-4})
    assert measure.model.threshold == pytest.approx(5.0229, abs=1e-3)


ON_THE_HORIZON = 0.5 * float(sunlight.direct_normal(0.0, sunlight.CLEAR_BETA, 905e-9, 1.0))
"Of what the sun gives in vain outside the atmosphere, in the half of a field of view above the horizon. [1/m]"
SUN_IN_VIEW = {
    "sun": {"azimuth_deg": 0.0, "elevation_deg": 0.0, "total_w_m2": 0.7e9 / 1366.1 * 1370.0 / ON_THE_HORIZON}
}
"As bright in level beams as the sun of a high summer's day, all of it."


def test_the_sun_in_the_field_of_view_makes_noise_and_shortens_the_range(tmp_path: Path) -> None:
    """The reference receiver: 36.67 nA becomes 54.95 nA, signal to noise 0.667, range 0.817."""
    physics = {**QUIET, "rule": "axis"}
    ratio = []
    for weather in (CLEAR, {**CLEAR, **SUN_IN_VIEW}):
        ball = {"plane": {"size_m": [0.1, 0.1]}, "at_m": [30.0, 0.0, 0.0], "material": "white", "pitch_deg": -90.0}
        measure = build(tmp_path, [ball], weather=weather, physics={**physics, "rule": "spiral", "sub_beams": 7})
        scan = measure(plan([0.0, 0.0]))
        assert not (scan.flags & DAZZLED).any(), "0.304 mW on 0.55 A/W is 0.17 mA, below 0.2 mA"
        ratio.append(scan.intensity[0, 0])
    assert ratio[1] == pytest.approx(ratio[0], rel=1e-12), "the plate stands before the sun"
    measure = build(tmp_path, weather={**CLEAR, **SUN_IN_VIEW}, physics=physics)
    from emulator.sensing.daylight import daylight

    view = measure.view(plan())
    light = daylight(view.air.sun, view.rays, view.seen, view.surfaces, measure._caster, measure.model)
    assert light.noise is not None
    assert light.noise[0] == pytest.approx(54.95 / 36.67, rel=2e-3)


def test_beside_a_plate_half_of_the_sun_in_the_field_of_view_lowers_its_echo(tmp_path: Path) -> None:
    """The plate covers half of the beam and of the field of view, and the sun stands right behind its edge."""
    physics = {**QUIET, "rule": "spiral", "sub_beams": 256}
    world = [plate(30.0, "white", 10.0, 5.001)]
    night, day = (
        build(tmp_path, world, weather={**CLEAR, **sky}, physics=physics)(plan()) for sky in ({}, SUN_IN_VIEW)
    )
    seen = 0.5 + 2.0 / np.pi * 0.001 / (30.0 * 0.61e-3)  # the edge is a millimetre beside the axis
    assert day.intensity[0, 0] / night.intensity[0, 0] == pytest.approx(
        36.67 / np.sqrt((1.0 - seen) * 36.67**2 + seen * 54.95**2), rel=1e-2
    )


def test_a_wide_receiver_looking_into_the_sun_is_dazzled_and_at_night_it_is_not(tmp_path: Path) -> None:
    beams = np.arange(-10.0, 10.5, 0.5)
    for total, dazzled in ((1370.0, True), (0.0, False)):
        weather = {"sun": {"azimuth_deg": 0.0, "elevation_deg": 0.01, "total_w_m2": total}}
        measure = build(tmp_path, model="sick-lms291-s05", weather=weather, physics={"rule": "axis"})
        scan = measure(plan(beams))
        flagged = beams[(scan.flags & DAZZLED) != 0]
        assert (flagged.size > 0) == dazzled
        assert (np.abs(flagged) < 1.0).all()
        assert np.isnan(scan.range_m[(scan.flags & DAZZLED) != 0]).all()


def test_a_roof_before_the_sun_ends_the_dazzle(tmp_path: Path) -> None:
    weather = {"sun": {"azimuth_deg": 0.0, "elevation_deg": 0.01}}
    roof = plate(5.0, "dark", 1.0)
    measure = build(tmp_path, [roof], model="sick-lms291-s05", weather=weather, physics={"rule": "axis"})
    assert not (measure(plan([0.0])).flags & DAZZLED).any()


def test_a_sunlit_wall_does_not_show_in_a_pin_receiver(tmp_path: Path) -> None:
    physics = {**QUIET, "rule": "axis"}
    night = build(tmp_path, [plate(30.0, "white")], physics=physics)(plan())
    sun = {"sun": {"azimuth_deg": 180.0, "elevation_deg": 20.0}}
    day = build(tmp_path, [plate(30.0, "white")], weather=sun, physics=physics)(plan())
    assert day.intensity == pytest.approx(night.intensity, rel=2e-5)
    assert day.range_m == pytest.approx(night.range_m, abs=1e-5)


def test_a_clipped_echo_is_marked_and_keeps_its_place(tmp_path: Path) -> None:
    tau = 16e-9
    # the walk table is entered with the clipped height, 10 times the threshold, instead of 600 times
    early = float(pulse.walk_sin2(tau, 600.0) - pulse.walk_sin2(tau, 10.0))
    for method, error in (("leading_edge", early), ("peak", 0.0), ("centroid", 0.0)):
        physics = {**QUIET, "rule": "axis", "full_scale_snr": 50.2, "detection": method}
        scan = build(tmp_path, [plate(5.0, "white")], weather=CLEAR, physics=physics)(plan())
        assert scan.flags[0] & SATURATED
        assert scan.range_m[0, 0] == pytest.approx(5.0 + error, abs=1e-2)


def test_after_a_clipped_echo_the_receiver_is_blind_for_a_while(tmp_path: Path) -> None:
    physics = {**QUIET, "rule": "adaptive", "echoes": "all", "max_echoes": 4, "full_scale_snr": 50.0}
    world = [plate(5.0, "white", 10.0, 5.0), plate(15.0, "white")]
    both = build(tmp_path, world, weather=CLEAR, physics=physics)(plan())
    assert np.count_nonzero(np.isfinite(both.range_m)) == 2
    blind = build(tmp_path, world, weather=CLEAR, physics={**physics, "recovery_ns": 100.0})(plan())
    assert np.count_nonzero(np.isfinite(blind.range_m)) == 1


@pytest.mark.parametrize(("echoes", "wanted"), [("first", 20.0), ("strongest", 30.0), ("last", 40.0)])
def test_a_sensor_of_one_echo_reports_the_one_it_prefers(tmp_path: Path, echoes: str, wanted: float) -> None:
    third = 2.5 * 0.0061
    left, right = plate(20.0, "half", 5.0, 2.5 + third), plate(30.0, "white", 5.0, -2.5 - third)
    world = [left, right, plate(40.0, "half")]
    physics = {**QUIET, "rule": "adaptive", "echoes": echoes, "max_echoes": 1, "divergence_deg": 0.2}
    scan = build(tmp_path, world, weather=CLEAR, physics=physics)(plan())
    assert scan.range_m.shape == (1, 1)
    assert scan.range_m[0, 0] == pytest.approx(wanted, abs=0.01)


def test_without_a_walk_table_weak_echoes_come_late(tmp_path: Path) -> None:
    """Oracles `walk_sin2`: 0.491 m at ten times the threshold, 0.153 m at a hundred times."""
    for over, walk_m in ((10.0, 0.491), (100.0, 0.153)):
        physics = {
            **QUIET,
            "rule": "axis",
            "walk_table": False,
            "threshold_to_noise": 5.0,
            "system_constant_m2": 75000.0,
        }
        scan = build(tmp_path, physics=physics, **at_snr(5.0 * over))(plan())
        assert scan.range_m[0, 0] - 10.0 == pytest.approx(walk_m, abs=1e-3)


def test_fog_correction_drops_what_is_fainter_than_its_reflectance(tmp_path: Path) -> None:
    for rho, seen in ((0.0039, False), (0.0041, True)):
        world, materials = [plate(2.0, "chosen")], {"chosen": grey(rho)}
        physics = {**QUIET, "rule": "axis", "floor_reflectance": 0.004}
        scan = build(tmp_path, world, materials=materials, model="sick-lms291-s05", physics=physics, weather=CLEAR)(
            plan()
        )
        assert np.isfinite(scan.range_m[0, 0]) == seen


def test_nothing_is_reported_from_before_the_near_gate_or_behind_the_gate(tmp_path: Path) -> None:
    for range_m, seen in ((0.4, False), (0.6, True), (300.0, False)):
        measure = build(tmp_path, [plate(range_m, "white")], model="sick-ld-lrs1000", physics={**QUIET, "rule": "axis"})
        assert np.isfinite(measure(plan()).range_m[0, 0]) == seen


def test_a_systematic_error_moves_every_range(tmp_path: Path) -> None:
    physics = {**QUIET, "rule": "axis", "systematic_mm": 35.0, "weather_echoes": False}
    scan = build(tmp_path, [plate(8.0, "white")], physics=physics)(plan())
    assert scan.range_m[0, 0] == pytest.approx(8.035, abs=1e-6)


def test_the_gain_of_a_plan_is_a_factor_on_the_signal(tmp_path: Path) -> None:
    from dataclasses import replace

    measure = build(tmp_path, [plate(30.0, "half")], weather=CLEAR, physics={**QUIET, "rule": "axis"})
    one = measure(plan()).intensity[0, 0]
    assert measure(replace(plan(), gain=(25 / 30) ** 2)).intensity[0, 0] == pytest.approx(
        one * (25 / 30) ** 2, rel=1e-12
    )


def test_an_empty_scene_and_an_empty_plan_give_no_echo(tmp_path: Path) -> None:
    measure = build(tmp_path, physics=QUIET)
    assert np.isnan(measure(plan(np.arange(-5.0, 6.0))).range_m).all()
    assert len(measure(plan([])).range_m) == 0
