"""Formulas that lose digits when written plainly, at the inputs where they would; numpy's errors raised throughout."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from emulator.physics import atmosphere, background, brdf, geometry, noise, pulse, radiometry, softtarget, tilted
from emulator.physics.arrays import cos_sin

ALPHA_1M = float(atmosphere.fog_kim(1.0, 905e-9))
SEED_HALF = 6.1086523819801535e-4


def test_transmission_that_underflows_is_zero_and_its_logarithm_stays() -> None:
    assert atmosphere.transmission_two_way(ALPHA_1M, 250.0) == 0.0
    assert float(atmosphere.log10_transmission_two_way(ALPHA_1M, 250.0)) == pytest.approx(-849.4850, abs=5e-5)
    assert radiometry.echo_extended(100.0, 0.75, 0.0, 0.01, 0.5, ALPHA_1M, 250.0) == 0.0
    log_snr = float(radiometry.log_snr(75_000.0, 0.75, ALPHA_1M, 250.0))
    assert log_snr == pytest.approx(math.log(75_000.0 * 0.75) - 500.0 * ALPHA_1M - 2.0 * math.log(250.0), rel=1e-14)


def test_maximum_range_is_found_from_thin_air_to_a_wall_of_fog() -> None:
    depth = np.logspace(-5, 15, 81)  # alpha R0
    r = radiometry.max_range_extended(1e4, 1.0, depth / 100.0, 1.0)
    residual = np.log(r) + depth / 100.0 * r - math.log(100.0)
    assert np.all(np.isfinite(r))
    assert np.max(np.abs(residual)) < 1e-12
    assert float(radiometry.max_range_extended(1e4, 1.0, 0.0, 1.0)) == 100.0
    assert float(radiometry.max_range_extended(1e4, 0.0, 1e-3, 1.0)) == 0.0


def test_an_echo_that_touches_the_window_takes_half_of_all_light() -> None:
    assert float(radiometry.echo_extended(100.0, 1.0, 0.0, 0.01, 0.5, 0.0, 0.0)) == 50.0


def test_shares_of_tiny_and_of_huge_targets_keep_their_digits() -> None:
    assert float(radiometry.fill_sphere(1e-8, 1.0)) == pytest.approx(1.33333333333e-16, rel=1e-11)
    assert float(radiometry.fill_cylinder(10.0, 1.0)) == pytest.approx(0.998747641439, rel=1e-11)
    assert float(radiometry.fill_disc(1e-8, 1.0)) == pytest.approx(1.9999999999999998e-16, rel=1e-14)
    assert float(radiometry.fill_strip(0.6995, 0.7005, 1.0)) == pytest.approx(0.000299454979184, rel=1e-11)
    huge = np.array([1e3, 1e8, 1e30, 1e200])
    for share in (radiometry.fill_disc, radiometry.fill_sphere, radiometry.fill_cylinder, radiometry.tophat_sphere):
        assert np.all(np.abs(share(huge, 1e-30) - 1.0) < 0.34), share
        assert np.all(np.isfinite(share(np.array([0.0, 1e-200, 1e-150]), 1.0)))


def test_a_beam_without_width_sees_everything_or_nothing() -> None:
    assert float(radiometry.fill_edge(0.1, 0.0)) == 1.0
    assert float(radiometry.fill_edge(-0.1, 0.0)) == 0.0
    assert float(radiometry.fill_edge(0.0, 0.0)) == 0.5
    assert float(radiometry.fill_disc(1e-6, 0.0)) == 1.0
    assert float(radiometry.fill_strip(-1e-9, 1e-9, 0.0)) == 1.0
    assert float(radiometry.fill_sphere(0.01, 0.0)) == 1.0
    reach = float(radiometry.max_range_cylinder(75_000.0, 0.5, 0.0, 1.0, 0.0, 0.001))
    assert reach == pytest.approx(float(radiometry.max_range_extended(75_000.0, 0.5, 0.0, 1.0)), rel=1e-9)


def test_a_strip_far_from_the_axis_is_a_difference_of_tails_not_of_ones() -> None:
    near, far = float(radiometry.fill_strip(4.0, 5.0, 1.0)), float(radiometry.fill_strip(-5.0, -4.0, 1.0))
    assert near == far
    assert near == pytest.approx(6.220960574271786e-16, rel=1e-9)  # Q(8), the far edge adds nothing


@given(angle=st.lists(st.floats(-1e4, 1e4, allow_subnormal=False), min_size=1, max_size=50))
def test_cosines_of_whole_arrays_are_those_of_the_library(angle: list[float]) -> None:
    wanted = np.array(angle)
    cosine, sine = cos_sin(wanted)
    limit = 2e-15 + 4e-16 * np.maximum(np.abs(wanted), 1.0)
    assert bool((np.abs(cosine - np.cos(wanted)) <= limit).all())
    assert bool((np.abs(sine - np.sin(wanted)) <= limit).all())
    nothing, half_turn = (float(value[0]) for value in cos_sin(np.zeros(1))), cos_sin(np.array([np.pi]))
    assert tuple(nothing) == (1.0, 0.0)
    assert (half_turn[0][0], half_turn[1][0]) == (-1.0, pytest.approx(0.0, abs=1e-15))


def test_solid_angle_of_a_small_cone_keeps_all_digits() -> None:
    h = 1.22e-3
    exact = math.pi * h * h * (1.0 - h * h / 12.0 + h**4 / 360.0)
    assert float(background.solid_angle(h)) == pytest.approx(exact, rel=1e-15)


def test_an_angle_of_a_nanoradian_is_resolved_and_an_opposite_one_too() -> None:
    a = np.array([1.0, 0.0, 0.0])
    b = np.array([math.cos(1e-9), math.sin(1e-9), 0.0])
    assert float(geometry.angle_between(a, b)) == pytest.approx(1e-9, rel=1e-9)
    assert float(geometry.angle_between(a, -b)) == pytest.approx(math.pi - 1e-9, rel=1e-15)
    assert float(geometry.angle_between(a, a)) == 0.0


def test_tails_of_the_normal_law_go_on_where_they_underflow() -> None:
    assert float(noise.log10_normal_tail(50.0)) == pytest.approx(-544.966335862, rel=1e-11)
    assert float(noise.log10_normal_tail(1000.0)) == pytest.approx(-217150.640042, rel=1e-11)
    assert float(noise.normal_tail(50.0)) == 0.0
    assert float(noise.detection_probability(5.0, 1e9)) == 1.0
    assert float(noise.false_alarm_samples(9.0, 52.0)) == pytest.approx(5.86865971e-18, rel=1e-8)
    assert float(noise.false_alarm_rice(60.0, 31.25e6, 250.0)) == 0.0


def test_paint_from_no_absorption_to_nothing_but_absorption() -> None:
    assert float(brdf.kubelka_munk(1e12)) == pytest.approx(4.999999999995e-13, rel=1e-12)
    assert float(brdf.kubelka_munk(0.0)) == 1.0
    assert float(brdf.kubelka_munk(1e300)) == pytest.approx(5e-301, rel=1e-12)


def test_a_lobe_near_normal_incidence_does_not_cancel() -> None:
    assert float(brdf.ggx_back(0.9, 0.001, 0.0)) == pytest.approx(225_000.0, rel=1e-12)


@pytest.mark.parametrize("model", ["ggx", "oren_nayar", "phong", "fresnel", "pane"])
def test_grazing_incidence_is_finite_in_every_model(model: str) -> None:
    cosine = np.array([0.0, 1e-300, 1e-16, 1e-9, 1e-4, 1.0])
    values = {
        "ggx": lambda: brdf.ggx_cos(0.04, 0.1, cosine),
        "oren_nayar": lambda: brdf.oren_nayar_cos(0.5, 0.5, cosine),
        "phong": lambda: brdf.phong_cos(0.3, 0.2, 1e6, cosine),
        "fresnel": lambda: brdf.fresnel_cos(1.0, cosine)[0] + brdf.fresnel_cos(1.5, cosine)[1],
        "pane": lambda: brdf.pane_internal_transmission_cos(1.5, cosine, 1.0),
    }[model]()
    assert np.all(np.isfinite(values))
    assert np.all(values >= 0.0)


def test_the_spread_over_a_plane_seen_square_on_is_second_order_and_there() -> None:
    assert float(tilted.tilted_plane_range_std(SEED_HALF, 0.0)) == pytest.approx(9.32890645e-8, rel=1e-6)


def test_the_leading_edge_at_and_just_over_the_threshold() -> None:
    assert float(pulse.walk_sin2(16e-9, 1.0)) == pytest.approx(2.39833966400, rel=1e-12)
    assert float(pulse.walk_sin2(16e-9, 1.0001)) == pytest.approx(2.38307186840, rel=1e-11)
    assert math.isnan(float(pulse.walk_sin2(16e-9, 0.9999)))
    assert float(pulse.walk_sin2(16e-9, 1e8)) == pytest.approx(0.153e-3, rel=5e-3)


def test_the_overlap_must_start_beyond_zero() -> None:
    with pytest.raises(ValueError, match=r"r1_m: 0.0; want a number > 0"):
        softtarget.fog_return(5.0, 0.1, 18.8, 0.0, 1.0, 250.0, 16e-9, 1.6e-6, 3.14e-4, 0.5)


@pytest.mark.parametrize("visibility_m", [1.0, 10.0, 40.0, 400.0, 1000.0, 23_000.0, 1e6])
def test_the_rule_of_twelve_nodes_agrees_with_the_closed_form(visibility_m: float) -> None:
    alpha = float(atmosphere.fog_kim(visibility_m, 905e-9))
    x = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 8.0])
    closed = softtarget.fog_shape(x, alpha, 0.9, 1.0, 250.0, 16e-9)
    nodes = softtarget.fog_shape_nodes(x, alpha, 0.9, 1.0, 250.0, 16e-9)
    kept = closed > 1e-6 * closed.max()
    assert np.max(np.abs(nodes[kept] / closed[kept] - 1.0)) < 1e-9


@pytest.mark.parametrize("visibility_m", [1.0, 1e6])
def test_fog_returns_are_finite_at_every_range_and_in_both_extremes(visibility_m: float) -> None:
    alpha = float(atmosphere.fog_kim(visibility_m, 905e-9))
    x = np.concatenate([[0.0, 0.89, 0.9, 0.9001, 1.0], np.linspace(1.0, 260.0, 300)])
    power = softtarget.fog_return(x, alpha, 18.8, 0.9, 1.0, 250.0, 16e-9, 1.6e-6, 3.14e-4, 0.5)
    assert np.all(np.isfinite(power))
    assert np.all(power >= 0.0)
    assert np.all(power[:3] == 0.0)
    assert np.all(softtarget.fog_return(x, 0.0, 18.8, 0.9, 1.0, 250.0, 16e-9, 1.6e-6, 3.14e-4, 0.5) == 0.0)


def test_a_hard_step_of_the_overlap_is_allowed() -> None:
    stepped = float(softtarget.fog_shape(4.0, 0.1, 1.0, 1.0, 250.0, 16e-9))
    ramped = float(softtarget.fog_shape(4.0, 0.1, 1.0, 1.0 + 1e-6, 250.0, 16e-9))
    assert stepped == pytest.approx(ramped, rel=1e-5)


@pytest.mark.parametrize(
    "law", ["fog_kim", "fog_kruse", "fog_naboulsi_advection", "fog_naboulsi_radiation", "fog_ijaz"]
)
@pytest.mark.parametrize("bad", [0.0, -5.0, math.nan, math.inf])
def test_a_visibility_that_is_no_distance_is_refused(law: str, bad: float) -> None:
    with pytest.raises(ValueError, match="visibility_m"):
        getattr(atmosphere, law)(bad, 905e-9)


@pytest.mark.parametrize("law", list(atmosphere.RAIN_LAWS))
def test_a_negative_rain_is_refused_and_none_is_none(law: str) -> None:
    with pytest.raises(ValueError, match="rain_mm_h"):
        atmosphere.RAIN_LAWS[law](-1.0)
    with pytest.raises(ValueError, match="rain_mm_h"):
        atmosphere.RAIN_LAWS[law](math.nan)
    assert float(atmosphere.RAIN_LAWS[law](0.0)) == 0.0
    assert np.isfinite(float(atmosphere.RAIN_LAWS[law](300.0)))
