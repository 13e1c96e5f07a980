"""Ouster's datagrams changed on their way: another time stamp, a wrong checksum, old values under a fresh stamp.

Belongs here: places in a packet. Not: when something is changed.
"""

from __future__ import annotations

import struct

from protocols.checksums import crc64_xz
from protocols.framing import Framing
from protocols.ouster.codec import COLUMNS, END, PLACEHOLDER, PROFILES
from protocols.session import Emission

UNKNOWN = b"GET /api/v1/unknown HTTP/1.1\r\n\r\n"
SIZES = {one.size(rows): one for one in PROFILES.values() for rows in (32, 64, 128)}
"Length of a packet -> one of the profiles that have it."


class OusterFraming(Framing):
    """One packet per emission."""

    def bad_check(self, one: Emission) -> bytes | None:
        """Another checksum; of firmware that has none, None."""
        tail = one.payload[-8:]
        if one.label != "lidar" or SIZES[len(one.payload)].legacy or tail in (bytes(8), PLACEHOLDER):
            return None
        return one.payload[:-1] + bytes((tail[-1] ^ 0xFF,))

    def with_counter(self, one: Emission, change: int) -> bytes | None:
        """The time stamps of its columns, in nanoseconds."""
        found = self._stamps(one)
        return None if found is None else self._with(one, [(stamp + change) % (1 << 64) for stamp in found])

    def with_type(self, one: Emission, code: int) -> bytes | None:
        """Another kind of packet; LEGACY has none."""
        if one.label != "lidar" or SIZES[len(one.payload)].legacy:
            return None
        return _checked(bytes((code & 0xFF,)) + one.payload[1:])

    def stale(self, old: Emission, fresh: Emission) -> bytes | None:
        stamps = self._stamps(fresh)
        if stamps is None or self._stamps(old) is None or len(old.payload) != len(fresh.payload):
            return None
        return self._with(old, stamps)

    @staticmethod
    def _places(size: int) -> range:
        profile = SIZES[size]
        first, rest = (0, 0) if profile.legacy else (END, 2 * END)
        return range(first, first + size - rest, (size - rest) // COLUMNS)

    def _stamps(self, one: Emission) -> list[int] | None:
        if one.label != "lidar" or len(one.payload) not in SIZES:
            return None
        return [struct.unpack_from("<Q", one.payload, at)[0] for at in self._places(len(one.payload))]

    def _with(self, one: Emission, stamps: list[int]) -> bytes:
        data = bytearray(one.payload)
        for at, stamp in zip(self._places(len(data)), stamps, strict=True):
            struct.pack_into("<Q", data, at, stamp)
        return bytes(data) if SIZES[len(data)].legacy else _checked(bytes(data))

    def to_be_refused(self, data: bytes) -> bytes | None:
        return UNKNOWN

    def is_whole(self, data: bytes) -> bool:
        return b"\r\n\r\n" in data or (not data[:1].isupper() and data.endswith(b"\n"))


def _checked(data: bytes) -> bytes:
    """With its checksum right again, where it has one."""
    if data[-8:] in (bytes(8), PLACEHOLDER):
        return data
    return data[:-8] + crc64_xz(data[:-8]).to_bytes(8, "little")
