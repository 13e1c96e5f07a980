"""Drops that fog hides are not drawn: what is reported stays that of drops drawn one by one, outside of the product.

Here: `Hidden`, and detection, ranges and heights beside `drops_in_fog`. Not here: drops without fog (test_particles).
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from emulator.physics.hidden import Hidden
from emulator.physics.particle_light import ParticleLight
from emulator.sensing.error_budget import explained
from emulator.sensing.measure import Measure
from emulator.sensing.particles import Particles
from tests.sensing.drops_in_fog import Floats, Receiver, echoes
from tests.sensing.one_particle_at_a_time import Rig
from tests.sensing.rig import build, grey, plan, plate

PHYSICS = {
    "divergence_deg": 0.18, "exit_diameter_mm": 10.0, "rule": "axis", "range_noise_mm": 0.0, "false_alarms": False,
    "floor_reflectance": "off",
}  # fmt: skip
TO_M = 12.0


def sensor(folder: Path, model: str, fog_m: float, rain_mm_h: float, world: Any = (), **physics: Any) -> Measure:
    """In fog and rain."""
    return build(
        folder, world, weather={"fog": {"visibility_m": fog_m}, "rain": {"rate_mm_h": rain_mm_h}},
        physics={**PHYSICS, **physics}, model=model, materials={"black": grey(0.002)},
    )  # fmt: skip


def law(measure: Measure) -> tuple[ParticleLight, Particles]:
    """By which drops are drawn, and what they are."""
    air = measure.air.at(0.0)
    soft = measure._soft.everywhere(air)
    (rain,) = air.particles
    return measure._falling.light(rain, air.everywhere.extinction_per_m, 1.0, soft), rain


def reported(measure: Measure, azimuth_deg: Floats, sweeps: int) -> tuple[Floats, Floats]:
    """Ranges and heights of the echoes of beams, sweeps long after each other."""
    scans = [measure(plan(azimuth_deg, sweep=k, start_s=20.0 * k)) for k in range(sweeps)]
    heights = [measure.model.threshold * scan.intensity for scan in scans]
    return np.concatenate([scan.range_m for scan in scans]), np.concatenate(heights)


def opinion(measure: Measure, azimuth_deg: Floats, times: int) -> tuple[Floats, Floats]:
    """The same by the second opinion."""
    model, air, (_, rain) = measure.model, measure.air.at(0.0), law(measure)
    assert rain.spectrum is not None
    beam, spectrum = model.beam, rain.spectrum
    rig = Rig(
        model.k_m2, math.tan(beam.half_angle_x_rad), beam.exit_radius_m, beam.profile == "gauss", model.threshold, 0.0,
        model.overlap_start_m, model.overlap_full_m, model.near_gate_m, 2.0 * model.pulse.fwhm_m,
        spectrum.density_m3_mm, spectrum.slope_mm, spectrum.kappa_sr, air.everywhere.extinction_per_m,
    )  # fmt: skip
    receiver = Receiver(air.everywhere.backscatter_per_m_sr, model.signal_shot, model.walk_table)
    found = measure.view(plan(azimuth_deg)).echoes
    end_m, end = np.full(len(azimuth_deg), np.inf), np.zeros(len(azimuth_deg))
    of_surface = found.source >= 0
    at = found.beam[of_surface]
    end_m[at], end[at] = found.range_m[of_surface], found.amplitude[of_surface]
    _, range_m, height = echoes(rig, receiver, np.tile(end_m, times), np.tile(end, times), TO_M, seed=3)
    return range_m, height


@lru_cache(maxsize=1)
def grazing() -> Floats:
    return np.arange(-30.0, 31.0, 3.0)


@pytest.mark.parametrize(
    ("model", "fog_m", "rain_mm_h", "plate_m", "bands_m"),
    [("ouster-os1-128", 1500.0, 40.0, None, ((0.0, 1.2), (1.2, 3.0), (3.0, 6.0))),
     ("velodyne-vlp-16", 500.0, 10.0, 6.0, ((5.0, 8.0),))],
)  # fmt: skip
def test_drops_in_fog_are_reported_as_if_each_were_drawn(
    tmp_path: Path, model: str, fog_m: float, rain_mm_h: float, plate_m: float | None, bands_m: Any
) -> None:
    world = () if plate_m is None else (plate(plate_m, "black"),)
    measure = sensor(tmp_path, model, fog_m, rain_mm_h, world)
    assert law(measure)[0].optics.hidden is not None
    azimuth, times, sweeps = (np.arange(0.0, 360.0, 2.0), 5, 20) if plate_m is None else (grazing(), 25, 200)
    range_m, height = reported(measure, azimuth, sweeps)
    other_m, other = opinion(measure, azimuth, times)
    n, m = len(azimuth) * sweeps, len(azimuth) * times
    for low, high in bands_m:
        ours, theirs = (range_m >= low) & (range_m < high), (other_m >= low) & (other_m < high)
        p = theirs.sum() / m
        assert ours.sum() / n == pytest.approx(p, abs=4.0 * math.sqrt(p * max(1.0 - p, 0.01) * (1.0 / m + 1.0 / n)))
        error = 4.0 / math.sqrt(min(ours.sum(), theirs.sum()))
        assert range_m[ours].mean() == pytest.approx(other_m[theirs].mean(), abs=error * other_m[theirs].std())
        assert range_m[ours].std() == pytest.approx(other_m[theirs].std(), rel=0.1 + error)
        # heights have a long tail: single large drops
        assert np.median(height[ours]) == pytest.approx(np.median(other[theirs]), abs=error * other[theirs].std())


def test_the_same_drops_hidden_or_not_give_the_same_echoes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    measure = sensor(tmp_path, "ouster-os1-128", 500.0, 10.0)
    few = law(measure)[0]
    azimuth = np.arange(0.0, 360.0, 1.0)
    range_m, height = reported(measure, azimuth, 5)
    monkeypatch.setattr("emulator.sensing.particles.hides", lambda model: False)
    whole = sensor(tmp_path, "ouster-os1-128", 500.0, 10.0)
    many = law(whole)[0]
    every_m, every = reported(whole, azimuth, 5)
    assert float(few.mean(np.array(np.inf))) < 0.6 * float(many.mean(np.array(np.inf)))
    same = (np.isfinite(range_m) == np.isfinite(every_m)).all(axis=1)
    assert (~same).mean() < 0.005
    own = np.isfinite(every_m[:, 0]) & same
    assert np.abs(range_m - every_m)[own, 0].mean() < 0.1 * every_m[own, 0].std()
    assert height[own, 0].mean() == pytest.approx(every[own, 0].mean(), rel=0.01)


def test_what_a_medium_hides_is_no_brighter_than_its_return_and_ends_at_the_threshold(tmp_path: Path) -> None:
    measure = sensor(tmp_path, "ouster-os1-128", 500.0, 10.0)
    soft = measure._soft.everywhere(measure.air.at(0.0))
    assert soft is not None
    hidden = Hidden.under(soft, 5.0, 2.0)
    assert hidden is not None
    np.testing.assert_array_less(hidden.amplitude, soft.wave(hidden.range_m) + 1e-9)
    assert float(hidden.level(np.array([soft.end_m + 1.0]))[0]) == 0.0
    assert Hidden.under(soft, soft.peak, 0.0) is None
    # before the maximum a drop moves the crossing of the rise, where that is reported
    shown = Hidden.under(soft, 5.0, 0.0)
    assert shown is not None
    assert float(shown.level(np.array([0.4]))[0]) < 0.5 * float(hidden.level(np.array([0.4]))[0])


def test_nothing_is_hidden_where_every_drop_is_asked_for_or_light_is_filtered(tmp_path: Path) -> None:
    for options in ({"leave_out": {"particles": False}}, {"full": True}):
        measure = sensor(tmp_path, "velodyne-vlp-16", 500.0, 10.0, **options)
        assert law(measure)[0].optics.hidden is None


def test_explain_says_how_many_drops_fog_hides_and_how_much_their_light_flickers(tmp_path: Path) -> None:
    measure = sensor(tmp_path, "velodyne-vlp-16", 500.0, 10.0)
    air = measure.air.at(0.0)
    number, until_m, rms = measure._falling.hidden(
        air.particles[0], air.everywhere.extinction_per_m, 1.0, measure._soft.everywhere(air)
    )
    assert 0.1 < number < 0.5
    assert 1.5 < until_m < 4.5
    # numbers and sizes as they are drawn, of all that stand in 0.75 FWHM and are not bright enough
    light, _ = law(measure)
    r, every = np.array([1.0]), replace(light, share=1e-6)
    size = every.drawn_sizes(np.full(200_000, 1.0), np.random.default_rng(1).random(200_000))
    bright = every.unit(r) * size**2
    some = bright < light.share * light.optics.level(r)
    square = (
        0.75 * light.optics.pulse.fwhm_m * every.density(r) * np.mean(bright**2 * some) / light.optics.level(r) ** 2
    )
    assert float(light.flicker_at(r)[0]) ** 2 == pytest.approx(float(square[0]), rel=0.03)
    assert 0.0 < rms < 0.15
    rows = explained(measure, plan(np.arange(0.0, 360.0, 5.0)))
    assert any(f"hides {number:.2g} more of each beam up to {until_m:.1f} m" in str(row) for row in rows)
