"""Keys of a terminal: a pseudo-terminal that is pressed, and one that goes away."""

from __future__ import annotations

import os
import pty
import sys
import termios
from collections.abc import Iterator

import pytest

from emulator.looking.screen import single_keys


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[int, int]]:
    """Ends of a terminal: who presses, and our standard input."""
    presser, ours = pty.openpty()
    with os.fdopen(ours, closefd=False) as stream:
        monkeypatch.setattr(sys, "stdin", stream)
        yield presser, ours
    os.close(ours)


def test_keys_come_without_enter_and_the_terminal_is_left_as_it_was(terminal: tuple[int, int]) -> None:
    presser, ours = terminal
    before = termios.tcgetattr(ours)
    with single_keys() as keys:
        assert keys.read() == ""
        os.write(presser, b"q\x1b[A\xff")
        assert keys.read() == "q\x1b[A\ufffd"
        assert termios.tcgetattr(ours) != before
    assert termios.tcgetattr(ours) == before
    os.close(presser)


def test_a_terminal_that_has_gone_gives_no_keys_and_ends_nothing(terminal: tuple[int, int]) -> None:
    presser, _ = terminal
    with single_keys() as keys:
        os.close(presser)
        assert [keys.read() for _ in range(3)] == [""] * 3
