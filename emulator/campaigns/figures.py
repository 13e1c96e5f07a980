"""Pictures of a campaign: maps of pass and fail over two factors, curves with confidence bands, bars of sensitivity.

Belongs here: drawing. Not: what is reported beside them (page), numbers (table, sensitivity).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from emulator.campaigns.factors import Floats
from emulator.campaigns.searching import mean_interval, wilson
from emulator.campaigns.sensitivity import Index
from emulator.campaigns.table import Results, shown_value
from emulator.studies.drawing import COLOURS, bare, figure, png, word
from emulator.studies.report import Picture, Spot

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_LEVELS = 30
"Distinct values of a factor that are shown one by one; more are put together in bins."
BINS, PER_BIN = 12, 12
"At most so many bins, and at least so many cases in each."
MOST_MARKS = 20_000
MOST_SPOTS = 200
PASS, FAIL, BROKEN = COLOURS[0], COLOURS[1], "#8c959f"


def short(name: str) -> str:
    """The part of a key that says most: its end."""
    return name if len(name) <= 28 else "…" + name[-27:]


def distinct(results: Results, column: str) -> Floats:
    """Its values, each once."""
    values = results.factors[column]
    return np.unique(values[~np.isnan(values)])


def logarithmic(axis: Any) -> None:
    """A scale with ticks at 1, 2 and 5 of each decade, as plain numbers."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.axes.set(**{f"{axis.axis_name}scale": "log"})
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=12))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def verdict_map(results: Results, across: str, up: str, link: Callable[[int], str]) -> Picture:
    """Pass rate over two factors: cells where both have few levels, else a mark a case; each leads to a case."""
    made, (axes,) = figure(1, 1, (8.6, 5.6))
    levels = [distinct(results, one) for one in (across, up)]
    x, y = results.factors[across], results.factors[up]
    cells = all(len(one) <= MOST_LEVELS for one in levels)
    if cells:
        ix, iy = np.searchsorted(levels[0], x), np.searchsorted(levels[1], y)
        spots_at, chosen = _cells(made, axes, results, ix, iy, (len(levels[0]), len(levels[1])))
        for column, axis, known in ((across, axes.xaxis, levels[0]), (up, axes.yaxis, levels[1])):
            texts = [word(_level(results, column, value)) for value in known]
            axis.set_ticks(range(len(known)), texts)
        if max(len(_level(results, across, one)) for one in levels[0]) * len(levels[0]) > 70:
            axes.tick_params(axis="x", rotation=90)
    else:
        spots_at, chosen = _marks(axes, results, x, y)
        for column, side, known in ((across, "x", levels[0]), (up, "y", levels[1])):
            if column in results.levels:
                setter = axes.set_xticks if side == "x" else axes.set_yticks
                setter(range(len(known)), [word(_level(results, column, value)) for value in known])
            elif column in results.log:
                logarithmic(axes.xaxis if side == "x" else axes.yaxis)
    axes.set_xlabel(across)
    axes.set_ylabel(up)
    made.draw_without_rendering()
    image = png(made)
    spots = _spots(made, axes, spots_at, chosen, results, link)
    reported = "Share of passed cases in each cell, over all other factors" if cells else "Each mark is a case"
    return Picture(
        f"map-{_file(across)}-{_file(up)}", f"Pass and fail over {across} and {up}", image,
        f"{reported}. A click opens a case.", spots,
    )  # fmt: skip


def _level(results: Results, column: str, value: float) -> str:
    known = results.levels.get(column)
    text = known[int(value)] if known is not None else f"{value:.4g}"
    return text if len(text) <= 24 else text[:21] + "..."


def _file(name: str) -> str:
    return "".join(letter if letter.isascii() and letter.isalnum() else "-" for letter in name)[:60]


def _cells(
    made: Figure, axes: Axes, results: Results, ix: np.ndarray, iy: np.ndarray, shape: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    passed = results.passed
    flat = ix * shape[1] + iy
    known = ~np.isnan(passed)
    count = np.bincount(flat[known], minlength=shape[0] * shape[1])
    total = np.bincount(flat[known], weights=passed[known], minlength=shape[0] * shape[1])
    with np.errstate(invalid="ignore"):
        rate = (total / np.where(count, count, np.nan)).reshape(shape).T
    bare(axes)
    drawn = axes.imshow(rate, cmap="RdYlBu", vmin=0.0, vmax=1.0, aspect="auto", origin="lower")
    made.colorbar(drawn, ax=axes, label="share passed")
    if shape[0] * shape[1] <= 200:
        for row, column in np.ndindex(rate.shape):
            if not np.isnan(rate[row, column]):
                value = rate[row, column]
                colour = "white" if value < 0.12 or value > 0.88 else "#1b1f24"
                axes.text(column, row, f"{100 * value:.0f} %", ha="center", va="center", fontsize=8, color=colour)
    # of each cell the first case that did not pass, or the first
    order = np.lexsort((np.arange(len(flat)), passed == 1.0, flat))
    _, first = np.unique(flat[order], return_index=True)
    chosen = order[first]
    return np.column_stack([ix[chosen], iy[chosen]]).astype(float), chosen


def _marks(axes: Axes, results: Results, x: Floats, y: Floats) -> tuple[np.ndarray, np.ndarray]:
    passed = results.passed
    shown = np.arange(len(results))
    if len(shown) > MOST_MARKS:
        shown = shown[:: -(-len(shown) // MOST_MARKS)]
    small = 26.0 if len(shown) < 600 else 9.0 if len(shown) < 4000 else 3.0
    for colour, marker, name, mask in (
        (PASS, "o", "passed", passed[shown] == 1.0),
        (FAIL, "X", "failed", passed[shown] == 0.0),
        (BROKEN, "D", "did not end", np.isnan(passed[shown])),
    ):
        if mask.any():
            axes.scatter(x[shown[mask]], y[shown[mask]], s=small, c=colour, marker=marker, label=name, linewidths=0.3)
    axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0, frameon=False)
    order = shown[np.argsort(passed[shown] == 1.0, kind="stable")][:MOST_SPOTS]
    return np.column_stack([x[order], y[order]]), order


def _spots(
    made: Figure, axes: Axes, at: np.ndarray, chosen: np.ndarray, results: Results, link: Callable[[int], str]
) -> tuple[Spot, ...]:
    if not len(at):
        return ()
    places = axes.transData.transform(at) / (made.get_size_inches() * made.dpi)
    found = []
    for (left, bottom), case in list(zip(places.tolist(), chosen.tolist(), strict=True))[:MOST_SPOTS]:
        values = ", ".join(f"{one}={shown_value(results, one, case)}" for one in results.factors)
        found.append(Spot(left, 1.0 - bottom, link(case), f"{values}: {_verdict(results, case)}"))
    return tuple(found)


def _verdict(results: Results, case: int) -> str:
    value = results.passed[case]
    return "did not end" if np.isnan(value) else "passed" if value else "failed"


def curves(results: Results, of: str, columns: Sequence[str], confidence: float = 0.95) -> Picture:
    """The mean of a result over each factor, all others as they come, with its confidence band."""
    wide = min(len(columns), 3)
    rows = -(-len(columns) // wide)
    made, panels = figure(wide, rows, (4.2 * wide + 0.6, 3.3 * rows + 0.3))
    values = results.value(of)
    for panel, column in zip(panels, columns, strict=False):
        found = band(results.factors[column], values, of == "pass", confidence)
        where, mean, low, high = found
        if column in results.levels:
            panel.errorbar(where, mean, [mean - low, high - mean], fmt="o", color=COLOURS[0], capsize=3, markersize=5)
            panel.set_xticks(where, [word(_level(results, column, one)) for one in where], rotation=30, ha="right")
        else:
            panel.fill_between(where, low, high, color=COLOURS[0], alpha=0.2, linewidth=0)
            panel.plot(where, mean, "o-", color=COLOURS[0], linewidth=1.6, markersize=3.5)
            if column in results.log:
                logarithmic(panel.xaxis)
        panel.set_xlabel(short(column))
        panel.set_ylabel("share passed" if of == "pass" else short(of))
        if of == "pass":
            panel.set_ylim(-0.04, 1.04)
    for panel in panels[len(columns) :]:
        panel.set_visible(False)
    name = "share of passed cases" if of == "pass" else f"mean of {of}"
    kind = "Wilson" if of == "pass" else "Student"
    return Picture(
        f"curves-{_file(of)}", f"{name[:1].upper()}{name[1:]} over each factor", png(made),
        f"Line: {name} over all other factors. Band: {100 * confidence:g} % confidence ({kind}).",
    )  # fmt: skip


def band(x: Floats, values: Floats, is_share: bool, confidence: float) -> tuple[Floats, Floats, Floats, Floats]:
    """Places, means and bounds: at each level where there are few, else in bins of equal counts."""
    known = ~np.isnan(x) & ~np.isnan(values)
    x, values = x[known], values[known]
    levels = np.unique(x)
    if len(levels) <= MOST_LEVELS:
        parts = [(float(one), values[x == one]) for one in levels]
    else:
        order = np.argsort(x, kind="stable")
        bins = min(max(len(x) // PER_BIN, 3), BINS)
        parts = [(float(np.median(x[one])), values[one]) for one in np.array_split(order, bins) if len(one)]
    found = []
    for place, inside in parts:
        interval = wilson(int(inside.sum()), len(inside), confidence) if is_share else mean_interval(inside, confidence)
        low = interval.low if np.isfinite(interval.low) else interval.estimate
        high = interval.high if np.isfinite(interval.high) else interval.estimate
        found.append((place, interval.estimate, low, high))
    table = np.array(found, dtype=np.float64).reshape(-1, 4)
    return table[:, 0], table[:, 1], table[:, 2], table[:, 3]


def sensitivity(found: Sequence[Index], of: str) -> Picture:
    """First-order and total indices as bars."""
    total = not np.isnan(found[0].total)
    made, (axes,) = figure(1, 1, (8.2, 1.4 + 0.55 * len(found)))
    order = sorted(found, key=lambda one: one.total if total else one.first)
    at = np.arange(len(order), dtype=float)
    height = 0.38 if total else 0.6
    axes.barh(
        at + (height / 2 if total else 0), [one.first for one in order], height, color=COLOURS[0], label="first order",
        xerr=[one.first_error for one in order], error_kw={"linewidth": 1.0, "capsize": 2},
    )  # fmt: skip
    if total:
        axes.barh(
            at - height / 2, [one.total for one in order], height, color=COLOURS[4], label="total",
            xerr=[one.total_error for one in order], error_kw={"linewidth": 1.0, "capsize": 2},
        )  # fmt: skip
    axes.set_yticks(at, [word(short(one.factor)) for one in order])
    axes.set_xlabel("Sobol index: share of the variance")
    axes.axvline(0.0, color="#57606a", linewidth=0.8)
    axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0, frameon=False)
    name = "pass and fail" if of == "pass" else of
    return Picture(f"sensitivity-{_file(of)}", f"Sensitivity of {name}", png(made), "Bars: 95 % confidence.")
