"""Packages of the user protocol on RS-232 and RS-422: words as ASCII hex between STX and ETX, with a CRC.

Sources: Miro middleware `laser360` (sends lower case), COMTEST (sends upper case, has the vendor's table in its CRC),
the maker's listing 8011576 (p. 51-52: the host in upper case, the device in lower case).
"""

from __future__ import annotations

import binascii
from dataclasses import dataclass

from protocols.session import DropReason
from protocols.skeleton.receiving import Fault

STX, ETX, NAK = 0x02, 0x03, 0x15

MAX_COUNT = 126
"Largest count word: Miro drops a package with more words behind its count."

FIRST_WORDS = MAX_COUNT - 3
"Message words in the first of several packages: package ID, number of packages and CRC are counted too."
LATER_WORDS = MAX_COUNT - 2

MAX_MESSAGE_WORDS = 2048
"Longest message put together from a host's packages; ours, as the TCP side's 4096 bytes."

MULTIPLE = 0xFFFF
_MAX_CHARACTERS = 4 * (MAX_MESSAGE_WORDS + 5)
_HEX = frozenset(b"0123456789abcdefABCDEF")


def crc_of(data: bytes) -> int:
    """CRC over the binary bytes of all words before the CRC word.

    Notes
    -----
    The vendor's recurrence ``r <- (r << 8 | byte) ^ T[r >> 8]`` with r0 = FFFF leaves the remainder of
    ``r0 x^(8n) + M  mod P``, P = x^16 + x^12 + x^5 + 1, where the usual CRC-CCITT step leaves that of
    ``(r0 x^(8n) + M) x^16``. With M = M' x^16 + t the former is the usual CRC of M' begun at ``r0 x^16 mod P``, plus t;
    so the library's C loop does the work.

    References
    ----------
    .. [1] COMTEST, `block_crc16_word` and the package 1410 0004 0000 0202 0001 2BBC of the vendor's documentation.
    """
    if len(data) < 2:
        value = 0xFFFF
        for byte in data:
            value = (value << 8 & 0xFF00 | byte) ^ binascii.crc_hqx(bytes((value >> 8,)), 0)
        return value
    begun = binascii.crc_hqx(b"\0\0", 0xFFFF)
    return binascii.crc_hqx(data[:-2], begun) ^ int.from_bytes(data[-2:], "big")


def swapped(address: int) -> int:
    """The address word of a reply: source and destination change places."""
    return (address & 0xFF) << 8 | address >> 8


def encode_packages(payload: bytes, address: int) -> bytes:
    """All packages of a message, back to back: Miro takes what has come in one go."""
    words = len(payload) // 2
    if words <= LATER_WORDS:
        return _package(address, b"\0\0" + payload)
    total = 1 + -(-(words - FIRST_WORDS) // LATER_WORDS)
    cut = 2 * FIRST_WORDS
    parts = [_package(address, b"\xff\xff" + total.to_bytes(2, "big") + payload[:cut])]
    for left in range(total - 1, 0, -1):
        parts.append(_package(address, left.to_bytes(2, "big") + payload[cut : cut + 2 * LATER_WORDS]))
        cut += 2 * LATER_WORDS
    return b"".join(parts)


def _package(address: int, body: bytes) -> bytes:
    data = address.to_bytes(2, "big") + (len(body) // 2 + 1).to_bytes(2, "big") + body
    return b"\x02" + (data + crc_of(data).to_bytes(2, "big")).hex().encode() + b"\x03"


@dataclass(frozen=True)
class Package:
    """One package whose count and CRC are right."""

    address: int
    body: bytes
    "Package ID and what follows it, without the CRC."


class PackageReader:
    """Finds packages between STX and ETX. Holds at most one."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def __bool__(self) -> bool:
        """Whether something incomplete is held."""
        return bool(self._buffer)

    def feed(self, data: bytes) -> list[Package | Fault]:
        """Packages and faults in the order of the stream."""
        found: list[Package | Fault] = []
        for index, piece in enumerate(data.split(b"\x02")):
            if index:
                if self._buffer:  # a new STX ends what was begun
                    found.append(Fault(DropReason.BAD_LENGTH, len(self._buffer)))
                self._buffer[:] = b"\x02"
            found.extend(self._add(piece))
        return found

    def expire(self) -> list[Package | Fault]:
        """Give up the package that stopped half-way."""
        gone = len(self._buffer)
        self._buffer.clear()
        return [Fault(DropReason.TIMEOUT, gone)] if gone else []

    def _add(self, piece: bytes) -> list[Package | Fault]:
        found: list[Package | Fault] = []
        if self._buffer:
            inside, end, piece = piece.partition(b"\x03")
            self._buffer += inside
            if end:
                found.append(_read(bytes(self._buffer[1:])))
                self._buffer.clear()
            elif len(self._buffer) > _MAX_CHARACTERS:
                found.append(Fault(DropReason.OVERLONG, len(self._buffer)))
                self._buffer.clear()
        if piece:
            found.append(Fault(DropReason.NO_START_BYTE, len(piece)))
        return found


def _read(characters: bytes) -> Package | Fault:
    size = len(characters) + 2
    if len(characters) % 4 or len(characters) < 16 or len(characters) > _MAX_CHARACTERS:
        return Fault(DropReason.BAD_LENGTH, size, "want four or more words of four hex characters", whole=True)
    if not _HEX.issuperset(characters):
        return Fault(DropReason.BAD_ARGUMENT, size, "not hexadecimal", whole=True)
    data = bytes.fromhex(characters.decode("ascii"))
    if int.from_bytes(data[2:4], "big") != len(data) // 2 - 2:
        return Fault(DropReason.BAD_LENGTH, size, "count word", whole=True)
    if crc_of(data[:-2]) != int.from_bytes(data[-2:], "big"):
        return Fault(DropReason.BAD_CHECKSUM, size, whole=True)
    return Package(int.from_bytes(data[:2], "big"), data[4:-2])


class PackageJoiner:
    """Puts the message of several packages together. Holds at most `MAX_MESSAGE_WORDS`."""

    def __init__(self) -> None:
        self._parts = bytearray()
        self._left = 0

    def add(self, package: Package) -> bytes | Fault | None:
        """The message once it is whole; a fault when the count-down is broken; None: more is to come."""
        number = int.from_bytes(package.body[:2], "big")
        if number == 0:
            self._left = 0
            return package.body[2:]
        if number == MULTIPLE:
            self._left = int.from_bytes(package.body[2:4], "big")
            self._parts[:] = package.body[4:]
            if not self._left:
                return Fault(DropReason.BAD_LENGTH, len(package.body), "message of no package", whole=True)
        elif number == self._left:
            self._parts += package.body[2:]
        else:
            self._left = 0
            return Fault(DropReason.BAD_LENGTH, len(package.body), f"package {number:04X} out of turn", whole=True)
        if len(self._parts) > 2 * MAX_MESSAGE_WORDS:
            self._left = 0
            return Fault(DropReason.OVERLONG, len(self._parts), whole=True)
        self._left -= 1
        return None if self._left else bytes(self._parts)
