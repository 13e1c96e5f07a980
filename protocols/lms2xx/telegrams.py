"""Bytes of the LMS2xx telegrams: frames, the header word of measured values, and the layouts that carry them.

    host    02 address length16 command data...        crc16
    device  02 address length16 command data... status crc16

Little-endian throughout. What is sent when, and what the words mean, is decided elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from protocols.checksums import crc16_lms
from protocols.errors import EncodeError
from protocols.lms2xx.values import Words

STX = b"\x02"
ACK = b"\x06"
NAK = b"\x15"
REPLY = 0x80
"Added to address and command of a request in its reply."

HEADER_BYTES = 4
CRC_BYTES = 2
OVERHEAD_BYTES = HEADER_BYTES + CRC_BYTES
MAX_REPLY_PAYLOAD = 806
"Payload of the largest ordinary telegram, 812 bytes (listing 4.2, p. 22)."
MAX_REQUEST_PAYLOAD = 817
"Of 40 with a field of 400 segments (FF) and the six reserved bytes of its table; 20 2C has 807 at most."
MAX_GROUPS = 5
"Sub-ranges of F5 (listing via Gepruft_Lidar)."


def word(value: int) -> bytes:
    """16 bits, low byte first."""
    return value.to_bytes(2, "little")


def words(data: bytes) -> tuple[int, ...]:
    """The 16-bit words of `data`, whose length is even."""
    return tuple(np.frombuffer(data, dtype="<u2").tolist())


def frame(address: int, payload: bytes) -> bytes:
    """One telegram with its CRC."""
    if not 0 <= address <= 0xFF or not 1 <= len(payload) <= 0xFFFF:
        raise EncodeError(f"address {address}, payload of {len(payload)} bytes; want 0..255 and 1..65535 bytes")
    body = STX + bytes((address,)) + word(len(payload)) + payload
    return body + word(crc16_lms(body))


def request(payload: bytes, address: int = 0) -> bytes:
    """A host's telegram to the device of that address; 0 is every device."""
    return frame(address, payload)


def reply(payload: bytes, status: int, address: int = 0) -> bytes:
    """A device's telegram: its own address and the payload's command carry bit 7, the status byte comes last."""
    return frame(address | REPLY, payload + bytes((status,)))


@dataclass(frozen=True)
class Telegram:
    """One telegram taken apart, CRC already checked."""

    address: int
    command: int
    data: bytes
    "Behind the command; in replies the status byte is its last."


def open_frame(whole: bytes) -> Telegram | None:
    """The telegram in exactly these bytes; None when its CRC is wrong."""
    if crc16_lms(whole[:-CRC_BYTES]) != int.from_bytes(whole[-CRC_BYTES:], "little"):
        return None
    return Telegram(whole[1], whole[HEADER_BYTES], whole[HEADER_BYTES + 1 : -CRC_BYTES])


@dataclass(frozen=True)
class Header:
    """The word before measured values: bits 0-9 count, 11-12 partial scan, 13 whether it is one, 14-15 unit."""

    count: int
    unit: int = 0
    "0 cm, 1 mm, 2 dm (10 in the two bits; reserved in the listing of 2006)."
    partial: int | None = None
    "0..3 for x.00, x.25, x.50, x.75 deg; None for a complete scan."

    def encode(self) -> bytes:
        """Two bytes."""
        if not 0 <= self.count < 1024:
            raise EncodeError(f"{self.count} values; the header word holds at most 1023")
        part = 0 if self.partial is None else 1 << 13 | self.partial << 11
        return word(self.count | part | self.unit << 14)

    @classmethod
    def decode(cls, value: int) -> Header:
        """From the word."""
        return cls(value & 0x3FF, value >> 14, value >> 11 & 3 if value >> 13 & 1 else None)


def value_bytes(values: Words) -> bytes:
    """Words, low byte first."""
    return values.astype("<u2", copy=False).tobytes()


def all_values(values: Words, header: Header) -> bytes:
    """B0: header, values. Indices and status byte follow."""
    return b"\xb0" + header.encode() + value_bytes(values)


def mean_values(scans: int, values: Words, header: Header) -> bytes:
    """B6: number of scans, header, values."""
    return bytes((0xB6, scans)) + header.encode() + value_bytes(values)


def sub_range(first: int, last: int, values: Words, header: Header) -> bytes:
    """B7: first and last beam (from 1), header, values."""
    return b"\xb7" + word(first) + word(last) + header.encode() + value_bytes(values)


def mean_sub_range(scans: int, first: int, last: int, values: Words, header: Header) -> bytes:
    """BF: number of scans, first and last beam, header, values."""
    return bytes((0xBF, scans)) + word(first) + word(last) + header.encode() + value_bytes(values)


def field_values(first: int, last: int, table: Words, unit: int) -> bytes:
    """BE: first and last beam, header that counts words, then four words a beam: value, fields A, B, C."""
    return b"\xbe" + word(first) + word(last) + Header(len(table), unit).encode() + value_bytes(table)


def cartesian(first: int, last: int, places: Words) -> bytes:
    """F6: first and last beam, number of points, then x and y of each."""
    return b"\xf6" + word(first) + word(last) + word(len(places) // 2) + value_bytes(places)


def range_and_reflectivity(
    values: Words, header: Header, first: int, last: int, reflectivity: NDArray[np.uint8]
) -> bytes:
    """C4: header, all ranges, number of reflectivity bytes, their first and last beam, the bytes (sicktoolbox)."""
    return (
        b"\xc4"
        + header.encode()
        + value_bytes(values)
        + word(len(reflectivity))
        + word(first)
        + word(last)
        + reflectivity.tobytes()
    )


def range_and_intensity(groups: list[tuple[int, int, Header, Words, Words]]) -> bytes:
    """F5: number of groups; each: first, last, header, then range and intensity words in turn (CARMEN, MIT driver)."""
    parts = [b"\xf5", word(len(groups))]
    for first, last, header, ranges, intensities in groups:
        parts += [word(first), word(last), header.encode(), value_bytes(np.column_stack((ranges, intensities)))]
    return b"".join(parts)


@dataclass(frozen=True, eq=False)
class MeasuredValues:
    """A telegram of measured values as a host reads it: raw words, nothing masked."""

    command: int
    header: Header
    values: Words
    first: int
    "Number of the first beam, from 1."
    scans: int
    "How many were averaged."
    extra: NDArray[np.uint16]
    "Intensity words (F5) or reflectivity bytes (C4), else empty."
    indices: tuple[int, int] | None
    "Real-time scan index, telegram index."
    status: int


def read_values(telegram: Telegram) -> MeasuredValues | None:
    """Contents of a B0, B6, B7, BF, C4 or F5 (first group); None for any other telegram, or a wrong length."""
    data, at, scans, first = telegram.data, 0, 1, 1
    groups = 1
    if telegram.command not in (0xB0, 0xB6, 0xB7, 0xBF, 0xC4, 0xF5) or len(data) < 3:
        return None
    if telegram.command in (0xB6, 0xBF):
        scans, at = data[0], 1
    if telegram.command == 0xF5:
        groups, at = int.from_bytes(data[:2], "little"), 2
    if telegram.command in (0xB7, 0xBF, 0xF5):
        first = int.from_bytes(data[at : at + 2], "little")
        at += 4
    header = Header.decode(int.from_bytes(data[at : at + 2], "little"))
    at += 2
    count = header.count * (2 if telegram.command == 0xF5 else 1)
    found = (
        np.frombuffer(data[at : at + 2 * count], dtype="<u2").astype(np.uint16) if len(data) >= at + 2 * count else None
    )
    if found is None:
        return None
    extra = np.zeros(0, dtype=np.uint16)
    at += 2 * count
    if telegram.command == 0xF5:
        found, extra = found[0::2], found[1::2]
    elif telegram.command == 0xC4:
        size = int.from_bytes(data[at : at + 2], "little")
        extra = np.frombuffer(data[at + 6 : at + 6 + size], dtype=np.uint8).astype(np.uint16)
        at += 6 + size
    rest = data[at:]
    if groups == 1 and len(rest) not in (1, 3):
        return None
    indices = (rest[-3], rest[-2]) if len(rest) >= 3 else None
    return MeasuredValues(telegram.command, header, found, first, scans, extra, indices, rest[-1])
