"""Messages of the user protocol on CAN: words cut into frames with a count-down, 11-bit identifiers.

Source: Fawkes `lase_edl_aqt.cpp` (Lase ELD-L-A), the only one.
"""

from __future__ import annotations

from protocols.session import DropReason
from protocols.skeleton.receiving import Fault

SINGLE = 0x0000
MULTIPLE = 0xFFFF

MAX_MESSAGE_WORDS = 2048
"Longest message put together from a host's frames, to within a frame; ours."


def encode_segments(payload: bytes, identity: int) -> list[bytes]:
    """Data fields of the frames of a message; `identity` is the ID word that its receiver looks for."""
    words = len(payload) // 2
    name = identity.to_bytes(2, "big")
    if words <= 2:
        return [b"\0\0" + name + payload]
    count = 1 + -(-(words - 1) // 3)
    frames = [b"\xff\xff" + count.to_bytes(2, "big") + name + payload[:2]]
    rest = payload[2:]
    left = range(count - 1, 0, -1)
    frames.extend(left[i].to_bytes(2, "big") + rest[6 * i : 6 * i + 6] for i in range(count - 1))
    return frames


def worst_case_bits(length: int) -> int:
    """Most bits that a standard frame of `length` data bytes takes, stuff bits and the pause behind it included."""
    return 47 + 8 * length + (33 + 8 * length) // 4


class SegmentJoiner:
    """Puts the message of several frames of one sender together. Holds at most `MAX_MESSAGE_WORDS`."""

    def __init__(self) -> None:
        self._parts = bytearray()
        self._left = 0
        self._identity = 0

    def __bool__(self) -> bool:
        """Whether something incomplete is held."""
        return self._left > 0

    def add(self, data: bytes) -> tuple[int, bytes] | Fault | None:
        """ID word and message once it is whole; a fault; None: more is to come."""
        if len(data) % 2 or len(data) < 4:
            self._left = 0
            return Fault(DropReason.BAD_LENGTH, len(data), "want two to four whole words")
        number = int.from_bytes(data[:2], "big")
        if number == SINGLE:
            self._left = 0
            return int.from_bytes(data[2:4], "big"), data[4:]
        if number == MULTIPLE and len(data) == 8:
            # FFFF cannot be a count-down of a message that we would hold
            self._left = int.from_bytes(data[2:4], "big") - 1
            self._identity = int.from_bytes(data[4:6], "big")
            self._parts[:] = data[6:]
            if self._left < 1 or 3 * self._left - 1 > MAX_MESSAGE_WORDS:
                count, self._left = self._left + 1, 0
                return Fault(DropReason.OVERLONG if count > 1 else DropReason.BAD_LENGTH, len(data), f"{count} frames")
            return None
        if number != self._left:
            self._left = 0
            return Fault(DropReason.BAD_LENGTH, len(data), f"frame {number:04X} out of turn")
        if self._left > 1 and len(data) != 8:
            self._left = 0
            return Fault(DropReason.BAD_LENGTH, len(data), "only the last frame may be short")
        self._parts += data[2:]
        self._left -= 1
        return None if self._left else (self._identity, bytes(self._parts))

    def expire(self) -> list[Fault]:
        """Give up the message that stopped half-way."""
        gone, self._left = len(self._parts) if self._left else 0, 0
        return [Fault(DropReason.TIMEOUT, gone)] if gone else []
