"""What hosts of lidars that send packets have in common: one on a connection that asks for them, one in virtual time.

Belongs here: asking, reading on, asking again. Not: packets, and how it is seen that they come (hosts of the families).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Protocol

from emulator.hosts.lines import Line
from emulator.hosts.scans import HostScan
from emulator.hosts.scripted import AGAIN_NS, SILENCE_NS, Connection, HostEnd
from emulator.process.clock import SystemClock

ANSWER_S = 1.0
TAKEN = b"HTTP/1.1 200"


class Reader(Protocol):
    """Scans out of a stream of packets in any chunking."""

    errors: int
    title: str

    def feed(self, data: bytes) -> Iterator[HostScan]:
        """Scans that are whole by now."""


class PacketHost:
    """Asks for packets on a TCP connection, and reads them."""

    asks_after_errors = False
    "Packets may no longer be what the reply said."

    def __init__(self, line: Line, reader: Reader, ask: bytes, start_s: float, ended: Callable[[bytes], bool]) -> None:
        """Read the beginning until it is `ended`, or `start_s` are over. `ask` may be empty: it only listens."""
        self._line, self._reader, self._ask, self._first = line, reader, ask, b""
        self.listens = False
        self.found_baud: int | None = None
        line.write(ask)
        clock = SystemClock()
        end_ns = clock.now_ns() + round(1e9 * start_s)
        while not ended(self._first) and (left_ns := end_ns - clock.now_ns()) > 0:
            self._first += line.read(min(left_ns / 1e9, ANSWER_S))
            if ask and line.asks and not (self._first and TAKEN.startswith(self._first[: len(TAKEN)])):
                break  # it answers at once, or it is none
        self.title = reader.title

    @property
    def errors(self) -> int:
        """Damaged packets so far."""
        return self._reader.errors

    def scans(self, timeout_s: float) -> Iterator[HostScan | None]:
        """Whole scans as they arrive, without the first, begun anywhere; None when nothing came for `timeout_s`."""
        data, errors = self._first, 0
        while True:
            for scan in self._reader.feed(data):
                self.title = self._reader.title
                if scan.number:
                    yield replace(scan, number=scan.number - 1)
            if not data:
                yield None
            if self.asks_after_errors and self._reader.errors > errors:
                errors = self._reader.errors
                self._line.write(self._ask)
            data = self._line.read(timeout_s)

    def close(self) -> None:
        """Hang up."""
        self._line.close()


class PacketScript:
    """A host in virtual time; it asks again when nothing comes, or what comes is not understood. `ask` may be
    empty: it only listens."""

    def __init__(
        self, line: HostEnd, on_scan: Callable[[int, HostScan], None], reader: Callable[[], Reader], ask: bytes,
        asks_after_errors: bool = False,
    ) -> None:  # fmt: skip
        self._line, self._on_scan, self._make, self._ask = line, on_scan, reader, ask
        self._asks_after_errors = asks_after_errors
        self._reader = reader()
        self._connection = line if isinstance(line, Connection) else None
        self._again_ns = 0

    def step(self, now_ns: int) -> int | None:
        """Read, decode, ask; when to be called again."""
        errors = self._reader.errors
        if data := self._line.read():
            self._again_ns = max(self._again_ns, now_ns + SILENCE_NS)
            for scan in self._reader.feed(data):
                self._on_scan(now_ns, scan)
            if self._asks_after_errors and self._reader.errors > errors:
                self._line.write(self._ask, now_ns)
        if now_ns >= self._again_ns:
            if self._connection is not None:
                self._connection.reconnect(now_ns)
            self._reader = self._make()
            self._line.write(self._ask, now_ns)
            self._again_ns = now_ns + AGAIN_NS
        return self._again_ns
