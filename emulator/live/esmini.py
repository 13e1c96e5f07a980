"""Messages of esmini's OSI reporter: several datagrams each, with a counter that is negative in the last.

Belongs here: putting datagrams together, what is lost. Not: what a message says (osi), sockets (receivers).

Source: esmini 3.6.0, OSIReporter: int32 counter, uint32 size, both in the sender's order (little-endian), then bytes.
"""

from __future__ import annotations

import struct
from collections import Counter
from dataclasses import dataclass, field

from emulator.live.samples import BadSample

MOST_PIECE = 65_507 - 8
MOST_MESSAGE = 64 << 20
MOST_SENDERS = 8
MOST_AGE_NS = 1_000_000_000
"A message that is not whole by then is given up."


@dataclass
class _Message:
    begun_ns: int
    pieces: int = 0
    data: bytearray = field(default_factory=bytearray)


class Assembly:
    """One message at a time of each sender."""

    def __init__(self, counts: Counter[str]) -> None:
        self._counts = counts
        self._open: dict[object, _Message] = {}

    def take(self, data: bytes, peer: object, now_ns: int) -> bytes | None:
        """A datagram; the message that is whole with it. `BadSample` for what is none of esmini's."""
        if len(data) < 8:
            raise BadSample(f"datagram: {len(data)} bytes; want a counter, a size and so many bytes")
        counter, size = struct.unpack_from("<iI", data)
        if size != len(data) - 8 or not size or not counter or counter == -(2**31):
            raise BadSample(
                f"datagram: size {size} in {len(data)} bytes, counter {counter}; want 8 bytes more than size"
            )
        number, last = abs(counter), counter < 0
        for other, message in list(self._open.items()):
            if now_ns - message.begun_ns > MOST_AGE_NS:
                self._give_up(other)
        if number == 1:
            if peer in self._open:
                self._give_up(peer)
            if len(self._open) >= MOST_SENDERS:
                self._counts["too many senders"] += 1
                return None
            self._open[peer] = _Message(now_ns)
        found = self._open.get(peer)
        if found is None:  # of a message whose begin is missing: counted once, with its last piece
            self._counts["osi incomplete"] += last
            return None
        if number != found.pieces + 1 or len(found.data) + size > MOST_MESSAGE:
            self._give_up(peer)
            return None
        found.pieces = number
        found.data += data[8:]
        if not last:
            return None
        del self._open[peer]
        return bytes(found.data)

    def _give_up(self, peer: object) -> None:
        del self._open[peer]
        self._counts["osi incomplete"] += 1


def datagrams(message: bytes, piece: int = 8192) -> list[bytes]:
    """A message as esmini sends it."""
    parts = [message[begin : begin + piece] for begin in range(0, len(message), piece)]
    return [
        struct.pack("<iI", number + 1 if number + 1 < len(parts) else -(number + 1), len(part)) + part
        for number, part in enumerate(parts)
    ]
