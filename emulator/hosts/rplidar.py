"""Hosts for RPLIDARs: one on an open line for `look` and `view`, one in virtual time for `lidaremu test`.

Belongs here: what a driver does. Bytes of its stream are taken apart in `rplidar_reading`.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from emulator.errors import LinkError
from emulator.hosts.lines import Line, LineClosed, SocketLine
from emulator.hosts.rplidar_reading import Reader, Reply, Turn
from emulator.hosts.scans import HostScan
from emulator.hosts.scripted import AGAIN_NS, SILENCE_NS, Connection, HostEnd
from emulator.process.clock import SystemClock
from protocols.rplidar.codec import FORMS, STANDARD, request

BAUDS = (115_200, 256_000, 460_800, 1_000_000)
ANSWER_S, QUIET_S = 0.4, 0.1
STOP, INFO, SCAN = request(0x25), request(0x50), request(0x20)
MOTOR = request(0xF0, struct.pack("<H", 660)) + request(0xA8, struct.pack("<H", 600))
"By PWM and by speed: a device ignores what is not its own."
TYPICAL = request(0x84, struct.pack("<I", 0x7C))
KINDS = {1: "A", 2: "A", 3: "A", 4: "C", 6: "S", 7: "S", 8: "S"}
LOWER = {"A": 0, "C": 3, "S": 5}


def name_of(info: bytes) -> str:
    """Name of a model as the maker's SDK makes it of GET_INFO."""
    major, minor = info[0] >> 4, info[0] & 0xF
    series = KINDS.get(major, "?")
    return f"RPLIDAR {series}{major - LOWER.get(series, 0)}M{minor}"


def _kind_request(mode: int) -> bytes:
    return request(0x84, struct.pack("<IH", 0x75, mode))


def start_of(mode: int, kind: int) -> bytes:
    """The request that starts a mode."""
    return SCAN if kind == STANDARD else request(0x82, struct.pack("<BHH", mode, 0, 0))


class RplidarHost:
    """Connects in the constructor; raises `LinkError` when nothing answers."""

    def __init__(self, line: Line, baud: int | None) -> None:
        """`baud`: line speed tried first; None: the device is asked for its name alone, and left as it is."""
        self._line, self._reader, self._clock = line, Reader(), SystemClock()
        self.listens = False
        self.found_baud: int | None = None
        self._started = False
        self.title = name_of(self._find(baud))
        if baud is not None:
            self._start()

    def _find(self, baud: int | None) -> bytes:
        speeds = [None] if isinstance(self._line, SocketLine) else [*([] if baud is None else [baud]), *BAUDS]
        for speed in dict.fromkeys(speeds):
            if speed is not None:
                self._line.set_baud(speed)
            for _ in range(2):
                self._hush()
                if (info := self._ask(INFO, 0x04)) is not None and len(info) == 20:
                    self.found_baud = speed
                    return info
        raise LinkError("no RPLIDAR answers GET_INFO")

    def _hush(self) -> None:
        """Stop a scan of an earlier host, and forget what is on its way."""
        self._line.write(STOP)
        end_ns = self._clock.now_ns() + round(1e9 * ANSWER_S)
        while self._clock.now_ns() < end_ns and self._line.read(QUIET_S):
            pass
        self._reader = Reader()

    def _ask(self, data: bytes, kind: int) -> bytes | None:
        self._line.write(data)
        end_ns = self._clock.now_ns() + round(1e9 * ANSWER_S)
        while (left_ns := end_ns - self._clock.now_ns()) > 0:
            for one in self._reader.feed(self._line.read(left_ns / 1e9)):
                if isinstance(one, Reply) and one.kind == kind:
                    return one.data
        return None

    def _start(self) -> None:
        self._line.write(MOTOR)
        mode, kind = 0, STANDARD
        typical = self._ask(TYPICAL, 0x20)
        if typical is not None and len(typical) >= 6:
            mode = int.from_bytes(typical[4:6], "little")
            answer = self._ask(_kind_request(mode), 0x20)
            kind = answer[4] if answer is not None and len(answer) == 5 and answer[4] in FORMS else STANDARD
        self._line.write(start_of(mode, kind))
        self._started = True

    @property
    def errors(self) -> int:
        """Damaged groups so far."""
        return self._reader.errors

    def scans(self, timeout_s: float) -> Iterator[HostScan | None]:
        """Turns as they become whole; None when none came for `timeout_s`."""
        number = 0
        while True:
            data = self._line.read(timeout_s)
            for one in self._reader.feed(data):
                if isinstance(one, Turn):
                    yield one.scan(number)
                    number += 1
            if not data:
                yield None

    def close(self) -> None:
        """Stop the stream and disconnect."""
        if self._started:
            try:
                self._line.write(STOP)
            except LineClosed:
                pass  # it has gone already
        self._line.close()


class RplidarScript:
    """A host in virtual time: STOP, motor, typical mode, scan; it starts again when nothing comes."""

    def __init__(self, line: HostEnd, on_scan: Callable[[int, HostScan], None]) -> None:
        self._line, self._on_scan = line, on_scan
        self._connection = line if isinstance(line, Connection) else None
        self._reader = Reader()
        self._again_ns = self._scans = self._tries = self._mode = 0

    def step(self, now_ns: int) -> int | None:
        """Read, decode, ask; when to be called again."""
        for one in self._reader.feed(self._line.read()):
            if isinstance(one, Turn):
                self._on_scan(now_ns, one.scan(self._scans))
                self._scans += 1
                self._tries, self._again_ns = 0, now_ns + SILENCE_NS
            elif one.kind == 0x20:
                self._take(one.data, now_ns)
        if now_ns >= self._again_ns:
            if self._connection is not None and (not self._connection.connected or self._tries % 8 == 7):
                self._connection.reconnect(now_ns)
            self._reader = Reader()
            self._ask(STOP + MOTOR + (SCAN if self._tries % 2 else TYPICAL), now_ns)
            self._tries += 1
        return self._again_ns

    def _take(self, value: bytes, now_ns: int) -> None:
        entry = int.from_bytes(value[:4], "little")
        if entry == 0x7C and len(value) >= 6:
            self._mode = int.from_bytes(value[4:6], "little")
            self._ask(_kind_request(self._mode), now_ns)
        elif entry == 0x75 and len(value) == 5:
            self._ask(start_of(self._mode, value[4]), now_ns)
            self._again_ns = now_ns + 2 * SILENCE_NS

    def _ask(self, data: bytes, now_ns: int) -> None:
        self._line.write(data, now_ns)
        self._again_ns = now_ns + AGAIN_NS


def rplidar_script(line: HostEnd, on_scan: Callable[[int, HostScan], None], device: Mapping[str, Any]) -> RplidarScript:
    """For `lidaremu test`."""
    return RplidarScript(line, on_scan)
