"""Pages, help texts, messages and all texts of `protocols` use the field's words; home-made words do not come back."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from emulator.commands.cli import commands
from emulator.sensing import error_budget
from tests.docs import reading

OURS = {
    r"told|tells|untold": "reported, reports",
    r"spares?|spared|sparing": "saves, pruning",
    r"befalls?|befell": "incident",
    r"onlookers?|who looks on|looks? on": "observer",
    r"strangers?": "untrusted",
    r"twins?": "coplanar",
    r"so manieth": "every n-th",
    r"hung up on": "disconnected",
    r"at one go|hearing": "input budget, rate limit",
    r"depth there and back": "two-way optical depth",
    r"half a step and no": "half a quantization step",
    r"by arrays": "with numpy arrays",
    r"reads? aloud|aloud": "print",
    r"of ours|our own": "built-in, of lidaremu",
    r"stands? still|stood still": "hangs, stops",
    r"made to hurt": "malformed",
    r"one object an?|one json object an?|objects? a (?:line|scan|sensor|scenario)": "per",
    r"(?:rays|beams|scans|ms|us|times) a (?:second|beam|sweep|scan|sensor)": "per",
    r"goes wrong on purpose": "fault injection",
    r"put back": "restored",
    r"how right": "how accurate",
    r"suffer(?:s|ed|ing)?": "impair",
    r"telling": "sanitizing",
    r"patience": "time limit",
    r"nobody|whoever": "no host, no process, the caller",
    r"befallen": "impaired",
    r"deaf": "without input",
    r"heeds?|heeded": "follow",
    r"passe?s? over|passed over": "skip, ignore",
    r"anew": "again",
    r"gone with": "disconnected",
    r"turns? a second|scans? a second|bytes? a second": "per",
}
"""Home-made word, and what to write instead."""
PLAIN = re.compile(
    r"'(?:of ours|our own|nobody|whoever|pass(?:es|ed)? over|st(?:ands?|ood) still|gone with)'", re.IGNORECASE
)
"Plain English for a docstring, where it is no term."
ELSEWHERE = {"scoreboard.md"}
"Pages that a run of tests writes."


def left(text: str) -> list[str]:
    """Words of ours in a text; what stands in backquotes is a name and stays."""
    plain = re.sub(r"`[^`\n]*`", "", text)
    return [f"{found[0]!r}; want {want}" for ours, want in OURS.items() for found in _found(ours, plain)]


def _found(ours: str, text: str) -> Iterator[re.Match[str]]:
    return re.finditer(rf"\b(?:{ours})\b", text, re.IGNORECASE)


def notes_of(path: Path) -> Iterator[tuple[int, str]]:
    """Line and text of every docstring of a module, and of every string under a field."""
    for node, inside in nodes(ast.parse(path.read_text(encoding="utf-8")), None):
        if isinstance(inside, ast.Expr) and isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.lineno, node.value


def texts_of(path: Path, messages_alone: bool) -> Iterator[tuple[int, str]]:
    """Line and text of every string of a module; `messages_alone`: neither docstrings nor single words, as keys are."""
    for node, inside in nodes(ast.parse(path.read_text(encoding="utf-8")), None):
        if not isinstance(node, ast.Constant) or not isinstance(node.value, str):
            continue
        is_note = isinstance(inside, ast.Expr)
        if not messages_alone or (not is_note and " " in node.value):
            yield node.lineno, node.value


def nodes(node: ast.AST, inside: ast.AST | None) -> Iterator[tuple[ast.AST, ast.AST | None]]:
    """Every node with the one that it is in."""
    yield node, inside
    for below in ast.iter_child_nodes(node):
        yield from nodes(below, node)


def found_in(folder: str, messages_alone: bool) -> list[str]:
    """Home-made words in the strings of a package, with file and line."""
    return [
        f"{path.relative_to(reading.ROOT)}:{line}: {word}"
        for path in sorted((reading.ROOT / folder).rglob("*.py"))
        for line, text in texts_of(path, messages_alone)
        for word in left(text)
    ]


def helps(command: click.Command, name: str) -> Iterator[tuple[str, str]]:
    """Help text of a command, of its options, and of those below it."""
    yield name, command.help or ""
    for one in command.params:
        yield f"{name} {one.name}", getattr(one, "help", None) or ""
    if isinstance(command, click.Group):
        for below in command.commands.values():
            yield from helps(below, f"{name} {below.name}")


@pytest.mark.parametrize(
    "page", [one for one in reading.pages() if one.name not in ELSEWHERE], ids=lambda one: one.name
)
def test_pages_use_the_words_of_the_field(page: Path) -> None:
    lines = page.read_text(encoding="utf-8").splitlines()
    found = [f"{page.name}:{number}: {word}" for number, line in enumerate(lines, 1) for word in left(line)]
    assert not found, "\n".join(found)


def test_help_texts_use_the_words_of_the_field() -> None:
    found = [f"{name}: {word}" for name, text in helps(commands, "lidaremu") for word in left(text)]
    assert not found, "\n".join(found)


def test_the_error_budget_uses_the_words_of_the_field() -> None:
    found = [word for rule in error_budget.RULES for word in left(f"{rule.name}. {rule.when}. {rule.why}")]
    assert not found, "\n".join(found)


def test_every_text_of_the_protocols_uses_the_words_of_the_field() -> None:
    found = found_in("protocols", messages_alone=False)
    assert not found, "\n".join(found)


def test_messages_use_the_words_of_the_field() -> None:
    found = found_in("emulator", messages_alone=True)
    assert not found, "\n".join(found)


def test_every_docstring_of_the_emulator_uses_the_words_of_the_field() -> None:
    found = [
        f"{path.relative_to(reading.ROOT)}:{line}: {word}"
        for path in sorted((reading.ROOT / "emulator").rglob("*.py"))
        for line, text in notes_of(path)
        for word in left(text)
        if not PLAIN.match(word)
    ]
    assert not found, "\n".join(found)


def test_strings_of_a_module_are_read_with_their_lines(tmp_path: Path) -> None:
    module = tmp_path / "one.py"
    module.write_text('"""What is told."""\n\nKEY = "told"\nWHY = f"it is told {KEY}"\n', encoding="utf-8")
    assert [line for line, _ in texts_of(module, messages_alone=False)] == [1, 3, 4]
    assert [line for line, _ in texts_of(module, messages_alone=True)] == [4]


def test_a_home_made_word_is_found_and_a_name_in_backquotes_is_not() -> None:
    assert left("What befell it is told, 60 rays a beam.") == [
        "'told'; want reported, reports", "'befell'; want incident", "'rays a beam'; want per",
    ]  # fmt: skip
    assert left("key `told`, default true") == []
