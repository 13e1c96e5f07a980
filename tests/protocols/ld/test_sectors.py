"""The sector table: where sectors lie, and which combinations the device measures."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocols.ld.sectors import (
    EMPTY,
    TICKS,
    Function,
    MeasureError,
    Sector,
    Table,
    check,
    initialised,
    is_step,
    spans,
    table_of,
    table_of_arcs,
    with_sector,
)

N, NONE = Function.NORMAL, Function.NO_MEASUREMENT
STEPS = [step for step in range(2, 65) if TICKS % step == 0]


def circle(step: int) -> Table:
    return table_of([Sector(N, TICKS - step)])


def arc(width: int, step: int) -> Table:
    return table_of([Sector(N, width), Sector(NONE, TICKS - step)])


def test_a_single_sector_is_a_full_revolution_that_begins_behind_its_own_stop() -> None:
    (span,) = spans(circle(8), 8)
    assert (span.start, span.stop, span.points, span.offset, span.length) == (0, 5752, 720, 0, 5752)


def test_what_sicktoolbox_writes_for_300_degrees_measures_601_points() -> None:
    first, second = spans(table_of([Sector(N, 0x12C0), Sector(NONE, 0x1678)]), 8)
    assert (first.start, first.stop, first.points) == (0, 4800, 601)
    assert (second.start, second.stop, second.points) == (4808, 5752, 0)


def test_three_areas_of_sicktoolbox_have_91_91_and_31_points() -> None:
    table = table_of_arcs([(0, 90 * 16), (100 * 16, 190 * 16), (200 * 16, 230 * 16)], 16)
    assert [span.points for span in spans(table, 16)] == [91, 0, 91, 0, 31, 0]


def test_an_area_through_direction_0_is_measured_in_one_piece() -> None:
    first, gap = spans(table_of_arcs([(350 * 16, 10 * 16)], 8), 8)
    assert (first.start, first.stop, first.points) == (5600, 160, 41)
    assert (gap.start, gap.stop) == (168, 5592)


def test_areas_that_meet_need_no_gap_between_them() -> None:
    table = table_of_arcs([(0, 1432), (1440, 5752)], 8)
    assert initialised(table) == (Sector(N, 1432), Sector(N, 5752))
    assert [span.points for span in spans(table, 8)] == [180, 540]


def test_arcs_that_need_more_sectors_than_there_are_do_not_fit() -> None:
    with pytest.raises(ValueError, match="10 sectors"):
        table_of_arcs([(start, start + 100) for start in range(0, 1000, 200)], 4)


@given(st.sampled_from(STEPS), st.lists(st.integers(0, 2879), min_size=1, max_size=8, unique=True), st.integers(0, 255))
def test_sectors_that_pass_the_check_tile_the_circle(step: int, marks: list[int], measuring: int) -> None:
    stops = sorted(mark * step % TICKS for mark in marks)
    functions = [N if measuring >> index & 1 else NONE for index in range(8)]
    table = table_of([Sector(function, stop) for function, stop in zip(functions, stops, strict=False)])
    if check(table, 5, step) in (MeasureError.OK, MeasureError.MEAN_PULSE):
        found = spans(table, step)
        directions = [(span.start + index * step) % TICKS for span in found for index in range(span.length // step + 1)]
        assert sorted(directions) == list(range(0, TICKS, step))
        assert found[0].offset == 0
        for before, after in pairwise(found):
            assert after.offset == before.offset + before.length + step
            assert after.start == (before.stop + step) % TICKS
        for span in found:
            assert span.points in (0, span.length // step + 1)


LARGEST_ARCS = [
    (5, 2, 270.0), (6, 3, 337.5), (7, 3, 289.3), (8, 4, 337.5), (9, 4, 300.0), (10, 4, 270.0), (11, 5, 306.8),
    (12, 5, 281.3), (13, 6, 311.5), (14, 6, 289.3), (15, 6, 270.0), (16, 8, 337.5), (17, 8, 317.6), (18, 8, 300.0),
    (19, 8, 284.2), (20, 8, 270.0),
]  # fmt: skip
"Speed, smallest step by the pulse limit, and the largest arc that the mean pulse rate leaves there."

SMALLEST_FULL = dict(zip(range(5, 21), [3, 4, 4, 5, 5, 6, 6, 8, 8, 8, 8, 9, 10, 10, 12, 12], strict=True))
"Smallest step for a full circle by speed."


@pytest.mark.parametrize(("hz", "step", "largest_deg"), LARGEST_ARCS)
def test_pulse_limits_are_those_of_the_table(hz: int, step: int, largest_deg: float) -> None:
    finer = STEPS[STEPS.index(step) - 1]
    if step > 2:
        assert check(circle(finer), hz, finer) is MeasureError.MAX_PULSE
    widest = int(10800 / 14400 * 360 * (14400 * step / (TICKS * hz)) * 16 + 1e-9) // step * step
    assert widest / 16 == pytest.approx(largest_deg, abs=step / 16)
    assert check(arc(widest, step), hz, step) is MeasureError.OK
    assert check(arc(widest + step, step), hz, step) is MeasureError.MEAN_PULSE


@pytest.mark.parametrize("hz", range(5, 21))
def test_the_finest_full_circle_is_that_of_the_table(hz: int) -> None:
    finest = SMALLEST_FULL[hz]
    assert check(circle(finest), hz, finest) is MeasureError.OK
    coarser = STEPS[STEPS.index(finest) - 1]
    assert check(circle(coarser), hz, coarser) in (MeasureError.MEAN_PULSE, MeasureError.MAX_PULSE)


@pytest.mark.parametrize(
    ("table", "why"),
    [
        (EMPTY, "no sector"),
        (table_of([Sector(NONE, 5752)]), "nothing to measure"),
        (table_of([Sector(N, 1600), Sector(NONE, 800), Sector(N, 3200)]), "stops run backwards"),
        (table_of([Sector(N, 1600), Sector(NONE, 1600)]), "two stops at one place"),
        (table_of([Sector(N, 1600), Sector(NONE, 1604)]), "a sector narrower than a step"),
        (table_of([Sector(N, 800 * (index + 1)) for index in range(5)]), "five measuring sectors"),
    ],
)
def test_borders_that_make_no_sense_are_error_3(table: Table, why: str) -> None:
    assert check(table, 10, 8) is MeasureError.BORDERS, why


@pytest.mark.parametrize(
    "table",
    [
        table_of([Sector(N, 1604), Sector(NONE, 5752)]),
        table_of([Sector(N, 1600), Sector(NONE, 5748)]),
        table_of([Sector(N, 5751)]),
    ],
)
def test_a_measuring_border_between_two_steps_is_error_4(table: Table) -> None:
    assert check(table, 10, 8) is MeasureError.NOT_MULTIPLE


def test_a_border_between_two_idle_sectors_may_lie_anywhere() -> None:
    table = table_of([Sector(N, 1600), Sector(NONE, 2003), Sector(NONE, 5752)])
    assert check(table, 10, 8) is MeasureError.OK


def test_a_sector_of_one_direction_is_measured() -> None:
    table = table_of([Sector(N, 8), Sector(NONE, 0)])
    assert check(table, 10, 8) is MeasureError.OK
    assert [(span.start, span.stop, span.points) for span in spans(table, 8)] == [(8, 8, 1), (16, 0, 0)]


def test_clearing_a_sector_clears_the_higher_ones() -> None:
    table = with_sector(with_sector(with_sector(EMPTY, 0, Sector(N, 8)), 1, Sector(NONE, 16)), 2, Sector(N, 24))
    assert with_sector(table, 1, Sector()) == table_of([Sector(N, 8)])
    assert initialised(with_sector(EMPTY, 3, Sector(N, 8))) == ()


def test_steps_are_divisors_of_the_revolution_above_one_tick() -> None:
    assert [step for step in range(65) if is_step(step)] == [
        2, 3, 4, 5, 6, 8, 9, 10, 12, 15, 16, 18, 20, 24, 30, 32, 36, 40, 45, 48, 60, 64,
    ]  # fmt: skip
