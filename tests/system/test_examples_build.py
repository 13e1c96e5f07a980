"""The worked examples of the pages, as their reader would take them: installed, tested, read over a link."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "docs/examples"


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Environment in which the example's wheel is installed in a folder of its own."""
    source = tmp_path_factory.mktemp("source") / "acme_family"
    shutil.copytree(EXAMPLES / "acme_family", source, ignore=shutil.ignore_patterns("build", "*.egg-info", "__*"))
    target = tmp_path_factory.mktemp("target")
    pip = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-build-isolation", "--no-index"]
    subprocess.run([*pip, "-t", str(target), str(source)], check=True, timeout=240, capture_output=True)
    return os.environ | {"PYTHONPATH": os.pathsep.join((str(target), str(ROOT)))}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for path in (*EXAMPLES.glob("*.yaml"), *EXAMPLES.glob("acme_family/*.yaml")):
        shutil.copy(path, tmp_path)
    return tmp_path


def lidaremu(*arguments: str, folder: Path, environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "emulator", *arguments]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=240)


def test_every_example_holds_what_it_expects(installed: dict[str, str], folder: Path) -> None:
    names = ["wall.yaml", "court.yaml", "one_file.yaml", "step_out.yaml"]
    done = lidaremu("test", *names, "--jobs", "1", folder=folder, environment=installed)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "4 passed" in done.stdout


def test_a_family_that_is_not_installed_is_told_with_the_line(folder: Path) -> None:
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = lidaremu("check", "wall.yaml", folder=folder, environment=environment)
    assert done.returncode == 2
    assert "wall.yaml:13: sensors.front.model" in done.stderr
    assert "which is not installed" in done.stderr


def test_the_installed_family_is_listed_and_looked_at_over_its_link(installed: dict[str, str], folder: Path) -> None:
    done = lidaremu("list", "commands", "acme", folder=folder, environment=installed)
    assert [line.split()[0] for line in done.stdout.splitlines()] == ["START", "STOP", "ID"]
    command = [sys.executable, "-m", "emulator", "run", "wall.yaml", "--json", "--duration", "300"]
    with subprocess.Popen(command, cwd=folder, env=installed, stdout=subprocess.PIPE, text=True) as daemon:
        try:
            assert daemon.stdout is not None
            assert json.loads(daemon.stdout.readline())["sensors"][0]["model"] == "acme-x2"
            look = ("look", "pty:./acme", "--family", "acme", "--scans", "3", "--json")
            done = lidaremu(*look, folder=folder, environment=installed)
        finally:
            daemon.terminate()
            daemon.communicate(timeout=60)
    assert done.returncode == 0, done.stderr
    scans = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(scans) == 3
    assert all(abs(scan["range_m"][0] - 8.0 / 0.70710678) < 0.05 for scan in scans)
    assert daemon.returncode == 0
