"""Drops and flakes: spectra and mean numbers."""

from __future__ import annotations

import math

import numpy as np
import pytest

from emulator.physics import precipitation as rain

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


def test_the_mean_does_not_cancel_where_every_drop_is_seen() -> None:
    spectrum = rain.rain_spectrum(10.0)
    everything = float(rain.detectable_mean(spectrum, 1e-12, HALF, 1.0, 30.0))
    assert everything == pytest.approx(float(rain.rain_drops_in_beam(10.0, 0.0, HALF, 1.0, 30.0)), rel=1e-6)
    assert float(rain.detectable_mean(spectrum, SCALE, HALF, 5.0, 5.0)) == 0.0
    assert float(rain.detectable_mean(spectrum, SCALE, HALF, 5.0, 2.0)) == 0.0  # the wall stands before the overlap


def test_snow_flakes_are_few_and_bright() -> None:
    snow = rain.snow_spectrum(2.0)
    assert snow.density_m3_mm == pytest.approx(7600.0 * 2.0**-0.87)
    assert snow.slope_mm == pytest.approx(2.55 * 2.0**-0.48)
    assert snow.kappa_sr / rain.rain_spectrum(2.0).kappa_sr > 30.0


def test_no_rain_has_no_spectrum() -> None:
    with pytest.raises(ValueError, match="rain_mm_h"):
        rain.rain_spectrum(0.0)
