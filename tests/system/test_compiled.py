"""Runs whose sweeps are computed by compiled loops, as with the extra `fast`, against those by arrays."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from emulator.compiled.switch import SWITCH
from emulator.runtime.control import ask
from tests.system.conftest import TIME_LIMIT_S

pytest.importorskip("numba")

SCENARIOS = ("flat_wall", "gltf_yard")
NOTHING_BUILT = """\
from emulator.compiled import build
build.wanted = lambda: True
build.BODY = '''
import os, threading, time
from pathlib import Path
from emulator.compiled import build
Path("aside").write_text(str(os.getpid()))
Path("aside").rename("building")
def kernels():
    while not Path("go").exists():
        time.sleep(0.02)
    return True
build.body(kernels)
'''
"""
"Of each process of a run, in `sitecustomize.py`: as on a machine that has no loops yet, with a compiler that waits."


def started(on: str, cwd: Path, *arguments: str) -> subprocess.Popen[str]:
    """The program in a process of its own, with compiled loops or without."""
    return subprocess.Popen(
        [sys.executable, "-m", "emulator", *arguments],
        env={**os.environ, SWITCH: on}, cwd=cwd, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def ended(process: subprocess.Popen[str]) -> str:
    """What it wrote, once it ended well."""
    reported, wrong = process.communicate(timeout=300)
    assert process.returncode == 0, reported + wrong
    return reported


def test_shipped_scenarios_hold_and_mostly_send_the_same_bytes(tmp_path: Path) -> None:
    processes = [started(on, tmp_path, "test", *SCENARIOS, "--json") for on in "01"]
    rows = [[json.loads(line) for line in ended(process).splitlines()] for process in processes]
    by_arrays, by_loops = ({row["scenario"]: row for row in some if "scenario" in row} for some in rows)
    assert set(by_arrays) == set(by_loops) == set(SCENARIOS)
    for name, row in by_arrays.items():
        counts = [[(one["id"], one["scans_sent"]) for one in run["sensors"]] for run in (row, by_loops[name])]
        assert counts[0] == counts[1], name
    # a ray that meets the edge between two triangles may be told of either
    same = [name for name, row in by_arrays.items() if row["sha256"] == by_loops[name]["sha256"]]
    assert same


def test_a_run_in_real_time_uses_them_too(tmp_path: Path) -> None:
    reported = ended(started("1", tmp_path, "demo", "--scenario", "crossing_car", "--duration", "2"))
    assert "crossing_car" in reported or "front" in reported


@pytest.fixture
def first_start(tmp_path: Path) -> Any:
    """A run in real time on a machine that has no loops yet; its control socket."""
    (tmp_path / "sitecustomize.py").write_text(NOTHING_BUILT, encoding="utf-8")
    root = Path(__file__).resolve().parents[2]
    process = subprocess.Popen(
        [sys.executable, "-m", "emulator", "run", "flat_wall", "--link", f"front=pty:{tmp_path}/front", "--json"],
        env={**os.environ, SWITCH: "1", "PYTHONPATH": f"{tmp_path}{os.pathsep}{root}"},
        cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stdout is not None
    ready = json.loads(process.stdout.readline())
    yield process, Path(ready["control"].removeprefix("unix:"))
    process.kill()
    process.communicate()


def until(holds: Callable[[], bool]) -> None:
    end = time.monotonic() + TIME_LIMIT_S
    while not holds():
        assert time.monotonic() < end, "not in time"
        time.sleep(0.05)


def gone(pid: int) -> bool:
    """Ended: at most a zombie of another's."""
    try:
        return Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0] == "Z"
    except OSError:
        return True


def test_the_first_start_begins_with_arrays_and_goes_over_to_loops(first_start: Any, tmp_path: Path) -> None:
    process, control = first_start

    def status() -> Any:
        return ask(control, "status", {})

    until((tmp_path / "building").exists)
    assert [row["form"] for row in status()["workers"]] == ["arrays"]
    (tmp_path / "go").touch()
    until(lambda: [row["form"] for row in status()["workers"]] == ["loops"])
    until(lambda: gone(int((tmp_path / "building").read_text())))
    assert status()["incident_totals"] == {}
    time.sleep(1.0)  # it is reported with the next look at the processes
    process.send_signal(signal.SIGTERM)
    _, reported = process.communicate(timeout=TIME_LIMIT_S)
    assert process.returncode == 0
    assert [line.partition(" loops are ")[2][:13] for line in reported.splitlines()] == [
        "being built f",
        "in use; built",
    ]


@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGKILL])
def test_what_builds_ends_with_the_run(first_start: Any, tmp_path: Path, how: signal.Signals) -> None:
    process, _ = first_start
    until((tmp_path / "building").exists)
    process.send_signal(how)
    _, reported = process.communicate(timeout=TIME_LIMIT_S)
    assert process.returncode == (0 if how == signal.SIGTERM else -how), reported
    until(lambda: gone(int((tmp_path / "building").read_text())))
