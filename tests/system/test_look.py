"""`look` and `demo` as a person sees them: on a terminal of 80 x 24, through real links, every family."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import termios
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from emulator.runtime.control import ask
from tests.system.conftest import STANDING, TIME_LIMIT_S, RunningDaemon
from tests.system.nursery import begun, ran
from tests.system.terminals import Terminal


@pytest.fixture
def terminal(tmp_path: Path) -> Iterator[Callable[..., Terminal]]:
    """Starts commands on terminals; all are ended after the test."""
    opened: list[Terminal] = []

    def start(*arguments: str, **variables: str) -> Terminal:
        opened.append(Terminal(list(arguments), tmp_path, **variables))
        return opened[-1]

    yield start
    for one in opened:
        one.close()


def lidaremu(folder: Path, *arguments: str, seconds: float = 4 * TIME_LIMIT_S) -> subprocess.CompletedProcess[str]:
    return ran(*arguments, cwd=folder, seconds=seconds)


def test_an_lms2xx_is_drawn_obeys_keys_and_a_new_size_and_leaves_the_terminal_as_it_was(
    daemon: Callable[..., Any], terminal: Callable[..., Terminal]
) -> None:
    running = daemon("flat_wall")
    shown = terminal("look", f"pty:{running.path('front')}", "--baud", "38400")
    before = termios.tcgetattr(shown._master)
    # the wall reaches to 75 degrees
    wanted = re.compile(r" 4\.7/s  361 beams, 301 echoes  nearest (7\.9|8\.0)\d m  0 errors  \d:\d\d")
    text = shown.until(lambda text: wanted.match(text.splitlines()[-2]) is not None)
    assert "LMS291" in text.splitlines()[0]
    assert "q quit" in text.splitlines()[-1]
    assert len({colour for colour in shown.colours() if colour != "default"}) >= 4  # rings, and ranges of 8 to 31 m
    shown.press("+")
    shown.until(lambda text: "20 m" in text and "50 m" not in text)
    shown.press("p")
    shown.until(lambda text: "PAUSED" in text.splitlines()[0])
    shown.resize(60, 16)
    text = shown.until(lambda text: "q quit" in text.splitlines()[-1])
    assert len(text.splitlines()) == 16
    shown.press("q")
    assert shown.finish() == 0
    assert termios.tcgetattr(shown._master)[3] == before[3]
    assert b"\x1b[?1049l" in shown.raw
    assert b"\x1b[2J" not in shown.raw  # pages are drawn over each other: nothing flickers
    assert running.stop() == 0
    assert running.end["front"]["input_dropped"] == {}


def test_the_demo_respects_no_color_and_sigterm_tidies_up(terminal: Callable[..., Terminal]) -> None:
    shown = terminal("demo", NO_COLOR="1")
    shown.until(lambda text: "361 beams" in text)
    assert b"\x1b[38;" not in shown.raw
    shown.process.send_signal(signal.SIGTERM)
    assert shown.finish() == 0
    assert b"\x1b[?25h" in shown.raw
    assert "scans sent" in shown.text


def measured_late(running: RunningDaemon) -> bool:
    """Some list, or a scan that lists are made of, was not ready in time."""
    status: Any = ask(running.control, "status", {})
    return any(row["scans_dropped"].get("measured too late") for row in status["sensors"])


def test_objects_on_can_are_drawn_and_listed_while_others_are_read_by_socketcand_and_slcan(
    daemon: Callable[..., Any], terminal: Callable[..., Terminal], tmp_path: Path
) -> None:
    links = ("--link", "radar=socketcand:127.0.0.1:0/can0", "--link", f"radar=slcan:{tmp_path / 'adapter'}")
    running = daemon("fog_objects", *links, "--set", "weather.changes=[]")  # no fog yet, whenever the hosts come
    shown = terminal("look", running.link("radar"), "--family", "can_objects", "--extended")
    rated = re.compile(r" 13\.[34]/s")
    # whatever a busy machine measures too late, and counts, comes less often
    text = shown.until(lambda text: " car " in text and (rated.search(text) is not None or measured_late(running)))
    assert text.splitlines()[0].split() == ["can-ars408"]
    rows = [line.split()[-7:] for line in text.splitlines() if line.rstrip().endswith("100")]
    assert 4 <= len(rows) <= 5
    assert any(abs(float(row[1]) - 26.2) < 0.5 and abs(float(row[2]) + 0.6) < 0.5 for row in rows)  # the car
    found = lidaremu(
        tmp_path, "look", f"slcan:{tmp_path / 'adapter'}", "--family", "can_objects", "--scans", "3", "--json"
    )
    assert found.returncode == 0, found.stderr
    lists = [json.loads(line) for line in found.stdout.splitlines()]
    assert [row["number"] for row in lists] == [0, 1, 2]
    assert {row["event"] for row in lists} == {"objects"}
    assert any(abs(one["x_m"] - 26.2) < 0.5 for one in lists[-1]["objects"])
    shown.press("q")
    assert shown.finish() == 0


def test_a_picture_and_a_table_of_an_ld_are_written(daemon: Callable[..., Any], tmp_path: Path) -> None:
    running = daemon("bumper", *STANDING, "--set", "sensors.1.device.delays=fast", "--link", "ld=tcp:127.0.0.1:0")
    command = ("look", running.link("ld"), "--family", "ld", "--png", "ld.png", "--csv", "ld.csv")
    done = lidaremu(tmp_path, *command)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1].startswith("ld.png: 721 beams")
    assert (tmp_path / "ld.png").stat().st_size > 10_000
    rows = [row.split(",") for row in (tmp_path / "ld.csv").read_text().splitlines()]
    assert rows[0] == ["scan", "azimuth_deg", "range_m", "intensity", "time_s"]
    ahead = [row for row in rows[1:] if abs(float(row[1])) < 0.3]
    assert all(40.0 < float(row[2]) < 61.0 and float(row[3]) >= 16.0 for row in ahead)


def test_an_address_where_nothing_answers_is_told_with_what_was_tried(tmp_path: Path) -> None:
    master, slave = os.openpty()
    with socket.create_server(("127.0.0.1", 0)) as silent:
        port = silent.getsockname()[1]
        tried = {
            f"pty:{os.ttyname(slave)}": "tried 9600, 38400, 500000, 19200 baud",
            f"tcp:127.0.0.1:{port}": "no reply A0",
            f"socketcand:127.0.0.1:{port}/can0": "no greeting within",
        }
        processes = {
            url: begun("look", url, *(["--family", "can_objects"] if "can" in url else []), cwd=tmp_path, stdout=None)
            for url in tried
        }
        for url, process in processes.items():
            _, reported = process.communicate(timeout=TIME_LIMIT_S)
            assert process.returncode == 3, reported
            assert tried[url] in reported
            assert url in reported
    os.close(master)
    os.close(slave)


def test_the_demo_ends_by_itself_where_nobody_watches(tmp_path: Path) -> None:
    done = lidaremu(tmp_path, "demo", "--family", "can_objects", "--duration", "1.5")
    assert done.returncode == 0, done.stderr
    assert "scans sent" in done.stdout
    assert "can-ars408" in done.stdout
