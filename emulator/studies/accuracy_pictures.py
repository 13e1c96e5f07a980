"""Pictures of the study `accuracy`: errors over rays, time and settings, all axes logarithmic.

Belongs here: which curve goes where. Not: numbers.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from emulator.physics.arrays import Floats
from emulator.studies import drawing
from emulator.studies.accuracy_acceptance import DEFAULT, Curves
from emulator.studies.accuracy_path import Run
from emulator.studies.accuracy_rules import TITLES
from emulator.studies.report import Picture, Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ORDER = (
    "spiral", "adaptive", "gauss_legendre", "sobol", "halton", "grid", "rings", "laguerre", "hermite", "monte_carlo",
)  # fmt: skip
MARKERS = "oDs^v<>PXp"
FLOOR = 1e-16
MOST_PERCENT = 150.0
"Where bars of costs end."


def _line(axes: Axes, rule: str, x: Floats, y: Floats, low: Floats | None = None, high: Floats | None = None) -> None:
    number = ORDER.index(rule)
    colour = drawing.COLOURS[number % len(drawing.COLOURS)]
    first = number == 0
    axes.plot(
        x, np.maximum(y, FLOOR), color=colour, linestyle="-" if number < len(drawing.COLOURS) else "--",
        linewidth=2.4 if first else 1.3, marker=MARKERS[number], markersize=5.5 if first else 4.0,
        label=TITLES[rule], zorder=5 if first else 3,
    )  # fmt: skip
    if low is not None and high is not None and rule in ("spiral", "adaptive", "monte_carlo"):
        axes.fill_between(x, np.maximum(low, FLOOR), np.maximum(high, FLOOR), color=colour, alpha=0.14, linewidth=0)


def _legend(made: Figure, axes: Axes, columns: int = 5) -> None:
    handles, labels = axes.get_legend_handles_labels()
    made.legend(handles, labels, loc="outside lower center", ncols=columns, frameon=False, fontsize=9)


def by_rays(curves: Curves) -> Picture:
    """Bare numpy: four targets."""
    made, panels = drawing.figure(2, 2, size=(12.0, 9.2))
    titles = {
        "edge": "edge: error of the share",
        "wire": "wire, a tenth of the radius: relative error",
        "plane": "plane at 80 degrees: relative error of the energy",
        "composed": "wire, edge and tilted wall: relative error of the energy",
    }
    for axes, (target, title) in zip(panels, titles.items(), strict=True):
        for rule in ORDER:
            curve = curves[target].get(rule)
            if curve is None:
                continue
            rays = np.array([one for one, _ in curve])
            errors = np.array([found for _, found in curve])
            _line(axes, rule, rays, np.median(errors, axis=1), errors.min(axis=1), errors.max(axis=1))
        axes.set(xscale="log", yscale="log", xlabel="rays per beam", title=title)
        _plain(axes, RAYS)
    _legend(made, panels[0])
    return Picture(
        "accuracy_rays", "Error against rays, by rule", drawing.png(made),
        "Median of ten repeats, band from the least to the largest for spiral, adaptive and Monte Carlo. Root mean "
        "square over random targets.",
    )  # fmt: skip


def _plain(axes: Axes, ticks: tuple[float, ...]) -> None:
    """Ticks of the x axis where they are reported, as plain numbers."""
    low, high = axes.get_xlim()
    shown = [tick for tick in ticks if low <= tick <= high]
    axes.set_xticks(shown, [f"{tick:g}" for tick in shown])
    axes.set_xticks([], minor=True)


RAYS = (16.0, 64.0, 256.0, 1024.0, 4096.0, 16384.0)
MICROSECONDS = (5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0, 5000.0)


def _energy(one: Run) -> Floats:
    return np.array([errors.energy for errors in one.errors])


def _times(of: list[Run]) -> Floats:
    return np.array([1e6 * np.median(one.seconds) for one in of])


def default(runs: dict[str, list[Run]]) -> Picture:
    """The one for the README: energy over rays and over time, the default marked."""
    made, (left, right) = drawing.figure(2, size=(11.0, 4.9))
    for rule in ORDER:
        of = runs[rule]
        energy = np.array([_energy(one) for one in of])
        low, middle, high = energy.min(axis=1), np.median(energy, axis=1), energy.max(axis=1)
        _line(left, rule, np.array([one.rays for one in of]), middle, low, high)
        _line(right, rule, _times(of), middle, low, high)
    one = next(run for run in runs["spiral"] if run.count == DEFAULT)
    for axes, x in ((left, one.rays), (right, 1e6 * float(np.median(one.seconds)))):
        axes.plot(
            [x], [np.median(_energy(one))], "o", markersize=13, markerfacecolor="none", markeredgecolor="black",
            markeredgewidth=1.6, zorder=6,
        )  # fmt: skip
        axes.annotate(
            f"default: spiral, {DEFAULT}", (x, float(np.median(_energy(one)))), xytext=(-4, -62),
            textcoords="offset points", fontsize=9, ha="center", arrowprops={"arrowstyle": "-", "linewidth": 0.8},
        )  # fmt: skip
        axes.set(xscale="log", yscale="log")
    _plain(left, RAYS)
    _plain(right, MICROSECONDS)
    left.set(xlabel="rays per beam", ylabel="error of an echo at a random edge\n(share of the beam's power, RMS)")
    right.set(xlabel="time per beam (us), one core")
    _legend(made, left)
    return Picture(
        "accuracy_time", "Error of an echo against rays and time", drawing.png(made),
        "Through the product: scenario, meshes, embreex, receiver. Ten repeats: median; band from least to largest.",
    )  # fmt: skip


def quantities(runs: dict[str, list[Run]]) -> Picture:
    """Range, detection and waveform over time and over rays."""
    names = {"range_m": "range (m)", "detection": "probability of detection", "waveform": "waveform, of its peak"}
    made, panels = drawing.figure(3, 2, size=(13.0, 8.6))
    for column, (name, title) in enumerate(names.items()):
        for row in (0, 1):
            axes = panels[3 * row + column]
            for rule in ORDER:
                of = runs[rule]
                found = np.array([np.median([getattr(e, name) for e in one.errors]) for one in of])
                _line(axes, rule, np.array([one.rays for one in of]) if row == 0 else _times(of), found)
            axes.set(xscale="log", yscale="log", xlabel="rays per beam" if row == 0 else "time per beam (us)")
            _plain(axes, RAYS if row == 0 else MICROSECONDS)
            if row == 0:
                axes.set_title(title)
            if column == 0:
                axes.set_ylabel("error (RMS)")
    _legend(made, panels[0])
    return Picture(
        "accuracy_quantities", "Range, detection and waveform", drawing.png(made),
        "Random edges through the product; medians of ten repeats.",
    )  # fmt: skip


def efficiency(runs: dict[str, list[Run]]) -> Picture:
    """One over error squared times time."""
    made, (axes,) = drawing.figure(size=(8.5, 5.2))
    for rule in ORDER:
        of = runs[rule]
        value = np.array([1.0 / (np.median(_energy(one)) ** 2 * np.median(one.seconds)) for one in of])
        _line(axes, rule, np.array([one.rays for one in of]), value)
    axes.set(xscale="log", yscale="log", xlabel="rays per beam", ylabel="1 / (error² time)  (1/s)")
    _plain(axes, RAYS)
    _legend(made, axes, 4)
    return Picture(
        "accuracy_efficiency", "Efficiency", drawing.png(made),
        "Level for Monte Carlo, whose error falls with the square root of the work; a rule that rises gains with every "
        "ray.",
    )  # fmt: skip


def settings(bins: Table, fog: Table, instants: Table, points: Table) -> Picture:
    """Bin width, fog nodes, instants of a sweep, points."""
    made, (left, right, low_left, low_right) = drawing.figure(2, 2, size=(11.0, 8.2))
    width = np.array(bins.numbers("bin_ns"))
    for number, (key, label) in enumerate(
        (
            ("samples_edge_mm", "edge, linear between samples"),
            ("product_peak_mm", "product: peak (parabola)"),
            ("product_centroid_mm", "product: centroid"),
        )
    ):
        left.plot(width, bins.numbers(key), marker="o", color=drawing.COLOURS[number], label=label)
    left.set(xscale="log", yscale="log", xlabel="bin (ns)", ylabel="largest range error (mm)", title="Bin width")
    _plain(left, (0.25, 0.5, 1.0, 2.0, 4.0, 8.0))
    left.legend(frameon=False, fontsize=9)
    for number, visibility in enumerate((20, 40, 200)):
        right.plot(
            fog.numbers("nodes"), fog.numbers(f"error_{visibility}_m"), marker="o", color=drawing.COLOURS[number],
            label=f"visibility {visibility} m",
        )  # fmt: skip
    right.set(yscale="log", xlabel="nodes", ylabel="relative error", title="Fog integral")
    right.legend(frameon=False, fontsize=9)
    some = [row for row in instants.rows if float(row[1] or 0.0) > 0.0]
    low_left.plot([float(r[0] or 0) for r in some], [float(r[1] or 0) for r in some], marker="o",
                  color=drawing.COLOURS[0], label="found")  # fmt: skip
    low_left.plot([float(r[0] or 0) for r in some], [float(r[2] or 0) for r in some], "--",
                  color="#8c959f", label="speed times interval")  # fmt: skip
    low_left.set(xscale="log", yscale="log", xlabel="instants of a sweep", ylabel="range error (m)",
                 title="Wall leaving at 30 m/s")  # fmt: skip
    _plain(low_left, (1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0))
    low_left.legend(frameon=False, fontsize=9)
    for rule in ("spiral", "grid", "laguerre"):
        mine = [row for row in points.rows if row[0] == rule]
        _line(low_right, rule, np.array([float(r[1] or 0) for r in mine]), np.array([float(r[2] or 0) for r in mine]))
    low_right.set(xscale="log", yscale="log", xlabel="sub-beams", ylabel="points off the closed form (worst)",
                  title="Mean points on a plate of 1.75 m")  # fmt: skip
    _plain(low_right, (8.0, 16.0, 32.0, 61.0, 128.0, 256.0, 512.0))
    low_right.legend(frameon=False, fontsize=9)
    return Picture(
        "accuracy_settings", "Other settings", drawing.png(made),
        "The product finds leading edges of overlapping pulses in closed form: no bin error, so no curve.",
    )  # fmt: skip


def leaving_out(each: Table) -> Picture:
    """Share of rays and time that each rule leaves, a group of bars a rule, a colour a sensor."""
    sensors = list(dict.fromkeys(row[:3] for row in each.rows))
    rules = [str(row[3]) for row in each.rows if row[:3] == sensors[0]][1:]
    made, panels = drawing.figure(2, size=(12.0, 0.16 * len(rules) * (1 + len(sensors)) + 1.4))
    height = 0.8 / len(sensors)
    for axes, key, title in zip(panels, ("rays_percent", "time_percent"), ("rays", "time"), strict=True):
        values = each.numbers(key)
        for number, sensor in enumerate(sensors):
            mine = [value for value, row in zip(values, each.rows, strict=True) if row[:3] == sensor][1:]
            place = np.arange(len(rules)) + (number - 0.5 * (len(sensors) - 1)) * height
            shown = np.minimum(mine, MOST_PERCENT)
            colour = drawing.COLOURS[number % len(drawing.COLOURS)]
            axes.barh(place, shown, height, color=colour, label=f"{sensor[0]}: {sensor[1]}")
            for at, value in zip(place, mine, strict=True):
                if value > MOST_PERCENT:
                    axes.annotate(f"{value:.0f} %", (MOST_PERCENT, at), xytext=(-3, 0), textcoords="offset points",
                                  ha="right", va="center", fontsize=7, color="white")  # fmt: skip
        axes.axvline(100.0, color="#57606a", linewidth=1.0)
        axes.set_yticks(range(len(rules)), rules if key == "rays_percent" else [""] * len(rules))
        axes.set(xlim=(0.0, MOST_PERCENT), xlabel=f"{title}, % of what they are with every rule off")
        axes.invert_yaxis()
    _legend(made, panels[0], 4)
    return Picture(
        "accuracy_leaving", "What each rule of leaving out saves", drawing.png(made),
        f"Shorter is better; the line is every rule off. Bars end at {MOST_PERCENT:.0f} %.",
    )  # fmt: skip
