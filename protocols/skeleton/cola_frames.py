"""Frames of both dialects of CoLa, distinguished telegram by telegram.

    CoLa-A    STX text ETX
    CoLa-B    02 02 02 02, length of the payload (32 bits, big endian), payload, XOR of the payload

Belongs here: from bytes to payloads and back. Not: what a payload says (cola_values).
"""

from __future__ import annotations

import re

from protocols.checksums import xor8
from protocols.session import DropReason
from protocols.skeleton.cola_values import ASCII, BINARY, ETX, STX, Code
from protocols.skeleton.receiving import Fault, Splitter

START = STX * 4
HEAD_BYTES = 8
LONGEST = 16_384
"A host's longest telegram writes a segmented field of 1141 directions."
UNKNOWN = {b"sRN": Code.VARIABLE_UNKNOWN, b"sWN": Code.VARIABLE_UNKNOWN, b"sMN": Code.METHOD_UNKNOWN,
           b"sEN": Code.EVENT_UNKNOWN}  # fmt: skip
"What a name is that the device does not have, by the type of the telegram."
CONTROL = re.compile(rb"[\x00-\x1f]")
"The first of these behind STX ends a text, or it is none."


def frame(dialect: bytes, payload: bytes) -> bytes:
    """A telegram on the wire."""
    if dialect == ASCII:
        return STX + payload + ETX
    return START + len(payload).to_bytes(4, "big") + payload + bytes((xor8(payload),))


def telegram(dialect: bytes, head: bytes, name: bytes, data: bytes = b"") -> bytes:
    """On the wire: type, name, arguments; in CoLa-B the blank stands even where nothing follows."""
    blank = b" " if data or dialect == BINARY else b""
    return frame(dialect, head + b" " + name + blank + data)


def refused(dialect: bytes, code: Code) -> bytes:
    """The payload of `sFA`."""
    return b"sFA %X" % code if dialect == ASCII else b"sFA" + int(code).to_bytes(2, "big")


def opened(telegram: bytes) -> tuple[bytes, bytes] | None:
    """Dialect and payload of one whole telegram; None: it is none, or damaged."""
    found = ColaSplitter(1 << 20).feed(telegram)
    one = found[0] if len(found) == 1 else None
    return (one[:1], one[1:]) if isinstance(one, bytes) else None


class ColaSplitter(Splitter[bytes]):
    """Finds telegrams; an item is the letter of its dialect and the payload.

    Of a false start only its first bytes are skipped; what follows them is read again.
    """

    def __init__(self, longest: int = LONGEST) -> None:
        super().__init__(longest + HEAD_BYTES + 1)
        self._longest = longest

    def expire(self) -> list[bytes | Fault]:
        """Give up the telegram that stopped half-way; what a false start swallowed is read again."""
        gone = len(self._buffer.take(1))
        return [Fault(DropReason.TIMEOUT, gone), *self.feed(b"")] if gone else []

    def _next(self) -> bytes | Fault | None:
        if skipped := self._buffer.skip_to(STX):
            return Fault(DropReason.NO_START_BYTE, skipped)
        held = self._buffer.peek(len(self._buffer)) or b""
        starts = len(held) - len(held.lstrip(STX))
        if starts >= len(START):
            return self._binary(held)
        if starts == len(held):
            return None  # either dialect
        if starts > 1:
            return Fault(DropReason.NO_START_BYTE, len(self._buffer.take(starts - 1)))
        control = CONTROL.search(held, 1)
        if control is None:
            return None
        end = control.start()
        if held[end : end + 1] != ETX:
            return Fault(DropReason.BAD_LENGTH, len(self._buffer.take(end)), "no ETX")
        self._buffer.take(end + 1)
        return ASCII + held[1:end]

    def _binary(self, held: bytes) -> bytes | Fault | None:
        if len(held) < HEAD_BYTES:
            return None
        length = int.from_bytes(held[4:8], "big")
        if length > self._longest:
            return Fault(DropReason.BAD_LENGTH, len(self._buffer.take(1)), f"{length} bytes")
        if len(held) < HEAD_BYTES + length + 1:
            return None
        payload = held[HEAD_BYTES : HEAD_BYTES + length]
        if held[HEAD_BYTES + length] != xor8(payload):
            return Fault(DropReason.BAD_CHECKSUM, len(self._buffer.take(len(START))), whole=True)
        self._buffer.take(HEAD_BYTES + length + 1)
        return BINARY + payload
