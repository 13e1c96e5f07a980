"""One RPLIDAR: frames of requests in, descriptors and data out.

Belongs here: the form of requests and replies. Not: what they do (commands).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from protocols.checksums import xor8
from protocols.rplidar import commands
from protocols.rplidar.device import BLOCK, BLOCKS, RplidarDevice
from protocols.session import DropReason, LinkKind
from protocols.skeleton.descriptors import SYNC
from protocols.skeleton.receiving import Fault, Splitter
from protocols.skeleton.requests import Command, Host, Request

LONGEST = 3 + 255 + 1
DETECT = b"\x41"


class Frames(Splitter[bytes]):
    """Requests `A5 code`, those from 80 on with size, payload and sum; a run of 41 is one request `41`."""

    def _next(self) -> bytes | Fault | None:
        held = self._buffer.peek(len(self._buffer)) or b""
        begin = held.find(SYNC)
        noise = held if begin < 0 else held[:begin]
        if noise:
            if noise.count(BLOCK) == len(noise) and begin < 0 and len(noise) < BLOCKS:
                return None  # perhaps blocks to measure the speed by
            self._buffer.take(len(noise))
            return DETECT if bytes((BLOCK,)) * BLOCKS in noise else Fault(DropReason.NO_START_BYTE, len(noise))
        if len(held) < 2:
            return None
        if held[1] < 0x80:
            return self._buffer.take(2)
        if len(held) < 3 or len(held) < 4 + held[2]:
            return None
        frame = held[: 4 + held[2]]
        if xor8(frame):
            self._buffer.take(1)
            return Fault(DropReason.BAD_CHECKSUM, 1)
        return self._buffer.take(len(frame))


class RplidarSession(RplidarDevice):
    """With its commands."""

    COMMANDS: ClassVar[Mapping[bytes, Command]] = commands.COMMANDS

    def _splitter(self, kind: LinkKind | None) -> Frames:
        return Frames(LONGEST)

    def _parse(self, request: bytes) -> tuple[bytes, bytes]:
        if request == DETECT:
            self.detect(self._now_ns)
            return b"", b""
        return request[1:2], request[3:-1]

    def _carry_out(self, request: Request, size: int, host: Host) -> None:
        ends = request.code in self.COMMANDS and request.code not in commands.DURING_SCAN
        if self.stream is not None and ends:
            self.stop(request.now_ns)
        super()._carry_out(request, size, host)

    def _reply(self, request: Request, payload: bytes) -> bytes:
        return payload
