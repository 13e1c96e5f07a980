"""The fifty example scenarios: all understood, one of each kind run."""

from __future__ import annotations

from pathlib import Path

import pytest

from emulator.commands.cli import main
from emulator.judging.examples import texts, write
from emulator.judging.expectations import understand
from emulator.judging.trial import run_trial
from emulator.scenario import scenario

TEXTS = dict(texts())
KINDS = (
    "lms291_clear_3m_100",
    "lms291_haze_6m_050",
    "lms291_rain_20m_025",
    "lms200_30106",
    "lms221_30206",
    "ld_20hz_200",
)


def test_there_are_fifty_and_every_one_is_good(tmp_path: Path) -> None:
    paths = write(tmp_path)
    assert len(paths) == len(TEXTS) == 50
    for path in paths:
        assert len(understand(scenario.load(str(path)))) >= 5


@pytest.mark.parametrize("name", KINDS)
def test_what_the_closed_form_says_holds(name: str) -> None:
    found = run_trial(scenario.loads(TEXTS[name], Path("case.yaml")))
    assert [(item.name, item.found) for item in found.judgements if not item.held] == []


def test_a_test_without_scenarios_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["test"]) == 2
    assert "--examples" in capsys.readouterr().err
