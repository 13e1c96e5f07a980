"""Value words: rounding, limits, special words, flags, reflectivity."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocols.lms2xx.outputs import ALL, MEAN, Format, Mean, Measured, Output, encode
from protocols.lms2xx.values import (
    MEASURING_MODES,
    intensity_words,
    max_range_m,
    reflectance,
    reflectivity_bytes,
    value_words,
)
from protocols.scan import DAZZLED, SATURATED

CM, MM, DM = 0, 1, 2


def words(
    ranges: list[float], mode: int = 0, unit: int = CM, flags: list[int] | None = None, **more: object
) -> list[int]:
    arrays = np.array(ranges, dtype=np.float64), np.array(flags or [0] * len(ranges), np.uint8)
    return value_words(*arrays, MEASURING_MODES[mode], unit, **more).tolist()  # type: ignore[arg-type]


def test_rounding_is_half_up_to_the_unit() -> None:
    assert words([0.125, 0.124, 0.375, 1.0, 0.0, 0.0049]) == [13, 12, 38, 100, 0, 0]
    assert words([0.0625, 1.0004], unit=MM) == [63, 1000]
    assert words([0.25, 12.34], unit=DM) == [3, 123]


@pytest.mark.parametrize(
    ("mode", "largest", "far"),
    [
        (0x00, 8182, 0x1FF7),
        (0x01, 8182, 0x1FF7),
        (0x02, 8182, 0x1FF7),
        (0x03, 16374, 0x3FF7),
        (0x04, 16374, 0x3FF7),
        (0x05, 32758, 0x7FF7),
        (0x06, 32758, 0x7FF7),
        (0x0D, 8182, 0x1FF7),
        (0x0E, 8182, 0x1FF7),
        (0x0F, 32758, 0x7FF7),
    ],
)
def test_the_largest_distance_is_followed_by_the_word_for_too_far(mode: int, largest: int, far: int) -> None:
    top_m = largest / 100
    assert words([top_m, top_m + 0.01, 1e6, math.inf, math.nan], mode) == [largest, far, far, far, far]
    assert max_range_m(MEASURING_MODES[mode], CM) == pytest.approx((largest + 0.5) / 100)
    assert max_range_m(MEASURING_MODES[mode], MM) == pytest.approx((largest + 0.5) / 1000)


def test_a_dazzled_beam_has_its_word_and_in_mode_00_its_flag() -> None:
    assert words([5.0, 5.0], 0x00, flags=[DAZZLED, 0]) == [0x9FFE, 500]
    assert words([math.nan], 0x01, flags=[DAZZLED]) == [0x1FFE]
    assert words([math.nan], 0x03, flags=[DAZZLED]) == [0x3FFE]
    assert words([math.nan], 0x06, flags=[DAZZLED]) == [0x7FFE]


def test_a_saturated_beam_is_measured_like_any_other() -> None:
    assert words([5.0], flags=[SATURATED]) == [500]


def test_negative_ranges_are_zero_and_never_wrap() -> None:
    assert words([-0.5, -1e9]) == [0, 0]


@given(st.lists(st.floats(allow_nan=True, allow_infinity=True, width=64), min_size=1, max_size=40))
def test_whatever_was_measured_becomes_a_distance_or_a_special_word(ranges: list[float]) -> None:
    for mode in (0x00, 0x03, 0x06):
        mask = MEASURING_MODES[mode].mask
        for found in words(ranges, mode):
            assert found <= mask - 9 or found == mask - 8


def test_reflectance_is_that_of_the_lambert_target_that_gives_the_echo() -> None:
    # 30 m at 10 % just reaches the threshold; at 15 m the same target gives four times the signal.
    found = reflectance(np.array([30.0, 15.0]), np.array([1.0, 4.0]), 9000.0)
    assert found == pytest.approx([0.1, 0.1])


@pytest.mark.parametrize(
    ("mode", "shift", "levels"),
    [(0x01, 13, [0, 0, 1, 2, 7]), (0x03, 14, [0, 0, 1, 1, 3]), (0x05, 15, [0, 0, 1, 1, 1])],
)
def test_reflector_bits_begin_above_any_white_surface(mode: int, shift: int, levels: list[int]) -> None:
    rho = np.array([0.1, 1.3, 2.0, 5.0, 1000.0])
    found = words([1.0] * 5, mode, rho=rho)
    assert found == [100 | level << shift for level in levels]


def test_a_beam_without_an_echo_has_no_reflector_bits() -> None:
    assert words([math.nan, 100.0], 0x01, rho=np.array([math.nan, 500.0])) == [0x1FF7, 0x1FF7]


def test_mode_3f_sends_reflectivity_only() -> None:
    rho = np.array([0.805, math.nan, 0.3])
    assert words([5.0, math.nan, 5.0], 0x3F, flags=[0, 0, DAZZLED], rho=rho) == [81, 0, 255]


def test_reflectivity_bytes_stop_below_the_dazzled_one() -> None:
    flags = np.array([0, 0, DAZZLED], np.uint8)
    assert reflectivity_bytes(np.array([0.5, 90.0, 0.5]), flags).tolist() == [50, 254, 255]


def test_raw_intensities_double_their_signal_every_thousand() -> None:
    signal = np.array([1.0, 2.0, 64.0, 1e9, math.nan, 0.5])
    found = intensity_words(signal, np.ones(6), MEASURING_MODES[0x0E]).tolist()
    assert found == [7000, 8000, 13000, 13000, 0, 7000]


def test_normalised_intensities_are_thousandths_of_white() -> None:
    rho = np.array([0.1, 1.0, 1e9, math.nan])
    assert intensity_words(np.ones(4), rho, MEASURING_MODES[0x0D]).tolist() == [100, 1000, 65535, 0]


def measured(ranges: list[float], flags: list[int] | None = None) -> Measured:
    array = np.array(ranges)
    return Measured(array, np.where(np.isnan(array), np.nan, 2.0), np.array(flags or [0] * len(ranges), np.uint8))


def test_a_mean_counts_only_scans_in_which_the_beam_had_an_echo() -> None:
    mean = Mean(4, 81.825)
    mean.add(measured([10.0, math.nan, 90.0, math.nan]))
    mean.add(measured([10.03, 7.0, 50.0, math.nan], [0, 0, 0, DAZZLED]))
    mean.add(measured([10.06, 9.0, 52.0, math.nan]))
    mean.add(measured([10.03, 8.0, 51.0, math.nan]))
    mean.add(measured([10.03, 8.0, 51.0, math.nan]))
    found = mean.result()
    assert found.range_m[:3] == pytest.approx([10.03, 8.0, 51.0])
    assert np.isnan(found.range_m[3])
    assert found.intensity[:3] == pytest.approx([2.0, 2.0, 2.0])
    assert found.flags.tolist() == [0, 0, 0, DAZZLED]


@pytest.mark.parametrize(("missing", "scans", "kept"), [(1, 5, True), (2, 9, False), (2, 10, True), (50, 250, True)])
def test_a_mean_with_more_than_a_fifth_missing_is_none(missing: int, scans: int, kept: bool) -> None:
    mean = Mean(1, 81.825)
    for number in range(scans):
        mean.add(measured([math.nan if number < missing else 3.0]))
    assert bool(mean.result().range_m[0] == 3.0) is kept


def test_a_mean_is_rounded_once() -> None:
    mean = Mean(1, 81.825)
    for range_m in (1.004, 1.004, 1.008):  # each would round to 100, 100, 101: a mean of 100.33
        mean.add(measured([range_m]))
    assert value_words(mean.result().range_m, np.zeros(1, np.uint8), MEASURING_MODES[0], CM).tolist() == [101]


def test_means_carry_no_flag_even_where_they_are_dazzled() -> None:
    form = Format(MEASURING_MODES[0], CM, False, 9000.0)
    found = Measured(np.array([math.nan, 2.0]), np.ones(2), np.array([DAZZLED, 0], np.uint8))
    words = np.frombuffer(encode(Output(MEAN, 2), found, form, None)[4:], "<u2")
    assert words.tolist() == [0x1FFE, 200]
    single = np.frombuffer(encode(Output(ALL), found, form, None)[3:], "<u2")
    assert single.tolist() == [0x9FFE, 200], "a single scan does"
