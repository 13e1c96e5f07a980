"""Scan patterns against closed forms: spacing, period, petals, envelope, coverage."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest

from protocols.livox.patterns import Lissajous, Pattern, Raster, Rosette, repetition_s, through_wedges

RATE = Fraction(100_000)
NO_PHASE = (Fraction(0), Fraction(0))


def frame_of(pattern: Pattern, frame: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Azimuth and elevation in degrees of all points of a frame."""
    azimuth, elevation = pattern.aim(frame, np.arange(pattern.points))
    return np.degrees(azimuth), np.degrees(elevation)


def rosette(one_hz: float, other_hz: float, wedge_deg: float = 1.0, frame_s: Fraction | None = None) -> Rosette:
    hz = Fraction(str(one_hz)), Fraction(str(other_hz))
    return Rosette(RATE, frame_s or repetition_s(hz), hz, NO_PHASE, (1.5, 1.5), (wedge_deg, wedge_deg))


def off_axis(pattern: Pattern, frame: int = 0) -> np.ndarray:
    """Angle to the axis in degrees."""
    azimuth, elevation = np.radians(frame_of(pattern, frame))
    return np.degrees(np.arccos(np.clip(np.cos(azimuth) * np.cos(elevation), -1.0, 1.0)))


def test_rows_and_columns_of_a_raster_are_evenly_apart_over_its_field() -> None:
    raster = Raster(RATE, 9, 41, (40.0, 16.0))
    azimuth, elevation = (part.reshape(9, 41) for part in frame_of(raster))
    np.testing.assert_allclose(azimuth, np.broadcast_to(20.0 - np.arange(41.0), (9, 41)), atol=1e-12)
    np.testing.assert_allclose(elevation, np.broadcast_to(8.0 - 2.0 * np.arange(9.0)[:, None], (9, 41)), atol=1e-12)


def test_a_raster_flies_back_after_each_row_and_after_the_last() -> None:
    raster = Raster(RATE, 5, 10, (40.0, 16.0), Fraction(30, 10**6), Fraction(200, 10**6))
    fire_us = 1e6 * raster.fire_s(np.arange(50)).reshape(5, 10)
    np.testing.assert_allclose(np.diff(fire_us, axis=1), 10.0, rtol=1e-9)
    np.testing.assert_allclose(fire_us[:, 0], np.arange(5) * 130.0, rtol=1e-12)
    assert raster.frame_s == Fraction(5 * 130 + 200, 10**6)


def test_to_and_fro_every_second_row_begins_where_the_last_one_ended() -> None:
    azimuth, _ = frame_of(Raster(RATE, 3, 5, (8.0, 2.0), both_ways=True))
    assert azimuth == pytest.approx([4, 2, 0, -2, -4, -4, -2, 0, 2, 4, 4, 2, 0, -2, -4])


def test_one_row_or_column_is_in_the_middle() -> None:
    azimuth, elevation = frame_of(Raster(RATE, 1, 1, (40.0, 20.0)))
    assert (azimuth[0], elevation[0]) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("hz", "period"),
    [
        ((1310, 370), Fraction(1, 10)),
        ((500, 500), Fraction(1, 500)),
        ((0.5, 0.75), Fraction(4)),
        ((7, -3), Fraction(1)),
    ],
)
def test_two_motions_repeat_after_one_over_their_greatest_common_divisor(
    hz: tuple[float, float], period: Fraction
) -> None:
    one, other = (Fraction(str(value)) for value in hz)
    assert repetition_s((one, other)) == period


def test_a_lissajous_repeats_after_its_period_and_not_before() -> None:
    hz = Fraction(131), Fraction(37)
    figure = Lissajous(RATE, repetition_s(hz), hz, (Fraction(0), Fraction(90)), (50.0, 25.0))
    assert figure.frame_s == 1
    first, later = frame_of(figure), frame_of(figure, 7)
    np.testing.assert_allclose(later, first, atol=1e-9)
    azimuth, elevation = first
    tenth = Lissajous(RATE, Fraction(1, 10), hz, (Fraction(0), Fraction(90)), (50.0, 25.0))
    parts = np.array([frame_of(tenth, frame) for frame in range(10)])
    np.testing.assert_allclose(np.concatenate(parts, axis=1), first, atol=1e-9)
    for one in range(10):
        for other in range(one):
            assert np.abs(parts[one] - parts[other]).max() > 1.0
    assert (np.ptp(azimuth), np.ptp(elevation)) == pytest.approx((50.0, 25.0), abs=1e-3)
    rises = [int(np.sum((part[:-1] < 0) & (part[1:] >= 0))) for part in (azimuth, elevation)]
    assert rises[0] in (130, 131)
    assert rises[1] in (36, 37)
    t_s = np.arange(len(azimuth)) / 1e5
    np.testing.assert_allclose(azimuth, 25.0 * np.sin(2 * np.pi * 131 * t_s), atol=1e-8)
    np.testing.assert_allclose(elevation, 12.5 * np.cos(2 * np.pi * 37 * t_s), atol=1e-8)


@pytest.mark.parametrize(("one_hz", "other_hz", "petals"), [(30, -20, 5), (70, -30, 10), (50, 20, 3), (40, -40, 2)])
def test_a_rosette_has_as_many_petals_as_the_wedges_meet_in_a_period(one_hz: int, other_hz: int, petals: int) -> None:
    pattern = rosette(one_hz, other_hz)
    assert petals == abs(one_hz - other_hz) // math.gcd(one_hz, other_hz)
    off = off_axis(pattern)
    ahead, behind = np.roll(off, -1), np.roll(off, 1)
    assert np.sum((off > behind) & (off >= ahead) & (off > 0.9)) == petals
    assert off.max() == pytest.approx(1.0, abs=2e-3)  # 2 (n - 1) A
    assert off.min() < 1e-2  # equal wedges against each other: through the middle


def test_thin_wedges_add_their_deviations_as_vectors() -> None:
    one, other = np.random.default_rng(1).uniform(0.0, 2.0 * np.pi, (2, 1000))
    wedge = np.radians([0.2, 0.1])
    found = through_wedges((1.5, 1.7), wedge, one, other)
    first, second = 0.5 * wedge[0], 0.7 * wedge[1]
    np.testing.assert_allclose(found[1], first * np.cos(one) + second * np.cos(other), atol=3e-8)
    np.testing.assert_allclose(found[2], first * np.sin(one) + second * np.sin(other), atol=3e-8)
    np.testing.assert_allclose(np.linalg.norm(found, axis=0), 1.0, rtol=1e-14)


@pytest.mark.parametrize("against", [0.0, math.pi])
@pytest.mark.parametrize(
    ("n1", "n2", "a1", "a2"), [(1.51, 1.51, 18.0, 18.0), (1.5, 1.8, 25.0, 10.0), (1.4, 3.5, 5.0, 12.0)]
)
def test_wedges_in_line_deviate_as_snells_law_in_the_plane(
    n1: float, n2: float, a1: float, a2: float, against: float
) -> None:
    a, b = math.radians(a1), math.radians(a2) * (1.0 if against == 0.0 else -1.0)
    after_first = math.asin(n1 * math.sin(a)) - a
    inside = b + math.asin(math.sin(after_first - b) / n2)
    expected = math.asin(n2 * math.sin(inside))
    turned = np.radians(np.arange(0.0, 360.0, 15.0))
    found = through_wedges((n1, n2), np.radians([a1, a2]), turned, turned + against)
    np.testing.assert_allclose(found[0], math.cos(expected), rtol=1e-12)
    np.testing.assert_allclose(found[1], math.sin(expected) * np.cos(turned), atol=1e-12)
    np.testing.assert_allclose(found[2], math.sin(expected) * np.sin(turned), atol=1e-12)


def test_the_envelope_of_a_rosette_is_both_wedges_in_line_and_the_hole_their_difference() -> None:
    hz = Fraction(70), Fraction(-30)
    pattern = Rosette(RATE, repetition_s(hz), hz, NO_PHASE, (1.5, 1.5), (2.0, 1.0))
    off = off_axis(pattern)
    assert off.max() == pytest.approx(1.5, abs=5e-3)
    assert off.min() == pytest.approx(0.5, abs=5e-3)


def test_light_that_is_reflected_within_a_wedge_has_no_direction() -> None:
    assert np.isnan(through_wedges((1.5, 1.5), np.radians([45.0, 1.0]), np.zeros(3), np.zeros(3))).all()


def test_phases_are_as_exact_after_ten_years() -> None:
    hz = Fraction("121.57"), Fraction("-77.73")
    pattern = Rosette(RATE, Fraction(1, 10), hz, NO_PHASE, (1.5, 1.5), (10.0, 10.0))
    same = 10 * 100 * 3_155_760  # 0.01 Hz divides both frequencies: it repeats after 100 s
    np.testing.assert_allclose(frame_of(pattern, 3 + same), frame_of(pattern, 3), atol=1e-9)


def covered(pattern: Pattern, frames: int, cell_deg: float, radius_deg: float) -> float:
    """Share of the cells within a radius that some point of so many frames is in."""
    parts = np.concatenate([np.array(frame_of(pattern, frame)) for frame in range(frames)], axis=1)
    cells = {(int(x), int(y)) for x, y in np.floor(parts / cell_deg).T}
    side = int(radius_deg / cell_deg) + 1
    whole = [
        (x, y)
        for x in range(-side, side)
        for y in range(-side, side)
        if math.hypot((x + 0.5) * cell_deg, (y + 0.5) * cell_deg) < radius_deg
    ]
    return sum(cell in cells for cell in whole) / len(whole)


def test_a_rosette_that_does_not_repeat_covers_more_with_time_and_a_raster_does_not() -> None:
    moving = Rosette(RATE, Fraction(1, 10), (Fraction("121.57"), Fraction("-77.73")), NO_PHASE, (1.51, 1.51), (18, 18))
    shares = [covered(moving, frames, 0.25, 18.0) for frames in (1, 5, 20)]
    assert shares[0] < 0.45
    assert shares[1] > 1.7 * shares[0]
    assert shares[2] > 0.95
    fixed = rosette(120, -80, 18.0, Fraction(1, 10))
    assert covered(fixed, 5, 0.25, 18.0) == covered(fixed, 1, 0.25, 18.0)
    raster = Raster(RATE, 20, 100, (40.0, 40.0))
    assert covered(raster, 5, 0.25, 18.0) == covered(raster, 1, 0.25, 18.0)
