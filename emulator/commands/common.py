"""What commands share: exit codes, lines for the user, options of every command that reads a scenario."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from emulator.scenario import Scenario

OK, FAILED, CANNOT_RUN, LINK_LOST = 0, 1, 2, 3


def say(text: str) -> None:
    """One line for the user, at once."""
    click.echo(text)
    sys.stdout.flush()


def note(text: str) -> None:
    """One line of the log, on standard error."""
    click.echo(f"lidaremu: {text}", err=True)


def scenario_options(function: Any) -> Any:
    """Options common to all commands that read a scenario."""
    for option in (
        click.option("--set", "overrides", multiple=True, metavar="a.b=c", help="Set any key of the scenario."),
        click.option("--seed", type=int, help="Seed of every random draw."),
        click.option("--link", "links", multiple=True, metavar="SENSOR=URL", help="Replace that sensor's links."),
    ):
        function = option(function)
    return function


def load_scenario(name: str, overrides: Sequence[str], seed: int | None, links: Sequence[str]) -> Scenario:
    """The scenario of that path or built-in name, with the command line's changes."""
    from emulator import scenario

    replaced: dict[str, list[str]] = {}
    for text in links:
        sensor, separator, url = text.partition("=")
        if not separator or not sensor or not url:
            raise click.BadParameter(f"{text!r}; want SENSOR=URL", param_hint="--link")
        replaced.setdefault(sensor, []).append(url)
    return scenario.load(name, overrides, seed, replaced)
