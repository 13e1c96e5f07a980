"""Tables as CSV files: the one place that writes them, so that a spreadsheet shows what it opens and computes nothing.

A cell that is a text and would begin a formula (`=`, `+`, `-`, `@`, also after blanks, after a semicolon, which parts
cells where a comma is the decimal sign, and in full width) has an apostrophe before that sign: spreadsheets and people
take the rest as text. Numbers stay numbers, negative ones too. Characters that are not printable are escapes
(`sanitizing.visible`), so that a row is a line. Who reads with a program takes the apostrophe off: `text_of`.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterable, Mapping
from numbers import Integral
from typing import IO

from emulator.output.sanitizing import visible

Cell = str | float | int | bool | None

SIGNS = "=+\\-@＝＋－＠"
FORMULA = re.compile(rf"(^|;)(\s*)(?=[{SIGNS}])")
QUOTED = re.compile(rf"(^|;)(\s*)'(?=[{SIGNS}])")


def cell(value: Cell, form: str = "") -> str:
    """One cell; `form`: of a number that is no whole one. Empty for None and NaN."""
    if value is None:
        return ""
    if isinstance(value, str):
        return FORMULA.sub(r"\1\2'", visible(value))
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, Integral):
        return str(int(value))
    return "" if math.isnan(value) else format(float(value), form)


def text_of(text: str) -> str:
    """The text that a cell was written from, where that was printable."""
    return QUOTED.sub(r"\1\2", text)


class Writer:
    """Writes rows of known columns into a file opened with `newline=""` and UTF-8."""

    def __init__(self, file: IO[str], columns: Mapping[str, str]) -> None:
        """`columns`: head, unit included, and format of its numbers."""
        self._writer = csv.writer(file, lineterminator="\n")
        self._forms = tuple(columns.values())
        self._writer.writerow(cell(head) for head in columns)

    def rows(self, rows: Iterable[Iterable[Cell]]) -> None:
        """Append rows, each as long as the columns. Raises `OSError`."""
        forms = self._forms
        self._writer.writerows([cell(value, form) for value, form in zip(row, forms, strict=True)] for row in rows)
