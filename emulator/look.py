"""`lidaremu look`: a host of our own draws what a device sends, in the terminal, as a picture or as a table."""

from __future__ import annotations

import csv
import importlib.util
import math
import shutil
import sys
from collections.abc import Callable
from contextlib import nullcontext
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from emulator import plot
from emulator.clock import SystemClock
from emulator.errors import EmulatorError, LinkError
from emulator.hosts.lines import Line, open_line
from emulator.hosts.scans import Host, HostScan

if TYPE_CHECKING:
    from matplotlib.projections.polar import PolarAxes

HOSTS = {"lms2xx": "emulator.hosts.lms2xx:Lms2xxHost", "ld": "emulator.hosts.ld:LdHost"}
"Families that `look` can speak -> `module:class`, imported when one is wanted; made with a line and a line speed."

REDRAW_NS = 100_000_000
QUIET_S = 2.0


def connect(url: str, family_name: str, baud: int) -> Host:
    """A connected host of that family."""
    if family_name not in HOSTS:
        raise EmulatorError(f"look does not speak {family_name!r}; want {', '.join(sorted(HOSTS))}")
    module, _, name = HOSTS[family_name].partition(":")
    make: Callable[[Line, int], Host] = getattr(import_module(module), name)
    line = open_line(url, baud)
    try:
        return make(line, baud)
    except BaseException:
        line.close()
        raise


def run_look(
    url: str,
    family_name: str,
    baud: int,
    scans: int | None,
    duration_s: float | None,
    png: Path | None,
    table: Path | None,
    say: Callable[[str], None],
) -> int:
    """Draw until told to stop; the exit code."""
    if png is not None:
        require_matplotlib()
    host = connect(url, family_name, baud)
    try:
        last = watch(host, scans, duration_s, table, say, live=sys.stdout.isatty() and png is None)
    finally:
        host.close()
    if last is None:
        raise LinkError(f"{url}: the device sends no scan")
    if png is not None:
        save_png(last, host.title, png)
        say(f"{png}: {describe(last)}")
    return 0


def watch(
    host: Host,
    scans: int | None,
    duration_s: float | None,
    table: Path | None,
    say: Callable[[str], None],
    live: bool,
) -> HostScan | None:
    """Follow the stream; the last scan. Draws live, or the last scan at the end when nobody watches."""
    clock = SystemClock()
    last: HostScan | None = None
    drawn_ns = -REDRAW_NS
    first_ns = 0
    with _screen(live) as screen, _table(table) as rows:
        for scan in host.scans(timeout_s=QUIET_S):
            now_ns = clock.now_ns()
            if scan is not None:
                if last is None:
                    first_ns = now_ns
                last = scan
                if rows is not None:
                    write_rows(rows, scan)
                if screen is not None and now_ns - drawn_ns >= REDRAW_NS:
                    drawn_ns = now_ns
                    screen.update(picture(host.title, scan, rate(scan, now_ns - first_ns)))
            elif last is None:
                break
            if (scans is not None and last is not None and last.number + 1 >= scans) or (
                duration_s is not None and now_ns >= duration_s * 1e9
            ):
                break
    if last is not None and not live:
        say(picture(host.title, last, rate(last, clock.now_ns() - first_ns)))
    return last


def rate(scan: HostScan, elapsed_ns: int) -> float:
    """Scans a second since the first one; NaN before the second."""
    return scan.number * 1e9 / elapsed_ns if scan.number and elapsed_ns > 0 else math.nan


def describe(scan: HostScan) -> str:
    """One line: how many points, how near."""
    seen = np.isfinite(scan.range_m)
    if not seen.any():
        return f"{len(scan.range_m)} beams, no echo"
    return f"{len(scan.range_m)} beams, {int(seen.sum())} echoes, nearest {np.nanmin(scan.range_m):.2f} m"


def picture(title: str, scan: HostScan, scans_per_s: float) -> str:
    """A scan drawn to fit the terminal, status line included; 80 x 24 where there is none."""
    size = shutil.get_terminal_size((80, 24))
    rate_text = "-" if math.isnan(scans_per_s) else f"{scans_per_s:.1f}/s"
    status = f"{'; '.join(title.replace(';', ' ').split())} | {rate_text} | {describe(scan)}"
    lines = plot.polar(scan.azimuth_rad, scan.range_m, min(size.columns, 160), max(6, size.lines - 2))
    return "\n".join([status[: size.columns], *lines])


class _Table:
    def __init__(self, path: Path) -> None:
        try:
            self._file = path.open("w", newline="", encoding="utf-8")
        except OSError as error:
            raise EmulatorError(f"{path}: cannot be written: {error.strerror}") from None
        self.writer = csv.writer(self._file)
        self.writer.writerow(["scan", "azimuth_deg", "range_m"])

    def __enter__(self) -> Any:
        return self.writer

    def __exit__(self, *_: object) -> None:
        self._file.close()


def _table(path: Path | None) -> Any:
    return nullcontext() if path is None else _Table(path)


def write_rows(rows: Any, scan: HostScan) -> None:
    """One row a beam; an empty range where there is no echo."""
    degrees = np.degrees(scan.azimuth_rad)
    rows.writerows(
        (scan.number, f"{angle:.4f}", "" if math.isnan(metres) else f"{metres:.4f}")
        for angle, metres in zip(degrees.tolist(), scan.range_m.tolist(), strict=True)
    )


def _screen(live: bool) -> Any:
    return _LiveText() if live else nullcontext()


class _LiveText:
    """Rich's live display of plain text, on the alternate screen."""

    def __init__(self) -> None:
        from rich.live import Live

        self._live = Live(screen=True, auto_refresh=False)

    def __enter__(self) -> _LiveText:
        self._live.__enter__()
        return self

    def __exit__(self, *args: Any) -> None:
        self._live.__exit__(*args)

    def update(self, text: str) -> None:
        from rich.text import Text

        self._live.update(Text(text, no_wrap=True), refresh=True)


def require_matplotlib() -> None:
    """Say what is missing before a device is asked for anything."""
    if importlib.util.find_spec("matplotlib") is None:
        raise EmulatorError("--png needs the extra `report`: pip install 'lidaremu[report]'")


def save_png(scan: HostScan, title: str, path: Path) -> None:
    """The scan as a picture; needs the extra `report`."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 6), layout="constrained")
    axes = cast("PolarAxes", figure.add_subplot(projection="polar"))
    axes.set_theta_zero_location("N")
    seen = np.isfinite(scan.range_m)
    axes.plot(scan.azimuth_rad[seen], scan.range_m[seen], ".", markersize=3)
    if np.all(np.abs(scan.azimuth_rad) <= math.radians(91.0)):
        axes.set_thetamin(-90.0)
        axes.set_thetamax(90.0)
    axes.set_title(f"{title}: {describe(scan)}")
    try:
        figure.savefig(path, dpi=120, format="png")
    except OSError as error:
        raise EmulatorError(f"{path}: cannot be written: {error.strerror}") from None
