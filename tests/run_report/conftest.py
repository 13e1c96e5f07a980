"""Recordings that tests of the report look at, each made once in virtual time."""

from __future__ import annotations

from pathlib import Path

import pytest

from emulator.judging.trial import run_trial
from emulator.scenario import scenario as scenario_file


@pytest.fixture(scope="session")
def wall(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two seconds of `flat_wall`."""
    folder = tmp_path_factory.mktemp("recordings") / "wall"
    run_trial(scenario_file.load("flat_wall", ["duration_s=2"]), record=folder)
    return folder


@pytest.fixture(autouse=True)
def _coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures of few dots: drawn just so, in a fifth of the time."""
    monkeypatch.setattr("emulator.studies.drawing.DPI", 30)


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are put together and not drawn, which is what takes time."""
    monkeypatch.setattr("emulator.run_report.figures.png", lambda made: b"\x89PNG\r\n\x1a\n")
