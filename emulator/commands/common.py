"""What commands share: exit codes, lines for the user, options of every command that reads a scenario."""

from __future__ import annotations

import contextlib
import math
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import click

from emulator.errors import EmulatorError
from emulator.output.sanitizing import put, raw, visible

if TYPE_CHECKING:
    from emulator.scenario.scenario import Scenario

OK, FAILED, CANNOT_RUN, LINK_LOST = 0, 1, 2, 3
LONGEST_S = 1e9
"Of a duration on the command line: thirty years, in nanoseconds still a 64 bit number."


class Finite(click.FloatRange):
    """A number within bounds; click itself lets NaN pass."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """The number, or a refusal."""
        found = float(super().convert(value, param, ctx))
        if math.isnan(found):
            self.fail(f"{value!r}; want a number", param, ctx)
        return found


def complain(error: EmulatorError, head: str = "lidaremu: ") -> None:
    """An error's lines, on standard error."""
    with contextlib.suppress(BrokenPipeError, EmulatorError):
        put(sys.stderr, [f"{head}{line}" for line in error.lines])


def complain_of_use(error: click.ClickException) -> None:
    """What is wrong with the arguments, as reported by click, on one line; of a missing subcommand the help."""
    lines = []
    context = getattr(error, "ctx", None)
    if context is not None and isinstance(error, getattr(click.exceptions, "NoArgsIsHelpError", ())):  # click 8.2 on
        with contextlib.suppress(BrokenPipeError, EmulatorError):
            put(sys.stderr, context.get_help().split("\n"))
        return
    if context is not None:
        lines = [
            *context.get_usage().split("\n"),
            f"Try '{context.command_path} {context.help_option_names[0]}' for help.",
            "",
        ]
    text = error.format_message()
    if isinstance(error, click.MissingParameter):  # a list of choices has lines and tabs
        text = " ".join(text.split())
    with contextlib.suppress(BrokenPipeError, EmulatorError):
        put(sys.stderr, [*lines, f"Error: {text}"])


@contextmanager
def bar(title: str) -> Iterator[Callable[..., None]]:
    """A bar on standard error where that is a terminal; called with the share that is done, and a text
    behind the title; it is drawn again then.

    No thread draws it: some of the work forks. What is said meanwhile stays on standard output, redirected or not.
    """
    if not sys.stderr.isatty():
        yield lambda share, text="": None
        return
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import Progress

    with Progress(
        console=Console(file=raw(sys.stderr)), transient=True, auto_refresh=False, redirect_stdout=sys.stdout.isatty()
    ) as shown:
        task = shown.add_task(escape(visible(title)), total=1.0)
        shown.refresh()

        def tell(share: float, text: str = "") -> None:
            shown.update(task, completed=share, description=escape(visible(f"{title} {text}" if text else title)))
            shown.refresh()

        yield tell


def part_of(progress: Callable[[float], None], done: int, of: int) -> Callable[[float], None]:
    """Passes on the share of one of several things as that of the whole."""
    return lambda share: progress((done + share) / of)


def scenario_options(function: Any) -> Any:
    """Options common to all commands that read a scenario."""
    for option in (
        click.option("--set", "overrides", multiple=True, metavar="a.b=c", help="Set any key of the scenario."),
        click.option("--seed", type=int, help="Seed of all random numbers."),
        click.option("--link", "links", multiple=True, metavar="SENSOR=URL", help="Replace the links of that sensor."),
    ):
        function = option(function)
    return function


def load_scenario(name: str, overrides: Sequence[str], seed: int | None, links: Sequence[str]) -> Scenario:
    """The scenario of that path or built-in name, with the command line's changes."""
    from emulator.scenario import scenario

    return scenario.load(name, overrides, seed, links_of(links))


def links_of(links: Sequence[str]) -> dict[str, list[str]]:
    """Sensor -> its links, of `--link SENSOR=URL`; `click.BadParameter` for other forms."""
    replaced: dict[str, list[str]] = {}
    for text in links:
        sensor, separator, url = text.partition("=")
        if not separator or not sensor or not url:
            raise click.BadParameter(f"{text!r}; want SENSOR=URL", param_hint="--link")
        replaced.setdefault(sensor, []).append(url)
    return replaced
