"""HTTP/1.1 on a device: requests out of a stream, pages as replies.

Belongs here: the form of requests and replies. Not: which paths there are, and what a request does (families).
"""

from __future__ import annotations

from urllib.parse import parse_qsl

from protocols.session import DropReason
from protocols.skeleton.receiving import Fault, Splitter

LONGEST = 8192
"Of a request, with its body."
STATUS = {
    200: "OK", 204: "No Content", 400: "Bad Request", 404: "Not Found", 405: "Method Not Allowed",
    500: "Internal Server Error", 503: "Service Unavailable",
}  # fmt: skip


class HttpRequests(Splitter[bytes]):
    """Requests with a body of a stated length."""

    def _next(self) -> bytes | Fault | None:
        held = self._buffer.peek(len(self._buffer)) or b""
        head, end, _ = held.partition(b"\r\n\r\n")
        if not end:
            return None
        fields = dict(line.lower().partition(b":")[::2] for line in head.split(b"\r\n")[1:])
        length = fields.get(b"content-length", b"0").strip()
        if b"transfer-encoding" in fields or not (length.isdigit() and len(length) < 5):
            return Fault(DropReason.BAD_LENGTH, len(self._buffer.take(len(head) + 4)), "no usable length", whole=True)
        size = len(head) + 4 + int(length)
        if size > LONGEST:
            return Fault(DropReason.OVERLONG, len(self._buffer.take(len(held))), "", whole=True)
        return self._buffer.take(size) if len(held) >= size else None


def page(status: str, body: bytes, kind: str = "text/html", fields: str = "") -> bytes:
    """A reply; drivers want a length and a body. `fields`: further lines of the head, each with CR LF."""
    head = f"HTTP/1.1 {status}\r\n{fields}Content-Type: {kind}\r\nContent-Length: {len(body)}\r\n\r\n"
    return head.encode() + body


def taken_apart(request: bytes) -> tuple[bytes, bytes, bytes]:
    """Method and path, query, and body of a request."""
    head, _, body = request.partition(b"\r\n\r\n")
    method, _, rest = head.partition(b"\r\n")[0].partition(b" ")
    path, _, query = rest.partition(b" ")[0].partition(b"?")
    return method + b" " + path, query, body


def fields_of(text: bytes, most: int = 32) -> dict[str, str]:
    """A query or a form; raises ValueError when it is none."""
    return dict(parse_qsl(text.decode("ascii"), keep_blank_values=True, max_num_fields=most))
