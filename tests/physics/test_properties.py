"""Laws that hold for any input: energy, monotony, scaling with the power."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from emulator.physics import atmosphere as air
from emulator.physics import radiometry, softtarget
from emulator.physics.pulse import Pulse

HALF = 6.1086523819801535e-4


def upto(largest: float) -> st.SearchStrategy[float]:
    """Zero, or a number that is not so small that its products are nothing."""
    return st.just(0.0) | st.floats(1e-9 * largest, largest)


@given(upto(500.0), upto(0.5), st.floats(1e-4, 0.2), upto(1.0))
def test_no_echo_brings_back_more_than_was_sent(range_m: float, alpha: float, aperture: float, rho: float) -> None:
    power = float(radiometry.echo_extended(100.0, rho, 0.0, aperture, 1.0, alpha, range_m))
    assert 0.0 <= power <= 100.0 * rho * (1.0 + 1e-15)


@given(upto(499.0), upto(1.0), upto(0.5), upto(0.5))
def test_more_distance_and_more_extinction_never_give_more_signal(r: float, dr: float, a: float, da: float) -> None:
    first = float(radiometry.echo_extended(100.0, 0.5, 0.0, 0.01, 0.5, a, r))
    assert float(radiometry.echo_extended(100.0, 0.5, 0.0, 0.01, 0.5, a, r + dr)) <= first * (1.0 + 1e-12)
    assert float(radiometry.echo_extended(100.0, 0.5, 0.0, 0.01, 0.5, a + da, r)) <= first * (1.0 + 1e-12)


@pytest.mark.parametrize("law", list(air.FOG_LAWS))
@pytest.mark.parametrize("wavelength_m", [532e-9, 905e-9, 1550e-9])
def test_more_fog_never_lets_more_light_through_except_at_the_documented_jumps(law: str, wavelength_m: float) -> None:
    v = np.geomspace(1.0, 1e6, 4000)
    alpha = air.FOG_LAWS[law](v, wavelength_m)
    assert np.all(np.isfinite(alpha) & (alpha > 0.0))
    rises = np.flatnonzero(np.diff(alpha) > 0.0)
    if wavelength_m > 550e-9:
        assert rises.size == 0
    else:  # below 550 nm the exponent works the other way at the jumps
        jumps = v[rises + 1]
        assert all(min(abs(jump - at) / at for at in (6e3, 5e4)) < 0.01 for jump in jumps)


@pytest.mark.parametrize("law", list(air.RAIN_LAWS))
def test_more_rain_never_lets_more_light_through(law: str) -> None:
    alpha = air.RAIN_LAWS[law](np.linspace(0.0, 300.0, 601))
    assert alpha[0] == 0.0
    assert np.all(np.diff(alpha) > 0.0)


@given(st.floats(1e-3, 20.0), upto(5.0))
def test_shares_lie_between_nothing_and_everything_and_grow_with_the_target(a: float, da: float) -> None:
    for share in (
        radiometry.fill_disc,
        radiometry.fill_cylinder,
        radiometry.fill_sphere,
        radiometry.tophat_sphere,
        radiometry.tophat_cylinder,
        radiometry.fill_edge,
        radiometry.tophat_edge,
    ):
        small, large = float(share(a, 1.0)), float(share(a + da, 1.0))
        assert 0.0 <= small <= large + 1e-12 <= 1.0 + 2e-12, share


@given(st.floats(-3.0, 3.0), upto(3.0), upto(3.0))
def test_strips_side_by_side_add_to_the_strip_of_both(x: float, first: float, second: float) -> None:
    both = float(radiometry.fill_strip(x, x + first + second, 1.0))
    parts = float(radiometry.fill_strip(x, x + first, 1.0)) + float(
        radiometry.fill_strip(x + first, x + first + second, 1.0)
    )
    assert both == pytest.approx(parts, abs=1e-14)


@given(upto(3.0))
def test_a_disc_off_the_axis_tends_to_the_centred_one_and_to_nothing(offset: float) -> None:
    centred = float(radiometry.fill_disc(0.7, 1.0))
    off = float(radiometry.fill_disc_offset(0.7, 1.0, offset))
    assert off <= centred * (1.0 + 1e-12)
    assert float(radiometry.fill_disc_offset(0.7, 1.0, 0.0)) == pytest.approx(centred, rel=1e-12)
    assert float(radiometry.fill_disc_offset(0.7, 1.0, 30.0)) == 0.0


@pytest.mark.parametrize(
    ("reach", "power", "exponent"),
    [
        (lambda k: radiometry.max_range_extended(k, 0.5, 0.0, 1.0), 75_000.0, 1.0 / 2.0),
        (lambda k: radiometry.max_range_cylinder(k, 0.5, 0.0, 1.0, HALF, 1e-4), 75_000.0, 1.0 / 3.0),
        (lambda k: radiometry.max_range_sphere(k, 0.5, 0.0, 1.0, HALF, 1e-3), 75_000.0, 1.0 / 4.0),
    ],
)
def test_range_grows_with_the_power_as_a_half_a_third_a_quarter(reach: object, power: float, exponent: float) -> None:
    assert callable(reach)
    slope = math.log(float(reach(power * 1.01)) / float(reach(power))) / math.log(1.01)
    assert slope == pytest.approx(exponent, abs=2e-3)


def test_a_smaller_divergence_lengthens_the_range_of_wire_and_point_only() -> None:
    half = HALF / 1.01
    for reach, exponent in (
        (lambda h: radiometry.max_range_cylinder(75_000.0, 0.5, 0.0, 1.0, h, 1e-4), 1.0 / 3.0),
        (lambda h: radiometry.max_range_sphere(75_000.0, 0.5, 0.0, 1.0, h, 1e-3), 1.0 / 2.0),
        (lambda h: radiometry.max_range_cylinder(75_000.0, 0.5, 0.0, 1.0, h, 100.0), 0.0),
    ):
        slope = math.log(float(reach(half)) / float(reach(HALF))) / math.log(1.01)
        assert slope == pytest.approx(exponent, abs=3e-3)


@given(upto(400.0), upto(400.0), upto(400.0), upto(0.1))
def test_clouds_along_a_ray_add_up_once(range_m: float, enter: float, length: float, alpha: float) -> None:
    whole = float(air.optical_depth(range_m, alpha, enter, enter + length))
    middle = enter + 0.5 * length
    halves = float(
        air.optical_depth(range_m, alpha, enter, middle) + air.optical_depth(range_m, alpha, middle, enter + length)
    )
    assert whole == pytest.approx(halves, abs=1e-12)
    assert 0.0 <= whole <= alpha * length + 1e-13


@given(st.floats(1.0, 5e4), st.floats(0.05, 3.0), upto(3.0), upto(60.0))
def test_the_fog_s_return_never_exceeds_its_bound(visibility_m: float, r1: float, ramp: float, x: float) -> None:
    alpha = float(air.fog_kim(visibility_m, 905e-9))
    r2 = r1 + max(ramp, 1e-3)
    power = float(softtarget.fog_return(x, alpha, 18.8, r1, r2, 250.0, 16e-9, 1.6e-6, 3.14e-4, 0.5))
    bound = float(softtarget.fog_bound(alpha, 18.8, r1, r2, 1.6e-6, 3.14e-4, 0.5))
    assert 0.0 <= power <= bound * (1.0 + 1e-9)


@pytest.mark.parametrize("shape", ["sin2", "gauss"])
def test_the_pulse_has_its_width_its_energy_and_is_even(shape: str) -> None:
    pulse = Pulse(16e-9, shape)  # type: ignore[arg-type]
    half = float(pulse.profile(0.5 * pulse.fwhm_m))
    assert half == pytest.approx(0.5, rel=1e-12)
    t = np.linspace(-60e-9, 60e-9, 200_001)
    watts = pulse.peak_power(1.6e-6) * pulse.profile(0.5 * 299_792_458.0 * t)
    assert float(np.trapezoid(watts, t)) == pytest.approx(1.6e-6, rel=1e-6)
    assert np.allclose(watts, watts[::-1], rtol=1e-9, atol=1e-12)
    with pytest.raises(ValueError, match="fwhm_s"):
        Pulse(0.0)
    with pytest.raises(ValueError, match="want sin2 or gauss"):
        Pulse(1e-9, "box")  # type: ignore[arg-type]


def test_laws_warn_outside_their_range_and_compute_all_the_same() -> None:
    assert air.out_of_validity("kim", 200.0, 905e-9) == ()
    assert "wavelength 532 nm" in air.out_of_validity("kim", 200.0, 532e-9)[0]
    assert "visibility 4000 m" in air.out_of_validity("naboulsi_advection", 4000.0, 905e-9)[0]
    assert len(air.out_of_validity("ijaz", 0.5, 400e-9)) == 3
    assert air.deep_path_warning(4.9) == ()
    assert "single-scattering" in air.deep_path_warning(6.0)[0]
    assert set(air.FOG_LAWS) == {"kim", "kruse", "naboulsi_advection", "naboulsi_radiation", "ijaz"}
    assert air.fog_lidar_ratio(200.0) == 18.8
    assert air.fog_lidar_ratio(23_000.0) == 70.0
    assert float(air.visibility_from_mor(765.776)) == pytest.approx(1000.0, rel=1e-6)


def test_spray_grows_with_the_square_of_the_speed() -> None:
    assert float(air.spray(100.0 / 3.6)) == pytest.approx(0.0045)
    assert float(air.spray(50.0 / 3.6, dense=True)) == pytest.approx(0.017 / 4.0)
    assert float(air.spray(0.0)) == 0.0
