"""`lidaremu look`: a host of our own shows what a device sends, in the terminal, as lines, a picture or a table.

Belongs here: following a host and what is on a page. Not: protocols (hosts), the terminal (screen), files (look_files).
"""

from __future__ import annotations

import json
import math
import signal
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np

from emulator.errors import EmulatorError, LinkError
from emulator.hosts.families import BUILT_IN, found_at, is_on_can, names
from emulator.hosts.lines import Line, LineClosed, open_line
from emulator.hosts.scans import Host, HostObject, HostObjects, HostScan, Seen
from emulator.looking import plot
from emulator.process.clock import SystemClock

if TYPE_CHECKING:
    from emulator.looking.screen import Page

REDRAW_NS = 80_000_000
POLL_S = 0.05
FIRST_S = 6.0
"Until the first scan, however short a look was asked for; an LD on a slow line needs its time."
SILENT_S = 10.0
"Then a device is given up where nobody watches."
LINE_NS = 1_000_000_000
RATE_SCANS = 40
"Scans over which the rate is reported."
SHRINK_PAGES = 25
"Pages for which a smaller picture would have done before it is taken: it does not jump about."
GROW_PAGES = 3
"Pages in succession that want a larger picture before it is taken: a lone false alarm is of one scan."
TABLE_COLUMNS = 42
KEYS = " q quit   p pause   + zoom in   - zoom out   0 fit"

Say = Callable[[str], None]


@runtime_checkable
class HasHost(Protocol):
    """A family of another package that brings its own host for `lidaremu look`."""

    def host(self, line: Line, baud: int) -> Host: ...


@dataclass(frozen=True)
class Wanted:
    """What a user of `look` asked for."""

    scans: int | None = None
    duration_s: float | None = None
    png: Path | None = None
    table: Path | None = None
    as_json: bool = False
    live: bool = False
    "Draw on the terminal until asked to stop."
    lines: bool = True
    "Without `live`: a line a second, the last scan drawn at the end."


def connect(
    url: str, family_name: str, baud: int, model: str | None = None, more: bool = False, listen: bool = False
) -> Host:
    """A connected host of that family; every error names the link. `listen`: it asks the device for nothing."""
    if is_on_can(family_name):
        from emulator.hosts.can_lines import open_can
        from emulator.hosts.can_objects import CanObjectHost

        bus = open_can(url)
        with _closed_if_refused(bus.close, url):
            return CanObjectHost(bus, model, more)
    make = _maker(family_name)
    line = open_line(url, baud)
    with _closed_if_refused(line.close, url):
        return _listening(make)(line, baud) if listen else make(line, baud)


def _listening(make: Callable[..., Host]) -> Callable[[Line, int], Host]:
    """The same, asking for nothing; `EmulatorError` of a host that cannot."""
    if "listen" not in signature(make).parameters:
        raise EmulatorError(f"--listen: the host of this family always sends requests; want {names()}")
    return partial(make, listen=True)


def _maker(family_name: str) -> Callable[[Line, int], Host]:
    """What makes a host of an open line: ours, or one that another package's family brings."""
    if family_name in BUILT_IN:
        made: Callable[[Line, int], Host] = found_at(BUILT_IN[family_name].host)
        return made
    from protocols import families, family

    if family_name in families() and isinstance(found := family(family_name), HasHost):
        return found.host
    raise EmulatorError(f"look does not support {family_name!r}; want {names()}")


@contextmanager
def _closed_if_refused(close: Callable[[], None], url: str) -> Iterator[None]:
    try:
        yield
    except LinkError as error:
        close()
        raise LinkError(f"{url}: {error}" if url not in str(error) else str(error)) from None
    except BaseException:
        close()
        raise


def run_look(host: Host, url: str, wanted: Wanted, say: Say) -> int:
    """Follow a host as was asked; the exit code. The host is closed."""
    try:
        last = watch(host, wanted, say)
    finally:
        host.close()
    if last is None:
        raise LinkError(f"{url}: connected to {tidy(host.title)}, but no scan came within {FIRST_S:g} s")
    if wanted.png is not None:
        from emulator.looking.look_files import save_png

        save_png(last, f"{tidy(host.title)}: {describe(last)}", wanted.png)
        if not wanted.as_json:
            say(f"{wanted.png}: {describe(last)}")
    return 0


def watch(host: Host, wanted: Wanted, say: Say) -> Seen | None:
    """Follow the stream until asked to stop; the last scan, None when none came."""
    clock = SystemClock()
    view = View(tidy(host.title))
    with ExitStack() as open_:
        open_.enter_context(_stopped_by_signals())
        sinks = []
        if wanted.table is not None:
            from emulator.looking.look_files import Table

            table = Table(wanted.table)
            open_.callback(table.close)
            sinks.append(table.add)
        if wanted.as_json:
            from emulator.looking.look_files import as_json

            sinks.append(lambda seen, time_s: say(json.dumps(as_json(seen, time_s, host.errors))))
        show: Callable[[int], bool] = _no_show
        if wanted.live:
            show = open_.enter_context(_live(view))
        elif wanted.lines and not wanted.as_json:
            show = _lines(view, say)
        begun_ns, ended = clock.now_ns(), ""
        try:
            for seen in host.scans(POLL_S):
                now_ns = clock.now_ns()
                view.errors = host.errors
                if seen is not None:
                    view.take(seen, now_ns)
                    for sink in sinks:
                        sink(seen, (now_ns - view.first_ns) * 1e-9)
                if not show(now_ns):
                    break
                if wanted.scans is not None and view.count >= wanted.scans:
                    break
                quiet_s = (now_ns - (view.last_ns if view.last else begun_ns)) * 1e-9
                if view.last is None:
                    if quiet_s >= FIRST_S:
                        break
                elif wanted.duration_s is not None and now_ns - begun_ns >= wanted.duration_s * 1e9:
                    break
                if quiet_s >= SILENT_S and not wanted.live:
                    raise LinkError(f"{view.title}: silent for {quiet_s:.0f} s after {view.count} scans")
        except KeyboardInterrupt:
            pass  # stopped as asked
        except LineClosed as error:
            if view.last is None or wanted.scans is not None or wanted.duration_s is not None:
                count = _several(view.count, "scan")
                raise LineClosed(f"after {count}: {error}") from None
            ended = f"after {_several(view.count, 'scan')}: {error}"
    if view.last is not None and not wanted.as_json and wanted.lines:
        from emulator.looking.screen import plain

        for line in (
            [view.status(clock.now_ns())] if wanted.live else plain(view.page(80, 24, clock.now_ns()), 80).split("\n")
        ):
            say(line)
    if ended and not wanted.as_json:
        say(ended)
    return view.last


@contextmanager
def _stopped_by_signals() -> Iterator[None]:
    """SIGTERM ends a watch as Ctrl-C does: the terminal is restored, files are finished, the device is left tidy."""

    def stop(number: int, frame: object) -> None:
        raise KeyboardInterrupt

    try:
        before = signal.signal(signal.SIGTERM, stop)
    except ValueError:  # not in the main thread
        yield
        return
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _no_show(now_ns: int) -> bool:
    return True


def _lines(view: View, say: Say) -> Callable[[int], bool]:
    reported_ns: int | None = None

    def show(now_ns: int) -> bool:
        nonlocal reported_ns
        if view.last is not None:
            if reported_ns is None:
                reported_ns = now_ns
            elif now_ns - reported_ns >= LINE_NS:
                reported_ns = now_ns
                say(view.status(now_ns))
        return True

    return show


@contextmanager
def _live(view: View) -> Iterator[Callable[[int], bool]]:
    """Draws on the terminal and obeys keys; false when the user has had enough."""
    from emulator.looking.screen import Screen, single_keys

    with single_keys() as keys, Screen() as screen:
        drawn_ns, drawn_size = -REDRAW_NS, (0, 0)

        def show(now_ns: int) -> bool:
            nonlocal drawn_ns, drawn_size
            pressed = keys.read()
            for key in pressed:
                if not view.obey(key):
                    return False
            if pressed or screen.size != drawn_size or now_ns - drawn_ns >= REDRAW_NS:
                drawn_ns, drawn_size = now_ns, screen.size
                screen.update(view.page(*drawn_size, now_ns))
            return True

        yield show


def tidy(title: str) -> str:
    """A device's name for itself on one line of printable text."""
    text = "; ".join(title.replace(";", " ").split()) if ";" in title else " ".join(title.split())
    return "".join(letter if letter.isprintable() else "?" for letter in text) or "unnamed device"


def describe(seen: Seen) -> str:
    """How many points or objects, how near; short enough for a status line."""
    if isinstance(seen, HostObjects):
        nearest = min((math.hypot(one.x_m, one.y_m) for one in seen.objects), default=None)
        return _several(len(seen.objects), "object") + ("" if nearest is None else f"  nearest {nearest:.2f} m")
    known = np.isfinite(seen.range_m)
    if not known.any():
        return f"{len(seen.range_m)} beams, no echo"
    echoes = _several(int(known.sum()), "echo", "echoes")
    return f"{len(seen.range_m)} beams, {echoes}  nearest {np.nanmin(seen.range_m):.2f} m"


def _several(count: int, one: str, more: str = "") -> str:
    return f"{count} {one if count == 1 else more or one + 's'}"


class View:
    """What is on a page: the last scan, how far it is drawn, what the status line reports."""

    def __init__(self, title: str) -> None:
        self.title = title
        self.last: Seen | None = None
        self.count = 0
        self.errors = 0
        self.first_ns = 0
        self.last_ns = 0
        self._times: deque[int] = deque(maxlen=RATE_SCANS)
        self._shown: Seen | None = None
        "The last one, or the one at which the picture was paused."
        self._paused = False
        self._zoom_m: float | None = None
        self._auto_m = 0.0
        self._smaller = self._larger = 0
        self._peaks: tuple[float, float] | None = None

    def take(self, seen: Seen, now_ns: int) -> None:
        """One more scan has come."""
        self.first_ns = now_ns if self.last is None else self.first_ns
        self.last, self.last_ns = seen, now_ns
        self.count += 1
        self._times.append(now_ns)
        if not self._paused:
            self._shown = seen

    def obey(self, key: str) -> bool:
        """What a key does; false: enough."""
        if key in "qQ\x03\x04":
            return False
        if key in "pP ":
            self._paused = not self._paused
            self._shown = self._shown if self._paused else self.last
        elif key in "+=":
            self._zoom_m = plot.next_range(self.limit_m, up=False)
        elif key in "-_":
            self._zoom_m = plot.next_range(self.limit_m, up=True)
        elif key == "0":
            self._zoom_m = None
        return True

    @property
    def limit_m(self) -> float:
        """Range at the edge of the picture."""
        return self._zoom_m or self._auto_m or 10.0

    @property
    def rate_hz(self) -> float:
        """Scans per second over the last ones; NaN before the second."""
        span_ns = self._times[-1] - self._times[0] if self._times else 0
        return (len(self._times) - 1) * 1e9 / span_ns if span_ns > 0 else math.nan

    def status(self, now_ns: int) -> str:
        """Rate, points, nearest, errors, time: one line."""
        if self.last is None:
            return " waiting for the first scan"
        elapsed = int((now_ns - self.first_ns) * 1e-9)
        rate = "-" if math.isnan(self.rate_hz) else f"{self.rate_hz:.1f}/s"
        quiet_s = (now_ns - self.last_ns) * 1e-9
        late = f"  SILENT for {quiet_s:.0f} s" if quiet_s > max(2.0, 5.0 / (self.rate_hz or 1.0)) else ""
        errors = _several(self.errors, "error")
        return f" {rate}  {describe(self.last)}  {errors}  {elapsed // 60}:{elapsed % 60:02d}{late}"

    def page(self, columns: int, rows: int, now_ns: int) -> Page:
        """Everything to fit a terminal of that size."""
        from emulator.looking.screen import Page

        seen = self._shown
        height = max(6, rows - (3 if rows > 12 else 2))
        detail = f"  {seen.detail}" if seen is not None and seen.detail else ""
        title = f" {self.title}{detail}{'  PAUSED' if self._paused else ''}"
        if isinstance(seen, HostObjects):
            beside = columns >= TABLE_COLUMNS + 26
            drawing = self._draw_objects(seen, columns - TABLE_COLUMNS - 2 if beside else columns, height)
            table = table_of(seen.objects, height) if beside else ()
            return Page(title, drawing, table, self.status(now_ns), KEYS)
        if seen is None:
            seen = HostScan(0, np.zeros(1), np.full(1, np.nan))
        return Page(title, self._draw_scan(seen, columns, height), (), self.status(now_ns), KEYS)

    def _draw_scan(self, scan: HostScan, columns: int, rows: int) -> plot.Drawing:
        seen = np.isfinite(scan.range_m)
        self._fit(float(np.max(scan.range_m[seen])) if seen.any() else math.nan)
        if scan.intensity is None or not np.isfinite(scan.intensity).any():
            levels = self._by_range(scan)
        else:
            shades = np.log(np.maximum(scan.intensity, 1.0))
            low, high = float(np.nanmin(shades)), float(np.nanmax(shades))
            before = self._peaks or (low, high)
            self._peaks = min(low, before[0]), max(high, before[1])
            levels = plot.levels_of(shades, *self._peaks)
        return plot.draw_scan(scan.azimuth_rad, scan.range_m, columns, rows, self.limit_m, levels)

    def _by_range(self, scan: HostScan) -> np.ndarray[tuple[int, ...], np.dtype[np.int8]]:
        """Near is red, far is blue."""
        return np.asarray(plot.LEVELS - 1 - plot.levels_of(scan.range_m, 0.0, self.limit_m), dtype=np.int8)

    def _draw_objects(self, found: HostObjects, columns: int, rows: int) -> plot.Drawing:
        ranges = [math.hypot(one.x_m, one.y_m) for one in found.objects]
        self._fit(max(ranges, default=math.nan))
        boxes = [
            plot.Box(
                str(one.number), one.x_m, one.y_m, one.length_m or 0.0, one.width_m or 0.0, one.yaw_rad or 0.0,
                max(0, plot.LEVELS - 1 - int(plot.LEVELS * away / self.limit_m)),
            )
            for one, away in zip(found.objects, ranges, strict=True)
        ]  # fmt: skip
        return plot.draw_boxes(boxes, columns, rows, self.limit_m, all(one.x_m > -1.0 for one in found.objects))

    def _fit(self, farthest_m: float) -> None:
        """Let the picture grow soon, and shrink when a smaller one has done for some time."""
        if math.isnan(farthest_m):
            return
        wanted = plot.nice_range(farthest_m)
        self._larger = self._larger + 1 if wanted > self._auto_m else 0
        self._smaller = self._smaller + 1 if wanted < self._auto_m else 0
        if self._auto_m and self._larger < GROW_PAGES and self._smaller < SHRINK_PAGES:
            return
        self._auto_m, self._larger, self._smaller = wanted, 0, 0


def table_of(objects: tuple[HostObject, ...], rows: int) -> tuple[str, ...]:
    """Objects as lines of at most `TABLE_COLUMNS`, the nearest first; what finds no room is counted."""
    lines = [f"{'id':>3} {'x m':>6} {'y m':>6} {'vx':>5} {'vy':>5} {'class':<7} {'p':>3}"]
    ordered = sorted(objects, key=lambda one: math.hypot(one.x_m, one.y_m))
    room = rows - 1 if len(ordered) <= rows - 1 else rows - 2
    for one in ordered[:room]:
        chance = "-" if one.existence is None else f"{100.0 * one.existence:.0f}"
        lines.append(
            f"{one.number:>3} {one.x_m:6.1f} {one.y_m:6.1f} {_speed(one.vx_m_s)} {_speed(one.vy_m_s)}"
            f" {(one.category or '-')[:7]:<7} {chance:>3}"
        )
    if len(ordered) > room:
        lines.append(f"    and {len(ordered) - room} more")
    return tuple(lines)


def _speed(value: float | None) -> str:
    return "    -" if value is None else f"{value:5.1f}"
