"""The wheel, installed into an environment of its own, runs the demo and every shipped scenario from another folder.

Built and installed without a network: libraries are borrowed from the environment of the tests. `.ci/wheel` does the
same with nothing borrowed, and judges every `expect`.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from emulator.scenario.scenario import builtin_names

pytestmark = pytest.mark.timeout(600)  # processes, one after the other, perhaps on a busy machine
ROOT = Path(__file__).resolve().parents[2]
PIP = (sys.executable, "-m", "pip")
OFFLINE = ("-q", "--no-deps", "--no-index", "--disable-pip-version-check")


def reported(command: list[str], folder: Path) -> str:
    """What a command prints; it ends well. Nothing of the project's folder reaches it."""
    environment = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=500)
    assert done.returncode == 0, f"{command}: {done.stdout[-2000:]}{done.stderr[-2000:]}"
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built from a copy: the project's folder stays as it is."""
    source = tmp_path_factory.mktemp("source")
    for name in ("emulator", "protocols", "scenarios"):
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    dist = tmp_path_factory.mktemp("dist")
    reported([*PIP, "wheel", *OFFLINE, "--no-build-isolation", "-w", str(dist), str(source)], dist)
    (built,) = dist.glob("lidaremu-*.whl")
    return built


@pytest.fixture(scope="module")
def lidaremu(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    """The command as installed."""
    place = tmp_path_factory.mktemp("fresh") / "venv"
    reported([sys.executable, "-m", "venv", "--without-pip", str(place)], place.parent)
    reported([*PIP, "--python", str(place / "bin/python"), "install", *OFFLINE, str(wheel)], place.parent)
    (site,) = place.glob("lib/python*/site-packages")
    libraries = [path for path in sys.path if path.endswith("site-packages")]
    (site / "borrowed.pth").write_text("\n".join(libraries) + "\n", encoding="utf-8")
    where = reported([str(place / "bin/python"), "-c", "import emulator; print(emulator.__file__)"], place.parent)
    assert where.startswith(str(site)), where
    return str(place / "bin/lidaremu")


def test_the_wheel_has_the_data_that_the_program_reads(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    suffixes = (".yaml", ".glb", ".dbc", ".c", ".j2", ".typed")
    folders = ("emulator", "protocols", "scenarios")
    wanted = {
        str(path.relative_to(ROOT))
        for folder in folders
        for path in (ROOT / folder).rglob("*")
        if path.suffix in suffixes or path.name == "py.typed"
    }
    assert len(wanted) > 50
    assert wanted <= names, wanted - names
    assert not [name for name in names if name.startswith(("tests", "docs"))]


def test_it_runs_the_demo_from_another_folder(lidaremu: str, tmp_path: Path) -> None:
    shown = reported([lidaremu, "demo", "--duration", "1"], tmp_path)
    assert "LMS291" in shown
    assert "361 beams" in shown
    assert "scans sent" in shown
    assert list(tmp_path.iterdir()) == []


def test_it_runs_every_shipped_scenario_from_another_folder(lidaremu: str, tmp_path: Path) -> None:
    names = builtin_names()
    assert len(names) >= 10
    tested = reported([lidaremu, "test", *names, "--duration", "0.3", "--set", "expect=[]", "--jobs", "1"], tmp_path)
    assert f"{len(names)} passed" in tested
