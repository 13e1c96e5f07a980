"""The worked example of a closed loop: a small part of its page, and one drive in real time."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.system.nursery import SWITCH

pytestmark = pytest.mark.usefixtures("loops")
ROOT = Path(__file__).resolve().parents[2]
PROGRAM = ROOT / "docs/examples/brake/brake.py"


def rows(text: str) -> dict[tuple[str, str], list[float]]:
    """Weather and speed -> braked at, left, speed at impact; 0 where there is none."""
    cells = [[cell.strip() for cell in line.strip("|\n ").split("|")] for line in text.splitlines() if "| " in line]
    return {
        (one[0], one[1]): [0.0 if cell == "-" else float(cell) for cell in one[2:]]
        for one in cells
        if len(one) == 5 and one[1].isdecimal()
    }


def driven(folder: Path, *words: str) -> dict[tuple[str, str], list[float]]:
    environment = os.environ | {"PYTHONPATH": str(ROOT), SWITCH: "1"}  # a drive by arrays takes three times as long
    command = [sys.executable, str(PROGRAM), *words]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=280)
    assert done.returncode == 0, done.stdout + done.stderr
    return rows(done.stdout)


def test_what_is_driven_in_virtual_time_is_what_the_page_says(tmp_path: Path) -> None:
    page = rows((ROOT / "docs/brake.md").read_text(encoding="utf-8"))
    found = driven(tmp_path, "--weather", "clear", "--weather", "fog_15", "--speed", "30", "--speed", "50")
    assert len(found) == 4
    for key, value in found.items():  # compiled loops and arrays may differ in a count of a range
        assert all(abs(one - other) <= 1.01 for one, other in zip(value, page[key], strict=True)), (
            key,
            value,
            page[key],
        )
    assert found["clear", "50"][1] > 10
    assert found["fog_15", "50"][2] > 10


def test_it_stops_on_what_mrpts_driver_reads(tmp_path: Path, mrpt: Path) -> None:
    words = ("--weather", "clear", "--speed", "30", "--real", "--mrpt", str(mrpt / "mrpt_host"))
    braked_at, left, impact = driven(tmp_path, *words)["clear", "30"]
    assert impact == 0
    assert 15 < braked_at < 25
    assert left > 3


def test_it_stops_in_real_time_too(tmp_path: Path) -> None:
    braked_at, left, impact = driven(tmp_path, "--weather", "clear", "--speed", "30", "--real")["clear", "30"]
    assert impact == 0
    assert 15 < braked_at < 25
    assert left > 3
