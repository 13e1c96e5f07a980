"""docs/report.md and docs/look.md: the report's commands are run as they stand, those of `look` are taken apart."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import click
import pytest

from emulator.commands.cli import commands, main
from emulator.looking.look_files import OBJECT_COLUMNS, SCAN_COLUMNS

DOCS = Path(__file__).resolve().parents[2] / "docs"


def lines_of(name: str) -> list[list[str]]:
    """Command lines of a page; what stands behind several blanks explains them."""
    text = (DOCS / name).read_text(encoding="utf-8")
    found = [re.split(r"\s{3,}", line.strip())[0] for line in text.splitlines() if line.startswith("    lidaremu ")]
    return [shlex.split(line)[1:] for line in found]


@pytest.mark.usefixtures("undrawn")
def test_the_commands_of_the_reports_page_work_one_after_the_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    reported = lines_of("report.md")
    assert len(reported) == 4
    for arguments in reported:
        assert main(arguments) == 0, capsys.readouterr().err
    assert {"crossing_car.html", "crossing.html", "crossing", "runs"} <= {path.name for path in tmp_path.iterdir()}
    assert (tmp_path / "crossing" / "front_ranges.csv").exists()


def test_every_command_of_the_page_on_look_is_understood() -> None:
    reported = lines_of("look.md")
    assert len(reported) == 10
    for name, *arguments in reported:
        command = commands.commands[name]
        with command.make_context(name, list(arguments)) as context:
            assert isinstance(context, click.Context)


def test_every_column_of_the_csv_is_on_the_page() -> None:
    text = (DOCS / "look.md").read_text(encoding="utf-8")
    for column in (*SCAN_COLUMNS, *OBJECT_COLUMNS):
        assert f"`{column}`" in text
