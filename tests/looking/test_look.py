"""`look` without a device: what a page holds, what keys do, what files say. Hosts are played, time is counted."""

from __future__ import annotations

import io
import json
import math
import os
from collections.abc import Iterator, Sequence
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from emulator.errors import LinkError
from emulator.hosts.lines import GONE, LineClosed, SerialLine
from emulator.hosts.scans import HostObject, HostObjects, HostScan, Seen
from emulator.looking import look, plot
from emulator.looking.look import TABLE_COLUMNS, View, Wanted, describe, run_look, table_of, tidy, watch
from emulator.looking.look_files import OBJECT_COLUMNS, SCAN_COLUMNS
from emulator.looking.screen import Screen, drawable, plain

WALL = HostScan(0, np.radians(np.arange(-90.0, 91.0)), np.full(181, 8.0), "status 10")
CAR = HostObject(7, 20.0, 2.0, -5.0, 0.5, 4.4, 1.8, 0.1, "car", 0.999)
LIST = HostObjects(0, (CAR, HostObject(12, 40.0, -3.0)), "")


class Played:
    """A host that has these scans, then nothing."""

    title = "LMS291;S05 ;V02.10"
    errors = 3

    def __init__(self, seen: Sequence[Seen | None]) -> None:
        self._seen = seen
        self.closed = False

    def scans(self, timeout_s: float) -> Iterator[Seen | None]:
        yield from self._seen

    def close(self) -> None:
        self.closed = True


def lines_of(view: View, columns: int = 80, rows: int = 24, now_ns: int = 0) -> list[str]:
    return plain(view.page(columns, rows, now_ns), columns).splitlines()


@pytest.mark.parametrize(("columns", "rows"), [(80, 24), (40, 10), (20, 6), (200, 60)])
@pytest.mark.parametrize("seen", [WALL, LIST, HostObjects(0, ()), HostScan(0, np.zeros(0), np.zeros(0))])
def test_a_page_fits_the_terminal(seen: Seen, columns: int, rows: int) -> None:
    view = View("device")
    view.take(seen, 0)
    page = view.page(columns, rows, 0)
    assert len(page.drawing.lines) == max(6, rows - (3 if rows > 12 else 2))
    widest = max(len(line) for line in page.drawing.lines)
    assert widest + (TABLE_COLUMNS + 2 if page.beside else 0) <= max(columns, 16)
    assert all(len(text) <= TABLE_COLUMNS for text in page.beside)


def test_the_status_line_tells_rate_points_nearest_errors_and_time() -> None:
    view = View("device")
    for index in range(76):
        view.take(WALL, index * 26_666_667)
    view.errors = 1
    assert view.status(2_000_000_000) == " 37.5/s  181 beams, 181 echoes  nearest 8.00 m  1 error  0:02"
    assert "SILENT for 65 s" in view.status(67_000_000_000)


def test_pause_holds_the_picture_and_zoom_changes_its_edge() -> None:
    view = View("device")
    view.take(WALL, 0)
    assert "10 m" in "".join(lines_of(view))
    view.obey("+")
    assert view.limit_m == 5.0
    view.obey("-")
    view.obey("-")
    assert view.limit_m == 20.0
    view.obey("0")
    assert view.limit_m == 10.0
    view.obey("p")
    view.take(LIST, 1)
    assert "PAUSED" in lines_of(view)[0]
    assert "status 10" in lines_of(view)[0]
    view.obey("p")
    assert "car" in "\n".join(lines_of(view))
    assert not view.obey("q")


def test_zooming_goes_through_round_ranges_and_ends() -> None:
    assert [plot.next_range(limit, up=True) for limit in (1.0, 2.0, 5.0, 10.0, 500.0)] == [2.0, 5.0, 10.0, 20.0, 500.0]
    assert [plot.next_range(limit, up=False) for limit in (0.5, 2.0, 5.0, 10.0, 20.0)] == [0.5, 1.0, 2.0, 5.0, 10.0]


def test_the_picture_grows_soon_and_shrinks_after_a_while_and_a_lone_false_alarm_moves_it_not() -> None:
    view = View("device")
    far = HostScan(0, WALL.azimuth_rad, np.full(181, 60.0))

    def limits(*scans: HostScan) -> list[float]:
        found = []
        for seen in scans:
            view.take(seen, 0)
            view.page(80, 24, 0)
            found.append(view.limit_m)
        return found

    assert limits(WALL, far, WALL, far, far) == [10.0] * 5
    assert limits(far) == [100.0]
    assert limits(*[WALL] * look.SHRINK_PAGES) == [100.0] * (look.SHRINK_PAGES - 1) + [10.0]


def test_near_points_are_red_and_bright_ones_too_where_the_device_tells() -> None:
    view = View("device")
    view.take(HostScan(0, np.array([0.0, 0.5]), np.array([1.0, 9.9])), 0)
    levels = set(view.page(80, 24, 0).drawing.levels.ravel().tolist())
    assert {plot.LEVELS - 2, 0} <= levels
    view.take(HostScan(1, np.array([0.0, 0.5]), np.array([9.0, 9.0]), intensity=np.array([10.0, 1000.0])), 0)
    levels = set(view.page(80, 24, 0).drawing.levels.ravel().tolist())
    assert {plot.LEVELS - 1, 0} <= levels


def test_objects_are_drawn_where_they_are_with_their_numbers_and_listed_nearest_first() -> None:
    view = View("can-ars408")
    view.take(HostObjects(0, tuple(reversed(LIST.objects))), 0)
    reported = lines_of(view)
    table = [line[line.index("  ") :].split() for line in reported if "car" in line or " 12 " in line]
    assert table[0][-7:] == ["7", "20.0", "2.0", "-5.0", "0.5", "car", "100"]
    assert table[1][-7:] == ["12", "40.0", "-3.0", "-", "-", "-", "-"]
    picture = [line[:36] for line in view.page(80, 24, 0).drawing.lines]
    (near,) = [row for row, line in enumerate(picture) if "7" in line]
    (far,) = [row for row, line in enumerate(picture) if "12" in line]
    assert far < near
    assert picture[far].index("12") > picture[near].index("7")  # y = -3 is further to the right than y = 2


def test_more_objects_than_lines_are_counted() -> None:
    objects = tuple(HostObject(index, 5.0 + index, 0.0) for index in range(30))
    lines = table_of(objects, 21)
    assert len(lines) == 21
    assert lines[-1].strip() == "and 11 more"


def test_a_screen_shows_colours_unless_told_not_to(monkeypatch: pytest.MonkeyPatch) -> None:
    view = View("device")
    view.take(WALL, 0)
    for no_color in (False, True):
        out = io.StringIO()
        console = Console(file=out, force_terminal=True, color_system="256", width=80, height=24, no_color=no_color)
        with Screen(console) as screen:
            assert screen.size == (80, 24)
            screen.update(view.page(*screen.size, 0))
        text = out.getvalue()
        assert ("\x1b[38;5;" in text) is not no_color
        assert "\x1b[?1049h" in text
        assert "\x1b[?25h" in text
        assert "\x1b[?1049l" in text
        assert "181 beams" in text


@pytest.mark.parametrize(
    ("terminal", "term", "wanted"), [(True, "xterm", True), (True, "dumb", False), (False, "xterm", False)]
)
def test_pages_are_drawn_on_terminals_that_can(
    terminal: bool, term: str, wanted: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stdout.isatty", lambda: terminal)
    monkeypatch.setenv("TERM", term)
    assert drawable() is wanted


def test_without_a_terminal_the_last_scan_is_drawn_with_its_status(tmp_path: Path) -> None:
    said: list[str] = []
    host = Played([WALL, WALL])
    assert run_look(host, "pty:x", Wanted(table=tmp_path / "x.csv"), said.append) == 0
    assert host.closed
    assert said[0] == " LMS291; S05; V02.10  status 10"
    assert "181 beams, 181 echoes  nearest 8.00 m  3 errors" in said[-1]
    rows = (tmp_path / "x.csv").read_text().splitlines()
    assert rows[0].split(",") == list(SCAN_COLUMNS)
    assert len(rows) == 1 + 2 * 181
    assert rows[1].startswith("0,-90.0000,8.0000,,0.0")


def test_objects_as_csv_and_json(tmp_path: Path) -> None:
    said: list[str] = []
    watch(Played([LIST]), Wanted(table=tmp_path / "x.csv", as_json=True), said.append)
    rows = [row.split(",") for row in (tmp_path / "x.csv").read_text().splitlines()]
    assert rows[0] == list(OBJECT_COLUMNS)
    assert rows[1][:-1] == "0,7,20.000,2.000,-5.000,0.500,4.400,1.800,5.73,car,0.999".split(",")
    assert rows[2][:-1] == "0,12,40.000,-3.000,,,,,,,".split(",")
    (row,) = map(json.loads, said)
    assert (row["event"], row["errors"], row["objects"][1]["class"]) == ("objects", 3, None)
    assert row["objects"][0]["yaw_deg"] == pytest.approx(math.degrees(0.1), abs=1e-3)


def test_scans_as_json_have_null_where_there_is_no_echo() -> None:
    said: list[str] = []
    scan = HostScan(0, np.array([0.0, 0.1]), np.array([np.nan, 2.0]), intensity=np.array([np.nan, 7.0]))
    watch(Played([scan, scan]), Wanted(as_json=True, scans=1), said.append)
    (row,) = map(json.loads, said)
    assert (row["range_m"], row["intensity"]) == ([None, 2.0], [None, 7.0])
    assert row["azimuth_deg"] == [0.0, 5.7296]


@pytest.mark.parametrize("seen", [WALL, LIST, HostObjects(0, ()), HostScan(0, np.zeros(1), np.full(1, np.nan))])
def test_a_picture_of_anything_is_made(seen: Seen, tmp_path: Path) -> None:
    said: list[str] = []
    assert run_look(Played([seen]), "pty:x", Wanted(scans=1, png=tmp_path / "x.png", lines=False), said.append) == 0
    assert (tmp_path / "x.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert said == [f"{tmp_path / 'x.png'}: {describe(seen)}"]


def test_a_device_that_sends_nothing_is_an_error_that_names_the_link(monkeypatch: pytest.MonkeyPatch) -> None:
    host = Played([None, None])
    with pytest.raises(LinkError, match=r"pty:x: connected to LMS291; S05; V02.10, but no scan"):
        run_look(host, "pty:x", Wanted(), lambda text: None)
    assert host.closed


def test_a_device_that_falls_silent_is_told_where_nobody_watches(monkeypatch: pytest.MonkeyPatch) -> None:
    class Jumping:
        def __init__(self) -> None:
            self.now = 0

        def now_ns(self) -> int:
            self.now += 6_000_000_000
            return self.now

    monkeypatch.setattr(look, "SystemClock", Jumping)
    with pytest.raises(LinkError, match="silent for 12 s after 1 scans"):
        watch(Played([WALL, None, None, None]), Wanted(), lambda text: None)


@pytest.mark.parametrize(("silent_s", "found"), [(5, WALL), (6, None)])
def test_a_short_look_waits_for_the_first_scan(
    monkeypatch: pytest.MonkeyPatch, silent_s: int, found: HostScan | None
) -> None:
    seconds = count()  # one a look
    monkeypatch.setattr(look, "SystemClock", lambda: SimpleNamespace(now_ns=lambda: next(seconds) * 1_000_000_000))
    seen = watch(Played([None] * silent_s + [WALL, LIST]), Wanted(duration_s=1.5), lambda text: None)
    assert seen is found


@pytest.mark.parametrize(
    ("title", "reported"), [("LMS;S05", "LMS; S05"), ("LD \x1b[2J", "LD ?[2J"), ("", "unnamed device")]
)
def test_a_title_is_one_line_of_printable_text(title: str, reported: str) -> None:
    assert tidy(title).startswith(reported)


def test_keyboard_interrupt_is_an_end_as_asked() -> None:
    class Interrupted(Played):
        def scans(self, timeout_s: float) -> Iterator[Any]:
            yield WALL
            raise KeyboardInterrupt

    said: list[str] = []
    assert run_look(Interrupted([]), "pty:x", Wanted(), said.append) == 0
    assert "181 beams" in said[-1]


class Ending(Played):
    """A host whose device goes after its scans."""

    def scans(self, timeout_s: float) -> Iterator[Seen | None]:
        yield from self._seen
        raise LineClosed(GONE)


def test_a_run_that_ends_is_told_as_that_and_is_no_fault_of_who_looks() -> None:
    said: list[str] = []
    assert run_look(Ending([WALL, WALL]), "pty:./x", Wanted(), said.append) == 0
    assert said[-1].startswith("after 2 scans: the other end has closed the line: the run or the replay has ended")


@pytest.mark.parametrize("wanted", [Wanted(scans=3), Wanted(duration_s=1e6)])
def test_whoever_wanted_more_than_came_is_told_with_an_error(wanted: Wanted) -> None:
    with pytest.raises(LineClosed, match="after 2 scans: the other end has closed the line"):
        run_look(Ending([WALL, WALL]), "pty:./x", wanted, lambda text: None)


def test_a_pty_whose_master_is_closed_says_that_the_run_has_ended_not_pyserial() -> None:
    master, slave = os.openpty()
    line = SerialLine(os.ttyname(slave), 9600)
    os.close(slave)
    os.close(master)
    for act in (lambda: line.read(0.0), lambda: line.write(b"x"), lambda: line.set_baud(38_400)):
        with pytest.raises(LineClosed, match="the run or the replay has ended"):
            act()
    line.close()
