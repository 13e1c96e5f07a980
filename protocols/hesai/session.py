"""The control channel of a Hesai: PTC 1.0 and HTTP on any connection; PTC 2.0 and TLS are refused in their own frames.

Belongs here: framing of requests and replies, return codes. Not: what a command does (commands).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from protocols.hesai.commands import COMMANDS, PTC_2, PTC_TLS, page
from protocols.hesai.device import HesaiDevice
from protocols.session import DropReason, LinkKind
from protocols.skeleton import http
from protocols.skeleton.receiving import Fault, FrameSplitter, Refusal
from protocols.skeleton.requests import Command, Host, Refused, Request

HEAD_BYTES = 8
LONGEST = 65_536
"Of a request."
LONGEST_HTTP = 4096
GET = b"GET "
SECOND, SECOND_HEAD_BYTES = b"\x57\x75\x01", 12
"How a request of PTC 2.0 begins."
HELLO, RECORD_BYTES = b"\x16\x03", 5
"How a handshake of TLS begins: a record that ends with a length, then the kind of message."
NO_TLS = b"\x15\x03\x01\0\2\2\x28"
"Fatal alert: handshake failure."
BAD_INPUT, BAD_DATA, UNSUPPORTED = 1, 3, 5
"Return codes."


def frame(command: int, payload: bytes = b"", code: int = 0) -> bytes:
    """A request, or with its return code a reply."""
    return b"\x47\x74" + bytes((command, code)) + len(payload).to_bytes(4, "big") + payload


def quoted(held: bytes) -> bytes:
    """A request whose query has its spaces as drivers send them, with quoted ones."""
    line, end, rest = held.partition(b"\r\n")
    target, version, number = line[len(GET) :].rpartition(b" HTTP/")
    return GET + target.replace(b" ", b"%20") + version + number + end + rest if version else held


@dataclass(frozen=True)
class TooLong(Fault):
    """A request that says it is longer than any."""

    command: int = 0


class PtcRequests(FrameSplitter):
    """Frames of PTC, and lines of HTTP with their heads."""

    START = b"\x47\x74"
    HEAD_BYTES = HEAD_BYTES

    def _next(self) -> bytes | Fault | None:
        held = self._buffer.peek(min(len(self._buffer), LONGEST_HTTP)) or b""
        if held and GET.startswith(held[: len(GET)]):
            found = http.next_in(self._buffer, quoted)
            if found is None and held[LONGEST_HTTP - 1 :]:
                return Fault(DropReason.OVERLONG, len(self._buffer.take(LONGEST_HTTP)))
            return found
        if held and SECOND.startswith(held[: len(SECOND)]):
            return self._whole(held, SECOND_HEAD_BYTES)
        if held and HELLO.startswith(held[: len(HELLO)]):
            return self._whole(held, RECORD_BYTES, 2)
        return self._whole(held, HEAD_BYTES) if held.startswith(self.START) else super()._next()

    def _whole(self, held: bytes, head: int, width: int = 4) -> bytes | Fault | None:
        """A frame whose head ends with its length; one that is too long is answered by its head alone."""
        size = head + int.from_bytes(held[head - width : head], "big")
        if len(held) < head or len(self._buffer) < size <= LONGEST:
            return None
        if size <= LONGEST or head != HEAD_BYTES:
            return self._buffer.take(size if size <= LONGEST else head)
        self._buffer.take(head)
        return TooLong(DropReason.BAD_LENGTH, head, f"{size - head} bytes", True, held[2])

    def _size(self, head: bytes) -> int | Refusal:
        return HEAD_BYTES

    def _open(self, frame: bytes) -> bytes | Refusal:
        return frame


class HesaiSession(http.HttpSession, HesaiDevice):
    """With its requests."""

    COMMANDS: ClassVar[Mapping[bytes, Command]] = COMMANDS
    WEB = (GET,)
    restart_hangs_up = True
    error_code = 0
    "Answered to every command of PTC; 0: none."

    def impair(self, now_ns: int, what: str, degree: float) -> bool:
        """And what it answers."""
        if what == "calibration":
            self.calibration = round(degree)
        elif what == "wrong calibration served":
            self.wrong_deg = degree
        elif what == "ptc error":
            self.error_code = round(degree)
        else:
            return super().impair(now_ns, what, degree)
        return True

    def _splitter(self, kind: LinkKind | None) -> PtcRequests:
        return PtcRequests(LONGEST)

    def _parse(self, request: bytes) -> tuple[bytes, bytes]:
        if request.startswith(SECOND):
            return PTC_2, request
        if request.startswith(HELLO):
            return PTC_TLS, request
        if not request.startswith(GET):
            return f"{request[2]:02X}".encode(), request[HEAD_BYTES:]
        asked = http.read(request)
        return asked.code, asked.query

    def _carry_out(self, request: Request, size: int, host: Host) -> None:
        if self.error_code and len(request.code) == 2:
            self._events.drop(request.now_ns, DropReason.REFUSED, "fault", size)
            self._say(frame(int(request.code, 16), code=self.error_code), request.code.decode(), host, request.now_ns)
            return
        super()._carry_out(request, size, host)

    def _reply(self, request: Request, payload: bytes) -> bytes:
        return payload if request.code.startswith(GET) else frame(int(request.code, 16), payload)

    def _complaint(self, fault: Fault) -> bytes | None:
        if isinstance(fault, http.NoRequest):
            return http.page(400)
        return frame(fault.command, code=BAD_INPUT) if isinstance(fault, TooLong) else None

    def _refusal(self, request: Request, refused: Refused) -> bytes:
        if request.code.startswith(GET):
            known = request.code in self.COMMANDS
            return page(1) if known else http.page(404)
        if request.code == PTC_2:
            return SECOND + bytes((request.data[3], UNSUPPORTED)) + bytes(7)
        if request.code == PTC_TLS:
            return NO_TLS
        if request.code == b"05" and refused.reason is DropReason.REFUSED:
            code = BAD_DATA
        else:
            code = BAD_INPUT if refused.reason in (DropReason.BAD_ARGUMENT, DropReason.BAD_LENGTH) else UNSUPPORTED
        return frame(int(request.code, 16), code=code)
