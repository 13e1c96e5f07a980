"""The frame of the user protocol on TCP: STX, `USP`, length, payload, XOR of the payload.

Sources: sicktoolbox `SickLDMessage`, `SickLDBufferMonitor`; COMTEST `MessageHandlerEnternet`. The same frames go into
the datagrams of a `udp:` link, which is this project's own addition: no source knows UDP in the real device.
"""

from __future__ import annotations

import numpy as np

from protocols.session import DropReason
from protocols.skeleton.receiving import FrameSplitter, Refusal

HEADER = b"\x02USP"
OVERHEAD = 9
"Header 4, length 4, checksum 1."

MAX_REQUEST_BYTES = 4096
"""Longest payload taken from a host. Ours: the longest request with a known layout has 32 bytes; the bound keeps a
damaged length field from swallowing the stream."""

_SHORT = 64
"Below this, a Python loop beats numpy's call overhead."


def xor_of(payload: bytes) -> int:
    """XOR of all bytes. Check: the payload 01 02 (GET_STATUS) gives 03."""
    if len(payload) < _SHORT:
        value = 0
        for byte in payload:
            value ^= byte
        return value
    whole = len(payload) & ~7
    folded = int(np.bitwise_xor.reduce(np.frombuffer(payload, np.uint64, whole // 8)))
    return xor_of(folded.to_bytes(8, "little") + payload[whole:])


def encode_frame(payload: bytes) -> bytes:
    """A payload as it leaves on TCP."""
    return b"".join((HEADER, len(payload).to_bytes(4, "big"), payload, bytes((xor_of(payload),))))


class UspReader(FrameSplitter):
    """Finds frames in a stream of bytes that may begin, end and break off anywhere. Holds at most one frame."""

    START = HEADER
    HEAD_BYTES = 8

    def __init__(self, longest: int = MAX_REQUEST_BYTES) -> None:
        super().__init__(longest + OVERHEAD)
        self._longest = longest

    def _size(self, head: bytes) -> int | Refusal:
        length = int.from_bytes(head[4:], "big")
        if length > self._longest:
            return DropReason.OVERLONG, f"payload of {length} bytes"
        return length + OVERHEAD

    def _open(self, frame: bytes) -> bytes | Refusal:
        payload = frame[8:-1]
        return payload if xor_of(payload) == frame[-1] else (DropReason.BAD_CHECKSUM, "")
