"""Formulas that lose digits when written plainly: every row of section 6.1 of the project's physics specification.

Numbers are that section's, or the cases of its `physics_oracles.json` (20 digits, computed with mpmath), named at each.
Rows that a scene can reach are measured in one as well.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from emulator.physics import atmosphere, background, brdf, geometry, noise, pulse, radiometry, softtarget, tilted
from emulator.physics.detection import detect
from emulator.physics.detector import Detector
from emulator.physics.pulse import Pulse
from emulator.physics.subechoes import SubEchoes
from protocols.scan import SATURATED
from tests.sensing.rig import QUIET, build, plan, plate

ALPHA_V1 = 3.9120230054281461
"Extinction by Kim at a visibility of 1 m, 905 nm: ln 50 per metre."
LASER_M = 905e-9
PULSE = Pulse(16e-9)


def one_beam(*pairs: tuple[float, float]) -> SubEchoes:
    """Sub-echoes (range, amplitude) of a single beam."""
    r, a = (np.array(values, np.float64) for values in zip(*pairs, strict=True))
    return SubEchoes.of(np.zeros(len(pairs), np.int64), r, a)


# ------------------------------------------------------------------------------- row 1: exp(-2 alpha R)
def test_a_wall_at_250_m_in_a_visibility_of_1_m_has_no_transmission_but_a_logarithm() -> None:
    """Oracle `two-way underflow, V 1 m fog, 250 m, log10`."""
    assert float(atmosphere.fog_kim(1.0, LASER_M)) == pytest.approx(ALPHA_V1, rel=1e-14)
    assert float(atmosphere.transmission_two_way(ALPHA_V1, 250.0)) == 0.0
    logarithm = float(atmosphere.log10_transmission_two_way(ALPHA_V1, 250.0))
    assert logarithm == pytest.approx(-849.48500216800941138, rel=1e-12)
    log_snr = float(radiometry.log_snr(75_000.0, 0.75, ALPHA_V1, 250.0))
    assert log_snr == pytest.approx(math.log(75_000.0 * 0.75) - 500.0 * ALPHA_V1 - 2.0 * math.log(250.0), rel=1e-14)
    assert float(atmosphere.transmission_two_way(ALPHA_V1, 1e300)) == 0.0


@pytest.mark.parametrize("rule", ["axis", "spiral", "adaptive"])
@pytest.mark.parametrize("full", [False, True])
def test_a_wall_at_250_m_in_a_visibility_of_1_m_is_no_echo(tmp_path: Path, rule: str, full: bool) -> None:
    physics = {"rule": rule, "sub_beams": 16, "gate_m": 300.0, "echoes": "all", "max_echoes": 4, "full": full}
    weather = {"fog": {"visibility_m": 1.0}}
    scan = build(tmp_path, [plate(250.0, "white")], weather=weather, physics=physics)(plan(np.arange(-5.0, 6.0)))
    assert (scan.actor == -1).all()
    assert not np.isinf(scan.range_m).any()
    assert np.array_equal(np.isnan(scan.range_m), np.isnan(scan.intensity))
    # 7.9e-8 W of the fog's own light at 2 m (row 3) are 1.2 times the noise: not even that is an echo
    assert np.isnan(scan.range_m).all()


# ------------------------------------------------------------------------------- row 2: range equation solved for R
def test_the_largest_range_is_solved_from_thin_air_to_a_wall_of_fog() -> None:
    """Oracle `car in fog 1 m`; then alpha R0 from 1e-5 to 1e15."""
    found = float(radiometry.max_range_extended(75_000.0, 0.75, ALPHA_V1, 1.0))
    assert found == pytest.approx(1.3258438269793153790, rel=1e-12)
    depth = np.logspace(-5.0, 15.0, 201)
    r = radiometry.max_range_extended(1e4, 1.0, depth / 100.0, 1.0)
    assert np.isfinite(r).all()
    assert (np.diff(r) < 0.0).all()
    assert np.abs(np.log(r) + depth / 100.0 * r - math.log(100.0)).max() < 1e-12
    assert float(radiometry.max_range_extended(1e4, 1.0, 0.0, 1.0)) == 100.0


# ------------------------------------------------------------------------------- row 3: fog integral at the near gate
FOG_RETURNS = [
    (1000.0, 0.0030497093779208597, 2.0, 2.7744586328916543661e-7),
    (1000.0, 0.0030497093779208597, 5.0, 1.2116451078288039589e-6),
    (1000.0, 0.0030497093779208597, 20.0, 1.7857150925815223390e-8),
    (400.0, 0.0097800575135703651, 2.0, 8.7597368674129959896e-7),
    (400.0, 0.0097800575135703651, 5.0, 3.7796116010954870340e-6),
    (400.0, 0.0097800575135703651, 20.0, 4.5243418734897192265e-8),
    (40.0, 0.097800575135703651, 2.0, 7.1480479891665820286e-6),
    (40.0, 0.097800575135703651, 5.0, 0.000026582585496072354648),
    (40.0, 0.097800575135703651, 20.0, 2.1016504798250582121e-8),
    (10.0, 0.39120230054281461, 2.0, 0.000014619291549534125126),
    (10.0, 0.39120230054281461, 5.0, 0.000036798870083405031823),
    (10.0, 0.39120230054281461, 20.0, 3.5575136924836730188e-12),
    (1.0, 3.9120230054281461, 2.0, 7.8773559365380367900e-8),
    (1.0, 3.9120230054281461, 5.0, 6.3427581632228483226e-8),
    (1.0, 3.9120230054281461, 20.0, 5.1364335996352565428e-60),
]
"Oracles `fog return V ... m at ... m`: visibility, extinction, apparent range, power in watts."


def fog(x_m: Any, alpha: float, r1_m: float = 0.9, r2_m: float = 1.0, end_m: float = 250.0) -> Any:
    return softtarget.fog_return(x_m, alpha, 18.8, r1_m, r2_m, end_m, 16e-9, 1.6e-6, 3.141592653589793e-4, 0.5)


@pytest.mark.parametrize(("visibility_m", "alpha", "x_m", "watts"), FOG_RETURNS)
def test_fog_sends_back_its_reference_power(visibility_m: float, alpha: float, x_m: float, watts: float) -> None:
    assert float(atmosphere.fog_kim(visibility_m, LASER_M)) == pytest.approx(alpha, rel=1e-12)
    assert float(fog(x_m, alpha)) == pytest.approx(watts, rel=1e-10)


def test_fog_before_a_wall_and_under_a_long_ramp_sends_back_its_reference_power() -> None:
    """Oracles `fog return V 40 m, wall at 10 m, x 12 m` and `fog return, long overlap ramp 1..10 m`."""
    assert float(fog(12.0, 0.097800575135703651, end_m=10.0)) == pytest.approx(2.7258354301051035752e-7, rel=1e-10)
    ramp = float(fog(8.0, 0.097800575135703651, 1.0, 10.0))
    assert ramp == pytest.approx(1.1208777681217248652e-6, rel=1e-10)


def test_an_overlap_that_begins_at_zero_is_refused_by_name() -> None:
    with pytest.raises(ValueError, match=r"r1_m: 0.0; want a number > 0"):
        fog(2.0, 0.1, r1_m=0.0)


@pytest.mark.parametrize("visibility_m", [1.0, 10.0, 40.0, 400.0, 1000.0])
@pytest.mark.parametrize("wall_m", [0.95, 1.5, 10.0])
def test_a_wall_within_fog_is_measured_without_a_bad_number(tmp_path: Path, visibility_m: float, wall_m: float) -> None:
    physics = {"rule": "spiral", "sub_beams": 16, "echoes": "all", "max_echoes": 4, **QUIET}
    weather = {"fog": {"visibility_m": visibility_m}}
    measure = build(tmp_path, [plate(wall_m, "white")], weather=weather, physics=physics)
    scan = measure(plan(np.arange(-5.0, 6.0)))
    seen = np.isfinite(scan.range_m)
    overlap = 0.5 if wall_m < 1.0 else 1.0
    amplitude = overlap * measure.model.k_m2 / wall_m**2 * math.exp(-2.0 * ALPHA_V1 / visibility_m * wall_m)
    assert seen[:, 0].all() if amplitude > 2.0 * measure.model.threshold else not (scan.actor == 0).any()
    assert np.array_equal(seen, np.isfinite(scan.intensity))
    assert (scan.range_m[seen] < wall_m + 3.0).all()  # a pulse length: nothing shines through the wall


# ------------------------------------------------------------------------------- row 4: R -> 0
def test_an_echo_that_touches_the_window_takes_half_the_light() -> None:
    """Oracle `echo touching 0 m`: 50 W of 100 W."""
    assert float(radiometry.echo_extended(100.0, 1.0, 0.0, 0.01, 0.5, 0.0, 0.0)) == 50.0


@pytest.mark.parametrize("range_m", [1e-9, 1e-6, 1e-3])
def test_a_plate_at_the_window_is_not_an_infinite_echo(tmp_path: Path, range_m: float) -> None:
    physics = {**QUIET, "rule": "axis"}
    # overlap 0.9 to 1 m (paper-905nm): no light from nearer
    scan = build(tmp_path, [plate(range_m, "white", 1.0, 0.0, 1.0)], physics=physics)(plan([0.0]))
    assert np.isnan(scan.range_m).all()
    near = build(tmp_path, [plate(range_m, "white")], model="sick-lms291-s05", physics=physics)
    assert np.isfinite(near.view(plan([0.0])).echoes.amplitude).all()


# ------------------------------------------------------------------------------- rows 5 to 7: shares
def test_a_sphere_and_a_cylinder_of_a_hundred_millionth_and_of_ten_beams_have_their_shares() -> None:
    """Oracles `sphere a ... w`, `cylinder a ... w`. The section prints 0.998747641439 beside both: it is the
    cylinder's; a sphere of 10 w fills 0.997493702529 (both from the series and from Dawson's integral)."""
    assert float(radiometry.fill_sphere(1e-8, 1.0)) == pytest.approx(1.3333333333333332267e-16, rel=1e-12)
    assert float(radiometry.fill_cylinder(1e-8, 1.0)) == pytest.approx(1.2533141373155001885e-8, rel=1e-12)
    assert float(radiometry.fill_cylinder(10.0, 1.0)) == pytest.approx(0.99874764143876837601, rel=1e-12)
    assert float(radiometry.fill_sphere(10.0, 1.0)) == pytest.approx(0.99749370252857132198, rel=1e-12)
    for share in (radiometry.fill_sphere, radiometry.fill_cylinder):
        radius = np.logspace(-150.0, 150.0, 601)
        found = share(radius, 1.0)
        assert np.isfinite(found).all()
        assert (np.diff(found) >= 0.0).all()
        assert (found <= 1.0).all()


def test_a_thin_strip_off_the_axis_keeps_eleven_digits() -> None:
    """Oracles `wire strip 0.001 w at 0.7 w`, `wire strip 0.1 w centred`."""
    assert float(radiometry.fill_strip(0.6995, 0.7005, 1.0)) == pytest.approx(0.00029945497918426643506, rel=1e-11)
    assert float(radiometry.fill_strip(-0.05, 0.05, 1.0)) == pytest.approx(0.079655674554057962931, rel=1e-11)


def test_a_disc_of_a_hundred_millionth_of_the_beam_has_its_share() -> None:
    """Oracles `disc a 1e-8 w`, `disc a 10 w`."""
    assert float(radiometry.fill_disc(1e-8, 1.0)) == pytest.approx(1.9999999999999998000e-16, rel=1e-12)
    assert float(radiometry.fill_disc(10.0, 1.0)) == 1.0


# ------------------------------------------------------------------------------- rows 8 and 9: small angles
def test_the_solid_angle_of_a_cone_of_1_22_mrad_is_exact_to_rounding() -> None:
    h = 1.22e-3
    exact = math.pi * h * h * (1.0 - h * h / 12.0 + h**4 / 360.0)
    assert float(background.solid_angle(h)) == pytest.approx(exact, rel=1e-15)
    assert float(background.solid_angle(1e-150)) == pytest.approx(math.pi * 1e-300, rel=1e-14)


def test_directions_a_nanoradian_apart_are_told_apart() -> None:
    a = np.array([1.0, 0.0, 0.0])
    b = np.array([math.cos(1e-9), math.sin(1e-9), 0.0])
    assert float(geometry.angle_between(a, b)) == pytest.approx(1e-9, rel=1e-9)
    assert float(geometry.angle_between(a, a)) == 0.0
    assert float(geometry.angle_between(a, -b)) == pytest.approx(math.pi - 1e-9, rel=1e-15)
    over = np.array([1.0 + 2e-16, 0.0, 0.0])  # a cosine of more than 1 by rounding
    assert float(np.max(geometry.incidence_cosine(over, -over))) <= 1.0 + 1e-15


# ------------------------------------------------------------------------------- rows 10 to 13: tails, paint, lobes
def test_the_tail_of_the_normal_law_goes_on_where_it_underflows() -> None:
    """Oracles `log10 normal tail 50` and `1000`."""
    assert float(noise.log10_normal_tail(50.0)) == pytest.approx(-544.96633586199665500, rel=1e-11)
    assert float(noise.log10_normal_tail(1000.0)) == pytest.approx(-217150.64004199438628, rel=1e-11)
    assert float(noise.normal_tail(50.0)) == 0.0
    assert float(noise.detection_probability(5.0, 1e9)) == 1.0


def test_a_false_alarm_of_less_than_rounding_is_not_zero() -> None:
    """Oracle `false alarms tnr 9, 52 samples`."""
    assert float(noise.false_alarm_samples(9.0, 52.0)) == pytest.approx(5.8686597109599713513e-18, rel=1e-12)


def test_paint_of_almost_nothing_but_absorption_reflects_what_it_should() -> None:
    """Oracle `Kubelka-Munk 1e12`."""
    assert float(brdf.kubelka_munk(1e12)) == pytest.approx(4.9999999999950000000e-13, rel=1e-12)
    assert float(brdf.kubelka_munk(1e300)) == pytest.approx(5e-301, rel=1e-12)


def test_a_mirror_lobe_of_a_thousandth_at_normal_incidence_has_its_peak() -> None:
    assert float(brdf.ggx_back(0.9, 0.001, 0.0)) == pytest.approx(225_000.0, rel=1e-12)


# ------------------------------------------------------------------------------- row 14: spread over a plane
def test_the_range_spread_over_a_plane_met_square_on_is_not_lost() -> None:
    """Oracles `tilted_plane_range_std ... tilt 0`."""
    narrow, wide = 6.1086523819801535e-4, 6.4565e-3
    assert float(tilted.tilted_plane_range_std(narrow, 0.0)) == pytest.approx(9.3289064503044337252e-8, rel=1e-6)
    assert float(tilted.tilted_plane_range_std(wide, 0.0)) == pytest.approx(0.000010421344671402968249, rel=1e-6)


# ------------------------------------------------------------------------------- row 15: leading edge at the threshold
def test_the_leading_edge_at_the_threshold_is_finite_and_below_it_there_is_no_echo() -> None:
    """Oracles `walk sin^2 amplitude 1` and `1.0001`."""
    assert float(pulse.walk_sin2(16e-9, 1.0)) == pytest.approx(2.3983396640000000000, rel=1e-12)
    assert float(pulse.walk_sin2(16e-9, 1.0001)) == pytest.approx(2.3830718684033910087, rel=1e-12)
    assert math.isnan(float(pulse.walk_sin2(16e-9, np.nextafter(1.0, 0.0))))


@pytest.mark.parametrize("shape", ["sin2", "gauss"])
@pytest.mark.parametrize("method", ["leading_edge", "constant_fraction", "peak", "centroid"])
def test_an_amplitude_a_hair_below_the_threshold_is_no_echo_and_at_it_one(method: Any, shape: Any) -> None:
    detector = Detector(Pulse(16e-9, shape), 5.0, method)
    assert np.isnan(detect(one_beam((20.0, np.nextafter(5.0, 0.0))), 1, detector).range_m).all()
    for amplitude in (5.0, np.nextafter(5.0, 6.0), 5.0001):
        found = detect(one_beam((20.0, amplitude)), 1, detector)
        assert float(found.range_m[0, 0]) == pytest.approx(20.0, abs=1e-9)


# ------------------------------------------------------------------------------- row 16: very high SNR
def test_walk_at_a_hundred_million_times_the_threshold_is_a_seventh_of_a_millimetre() -> None:
    """Oracle `walk sin^2 amplitude 1e8`."""
    assert float(pulse.walk_sin2(16e-9, 1e8)) == pytest.approx(0.00015268304535005389526, rel=1e-12)


@pytest.mark.parametrize("method", ["leading_edge", "peak", "constant_fraction", "centroid"])
@pytest.mark.parametrize("snr", [1e6, 1e8, 1e9])
def test_an_echo_far_over_the_full_scale_is_marked_and_stays_in_its_place(
    tmp_path: Path, snr: float, method: str
) -> None:
    physics = {
        **QUIET, "rule": "axis", "system_constant_m2": snr * 400.0, "full_scale_snr": 1000.0,
        "threshold_to_noise": 5.0, "detection": method, "walk_table": False,
    }  # fmt: skip
    measure = build(tmp_path, [plate(20.0, "white")], weather={"visibility_m": 1e9}, physics=physics)
    scan = measure(plan([0.0]))
    assert scan.flags[0] & SATURATED
    assert scan.intensity[0, 0] == pytest.approx(200.0, rel=1e-9)  # clipped
    if method == "leading_edge":
        walk = float(pulse.walk_sin2(16e-9, snr / 5.0))
        assert scan.range_m[0, 0] == pytest.approx(20.0 + walk, abs=measure.model.lsb_m)
    elif method in ("peak", "constant_fraction"):
        # a clipped pulse has a flat top: nowhere farther off than half of it
        assert abs(scan.range_m[0, 0] - 20.0) < PULSE.fwhm_m
    else:
        assert np.isfinite(scan.range_m[0, 0])


# ------------------------------------------------------------------------------- row 17: order of the sum
def test_sub_echoes_in_any_order_give_the_same_range_to_a_nanometre(tmp_path: Path) -> None:
    posts = [plate(20.0 + 0.7 * k, "half", 100.0, 50.0 - 0.002 * k) for k in range(6)]
    physics = {**QUIET, "rule": "spiral", "sub_beams": 4096}
    found = build(tmp_path, posts, physics=physics).view(plan([0.0])).echoes
    assert len(found) > 3500
    detector = Detector(PULSE, 5.0, max_echoes=4, keep="all")
    first = detect(found, 1, detector)
    for seed in range(5):
        order = np.random.default_rng(seed).permutation(len(found))
        mixed = SubEchoes.of(
            found.beam[order], found.range_m[order], found.amplitude[order], found.blocked[order], found.source[order]
        )
        again = detect(mixed, 1, detector)
        assert again.range_m == pytest.approx(first.range_m, abs=1e-9, nan_ok=True)
        assert again.amplitude == pytest.approx(first.amplitude, rel=1e-12, nan_ok=True)
