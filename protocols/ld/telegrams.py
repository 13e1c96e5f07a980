"""Messages of the LD user protocol: service words, sensor status, and words as big-endian bytes.

A message is a service word and its data words; its framing is in `usp` (TCP), `packages`
(RS-232/422) and `segments` (CAN). The services are in `services`.
"""

from __future__ import annotations

import struct
from enum import IntEnum

from protocols.errors import EncodeError

REPLY_BIT = 0x8000
"Set in the service word of every reply."

SERVICE_FAILURE = 0xFF00
"Reply to a service that is unknown or not available in this state: two words of 0 and the status follow (UPS p. 44)."

GET_PROFILE_REPLY = 0x8301

REFUSED = 0xFFFF
"Data of a refused SET_CONFIG, GET_CONFIG, SET_FUNCTION, GET_FUNCTION, SET_SIGNAL, SET_FILTER, COM or MONITOR."


class Mode(IntEnum):
    """Low nibble of the sensor status."""

    IDLE = 1
    ROTATE = 2
    MEASURE = 3
    ERROR = 4


class Motor(IntEnum):
    """High nibble of the sensor status."""

    OK = 0
    TOO_SLOW = 4
    "sicktoolbox; the COMTEST program reads 0xA for it and knows no 4."
    TOO_FAST = 9
    STOPPED = 11


def status_words(mode: Mode, motor: Motor = Motor.OK) -> tuple[int, int]:
    """SENSTAT: a 32-bit number of which only the lowest byte is used."""
    return 0, motor << 4 | mode


def payload_of(*words: int) -> bytes:
    """Words as they follow each other on every interface, high byte first; `EncodeError` beyond 16 bits."""
    try:
        return struct.pack(f">{len(words)}H", *words)
    except struct.error:
        raise EncodeError(f"{words}: want words of 0..65535") from None


def words_of(payload: bytes) -> tuple[int, ...]:
    """The whole words of a payload; an odd byte at its end is left out (the Stanford module sends stray bytes)."""
    return struct.unpack_from(f">{len(payload) // 2}H", payload)


def words_text(words: tuple[int, ...]) -> str | None:
    """The text in six words, without what fills them; None when it is not ASCII."""
    data = payload_of(*words).rstrip(b"\0 ")
    return data.decode("ascii") if data.isascii() else None


def text_words(text: str) -> tuple[int, ...]:
    """Six words of an identification text, filled with 0x00; blanks would stay in the host's strings (sicktoolbox)."""
    data = text.encode("ascii")
    if len(data) > 12:
        raise EncodeError(f"{text!r}: want at most 12 characters")
    return words_of(data.ljust(12, b"\0"))
