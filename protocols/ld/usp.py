"""The frame of the user protocol on TCP: STX, `USP`, length, payload, XOR of the payload.

Sources: sicktoolbox `SickLDMessage`, `SickLDBufferMonitor`; COMTEST `MessageHandlerEnternet`. The same frames go into
the datagrams of a `udp:` link, which is this project's own addition: no source knows UDP in the real device.
"""

from __future__ import annotations

import numpy as np

from protocols.ld.telegrams import Fault
from protocols.receive_buffer import ReceiveBuffer
from protocols.session import DropReason

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


class UspReader:
    """Finds frames in a stream of bytes that may begin, end and break off anywhere. Holds at most one frame."""

    def __init__(self, longest: int = MAX_REQUEST_BYTES) -> None:
        self._longest = longest
        self._buffer = ReceiveBuffer(longest + OVERHEAD)

    def __bool__(self) -> bool:
        """Whether something incomplete is held."""
        return len(self._buffer) > 0

    def feed(self, data: bytes) -> list[bytes | Fault]:
        """Payloads and faults in the order of the stream."""
        found: list[bytes | Fault] = []
        rest = memoryview(data)
        while True:
            rest = rest[self._buffer.add(rest) :]
            while (item := self._next()) is not None:
                found.append(item)
            if not rest:
                return found

    def expire(self) -> list[bytes | Fault]:
        """Give up the frame that stopped half-way; what a false header swallowed is read again."""
        gone = len(self._buffer.take(len(HEADER)))
        return [Fault(DropReason.TIMEOUT, gone), *self.feed(b"")] if gone else []

    def _next(self) -> bytes | Fault | None:
        buffer = self._buffer
        skipped = buffer.skip_to(HEADER)
        if skipped:
            return Fault(DropReason.NO_START_BYTE, skipped)
        head = buffer.peek(8)
        if head is None:
            return None
        length = int.from_bytes(head[4:], "big")
        if length > self._longest:
            return self._resume(DropReason.OVERLONG, f"payload of {length} bytes")
        frame = buffer.peek(length + OVERHEAD)
        if frame is None:
            return None
        payload = frame[8:-1]
        if xor_of(payload) != frame[-1]:
            return self._resume(DropReason.BAD_CHECKSUM)
        buffer.take(len(frame))
        return payload

    def _resume(self, reason: DropReason, detail: str = "") -> Fault:
        """Look for the next header behind this one, not behind its frame: its length may be what was damaged."""
        self._buffer.take(len(HEADER))
        return Fault(reason, len(HEADER), detail)
