"""Pulses of other lidars: which arrives where and how strong, counted pulse by pulse apart from the product."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from emulator.errors import ScenarioError
from emulator.physics.constants import SPEED_OF_LIGHT_M_S
from emulator.sensing.error_budget import explained
from emulator.sensing.measure import Measure
from tests.sensing.rig import QUIET, build, plan, plate

PHYSICS: dict[str, Any] = {**QUIET, "rule": "axis", "echoes": "all", "max_echoes": 8, "full_scale_snr": "off",
                           "weather_echoes": False}  # fmt: skip
AIR = {"visibility_m": 1e9}
BEAMS = 2000
ACROSS = {"at_m": [0.0, 3.0, 0.0], "yaw_deg": -math.degrees(math.atan2(3.0, 10.0))}
"Three metres to the left, and its beam at azimuth 0 where ours is on the wall."
FIRE_S = 50e-6 * np.arange(BEAMS)
ASIDE_M = 2e-3
PULSE_HZ = 101_234.5
"Five and a bit in the time from beam to beam."


def beside(**keys: Any) -> dict[str, Any]:
    """A standing beam 2 mm beside ours, on the same wall."""
    return {"id": "it", "model": "paper-905nm", "mount": {"at_m": [0.0, ASIDE_M, 0.0]}, "turn_hz": 0.0,
            "pulse_hz": PULSE_HZ, "phase_us": 3.3, **keys}  # fmt: skip


def on_a_wall(folder: Path, *emitters: dict[str, Any], **keys: Any) -> Measure:
    keys = {"weather": AIR, "physics": PHYSICS, **keys}
    return build(folder, keys.pop("world", [plate(10.0, "half")]), emitters=emitters, **keys)


def one_by_one(start_s: float, way_m: float, period_s: float, phase_s: float, gate_m: float) -> set[tuple[int, int]]:
    """(beam, range in cm) of every pulse within the gate: all pulses against all beams."""
    found = set()
    number = np.arange(math.floor((start_s - phase_s) / period_s) - 3, (start_s + FIRE_S[-1] + 1e-4) / period_s)
    arrives = phase_s + number * period_s + way_m / SPEED_OF_LIGHT_M_S
    for beam, fired in enumerate(start_s + FIRE_S):
        range_m = 0.5 * SPEED_OF_LIGHT_M_S * (arrives - fired)
        found |= {(beam, round(100 * one)) for one in range_m[(range_m >= 0.0) & (range_m <= gate_m)]}
    return found


@pytest.mark.parametrize("start_s", [0.0, 7.3])
def test_every_pulse_that_comes_into_a_gate_is_an_echo_there(tmp_path: Path, start_s: float) -> None:
    measure = on_a_wall(tmp_path, beside())
    scan = measure(plan(np.zeros(BEAMS), start_s=start_s, fire_s=FIRE_S))
    wanted = one_by_one(start_s, 20.0, 1.0 / (PULSE_HZ * (1.0 + 20e-6)), 3.3e-6, measure.model.gate_m)
    apart = {(beam, cm) for beam, cm in wanted if abs(cm - 1000) > 400 and cm > 100 and cm < 24_700}  # not in our own
    rows, places = np.nonzero(np.isfinite(scan.range_m) & (np.abs(scan.range_m - 10.0) > 4.0))
    found = {(int(row), round(100 * float(scan.range_m[row, place]))) for row, place in zip(rows, places, strict=True)}
    assert len(apart) > 200
    near = {(beam, cm + off) for beam, cm in found for off in (-2, -1, 0, 1, 2)}
    assert apart <= near
    assert len(found) <= len(wanted)
    assert (scan.actor[rows, places] == -1).all()


def test_false_echoes_come_as_often_as_pulses_fall_into_gates_and_move_with_the_clocks(tmp_path: Path) -> None:
    measure = on_a_wall(tmp_path, beside())
    gate_s = 2.0 * measure.model.gate_m / SPEED_OF_LIGHT_M_S
    count, places = 0, []
    for sweep in range(5):
        scan = measure(plan(np.zeros(BEAMS), sweep=sweep, start_s=0.137 * sweep, fire_s=FIRE_S))
        false = np.isfinite(scan.range_m) & (np.abs(scan.range_m - 10.0) > 0.5)
        count += int(np.count_nonzero(false))
        places.append(scan.range_m[false])
    assert count / (5 * BEAMS) == pytest.approx(PULSE_HZ * gate_s, rel=0.1)
    assert measure.others is not None
    assert measure.others.pulses_of(BEAMS) == pytest.approx(PULSE_HZ * gate_s * BEAMS, rel=1e-3)
    still = on_a_wall(tmp_path, beside(pulse_hz=1e5, clock_ppm=0.0, phase_us=0.4))
    again = [still(plan(np.zeros(BEAMS), sweep=k, start_s=0.137 * k, fire_s=FIRE_S)).range_m for k in (0, 1)]
    np.testing.assert_allclose(again[0], again[1], atol=2e-3)  # five pulses a beam, in step
    assert np.nanmax(again[0]) > 50.0
    assert np.std(np.concatenate(places)) > 30.0


def test_a_pulse_on_a_wall_is_as_strong_as_its_spot_in_our_field_of_view(tmp_path: Path) -> None:
    """Random points of its spot, those counted that we look at."""
    aside_m = 12e-3
    emitter = beside(pulse_hz=1000.0, clock_ppm=0.0, phase_us=0.5, mount={"at_m": [0.0, aside_m, 0.0]})
    measure = on_a_wall(tmp_path, emitter)
    model = measure.model
    scan = measure(plan([0.0], fire_s=0.0))
    rng = np.random.default_rng(3)
    width = model.beam.half_angle_x_rad * 10.0
    point = rng.normal(scale=0.5 * width, size=(400_000, 2))
    point[:, 0] += aside_m
    inside = float(np.mean(np.hypot(*point.T) < 10.0 * 0.5 * model.receiver.field_of_view_rad))
    false = np.abs(scan.range_m[0] - (0.5 * SPEED_OF_LIGHT_M_S * 0.5e-6 + 10.0)) < 0.1
    assert np.count_nonzero(false) == 1
    assert 0.3 < inside < 0.98
    assert float(scan.intensity[0, false][0]) * model.threshold == pytest.approx(
        model.k_m2 * 0.5 / 100.0 * inside, rel=0.01
    )


@pytest.mark.parametrize(("off_deg", "share"), [(0.0, 1.0), (2.0, 2.5e-5)])
def test_a_beam_into_our_eyes_has_the_light_that_falls_on_the_aperture(
    tmp_path: Path, off_deg: float, share: float
) -> None:
    """2 a^2/w^2 of it; beside the field of view the stray light of the sun's law."""
    emitter = beside(pulse_hz=1000.0, clock_ppm=0.0, phase_us=0.5,
                     mount={"at_m": [40.0, 0.0, 0.0], "yaw_deg": 180.0})  # fmt: skip
    measure = on_a_wall(tmp_path, emitter, world=[])
    model = measure.model
    scan = measure(plan([off_deg], fire_s=0.0))
    a, w = model.aperture_radius_m, 40.0 * model.beam.half_angle_x_rad
    wanted = model.k_m2 / a**2 * -math.expm1(-2.0 * a**2 / w**2) * share
    assert scan.range_m[0, 0] == pytest.approx(0.5 * (SPEED_OF_LIGHT_M_S * 0.5e-6 + 40.0), abs=0.02)
    assert float(scan.intensity[0, 0]) * model.threshold == pytest.approx(wanted, rel=0.01)


@pytest.mark.parametrize("world", [
    [plate(10.0, "half"), plate(5.0, "dark", 1.0, 1.5)],  # between it and its spot
    [plate(10.0, "half"), plate(0.5, "dark", 0.9, -0.4493, 1.0)],  # between us and its spot
])  # fmt: skip
def test_what_hides_the_spot_hides_the_echo(tmp_path: Path, world: list[dict[str, Any]]) -> None:
    emitter = beside(mount=ACROSS)
    open_, hidden = (
        on_a_wall(tmp_path, emitter, world=one)(plan(np.zeros(BEAMS), fire_s=FIRE_S)).range_m
        for one in (world[:1], world)
    )
    false = [
        np.count_nonzero((np.abs(one - 10.0) > 0.5) & (one > 1.0) & (np.abs(one - 5.0) > 0.5))
        for one in (open_, hidden)
    ]
    assert false[0] > 100
    assert false[1] == 0


def test_light_on_the_back_of_a_plate_is_not_seen_from_its_front(tmp_path: Path) -> None:
    emitter = beside(mount={"at_m": [20.0, ASIDE_M, 0.0], "yaw_deg": 180.0})
    scan = on_a_wall(tmp_path, emitter)(plan(np.zeros(BEAMS), fire_s=FIRE_S))
    assert np.nanmax(np.abs(scan.range_m - 10.0)) < 0.1


def test_another_wavelength_costs_nothing_and_explain_says_so(tmp_path: Path) -> None:
    far = {"id": "right", "model": "paper-905nm", "physics": {"wavelength_nm": 1550}}
    measure = on_a_wall(tmp_path, {"id": "it", "sensor": "right", "turn_hz": 0.0}, others=[far])
    assert measure.others is not None
    assert measure.others.found == ()
    row = next(one for one in explained(measure, plan([0.0])) if one["term"] == "pulses of other lidars")
    assert row["left_out"]
    assert "it, stopped by the optical filter" in row["saves"]
    assert on_a_wall(tmp_path).others is None
    assert on_a_wall(tmp_path, {"id": "me", "sensor": "front"}).others is None, "nobody is his own disturbance"


def test_a_turning_beam_comes_by_once_a_turn(tmp_path: Path) -> None:
    """10 turns a second: in 2 s our beam, which stands, has pulses of 20 passes."""
    measure = on_a_wall(
        tmp_path, beside(turn_hz=10.0, pulse_hz=2e5, field_deg=90.0, mount=ACROSS), world=[plate(10.0, "half")]
    )
    fire = 20e-6 * np.arange(100_000)
    scan = measure(plan(np.zeros(len(fire)), fire_s=fire))
    beams = np.unique(np.nonzero(np.abs(scan.range_m - 10.0) > 0.5)[0])
    turns = np.mod(fire[beams] * 10.0 * (1.0 + 20e-6) + 0.5, 1.0) - 0.5
    assert len(beams) > 20
    assert np.abs(turns).max() < 3e-3 / (2.0 * math.pi) + 1e-4
    assert len(np.unique(np.round(fire[beams] * 10.0))) >= 8


@pytest.mark.parametrize(("emitter", "reported"), [
    ({"id": "a"}, "want either sensor or model"),
    ({"id": "a", "sensor": "left"}, "emitters.a.sensor: 'left'; want"),
    ({"id": "a", "model": "sick-lms292"}, "emitters.a.model: 'sick-lms292'; want a shipped model"),
    ({"id": "a", "model": "can-esr"}, "emitters.a.model: 'can-esr' lists objects; want one that sends beams"),
    ({"id": "a", "sensor": "front", "mount": {}}, "mount beside sensor"),
    ({"id": "a", "model": "paper-905nm", "mount": {"actor": "car"}}, "emitters.a.mount.actor: 'car'"),
    ({"id": "a", "model": "paper-905nm", "pulse_hz": 0.0}, "emitters.a.pulse_hz"),
])  # fmt: skip
def test_a_wrong_emitter_is_refused_with_its_place(tmp_path: Path, emitter: dict[str, Any], reported: str) -> None:
    with pytest.raises(ScenarioError) as raised:
        on_a_wall(tmp_path, emitter)
    assert reported in str(raised.value)
