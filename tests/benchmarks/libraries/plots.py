"""A scan as characters: points with ten levels of colour, equal scales on both axes, rings with their ranges."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from emulator.looking import plot
from emulator.looking.plot import LEVELS, Drawing, draw_scan, is_half, nice_range
from protocols.scan import Floats
from tests.benchmarks.libraries.measure import Row, added, failing, import_cost, lines, per_s, version_of

Levels = NDArray[np.int8] | None
Draw = Callable[[Floats, Floats, int, int, float | None, Levels], Drawing]
TESTS = ("tests/looking/test_plot.py",)
RAINBOW = (27, 33, 38, 43, 48, 82, 154, 220, 208, 196)
ESCAPE = re.compile(r"\x1b\[[0-9;]*m")


def _window(columns: int, rows: int, limit: float, half: bool) -> tuple[float, float, float]:
    """Half the width, lower and upper edge in metres, so that a metre is as long both ways."""
    low = 0.0 if half else -limit
    per_m = min(rows * 4 / (limit - low), columns * 2 / (2 * limit))
    middle = limit / 2 if half else 0.0
    return columns / per_m, middle - rows * 2 / per_m, middle + rows * 2 / per_m


def _parts(azimuth: Floats, ranges: Floats, limit: float, levels: Levels) -> list[tuple[Floats, Floats]]:
    """Left and ahead of the points of each level, then of two rings."""
    at = np.zeros(len(ranges), np.int8) if levels is None else levels
    seen = np.isfinite(ranges)
    points = [(azimuth[seen & (at == level)], ranges[seen & (at == level)]) for level in range(LEVELS)]
    ring = np.radians(np.arange(-90.0, 90.1, 6.0) if is_half(azimuth) else np.arange(0.0, 360.0, 6.0))
    points += [(ring, np.full(ring.shape, share * limit)) for share in (0.5, 1.0)]
    return [(-r * np.sin(a), r * np.cos(a)) for a, r in points if len(r)]


def _limit(ranges: Floats, max_range_m: float | None) -> float:
    seen = ranges[np.isfinite(ranges)]
    return max_range_m or nice_range(float(np.max(seen)) if len(seen) else 10.0)


def by_uniplot(
    azimuth: Floats, ranges: Floats, columns: int = 80, rows: int = 22, max_range_m: float | None = None,
    levels: Levels = None,
) -> Drawing:  # fmt: skip
    import uniplot

    columns, rows = max(columns, 16), max(rows, 6)
    limit = _limit(ranges, max_range_m)
    side, low, high = _window(columns, rows, limit, is_half(azimuth))
    parts = _parts(azimuth, ranges, limit, levels)
    text = uniplot.plot_to_string(
        xs=[x for x, _ in parts], ys=[y for _, y in parts], width=columns, height=rows, character_set="braille",
        x_min=-side, x_max=side, y_min=low, y_max=high, x_gridlines=[], y_gridlines=[], lines=False,
        color=["blue", "cyan", "green", "yellow", "red"] * 3,
    )  # fmt: skip
    body = [ESCAPE.sub("", line)[1 : columns + 1] for line in text.splitlines()[1 : rows + 1]]
    return Drawing(body, np.zeros((rows, columns), np.int8))


def by_plotext(
    azimuth: Floats, ranges: Floats, columns: int = 80, rows: int = 22, max_range_m: float | None = None,
    levels: Levels = None,
) -> Drawing:  # fmt: skip
    import plotext

    columns, rows = max(columns, 16), max(rows, 6)
    limit = _limit(ranges, max_range_m)
    side, low, high = _window(columns, rows, limit, is_half(azimuth))
    figure = plotext.figure
    figure.clear()
    figure.plot_size(columns, rows)
    figure.axes(False)
    for axis, edges in (("x", (-side, side)), ("y", (low, high))):
        figure.ruler(axis).lim(*edges)
        figure.ruler(axis).frequency(0)
    for level, (x, y) in enumerate(_parts(azimuth, ranges, limit, levels)):
        marker = plotext.marker("braille", RAINBOW[level % LEVELS])
        figure.draw(figure.signal(x.tolist(), y.tolist(), marker=marker))
    for x, y, text in ((0.0, 0.0, "▲"), (0.0, limit, f"{limit:g} m"), (0.0, limit / 2, f"{limit / 2:g} m")):
        figure.draw(figure.text(x, y, text))
    body = ESCAPE.sub("", str(figure.build())).splitlines()[:rows]
    return Drawing(body, np.zeros((rows, columns), np.int8))


LIBRARIES: dict[str, tuple[str, str, Draw]] = {
    "uniplot": ("uniplot", "uniplot", by_uniplot),
    "plotext": ("plotext", "plotext", by_plotext),
}
"Of asciichartpy and rich: the one draws a series over its index alone, the other nothing of dots."


def put_in(name: str) -> None:
    """Draw with a library instead of ourselves."""
    plot.draw_scan = LIBRARIES[name][2]


def _frame(draw: Draw) -> str:
    azimuth = np.radians(np.arange(0.0, 360.0, 0.25))
    ranges = 8.0 + np.sin(5.0 * azimuth)
    levels = (np.arange(len(azimuth)) % LEVELS).astype(np.int8)
    try:
        return f"{1e3 / per_s(lambda: draw(azimuth, ranges, 120, 40, 10.0, levels)):.1f} ms"
    except Exception as error:
        return f"cannot ({type(error).__name__}: {error})"


OURS = (
    plot.draw_scan,
    plot._Canvas.__init__,
    plot._Canvas.rings,
    plot._Canvas.dots,
    plot._Canvas.done,
    plot._Canvas._write,
)
"What of ours a library would replace; outlines, names and levels stay."


def rows(tests: bool = False) -> list[Row]:
    """Ours, then every library: a frame of 1440 points of ten levels on 120 by 40 characters."""
    found = [Row("ours", {"lines to replace": str(lines(*OURS)), "a frame": _frame(draw_scan)})]
    for name, (distribution, module, draw) in LIBRARIES.items():
        version = version_of(distribution)
        if version is None:
            found.append(Row(name))
            continue
        cost = {"install": added(distribution), "import": import_cost(module, "import emulator.looking.look")}
        cost |= {"lines of glue": str(lines(draw, _window, _parts, _limit)), "a frame": _frame(draw)}
        if tests:
            cost["our tests that fail with it"] = failing(TESTS, f"plots:{name}")
        found.append(Row(f"{name} {version}", cost))
    return found
