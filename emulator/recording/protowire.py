"""Protocol buffers, written: the few kinds of fields that messages of the field's formats have.

Belongs here: fields to bytes. Not: which fields a message has (foxglove, osi_out).
"""

from __future__ import annotations

import struct
from collections.abc import Iterable

VARINT, FIXED64, BYTES, FIXED32 = 0, 1, 2, 5


def varint(value: int) -> bytes:
    """Of a number >= 0."""
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def key(number: int, kind: int) -> bytes:
    """Begin of a field."""
    return varint(number << 3 | kind)


def whole(number: int, value: int) -> bytes:
    """An integer >= 0, an enumeration, a truth value."""
    return key(number, VARINT) + varint(value)


def fixed32(number: int, value: int) -> bytes:
    """An integer of four bytes."""
    return key(number, FIXED32) + struct.pack("<I", value)


def double(number: int, value: float) -> bytes:
    """A float of eight bytes."""
    return key(number, FIXED64) + struct.pack("<d", value)


def piece(number: int, data: bytes | str) -> bytes:
    """A message, text or bytes."""
    raw = data.encode() if isinstance(data, str) else data
    return key(number, BYTES) + varint(len(raw)) + raw


def doubles(values: Iterable[float]) -> bytes:
    """Fields 1, 2, 3, ... of a message of floats: a vector, an orientation, a colour."""
    return b"".join(double(number, value) for number, value in enumerate(values, start=1))


def instant(at_ns: int) -> bytes:
    """Seconds and nanoseconds: `google.protobuf.Timestamp` and `osi3.Timestamp`."""
    return whole(1, at_ns // 1_000_000_000) + whole(2, at_ns % 1_000_000_000)
