"""Packets of points changed on their way: wrong CRC, other counters, old points.

Belongs here: places in a packet. Not: when something is changed.
"""

from __future__ import annotations

from protocols.framing import Framing
from protocols.livox.codec import CRC_AT, HEAD_BYTES, is_packet, with_crc
from protocols.session import Emission


class PointFraming(Framing):
    """One packet per emission."""

    def bad_check(self, one: Emission) -> bytes | None:
        """A wrong CRC."""
        data = one.payload
        return data[:CRC_AT] + bytes((data[CRC_AT] ^ 0x55,)) + data[CRC_AT + 1 :] if is_packet(data) else None

    def with_length(self, one: Emission, change: int) -> bytes | None:
        """Another length in the head."""
        return _with(one.payload, 1, 2, change)

    def with_counter(self, one: Emission, change: int) -> bytes | None:
        """Another number of the packet."""
        return _with(one.payload, 7, 2, change)

    def with_type(self, one: Emission, code: int) -> bytes | None:
        """Another type of data."""
        data = one.payload
        return data[:10] + bytes((code & 0xFF,)) + data[11:] if is_packet(data) else None

    def stale(self, old: Emission, fresh: Emission) -> bytes | None:
        """Points of an old packet with counters and time stamp of a new one."""
        was, now = old.payload, fresh.payload
        if not is_packet(was) or not is_packet(now) or len(was) != len(now):
            return None
        return with_crc(now[:HEAD_BYTES] + was[HEAD_BYTES:])


def _with(data: bytes, at: int, size: int, change: int) -> bytes | None:
    if not is_packet(data):
        return None
    value = (int.from_bytes(data[at : at + size], "little") + change) % (1 << 8 * size)
    return with_crc(data[:at] + value.to_bytes(size, "little") + data[at + size :])
