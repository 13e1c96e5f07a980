"""Replies of RPLIDARs changed on their way: wrong sums, another type, requests that no device knows.

Belongs here: places in a reply or a group. Not: when something is changed.
"""

from __future__ import annotations

from protocols.framing import Framing
from protocols.rplidar.codec import DESCRIPTOR, REPLY_SYNC
from protocols.session import Emission

UNKNOWN = b"\xa5\x7f"
"A request that no device knows."
CAPSULES, HQ_LABEL = ("82", "84", "85", "86"), "83"


class RplidarFraming(Framing):
    """A descriptor with data, or groups of samples."""

    def bad_check(self, one: Emission) -> bytes | None:
        """Of a capsule its sum, of an HQ block its CRC; nodes and replies have none."""
        if one.sweep is None and one.scans:
            return None
        if one.label == HQ_LABEL:
            return one.payload[:-1] + bytes((one.payload[-1] ^ 0x01,))
        return bytes((one.payload[0] ^ 0x01,)) + one.payload[1:] if one.label in CAPSULES else None

    def with_type(self, one: Emission, code: int) -> bytes | None:
        """Another type byte in the descriptor."""
        if not one.payload.startswith(REPLY_SYNC) or len(one.payload) < DESCRIPTOR:
            return None
        return one.payload[: DESCRIPTOR - 1] + bytes((code & 0xFF,)) + one.payload[DESCRIPTOR:]

    def to_be_refused(self, data: bytes) -> bytes | None:
        return UNKNOWN

    def is_whole(self, data: bytes) -> bool:
        return len(data) >= 2
