"""The coverage page: every command of every family: implemented, refused or absent, with its source.

Generated from the tables that dispatch the commands, so the two cannot differ. `python -m
protocols.coverage` rewrites `COVERAGE.md`; a test fails while the file differs from the tables.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from importlib.util import find_spec
from pathlib import Path

from protocols import FAMILIES, family
from protocols.session import CommandRow

PAGE = Path(__file__).with_name("COVERAGE.md")

HEAD = """# Commands

Made by `python -m protocols.coverage` from the command tables; do not edit.

- done: answered as the device answers it.
- refused: named, but without a printed layout even in the maker's listing, reserved there, or for the factory only;
  answered with the device's own refusal.
- absent: not a command of this family, though a relative has it; answered like any unknown command.
"""


def family_table(rows: Iterable[CommandRow]) -> str:
    """One family's commands as a Markdown table, with the count of each status above it."""
    listed = list(rows)
    counts = Counter(row.status for row in listed)
    lines = [", ".join(f"{counts[status]} {status}" for status in ("done", "refused", "absent") if counts[status])]
    lines += ["", "| code | command | status | source | note |", "|---|---|---|---|---|"]
    for row in listed:
        cells = (row.code, row.name, row.status, row.source, row.note)
        lines.append("| " + " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in cells) + " |")
    return "\n".join(lines)


def page() -> str:
    """The whole page. A family whose module is not part of this installation has no section."""
    sections = [
        f"## {name}\n\n{family_table(family(name).commands())}\n"
        for name, module in FAMILIES.items()
        if find_spec(module) is not None
    ]
    return "\n".join([HEAD, *sections])


def write() -> Path:
    """Write the page into the package; where it is."""
    PAGE.write_text(page(), encoding="utf-8")
    return PAGE


if __name__ == "__main__":
    write()
