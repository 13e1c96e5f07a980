"""HTTP/1.1 on a device, as h11 reads and writes it: requests out of a stream, pages as replies.

Each request has a reader of its own, as replies leave later. Belongs here: where a request ends, bounds. Not: which
paths there are, and what a request does (families).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from http import HTTPStatus
from typing import ClassVar
from urllib.parse import parse_qsl

import h11

from protocols.receive_buffer import ReceiveBuffer
from protocols.session import DropReason
from protocols.skeleton.receiving import Fault, Splitter
from protocols.skeleton.requests import RequestSession

LONGEST = 8192
"Of a request, with its body."
END = b"\r\n\r\n"
"Of a head."


@dataclass(frozen=True)
class Asked:
    """What a request says."""

    code: bytes
    "Method and path."
    query: bytes
    body: bytes
    host: str
    "Whom it calls; empty: it does not say."
    size: int
    "Bytes of it in the stream."
    last: bool
    "The connection ends with the reply."


def first_of(held: bytes) -> Asked | None:
    """The first request in a stream; None: more bytes are needed. Raises `h11.RemoteProtocolError` if it is none."""
    head, end, rest = held.partition(END)
    if not end:
        return None
    lines = head.split(b"\r\n")
    if not any(line[:5].lower() == b"host:" for line in lines):
        lines.append(b"Host: ")  # h11 insists on it, devices do not
    reader = h11.Connection(h11.SERVER, LONGEST)
    reader.receive_data(b"\r\n".join(lines) + END + rest)
    request, body = reader.next_event(), b""
    assert isinstance(request, h11.Request)
    while not isinstance(part := reader.next_event(), h11.EndOfMessage):
        if not isinstance(part, h11.Data):
            if len(head) + len(END) + int(dict(request.headers).get(b"content-length", b"0")) > LONGEST:
                raise h11.RemoteProtocolError(f"longer than {LONGEST} bytes")
            return None
        body += part.data
    path, _, query = request.target.partition(b"?")
    host = dict(request.headers)[b"host"].decode("latin-1")
    last = reader.their_state is h11.MUST_CLOSE
    return Asked(request.method + b" " + path, query, body, host, len(held) - len(reader.trailing_data[0]), last)


class NoRequest(Fault):
    """A head that is none of HTTP, or of a body that is none."""


def next_in(buffer: ReceiveBuffer, meant: Callable[[bytes], bytes] = bytes) -> bytes | NoRequest | None:
    """The first request in a buffer, removed; None: it is not whole. `meant`: what drivers mean that break rules."""
    held = buffer.peek(len(buffer)) or b""
    stream = meant(held)
    try:
        found = first_of(stream)
    except h11.RemoteProtocolError as error:
        size = len(buffer.take(held.find(END) + len(END)))
        return NoRequest(DropReason.BAD_LENGTH, size, str(error), whole=True)
    if found is None:
        return None
    buffer.take(found.size + len(held) - len(stream))
    return stream[: found.size]


class HttpRequests(Splitter[bytes]):
    """Requests, each as its bytes."""

    def _next(self) -> bytes | Fault | None:
        return next_in(self._buffer)


def read(request: bytes) -> Asked:
    """What a whole request says, as `HttpRequests` gives it."""
    found = first_of(request)
    assert found is not None
    return found


def page(status: int, body: bytes = b"", kind: str = "text/html", fields: Iterable[tuple[str, str]] = ()) -> bytes:
    """A reply; drivers want a length and a body, but for 204. `fields`: the first ones of its head."""
    headers = list(fields)
    if status != HTTPStatus.NO_CONTENT:
        headers += [("Content-Type", kind), ("Content-Length", str(len(body)))]
    writer = h11.Connection(h11.SERVER)
    parts = (
        h11.Response(status_code=status, reason=HTTPStatus(status).phrase, headers=headers),
        h11.Data(data=body),
        h11.EndOfMessage(),
    )
    return b"".join(writer.send(part) or b"" for part in parts)


def answered(method: bytes, reply: bytes) -> bytes:
    """The reply to a request of this method or code; that to HEAD ends with its head (RFC 9110, 9.3.2)."""
    return reply[: reply.index(END) + len(END)] if method.startswith(b"HEAD ") else reply


def last(reply: bytes) -> bytes:
    """That reply, when the connection ends with it."""
    head, end, body = reply.partition(END)
    lines = [line for line in head.split(b"\r\n") if not line.lower().startswith(b"connection:")]
    return b"\r\n".join([*lines, b"Connection: close"]) + end + body


class HttpSession(RequestSession):
    """A device of which requests may come by HTTP: a connection ends where its client says so."""

    WEB: ClassVar[tuple[bytes, ...]] = (b"",)
    "How requests of HTTP begin, where a device has others too."

    def _ends(self, request: bytes) -> bool:
        return request.startswith(self.WEB) and read(request).last

    def _last(self, reply: bytes) -> bytes:
        return last(reply)


def fields_of(text: bytes, most: int = 32) -> dict[str, str]:
    """A query or a form; raises ValueError when it is none."""
    return dict(parse_qsl(text.decode("ascii"), keep_blank_values=True, max_num_fields=most))
