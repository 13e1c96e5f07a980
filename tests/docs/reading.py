"""What stands in the pages: blocks of code, commands, links. Shared by the tests of the documentation."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
COMMAND = re.compile(r"^(?:\$ )?((?:lidaremu|python3? -m|python tests/|bash \.ci/|pip |docker |\.venv/bin/).*)$")
PLACEHOLDER = re.compile(r"^[<\[]|[|]|\.\.\.$|^[A-Z][A-Z_]*(?:\.\w+)?$")


@dataclass(frozen=True)
class Block:
    """One block of code of a page."""

    page: Path
    line: int
    language: str
    "As a fence says; empty: indented."
    text: str

    def __str__(self) -> str:
        return f"{self.page.relative_to(ROOT)}:{self.line}"


@dataclass(frozen=True)
class Command:
    """One line of a block that a reader would type."""

    place: str
    text: str
    "Without the prompt and what explains it."
    is_form: bool
    "It stands for many, as `lidaremu run SCENARIO [--record DIR]`, or among such."

    @property
    def words(self) -> list[str]:
        """As a shell takes them."""
        return shlex.split(self.text)


def pages() -> list[Path]:
    """All pages, as a reader meets them."""
    return [ROOT / "README.md", ROOT / "SECURITY.md", *sorted((ROOT / "docs").glob("*.md"))]


def blocks(page: Path) -> Iterator[Block]:
    """Fenced and indented blocks, in order; an indented one begins after an empty line."""
    lines = page.read_text(encoding="utf-8").splitlines()
    number = 0
    while number < len(lines):
        fence = re.match(r"^( *)(```+)(.*)$", lines[number])
        start = number
        if fence:
            number += 1
            while number < len(lines) and not lines[number].strip().startswith(fence[2]):
                number += 1
            text = [line.removeprefix(fence[1]) for line in lines[start + 1 : number]]
            number += 1
            yield Block(page, start + 2, fence[3].strip(), "\n".join(text) + "\n")
            continue
        if lines[number].startswith("    ") and (not start or not lines[start - 1].strip()):
            while number < len(lines) and (lines[number].startswith("    ") or not lines[number].strip()):
                number += 1
            text = [line[4:] for line in lines[start:number]]
            yield Block(page, start + 1, "", "\n".join(text).rstrip() + "\n")
            continue
        number += 1


def commands(block: Block) -> list[Command]:
    """Commands of a block, continued lines joined; three blanks end one, what follows explains it."""
    found = []
    if block.language not in ("", "sh", "console"):
        return []
    number = block.line
    for whole in re.sub(r"\\\n\s*", " ", block.text).splitlines():
        line = COMMAND.match(whole.strip())
        if line:
            found.append((number, re.split(r"(?<=\S)(?:   +|  +#)", line[1])[0].strip()))
        number += 1
    forms = [any(PLACEHOLDER.search(word) for word in text.split()[2:]) for _, text in found]
    among_forms = 2 * sum(forms) >= len(forms) > 1
    place = block.page.relative_to(ROOT)
    return [Command(f"{place}:{at}", text, form or among_forms) for (at, text), form in zip(found, forms, strict=True)]


def all_commands() -> list[Command]:
    """Of all pages."""
    return [one for page in pages() for block in blocks(page) for one in commands(block)]
