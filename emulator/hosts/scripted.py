"""Hosts that live in virtual time on links in memory: each brings its device to send scans and decodes them.

For `lidaremu test` and tests. They ask again when no reply comes, as drivers do; nothing here reads a clock.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from emulator.hosts.lms2xx import RATE_CODES, Lms2xxView, TelegramReader
from emulator.hosts.scans import HostScan
from emulator.transports.loopback import LoopHost
from protocols.ld.profiles import ALL_FIELDS, Field
from protocols.ld.sectors import TICKS
from protocols.ld.telegrams import GET_PROFILE_REPLY, REPLY_BIT, payload_of, words_of
from protocols.ld.usp import HEADER, OVERHEAD, encode_frame, xor_of
from protocols.lms2xx.telegrams import read_values, request

OnScan = Callable[[int, HostScan], None]
"(now_ns, scan)"

PATIENCE_NS = 4_000_000_000
"An LMS2xx may take three seconds to change its mode."
LD_PATIENCE_NS = 30_000_000_000
"An LD answers TRANS_MEASURE when its head is at speed."
SILENCE_NS = 2_000_000_000
"A stream that pauses for so long is asked for anew: the device may have been switched off and on."


@dataclass(frozen=True)
class Request:
    """One step of a start-up."""

    payload: bytes
    reply: int
    baud: int | None = None
    "Speed of the line once it has been answered."


class Lms2xxScript:
    """Asks an LMS2xx for its settings, the wanted line speed and a continuous stream."""

    SPEEDS = (9_600, 38_400, 500_000, 19_200)

    def __init__(self, line: LoopHost, on_scan: OnScan, baud: int = 500_000) -> None:
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
        self._again_ns = 0
        self._reader = TelegramReader()
        self._view: Lms2xxView | None = None
        self._scans = 0
        line.baud = self.SPEEDS[0]

    def step(self, now_ns: int) -> int | None:
        """Read, decode, ask; when to be called again."""
        data = self._line.read()
        if data:
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
        if self._at == len(self._requests):
            self._at = self._tries = 0
        elif self._tries:  # no answer: perhaps another line speed, or the device has been reset
            self._at = 0
            self._line.baud = self.SPEEDS[self._tries % len(self.SPEEDS)]
        self._ask(now_ns)

    def _ask(self, now_ns: int) -> None:
        self._tries += 1
        self._line.write(request(self._requests[self._at].payload), now_ns)
        self._again_ns = now_ns + PATIENCE_NS


class LdScript:
    """Brings an LD to measure and asks for whole profiles of everything."""

    def __init__(self, line: LoopHost, on_scan: OnScan, zero_rad: float = 0.0) -> None:
        self._line = line
        self._on_scan = on_scan
        self._zero_rad = zero_rad
        self._buffer = b""
        self._again_ns = 0
        self._scans = 0

    def step(self, now_ns: int) -> int | None:
        """Read, decode, ask; when to be called again."""
        self._buffer += self._line.read()
        while (payload := self._take()) is not None:
            words = words_of(payload)
            if words and words[0] == 0x0404 | REPLY_BIT:
                self._line.write(encode_frame(payload_of(0x0301, 0, ALL_FIELDS)), now_ns)
                self._again_ns = now_ns + SILENCE_NS
            elif words and words[0] == GET_PROFILE_REPLY:
                self._on_scan(now_ns, HostScan(self._scans, *read_profile(words, self._zero_rad)))
                self._scans += 1
                self._again_ns = now_ns + SILENCE_NS
        if now_ns >= self._again_ns:
            self._line.write(encode_frame(payload_of(0x0404)), now_ns)
            self._again_ns = now_ns + LD_PATIENCE_NS
        return self._again_ns

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


def read_profile(words: tuple[int, ...], zero_rad: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Azimuths and ranges of a profile that has all fields; (n,) each, NaN without an echo."""
    form, sectors, at = words[1], words[2] & 0xFF, 3
    at += sum(1 for kind in (Field.PROFILESENT, Field.PROFILECOUNT, Field.LAYERNUM) if form & kind)
    directions, distances = [], []
    for _ in range(sectors):
        points = words[at + 2]
        at += 5  # number, step, points, time, first direction
        block = np.array(words[at : at + 3 * points], dtype=np.float64).reshape(-1, 3)
        distances.append(block[:, 0])
        directions.append(block[:, 1])
        at += 3 * points + 2
    range_m = np.concatenate([np.zeros(0), *distances]) / 256.0
    azimuth = zero_rad - np.concatenate([np.zeros(0), *directions]) * (2.0 * np.pi / TICKS)
    return np.angle(np.exp(1j * azimuth)), np.where(range_m > 0, range_m, np.nan)
