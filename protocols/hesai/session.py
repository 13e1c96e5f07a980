"""The control channel of a Hesai: PTC 1.0 and HTTP, both on any connection.

Belongs here: framing of requests and replies, return codes. Not: what a command does (commands).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from protocols.hesai.commands import COMMANDS, page
from protocols.hesai.device import HesaiDevice
from protocols.hesai.models import Model
from protocols.hesai.settings import Build, Settings
from protocols.session import DropReason, LinkKind
from protocols.skeleton.receiving import Fault, FrameSplitter, Refusal
from protocols.skeleton.requests import Command, Host, Refused, Request

HEAD_BYTES = 8
LONGEST = 65_536
"Of a request."
LONGEST_HTTP = 4096
GET = b"GET "
BAD_INPUT, BAD_DATA, UNSUPPORTED = 1, 3, 5
"Return codes."


def frame(command: int, payload: bytes = b"", code: int = 0) -> bytes:
    """A request, or with its return code a reply."""
    return b"\x47\x74" + bytes((command, code)) + len(payload).to_bytes(4, "big") + payload


class PtcRequests(FrameSplitter):
    """Frames of PTC, and lines of HTTP with their heads."""

    START = b"\x47\x74"
    HEAD_BYTES = HEAD_BYTES

    def _next(self) -> bytes | Fault | None:
        held = self._buffer.peek(min(len(self._buffer), LONGEST_HTTP)) or b""
        if not held or not GET.startswith(held[: len(GET)]):
            return super()._next()
        end = held.find(b"\r\n\r\n")
        if end >= 0:
            return self._buffer.take(end + 4)
        if len(held) < LONGEST_HTTP:
            return None
        return Fault(DropReason.OVERLONG, len(self._buffer.take(LONGEST_HTTP)))

    def _size(self, head: bytes) -> int | Refusal:
        length = int.from_bytes(head[4:8], "big")
        if length > LONGEST - HEAD_BYTES:
            return DropReason.BAD_LENGTH, f"{length} bytes"
        return HEAD_BYTES + length

    def _open(self, frame: bytes) -> bytes | Refusal:
        return frame


class HesaiSession(HesaiDevice):
    """With its requests."""

    COMMANDS: ClassVar[Mapping[bytes, Command]] = COMMANDS
    restart_hangs_up = True

    def __init__(self, model: Model, settings: Settings, build: Build) -> None:
        super().__init__(model, settings, build)
        self.error_code = 0
        "Answered to every command of PTC; 0: none."

    def impair(self, now_ns: int, what: str, degree: float) -> bool:
        """And what it answers."""
        if what == "calibration":
            self.calibration = round(degree)
        elif what == "ptc error":
            self.error_code = round(degree)
        else:
            return super().impair(now_ns, what, degree)
        return True

    def _splitter(self, kind: LinkKind | None) -> PtcRequests:
        return PtcRequests(LONGEST)

    def _parse(self, request: bytes) -> tuple[bytes, bytes]:
        if not request.startswith(GET):
            return f"{request[2]:02X}".encode(), request[HEAD_BYTES:]
        # drivers send spaces and quotes of a query as they are
        line = request.partition(b"\r\n")[0][len(GET) :]
        target = line.rpartition(b" HTTP/")[0] or line
        path, _, query = target.partition(b"?")
        return GET + path, query

    def _carry_out(self, request: Request, size: int, host: Host) -> None:
        if self.error_code and not request.code.startswith(GET):
            self._events.drop(request.now_ns, DropReason.REFUSED, "fault", size)
            self._say(frame(int(request.code, 16), code=self.error_code), request.code.decode(), host, request.now_ns)
            return
        super()._carry_out(request, size, host)

    def _reply(self, request: Request, payload: bytes) -> bytes:
        return payload if request.code.startswith(GET) else frame(int(request.code, 16), payload)

    def _refusal(self, request: Request, refused: Refused) -> bytes:
        if request.code.startswith(GET):
            known = request.code in self.COMMANDS
            return page(1) if known else b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\n\r\n"
        if request.code == b"05" and refused.reason is DropReason.REFUSED:
            code = BAD_DATA
        else:
            code = BAD_INPUT if refused.reason in (DropReason.BAD_ARGUMENT, DropReason.BAD_LENGTH) else UNSUPPORTED
        return frame(int(request.code, 16), code=code)
