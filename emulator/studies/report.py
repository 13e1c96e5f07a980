"""What a study hands out: tables, pictures and words, written as one HTML page that needs nothing else, PNG and CSV.

Belongs here: the form. Not: numbers (the studies), how curves are drawn (drawing).
"""

from __future__ import annotations

import base64
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING

from emulator import __version__
from emulator.errors import EmulatorError
from emulator.output.csv_tables import Writer
from emulator.output.sanitizing import visible

if TYPE_CHECKING:
    import jinja2

Value = str | float | int | bool | None

NOTHING = "–"
"Stands for None in the page; the CSV leaves the field empty."


class Link(str):
    """A text in a table that leads to another page."""

    href: str

    def __new__(cls, text: str, href: str) -> Link:
        made = super().__new__(cls, text)
        made.href = href
        return made


@dataclass(frozen=True)
class Spot:
    """A place of a picture that leads to another page; from its upper left corner, as shares of its size."""

    left: float
    top: float
    href: str
    reported: str


@dataclass(frozen=True)
class Column:
    """One column of a table."""

    key: str
    "Head in the CSV, unit included: `range_m`."
    title: str
    "Head in the page."
    form: str = ".2f"
    "Format of numbers in the page; the CSV has all digits that matter."


@dataclass(frozen=True)
class Table:
    """Rows of one table; every row as long as `columns`."""

    name: str
    "Stem of the CSV file."
    title: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Value, ...], ...]
    note: str = ""

    def __post_init__(self) -> None:
        wrong = [row for row in self.rows if len(row) != len(self.columns)]
        if wrong:
            raise ValueError(f"{self.name}: row {wrong[0]!r}; want {len(self.columns)} values")

    def column(self, key: str) -> list[Value]:
        """The values of one column."""
        at = [column.key for column in self.columns].index(key)
        return [row[at] for row in self.rows]

    def numbers(self, key: str) -> list[float]:
        """The numbers of one column, those that are there."""
        return [float(value) for value in self.column(key) if isinstance(value, int | float)]


@dataclass(frozen=True)
class Picture:
    """A drawing."""

    name: str
    "Stem of the PNG file."
    title: str
    png: bytes
    caption: str = ""
    spots: tuple[Spot, ...] = ()

    @property
    def uri(self) -> str:
        """The picture itself as an address, so that the page needs no other file."""
        return "data:image/png;base64," + base64.b64encode(self.png).decode("ascii")


@dataclass(frozen=True)
class Section:
    """A chapter of the report."""

    title: str
    text: tuple[str, ...] = ()
    pictures: tuple[Picture, ...] = ()
    tables: tuple[Table, ...] = ()
    beside: tuple[Table, ...] = ()
    "Tables too long for the page: files alone."

    @property
    def anchor(self) -> str:
        """Its name inside the page."""
        return "".join(letter if letter.isalnum() else "-" for letter in self.title.lower())


@dataclass(frozen=True)
class Fact:
    """A number that is reported first, in large letters."""

    label: str
    value: str
    tone: str = ""
    "good | bad; empty: neither."


@dataclass(frozen=True)
class Report:
    """Everything a study found."""

    name: str
    title: str
    summary: tuple[str, ...]
    sections: tuple[Section, ...]
    closing: str = ""
    "Last line of the page; empty: where a study's tables and pictures are."
    lead: tuple[Picture, ...] = ()
    "Before everything else, in their own colours on a light page and on a dark one."
    facts: tuple[Fact, ...] = ()

    def table(self, name: str) -> Table:
        """One of its tables."""
        return next(table for section in self.sections for table in section.tables if table.name == name)


def percent(found: float, wanted: float) -> float:
    """Deviation of `found` from `wanted`. [%]"""
    return 100.0 * (found / wanted - 1.0)


def need_extra() -> None:
    """Raise `EmulatorError` where the libraries that reports need are not installed."""
    try:
        import jinja2  # noqa: F401
        import matplotlib  # noqa: F401
    except ImportError as error:
        raise EmulatorError(
            f"{error.name} is missing; studies need the extra: pip install 'lidaremu[report]'"
        ) from None


def prepare(out: Path) -> None:
    """Make the folder; said before the work rather than after it when it cannot be."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        probe = out / ".lidaremu-probe"
        probe.write_bytes(b"")
        probe.unlink()
    except OSError as error:
        raise EmulatorError(f"--out: {out}: {error.strerror}; want a folder that can be written") from None


def write(report: Report, out: Path) -> list[Path]:
    """Write page, pictures and tables; the files, page first."""
    path = out / f"{report.name}.html"
    try:
        path.write_text(page(report), encoding="utf-8")
    except OSError as error:
        raise EmulatorError(f"{path}: cannot be written: {error.strerror}") from None
    return [path, *write_parts(report, out)]


def write_parts(report: Report, out: Path) -> list[Path]:
    """Write pictures and tables; the files."""
    written: list[Path] = []
    try:
        for picture in (*report.lead, *(one for section in report.sections for one in section.pictures)):
            written.append(out / f"{picture.name}.png")
            written[-1].write_bytes(picture.png)
        for section in report.sections:
            for table in (*section.tables, *section.beside):
                written.append(out / f"{table.name}.csv")
                _write_csv(table, written[-1])
    except OSError as error:
        raise EmulatorError(f"{written[-1]}: cannot be written: {error.strerror}") from None
    return written


def page(report: Report) -> str:
    """The report as one HTML page without references to anything outside it."""
    return str(_template().render(report=report, version=__version__))


@cache
def _template() -> jinja2.Template:
    import jinja2

    source = (files("emulator.studies") / "report.html.j2").read_text(encoding="utf-8")
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, finalize=_tamed
    )
    environment.filters["shown"] = shown
    environment.filters["with_code"] = with_code
    return environment.from_string(source)


def _tamed(value: object) -> object:
    """A text as it is shown, whatever was in the recording."""
    return visible(value, "\n") if isinstance(value, str) and not hasattr(value, "__html__") else value


def with_code(text: str) -> str:
    """HTML of a text in which names of keys and commands stand between backticks."""
    import markupsafe

    return markupsafe.Markup(re.sub("`([^`]+)`", r"<code>\1</code>", str(markupsafe.escape(visible(text)))))


def shown(value: Value, form: str) -> str:
    """A value as the page has it."""
    if value is None:
        return NOTHING
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int | float):
        return format(value, form).replace("-", "−")
    return value


def _write_csv(table: Table, path: Path) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        Writer(file, {column.key: ".9g" for column in table.columns}).rows(table.rows)


def rows_of(values: Sequence[Sequence[Value]]) -> tuple[tuple[Value, ...], ...]:
    """Rows in the form that `Table` takes."""
    return tuple(tuple(row) for row in values)
