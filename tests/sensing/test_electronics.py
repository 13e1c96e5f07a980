"""Receivers with electronics in whole scans: rated values stand, nothing is computed where they are off."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from emulator.errors import ScenarioError
from emulator.sensing import error_budget
from emulator.sensing.daylight import NIGHT
from emulator.sensing.photon_receiver import PhotonReceiver
from emulator.sensing.receiver import Receiver
from emulator.sensors.spec import list_models, load_spec
from protocols.scan import SATURATED
from tests.sensing.rig import QUIET, build, plan, plate

CLEAR: dict[str, Any] = {"visibility_m": 1e9}
ALONE = {"range_noise_mm": 0.0, "false_alarms": False}


def test_no_shipped_model_has_electronics_and_without_them_nothing_is_made(tmp_path: Path) -> None:
    for name in list_models():
        receiver = load_spec(name).receiver
        assert receiver is None or receiver.response is None
    measure = build(tmp_path, [plate(20.0, "half")])
    assert isinstance(measure._receiver, Receiver)
    assert measure._receiver._shaped is None
    off = build(tmp_path, [plate(20.0, "half")], physics={"response": "off"})
    assert off(plan(np.zeros(50))).range_m.tobytes() == measure(plan(np.zeros(50))).range_m.tobytes()


@pytest.mark.parametrize("response", ["single_pole", "gauss"])
def test_the_rated_range_of_a_device_stands(tmp_path: Path, response: str) -> None:
    """LMS291: 30 m at 10 %: its echo is as high as the threshold there. Half of the beams see a plate at that place."""
    seen = []
    for range_m in (28.0, 30.0, 33.0):
        physics = {**ALONE, "rule": "axis", "response": response, "floor_reflectance": "off", "noise": False}
        measure = build(tmp_path, [plate(range_m, "dark")], weather=CLEAR, model="sick-lms291-s05", physics=physics)
        scan = measure(plan())
        seen.append(bool(np.isfinite(scan.range_m[0, 0])))
        if seen[-1]:
            assert scan.intensity[0, 0] == pytest.approx((30.0 / range_m) ** 2, rel=2e-3)
    assert seen[0] is True
    assert seen[2] is False


def test_slanted_walls_and_two_plates_are_where_the_ideal_receiver_has_them(tmp_path: Path) -> None:
    wall = {**plate(12.0, "half"), "yaw_deg": 40.0}
    for world in ([wall], [plate(10.0, "half", 5.0, 2.505), plate(17.0, "half")]):
        scans = [
            build(tmp_path, world, weather=CLEAR, physics={**QUIET, "echoes": "all", "max_echoes": 2, "response": one})(
                plan()
            )
            for one in ("off", "gauss")
        ]
        assert scans[1].range_m == pytest.approx(scans[0].range_m, abs=0.03, nan_ok=True)
        assert scans[1].actor.tolist() == scans[0].actor.tolist()


def test_behind_a_saturating_retroreflector_a_wall_is_hidden_and_comes_back_farther_on(tmp_path: Path) -> None:
    """One pole of 20 MHz: the tail of the clipped plate is above the wall's light for some metres."""
    hidden = []
    for behind in (3.0, 6.0, 30.0):
        world = [plate(10.0, "retro_sheeting", 5.0, 2.5), plate(10.0 + behind, "half")]
        physics = {
            **QUIET, "echoes": "all", "max_echoes": 3, "response": "single_pole", "corner_mhz": 20.0,
            "full_scale_snr": 20000, "rule": "grid",
        }  # fmt: skip
        scan = build(tmp_path, world, weather=CLEAR, model="sick-lms291-s05", physics=physics)(plan())
        assert scan.flags[0] & SATURATED
        hidden.append(np.count_nonzero(np.isfinite(scan.range_m[0])) < 2)
    assert hidden == [True, True, False]


def test_false_alarms_are_as_frequent_as_the_law_of_the_filter_says(tmp_path: Path) -> None:
    measure = build(
        tmp_path, [plate(100.0, "white")], weather=CLEAR,
        physics={
            "rule": "axis", "threshold_to_noise": 3.5, "response": "gauss", "range_noise_mm": 0.0, "echoes": "first",
        },
    )  # fmt: skip
    assert isinstance(measure._receiver, Receiver)
    scan = measure(plan(np.zeros(4000), max_echoes=1))
    response = measure.model.response
    assert response is not None
    rate = float(response.crossings_hz(3.5, 2.0 * measure.model.bin_m / 299792458.0))
    early = float(np.mean(scan.range_m[:, 0] < 97.0))
    expected = -np.expm1(-rate * 2.0 * (97.0 - measure.model.near_gate_m) / 299792458.0)
    assert early == pytest.approx(expected, abs=4.0 * np.sqrt(expected / 4000))


def test_a_wanted_rate_of_false_alarms_sets_the_threshold_by_that_law(tmp_path: Path) -> None:
    model = build(tmp_path, physics={"false_alarms_per_gate": 1e-4, "response": "gauss"}).model
    assert model.response is not None
    per_gate = float(model.response.crossings_hz(model.threshold, 2.0 * model.bin_m / 299792458.0)) * 500.0 / 299792458
    assert per_gate == pytest.approx(1e-4, rel=1e-6)


def test_fog_is_shaped_too(tmp_path: Path) -> None:
    physics = {**QUIET, "rule": "axis", "echoes": "first"}
    fog = {"fog": {"visibility_m": 30.0}}
    off, on = (build(tmp_path, weather=fog, physics={**physics, "response": one})(plan()) for one in ("off", "gauss"))
    assert np.isfinite(off.range_m[0, 0])
    assert on.range_m[0, 0] == pytest.approx(off.range_m[0, 0], abs=0.3)


def test_the_scan_is_the_same_in_whatever_order_and_with_all_rules_off(tmp_path: Path) -> None:
    physics = {**ALONE, "rule": "axis", "response": "gauss"}
    one = build(tmp_path, [plate(20.0, "half")], weather=CLEAR, physics=physics)
    late, early = one(plan(np.zeros(30), sweep=5)), one(plan(np.zeros(30), sweep=2))
    again = build(tmp_path, [plate(20.0, "half")], weather=CLEAR, physics={**physics, "full": True})
    assert again(plan(np.zeros(30), sweep=2)).range_m == pytest.approx(early.range_m, abs=1e-9)
    assert again(plan(np.zeros(30), sweep=5)).range_m == pytest.approx(late.range_m, abs=1e-9)
    assert not np.array_equal(early.range_m, late.range_m)


@pytest.mark.parametrize("response", ["single_pole", "gauss"])
def test_a_low_threshold_finds_echoes_at_the_rim_of_a_window_and_computes_no_nonsense(
    tmp_path: Path, response: str
) -> None:
    """Noise is over a threshold of three rms at first and last samples too; numpy's warnings are errors here."""
    physics = {**ALONE, "rule": "axis", "response": response, "pulse_fwhm_ns": 3.0, "threshold_to_noise": 3.0}
    measure = build(tmp_path, [plate(20.0, "dark")], weather=CLEAR, physics={**physics, "detection": "peak"})
    scan = measure(plan(np.zeros(1000), max_echoes=1))
    seen = scan.range_m[:, 0]
    assert np.count_nonzero(np.abs(seen - 20.0) < 1.0) > 900
    assert np.isfinite(scan.intensity[np.isfinite(seen), 0]).all()


def test_explain_says_whether_they_are_computed(tmp_path: Path) -> None:
    for response, out in (("off", True), ("gauss", False)):
        measure = build(tmp_path, [plate(20.0, "half")], physics={"response": response})
        rows = {row["term"]: row for row in error_budget.explained(measure, plan())}
        assert rows["receiver electronics"]["left_out"] is out


@pytest.mark.parametrize(
    ("physics", "message"),
    [
        ({"corner_mhz": 10.0}, "corner_mhz without response"),
        ({"response": "off", "tail_ns": 3.0}, "tail_ns beside response off"),
        ({"response": "gauss", "photons": {}}, "response beside photons"),
        ({"response": "bessel"}, "single_pole"),
        ({"response": "gauss", "tail_share": 0.7}, "tail_share"),
        ({"photons": {"cells": 10}}, "cells without dead_time_ns"),
        ({"photons": {"dead_time_ns": 0.3}}, "shorter than photons.bin_ns"),
    ],
)
def test_keys_that_do_not_fit_are_refused(tmp_path: Path, physics: dict[str, Any], message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        build(tmp_path, physics=physics)


def test_dead_time_lets_a_wall_show_behind_a_bright_plate(tmp_path: Path) -> None:
    """First-photon electronics never see the second of two bright echoes; a cell that is ready again does."""
    world = [plate(5.0, "white", 5.0, 2.5), plate(40.0, "white")]
    bright = {"rule": "grid", "gate_m": 60.0, "system_constant_m2": 75000.0, "near_gate_m": 20.0}
    seen = []
    for more in ({}, {"dead_time_ns": 50.0}, {"dead_time_ns": 500.0}, {"dead_time_ns": 50.0, "cells": 100}):
        measure = build(tmp_path, world, weather=CLEAR, physics={**bright, "photons": {"shots": 200, **more}})
        assert isinstance(measure._receiver, PhotonReceiver)
        counts, _ = measure._receiver._histogram(
            measure.view(plan()).echoes, 0, 1, None, NIGHT,
            np.random.default_rng(1),
        )  # fmt: skip
        seen.append(float(counts[0, round(37.0 / measure._receiver.bin_m) :].sum()))
    assert seen[0] < 1.0
    assert seen[1] > 190.0
    assert seen[2] < 1.0
    assert seen[3] > 100.0 * seen[1] / 10.0


def test_sheeting_at_a_slant_is_dimmer_in_a_scan(tmp_path: Path) -> None:
    bright = []
    for yaw in (0.0, 40.0):
        world = [{**plate(30.0, "chosen", 5.0), "yaw_deg": yaw}]
        made = {"chosen": {"rho": 0.0, "model": "retro", "retro_class": "ra1"}}
        physics = {**QUIET, "rule": "laguerre", "full_scale_snr": "off"}
        bright.append(build(tmp_path, world, weather=CLEAR, materials=made, physics=physics)(plan()).intensity[0, 0])
    assert bright[1] / bright[0] == pytest.approx(10.0 / 70.0 / math.cos(math.radians(40.0)), rel=0.02)
