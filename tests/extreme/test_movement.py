"""Motion during a scan: section 6.4 of the project's physics specification, through the LMS2xx's own sweeps.

The plans are those of sessions, so that instants and order of the beams are the device's, combs included.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from emulator.physics import counting
from emulator.physics.constants import SPEED_OF_LIGHT_M_S
from emulator.sensing.measure import Measure
from protocols.lms2xx.telegrams import MeasuredValues, read_values
from protocols.scan import Scan, ScanPlan
from tests.protocols.ld.reader import request
from tests.protocols.ld.rig import measuring
from tests.protocols.lms2xx.rig import Rig
from tests.sensing.rig import QUIET, build, plan, plate

CLEAR = {"visibility_m": 1e9}
RAY = {**QUIET, "rule": "axis"}
TURN_S = 1.0 / 75.0


def receding(at_m: float = 20.0, speed_m_s: float = 100.0) -> dict[str, Any]:
    """A large plate across x that moves along it."""
    motion = {"at_m": [at_m, 0.0, 0.0], "pitch_deg": -90.0, "velocity_m_s": [speed_m_s, 0.0, 0.0]}
    return {"id": "target", "shape": {"plane": {"size_m": [100.0, 400.0]}}, "material": "white", "motion": motion}


def one_scan(rig: Rig) -> tuple[ScanPlan, MeasuredValues]:
    """The next measured values on request, and the plan that they were measured by."""
    rig.ask("30 01")
    telegram = rig.await_reply(0xB0, 3.0)
    assert telegram is not None
    values = read_values(telegram)
    assert values is not None
    sent = rig.scans()[-1]
    return next(one for one in rig.plans if one.sweep == sent.sweep), values


def test_the_error_of_one_pose_a_scan_is_what_the_section_says() -> None:
    """Oracles `pose steps, ...`; 100 m/s and 13.3 ms: one pose 0.667 m, 181 poses 3.7 mm; 10 Hz: 5 m."""
    assert float(counting.pose_step_error(100.0, TURN_S, 1.0)) == pytest.approx(0.6667, abs=1e-4)
    found = float(counting.pose_step_error(100.0, 0.0133333333333333, 181.0))
    assert found == pytest.approx(0.0036832412523020165746, rel=1e-12)
    assert float(counting.pose_step_error(100.0, 0.1, 1.0)) == 5.0


@pytest.mark.parametrize(("resolution_deg", "field_deg"), [(1, 180), (0.5, 180), (0.25, 100), (1, 100)])
@pytest.mark.parametrize("speed_m_s", [100.0, -100.0])
def test_a_plate_that_recedes_at_100_m_s_has_each_beams_own_range_on_the_wire(
    tmp_path: Path, resolution_deg: float, field_deg: int, speed_m_s: float
) -> None:
    """LMS291 at 75 Hz: R0 + v t_j within one LSB; combs of 0.5 and 0.25 degrees take several turns."""
    at_m = 20.0 if speed_m_s > 0 else 30.0
    measure = build(tmp_path, actors=[receding(at_m, speed_m_s)], model="sick-lms291-s05", physics=RAY, weather=CLEAR)
    rig = Rig.on(measure=measure, resolution_deg=resolution_deg, field_deg=field_deg, unit="mm",
                 measuring_mode="32m-field-a")  # fmt: skip
    done, values = one_scan(rig)
    t_s = 1e-9 * done.start_ns + done.fire_offset_s
    range_m = (at_m + speed_m_s * t_s) / np.cos(done.azimuth_rad)
    heard = np.abs(np.degrees(done.azimuth_rad)) < 60.0
    heard &= range_m < 32.0
    assert heard.sum() > 20
    words = values.values.astype(np.float64)[heard]
    assert np.abs(words - 1000.0 * range_m[heard]).max() <= 1.0
    span_s = float(np.ptp(done.fire_offset_s))
    assert 100.0 * span_s > 0.3  # metres: one pose for all would be seen


def test_a_plate_that_recedes_has_each_beams_own_range_over_a_whole_revolution_of_100_ms(tmp_path: Path) -> None:
    """One pose for a 10 Hz revolution would be 5 m wrong."""
    measure = build(tmp_path, actors=[receding()], model="sick-ld-lrs1000", physics=RAY, weather=CLEAR)
    rig = measuring({"motor_hz": 10, "step_deg": 0.5}, world=measure)
    rig.put(request(0x0301, 1, 0x0100))
    rig.run(300_000_000)
    for done in rig.plans[:2]:
        scan = measure(done)
        t_s = 1e-9 * done.start_ns + done.fire_offset_s
        heard = np.cos(done.azimuth_rad) > 0.5
        range_m = (20.0 + 100.0 * t_s) / np.cos(done.azimuth_rad)
        assert np.abs(scan.range_m[heard, 0] - range_m[heard]).max() < 1.0 / 512.0
        assert np.ptp(t_s[heard]) > 0.03


def test_motion_during_the_lights_way_is_left_out_and_is_less_than_half_a_step(tmp_path: Path) -> None:
    """2 v R/c = 0.17 mm at 100 m/s and 250 m."""
    skipped_m = 2.0 * 100.0 * 250.0 / SPEED_OF_LIGHT_M_S
    assert skipped_m == pytest.approx(1.668e-4, rel=1e-3)
    measure = build(tmp_path, actors=[receding(249.0)], physics={**RAY, "gate_m": 300.0, "system_constant_m2": 1e8},
                    weather=CLEAR)  # fmt: skip
    scan = measure(plan([0.0], start_s=0.01))
    assert scan.range_m[0, 0] == pytest.approx(250.0, abs=1e-9)
    assert skipped_m < 0.5 * measure.model.lsb_m


def same_ranges(one: Scan, two: Scan) -> None:
    assert one.range_m == pytest.approx(two.range_m, abs=1e-9, nan_ok=True)
    np.testing.assert_array_equal(one.actor, two.actor)
    np.testing.assert_array_equal(np.round(one.range_m * 1000.0), np.round(two.range_m * 1000.0))


@pytest.mark.parametrize("rule", ["axis", "spiral", "adaptive"])
def test_what_rests_is_the_same_with_the_machinery_of_motion_on_and_off(tmp_path: Path, rule: str) -> None:
    wall = plate(12.0, "half", 20.0)
    ball = {"id": "ball", "shape": {"sphere": {"radius_m": 1.0}}, "material": "dark"}
    place = [8.0, 1.0, -1.0]
    points = [{"t_s": t, "at_m": place} for t in (0.0, 50.0, 100.0)]
    drivers = [{"id": "ego", "motion": motion} for motion in ({}, {"waypoints": [{"t_s": 0.0, "at_m": [0.0, 0.0, 0.0]},
               {"t_s": 9.0, "at_m": [0.0, 0.0, 0.0]}]})]  # fmt: skip
    motions: list[dict[str, Any]] = [{"at_m": place}, {"waypoints": points}, {"waypoints": points, "loop": True}]
    fire = np.tile(np.arange(181), 2)[:361] / 360.0 * TURN_S
    scans = []
    for ego in drivers:
        for motion in motions:
            measure = build(
                tmp_path, [wall], actors=[ego, {**ball, "motion": motion}], mount={"actor": "ego"},
                model="sick-lms291-s05", physics={**QUIET, "rule": rule, "sub_beams": 16, "depth": 1},
            )  # fmt: skip
            scans.append(measure(plan(np.arange(-90.0, 90.5, 0.5), fire_s=fire)))
    for scan in scans[1:]:
        same_ranges(scans[0], scan)


def test_sensor_and_target_that_move_together_see_each_other_at_rest(tmp_path: Path) -> None:
    """100 m/s each, 5e6 m from the origin."""
    start = [5e6, -5e6, 100.0]
    ego = {"id": "ego", "motion": {"at_m": start, "velocity_m_s": [100.0, -100.0, 0.0]}}
    target = {"id": "target", "shape": {"plane": {"size_m": [50.0, 50.0]}}, "material": "white",
              "motion": {"at_m": [start[0] + 20.0, start[1], start[2]], "pitch_deg": -90.0,
                         "velocity_m_s": [100.0, -100.0, 0.0]}}  # fmt: skip
    measure = build(tmp_path, actors=[ego, target], mount={"actor": "ego"}, physics=RAY, weather=CLEAR)
    fire = np.linspace(0.0, TURN_S, 81)
    azimuth = np.linspace(-40.0, 40.0, 81)
    for start_s in (0.0, 1.0, 1000.0):
        scan = measure(plan(azimuth, fire_s=fire, start_s=start_s))
        assert np.abs(scan.range_m[:, 0] - 20.0 / np.cos(np.radians(azimuth))).max() < 1.2e-4


def overtaking(folder: Path, **physics: Any) -> Measure:
    motion = {"at_m": [10.0, -5.0, -1.0], "velocity_m_s": [0.0, 100.0, 0.0], "yaw_rate_deg_s": 3600.0}
    box = {"id": "box", "shape": {"box": {"size_m": [2.0, 2.0, 2.0]}}, "material": "half", "motion": motion}
    return build(folder, [plate(30.0, "white")], actors=[box], physics={**QUIET, **physics}, weather=CLEAR)


def test_beams_in_any_order_of_their_instants_see_what_each_would_alone(tmp_path: Path) -> None:
    measure = overtaking(tmp_path, rule="axis")
    azimuth, fire = np.linspace(-30.0, 30.0, 61), 0.1 * np.random.default_rng(2).random(61)
    scan = measure(plan(azimuth, fire_s=fire))
    assert len(np.unique(scan.actor[:, 0])) == 2  # box and wall
    for j in range(0, 61, 5):
        alone = measure(plan(azimuth[j : j + 1], fire_s=fire[j : j + 1]))
        assert alone.range_m[0, 0] == pytest.approx(scan.range_m[j, 0], abs=1e-9)
        assert alone.actor[0, 0] == scan.actor[j, 0]
