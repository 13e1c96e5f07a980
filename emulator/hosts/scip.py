"""Hosts for SCIP: one on an open line for `look` and `view`, one in virtual time for `lidaremu test`.

Belongs here: what a driver does. It shares the codec with the device, and nothing else.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from emulator.errors import LinkError
from emulator.hosts.lines import Line, LineClosed, SocketLine
from emulator.hosts.scans import HostScan
from emulator.hosts.scip_reading import decode_number, decode_values, joined
from emulator.hosts.scripted import AGAIN_NS, SILENCE_NS, Connection, HostEnd
from emulator.process.clock import SystemClock
from protocols.scip.codec import STAMP_CHARS, Form, line_sum

MOST_HELD = 65_536
"Of a reply without end: the largest has three echoes with intensities for 1081 steps, 23 kB."
BAUDS = (19_200, 115_200, 38_400, 57_600, 250_000, 500_000, 750_000)
ANSWER_S = 0.6
"For each of two tries at each speed."
START_S = 5.0
"A device whose motor starts sends no scan, but answers."
FORMS = {b"MD": Form(3), b"ME": Form(3, intensity=True)}


@dataclass(frozen=True)
class Reply:
    """One reply, or one scan."""

    echo: bytes
    status: bytes
    "Two characters; one or none in SCIP 1.1."
    lines: tuple[bytes, ...]


class ReplyReader:
    """Replies out of bytes in any chunking; each ends with an empty line."""

    def __init__(self) -> None:
        self._held = b""
        self.errors = 0
        "Replies that were not whole, or whose status had a wrong sum."

    def feed(self, data: bytes) -> Iterator[Reply]:
        """Replies that are whole by now."""
        *texts, self._held = (self._held + data).split(b"\n\n")
        self._held = self._held[-MOST_HELD:]
        for text in texts:
            lines = text.strip(b"\n").split(b"\n")
            if len(lines) < 2:
                self.errors += bool(text.strip())
                continue
            status, check = lines[1][:2], lines[1][2:]
            if len(status) == 2 and check != line_sum(status):
                self.errors += 1
                continue
            yield Reply(lines[0], status, tuple(lines[2:]))


@dataclass(frozen=True)
class ScipView:
    """What a host needs to know of a device to read its scans."""

    first: int
    last: int
    front: int
    steps: int
    least_m: float
    most_m: float

    @classmethod
    def of(cls, reply: Reply) -> ScipView | None:
        """From the reply to PP; None if a value is missing or no number."""
        values = dict(line.split(b";")[0].partition(b":")[::2] for line in reply.lines)
        try:
            numbers = [int(values[key]) for key in (b"AMIN", b"AMAX", b"AFRT", b"ARES", b"DMIN", b"DMAX")]
        except (KeyError, ValueError):
            return None
        first, last, front, steps, least, most = numbers
        good = 0 <= first <= last <= 9999 and steps > 0
        return cls(first, last, front, steps, least / 1000.0, most / 1000.0) if good else None

    def request(self, command: bytes) -> bytes:
        """All scans of the whole field, until stopped."""
        return command + b"%04d%04d01000\n" % (self.first, self.last)

    def decode(self, number: int, reply: Reply) -> HostScan | None:
        """A scan of the whole field; None if it is damaged."""
        try:
            ticks = decode_number(joined(reply.lines[:1]))
            range_m, strength = decode_values(joined(reply.lines[1:]), FORMS[reply.echo[:2]])
        except (ValueError, KeyError, IndexError):
            return None
        index = np.arange(self.first, self.last + 1)
        if range_m.shape != (len(index), 1) or len(reply.lines[0]) != STAMP_CHARS + 1:
            return None
        found = range_m[:, 0]
        found = np.where((found >= self.least_m) & (found <= self.most_m), found, np.nan)
        azimuth = np.asarray((index - self.front) * (2.0 * np.pi / self.steps), np.float64)
        intensity = None if reply.echo[:2] != b"ME" else np.where(np.isnan(found), np.nan, strength[:, 0])
        return HostScan(number, azimuth, found, f"stamp {ticks} ms", intensity)


class ScipHost:
    """Connects in the constructor; raises `LinkError` when nothing answers."""

    def __init__(self, line: Line, baud: int | None) -> None:
        """`baud`: line speed tried first; None: the device is asked for its name alone, and left as it is."""
        self._line, self._reader, self._clock = line, ReplyReader(), SystemClock()
        self._waiting: deque[Reply] = deque()
        self._damaged = 0
        self._command = b""
        self.listens = False
        self.found_baud: int | None = None
        version = self._find(baud)
        self.title = _title(version)
        if baud is not None:
            self._start(version)

    def _find(self, baud: int | None) -> Reply:
        speeds = [None] if isinstance(self._line, SocketLine) else [*([] if baud is None else [baud]), *BAUDS]
        for speed in dict.fromkeys(speeds):
            if speed is not None:
                self._line.set_baud(speed)
            for command in (b"\nVV\n", b"\nVV\n"):
                self._line.write(command)
                reply = self._until(ANSWER_S, lambda one: one.echo == b"VV")
                if reply is not None:
                    self.found_baud = speed
                    return reply
        raise LinkError("no SCIP device answers VV")

    def _start(self, version: Reply) -> None:
        if version.status != b"00":
            self._ask(b"SCIP2.0")
            self.title = _title(self._ask(b"VV"))
        if self._ask(b"QT").status != b"00":
            self._ask(b"TM2")
            self._ask(b"QT")
        view = ScipView.of(self._ask(b"PP"))
        if view is None:
            raise LinkError("the reply to PP lacks a parameter")
        self._view = view
        for command in (b"ME", b"MD"):
            if self._ask(view.request(command).strip()).status == b"00":
                self._command = command
                return
        raise LinkError("the device refuses to send scans")

    def _ask(self, command: bytes) -> Reply:
        self._line.write(command + b"\n")
        reply = self._until(START_S, lambda one: one.echo == command)
        if reply is None:
            raise LinkError(f"no reply to {command.decode()}")
        return reply

    def _until(self, seconds: float, fits: Callable[[Reply], bool]) -> Reply | None:
        end_ns = self._clock.now_ns() + round(1e9 * seconds)
        while (left_ns := end_ns - self._clock.now_ns()) > 0:
            for reply in self._reader.feed(self._line.read(left_ns / 1e9)):
                if fits(reply):
                    return reply
        return None

    @property
    def errors(self) -> int:
        """Damaged replies so far."""
        return self._reader.errors + self._damaged

    def scans(self, timeout_s: float) -> Iterator[HostScan | None]:
        """Scans as they arrive; None when none came for `timeout_s`."""
        number = 0
        while True:
            data = self._line.read(timeout_s)
            for reply in self._reader.feed(data):
                if reply.status != b"99":
                    continue
                scan = self._view.decode(number, reply)
                if scan is None:
                    self._damaged += 1
                    continue
                yield scan
                number += 1
            if not data:
                yield None

    def close(self) -> None:
        """Stop the stream and disconnect."""
        if self._command:
            try:
                self._line.write(b"QT\n")
            except LineClosed:
                pass  # it has gone already
        self._line.close()


def _title(version: Reply) -> str:
    for line in version.lines:
        if line.startswith(b"PROD:"):
            return line[5:].partition(b";")[0].decode("ascii", "replace")
    return "SCIP"


class ScipScript:
    """A host in virtual time: QT, PP, MD; it asks again when nothing comes."""

    def __init__(self, line: HostEnd, on_scan: Callable[[int, HostScan], None]) -> None:
        self._line, self._on_scan = line, on_scan
        self._connection = line if isinstance(line, Connection) else None
        self._reader = ReplyReader()
        self._view: ScipView | None = None
        self._again_ns = self._scans = self._tries = 0

    def step(self, now_ns: int) -> int | None:
        """Read, decode, ask; when to be called again."""
        for reply in self._reader.feed(self._line.read()):
            self._take(reply, now_ns)
        if now_ns >= self._again_ns:
            if self._connection is not None and (not self._connection.connected or self._tries % 8 == 7):
                self._connection.reconnect(now_ns)
            self._reader = ReplyReader()
            self._ask(b"\nTM2\nSCIP2.0\nQT\n" if self._tries % 2 else b"\nQT\n", now_ns)
            self._tries += 1
        return self._again_ns

    def _take(self, reply: Reply, now_ns: int) -> None:
        if reply.status == b"99" and self._view is not None:
            if (scan := self._view.decode(self._scans, reply)) is not None:
                self._on_scan(now_ns, scan)
                self._scans += 1
                self._tries, self._again_ns = 0, now_ns + SILENCE_NS
        elif reply.echo == b"QT" and reply.status == b"00":
            self._ask(b"PP\n", now_ns)
        elif reply.echo == b"PP" and (view := ScipView.of(reply)) is not None:
            self._view = view
            self._ask(view.request(b"MD"), now_ns)
            self._again_ns = now_ns + SILENCE_NS
        elif reply.status in (b"0M", b"21"):  # it waits for its motor
            self._again_ns = now_ns + SILENCE_NS

    def _ask(self, data: bytes, now_ns: int) -> None:
        self._line.write(data, now_ns)
        self._again_ns = now_ns + AGAIN_NS


def scip_script(line: HostEnd, on_scan: Callable[[int, HostScan], None], device: Mapping[str, Any]) -> ScipScript:
    """For `lidaremu test`."""
    return ScipScript(line, on_scan)
