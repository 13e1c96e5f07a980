"""Tables for spreadsheets: texts that would be formulas are texts, numbers are numbers; one place writes them."""

from __future__ import annotations

import ast
import csv
import io
import math
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from emulator.output.csv_tables import SIGNS, Cell, Writer, cell, text_of
from emulator.studies.report import Column, Report, Section, Table, write_parts

ROOT = Path(__file__).resolve().parent.parent.parent
FORMULAS = [
    ("=1+1", "'=1+1"),
    ("+1", "'+1"),
    ("-1", "'-1"),
    ("@SUM(A1)", "'@SUM(A1)"),
    ("  =1", "  '=1"),
    ("\t=1", r"\x09=1"),
    ("\r=1", r"\x0d=1"),
    ("\n=1", r"\x0a=1"),
    ("\u3000=1", r"\u3000=1"),
    ("＝1", "'＝1"),
    ("a;=1;b", "a;'=1;b"),
    ("a; @x", "a; '@x"),
    ('"=1', '"=1'),
]


@pytest.mark.parametrize(("text", "written"), FORMULAS)
def test_a_text_that_would_be_a_formula_is_a_text(text: str, written: str) -> None:
    assert cell(text) == written


@pytest.mark.parametrize("text", ["", "front", "a-b", "a = b", "'quoted", "10 dB, -3 dB", "–", "−1"])
def test_other_texts_stay(text: str) -> None:
    assert cell(text) == text


@pytest.mark.parametrize(
    ("value", "form", "written"),
    [
        (-1.5, "", "-1.5"),
        (-1.5, ".3f", "-1.500"),
        (np.float64(-2.0), ".9g", "-2"),
        (np.float32(-2.5), "g", "-2.5"),
        (-3, ".3f", "-3"),
        (np.int64(-3), "", "-3"),
        (-math.inf, "g", "-inf"),
        (math.nan, "g", ""),
        (None, "", ""),
        (True, "g", "yes"),
        (False, "", "no"),
    ],
)
def test_numbers_stay_numbers(value: Cell, form: str, written: str) -> None:
    assert cell(value, form) == written


def in_a_file(rows: list[list[Cell]]) -> list[list[str]]:
    file = io.StringIO()
    Writer(file, {f"c{number}": "" for number in range(len(rows[0]))}).rows(rows)
    file.seek(0)
    return list(csv.reader(file))[1:]


@given(st.lists(st.text(), min_size=1, max_size=4))
def test_every_text_is_read_again_and_no_cell_begins_a_formula(texts: list[str]) -> None:
    (row,) = in_a_file([list(texts)])
    for text, written in zip(texts, row, strict=True):
        assert not any(
            part.strip()[:1] in tuple(SIGNS.replace("\\", "")) for part in written.split(";") if part.strip()
        )
        assert written.isprintable()
        if text.isprintable() and "'" not in text:
            assert text_of(written) == text


def test_a_study_and_a_report_write_them_so(tmp_path: Path) -> None:
    columns = (Column("=key", "Key"), Column("n", "N"))
    table = Table("t", "T", columns, (("=cmd|' /C calc'!A0", -1.25), ("@x\n", 2)))
    write_parts(Report("r", "R", (), (Section("s", tables=(table,)),)), tmp_path)
    assert (tmp_path / "t.csv").read_text() == "'=key,n\n'=cmd|' /C calc'!A0,-1.25\n'@x\\x0a,2\n"


IMPORTS = re.compile(r"\b(?:csv|pandas|polars|xlsxwriter|openpyxl)\b")
"Without one of these words no file imports them: it need not be parsed."


READ = ("emulator/campaigns/factors.py",)
"Tables of users are read there."


def test_nobody_else_writes_tables() -> None:
    for path in (ROOT / "emulator").rglob("*.py"):
        writes_tables_by_the_one_place(path)


def writes_tables_by_the_one_place(path: Path) -> None:
    """Or none at all."""
    source, place = path.read_text(encoding="utf-8"), path.relative_to(ROOT).as_posix()
    imported = (
        set()
        if not IMPORTS.search(source)
        else {
            name.partition(".")[0]
            for node in ast.walk(ast.parse(source))
            for name in (
                [alias.name for alias in node.names]
                if isinstance(node, ast.Import)
                else [node.module or ""]
                if isinstance(node, ast.ImportFrom) and node.level == 0
                else []
            )
        }
    )
    assert ("csv" in imported) == (place in ("emulator/output/csv_tables.py", *READ)), place
    assert place not in READ or "csv.writer" not in source
    assert not imported & {"pandas", "polars", "xlsxwriter", "openpyxl"}, place
    if '.csv"' in source:
        assert "from emulator.output.csv_tables import" in source, f"{place}: a table that the one place does not write"
    assert "savetxt" not in source, place
    assert "to_csv" not in source, place
