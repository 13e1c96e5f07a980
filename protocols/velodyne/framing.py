"""Velodyne's datagrams changed on their way: another time stamp, old values under a fresh one.

Belongs here: places in a packet; it has no checksum. Not: when something is changed.
"""

from __future__ import annotations

from protocols.framing import Framing
from protocols.session import Emission
from protocols.velodyne.codec import DATA_BYTES, HOUR_US

UNKNOWN = b"GET /unknown HTTP/1.1\r\n\r\n"


class VelodyneFraming(Framing):
    """One packet per emission."""

    def with_counter(self, one: Emission, change: int) -> bytes | None:
        """Its time stamp, in microseconds."""
        if len(one.payload) != DATA_BYTES:
            return None
        stamp = (int.from_bytes(one.payload[1200:1204], "little") + change) % HOUR_US
        return one.payload[:1200] + stamp.to_bytes(4, "little") + one.payload[1204:]

    def with_type(self, one: Emission, code: int) -> bytes | None:
        """Another model."""
        return one.payload[:-1] + bytes((code & 0xFF,)) if len(one.payload) == DATA_BYTES else None

    def stale(self, old: Emission, fresh: Emission) -> bytes | None:
        if len(old.payload) != DATA_BYTES or len(fresh.payload) != DATA_BYTES:
            return None
        return old.payload[:1200] + fresh.payload[1200:]

    def to_be_refused(self, data: bytes) -> bytes | None:
        return UNKNOWN

    def is_whole(self, data: bytes) -> bool:
        return b"\r\n\r\n" in data
