"""Long work shows how far it is on a terminal, on standard error alone, and nothing elsewhere."""

from __future__ import annotations

import io
import json
import re
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from emulator.commands.cli import main
from emulator.commands.common import bar
from emulator.output.lines import say

Begin = Callable[[], SimpleNamespace]
SCENARIO = """\
schema: 1
duration_s: 0.2
world:
  - {plane: {size_m: [6, 60]}, at_m: [8, 0, 1], pitch_deg: -90, material: white_plaster}
sensors:
  - {id: top, model: sick-ld-lrs1000, device: {step_deg: 8, delays: fast}, links: ["tcp:127.0.0.1:0"]}
"""


class Terminal(io.StringIO):
    """What a program takes for one."""

    terminal = True

    def isatty(self) -> bool:
        return self.terminal


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Callable[[], SimpleNamespace]:
    """Makes standard error a terminal, standard output a pipe; called within the test, as pytest has its own before."""

    def begin() -> SimpleNamespace:
        monkeypatch.setenv("TERM", "xterm")
        monkeypatch.setenv("COLUMNS", "100")
        for name in ("NO_COLOR", "FORCE_COLOR", "TTY_COMPATIBLE", "TTY_INTERACTIVE"):
            monkeypatch.delenv(name, raising=False)
        made = SimpleNamespace(screen=Terminal(), out=io.StringIO())
        monkeypatch.setattr(sys, "stderr", made.screen)
        monkeypatch.setattr(sys, "stdout", made.out)
        return made

    return begin


def shares(screen: io.StringIO) -> list[int]:
    """Per cents as drawn."""
    return [int(found) for found in re.findall(r"(\d+)%", screen.getvalue())]


@pytest.fixture
def scenario(tmp_path: Path) -> Path:
    path = tmp_path / "small.yaml"
    path.write_text(SCENARIO, encoding="utf-8")
    return path


def test_a_bar_is_drawn_on_a_terminal_and_lines_stay_on_standard_output(terminal: Begin) -> None:
    seen = terminal()
    with bar("work") as progress:
        say("a line")
        progress(0.5)
    assert seen.out.getvalue() == "a line\n"
    assert sorted(set(shares(seen.screen))) == [0, 50]
    assert "work" in seen.screen.getvalue()


def test_elsewhere_nothing_is_drawn(capsys: pytest.CaptureFixture[str]) -> None:
    with bar("work") as progress:
        progress(0.5)
    assert capsys.readouterr() == ("", "")


def test_scenarios_tell_how_far_they_are_and_stay_the_same(terminal: Begin, scenario: Path) -> None:
    seen = terminal()
    assert main(["test", str(scenario), "--json"]) == 0
    drawn = shares(seen.screen)
    assert len(set(drawn)) > 20
    assert drawn == sorted(drawn)
    reported = json.loads(seen.out.getvalue())
    seen.out.truncate(0)
    seen.out.seek(0)
    seen.screen.terminal = False
    before = len(seen.screen.getvalue())
    assert main(["test", str(scenario), "--json"]) == 0
    assert json.loads(seen.out.getvalue())["sha256"] == reported["sha256"]
    assert len(seen.screen.getvalue()) == before


def test_what_is_explained_is_told_on_the_way(terminal: Begin, scenario: Path) -> None:
    seen = terminal()
    assert main(["explain", str(scenario), "--json"]) == 0
    assert len(set(shares(seen.screen))) > 5
    assert json.loads(seen.out.getvalue())["sensor"] == "top"


def test_fuzzing_and_soaks_tell_how_far_they_are(terminal: Begin) -> None:
    seen = terminal()
    assert main(["study", "fuzz", "--seconds", "0.05", "--parser", "links", "--parser", "yaml", "--json"]) == 0
    assert {50, 100} <= set(shares(seen.screen))
    rows = [json.loads(line) for line in seen.out.getvalue().splitlines()]
    assert [row["parser"] for row in rows] == ["links", "yaml"]


def test_replays_and_reports_tell_how_far_they_are(
    terminal: Begin, scenario: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    seen = terminal()
    assert main(["test", str(scenario), "--duration", "2.5", "--record", "runs"]) == 0
    seen.screen.truncate(0)
    assert main(["replay", "runs/small", "--at-once", "--speed", "20", "--link", "top=loop:x"]) == 0
    assert shares(seen.screen)
    seen.screen.truncate(0)
    assert main(["report", "runs/small", "--no-truth"]) == 0
    assert shares(seen.screen)


def test_a_line_said_on_a_terminal_does_not_share_one_with_the_bar(
    terminal: Begin, monkeypatch: pytest.MonkeyPatch
) -> None:
    made, raw = terminal(), io.BytesIO()
    whole = io.TextIOWrapper(raw, encoding="utf-8")  # with bytes below it, as the real one
    monkeypatch.setattr(whole, "isatty", lambda: True)
    monkeypatch.setattr(sys, "stdout", whole)
    with bar("work") as tell:
        tell(0.3)
        say("a line")
        tell(0.6)
    assert raw.getvalue() == b""
    text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", made.screen.getvalue()).replace("\r", "\n")
    assert "a line" in text.splitlines()
