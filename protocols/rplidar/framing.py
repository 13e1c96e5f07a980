"""Replies of RPLIDARs changed on their way: wrong sums, another type, another answer; sums made right again.

Belongs here: places in a reply or a group. Not: when something is changed.
"""

from __future__ import annotations

from protocols.framing import Framing
from protocols.rplidar.codec import DESCRIPTOR, REPLY_SYNC, xor
from protocols.session import Emission

UNKNOWN = b"\xa5\x7f"
"A request that no device knows."
CAPSULES = ("82", "84", "85", "86")


class RplidarFraming(Framing):
    """A descriptor with data, or groups of samples."""

    def bad_check(self, one: Emission) -> bytes | None:
        """Of a capsule its sum; nodes and replies have none."""
        if one.label not in CAPSULES or one.payload[:1] < b"\xa0" or (one.sweep is None and one.scans):
            return None
        return bytes((one.payload[0] ^ 0x01,)) + one.payload[1:]

    def with_sum(self, payload: bytes) -> bytes:
        """A capsule with the sum that it should have."""
        total = xor(payload[2:])
        return bytes((0xA0 | total & 0x0F, 0x50 | total >> 4)) + payload[2:]

    def with_type(self, one: Emission, code: int) -> bytes | None:
        """Another type byte in the descriptor."""
        if not one.payload.startswith(REPLY_SYNC) or len(one.payload) < DESCRIPTOR:
            return None
        return one.payload[: DESCRIPTOR - 1] + bytes((code & 0xFF,)) + one.payload[DESCRIPTOR:]

    def to_be_refused(self, data: bytes) -> bytes | None:
        return UNKNOWN

    def is_whole(self, data: bytes) -> bool:
        return len(data) >= 2
