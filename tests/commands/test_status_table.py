"""`ctl` for people: a table on a terminal, JSON elsewhere, and the names of what runs. Daemons are played."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from emulator.commands.cli import main
from emulator.commands.status_table import lines_of
from emulator.errors import LinkError
from emulator.runtime import control

LINK = {"url": "pty:./front", "bytes_in": 31, "bytes_out": 273_347, "bytes_lost": 0}
SENSOR = {
    "id": "front", "scans_sent": 664, "scans_per_s": 37.5, "scans_dropped": {"line slower than the scan rate": 3},
    "replies_sent": 8, "input_dropped": {"no start byte": 9}, "lateness_us": {"sends": 671, "p99": 1234.0},
    "links": [LINK, {**LINK, "url": "tcp:127.0.0.1:1"}], "silent_s": 0.0,
}  # fmt: skip
STATUS: dict[str, Any] = {
    "scenario": "street", "clock": "real", "now_s": 12.34, "paused": False, "ends_at_s": 30.0, "sensors": [SENSOR],
    "workers": [{"worker": 0, "pid": 4711, "state": "ready"}], "recording": None,
    "incident_totals": {"sensor silent": 2},
}  # fmt: skip


def test_a_table_has_a_row_a_sensor_and_a_row_for_each_further_link() -> None:
    reported = lines_of(STATUS)
    assert reported[0] == "street: 12.3 s, real clock, ends at 30 s"
    assert reported[2].split() == "sensor scans rate dropped replies late p99 silent link in out".split()
    assert reported[3].split() == "front 664 37.50/s 3 8 1.23 ms - pty:./front 31 B 273.3 kB".split()
    assert reported[4].split() == "tcp:127.0.0.1:1 31 B 273.3 kB".split()
    assert reported[2].index("link") == reported[3].index("pty:") == reported[4].index("tcp:")
    assert "front: dropped: 3 line slower than the scan rate" in reported
    assert "front: input not taken: 9 no start byte" in reported
    assert reported[-2:] == ["workers: 0 ready (pid 4711)", "incidents: 2 sensor silent"]


def test_a_sensor_without_links_or_rate_has_its_row_too() -> None:
    bare = STATUS | {"sensors": [{"id": "x", "scans_sent": 0, "scans_per_s": None}], "workers": [], "ends_at_s": None}
    reported = lines_of(bare | {"paused": True, "clock": "virtual"})
    assert reported[0] == "street: 12.3 s, virtual clock, paused"
    assert reported[3].split() == ["x", "0", "-", "0", "-", "-", "-", "-", "-", "-"]


REPORTED = [(True, (), True), (True, ("--json",), False), (False, (), False)]


@pytest.fixture
def daemons(monkeypatch: pytest.MonkeyPatch) -> dict[Path, Any]:
    found: dict[Path, Any] = {Path("/run/a.sock"): STATUS}

    def ask(path: Path, method: str, params: Mapping[str, Any], time_limit_s: float = 0.0) -> object:
        if found[path] is None:
            raise LinkError(f"{path}: no daemon answers")
        return found[path]

    monkeypatch.setattr(control, "running", lambda: list(found))
    monkeypatch.setattr(control, "ask", ask)
    return found


@pytest.mark.parametrize(("terminal", "words", "table"), REPORTED)
def test_a_terminal_gets_the_table_and_a_pipe_json(
    daemons: dict[Path, Any],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    terminal: bool,
    words: tuple[str, ...],
    table: bool,
) -> None:
    monkeypatch.setattr(sys.stdout, "isatty", lambda: terminal)
    assert main(["ctl", "status", *words]) == 0
    out = capsys.readouterr().out
    if table:
        assert out.startswith("street: 12.3 s")
    else:
        assert json.loads(out) == STATUS


def test_which_daemon_names_the_scenarios(daemons: dict[Path, Any], capsys: pytest.CaptureFixture[str]) -> None:
    daemons[Path("/run/b.sock")] = {"clock": "real"}
    daemons[Path("/run/c.sock")] = None
    assert main(["ctl", "status"]) == 3
    reported = capsys.readouterr().err
    for part in (
        "street at /run/a.sock",
        "an older daemon at /run/b.sock",
        "does not answer at /run/c.sock",
        "--socket",
    ):
        assert part in reported


def test_a_step_that_brought_nothing_says_why_beside_its_json(
    daemons: dict[Path, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    daemons[Path("/run/a.sock")] = {"scans": 0, "why": "0 scans within 10 virtual s; front: no host is connected"}
    assert main(["ctl", "step", "scans=1"]) == 0
    both = capsys.readouterr()
    assert json.loads(both.out)["scans"] == 0
    assert "front: no host is connected" in both.err
