"""Hesai's packets and PTC replies changed on their way: wrong checks, other sequence numbers, lengths, return codes.

Belongs here: places in a packet. Not: when something is changed.
"""

from __future__ import annotations

from protocols.checksums import crc32_mpeg2
from protocols.framing import Framing
from protocols.hesai.codec import model_of_packet
from protocols.hesai.models import Model
from protocols.session import Emission

UNKNOWN = bytes.fromhex("4774ee0000000000")
PTC = b"\x47\x74"


def _model(data: bytes) -> Model | None:
    model = model_of_packet(data)
    return model if model is not None and len(data) >= model.layout.size else None


def _checked(model: Model, data: bytearray) -> bytes:
    for begin, end in model.layout.checks:
        data[end : end + 4] = crc32_mpeg2(bytes(data[begin:end])).to_bytes(4, "little")
    return bytes(data)


class HesaiFraming(Framing):
    """One packet or reply per emission."""

    def bad_check(self, one: Emission) -> bytes | None:
        """The CRC of the blocks; models that have one."""
        model = _model(one.payload)
        if model is None or not model.layout.checks:
            return None
        data, (_, end) = bytearray(one.payload), model.layout.checks[0]
        data[end] ^= 1
        return bytes(data)

    def with_counter(self, one: Emission, change: int) -> bytes | None:
        """The sequence number."""
        if (model := _model(one.payload)) is None:
            return None
        data, at = bytearray(one.payload), model.layout.places["sequence"]
        number = int.from_bytes(data[at : at + 4], "little") + change & 0xFFFFFFFF
        data[at : at + 4] = number.to_bytes(4, "little")
        return _checked(model, data)

    def with_length(self, one: Emission, change: int) -> bytes | None:
        """Of a reply of PTC."""
        if not one.payload.startswith(PTC):
            return None
        length = int.from_bytes(one.payload[4:8], "big") + change & 0xFFFFFFFF
        return one.payload[:4] + length.to_bytes(4, "big") + one.payload[8:]

    def with_type(self, one: Emission, code: int) -> bytes | None:
        """Command of a reply; of a packet the version of its protocol."""
        if one.payload.startswith(PTC) or one.payload.startswith(b"\xee\xff"):
            return one.payload[:2] + bytes((code & 0xFF,)) + one.payload[3:]
        return None

    def stale(self, old: Emission, fresh: Emission) -> bytes | None:
        """Blocks of an old packet."""
        model = _model(fresh.payload)
        if model is None or _model(old.payload) is not model:
            return None
        end = len(model.layout.head) + model.dtype["blocks"].itemsize
        return _checked(model, bytearray(old.payload[:end] + fresh.payload[end:]))

    def to_be_refused(self, data: bytes) -> bytes | None:
        return UNKNOWN

    def is_whole(self, data: bytes) -> bool:
        if data.startswith(PTC):
            return len(data) >= 8 and len(data) >= 8 + int.from_bytes(data[4:8], "big")
        return b"\r\n\r\n" in data
