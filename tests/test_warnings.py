"""A law used outside its range is told to whoever runs the scenario, by every command that computes with it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from emulator.commands.cli import main

THIN = "front: fog: law naboulsi_advection: visibility 4000 m outside 50 to 1000 m"
DENSE = "front: fog: visibility 0.5 m: no law is physical below about 1 m"


@pytest.fixture
def scenario(tmp_path: Path) -> str:
    path = tmp_path / "haze.yaml"
    path.write_text(
        f"""
schema: 1
duration_s: 0.2
weather:
  fog: {{visibility_m: 4000, law: naboulsi_advection}}
  changes: [{{t_s: 0.1, fog: {{visibility_m: 0.5}}}}]
sensors:
  - {{id: front, model: sick-lms291-s05, links: ["pty:{tmp_path}/link"]}}
"""
    )
    return str(path)


def test_check_tells_the_range_of_a_law(scenario: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", scenario]) == 0
    reported = capsys.readouterr().err
    assert reported == f"lidaremu: {scenario}: warning: {THIN}\nlidaremu: {scenario}: warning: {DENSE}\n"
    assert main(["check", "--json", scenario]) == 0
    assert json.loads(capsys.readouterr().out)["warnings"] == [THIN, DENSE]


def test_test_tells_the_range_of_a_law(scenario: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["test", scenario]) == 0
    reported = capsys.readouterr().out
    assert reported.count(f"  warning: {THIN}\n") == reported.count(f"  warning: {DENSE}\n") == 1
    assert main(["test", "--json", "--workers", "1", scenario]) == 0
    assert json.loads(capsys.readouterr().out)["warnings"] == [THIN, DENSE]


def test_run_tells_the_range_of_a_law_once(scenario: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", scenario, "--duration", "0.2"]) == 0
    reported = capsys.readouterr().err
    assert reported.count(f"lidaremu: warning: {THIN}\n") == reported.count(f"lidaremu: warning: {DENSE}\n") == 1
