"""The picture of a scan: where points land, and that nothing breaks it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from emulator.looking.plot import BLANK, nice_range, polar


def dots(lines: list[str]) -> set[tuple[int, int]]:
    """Characters that hold a dot, as (row, column)."""
    return {(r, c) for r, line in enumerate(lines) for c, sign in enumerate(line) if BLANK < ord(sign) <= BLANK + 255}


def test_a_point_ahead_is_drawn_above_the_sensor_and_one_to_the_left_is_drawn_left() -> None:
    empty = dots(polar(np.array([0.0]), np.array([np.nan]), 40, 10, 10.0))
    ahead = dots(polar(np.array([0.0]), np.array([7.5]), 40, 10, 10.0)) - empty
    left = dots(polar(np.array([math.radians(80.0)]), np.array([7.5]), 40, 10, 10.0)) - empty
    assert {column for _, column in ahead} == {20}
    assert all(column < 12 for _, column in left)
    assert min(row for row, _ in ahead) < min(row for row, _ in left)


@pytest.mark.parametrize(("columns", "rows"), [(80, 22), (16, 6), (1, 1), (200, 60)])
def test_the_picture_has_the_size_asked_for(columns: int, rows: int) -> None:
    lines = polar(np.radians(np.arange(360.0)), np.full(360, 12.0), columns, rows)
    assert len(lines) == max(rows, 6)
    assert {len(line) for line in lines} == {max(columns, 16)}


def test_a_scan_without_an_echo_is_still_drawn() -> None:
    lines = polar(np.radians(np.arange(-90.0, 91.0)), np.full(181, np.nan), 80, 22)
    assert "▲" in "".join(lines)


@pytest.mark.parametrize(
    ("limit_m", "edge_m"),
    [(9.9, 10.0), (10.0, 10.0), (10.1, 20.0), (0.3, 0.5), (81.0, 100.0), (0.0, 10.0), (math.inf, 10.0)],
)
def test_the_edge_is_a_round_number_beyond_the_farthest_point(limit_m: float, edge_m: float) -> None:
    assert nice_range(limit_m) == pytest.approx(edge_m)
