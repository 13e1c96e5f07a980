"""The `physics:` table of a sensor: what is refused, and what its choices do."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from emulator.casting import raycast
from emulator.errors import EmulatorError, ScenarioError
from emulator.scenario import scenario
from emulator.sensing.measure import build as build_measure
from emulator.world import scene
from protocols.scan import Scan
from tests.sensing.rig import QUIET, build, grey, plan, plate

SCAN_DEG = np.arange(-60.0, 60.5, 0.5)


@pytest.mark.parametrize(
    ("physics", "reported"),
    [
        ({"divergence_deg": 20.1}, "physics.divergence_deg"),
        ({"divergence_deg": -1}, "physics.divergence_deg"),
        ({"divergence_deg": [0.1, 30]}, "physics.divergence_deg"),
        ({"rule": "cubic"}, "want 'axis', 'laguerre', 'spiral', 'grid' or 'adaptive'"),
        ({"sub_beams": 0}, "physics.sub_beams: 0; want a"),
        ({"sub_beams": 1.5}, "physics.sub_beams: 1.5; want a"),
        ({"pulse_fwhm_ns": 0}, "physics.pulse_fwhm_ns: 0; want a number >= 0.01"),
        ({"threshold_to_noise": 5, "false_alarms_per_gate": 1e-4}, "want one of them"),
        ({"near_gate_m": 5, "gate_m": 4}, "not before gate_m"),
        ({"noise": "no"}, "physics.noise: 'no'; want true or false"),
        ({"sub_beam": 3}, "physics.sub_beam: unknown key"),
        ({"windscreen": {"rake_deg": 90}}, "physics.windscreen.rake_deg: 90; want a number < 90"),
        ({"full_scale_snr": 4.0}, "full_scale"),
        ({"wavelength_nm": 532}, "no value for 532 nm"),
        ({"floor_reflectance": 1e300}, "physics.floor_reflectance: 1e+300; want a number <= 10000"),
        ({"filter_offset_nm": -1e300}, "physics.filter_offset_nm: -1e+300; want a number >= -3000"),
        ({"bin_ns": 1e300}, "bin_ns: 1e+300; want at most the pulse's FWHM, 16"),
        ({"pulse_fwhm_ns": 0.1, "gate_m": 1e4}, "1.067e+07 steps of the sampled waveform, 0.00625 ns each; want"),
        ({"photons": {"bin_ns": 0.001}}, "photons.bin_ns 0.001 under a pulse of 16 ns; want at least 0.01562"),
        ({"photons": {"bin_ns": 0.1}, "gate_m": 1e4}, "want at most 100000: bin_ns from 0.6671, or gate_m to 1499"),
        ({"photons": {}, "gate_m": 1e6}, "6.671e+06 bins of gate_m 1e+06; want at most 100000"),
    ],
)
def test_a_wrong_choice_is_refused_by_file_line_and_key(tmp_path: Path, physics: dict[str, Any], reported: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        build(tmp_path, [plate(20.0, "asphalt")], physics=physics)
    assert reported in str(caught.value)
    assert "scene.yaml:1: sensors" in str(caught.value)


def test_a_sensor_that_lists_objects_has_no_beams_of_its_own(tmp_path: Path) -> None:
    text = {
        "schema": 1,
        "sensors": [
            {"id": "front", "model": "sick-lms291-s05"},
            {"id": "objects", "model": "can-ars408", "from": ["front"]},
        ],
    }
    path = tmp_path / "scene.yaml"
    path.write_text(json.dumps(text), encoding="utf-8")
    loaded = scenario.load(str(path))
    world = scene.build(loaded)
    with pytest.raises(EmulatorError, match="lists objects"):
        build_measure(loaded, world, raycast.Caster(world), "objects")


def test_a_laser_at_the_edge_of_its_filter_loses_half_its_light(tmp_path: Path) -> None:
    """Section 2.7: a 5 nm line in a 40 nm band, 20 nm off, passes exactly half; here a line far narrower."""
    amplitude = []
    for offset_nm in (0.0, 20.0, 30.0):
        measure = build(
            tmp_path, [plate(20.0, "half")], physics={**QUIET, "rule": "axis", "filter_offset_nm": offset_nm}
        )
        amplitude.append(float(measure.view(plan()).echoes.amplitude.sum()))
    assert amplitude[1] / amplitude[0] == pytest.approx(0.5, rel=1e-9)
    assert amplitude[2] == 0.0


def test_results_beyond_an_optical_depth_of_five_are_marked_as_estimates(tmp_path: Path) -> None:
    weather = {"fog": {"visibility_m": 30.0}, "visibility_m": 23000.0}
    measure = build(tmp_path, [plate(50.0, "sheet")], weather=weather, materials={
        "sheet": {"rho": 0.1, "model": "retro", "retro_cd_lx_m2": 700.0}},
        physics={**QUIET, "rule": "axis", "echoes": "last", "system_constant_m2": 3e6},
    )  # fmt: skip
    assert measure.warnings == ()
    measure(plan())
    assert any("single-scattering estimates" in line for line in measure.warnings)


def agree(one: Scan, two: Scan, lsb_m: float) -> float:
    """Share of the beams whose reported range is the same within a step."""
    same = np.isnan(one.range_m) & np.isnan(two.range_m) | (np.abs(one.range_m - two.range_m) <= lsb_m)
    return float(same.mean())


@pytest.mark.parametrize(
    "weather", [{}, {"fog": {"visibility_m": 5000.0}}, {"sun": {"azimuth_deg": 200.0, "elevation_deg": 30.0}},
                {"rain": {"rate_mm_h": 2.0}}]
)  # fmt: skip
def test_what_is_left_out_does_not_show(tmp_path: Path, weather: dict[str, Any]) -> None:
    ball = {"sphere": {"radius_m": 1.0}, "at_m": [9.0, 3.0, -1.0], "material": "pane"}
    materials = {"pane": {"rho": 0.02, "model": "glass", "index": 1.5}, "third": grey(0.3)}
    world = [plate(20.0, "third", 30.0), ball]
    scans = [
        build(tmp_path, world, weather=weather, materials=materials, model="sick-lms291-s05", physics={"full": full})(
            plan(SCAN_DEG, max_echoes=1)
        )
        for full in (False, True)
    ]
    assert agree(*scans, lsb_m=0.010) >= 0.99


@pytest.mark.parametrize(
    "physics",
    [
        {"photons": {"bin_ns": 0.01562}},
        {"photons": {"bin_ns": 0.6671}, "gate_m": 1e4},
        {"pulse_fwhm_ns": 0.1, "gate_m": 2811},
        {"pulse_fwhm_ns": 0.1, "gate_m": 1e4, "weather_echoes": False},
    ],
)
def test_what_a_refusal_tells_is_allowed(tmp_path: Path, physics: dict[str, Any]) -> None:
    build(tmp_path, physics={"gate_m": 200.0, **physics})
