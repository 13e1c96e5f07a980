"""Replies behind a descriptor: `A5 5A`, length and mode, type. RPLIDAR's form, which YDLIDAR took over.

Belongs here: the descriptor, and places in it. Not: which types there are, and the data behind it.
"""

from __future__ import annotations

import struct

from protocols.framing import Framing
from protocols.session import Emission

SYNC, REPLY_SYNC = 0xA5, b"\xa5\x5a"
"The first byte of a request, and of a reply the first two."
DESCRIPTOR = 7
"Bytes of it."
MULTIPLE = 1 << 30
"In the length: of that many bytes more than one follow."
UNKNOWN = b"\xa5\x7f"
"A request that no device knows."


def descriptor(kind: int, length: int, multiple: bool = False) -> bytes:
    """What comes before the data of a reply."""
    return REPLY_SYNC + struct.pack("<IB", length | MULTIPLE * multiple, kind)


def reply(kind: int, data: bytes) -> bytes:
    """A reply of one piece."""
    return descriptor(kind, len(data)) + data


class DescriptorFraming(Framing):
    """Replies of one piece, and requests of at least two bytes."""

    def with_type(self, one: Emission, code: int) -> bytes | None:
        """Another type byte in the descriptor."""
        if not one.payload.startswith(REPLY_SYNC) or len(one.payload) < DESCRIPTOR:
            return None
        return one.payload[: DESCRIPTOR - 1] + bytes((code & 0xFF,)) + one.payload[DESCRIPTOR:]

    def to_be_refused(self, data: bytes) -> bytes | None:
        return UNKNOWN

    def is_whole(self, data: bytes) -> bool:
        return len(data) >= 2
