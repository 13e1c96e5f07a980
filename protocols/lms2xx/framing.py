"""LMS2xx telegrams changed on their way: fields replaced, the CRC made right again or wrong on purpose."""

from __future__ import annotations

from protocols.checksums import crc16_lms
from protocols.framing import Framing
from protocols.lms2xx.telegrams import CRC_BYTES, HEADER_BYTES, REPLY, STX, open_frame, read_values, word
from protocols.session import Emission

SHORTEST = 7
"STX, address, length, command, CRC."
TRAILER = 3
"Two indices and the status byte, where a telegram of values has indices."


class Lms2xxFraming(Framing):
    """One telegram an emission; ACK and NAK are single bytes and have no fields."""

    def bad_check(self, one: Emission) -> bytes | None:
        return one.payload[:-1] + bytes((one.payload[-1] ^ 0xFF,)) if _is_telegram(one.payload) else None

    def with_length(self, one: Emission, change: int) -> bytes | None:
        if not _is_telegram(one.payload):
            return None
        length = int.from_bytes(one.payload[2:4], "little") + change
        return _checked(one.payload[:2] + word(length & 0xFFFF) + one.payload[4:-CRC_BYTES])

    def with_counter(self, one: Emission, change: int) -> bytes | None:
        """The real-time scan index and the telegram index, if the device is configured to send them."""
        places = _indices(one.payload)
        if places is None:
            return None
        data = bytearray(one.payload[:-CRC_BYTES])
        for place in places:
            data[place] = (data[place] + change) & 0xFF
        return _checked(bytes(data))

    def with_type(self, one: Emission, code: int) -> bytes | None:
        return _put(one.payload, HEADER_BYTES, code)

    def with_address(self, one: Emission, address: int) -> bytes | None:
        return _put(one.payload, 1, address | REPLY)

    def stale(self, old: Emission, fresh: Emission) -> bytes | None:
        if not (_is_telegram(old.payload) and len(old.payload) == len(fresh.payload)):
            return None
        data = bytearray(old.payload[:-CRC_BYTES])
        for place in _indices(fresh.payload) or ():
            data[place] = fresh.payload[place]
        return _checked(bytes(data))

    def is_whole(self, data: bytes) -> bool:
        return len(data) >= SHORTEST and len(data) >= int.from_bytes(data[2:4], "little") + HEADER_BYTES + CRC_BYTES

    def to_be_refused(self, data: bytes) -> bytes | None:
        """A wrong CRC: the device answers NAK and carries nothing out."""
        return data[:-1] + bytes((data[-1] ^ 0xFF,)) if data else None


def _is_telegram(payload: bytes) -> bool:
    return len(payload) >= SHORTEST and payload[:1] == STX


def _checked(body: bytes) -> bytes:
    return body + word(crc16_lms(body))


def _put(payload: bytes, place: int, value: int) -> bytes | None:
    if not _is_telegram(payload):
        return None
    return _checked(payload[:place] + bytes((value & 0xFF,)) + payload[place + 1 : -CRC_BYTES])


def _indices(payload: bytes) -> tuple[int, int] | None:
    """Where the two indices are."""
    telegram = open_frame(payload) if _is_telegram(payload) else None
    values = None if telegram is None else read_values(telegram)
    if values is None or values.indices is None:
        return None
    at = len(payload) - CRC_BYTES - TRAILER
    return at, at + 1
