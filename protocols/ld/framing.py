"""Messages of the LD user protocol changed on their way, on TCP, serial lines and CAN; checks made right again."""

from __future__ import annotations

from collections.abc import Callable

from protocols.framing import Framing
from protocols.ld import packages, usp
from protocols.ld.profiles import Field
from protocols.ld.segments import MULTIPLE, SINGLE
from protocols.ld.telegrams import GET_PROFILE_REPLY
from protocols.session import Emission

UNKNOWN_SERVICE = 0x00EE
"A service word that no LD knows."


def counters(words: bytes) -> list[int]:
    """Places of PROFILESENT and PROFILECOUNT among the bytes of a profile's message."""
    if len(words) < 8 or int.from_bytes(words[:2], "big") != GET_PROFILE_REPLY:
        return []
    form = int.from_bytes(words[2:4], "big")
    found = [6] if form & Field.PROFILESENT else []
    if form & Field.PROFILECOUNT:
        found.append(6 + 2 * len(found))
    return [place for place in found if place + 2 <= len(words)]


def _added(data: bytes, place: int, change: int) -> bytes:
    return _set(data, place, int.from_bytes(data[place : place + 2], "big") + change)


def _set(data: bytes, place: int, value: int) -> bytes:
    """With another word at that place; what another fault has cut before it stays as it is."""
    if place + 2 > len(data):
        return data
    return data[:place] + (value & 0xFFFF).to_bytes(2, "big") + data[place + 2 :]


class _Messages(Framing):
    """Fields of the message itself; the two methods below unpack and pack its frame."""

    def _changed(self, payload: bytes, change: Callable[[bytes], bytes | None]) -> bytes | None:
        """The frame with another message in it; `change` gets its first words."""
        raise NotImplementedError

    def with_counter(self, one: Emission, change: int) -> bytes | None:
        def count(words: bytes) -> bytes | None:
            places = counters(words)
            for place in places:
                words = _added(words, place, change)
            return words if places else None

        return self._changed(one.payload, count)

    def with_type(self, one: Emission, code: int) -> bytes | None:
        return self._changed(one.payload, lambda words: _set(words, 0, code))

    def stale(self, old: Emission, fresh: Emission) -> bytes | None:
        new: list[bytes] = []

        def look(words: bytes) -> bytes | None:
            new.append(words)
            return None

        self._changed(fresh.payload, look)

        def put(words: bytes) -> bytes | None:
            if not new or len(new[0]) != len(words):
                return None
            for place in counters(new[0]):
                words = words[:place] + new[0][place : place + 2] + words[place + 2 :]
            return words

        return self._changed(old.payload, put)


class UspFraming(_Messages):
    """On TCP and in datagrams."""

    def _changed(self, payload: bytes, change: Callable[[bytes], bytes | None]) -> bytes | None:
        if len(payload) < usp.OVERHEAD + 2 or not payload.startswith(usp.HEADER):
            return None
        changed = change(payload[8:-1])
        return None if changed is None else usp.encode_frame(changed)

    def bad_check(self, one: Emission) -> bytes | None:
        return one.payload[:-1] + bytes((one.payload[-1] ^ 0xFF,)) if one.payload.startswith(usp.HEADER) else None

    def with_length(self, one: Emission, change: int) -> bytes | None:
        if not one.payload.startswith(usp.HEADER) or len(one.payload) < 8:
            return None
        length = max(0, int.from_bytes(one.payload[4:8], "big") + change)
        return one.payload[:4] + length.to_bytes(4, "big") + one.payload[8:]

    def is_whole(self, data: bytes) -> bool:
        return len(data) >= 8 and len(data) >= int.from_bytes(data[4:8], "big") + usp.OVERHEAD

    def to_be_refused(self, data: bytes) -> bytes | None:
        """A request for a service that does not exist: answered by SERVICE FAILURE."""
        return self._changed(data, lambda words: _set(words, 0, UNKNOWN_SERVICE))


class PackageFraming(_Messages):
    """On serial lines. Of a message of several packages the first one is changed."""

    def _data(self, payload: bytes) -> tuple[bytes, bytes] | None:
        """Bytes of the first package without its CRC, and the packages behind it."""
        end = payload.find(bytes((packages.ETX,)))
        if len(payload) < 18 or payload[0] != packages.STX or end < 0:
            return None
        try:
            return bytes.fromhex(payload[1:end].decode("ascii"))[:-2], payload[end + 1 :]
        except ValueError:
            return None  # another fault has been at it

    def _package(self, data: bytes, change_crc: int = 0) -> bytes:
        crc = packages.crc_of(data) ^ change_crc
        return b"\x02" + (data + crc.to_bytes(2, "big")).hex().encode() + b"\x03"

    def _changed(self, payload: bytes, change: Callable[[bytes], bytes | None]) -> bytes | None:
        found = self._data(payload)
        if found is None:
            return None
        data, rest = found
        head = 8 if int.from_bytes(data[4:6], "big") == packages.MULTIPLE else 6
        changed = change(data[head:])
        return None if changed is None else self._package(data[:head] + changed) + rest

    def bad_check(self, one: Emission) -> bytes | None:
        found = self._data(one.payload)
        return None if found is None else self._package(found[0], 0xFFFF) + found[1]

    def with_length(self, one: Emission, change: int) -> bytes | None:
        found = self._data(one.payload)
        return None if found is None else self._package(_added(found[0], 2, change)) + found[1]

    def with_address(self, one: Emission, address: int) -> bytes | None:
        found = self._data(one.payload)
        return None if found is None else self._package(_set(found[0], 0, address)) + found[1]

    def is_whole(self, data: bytes) -> bool:
        return data.endswith(bytes((packages.ETX,)))

    def to_be_refused(self, data: bytes) -> bytes | None:
        """A wrong CRC: the device answers NAK."""
        place = data.rfind(bytes((packages.ETX,))) - 1
        if place < 1:
            return None
        other = b"1" if data[place : place + 1] == b"0" else b"0"
        return data[:place] + other + data[place + 1 :]


class SegmentFraming(Framing):
    """On CAN: frames of eight bytes without a check of their own."""

    def _is_first(self, payload: bytes) -> bool:
        return len(payload) >= 6 and int.from_bytes(payload[:2], "big") in (SINGLE, MULTIPLE)

    def with_length(self, one: Emission, change: int) -> bytes | None:
        """The number of frames in the first one."""
        first = len(one.payload) == 8 and int.from_bytes(one.payload[:2], "big") == MULTIPLE
        return _added(one.payload, 2, change) if first else None

    def with_counter(self, one: Emission, change: int) -> bytes | None:
        """The count-down of a frame in the middle of a message."""
        return None if self._is_first(one.payload) or len(one.payload) < 4 else _added(one.payload, 0, change)

    def with_type(self, one: Emission, code: int) -> bytes | None:
        if not self._is_first(one.payload):
            return None
        place = 6 if int.from_bytes(one.payload[:2], "big") == MULTIPLE else 4
        return _set(one.payload, place, code)

    def with_address(self, one: Emission, address: int) -> bytes | None:
        if not self._is_first(one.payload):
            return None
        place = 4 if int.from_bytes(one.payload[:2], "big") == MULTIPLE else 2
        return _set(one.payload, place, address)

    def to_be_refused(self, data: bytes) -> bytes | None:
        return _set(data, 4, UNKNOWN_SERVICE) if len(data) >= 6 and data[:2] == b"\0\0" else None
