"""A scan or a list of objects drawn with characters: two by four dots a character, x forward upwards, y to the left.

Text and a level for each character come out; colours and screens belong to whoever shows it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from protocols.scan import Floats

DOTS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]], dtype=np.uint32)
"Unicode's braille patterns: bit of the dot in row i, column j of a character."

BLANK = 0x2800
RINGS = (1.0, 2.0, 5.0)
LEVELS = 10
"Steps of a point's level, from 0."
NOTHING, FRAME, LABEL = -2, -1, LEVELS
"Levels of a character without a dot, of rings and their ranges, of names."
EDGE_DOTS = 24
"Points along each side of a box."


@dataclass(frozen=True, eq=False)
class Drawing:
    """Characters, and a level for each."""

    lines: list[str]
    levels: NDArray[np.int8]
    "(rows, columns)"


@dataclass(frozen=True)
class Box:
    """An object to be drawn: its outline where the size is known, and its name beside it."""

    name: str
    x_m: float
    y_m: float
    length_m: float = 0.0
    width_m: float = 0.0
    yaw_rad: float = 0.0
    level: int = LEVELS - 1


def nice_range(limit_m: float) -> float:
    """Smallest 1, 2 or 5 times a power of ten that is not below `limit_m`."""
    if not math.isfinite(limit_m) or limit_m <= 0.0:
        return 10.0
    decade = 10.0 ** math.floor(math.log10(limit_m))
    for factor in (*RINGS, 10.0):
        if factor * decade >= limit_m * (1.0 - 1e-12):
            return factor * decade
    return 10.0 * decade


def next_range(limit_m: float, up: bool) -> float:
    """The nice range above or below one that is nice itself, 0.5 m to 500 m."""
    found = nice_range(limit_m * 1.01) if up else nice_range(limit_m / 2.6)
    return min(max(found, 0.5), 500.0)


def levels_of(values: Floats, low: float, high: float) -> NDArray[np.int8]:
    """Levels 0 to LEVELS - 1 of values, (n,), evenly from `low` to `high`; NaN has the lowest."""
    span = high - low
    share = np.nan_to_num((np.asarray(values, dtype=np.float64) - low) / span if span > 0.0 else 0.0 * values)
    return np.clip((share * LEVELS).astype(np.int64), 0, LEVELS - 1).astype(np.int8)


def is_half(azimuth_rad: Floats) -> bool:
    """Whether all directions are within 90 degrees of straight ahead."""
    return bool(np.all(np.abs(azimuth_rad) <= math.radians(91.0)))


def polar(
    azimuth_rad: Floats, range_m: Floats, columns: int = 80, rows: int = 22, max_range_m: float | None = None
) -> list[str]:
    """Draw one scan; `rows` lines of `columns` characters. As `draw_scan`, without levels."""
    return draw_scan(azimuth_rad, range_m, columns, rows, max_range_m).lines


def draw_scan(
    azimuth_rad: Floats,
    range_m: Floats,
    columns: int = 80,
    rows: int = 22,
    max_range_m: float | None = None,
    levels: NDArray[np.int8] | None = None,
) -> Drawing:
    """Draw one scan.

    Parameters
    ----------
    azimuth_rad, range_m : (n,)
        NaN ranges are left out. [rad], [m]
    max_range_m : > 0 or None
        Range at the edge of the picture; None: a round number beyond the farthest point.
    levels : (n,) or None
        Of each point; a character has the highest of its points.

    Notes
    -----
    A scan within 90 degrees of straight ahead is drawn as a half plane with the sensor at the bottom, any other with
    the sensor in the middle. Rings are at half and full range.
    """
    seen = np.isfinite(range_m)
    limit = max_range_m or nice_range(float(np.max(range_m[seen])) if seen.any() else 10.0)
    canvas = _Canvas(columns, rows, limit, is_half(azimuth_rad))
    canvas.rings()
    at = np.zeros(len(range_m), np.int8) if levels is None else levels
    canvas.dots(range_m[seen] * np.cos(azimuth_rad[seen]), range_m[seen] * np.sin(azimuth_rad[seen]), at[seen])
    return canvas.done()


def draw_boxes(boxes: Sequence[Box], columns: int, rows: int, max_range_m: float, half: bool) -> Drawing:
    """Draw objects from above: outlines and names. Of a half plane all of the height is used, and the sides are cut."""
    canvas = _Canvas(columns, rows, max_range_m, half, half)
    canvas.rings()
    for box in boxes:
        x, y = _outline(box)
        canvas.dots(x, y, np.full(x.shape, box.level, np.int8))
    for box in sorted(boxes, key=lambda box: -math.hypot(box.x_m, box.y_m)):  # the nearest name is written last
        canvas.name(box)
    return canvas.done()


def _outline(box: Box) -> tuple[Floats, Floats]:
    """Points along a box's sides; a point alone for an object without a size."""
    along, across = 0.5 * box.length_m, 0.5 * box.width_m
    corners = np.array([(along, across), (-along, across), (-along, -across), (along, -across), (along, across)])
    share = np.linspace(0.0, 1.0, EDGE_DOTS)[:, None]
    path = np.concatenate([a + share * (b - a) for a, b in pairwise(corners)])
    c, s = math.cos(box.yaw_rad), math.sin(box.yaw_rad)
    return box.x_m + c * path[:, 0] - s * path[:, 1], box.y_m + s * path[:, 0] + c * path[:, 1]


class _Canvas:
    """Dots, names and levels of one drawing."""

    def __init__(self, columns: int, rows: int, limit_m: float, half: bool, tall: bool = False) -> None:
        columns, rows = max(columns, 16), max(rows, 6)
        self._cells = np.zeros((rows, columns), dtype=np.uint32)
        self._levels = np.full((rows, columns), NOTHING, dtype=np.int8)
        self._written: dict[tuple[int, int], str] = {}
        self._limit, self._half = limit_m, half
        height, width = rows * 4, columns * 2
        by_height = (height - 2) / (limit_m if half else 2.0 * limit_m)
        self._scale = by_height if tall else min(by_height, (width - 2) / (2.0 * limit_m))
        self._row0, self._column0 = (height - 2) if half else height // 2, width // 2

    def rings(self) -> None:
        """At half and full range, with the ranges; and the sensor."""
        ring = np.radians(np.arange(-90.0, 90.1, 6.0) if self._half else np.arange(0.0, 360.0, 6.0))
        for share in (0.5, 1.0):
            radius = share * self._limit
            frame = np.full(ring.shape, FRAME, np.int8)
            self.dots(radius * np.cos(ring), radius * np.sin(ring), frame)
            row = max(0, int(self._row0 - self._scale * radius) // 4)
            self._write(row, self._column0 // 2 + 1, f"{radius:g} m", FRAME)
        self._write(self._row0 // 4, self._column0 // 2, "▲", LABEL)

    def dots(self, x_m: Floats, y_m: Floats, levels: NDArray[np.int8]) -> None:
        """Points, (n,) each; what lies outside is left out."""
        row = np.rint(self._row0 - self._scale * x_m).astype(int)
        column = np.rint(self._column0 - self._scale * y_m).astype(int)
        rows, columns = self._cells.shape
        inside = (row >= 0) & (row < rows * 4) & (column >= 0) & (column < columns * 2)
        row, column = row[inside], column[inside]
        np.bitwise_or.at(self._cells, (row // 4, column // 2), DOTS[row % 4, column % 2])
        np.maximum.at(self._levels, (row // 4, column // 2), levels[inside])

    def name(self, box: Box) -> None:
        """Write a box's name beside its middle."""
        row = round(self._row0 - self._scale * box.x_m) // 4
        half = 0.5 * self._scale * (abs(box.width_m) if abs(math.cos(box.yaw_rad)) > 0.7 else abs(box.length_m))
        column = round(self._column0 - self._scale * box.y_m + half) // 2 + 1
        self._write(row, column, box.name, LABEL)

    def done(self) -> Drawing:
        """What has been drawn."""
        picture = [[chr(BLANK + int(code)) for code in line] for line in self._cells]
        for (row, column), character in self._written.items():
            picture[row][column] = character
        return Drawing(["".join(line) for line in picture], self._levels)

    def _write(self, row: int, column: int, text: str, level: int) -> None:
        for offset, character in enumerate(text):
            if 0 <= row < self._cells.shape[0] and 0 <= column + offset < self._cells.shape[1]:
                self._written[row, column + offset] = character
                self._levels[row, column + offset] = level
