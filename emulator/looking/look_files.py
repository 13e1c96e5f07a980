"""What `lidaremu look` leaves behind: rows of a CSV file, lines of JSON, a picture.

Belongs here: the forms and their columns. Not: where scans come from (hosts), the terminal (screen).
"""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from emulator.errors import EmulatorError
from emulator.hosts.scans import HostObjects, HostScan, Seen
from emulator.looking.plot import is_half, nice_range
from emulator.output.csv_tables import Cell, Writer
from protocols.scan import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SCAN_COLUMNS = {"scan": "", "azimuth_deg": ".4f", "range_m": ".4f", "intensity": "g", "time_s": ".6f"}
OBJECT_COLUMNS = {
    "list": "", "id": "", "x_m": ".3f", "y_m": ".3f", "vx_m_s": ".3f", "vy_m_s": ".3f", "length_m": ".3f",
    "width_m": ".3f", "yaw_deg": ".2f", "class": "", "existence": "g", "time_s": ".6f",
}  # fmt: skip
"Heads, and formats of their numbers."


class Table:
    """A CSV file: one row a beam, or one row an object; empty fields for what the device does not tell."""

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            self._file = path.open("w", newline="", encoding="utf-8")
        except OSError as error:
            raise EmulatorError(f"{path}: cannot be written: {error.strerror}") from None
        self._writer: Writer | None = None

    def add(self, seen: Seen, time_s: float) -> None:
        """Append a scan or a list that came `time_s` after the first."""
        try:
            if self._writer is None:
                self._writer = Writer(self._file, OBJECT_COLUMNS if isinstance(seen, HostObjects) else SCAN_COLUMNS)
            self._writer.rows(_object_rows(seen, time_s) if isinstance(seen, HostObjects) else _rows(seen, time_s))
        except OSError as error:
            raise EmulatorError(f"{self._path}: cannot be written: {error.strerror}") from None

    def close(self) -> None:
        """Finish the file."""
        self._file.close()


def _rows(scan: HostScan, time_s: float) -> list[tuple[Cell, ...]]:
    degrees = np.degrees(scan.azimuth_rad).tolist()
    peaks = [math.nan] * len(degrees) if scan.intensity is None else scan.intensity.tolist()
    return [
        (scan.number, angle, metres, peak, time_s)
        for angle, metres, peak in zip(degrees, scan.range_m.tolist(), peaks, strict=True)
    ]


def _object_rows(found: HostObjects, time_s: float) -> list[tuple[Cell, ...]]:
    return [
        (
            found.number, one.number, one.x_m, one.y_m, one.vx_m_s, one.vy_m_s, one.length_m, one.width_m,
            None if one.yaw_rad is None else math.degrees(one.yaw_rad), one.category, one.existence, time_s,
        )
        for one in found.objects
    ]  # fmt: skip


def as_json(seen: Seen, time_s: float, errors: int) -> dict[str, Any]:
    """A scan or a list as one JSON object; null for what the device does not tell."""
    head = {"number": seen.number, "time_s": round(time_s, 6), "errors": errors, "detail": seen.detail}
    if isinstance(seen, HostObjects):
        return {"event": "objects", **head, "objects": [_object_json(asdict(one)) for one in seen.objects]}
    columns: dict[str, Any] = {
        "azimuth_deg": np.round(np.degrees(seen.azimuth_rad), 4).tolist(),
        "range_m": _numbers(seen.range_m),
    }
    if seen.intensity is not None:
        columns["intensity"] = _numbers(seen.intensity)
    return {"event": "scan", **head, **columns}


def _object_json(row: dict[str, Any]) -> dict[str, Any]:
    yaw, row["class"] = row.pop("yaw_rad"), row.pop("category")
    row = {key: round(value, 4) if isinstance(value, float) else value for key, value in row.items()}
    return {"id": row.pop("number"), **row, "yaw_deg": None if yaw is None else round(math.degrees(yaw), 3)}


def _numbers(values: Floats) -> list[float | None]:
    return [None if math.isnan(value) else round(value, 4) for value in values.tolist()]


def require_matplotlib() -> None:
    """Say what is missing before a device is asked for anything."""
    if importlib.util.find_spec("matplotlib") is None:
        raise EmulatorError("--png needs the extra `report`: pip install 'lidaremu[report]'")


def save_png(seen: Seen, title: str, path: Path) -> None:
    """A scan or a list as a picture; needs the extra `report`."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib.figure import Figure

    from emulator.studies.drawing import tame

    figure = Figure(figsize=(9.0, 5.4 if isinstance(seen, HostScan) and is_half(seen.azimuth_rad) else 7.6))
    figure.set_layout_engine("constrained")
    axes = figure.add_subplot()
    if isinstance(seen, HostScan):
        _draw_scan(axes, seen)
    else:
        _draw_objects(axes, seen.objects)
    axes.set_xlabel("to the right, -y [m]")
    axes.set_ylabel("ahead, x [m]")
    axes.set_aspect("equal")
    axes.grid(color="#e3e7eb", linewidth=0.8)
    axes.set_axisbelow(True)
    axes.plot(0.0, 0.0, "^", color="#444444", markersize=9, clip_on=False)
    axes.set_title(title.replace("  ", ", "), fontsize=11)
    tame(figure)
    try:
        figure.savefig(path, dpi=130, format="png")
    except OSError as error:
        raise EmulatorError(f"{path}: cannot be written: {error.strerror}") from None


def _draw_scan(axes: Axes, scan: HostScan) -> None:
    """From above: x upwards, y to the left, rings of equal range."""
    from matplotlib.patches import Circle

    seen = np.isfinite(scan.range_m)
    limit = nice_range(float(np.max(scan.range_m[seen])) if seen.any() else 10.0)
    for share in (0.25, 0.5, 0.75, 1.0):
        axes.add_patch(Circle((0.0, 0.0), share * limit, fill=False, color="#c9d1d9", linewidth=0.8))
    colour = scan.range_m[seen] if scan.intensity is None else scan.intensity[seen]
    x, y = scan.range_m * np.cos(scan.azimuth_rad), scan.range_m * np.sin(scan.azimuth_rad)
    dots = axes.scatter(-y[seen], x[seen], c=colour, s=8.0, cmap="viridis_r", linewidths=0.0, zorder=3)
    axes.set_xlim(-1.02 * limit, 1.02 * limit)
    axes.set_ylim(0.0 if is_half(scan.azimuth_rad) else -1.02 * limit, 1.02 * limit)
    if seen.any():
        label = "range [m]" if scan.intensity is None else "intensity (the device's units)"
        assert axes.figure is not None
        axes.figure.colorbar(dots, ax=axes, label=label, shrink=0.8)


def _draw_objects(axes: Axes, objects: Sequence[Any]) -> None:
    """From above: x upwards, y to the left, a second of each object's way as an arrow."""
    from matplotlib.patches import Polygon

    names = sorted({one.category or "not reported" for one in objects})
    colours = dict(zip(names, ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9") * 3, strict=False))
    labelled: set[str] = set()
    for one in objects:
        name = one.category or "not reported"
        style = {"color": colours[name], "label": None if name in labelled else name}
        labelled.add(name)
        if one.length_m and one.width_m:
            yaw = one.yaw_rad or 0.0
            half = 0.5 * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * (one.length_m, one.width_m)
            c, s = math.cos(yaw), math.sin(yaw)
            x, y = one.x_m + half @ (c, -s), one.y_m + half @ (s, c)
            axes.add_patch(Polygon(np.column_stack((-y, x)), closed=True, alpha=0.75, **style))
        else:
            axes.plot(-one.y_m, one.x_m, "o", markersize=5, linestyle="none", **style)
        axes.annotate(f"{one.number}", (-one.y_m, one.x_m), xytext=(9, -3), textcoords="offset points", fontsize=9)
        if one.vx_m_s is not None and one.vy_m_s is not None and math.hypot(one.vx_m_s, one.vy_m_s) > 0.5:
            axes.annotate(
                "", (-(one.y_m + one.vy_m_s), one.x_m + one.vx_m_s), (-one.y_m, one.x_m),
                arrowprops={"arrowstyle": "->", "color": "#444444", "linewidth": 1.0},
            )  # fmt: skip
    far = max((math.hypot(one.x_m, one.y_m) for one in objects), default=10.0) + 3.0
    side = max(max((abs(one.y_m) for one in objects), default=5.0) + 3.0, 0.45 * far)
    axes.set_xlim(-side, side)
    axes.set_ylim(min(-2.0, min((one.x_m for one in objects), default=0.0) - 3.0), far)
    if objects:
        axes.legend(loc="upper left", bbox_to_anchor=(1.02, 1.0), frameon=False)
