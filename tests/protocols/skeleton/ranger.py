"""An invented device with a whole command channel, as the families to come have: frames on a line, TCP or UDP, scans to
each host that asked, settings that scans depend on, a reset, another line speed, telegrams by the clock.

Not: a device that anybody sells. Requests are `AB size code data sum`, replies `BA ...`.
"""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from typing import ClassVar

import numpy as np

from protocols.scan import Scan
from protocols.session import DropReason, Emission, LinkKind
from protocols.skeleton.instants import SECOND_NS
from protocols.skeleton.receiving import Fault, FrameSplitter, Refusal
from protocols.skeleton.requests import Answer, Command, Refused, Request, RequestSession
from protocols.skeleton.sweeps import Sweep, Telegram

MS = 1_000_000
BEAMS = 4
BOOT_NS = 300 * MS
HEARTBEAT_NS = 250 * MS


def framed(start: bytes, data: bytes) -> bytes:
    body = start + bytes((4 + len(data),)) + data
    return body + bytes((sum(body) & 0xFF,))


def request(code: bytes, data: bytes = b"") -> bytes:
    return framed(b"AB", code + data)


class Frames(FrameSplitter):
    """Requests."""

    START = b"AB"
    HEAD_BYTES = 3

    def _size(self, head: bytes) -> int | Refusal:
        return head[2] if 5 <= head[2] <= 16 else (DropReason.BAD_LENGTH, f"{head[2]} bytes")

    def _open(self, frame: bytes) -> bytes | Refusal:
        return frame[3:-1] if sum(frame[:-1]) & 0xFF == frame[-1] else (DropReason.BAD_CHECKSUM, "")


class Ranger(RequestSession):
    """Three scans a turn of 100 ms, two telegrams a scan."""

    LINE_SPEED = 115_200
    INTER_BYTE_NS = 50 * MS

    def __init__(self, heartbeat: bool = False) -> None:
        super().__init__(BOOT_NS, Fraction(100 * MS, 3))
        self._heartbeat = heartbeat

    def _start(self, now_ns: int) -> None:
        if self._heartbeat:
            self._timers.add(now_ns + HEARTBEAT_NS, HEARTBEAT_NS, self._beat)

    def _beat(self, now_ns: int) -> None:
        self._outbox.send(Emission(now_ns, b"beat", label="beat"))

    def _sweep(self, number: int) -> Sweep:
        angle = np.linspace(-0.5, 0.5, BEAMS)
        return Sweep(angle, np.zeros(BEAMS), np.arange(BEAMS) * 0.002, 0.010, max_range_m=30.0)

    def _telegrams(self, scan: Scan) -> list[Telegram]:
        words = np.nan_to_num(scan.range_m[:, 0] * 100.0).astype("<u2").tobytes()
        number = bytes((scan.plan.sweep & 0xFF,))
        return [Telegram(6 * MS, b"1" + number + words[:4], "1"), Telegram(10 * MS, b"2" + number + words[4:], "2")]

    def _splitter(self, kind: LinkKind | None) -> Frames:
        return Frames(16)

    def _parse(self, request: bytes) -> tuple[bytes, bytes]:
        return request[:1], request[1:]

    def _reply(self, request: Request, payload: bytes) -> bytes:
        return framed(b"BA", request.code + payload)

    def _refusal(self, request: Request, refused: Refused) -> bytes | None:
        return framed(b"BA", b"?" + request.code)

    def _complaint(self, fault: Fault) -> bytes | None:
        return b"\x15" if fault.reason is DropReason.BAD_CHECKSUM else None

    def _begin(self, request: Request) -> bytes:
        self._subscribe(request.now_ns, request.address)
        return b""

    def _end(self, request: Request) -> bytes:
        self._unsubscribe(request.now_ns, request.address)
        return b""

    def _rate(self, request: Request) -> bytes | Refused:
        if len(request.data) != 1 or not 1 <= request.data[0] <= 50:
            return Refused(DropReason.BAD_ARGUMENT, f"{request.data.hex()}; want 1 to 50")
        self._change(request.now_ns, Fraction(SECOND_NS, request.data[0]))
        return request.data

    def _faster(self, request: Request) -> Answer:
        return Answer(b"", line_speed=460_800)

    def _reset(self, now_ns: int) -> None:
        self._nominal_ns = Fraction(100 * MS, 3)

    def _start_again(self, request: Request) -> Answer:
        return Answer(b"", restarts=True)

    def _be_quiet(self, request: Request) -> Answer:
        return Answer(None)

    COMMANDS: ClassVar[Mapping[bytes, Command]] = {
        b"S": Command("scans to whoever asks", _begin, "here"),
        b"E": Command("no scans any more", _end, "here"),
        b"R": Command("scans a second", _rate, "here", "1 to 50"),
        b"B": Command("line to 460800 baud", _faster, "here"),
        b"X": Command("reset", _start_again, "here"),
        b"Q": Command("nothing, without a word", _be_quiet, "here"),
        b"\x00": Command("factory", None, "here"),
    }
