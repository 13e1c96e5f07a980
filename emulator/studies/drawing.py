"""How studies draw: one look for all figures, and a figure as PNG bytes.

Belongs here: sizes, colours, axes. Not: what is drawn. Matplotlib is imported when something is drawn.
"""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

import numpy as np

from emulator.output.sanitizing import visible
from emulator.physics.arrays import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#444444")
"Distinguished by colour-blind readers (Okabe and Ito)."
DPI = 130


def figure(columns: int = 1, rows: int = 1, size: tuple[float, float] = (9.0, 5.0)) -> tuple[Figure, list[Axes]]:
    """An empty figure and its axes, row by row."""
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    made = Figure(figsize=size, layout=ConstrainedLayoutEngine(h_pad=0.08))  # titles stay off the axis above
    grid = made.subplots(rows, columns, squeeze=False)
    for axes in grid.flat:
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(color="#e3e7eb", linewidth=0.8)
        axes.set_axisbelow(True)
    return made, list(grid.flat)


def png(made: Figure) -> bytes:
    """The figure as a PNG file; the same bytes for the same drawing."""
    tame(made)
    out = io.BytesIO()
    made.savefig(out, format="png", dpi=DPI, metadata={"Software": None})
    return out.getvalue()


def tame(made: Figure) -> None:
    """Names in a figure are letters: no formulas, which a `$` begins, no control characters; of ticks see `word`."""
    from matplotlib.text import Text

    ticks = set()
    for axes in made.axes:
        for axis in (axes.xaxis, axes.yaxis):
            ticks |= {*axis.get_ticklabels(which="both"), axis.get_offset_text()}  # powers of ten are formulas
    for text in made.findobj(Text):
        if isinstance(text, Text) and text not in ticks:
            text.set_text(visible(text.get_text(), "\n"))
            text.set_parse_math(False)


def word(name: str) -> str:
    """A name as the label of a tick."""
    return visible(name).replace("$", r"\$")


def curve(axes: Axes, x: Floats, y: Floats, number: int, label: str | None, **more: Any) -> None:
    """A closed form: a line."""
    axes.plot(x, y, color=COLOURS[number % len(COLOURS)], linewidth=1.7, label=label, **more)


def measured(axes: Axes, x: Floats, y: Floats, number: int, label: str | None = None, marker: str = "o") -> None:
    """What the whole path gives: open marks."""
    axes.plot(
        x, y, marker, color=COLOURS[number % len(COLOURS)], markerfacecolor="white", markersize=5.0,
        markeredgewidth=1.3, label=label, linestyle="none",
    )  # fmt: skip


def limit(axes: Axes, y: float, text: str) -> None:
    """A horizontal limit with its name at the left."""
    axes.axhline(y, color="#8c959f", linewidth=1.0, linestyle=(0, (4, 3)))
    axes.annotate(
        text, (0.01, y), xycoords=("axes fraction", "data"), xytext=(0, 3), textcoords="offset points",
        color="#57606a", fontsize=8.5,
    )  # fmt: skip


def right_labels(axes: Axes, texts: list[str], heights: list[float], top: float) -> None:
    """Names of horizontal lines beside the right edge, moved apart where lines lie close; the axis begins at 0."""
    gap, free = 0.04 * top, -1.0
    for height, text in sorted(zip(heights, texts, strict=True)):
        free = max(height, free + gap)
        axes.annotate(
            text, (1.0, height), xycoords=("axes fraction", "data"), xytext=(1.035, free),
            textcoords=("axes fraction", "data"), fontsize=8.5, va="center", color="#1b1f24",
            arrowprops={"arrowstyle": "-", "color": "#8c959f", "linewidth": 0.7, "relpos": (0.0, 0.5)},
        )  # fmt: skip


def bare(axes: Axes) -> None:
    """Axes for cells and bars: no frame, no grid."""
    axes.grid(visible=False)
    axes.spines[:].set_visible(False)
    axes.tick_params(length=0)


def spaced(low: float, high: float, count: int) -> Floats:
    """Values at equal ratios."""
    return np.geomspace(low, high, count)
