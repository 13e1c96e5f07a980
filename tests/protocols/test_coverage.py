"""The coverage page is what the tables say."""

from __future__ import annotations

from pathlib import Path

import pytest

from protocols import FAMILIES, coverage, family
from protocols.session import CommandRow


def test_the_page_is_as_new_as_the_tables() -> None:
    written = coverage.PAGE.read_text(encoding="utf-8")
    assert written == coverage.page(), "write it anew: python -m protocols.coverage"


def test_every_family_has_its_section_with_every_command() -> None:
    page = coverage.page()
    for name in FAMILIES:
        section = page.partition(f"## {name}\n")[2].partition("\n## ")[0]
        for row in family(name).commands():
            assert f"| {row.code} |" in section


def test_a_bar_in_a_text_does_not_break_the_table() -> None:
    table = coverage.family_table([CommandRow("01", "a|b", "done", "listing\np. 3")])
    assert table.startswith("1 done\n")
    assert table.endswith("| 01 | a\\|b | done | listing p. 3 |  |")


def test_writing_gives_the_page(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(coverage, "PAGE", tmp_path / "COVERAGE.md")
    assert coverage.write().read_text(encoding="utf-8") == coverage.page()
