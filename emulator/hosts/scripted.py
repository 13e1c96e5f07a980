"""Hosts that live in virtual time on links in memory: each brings its device to send scans and decodes them.

For `lidaremu test` and tests. They ask again when no reply comes, as drivers do; nothing here reads a clock.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from emulator.hosts.ld import read_profile
from emulator.hosts.lms2xx import RATE_CODES, Lms2xxView, TelegramReader
from emulator.hosts.scans import HostScan
from protocols.ld.profiles import ALL_FIELDS
from protocols.ld.telegrams import GET_PROFILE_REPLY, REPLY_BIT, Mode, payload_of, words_of
from protocols.ld.usp import HEADER, OVERHEAD, encode_frame, xor_of
from protocols.lms2xx.telegrams import read_values, request


class HostEnd(Protocol):
    """A host's end of a link."""

    baud: int | None

    def read(self) -> bytes: ...

    def write(self, data: bytes, at_ns: int) -> int: ...


@runtime_checkable
class Connection(Protocol):
    """An end that can be disconnected."""

    @property
    def connected(self) -> bool: ...

    def reconnect(self, at_ns: int) -> bool:
        """Hang up, and connect again; False: refused."""


GET_STATUS, TRANS_ROTATE, TRANS_MEASURE = 0x0102, 0x0403, 0x0404

OnScan = Callable[[int, HostScan], None]
"(now_ns, scan)"


class Script(Protocol):
    """A host in virtual time."""

    def step(self, now_ns: int) -> int | None:
        """Read, decode, ask; when to be called again."""


@runtime_checkable
class HasScript(Protocol):
    """A family of another package that brings its own host for `lidaremu test`."""

    def script(self, line: HostEnd, on_scan: OnScan) -> Script: ...


TIME_LIMIT_NS = 4_000_000_000
"An LMS2xx may take three seconds to change its mode."
ACK_TIME_LIMIT_NS = 500_000_000
"Its ACK comes within 60 ms: where nothing at all is heard, it has another speed, or none is there."
AGAIN_NS = 1_000_000_000
"How often a host tries to connect again, or asks a device that may be starting."
LD_TIME_LIMIT_NS = 30_000_000_000
"An LD answers TRANS_MEASURE when its head is at speed."
SILENCE_NS = 2_000_000_000
"A stream that pauses for so long is asked for again: the device may have been switched off and on."


@dataclass(frozen=True)
class Request:
    """One step of a start-up."""

    payload: bytes
    reply: int
    baud: int | None = None
    "Speed of the line once it has been answered."


class Lms2xxScript:
    """Asks an LMS2xx for its settings, the wanted line speed and a continuous stream."""

    takes_whole = True
    "Each payload of the device is one telegram: a part of one changes nothing but at its own time limits."
    SPEEDS = (9_600, 38_400, 500_000, 19_200)

    def __init__(self, line: HostEnd, on_scan: OnScan, baud: int = 500_000) -> None:
        self._line = line
        self._on_scan = on_scan
        self._requests = (
            Request(b"\x20\x25", 0xA0),
            Request(b"\x31", 0xB1),
            Request(bytes((0x20, RATE_CODES[baud])), 0xA0, baud),
            Request(b"\x20\x24", 0xA0),
        )
        self._at = 0
        self._tries = 0
        self._again_ns = self._asked_ns = 0
        self._reader = TelegramReader()
        self._view: Lms2xxView | None = None
        self._scans = 0
        line.baud = self.SPEEDS[0]

    def step(self, now_ns: int) -> int | None:
        """Read, decode, ask; when to be called again."""
        data = self._line.read()
        if data:
            if 0 < self._at < len(self._requests) or self._tries:
                self._again_ns = max(self._again_ns, self._asked_ns + TIME_LIMIT_NS)
            self._reader.feed(data)
            while (telegram := self._reader.take()) is not None:
                if self._at < len(self._requests) and telegram.command == self._requests[self._at].reply:
                    self._answered(telegram.data, now_ns)
                elif self._view is not None and (values := read_values(telegram)) is not None:
                    self._on_scan(now_ns, self._view.decode(self._scans, values))
                    self._scans += 1
                    self._again_ns = now_ns + SILENCE_NS
        if now_ns >= self._again_ns:
            self._ask_again(now_ns)
        return self._again_ns

    def _answered(self, data: bytes, now_ns: int) -> None:
        wanted = self._requests[self._at]
        if wanted.reply == 0xB1:
            self._view = Lms2xxView.of(data)
        if wanted.baud is not None:
            self._line.baud = wanted.baud
        self._at += 1
        self._tries = 0
        if self._at < len(self._requests):
            self._ask(now_ns)
        else:
            self._again_ns = now_ns + SILENCE_NS

    def _ask_again(self, now_ns: int) -> None:
        self._reader = TelegramReader()  # the line has been silent: what was begun will not be finished
        if self._at == len(self._requests):
            self._at = self._tries = 0
        elif self._tries:  # no answer: perhaps another line speed, or the device has been reset
            self._at = 0
            self._line.baud = self.SPEEDS[self._tries % len(self.SPEEDS)]
        self._ask(now_ns)

    def _ask(self, now_ns: int) -> None:
        self._tries += 1
        self._asked_ns = now_ns
        self._line.write(request(self._requests[self._at].payload), now_ns)
        self._again_ns = now_ns + ACK_TIME_LIMIT_NS


class LdScript:
    """Brings an LD to measure and asks for whole profiles of everything."""

    def __init__(self, line: HostEnd, on_scan: OnScan, zero_rad: float = 0.0) -> None:
        self._line = line
        self._connection = line if isinstance(line, Connection) else None
        self._on_scan = on_scan
        self._zero_rad = zero_rad
        self._buffer = b""
        self._again_ns = 0
        self._scans = 0
        self._state = "status"
        "status (asks in which mode the device is) | measure (asked for it) | stream | lost (hung up, or silent)"

    def step(self, now_ns: int) -> int | None:
        """Read, decode, ask; when to be called again."""
        self._buffer += self._line.read()
        while (payload := self._take()) is not None:
            words = words_of(payload)
            if len(words) > 2 and words[0] == GET_STATUS | REPLY_BIT and self._state == "status":
                # an idle device does not measure before its head turns (listing 8011576, p. 46)
                asked = (TRANS_ROTATE, 0) if words[2] & 0xF == Mode.IDLE else (TRANS_MEASURE,)
                self._line.write(encode_frame(payload_of(*asked)), now_ns)
                self._state, self._again_ns = "measure", now_ns + LD_TIME_LIMIT_NS
            elif words and words[0] == TRANS_ROTATE | REPLY_BIT:
                self._line.write(encode_frame(payload_of(TRANS_MEASURE)), now_ns)
            elif words and words[0] == TRANS_MEASURE | REPLY_BIT:
                self._line.write(encode_frame(payload_of(0x0301, 0, ALL_FIELDS)), now_ns)
                self._state, self._again_ns = "stream", now_ns + SILENCE_NS
            elif words and words[0] == GET_PROFILE_REPLY:
                profile = read_profile(words, self._zero_rad)
                if profile is not None:
                    self._on_scan(now_ns, HostScan(self._scans, profile.azimuth_rad, profile.range_m))
                    self._scans += 1
                    self._again_ns = now_ns + SILENCE_NS
        line = self._connection
        if line is not None and self._state != "lost":
            if not line.connected or (self._state == "stream" and now_ns >= self._again_ns):
                self._state, self._again_ns = "lost", now_ns
        if now_ns >= self._again_ns:
            self._ask(now_ns)
        return self._again_ns

    def _ask(self, now_ns: int) -> None:
        """What this state asks for, and until when it waits."""
        self._again_ns = now_ns + AGAIN_NS
        line, connection = self._line, self._connection
        if self._state == "lost" and connection is not None and connection.reconnect(now_ns):
            self._state, self._buffer = "status", b""
        if self._state != "lost":
            self._buffer = b""  # it has been silent: what was begun, a wrong length perhaps, will not be finished
            line.write(encode_frame(payload_of(GET_STATUS)), now_ns)
            self._state = "status"

    def _take(self) -> bytes | None:
        """Payload of the next whole frame; what is none is passed over."""
        while True:
            start = self._buffer.find(HEADER)
            self._buffer = self._buffer[start if start >= 0 else max(0, len(self._buffer) - len(HEADER) + 1) :]
            if start < 0 or len(self._buffer) < 8:
                return None
            length = int.from_bytes(self._buffer[4:8], "big")
            if length > 1 << 20:
                self._buffer = self._buffer[4:]
                continue
            if len(self._buffer) < length + OVERHEAD:
                return None
            payload, check = self._buffer[8 : 8 + length], self._buffer[8 + length]
            whole = xor_of(payload) == check
            self._buffer = self._buffer[length + OVERHEAD if whole else 4 :]
            if whole:
                return payload


def lms2xx_script(line: HostEnd, on_scan: OnScan, device: Mapping[str, Any]) -> Lms2xxScript:
    """For `lidaremu test`."""
    return Lms2xxScript(line, on_scan)


def ld_script(line: HostEnd, on_scan: OnScan, device: Mapping[str, Any]) -> LdScript:
    """The same; directions go by the device's own zero."""
    return LdScript(line, on_scan, math.radians(float(device.get("zero_deg", 0.0))))
