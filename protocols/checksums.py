"""Checks of integrity: the CRC of SICK's LMS2xx telegrams, and the sums that several wire formats share.

A check that one other family alone has (CRC of the LD family, CAN end-to-end profiles) lives with that family.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

calculate_crc64: Callable[..., int] | None
calculate_crc32: Callable[..., int] | None
try:  # an environment from before this dependency
    from fastcrc.crc32 import mpeg_2 as calculate_crc32
    from fastcrc.crc64 import xz as calculate_crc64
except ImportError:  # pragma: no cover
    calculate_crc32 = calculate_crc64 = None

LMS_POLYNOMIAL = 0x8005
TABLE_BYTES = 1024
"Messages up to this long take one table look-up a byte; longer than any telegram (824 bytes)."


def crc16_lms(data: bytes | bytearray | memoryview) -> int:
    """CRC of an LMS2xx telegram, from STX to the last byte before the CRC; sent low byte first.

    It is not CRC-16/0x8005: each byte shifts the register by one bit only and enters together with its predecessor.

    Notes
    -----
    With ``P = x^16 + x^15 + x^2 + 1`` one step is ``crc <- x crc + b[i-1] x^8 + b[i]  mod P``, so that of n bytes

    ``crc = b[n-1] + sum over i < n-1 of b[i] (1 + x^7) x^(n-1-i)  mod P``

    Each byte adds its own term: the CRC is the XOR of one table entry a byte, without a loop in Python.

    References
    ----------
    .. [1] SICK Telegram Listing LMS2xx 8007954/Q501, section 9, p. 107 (via Gepruft_Lidar); all host drivers.
       Check: ``02 00 01 00 31`` gives 1215 hex.
    """
    length = len(data)
    if length > TABLE_BYTES:
        return crc16_lms_by_steps(data)
    if length == 0:
        return 0
    table, rows = _lms_table()
    return int(np.bitwise_xor.reduce(table.take(rows[TABLE_BYTES - length :] + np.frombuffer(data, dtype=np.uint8))))


def crc16_lms_by_steps(data: bytes | bytearray | memoryview) -> int:
    """The same CRC byte by byte, as the listing defines it; for messages of any length."""
    crc = previous = 0
    for byte in bytes(data):
        top = crc & 0x8000
        crc = (crc << 1) & 0xFFFF
        if top:
            crc ^= LMS_POLYNOMIAL
        crc ^= previous << 8 | byte
        previous = byte
    return crc


@lru_cache(maxsize=1)
def _lms_table() -> tuple[NDArray[np.uint16], NDArray[np.intp]]:
    """What byte b adds to the CRC when k bytes follow it, at `rows[TABLE_BYTES - 1 - k] + b`, and these `rows`."""
    powers = np.zeros(TABLE_BYTES + 15, dtype=np.uint16)  # x^j mod P
    power = 1
    for j in range(len(powers)):
        powers[j] = power
        power = (power << 1) ^ (0x10000 | LMS_POLYNOMIAL if power & 0x8000 else 0)
    place = np.arange(TABLE_BYTES)[:, None] + np.arange(8)
    bits = powers[place]
    bits[1:] ^= powers[place[1:] + 7]  # the last byte has no successor that enters it a second time
    table = np.zeros((TABLE_BYTES, 256), dtype=np.uint16)
    for bit in range(8):
        table[:, 1 << bit : 2 << bit] = table[:, : 1 << bit] ^ bits[:, bit, None]
    flat = table[::-1].ravel()
    flat.setflags(write=False)
    return flat, np.arange(TABLE_BYTES) * 256


def xor8(data: bytes | bytearray | memoryview) -> int:
    """XOR of all bytes. Check: the text between `$` and `*` of an NMEA 0183 sentence."""
    return int(np.bitwise_xor.reduce(np.frombuffer(data, dtype=np.uint8))) if len(data) else 0


def sum8(data: bytes | bytearray | memoryview) -> int:
    """Sum of all bytes, mod 256. Check: all bytes of an Intel HEX record sum to 0."""
    return sum(bytes(data)) & 0xFF


def crc32_mpeg2(data: bytes | memoryview) -> int:
    """CRC-32/MPEG-2. Check: `123456789` gives 0376E6E7. By the library fastcrc where it is installed."""
    if calculate_crc32 is not None:
        return int(calculate_crc32(data))
    reversed_bits = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))
    turned = zlib.crc32(bytes(data).translate(reversed_bits)) ^ 0xFFFFFFFF  # the same polynomial, bits reversed
    return int.from_bytes(turned.to_bytes(4, "little").translate(reversed_bits), "big")


def crc64_xz(data: bytes | memoryview) -> int:
    """CRC-64/XZ. Check: `123456789` gives 995DC9BBDF1939FA.

    By the library fastcrc where it is installed; without it a thousand times slower, and more.
    """
    if calculate_crc64 is not None:
        return int(calculate_crc64(data))
    crc, table = (1 << 64) - 1, _crc64_table()
    for byte in data:
        crc = table[(crc ^ byte) & 0xFF] ^ crc >> 8
    return crc ^ (1 << 64) - 1


@lru_cache(maxsize=1)
def _crc64_table() -> tuple[int, ...]:
    table = []
    for value in range(256):
        for _ in range(8):
            value = value >> 1 ^ (0xC96C5795D7870F42 if value & 1 else 0)
        table.append(value)
    return tuple(table)
