"""The foot of fog's own echo: it rises with the third power and faster within one or two bins, and is crossed there.

Every range at the default bins is that of bins many times finer, and that of the closed form of the integral, to a
quarter of the device's step. With and without what stands in the fog; in scans with all terms and with the spared ones.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from emulator.physics import softtarget
from emulator.scenario.weather import WeatherConfig
from emulator.sensing.measure import Measure
from tests.sensing.error_budget.scenes import LD, LMS, MODELS, measure_of, random_scene
from tests.sensing.error_budget.scenes import plan as wide_plan
from tests.sensing.rig import QUIET, Floats, build, plan, plate

PAPER = "paper-905nm"
BEHIND: dict[str, list[dict[str, Any]]] = {
    "nothing": [],
    "a wall in the rise": [plate(1.4, "dark")],
    "an edge in the rise": [plate(1.4, "dark", 0.02, 0.005)],
    "a wall behind": [plate(2.0, "white")],
    "a dark wall behind": [plate(4.0, "dark")],
}


def measured(folder: Path, model: str, world: list[dict[str, Any]], visibility_m: float, **physics: Any) -> Measure:
    chosen = {**QUIET, "echoes": "all", "max_echoes": 4, "near_gate_m": 0.0, **physics}
    return build(folder, world, model=model, weather={"fog": {"visibility_m": visibility_m}}, physics=chosen)


def crossed(measure: Measure) -> Floats:
    """Where the closed form of the fog's echo first reaches the threshold, counted as the device counts."""
    model, air = measure.model, measure.air.at(0.0).everywhere
    half = model.pulse.half_support_m

    def over(x_m: float) -> bool:
        shape = softtarget.fog_shape(
            x_m + half, air.extinction_per_m, model.overlap_start_m, model.overlap_full_m, 1e9, model.pulse.fwhm_s
        )
        scale = math.pi * model.k_m2 * air.backscatter_per_m_sr * model.pulse.fwhm_s
        return float(scale * shape) >= model.threshold

    low = model.overlap_start_m - half
    high = next(x for x in np.arange(low, low + 2.0 * half, 0.01) if over(float(x)))
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if over(middle) else (middle, high)
    return np.asarray(high, np.float64)


@pytest.mark.parametrize("model", [PAPER, LMS, LD])
@pytest.mark.parametrize("visibility_m", [5.0, 30.0, 60.0])
def test_fog_alone_is_crossed_where_the_closed_form_says(tmp_path: Path, model: str, visibility_m: float) -> None:
    measure = measured(tmp_path, model, [], visibility_m, walk_table=False)
    found = measure(plan()).range_m[0, 0]
    detector = measure._receiver.detector
    wanted = crossed(measure) + detector.pulse.start_lead_m - detector.offset_m
    assert found == pytest.approx(max(float(wanted), 0.0), abs=0.25 * measure.model.lsb_m)


@pytest.mark.parametrize("full", [False, True])
@pytest.mark.parametrize("behind", BEHIND)
@pytest.mark.parametrize(
    ("model", "visibility_m"), [(PAPER, 5.0), (PAPER, 30.0), (PAPER, 60.0), (LMS, 30.0), (LD, 60.0)]
)
def test_ranges_in_fog_are_those_of_bins_many_times_finer(
    tmp_path: Path, model: str, visibility_m: float, behind: str, full: bool
) -> None:
    """At 30 m of visibility 1.1126 m were found, and 1.1263 m with an eighth of the bins (paper-905nm)."""
    default = measured(tmp_path, model, BEHIND[behind], visibility_m, full=full)
    fine_ns = 1e9 * default.model.pulse.fwhm_s / 256.0
    fine = measured(tmp_path, model, BEHIND[behind], visibility_m, full=full, bin_ns=fine_ns)
    found, wanted = (one(plan()).range_m for one in (default, fine))
    assert np.isfinite(wanted[0, 0])
    assert found == pytest.approx(wanted, abs=0.25 * default.model.lsb_m, nan_ok=True)


def test_the_foot_is_that_of_30_m_of_visibility(tmp_path: Path) -> None:
    found = measured(tmp_path, PAPER, [], 30.0)(plan()).range_m[0, 0]
    assert found == pytest.approx(1.12636, abs=2.5e-4)


@pytest.mark.parametrize(
    ("seed", "sweep", "beam"),
    [
        pytest.param(70, 1, 172, id="the maximum between two samples reaches the level: 12 mm"),
        pytest.param(378, 1, 89, id="the same, and a maximum that the medium lifts and shifts: no echo"),
        pytest.param(456, 1, 104, id="crossed nearer to the maximum than the medium shifts it: 34 mm"),
        pytest.param(150, 1, 179, id="a valley above the level at its samples: 151 mm"),
        pytest.param(330, 0, 96, id="another: 153 mm"),
    ],
)
def test_an_echo_at_its_threshold_in_60_m_of_fog_is_the_same_in_full(seed: int, sweep: int, beam: int) -> None:
    """Of 253 400 beams these five differed."""
    fog = WeatherConfig.model_validate({"fog": {"visibility_m": 60.0}})
    scene, model, beams = random_scene(seed), MODELS[seed % 3], wide_plan(181, sweep=sweep)
    with np.errstate(all="ignore"):
        full, rays_saved = (
            measure_of(scene, model, fog, **one)(beams).range_m[beam]
            for one in ({"full": True}, {"leave_out": {"closed_form": "auto" if seed % 4 == 0 else "always"}})
        )
    assert np.isfinite(full).all()
    assert rays_saved == pytest.approx(full, abs=1e-3)


def test_a_valley_at_the_level_decides_on_no_more_than_the_spread_of_the_planes_ranges() -> None:
    """LD, seed 963: the valley before the echo was 2.7e-3 of noise below the level, in full 1.7e-3 above: 188 mm.

    Above the level there is no crossing: an echo kept the place of a single one at once, now a noise unit above.
    """
    fog = WeatherConfig.model_validate({"fog": {"visibility_m": 60.0}})
    scene, beams = random_scene(963), wide_plan(181, sweep=1)
    full, rays_saved = (
        measure_of(scene, LD, fog, **one)(beams).range_m[81, 0]
        for one in ({"full": True}, {"leave_out": {"closed_form": "always"}})
    )
    assert rays_saved == pytest.approx(full, abs=0.01)


def test_ranges_behind_a_valley_in_fog_change_by_little_as_the_level_passes_it(tmp_path: Path) -> None:
    """Levels so close together that no step between two ranges is a jump: a step of 190 mm before."""
    found = []
    for level in np.arange(4.5, 6.5, 0.05):
        measure = measured(
            tmp_path, LD, [plate(13.41, "dark")], 60.0, threshold_to_noise=round(float(level), 2), walk_table=False
        )
        found.append(measure(plan()).range_m[0, 1])
    assert np.ptp(found) > 0.1
    assert np.abs(np.diff(found)).max() < 0.035
