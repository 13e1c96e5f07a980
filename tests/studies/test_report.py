"""Form of a report: pages and CSV files that say what they were given."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from emulator.errors import EmulatorError
from emulator.studies import drawing, report
from emulator.studies.report import Column, Picture, Report, Section, Spot, Table


def small(text: str = "a & b") -> Report:
    columns = (Column("name", "name"), Column("range_m", "range (m)", "+.1f"), Column("seen", "seen"))
    table = Table("numbers", "Some <numbers>", columns, ((text, -1.26, True), ("none", None, False)), "note")
    made, (axes,) = drawing.figure()
    axes.plot([0, 1], [0, 1])
    return Report(
        "small",
        "Title",
        ("Summary",),
        (Section("One: 1", ("Words",), (Picture("p", "P", drawing.png(made)),), (table,)),),
    )


def test_a_page_escapes_what_it_is_given_and_shows_numbers_in_their_form() -> None:
    page = report.page(small('<b onload="x">'))
    assert "<b onload" not in page
    assert "Some &lt;numbers&gt;" in page
    assert "−1.3" in page
    assert report.NOTHING in page
    assert 'href="#one--1"' in page
    assert 'id="one--1"' in page


def test_places_of_a_picture_lead_elsewhere() -> None:
    spot = Spot(0.25, 0.5, "case/index.html", "the <first> case")
    section = Section("One", (), (Picture("p", "P", b"", spots=(spot,)),), ())
    page = report.page(Report("small", "Title", (), (section,)))
    assert 'href="case/index.html" title="the &lt;first&gt; case" aria-label="the &lt;first&gt; case"' in page
    assert 'style="left:25.00%;top:50.00%"' in page


def test_a_csv_file_keeps_all_digits_and_leaves_empty_what_is_not_there(tmp_path: Path) -> None:
    written = report.write(small(), tmp_path)
    assert [path.name for path in written] == ["small.html", "p.png", "numbers.csv"]
    with (tmp_path / "numbers.csv").open(encoding="utf-8", newline="") as file:
        assert list(csv.reader(file)) == [["name", "range_m", "seen"], ["a & b", "-1.26", "yes"], ["none", "", "no"]]


def test_the_same_drawing_gives_the_same_bytes() -> None:
    assert small().sections[0].pictures[0].png == small().sections[0].pictures[0].png


def test_a_row_of_another_length_is_refused() -> None:
    with pytest.raises(ValueError, match="want 1 values"):
        Table("t", "T", (Column("a", "a"),), ((1.0, 2.0),))


def test_columns_are_found_by_their_key() -> None:
    table = small().table("numbers")
    assert table.numbers("range_m") == [-1.26]
    assert table.column("seen") == [True, False]


def test_a_folder_that_is_a_file_is_an_error_with_its_name(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(EmulatorError, match="--out"):
        report.prepare(tmp_path / "file")
    report.prepare(tmp_path / "new" / "folder")
    assert list((tmp_path / "new" / "folder").iterdir()) == []


def test_names_between_backticks_are_code_and_nothing_else_becomes_html() -> None:
    pytest.importorskip("jinja2", reason="extra `report` is not installed")
    found = report.with_code("set `full: <b>` & `x`, a lone ` stays")
    assert found == "set <code>full: &lt;b&gt;</code> &amp; <code>x</code>, a lone ` stays"
