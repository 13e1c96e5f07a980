"""Drops and flakes: the thinned sample has the law of the whole."""

from __future__ import annotations

import math

import numpy as np
import pytest

from emulator.physics import precipitation as rain
from emulator.physics.arrays import Floats

HALF = 6.1086523819801535e-4
SCALE = float(rain.detectable_scale(HALF, 0.00584, 100.0, math.pi * 1e-4, 0.5, 3.35e-7))


def test_the_mean_of_detectable_drops_is_the_reference_formula() -> None:
    for rate in (1.0, 10.0, 300.0):
        spectrum = rain.rain_spectrum(rate, 0.00584)
        found = float(rain.detectable_mean(spectrum, SCALE, HALF, 1.0, 30.0))
        exact = float(rain.rain_false_echo_mean(rate, HALF, 1.0, 30.0, 0.00584, 100.0, math.pi * 1e-4, 0.5, 3.35e-7))
        assert found == pytest.approx(exact, rel=1e-9)


@pytest.mark.parametrize("y", [0.0, 1e-15, 1e-9, 1e-7, 1e-3, 0.5, 3.0, 40.0])
def test_the_cone_s_integral_keeps_its_digits_from_no_limit_to_a_sharp_one(y: float) -> None:
    t = np.linspace(0.0, 1.0, 20001)
    density = t * t * np.exp(-y * t * t)
    simpson = float(density[0] + density[-1] + 4.0 * density[1::2].sum() + 2.0 * density[2:-1:2].sum()) / 60000.0
    assert float(rain._cone(np.float64(y / 900.0), 30.0)) == pytest.approx(27000.0 * simpson, rel=1e-12)


def test_a_drop_lies_where_its_share_of_the_cone_is_reached() -> None:
    spectrum = rain.rain_spectrum(10.0)
    share = np.array([1e-9, 0.01, 0.3, 0.5, 0.9, 1.0 - 1e-9] * 2)
    far = np.array([5.0, 200.0])
    _, r, _ = rain.detectable_particles(
        spectrum, np.full(2, SCALE), HALF, 1.0, far, np.array([6, 6]), np.column_stack([share, share])
    )
    b = np.full(12, spectrum.slope_mm * SCALE)
    low, high = rain._cone(b, 1.0), rain._cone(b, far.repeat(6))
    assert (rain._cone(b, r) - low) / (high - low) == pytest.approx(share, rel=1e-6, abs=1e-12)


def test_the_mean_does_not_cancel_where_every_drop_is_seen() -> None:
    spectrum = rain.rain_spectrum(10.0)
    everything = float(rain.detectable_mean(spectrum, 1e-12, HALF, 1.0, 30.0))
    assert everything == pytest.approx(float(rain.rain_drops_in_beam(10.0, 0.0, HALF, 1.0, 30.0)), rel=1e-6)
    assert float(rain.detectable_mean(spectrum, SCALE, HALF, 5.0, 5.0)) == 0.0
    assert float(rain.detectable_mean(spectrum, SCALE, HALF, 5.0, 2.0)) == 0.0  # the wall stands before the overlap


def thinned(rate: float, beams: int, far_m: float) -> tuple[Floats, Floats]:
    rng = np.random.default_rng(4)
    spectrum = rain.rain_spectrum(rate, 0.00584)
    far = np.full(beams, far_m)
    mean = rain.detectable_mean(spectrum, np.full(beams, SCALE), HALF, 1.0, far)
    count = rng.poisson(mean)
    uniform = rng.uniform(size=(int(count.sum()), 2))
    beam, r, d = rain.detectable_particles(spectrum, np.full(beams, SCALE), HALF, 1.0, far, count, uniform)
    assert np.array_equal(np.bincount(beam, minlength=beams), count)
    return r, d


def test_the_number_of_false_echoes_is_that_of_the_closed_form() -> None:
    beams = 100_000
    r, _ = thinned(10.0, beams, 30.0)
    exact = float(rain.rain_false_echo_mean(10.0, HALF, 1.0, 30.0, 0.00584, 100.0, math.pi * 1e-4, 0.5, 3.35e-7))
    assert abs(r.size / beams - exact) < 4.0 * math.sqrt(exact / beams)


def test_every_thinned_drop_is_over_the_threshold_and_lies_in_the_gate() -> None:
    r, d = thinned(70.0, 20_000, 12.0)
    assert np.all((r >= 1.0) & (r <= 12.0))
    power = rain.particle_power(d, 0.00584, r, HALF, 0.0, 100.0, math.pi * 1e-4, 0.5)
    assert np.all(power >= 3.35e-7 * (1.0 - 1e-9))
    assert np.all(d <= rain.LARGEST_DROP_MM)


def test_thinned_drops_have_the_same_law_as_those_picked_from_all() -> None:
    r, d = thinned(70.0, 40_000, 30.0)
    rng = np.random.default_rng(9)
    slope = rain.rain_spectrum(70.0).slope_mm
    # all drops above 0.2 mm of as many cones, the detectable ones kept
    mean = float(rain.rain_drops_in_beam(70.0, 0.2, HALF, 1.0, 30.0))
    number = rng.poisson(mean * 40_000)
    place = np.cbrt(1.0 + rng.uniform(size=number) * (30.0**3 - 1.0))
    size = 0.2 - np.log(rng.uniform(size=number)) / slope
    seen = size >= SCALE * place**2
    near, big = place[seen & (SCALE * place**2 > 0.2)], size[seen & (SCALE * place**2 > 0.2)]
    kept = SCALE * r**2 > 0.2
    assert kept.sum() == pytest.approx(near.size, rel=0.1)
    assert np.quantile(r[kept], [0.25, 0.5, 0.75]) == pytest.approx(np.quantile(near, [0.25, 0.5, 0.75]), rel=0.06)
    assert np.quantile(d[kept], [0.25, 0.5, 0.75]) == pytest.approx(np.quantile(big, [0.25, 0.5, 0.75]), rel=0.1)


def test_snow_flakes_are_few_and_bright() -> None:
    snow = rain.snow_spectrum(2.0)
    assert snow.density_m3_mm == pytest.approx(7600.0 * 2.0**-0.87)
    assert snow.slope_mm == pytest.approx(2.55 * 2.0**-0.48)
    assert snow.kappa_sr / rain.rain_spectrum(2.0).kappa_sr > 30.0


def test_no_beams_and_no_drops_are_no_trouble() -> None:
    spectrum = rain.rain_spectrum(10.0)
    none = np.zeros(0, np.int64)
    empty = np.zeros(0)
    beam, r, d = rain.detectable_particles(spectrum, empty, HALF, 1.0, empty, none, np.zeros((0, 2)))
    assert beam.size == r.size == d.size == 0
    with pytest.raises(ValueError, match="rain_mm_h"):
        rain.rain_spectrum(0.0)
