"""A terminal to draw on: the alternate screen, colours as far as the terminal has them, keys without Enter.

Belongs here: how a page comes onto a terminal. Not: what is on it. Rich decides about colours (`NO_COLOR`, `TERM`).
"""

from __future__ import annotations

import os
import select
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import groupby
from typing import Any

from rich.console import Console
from rich.live import Live
from rich.text import Text

from emulator.looking.plot import FRAME, LABEL, LEVELS, NOTHING, Drawing
from emulator.output.sanitizing import raw, visible

PALETTE = (27, 33, 38, 43, 48, 82, 154, 220, 208, 196)
"Colours of levels 0 to LEVELS - 1, numbers of the 256: blue, green, yellow, red. Rich takes the nearest on less."
assert len(PALETTE) == LEVELS

STYLES = {NOTHING: "", FRAME: "color(240)", LABEL: "bold"} | {
    level: f"color({colour})" for level, colour in enumerate(PALETTE)
}


def drawable() -> bool:
    """Whether standard output is a terminal on which pages can be drawn over each other."""
    return sys.stdout.isatty() and os.environ.get("TERM", "") not in ("", "dumb", "unknown")


@dataclass(frozen=True)
class Page:
    """What is shown: a title, a drawing, text beside it, two lines below."""

    title: str
    drawing: Drawing
    beside: tuple[str, ...] = ()
    status: str = ""
    keys: str = ""


def plain(page: Page, columns: int) -> str:
    """A page as lines without colours, for a file or a pipe."""
    beside = [*page.beside, *[""] * len(page.drawing.lines)]
    lines = [
        (line + ("  " + text if text else "")).rstrip("⠀ ")
        for line, text in zip(page.drawing.lines, beside, strict=False)
    ]
    return "\n".join([page.title[:columns], *lines, page.status])


class Screen:
    """Pages on a terminal, drawn over each other without blanking it."""

    def __init__(self, console: Console | None = None) -> None:
        self._console = console or Console(file=raw(sys.stdout))
        self._live = Live(screen=True, auto_refresh=False, console=self._console, vertical_overflow="crop")

    def __enter__(self) -> Screen:
        self._live.__enter__()
        return self

    def __exit__(self, *args: Any) -> None:
        self._live.__exit__(*args)

    @property
    def size(self) -> tuple[int, int]:
        """Columns and rows, as they are now."""
        return self._console.size.width, self._console.size.height

    def update(self, page: Page) -> None:
        """Show a page."""
        columns, rows = self.size
        text = Text(no_wrap=True, overflow="crop", end="")
        text.append(f"{visible(page.title)[:columns]}\n", style="bold")
        beside = [*map(visible, page.beside), *[""] * len(page.drawing.lines)]
        for line, levels, more in zip(page.drawing.lines, page.drawing.levels.tolist(), beside, strict=False):
            at = 0
            for level, run in groupby(levels):
                length = len(list(run))
                text.append(line[at : at + length], style=STYLES.get(level, ""))
                at += length
            text.append(f"  {more}\n" if more else "\n", style="reverse" if more and more is beside[0] else "")
        text.append(visible(page.status)[:columns])
        if rows > 12 and page.keys:
            text.append("\n" + page.keys[:columns], style="color(245)")
        self._live.update(text, refresh=True)


class Keys:
    """Single keys of a terminal; none where standard input is no terminal."""

    def __init__(self, descriptor: int | None) -> None:
        self._descriptor = descriptor

    def read(self) -> str:
        """The keys pressed since the last call."""
        if self._descriptor is None or not select.select([self._descriptor], [], [], 0.0)[0]:
            return ""
        try:
            data = os.read(self._descriptor, 64)
        except OSError:  # of a terminal that has gone; select calls it readable for ever
            data = b""
        if not data:
            self._descriptor = None
        return data.decode("utf-8", "replace")


@contextmanager
def single_keys() -> Iterator[Keys]:
    """Keys come as they are pressed and are not echoed; the terminal is left as it was found."""
    try:
        descriptor = sys.stdin.fileno()
        terminal = os.isatty(descriptor)
    except (OSError, ValueError, AttributeError):
        terminal = False
    if not terminal:
        yield Keys(None)
        return
    import termios
    import tty

    before = termios.tcgetattr(descriptor)
    try:
        tty.setcbreak(descriptor)
        yield Keys(descriptor)
    finally:
        with suppress(termios.error):  # it has gone
            termios.tcsetattr(descriptor, termios.TCSADRAIN, before)
