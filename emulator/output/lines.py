"""One line for the user, one line of the log: output of every process of the emulator.

Belongs here: single lines. Not: how foreign characters are shown (sanitizing), bars (commands.common).
"""

from __future__ import annotations

import contextlib
import sys

from emulator.errors import EmulatorError
from emulator.output.sanitizing import put


def say(text: str) -> None:
    """One line for the user, at once; above a bar that is being drawn."""
    put(sys.stdout, [text])


def note(text: str) -> None:
    """One line of the log, on standard error; dropped where nobody is left to read it."""
    with contextlib.suppress(BrokenPipeError, EmulatorError):
        put(sys.stderr, [f"lidaremu: {text}"])
