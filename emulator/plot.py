"""A scan drawn with characters: two by four dots a character, x forward upwards, y to the left.

Only text comes out; colours and screens belong to whoever shows it.
"""

from __future__ import annotations

import math

import numpy as np

from protocols.scan import Floats

DOTS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]], dtype=np.uint32)
"Unicode's braille patterns: bit of the dot in row i, column j of a character."

BLANK = 0x2800
RINGS = (1.0, 2.0, 5.0)


def nice_range(limit_m: float) -> float:
    """Smallest 1, 2 or 5 times a power of ten that is not below `limit_m`."""
    if not math.isfinite(limit_m) or limit_m <= 0.0:
        return 10.0
    decade = 10.0 ** math.floor(math.log10(limit_m))
    for factor in (*RINGS, 10.0):
        if factor * decade >= limit_m * (1.0 - 1e-12):
            return factor * decade
    return 10.0 * decade


def polar(
    azimuth_rad: Floats, range_m: Floats, columns: int = 80, rows: int = 22, max_range_m: float | None = None
) -> list[str]:
    """Draw one scan; `rows` lines of `columns` characters.

    Parameters
    ----------
    azimuth_rad, range_m : (n,)
        NaN ranges are left out. [rad], [m]
    max_range_m : > 0 or None
        Range at the edge of the picture; None: a round number beyond the farthest point.

    Notes
    -----
    A scan within 90 degrees of straight ahead is drawn as a half plane with the sensor at the bottom, any other with
    the sensor in the middle. Rings are at half and full range.
    """
    columns, rows = max(columns, 16), max(rows, 6)
    seen = np.isfinite(range_m)
    half = bool(np.all(np.abs(azimuth_rad) <= math.radians(91.0)))
    limit = max_range_m or nice_range(float(np.max(range_m[seen])) if seen.any() else 10.0)
    height, width = rows * 4, columns * 2
    scale = min((height - 2) / (limit if half else 2.0 * limit), (width - 2) / (2.0 * limit))
    row0, column0 = (height - 2) if half else height // 2, width // 2

    cells = np.zeros((rows, columns), dtype=np.uint32)
    ring = np.radians(np.arange(-90.0, 90.1, 6.0) if half else np.arange(0.0, 360.0, 6.0))
    for share in (0.5, 1.0):
        _mark(cells, row0, column0, scale, ring, np.full(ring.shape, share * limit))
    _mark(cells, row0, column0, scale, azimuth_rad[seen], range_m[seen])
    picture = [[chr(BLANK + int(code)) for code in line] for line in cells]
    _write(picture, row0 // 4, column0 // 2, "▲")
    _label(picture, row0, column0, scale, 0.5 * limit)
    _label(picture, row0, column0, scale, limit)
    return ["".join(line) for line in picture]


def _mark(cells: np.ndarray, row0: int, column0: int, scale: float, azimuth_rad: Floats, range_m: Floats) -> None:
    row = np.rint(row0 - scale * range_m * np.cos(azimuth_rad)).astype(int)
    column = np.rint(column0 - scale * range_m * np.sin(azimuth_rad)).astype(int)
    inside = (row >= 0) & (row < cells.shape[0] * 4) & (column >= 0) & (column < cells.shape[1] * 2)
    row, column = row[inside], column[inside]
    np.bitwise_or.at(cells, (row // 4, column // 2), DOTS[row % 4, column % 2])


def _label(picture: list[list[str]], row0: int, column0: int, scale: float, range_m: float) -> None:
    row = max(0, int(row0 - scale * range_m) // 4)
    _write(picture, row, column0 // 2 + 1, f"{range_m:g} m")


def _write(picture: list[list[str]], row: int, column: int, text: str) -> None:
    for offset, character in enumerate(text):
        if 0 <= row < len(picture) and 0 <= column + offset < len(picture[0]):
            picture[row][column + offset] = character
