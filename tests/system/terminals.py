"""A command on a pseudo-terminal of its own, and what a person would see on its screen (pyte emulates the terminal)."""

from __future__ import annotations

import fcntl
import os
import select
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Callable
from pathlib import Path

import pyte


class Terminal:
    """`lidaremu ARGUMENTS` on a terminal of 80 x 24."""

    def __init__(self, arguments: list[str], folder: Path, **variables: str) -> None:
        self.screen = pyte.Screen(80, 24)
        self._stream = pyte.ByteStream(self.screen)
        self.raw = b""
        self._master, slave = os.openpty()
        self.resize(80, 24)
        unwanted = {"NO_COLOR", "COLUMNS", "LINES", "COLORTERM", "FORCE_COLOR"}
        environment = {key: value for key, value in os.environ.items() if key not in unwanted}
        environment |= {"TERM": "xterm-256color", "PYTHONPATH": str(Path(__file__).resolve().parents[2])} | variables
        self.process = subprocess.Popen(
            [sys.executable, "-m", "emulator", *arguments],
            stdin=slave, stdout=slave, stderr=slave, cwd=folder, env=environment, start_new_session=True,
        )  # fmt: skip
        os.close(slave)

    def resize(self, columns: int, rows: int) -> None:
        """Another size, as when a window is dragged."""
        fcntl.ioctl(self._master, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))
        self.screen.resize(rows, columns)

    def press(self, keys: str) -> None:
        os.write(self._master, keys.encode())

    @property
    def text(self) -> str:
        return "\n".join(self.screen.display)

    def colours(self) -> set[str]:
        """Colours of the characters of the braille patterns."""
        cells = [cell for row in self.screen.buffer.values() for cell in row.values()]
        return {cell.fg for cell in cells if 0x2800 < ord(cell.data[0]) < 0x2900}

    def until(self, wanted: Callable[[str], bool], seconds: float = 60.0) -> str:
        """Wait until the screen shows what is wanted; the screen."""
        end = time.monotonic() + seconds
        while not wanted(self.text):
            if time.monotonic() > end or not self._feed(0.2):
                raise AssertionError(f"never shown; exit code {self.process.poll()}; the screen:\n{self.text}")
        return self.text

    def finish(self, seconds: float = 60.0) -> int:
        """Read until the command ends; its exit code."""
        end = time.monotonic() + seconds
        while time.monotonic() < end and self._feed(0.2):
            if self.process.poll() is not None and not select.select([self._master], [], [], 0.05)[0]:
                break
        return self.process.wait(max(0.1, end - time.monotonic()))

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        os.close(self._master)

    def _feed(self, seconds: float) -> bool:
        """Take what has come; false at the end of the command."""
        if not select.select([self._master], [], [], seconds)[0]:
            return True
        try:
            data = os.read(self._master, 65536)
        except OSError:  # the other end is closed
            return False
        self.raw += data
        self._stream.feed(data)
        return bool(data)
