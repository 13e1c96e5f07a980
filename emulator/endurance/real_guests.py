"""Ends of real links for the hosts of a soak: a terminal, a TCP connection; and hosts of a socketcand server.

None of them ever waits: what cannot be written at once is lost, as an impatient host loses it.
"""

from __future__ import annotations

import contextlib
import os
import re
import socket
import termios
from collections import Counter

import numpy as np

from emulator.endurance.guests import Guestbook, noise
from emulator.transports.tty_modes import set_raw

SPEEDS = {
    9_600: termios.B9600,
    19_200: termios.B19200,
    38_400: termios.B38400,
    500_000: termios.B500000,
}
READ_SIZE = 262_144


class TerminalEnd:
    """A host that has a pseudo-terminal open."""

    def __init__(self, path: str, baud: int | None) -> None:
        self._fd = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        set_raw(self._fd)
        self._baud: int | None = None
        self.baud = baud or 9_600

    @property
    def baud(self) -> int | None:
        """Its own speed."""
        return self._baud

    @baud.setter
    def baud(self, value: int | None) -> None:
        self._baud = value
        if value is not None:
            modes = termios.tcgetattr(self._fd)
            modes[4] = modes[5] = SPEEDS[value]
            termios.tcsetattr(self._fd, termios.TCSANOW, modes)

    def read(self) -> bytes:
        """What has come."""
        try:
            return os.read(self._fd, READ_SIZE)
        except OSError:
            return b""

    def write(self, data: bytes, at_ns: int) -> int:
        """As much as there is room for."""
        with contextlib.suppress(OSError):
            os.write(self._fd, data)
        return at_ns

    def close(self, at_ns: int) -> None:
        """Leave; may be called twice."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1


class Terminal:
    """A sensor's pseudo-terminal by its path."""

    def __init__(self, path: str) -> None:
        self._path = path
        self._last: TerminalEnd | None = None

    def connect(self, at_ns: int = 0, baud: int | None = None) -> TerminalEnd:
        """A host that opens it."""
        self._last = TerminalEnd(self._path, baud)
        return self._last

    def close(self) -> None:
        """The last host leaves: they follow each other."""
        if self._last is not None:
            self._last.close(0)


class SocketEnd:
    """A host that is connected over TCP or a Unix socket."""

    def __init__(self, family: int, address: tuple[str, int] | str) -> None:
        self.baud: int | None = None
        self._socket = socket.socket(family, socket.SOCK_STREAM)
        self._socket.settimeout(5.0)
        self._socket.connect(address)
        self._socket.setblocking(False)

    @property
    def is_open(self) -> bool:
        """It has not left."""
        return self._socket.fileno() >= 0

    def read(self) -> bytes:
        """What has come."""
        try:
            return self._socket.recv(READ_SIZE)
        except OSError:
            return b""

    def write(self, data: bytes, at_ns: int) -> int:
        """As much as there is room for."""
        with contextlib.suppress(OSError):
            self._socket.send(data)
        return at_ns

    def close(self, at_ns: int) -> None:
        """Leave."""
        self._socket.close()


class Endpoint:
    """A listening address."""

    def __init__(self, address: tuple[str, int] | str) -> None:
        self._family = socket.AF_UNIX if isinstance(address, str) else socket.AF_INET
        self._address = address
        self._ends: set[SocketEnd] = set()

    def connect(self, at_ns: int = 0, baud: int | None = None) -> SocketEnd:
        """A host that connects."""
        self._ends = {end for end in self._ends if end.is_open}
        end = SocketEnd(self._family, self._address)
        self._ends.add(end)
        return end

    def close(self) -> None:
        """Every host leaves."""
        for end in self._ends:
            end.close(0)


FRAME = re.compile(rb"< frame ([0-9A-F]+) [0-9.]+ ([0-9A-F]*) >")


class ListReader:
    """A well-behaved client of a socketcand server: opens the bus and reads object lists."""

    def __init__(self, place: Endpoint, channel: str, book: Guestbook) -> None:
        self._end = place.connect()
        self._channel = channel.encode()
        self._book = book
        self._text = b""
        self._stage = 0
        self._left = -1
        "Objects still to come; -1: no list has begun."
        book.visits["well-behaved"] += 1

    def step(self, now_ns: int) -> None:
        """Read, answer, judge."""
        self._text += self._end.read()
        if self._stage == 0 and b"< hi >" in self._text:
            self._end.write(b"< open " + self._channel + b" >", now_ns)
            self._stage, self._text = 1, b""
        elif self._stage == 1 and b"< ok >" in self._text:
            self._end.write(b"< rawmode >", now_ns)
            self._stage, self._text = 2, b""
        elif self._stage == 2:
            end = self._text.rfind(b">") + 1
            for identifier, data in FRAME.findall(self._text[:end]):
                self._frame(int(identifier, 16), bytes.fromhex(data.decode()))
            self._text = self._text[end:]

    def _frame(self, identifier: int, data: bytes) -> None:
        if identifier == 0x60A:
            if self._left > 0:
                self._book.faults["objects missing in a list"] += 1
            self._left = data[0]
            self._book.clean_scans += 1
        elif identifier == 0x60B and self._left >= 0:
            self._left -= 1


class Intruders:
    """Hosts of any stream that come and go: one after the other, each of its own kind."""

    def __init__(
        self, place: Endpoint, rng: np.random.Generator, visits: Counter[str], words: tuple[bytes, ...]
    ) -> None:
        """`words`: valid and half-valid things to say in this protocol."""
        self._place = place
        self._rng = rng
        self._visits = visits
        self._words = words
        self._end: SocketEnd | None = None
        self._kind = ""
        self._until_ns = 0

    KINDS = ("silent", "random bytes", "flood of commands", "half a command", "never reads")

    def step(self, now_ns: int) -> None:
        """Come, misbehave, go."""
        if now_ns >= self._until_ns:
            if self._end is not None:
                self._end.close(now_ns)
                self._end = None
            else:
                self._kind = str(self._rng.choice(self.KINDS))
                self._visits[self._kind] += 1
                with contextlib.suppress(OSError):
                    self._end = self._place.connect(now_ns)
                    if self._kind == "never reads":
                        self._end.write(b"".join(self._words), now_ns)
            self._until_ns = now_ns + round(self._rng.uniform(0.1, 3.0) * 1e9)
        if self._end is None:
            return
        word = self._words[int(self._rng.integers(len(self._words)))]
        if self._kind == "random bytes":
            self._end.write(noise(self._rng, 2000), now_ns)
        elif self._kind == "flood of commands":
            self._end.write(word * 20, now_ns)
        elif self._kind == "half a command":
            self._end.write(word[: int(self._rng.integers(1, len(word)))], now_ns)
        if self._kind != "never reads":
            self._end.read()
