"""Runs whose sweeps are computed by compiled loops, as with the extra `fast`, against those by arrays."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from emulator.compiled.switch import SWITCH

pytest.importorskip("numba")

SCENARIOS = ("flat_wall", "gltf_yard")


def started(on: str, cwd: Path, *arguments: str) -> subprocess.Popen[str]:
    """The program in a process of its own, with compiled loops or without."""
    return subprocess.Popen(
        [sys.executable, "-m", "emulator", *arguments],
        env={**os.environ, SWITCH: on}, cwd=cwd, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def ended(process: subprocess.Popen[str]) -> str:
    """What it wrote, once it ended well."""
    told, wrong = process.communicate(timeout=300)
    assert process.returncode == 0, told + wrong
    return told


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
    told = ended(started("1", tmp_path, "demo", "--scenario", "crossing_car", "--duration", "2"))
    assert "crossing_car" in told or "front" in told
