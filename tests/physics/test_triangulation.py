"""Triangulation: closed forms, limits and scaling of its errors."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from emulator.physics.triangulation import Triangulation

PLAIN = Triangulation(0.048, 1333.0, 0.0)
NOISY = Triangulation(0.048, 1333.0, 0.0142, spot_px=0.1)
REALISTIC = Triangulation(0.048, 1333.0, 0.0142, 0.1, 1.0 / 128.0, 430.0)
BRIGHT = np.full(200_000, np.inf)


def test_a_target_at_f_times_b_is_one_pixel_from_the_vanishing_point() -> None:
    assert PLAIN.place_px(0.048 * 1333.0) == pytest.approx(1.0)
    assert PLAIN.place_px(np.array([1.0, 2.0])) == pytest.approx([63.984, 31.992])


@given(st.floats(0.05, 100.0))
def test_without_errors_a_range_comes_back(range_m: float) -> None:
    assert PLAIN.measured(np.array([range_m]), np.array([10.0])) == pytest.approx(range_m, rel=1e-12)


@given(st.floats(0.1, 20.0), st.floats(1.1, 5.0))
def test_the_error_grows_with_the_square_of_the_distance(range_m: float, times: float) -> None:
    assert NOISY.spread_m(times * range_m) == pytest.approx(times**2 * NOISY.spread_m(range_m))
    assert REALISTIC.step_m(times * range_m) == pytest.approx(times**2 * REALISTIC.step_m(range_m))


def test_half_a_millimetre_at_a_metre_and_a_half_is_32_mm_at_twelve() -> None:
    """The A1 of the specification: 0.22 mm/m2."""
    assert NOISY.spread_m(1.5) == pytest.approx(0.5e-3, rel=0.01)
    assert NOISY.spread_m(12.0) == pytest.approx(32e-3, rel=0.01)


@pytest.mark.parametrize("range_m", [0.5, 1.5, 4.0, 8.0])
def test_drawn_ranges_scatter_as_the_closed_form_says(range_m: float) -> None:
    normals = np.random.default_rng(1).standard_normal(len(BRIGHT))
    found = NOISY.measured(np.full(len(BRIGHT), range_m), BRIGHT, normals)
    assert found.std() == pytest.approx(float(NOISY.spread_m(range_m)), rel=0.01)
    # E[1/(p + e)] = (1 + (s / p)^2) / p: far targets are read a little too far
    excess = 1.0 + (0.0142 / NOISY.place_px(range_m)) ** 2
    assert found.mean() == pytest.approx(range_m * excess, abs=4 * NOISY.spread_m(range_m) / len(BRIGHT) ** 0.5)


def test_twice_the_baseline_or_the_lens_halves_the_error() -> None:
    for wide in (Triangulation(0.096, 1333.0, 0.0142), Triangulation(0.048, 2666.0, 0.0142)):
        assert wide.spread_m(3.0) == pytest.approx(NOISY.spread_m(3.0) / 2.0)


def test_faint_spots_scatter_by_their_width_over_the_signal_to_noise() -> None:
    assert NOISY.spread_px(5.0) == pytest.approx(np.hypot(0.0142, 0.02))
    assert NOISY.spread_px(np.inf) == 0.0142
    assert NOISY.spread_px(0.1) == pytest.approx(1.0, rel=1e-3)


def test_ranges_lie_on_steps_of_the_place_which_are_wider_the_farther() -> None:
    range_m = np.linspace(0.2, 12.0, 50_000)
    found = REALISTIC.measured(range_m, np.full(len(range_m), np.inf))
    places = REALISTIC.place_px(found) * 128.0
    np.testing.assert_allclose(places, np.rint(places), atol=1e-6)
    assert (np.abs(found - range_m) <= 0.51 * REALISTIC.step_m(range_m) * (1 + range_m / 100)).all()
    for at_m in (4.0, 12.0):
        near = np.unique(found[np.abs(range_m - at_m) < 5.0 * REALISTIC.step_m(at_m)])
        assert np.diff(near).max() == pytest.approx(float(REALISTIC.step_m(at_m)), rel=0.03)


def test_nearer_than_the_imager_reaches_there_is_no_spot() -> None:
    near = REALISTIC.nearest_m
    assert near == pytest.approx(0.1488, abs=1e-4)
    found = REALISTIC.measured(np.array([near - 1e-6, near + 1e-6, np.nan]), np.full(3, 100.0))
    assert np.isnan(found).tolist() == [True, False, True]


def test_a_spot_found_behind_the_vanishing_point_is_no_range() -> None:
    found = NOISY.measured(np.array([1e4, 1e4]), np.array([np.inf, np.inf]), np.array([-1.0, 1.0]))
    assert np.isnan(found).tolist() == [True, False]
