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

from emulator.physics import world_particles
from emulator.physics.random_streams import RandomStreams
from emulator.physics.subechoes import SubEchoes
from emulator.physics.world_particles import in_boxes
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
        scan = measure(plan(np.arange(float(BEAMS)), sweep=sweep, start_s=20.0 * sweep, max_echoes=1))
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
    plans = [plan(np.arange(50.0), sweep=k, start_s=0.1 * k) for k in range(3)]
    forwards = [one(each).range_m for each in plans]
    backwards = [other(each).range_m for each in reversed(plans)]
    for mine, others in zip(forwards, reversed(backwards), strict=True):
        np.testing.assert_array_equal(mine, others)


def test_the_number_of_other_beams_changes_no_particle(tmp_path: Path) -> None:
    case = named("particles_sum", "lms291-s05 w0 5 mm gauss floor 0.004, dry snow 5")[0]
    measure = sensor(tmp_path, case)
    few, many = measure(plan(np.arange(10.0))).range_m, measure(plan(np.arange(100.0))).range_m
    np.testing.assert_array_equal(few, many[:10])
    assert RandomStreams(1, "front") == measure.draws


# ------------------------------------------------------------------------------- places in the world
def light_at(measure: Measure, near_m: float, far_m: float, azimuth_deg: Floats, sweep: int, start_s: float) -> Floats:
    """Light of all particles between two ranges, of each beam of a sweep that fires at once."""
    found = measure.view(plan(azimuth_deg, sweep=sweep, start_s=start_s)).echoes
    inside = (found.range_m >= near_m) & (found.range_m < far_m)
    summed = np.bincount(found.beam[inside], found.amplitude[inside], minlength=len(azimuth_deg))
    return summed.astype(np.float64)


def sharp(folder: Path, case: dict[str, Any]) -> Measure:
    """The sensor of a case that sees small particles as well: the closed forms are of all of them."""
    faintest = 0.003 if "rain" in case["setup"]["weather"] else 0.3
    return sensor(
        folder, case, threshold_to_noise=faintest, floor_reflectance="off", noise=False, false_alarms=False, gate_m=6.0
    )


def correlation(pairs: list[tuple[Floats, Floats]]) -> float:
    one, other = (np.concatenate(column) for column in zip(*pairs, strict=True))
    return float(np.corrcoef(one, other)[0, 1])


@pytest.mark.parametrize(
    ("name", "step_deg"),
    [("lms291-s05 gauss floor 0.004 0.25 deg 0 ms", 0.25), ("lms291-s05 gauss floor 0.004 0.5 deg 0 ms", 0.5),
     ("lms291-s05 gauss floor 0.004 1 deg 0 ms", 1.0), ("lms291-s05 tophat floor 0.004 0.5 deg", 0.5),
     ("lrs1000 gauss floor 0.004 0.125 deg", 0.125)],
)  # fmt: skip
def test_neighbouring_beams_see_the_same_flakes_by_the_overlap_of_their_footprints(
    tmp_path: Path, name: str, step_deg: float
) -> None:
    case = named("pair", name)[0]
    measure, azimuth = sharp(tmp_path, case), step_deg * np.arange(400.0)
    pairs = []
    for sweep in range(12):
        light = light_at(measure, 4.5, 5.5, azimuth, sweep, 5.0 * sweep)
        pairs.append((light[:-1], light[1:]))
    expected = case["expected"]["signal_correlation_at_range"]["5"]
    assert correlation(pairs) == pytest.approx(expected, abs=0.06)


@pytest.mark.parametrize(
    ("case", "later"),
    [(case, later) for case in named("time")[:5] for later in case["expected"]["correlation_after_s"]],
    ids=lambda given: given if isinstance(given, str) else given["name"],
)
def test_the_next_sweep_sees_what_fell_or_was_blown_on(tmp_path: Path, case: dict[str, Any], later: str) -> None:
    setup = case["setup"]
    wind = setup["wind_across_m_s"]
    case = {"setup": {**setup, "weather": {**setup["weather"], "wind_m_s": [0.0, wind, 0.0]}}}
    azimuth = (
        np.arange(0.0, 360.0, 3.0) if wind == 0.0 else np.concatenate([k + np.arange(-9.0, 10, 3) for k in (0, 180)])
    )
    measure, pairs = sharp(tmp_path, case), []
    for sweep in range(12 if wind == 0.0 else 60):
        pair = [light_at(measure, 4.5, 5.5, azimuth, sweep, 7.0 * sweep + late) for late in (0.0, float(later))]
        pairs.append((pair[0], pair[1]))
    told = named("time", "")
    expected = next(one for one in told if one["setup"] == setup)["expected"]["correlation_after_s"][later]
    assert correlation(pairs) == pytest.approx(expected, abs=0.07)


@pytest.mark.parametrize(
    "case",
    [*named("pair", "lms291-s05 gauss floor 0.004 0.25 deg 0 ms"), *named("pair", "lrs1000 gauss floor 0, "),
     *named("pair", "lrs1000 gauss floor 0.004 0.125"), *named("pair", "lms291-s05 gauss floor 0.004 0.5 deg 13")],
    ids=lambda case: case["name"],
)  # fmt: skip
def test_what_one_particle_alone_makes_two_beams_answer_has_its_closed_form(
    tmp_path: Path, case: dict[str, Any]
) -> None:
    """Seen alone: a particle whose light reaches the level, without the mean light of the others."""
    setup, expected = case["setup"], case["expected"]
    measure = sensor(tmp_path, case)
    azimuth = (np.arange(0.0, 360.0, 2.0)[:, None] + np.array([0.0, setup["step_deg"]])).ravel()
    one, both = [], []
    rig = Rig.of(setup)
    for sweep in range(16):
        late = np.tile([0.0, setup["delay_s"]], 180)
        found = measure.view(plan(azimuth, sweep=sweep, start_s=5.0 * sweep, fire_s=late)).echoes
        light = measure._falling.light(measure.air.at(0.0).particles[0], measure.air.at(0.0).extinction_per_m, 1.0)
        alone = found.amplitude / light.lift(found.range_m) >= rig.level(found.range_m)
        alone &= found.range_m >= max(rig.r1, rig.near)
        answers = np.bincount(found.beam[alone], minlength=360).reshape(180, 2) > 0
        one.append(answers.mean())
        both.append(answers.all(axis=1).mean())
    p, n = expected["probability"], 16 * 180
    assert np.mean(one) == pytest.approx(p, abs=4.0 * math.sqrt(p * (1.0 - p) / n))
    phi = (np.mean(both) - np.mean(one) ** 2) / (np.mean(one) * (1.0 - np.mean(one)))
    assert phi == pytest.approx(expected["phi"], abs=4.0 / math.sqrt(n) * (1.0 + 0.2 / p) ** 0.5)


def test_two_sensors_and_one_that_drives_see_the_same_flakes(tmp_path: Path) -> None:
    case = named("pair", "lms291-s05 gauss floor 0.004 0.25 deg 0 ms")[0]
    setup = case["setup"]
    physics = {"noise": False, "floor_reflectance": "off", "rule": "axis"}
    own, other = (
        build(tmp_path, weather=setup["weather"], physics=physics, model=model, mount={"at_m": [x, 0.0, 1.0]})
        for model, x in (("sick-lms291-s05", 0.0), ("sick-lms200-30106", -0.5))
    )
    assert own.draws.seed == other.draws.seed
    found, missed = 0, 0
    for start_s in np.arange(20.0):
        one, two = (m.view(plan([0.0], start_s=start_s)).echoes for m in (own, other))
        # the second stands half a metre behind the first and looks along the same line, with a tenth of the light
        bright = one.range_m[(one.amplitude > 8.0) & (one.range_m > 1.0)]
        near = [np.abs(two.range_m - (r + 0.5)).min(initial=9.0) < 2e-3 for r in bright]
        found, missed = found + sum(near), missed + len(near) - sum(near)
    assert found > 15
    assert missed < 0.2 * found


@pytest.mark.parametrize("case", named("transmission_cone", "ld-lrs1000"), ids=lambda case: case["name"])
def test_shadows_make_what_stands_behind_flicker_about_its_mean(tmp_path: Path, case: dict[str, Any]) -> None:
    setup, expected = case["setup"], case["expected"]
    path_m = setup["path_m"]
    measure = sensor(tmp_path, case, threshold_to_noise=0.3, floor_reflectance="off")
    still = sensor(tmp_path, {"setup": {**setup, "weather": {}}})
    light = measure._falling.light(measure.air.at(0.0).particles[0], measure.air.at(0.0).extinction_per_m, 1.0)
    passed = []
    for sweep in range(8):
        seen = measure._falling.seen(
            measure.air.at(0.0).particles[0], *_rays(measure, sweep), np.full(BEAMS, path_m),
            measure.air.at(0.0).extinction_per_m, sweep, measure.draws,
        )  # fmt: skip
        assert seen is not None
        plate = SubEchoes.of(np.arange(BEAMS), np.full(BEAMS, path_m), np.ones(BEAMS), np.ones(BEAMS))
        passed.append(seen.shade(plate).amplitude)
    two_way = np.concatenate(passed)
    one_way = np.sqrt(two_way)
    error = one_way.std() / math.sqrt(len(two_way))
    assert two_way.mean() == pytest.approx(1.0, abs=8.0 * error)
    # those too small to be drawn are missing, and the disc is small against the beam
    assert 0.75 * expected["relative_std"] < one_way.std() < 1.1 * expected["relative_std"]
    assert light.mean_shadow(np.array(path_m)) > 0.0
    assert still.air.at(0.0).particles == ()


def _rays(measure: Measure, sweep: int) -> tuple[Any, Floats, Floats]:
    view = measure.view(plan(np.arange(float(BEAMS)), sweep=sweep, start_s=9.0 * sweep))
    return view.rays, np.full(BEAMS, 9.0 * sweep), np.broadcast_to(np.eye(3), (BEAMS, 3, 3))


@pytest.mark.parametrize("parts", [("lms291-s05 w0 5 mm gauss floor 0.004, dry snow 5",), ("tophat", "dry snow 5")])
def test_arrays_and_loops_find_the_same_particles(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, parts: tuple[str, ...]
) -> None:
    measure = sensor(tmp_path, named("particles_sum", *parts)[0], divergence_deg=[0.6, 0.3], roll_deg=20.0)
    sweep = plan(np.arange(40.0), start_s=3.0, fire_s=0.01 * np.arange(40.0))
    one = measure.view(sweep).echoes
    monkeypatch.setattr(in_boxes.pair, "on", False)  # type: ignore[attr-defined]
    other = measure.view(sweep).echoes
    assert len(one) > 100
    np.testing.assert_array_equal(one.beam, other.beam)
    np.testing.assert_allclose(one.range_m, other.range_m, rtol=1e-12)
    np.testing.assert_allclose(one.amplitude, other.amplitude, rtol=1e-9)


def test_where_the_world_has_too_many_each_beam_draws_its_own_by_the_same_law(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = named("particles_sum", "lms291-s05 w0 5 mm gauss floor 0, dry snow 5")[0]
    monkeypatch.setattr(world_particles, "MOST_PAIRS", 100)
    measure = sensor(tmp_path, case)
    found = np.isfinite(firsts(measure, 10))
    assert found.mean() == pytest.approx(case["expected"]["probability"], abs=0.025)


def test_the_mean_of_the_lost_light_is_that_of_the_particles_one_by_one(tmp_path: Path) -> None:
    case = named("transmission_cone", "lms291-s05 w0 5 mm, dry snow")[0]
    measure = sensor(tmp_path, case, floor_reflectance="off")
    now = measure.air.at(0.0)
    light = measure._falling.light(now.particles[0], now.extinction_per_m, 1.0)
    lost = []
    for sweep in range(10):
        seen = measure._falling.seen(
            now.particles[0], *_rays(measure, sweep), np.full(BEAMS, 20.0), now.extinction_per_m, sweep, measure.draws
        )
        assert seen is not None
        kept = np.exp(2.0 * np.bincount(seen.beam, seen.lost, minlength=BEAMS))
        lost.append(kept)
    together = np.concatenate(lost)
    error = together.std() / math.sqrt(len(together))
    assert together.mean() == pytest.approx(math.exp(-float(light.mean_shadow(np.array(20.0)))), abs=5.0 * error)
