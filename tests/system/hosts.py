"""A host written from the protocol's description alone, sharing no code with the product."""

from __future__ import annotations

import os
import select
import socket
import time
from collections.abc import Sequence
from typing import Any

import serial

TIME_LIMIT_S = 60.0
LONGEST = 0x400
"Bytes of a payload; what claims more is no header but bytes of a telegram of which the line has lost a part."
SILENCE_S = 2.0
"After which the rest of a telegram does not come."


def crc(data: bytes) -> bytes:
    """SICK's 16-bit CRC, bit by bit, low byte first."""
    register = previous = 0
    for byte in data:
        top = register & 0x8000
        register = (register << 1) & 0xFFFF
        if top:
            register ^= 0x8005
        register ^= previous << 8 | byte
        previous = byte
    return register.to_bytes(2, "little")


def telegram(payload: bytes) -> bytes:
    frame = b"\x02\x00" + len(payload).to_bytes(2, "little") + payload
    return frame + crc(frame)


class LmsHost:
    """Talks to an LMS2xx through pyserial."""

    def __init__(self, path: str, baud: int = 9600) -> None:
        self.port: Any = serial.Serial(path, baud, timeout=0.05)
        self.seen = b""

    @classmethod
    def on(cls, port: EndOfLine) -> LmsHost:
        """Of a line without a path."""
        made = cls.__new__(cls)
        made.port, made.seen = port, b""
        return made

    def __enter__(self) -> LmsHost:
        return self

    def __exit__(self, *_: object) -> None:
        self.port.close()

    def ask(self, payload: bytes, reply: int, seconds: float = TIME_LIMIT_S) -> bytes:
        """Send a request; the reply's payload. Stream telegrams on the way are skipped."""
        self.port.write(telegram(payload))
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            got = self.next(max(0.0, end - time.monotonic()))
            if got is not None and got[0] in (reply, 0x92):
                return got
        raise AssertionError(f"no reply {reply:02X}")

    def next(self, seconds: float) -> bytes | None:
        """Payload of the next telegram with a good CRC."""
        heard = time.monotonic()
        end = heard + seconds
        while True:
            start = self.seen.find(b"\x02\x80")
            if start >= 0 and len(self.seen) >= start + 4:
                length = int.from_bytes(self.seen[start + 2 : start + 4], "little")
                whole = self.seen[start : start + length + 6]
                if len(whole) == length + 6 and crc(whole[:-2]) == whole[-2:]:
                    self.seen = self.seen[start + length + 6 :]
                    return whole[4:-2]
                if len(whole) == length + 6 or length > LONGEST or time.monotonic() > heard + SILENCE_S:
                    self.seen = self.seen[start + 1 :]
                    continue
            if time.monotonic() >= end:
                return None
            if got := self.port.read(max(1, self.port.in_waiting)):
                self.seen += got
                heard = time.monotonic()

    def set_baud(self, baud: int) -> None:
        code = {9600: 0x42, 19200: 0x41, 38400: 0x40, 500000: 0x48}[baud]
        assert self.ask(bytes((0x20, code)), 0xA0)[1] == 0
        self.port.baudrate = baud

    def stream(self) -> None:
        assert self.ask(b"\x20\x24", 0xA0)[1] == 0

    def stop(self) -> int:
        """End the stream; how many scans came before the reply."""
        self.port.write(telegram(b"\x20\x25"))
        count, end = 0, time.monotonic() + TIME_LIMIT_S
        while time.monotonic() < end:
            got = self.next(max(0.0, end - time.monotonic()))
            if got is not None and got[0] == 0xA0:
                return count
            count += got is not None and got[0] == 0xB0
        raise AssertionError("no reply A0")

    def scan(self, seconds: float = TIME_LIMIT_S) -> list[int]:
        """Raw value words of the next B0."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            got = self.next(max(0.0, end - time.monotonic()))
            if got is not None and got[0] == 0xB0:
                count = int.from_bytes(got[1:3], "little") & 0x3FF
                return [int.from_bytes(got[3 + 2 * i : 5 + 2 * i], "little") for i in range(count)]
        raise AssertionError("no scan")


class Adapter:
    """A serial device that can be pulled out: `path` is the emulator's, the other end the host's."""

    def __init__(self) -> None:
        self.host, own = os.openpty()
        self.path = os.ttyname(own)
        self._own: int | None = own

    def opened(self) -> None:
        """The emulator has it: our own descriptor would keep it alive."""
        assert self._own is not None
        os.close(self._own)
        self._own = None

    def pull(self) -> None:
        """Once."""
        if self.host >= 0:
            os.close(self.host)
            self.host = -1

    def close(self) -> None:
        self.pull()
        if self._own is not None:
            self.opened()


class EndOfLine:
    """A host's end of an `Adapter`, used as `LmsHost` uses a port of pyserial."""

    def __init__(self, number: int) -> None:
        self._number = number
        self.in_waiting = 65_536
        self.baudrate = 9600

    def read(self, most: int) -> bytes:
        return os.read(self._number, most) if select.select([self._number], [], [], 0.05)[0] else b""

    def write(self, data: bytes) -> None:
        os.write(self._number, data)


def drift_s(stamps_s: Sequence[float], rate_hz: float) -> tuple[float, float]:
    """How much later the second half of a stream came than at that rate after its first half, and what lies between.

    Of each half the one counts that came soonest: a busy machine hands over late, never early.
    """
    late_s = [stamp - number / rate_hz for number, stamp in enumerate(stamps_s)]
    half = len(late_s) // 2
    return min(late_s[half:]) - min(late_s[:half]), half / rate_hz


class LdHost:
    """Talks to an LD-LRS on its TCP port: USP frames, words high byte first."""

    def __init__(self, port: int) -> None:
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=TIME_LIMIT_S)
        self.seen = b""

    def __enter__(self) -> LdHost:
        return self

    def __exit__(self, *_: object) -> None:
        self.socket.close()

    def send(self, *words: int) -> None:
        payload = b"".join(word.to_bytes(2, "big") for word in words)
        self.socket.sendall(b"\x02USP" + len(payload).to_bytes(4, "big") + payload + bytes([xor(payload)]))

    def ask(self, *words: int) -> list[int]:
        """Send a request; data words of its reply. Profiles on the way are skipped."""
        self.send(*words)
        while (got := self.next())[0] != words[0] | 0x8000:
            assert got[0] == 0x8301, [f"{word:04X}" for word in got[:6]]
        return got[1:]

    def next(self) -> list[int]:
        """Words of the next telegram, whose header, length and checksum must be right."""
        while len(self.seen) < 8 or len(self.seen) < 9 + int.from_bytes(self.seen[4:8], "big"):
            data = self.socket.recv(65536)
            assert data, "the device has closed the connection"
            self.seen += data
        end = 8 + int.from_bytes(self.seen[4:8], "big")
        head, payload, check = self.seen[:4], self.seen[8:end], self.seen[end]
        self.seen = self.seen[end + 1 :]
        assert (head, check) == (b"\x02USP", xor(payload))
        return [int.from_bytes(payload[i : i + 2], "big") for i in range(0, len(payload), 2)]

    def measure(self) -> None:
        assert self.ask(0x0403, 0) == [0, 2]
        assert self.ask(0x0404) == [0, 3, 0]

    def profile(self) -> list[tuple[float, float, int]]:
        """Clockwise angle in degrees, metres and amplitude of each point with an echo, of the next profile of 3FFF."""
        while (got := self.next())[:2] != [0x8301, 0x3FFF]:
            pass
        points, at = [], 6
        for sector in range(got[2] & 0xFF):  # the high byte: layers
            number, _step, count, _start_ms, start = got[at : at + 5]
            assert number == sector
            for index in range(count):
                distance, direction, echo = got[at + 5 + 3 * index : at + 8 + 3 * index]
                assert index or direction == start
                if distance:
                    points.append((direction / 16.0, distance / 256.0, echo))
            at += 5 + 3 * count
            assert not count or got[at + 1] == direction
            at += 2
        assert got[at:] == [0, 3]
        return points


def xor(payload: bytes) -> int:
    value = 0
    for byte in payload:
        value ^= byte
    return value
