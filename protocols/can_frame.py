"""Classic CAN frames as they are on the wire: identifier, data, and how many bits they take, stuff bits included.

Belongs here: ISO 11898-1 for any frame. Not: the meaning of a frame, and arbitration between senders.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

EXTENDED = 1 << 31
"Bit of `Address.peer` and `Received.peer`: the identifier has 29 bits."

MAX_STANDARD_ID = 0x7FF
MAX_EXTENDED_ID = 0x1FFFFFFF
MAX_DATA_BYTES = 8

CRC15_POLYNOMIAL = 0x4599
"ISO 11898-1: x^15 + x^14 + x^10 + x^8 + x^7 + x^4 + x^3 + 1, started at 0."

LONGEST_FRAME_BITS = 135
"Standard frame with eight bytes and all 24 stuff bits."

TAIL_BITS = 13
"CRC delimiter, ACK slot, ACK delimiter, seven bits end of frame, three bits between frames: never stuffed."


def split_identifier(peer: int) -> tuple[int, bool]:
    """Identifier without its flag, and whether it is extended."""
    return peer & MAX_EXTENDED_ID, bool(peer & EXTENDED)


def is_identifier(peer: int) -> bool:
    """Whether `peer` names a frame: 11 bits, or 29 bits with `EXTENDED`."""
    if peer & EXTENDED:
        return 0 <= peer ^ EXTENDED <= MAX_EXTENDED_ID
    return 0 <= peer <= MAX_STANDARD_ID


def arbitration_key(peer: int) -> tuple[int, int, int]:
    """Sorts frames as the bus does: the lower one wins. A standard frame beats an extended one of the same 11 bits."""
    identifier, extended = split_identifier(peer)
    return (identifier >> 18, 1, identifier & 0x3FFFF) if extended else (identifier, 0, 0)


def _crc_table() -> tuple[int, ...]:
    rows = []
    for byte in range(256):
        register = byte << 7
        for _ in range(8):
            register = (register << 1) ^ (CRC15_POLYNOMIAL if register & 0x4000 else 0)
        rows.append(register & 0x7FFF)
    return tuple(rows)


def _stuff_row(state: int, bits: int, width: int) -> tuple[int, int]:
    """State after `width` bits and the stuff bits among them. A state is 5 * last bit + (length of its run - 1)."""
    last, run, stuffed = state // 5, state % 5 + 1, 0
    for index in reversed(range(width)):
        bit = bits >> index & 1
        run = run + 1 if bit == last else 1
        last = bit
        if run == 5:
            stuffed += 1
            last, run = 1 - bit, 1
    return 5 * last + run - 1, stuffed


_CRC = _crc_table()
_STUFF_BYTE = tuple(_stuff_row(state, byte, 8) for state in range(10) for byte in range(256))
_STUFF_7 = tuple(_stuff_row(state, bits, 7) for state in range(10) for bits in range(128))
_CRC_ARRAY = np.array(_CRC, dtype=np.int64)
_STUFF_BYTE_ARRAY = np.array(_STUFF_BYTE, dtype=np.int64)
_STUFF_7_ARRAY = np.array(_STUFF_7, dtype=np.int64)
_IDLE = 5
"State of a bus at rest before the start bit: recessive, and no run carried over."


HEADERS_KEPT = 256
"A list has a few tens of identifiers; those of an untrusted flood must not accumulate: 70 kB in total."


@lru_cache(maxsize=HEADERS_KEPT)
def _header(peer: int, length: int) -> tuple[int, int, int]:
    """CRC register, stuffing state and bits so far once start bit, identifier, flags and length code have left."""
    identifier, extended = split_identifier(peer)
    if extended:
        # start, 11 bits, SRR = 1, IDE = 1, 18 bits, RTR = 0, r1 = 0, r0 = 0, length
        bits = ((identifier >> 18) << 2 | 0b11) << 18 | identifier & 0x3FFFF
        bits, width = bits << 7 | length, 39
    else:
        # start, 11 bits, RTR = 0, IDE = 0, r0 = 0, length
        bits, width = identifier << 7 | length, 19
    register = 0
    for index in reversed(range(width)):
        feedback = (bits >> index & 1) ^ (register >> 14)
        register = (register << 1 & 0x7FFF) ^ (CRC15_POLYNOMIAL if feedback else 0)
    state, stuffed = _stuff_row(_IDLE, bits, width)
    return register, state, width + stuffed


def frame_bits(peer: int, data: bytes) -> int:
    """Bits of a data frame from its start bit to the end of the pause behind it, stuff bits counted exactly.

    Parameters
    ----------
    peer : identifier, with `EXTENDED` for 29 bits.
    data : 0 to 8 bytes.

    Notes
    -----
    Standard frames: 47 + 8 n bits and up to (33 + 8 n) // 4 stuff bits.
    """
    register, state, total = _header(peer, len(data))
    for byte in data:
        register = (register << 8 & 0x7FFF) ^ _CRC[register >> 7 ^ byte]
        state, stuffed = _STUFF_BYTE[state << 8 | byte]
        total += stuffed
    state, first = _STUFF_BYTE[state << 8 | register >> 7]
    second = _STUFF_7[state << 7 | register & 0x7F][1]
    return total + first + second + 8 * len(data) + 15 + TAIL_BITS


def frames_bits(peers: Sequence[int], payloads: Sequence[bytes]) -> NDArray[np.int64]:
    """`frame_bits` of many frames at once, (n,)."""
    sizes = list(map(len, payloads))
    lengths = np.array(sizes, dtype=np.int64)
    shortest, longest = (min(sizes), max(sizes)) if sizes else (0, 0)
    # a list has few identifiers, so few headers
    rows: dict[tuple[int, int], int] = {}
    index = [rows.setdefault(row, len(rows)) for row in zip(peers, sizes, strict=True)]
    headers = np.array([_header(*row) for row in rows], dtype=np.int64).reshape(-1, 3)
    register, state, total = headers[np.array(index, dtype=np.intp)].T
    padded = payloads if shortest == 8 else [payload.ljust(8, b"\0") for payload in payloads]
    columns = np.frombuffer(b"".join(padded), np.uint8).reshape(-1, 8).T.astype(np.int64)
    total = total + 8 * lengths + 15 + TAIL_BITS
    for column, byte in enumerate(columns[:longest]):
        after = _STUFF_BYTE_ARRAY[state << 8 | byte]
        rest = (register << 8 & 0x7FFF) ^ _CRC_ARRAY[register >> 7 ^ byte]
        if column < shortest:
            total += after[:, 1]
            state, register = after[:, 0], rest
            continue
        sent = lengths > column
        total += np.where(sent, after[:, 1], 0)
        state, register = np.where(sent, after[:, 0], state), np.where(sent, rest, register)
    after = _STUFF_BYTE_ARRAY[state << 8 | register >> 7]
    last = _STUFF_7_ARRAY[after[:, 0] << 7 | register & 0x7F]
    return np.asarray(total + after[:, 1] + last[:, 1], dtype=np.int64)
