"""Drops and flakes in the whole path of a beam, against two independent computations of the same numbers.

`data/particles.json` holds cases that were computed outside of this project, with their statistical errors;
`one_particle_at_a_time` is a Monte Carlo that imports nothing of the product. The visibility is put so high that the
clear air sends nothing back: the cases leave it out.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from emulator.physics.random_streams import RandomStreams
from emulator.sensing.measure import Measure
from tests.sensing.one_particle_at_a_time import Rig, first_echoes
from tests.sensing.rig import build, plan

Floats = NDArray[np.float64]
CASES: list[dict[str, Any]] = json.loads((Path(__file__).parent / "data" / "particles.json").read_text())["cases"]
BEAMS = 360
"A degree apart: neighbours have next to no particle in common."


def named(kind: str, *parts: str) -> list[dict[str, Any]]:
    return [case for case in CASES if case["kind"] == kind and all(part in case["name"] for part in parts)]


def sensor(folder: Path, case: dict[str, Any], **physics: Any) -> Measure:
    """The sensor of a case, with the numbers of the case."""
    setup = case["setup"]
    numbers = setup["parameters"]
    chosen = {
        "rule": "axis",
        "range_noise_mm": 0.0,
        "divergence_deg": math.degrees(2.0 * numbers["theta"]),
        "exit_diameter_mm": 2e3 * numbers["w0"],
        "profile": numbers["profile"],
        "floor_reflectance": numbers["floor"] or "off",
        **setup["sensor"]["physics"],
        **physics,
    }
    weather = {"visibility_m": 1e9, **setup["weather"]}
    return build(folder, weather=weather, physics=chosen, model=setup["sensor"]["model"])


def firsts(measure: Measure, sweeps: int) -> Floats:
    """Ranges of the first echoes of beams that have nothing to do with each other."""
    found = []
    for sweep in range(sweeps):
        scan = measure(plan(np.arange(BEAMS), sweep=sweep, start_s=20.0 * sweep, max_echoes=1))
        found.append(scan.range_m[:, 0])
    return np.concatenate(found)


SUMS = [
    *named("particles_sum", "sick-ld-lrs1000 w0 10 mm gauss floor 0.004"),
    *named("particles_sum", "sick-ld-lrs1000 w0 10 mm gauss floor 0, rain"),
    *named("particles_sum", "sick-ld-lrs1000 w0 0 mm"),
    *named("particles_sum", "sick-ld-lrs1000 w0 20 mm"),
    *named("particles_sum", "sick-lms291-s05 w0 5 mm gauss"),
    *named("particles_sum", "sick-lms200"),
    *named("particles_sum", "paper"),
    *named("particles_sum", "tophat"),
]


@pytest.mark.parametrize("case", SUMS, ids=lambda case: case["name"])
def test_as_many_beams_answer_by_particles_as_an_independent_sum_of_their_light_says(
    case: dict[str, Any], tmp_path: Path
) -> None:
    expected = case["expected"]
    found = firsts(sensor(tmp_path, case), 22)
    share, n = np.isfinite(found).mean(), len(found)
    p = expected["probability"]
    spread = 4.0 * math.sqrt(max(p * (1.0 - p), 1e-4) / n + case["std_error"] ** 2)
    assert share == pytest.approx(p, abs=spread + 0.01 * p)
    middle = expected["first_range_quantiles_m_with_error"].get("50")
    if middle is not None and share * n > 300:
        # what is reported of several flakes together is up to 0.3 of the pulse nearer than their maximum
        pulse_m = 0.5 * 299792458.0 * case["setup"]["parameters"]["tau"]
        allowed = 0.3 * pulse_m + 3.0 * middle[1] + 0.1 * middle[0]
        assert float(np.nanmedian(found)) == pytest.approx(middle[0], abs=allowed)


@pytest.mark.parametrize(
    "case",
    [
        *named("particles_sum", "sick-ld-lrs1000 w0 10 mm gauss floor 0.004, dry snow 5"),
        *named("particles_sum", "sick-ld-lrs1000 w0 10 mm gauss floor 0, rain 20"),
        *named("particles_sum", "sick-lms291-s05 w0 5 mm tophat floor 0.004, dry snow 5"),
    ],
    ids=lambda case: case["name"],
)
def test_one_particle_at_a_time_agrees_with_the_cases_and_with_the_product(
    case: dict[str, Any], tmp_path: Path
) -> None:
    beams = 2000
    told = first_echoes(Rig.of(case["setup"]), beams, case["expected"]["to_m"], seed=3)
    p = case["expected"]["probability"]
    assert np.isfinite(told).mean() == pytest.approx(p, abs=4.0 * math.sqrt(p * (1.0 - p) / beams))
    found = firsts(sensor(tmp_path, case), 10)
    both = np.sqrt(p * (1.0 - p) * (1.0 / beams + 1.0 / len(found)))
    assert np.isfinite(found).mean() == pytest.approx(np.isfinite(told).mean(), abs=4.0 * both + 0.01 * p)
    for share in (25.0, 75.0):
        mine, other = np.nanpercentile(found, share), np.nanpercentile(told, share)
        assert mine == pytest.approx(other, rel=0.1, abs=0.2)


@pytest.mark.parametrize("case", named("particles_noise"), ids=lambda case: case["name"])
def test_noise_lifts_particles_over_the_threshold(case: dict[str, Any], tmp_path: Path) -> None:
    """Cases are of particles alone; where several make an echo together, the second opinion has noise too."""
    noisy = np.isfinite(firsts(sensor(tmp_path, case), 20))
    expected = case["expected"]
    if expected["probability"] < 0.01:
        assert noisy.mean() == pytest.approx(expected["probability"], abs=4.0 * math.sqrt(1e-4 / len(noisy)))
        return
    rig = Rig.of(case["setup"])
    without, told = (np.isfinite(first_echoes(rig, 3000, 14.0, seed=5, noise=rms)) for rms in (0.0, 1.0))
    quiet = np.isfinite(firsts(sensor(tmp_path, case, noise=False), 20))
    # the same particles with noise and without: only those near the threshold differ
    lifted, lifted_told = noisy.mean() - quiet.mean(), told.mean() - without.mean()
    turned = math.sqrt((noisy != quiet).mean() / len(quiet) + (told != without).mean() / len(told))
    assert lifted == pytest.approx(lifted_told, abs=4.0 * turned)
    if rig.near == 0.0:  # before a near gate, what is crossed early by noise is not reported
        assert noisy.sum() > quiet.sum()


@pytest.mark.parametrize(
    ("diameter_mm", "share"), [(0.0, 0.21), (20.0, 0.48)], ids=["no aperture", "aperture of 20 mm"]
)
def test_a_wider_window_makes_no_fewer_beams_of_an_ld_answer_in_rain(
    tmp_path: Path, diameter_mm: float, share: float
) -> None:
    """Of a beam alone, as the issue has it; together they are more."""
    case = {"setup": {**named("particles_sum", "lrs1000 w0 10 mm gauss floor 0, rain 50")[0]["setup"]}}
    measure = sensor(tmp_path, case, exit_diameter_mm=diameter_mm)
    found = np.isfinite(firsts(measure, 6)).mean()
    assert share - 0.03 < found < 1.45 * share


def test_the_near_gate_and_the_overlap_hold_for_drops_too(tmp_path: Path) -> None:
    rain = {"rain": {"rate_mm_h": 10.0}}
    physics = {
        "exit_diameter_mm": 0.0, "near_gate_m": 0.3, "noise": False, "floor_reflectance": "off", "rule": "axis",
        "echoes": "first",
    }  # fmt: skip
    measure = build(tmp_path, weather=rain, physics=physics, model="sick-lms291-s05")
    found = np.isfinite(firsts(measure, 60)).mean()
    assert found == pytest.approx(0.022, abs=0.004)
    lms200 = build(tmp_path, weather={"rain": {"rate_mm_h": 20.0}}, physics={"rule": "axis"}, model="sick-lms200-30106")
    seen = np.isfinite(firsts(lms200, 60)).mean()
    assert seen == pytest.approx(0.0008, abs=0.0008)


def test_a_sweep_of_particles_is_the_same_whenever_it_is_computed(tmp_path: Path) -> None:
    case = named("particles_sum", "lrs1000 w0 10 mm gauss floor 0.004, dry snow 5")[0]
    one, other = sensor(tmp_path, case), sensor(tmp_path, case)
    plans = [plan(np.arange(50), sweep=k, start_s=0.1 * k) for k in range(3)]
    forwards = [one(each).range_m for each in plans]
    backwards = [other(each).range_m for each in reversed(plans)]
    for mine, others in zip(forwards, reversed(backwards), strict=True):
        np.testing.assert_array_equal(mine, others)


def test_the_number_of_other_beams_changes_no_particle(tmp_path: Path) -> None:
    case = named("particles_sum", "lms291-s05 w0 5 mm gauss floor 0.004, dry snow 5")[0]
    measure = sensor(tmp_path, case)
    few, many = measure(plan(np.arange(10))).range_m, measure(plan(np.arange(100))).range_m
    np.testing.assert_array_equal(few, many[:10])
    assert RandomStreams(1, "front") == measure.draws
