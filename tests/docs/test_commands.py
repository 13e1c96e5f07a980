"""Every command of the pages is one: its sub-command, options and arguments exist. `tests/system` runs them."""

from __future__ import annotations

import re
from contextlib import suppress

import click
import pytest

from emulator.commands.cli import commands
from tests.docs import reading
from tests.docs.reading import Command

OURS = [one for one in reading.all_commands() if one.text.startswith("lidaremu ")]
FORMS = list({one.text: one for one in OURS if one.is_form}.values())
WHOLE = list({one.text: one for one in OURS if not one.is_form}.values())


def found(words: list[str]) -> tuple[list[click.Command], list[str]]:
    """The commands that the first words name (`soak | fuzz`: two), and what is left."""
    at: list[click.Command] = [commands]
    rest = [word for word in words if word != "|"]
    while isinstance(at[0], click.Group) and rest:
        names = rest.pop(0).split("|")
        while rest and rest[0] in at[0].commands and names[0] in at[0].commands:
            names.append(rest.pop(0))
        at = [at[0].commands[name] for name in names]
    return at, rest


def test_there_are_commands_of_both_kinds() -> None:
    assert len(FORMS) > 15
    assert len(WHOLE) > 30


@pytest.mark.parametrize("command", FORMS, ids=lambda one: one.text[:60])
def test_what_a_form_names_exists(command: Command) -> None:
    at, rest = found(command.text.split()[1:])
    known = {name for one in at for option in one.params for name in (*option.opts, *option.secondary_opts)}
    text = " ".join(rest).partition(" -- ")[0]
    assert set(re.findall(r"--[a-z][a-z-]*", text)) <= known, command.place


@pytest.mark.parametrize("command", WHOLE, ids=lambda one: one.text[:60])
def test_a_whole_command_is_understood(command: Command) -> None:
    at, rest = found(command.words[1:])
    with at[0].make_context("lidaremu", rest):
        pass


def test_options_named_within_the_text_exist() -> None:
    for page in reading.pages():
        for text in re.findall(r"`lidaremu ([^`\n]+)`", page.read_text(encoding="utf-8")):
            at, rest = found([word for word in text.replace("...", "").split() if word != "--version"])
            known = {name for one in at for option in one.params for name in option.opts}
            named = set(re.findall(r"--[a-z][a-z-]*", " ".join(rest).partition(" -- ")[0]))
            assert named <= known, f"{page.name}: {text}"
            if not any(reading.PLACEHOLDER.search(word) for word in rest):
                with suppress(click.MissingParameter, click.exceptions.NoArgsIsHelpError):  # a name alone is fine
                    at[0].make_context("lidaremu", rest)
