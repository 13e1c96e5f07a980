"""Cases of drops and flakes that were computed outside of this project, and what the product makes of the same setups.

Here: from a case to pairs of numbers, theirs and ours, with the error of ours. Not here: what is to be expected of them
(test_particles, benchmarks.particle_oracles). The visibility is put so high that the clear air sends nothing back: the
cases leave it out.
"""

from __future__ import annotations

import json
import math
import tempfile
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from emulator.physics.particle_light import ParticleLight
from emulator.physics.subechoes import SubEchoes
from emulator.sensing.measure import Measure
from emulator.sensing.particles import light_of
from tests.sensing.one_particle_at_a_time import Rig, first_echoes
from tests.sensing.rig import build, plan

Floats = NDArray[np.float64]
Case = dict[str, Any]
CASES: list[Case] = json.loads((Path(__file__).parent / "data" / "particles.json").read_text())["cases"]
BEAMS = 360
"A degree apart: neighbours have next to no particle in common."


class Row(NamedTuple):
    """One number of a case."""

    what: str
    oracle: float
    ours: float
    sigma: float
    "Statistical error of both."


def named(kind: str, *parts: str) -> list[Case]:
    """Cases of a kind whose names hold all these parts."""
    return [case for case in CASES if case["kind"] == kind and all(part in case["name"] for part in parts)]


def sensor(case: Case, **physics: Any) -> Measure:
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
    with tempfile.TemporaryDirectory() as folder:
        return build(Path(folder), weather=weather, physics=chosen, model=setup["sensor"]["model"])


def firsts(measure: Measure, sweeps: int) -> Floats:
    """Ranges of the first echoes of beams that have nothing to do with each other."""
    found = []
    for sweep in range(sweeps):
        scan = measure(plan(np.arange(float(BEAMS)), sweep=sweep, start_s=20.0 * sweep, max_echoes=1))
        found.append(scan.range_m[:, 0])
    return np.concatenate(found)


def particle_light(measure: Measure) -> ParticleLight:
    """The law by which a sensor draws."""
    now = measure.air.at(0.0)
    return measure._falling.light(now.particles[0], now.extinction_per_m, 1.0)


# ------------------------------------------------------------------------------- one beam
def alone(case: Case) -> list[Row]:
    """Of beams that answer by one particle alone, and of the first range: integrals of the law that is drawn from."""
    measure, numbers = sensor(case), case["setup"]["parameters"]
    now = measure.air.at(0.0)
    if not now.particles:
        return [Row("probability", case["expected"]["probability"], math.nan, 1e-4)]
    light = light_of(now.particles[0], measure.model, case["setup"]["extinction_per_m"], 1.0, 1.0)
    before = float(light.mean(np.array(numbers["near"])))
    share = -math.expm1(before - float(light.mean(np.array(np.inf))))
    rows = [Row("probability", case["expected"]["probability"], share, 1e-5)]
    middle = case["expected"]["first_range_quantiles_m"].get("50")
    if middle is not None:
        r = np.geomspace(1e-2, light.end_m, 4000)
        first = -np.expm1(before - light.mean(r))
        rows.append(Row("median range, m", middle, float(np.interp(0.5 * share, first, r)), 1e-3))
    return rows


@lru_cache(maxsize=64)
def _answers(name: str, sweeps: int, noise: bool, near_gate_m: float | None) -> Floats:
    case = next(one for one in CASES if one["name"] == name)
    physics: dict[str, Any] = {} if near_gate_m is None else {"near_gate_m": near_gate_m}
    return firsts(sensor(case, **physics, **({} if noise else {"noise": False})), sweeps)


def summed(case: Case, sweeps: int) -> list[Row]:
    """Of beams that answer by all their particles together."""
    found, expected = _answers(case["name"], sweeps, True, None), case["expected"]
    p, n = expected["probability"], len(found)
    sigma = math.sqrt(max(p * (1.0 - p), 1e-4) / n + case["std_error"] ** 2)
    rows = [Row("probability", p, float(np.isfinite(found).mean()), sigma)]
    middle = expected["first_range_quantiles_m_with_error"].get("50")
    answers = int(np.isfinite(found).sum())
    if middle is not None and answers > 100:
        spread = np.subtract(*np.nanpercentile(found, [75.0, 25.0])) / math.sqrt(answers)
        rows.append(Row("median range, m", middle[0], float(np.nanmedian(found)), float(np.hypot(spread, middle[1]))))
    return rows


def lifted(case: Case, sweeps: int, beams: int) -> list[Row]:
    """What noise adds to the share that answers, beside the second opinion: the case is of single particles.

    Without a near gate: it judges what is reported, and noise makes that nearer; the second opinion's judges maxima.
    """
    rig = replace(Rig.of(case["setup"]), near=0.0)
    to_m = 20.0 if rig.theta < 5e-3 else 5.0
    reported, reported_quiet = (np.isfinite(first_echoes(rig, beams, to_m, seed=5, noise=rms)) for rms in (1.0, 0.0))
    noisy, quiet = (np.isfinite(_answers(case["name"], sweeps, noise, 0.0)) for noise in (True, False))
    turned = math.sqrt((noisy != quiet).mean() / len(quiet) + (reported != reported_quiet).mean() / len(reported))
    both = math.sqrt(max(reported.mean(), 1e-4) * (1.0 / len(reported) + 1.0 / len(noisy)))
    return [
        Row("probability", float(reported.mean()), float(noisy.mean()), both),
        Row(
            "more by noise", float(reported.mean() - reported_quiet.mean()), float(noisy.mean() - quiet.mean()), turned
        ),
    ]


# ------------------------------------------------------------------------------- two beams, two times
def light_at(measure: Measure, near_m: float, far_m: float, azimuth_deg: Floats, sweep: int, start_s: float) -> Floats:
    """Light of all particles between two ranges, of each beam of a sweep that fires at once."""
    found = measure.view(plan(azimuth_deg, sweep=sweep, start_s=start_s)).echoes
    inside = (found.range_m >= near_m) & (found.range_m < far_m)
    summed = np.bincount(found.beam[inside], found.amplitude[inside], minlength=len(azimuth_deg))
    return summed.astype(np.float64)


def sharp(case: Case, range_m: float = 5.0) -> Measure:
    """The sensor of a case that sees small particles as well: the closed forms are of all of them."""
    faintest = 0.003 if "rain" in case["setup"]["weather"] else 0.3
    return sensor(
        case,
        threshold_to_noise=faintest,
        floor_reflectance="off",
        noise=False,
        false_alarms=False,
        gate_m=1.2 * range_m,
    )


def correlation(pairs: list[tuple[Floats, Floats]]) -> float:
    """Of the light of two beams or two times."""
    one, other = (np.concatenate(column) for column in zip(*pairs, strict=True))
    return float(np.corrcoef(one, other)[0, 1])


def neighbours(case: Case, sweeps: int) -> list[Row]:
    """Correlation of the light of neighbouring beams 5 m away."""
    setup = case["setup"]
    measure, azimuth, pairs = sharp(case), setup["step_deg"] * np.arange(400.0), []
    for sweep in range(sweeps):
        light = light_at(measure, 4.5, 5.5, azimuth, sweep, 5.0 * sweep)
        later = light
        if setup["delay_s"] > 0.0:
            later = light_at(measure, 4.5, 5.5, azimuth, sweep, 5.0 * sweep + setup["delay_s"])
        pairs.append((light[:-1], later[1:]))
    reported = case["expected"]["signal_correlation_at_range"]["5"]
    return [Row("correlation at 5 m", reported, correlation(pairs), 1.5 / math.sqrt(400.0 * sweeps))]


def later(case: Case, late_s: str, sweeps: int) -> list[Row]:
    """Correlation of the light of one beam with that some time later."""
    setup = case["setup"]
    wind, range_m = setup["wind_across_m_s"], setup["range_m"]
    blown = {"setup": {**setup, "weather": {**setup["weather"], "wind_m_s": [0.0, wind, 0.0]}}}
    level = np.concatenate([k + np.arange(-9.0, 10, 3) for k in (0, 180)])
    azimuth = np.arange(0.0, 360.0, 3.0) if wind == 0.0 else level
    measure, near, far, pairs = sharp(blown, range_m), 0.9 * range_m, 1.1 * range_m, []
    for sweep in range(sweeps):
        pair = [light_at(measure, near, far, azimuth, sweep, 7.0 * sweep + late) for late in (0.0, float(late_s))]
        pairs.append((pair[0], pair[1]))
    reported = case["expected"]["correlation_after_s"][late_s]
    return [Row(f"after {late_s} s", reported, correlation(pairs), 1.5 / math.sqrt(len(azimuth) * sweeps))]


def both_answer(case: Case, sweeps: int) -> list[Row]:
    """Of two beams, or one beam twice, that answer by one particle alone: p, and phi of both.

    Seen alone: a particle whose light reaches the level, without the mean light of the others.
    """
    setup, expected = case["setup"], case["expected"]
    measure, rig, n = sensor(case), Rig.of(setup), sweeps * BEAMS // 2
    light = particle_light(measure)
    azimuth = (np.arange(0.0, 360.0, 2.0)[:, None] + np.array([0.0, setup.get("step_deg", 0.0)])).ravel()
    one, both = [], []
    for sweep in range(sweeps):
        late = np.tile([0.0, setup["delay_s"]], 180)
        found = measure.view(plan(azimuth, sweep=sweep, start_s=5.0 * sweep, fire_s=late)).echoes
        single = found.amplitude / light.lift(found.range_m) >= rig.level(found.range_m)
        single &= found.range_m >= max(rig.r1, rig.near)
        answers = np.bincount(found.beam[single], minlength=BEAMS).reshape(BEAMS // 2, 2) > 0
        one.append(answers.mean())
        both.append(answers.all(axis=1).mean())
    p, ours = expected["probability"], float(np.mean(one))
    phi = (np.mean(both) - ours**2) / (ours * (1.0 - ours)) if ours > 0.0 else math.nan
    return [
        Row("probability", p, ours, math.sqrt(p * (1.0 - p) / n)),
        Row("phi", expected["phi"], float(phi), math.sqrt((1.0 + 0.2 / p) / n)),
    ]


# ------------------------------------------------------------------------------- what stands behind
def shadows(case: Case, sweeps: int, **physics: Any) -> list[Row]:
    """Mean and spread of the light that passes once, over the law's mean."""
    path_m, measure = case["setup"]["path_m"], sensor(case, **physics)
    now, passed = measure.air.at(0.0), []
    for sweep in range(sweeps):
        rays = measure.view(plan(np.arange(float(BEAMS)), sweep=sweep, start_s=9.0 * sweep)).rays
        seen = measure._falling.seen(
            now.particles[0], rays, np.full(BEAMS, 9.0 * sweep), np.broadcast_to(np.eye(3), (BEAMS, 3, 3)),
            np.full(BEAMS, path_m), now.extinction_per_m, sweep, measure.draws,
        )  # fmt: skip
        plate = SubEchoes.of(np.arange(BEAMS), np.full(BEAMS, path_m), np.ones(BEAMS), np.ones(BEAMS))
        passed.append(np.ones(BEAMS) if seen is None else seen.shade(plate).amplitude)
    one_way = np.sqrt(np.concatenate(passed))
    n, spread = len(one_way), float(one_way.std())
    return [
        Row("mean", 1.0, float(np.mean(one_way**2)), 2.0 * spread / math.sqrt(n)),
        Row("relative spread", case["expected"]["relative_std"], spread, spread / math.sqrt(2.0 * n) * 3.0),
    ]
