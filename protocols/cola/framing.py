"""Telegrams of CoLa changed on their way by faults.

Belongs here: where sum, length and counters stand in a telegram. Not: frames themselves (skeleton.cola_frames).
"""

from __future__ import annotations

import re

from protocols.framing import Framing
from protocols.session import Emission
from protocols.skeleton.cola_frames import HEAD_BYTES, START, frame, opened
from protocols.skeleton.cola_values import ASCII, BINARY, ETX, decode, encode

SCAN = {
    ASCII: re.compile(rb"(s(?:SN|RA) LMDscandata (?:[0-9A-F]+ ){5})([0-9A-F]{1,4} [0-9A-F]{1,4})(?= )"),
    BINARY: re.compile(rb"(s(?:SN|RA) LMDscandata .{10})(.{4})", re.DOTALL),
}
"By dialect: what stands before the counters of telegrams and of scans, and they."
COUNTERS = "u16 u16"
NAME = re.compile(rb"(s[RWEM]N )(\w+)")


class ColaFraming(Framing):
    """Telegrams changed on their way. CoLa-A has neither a check nor a length."""

    def bad_check(self, one: Emission) -> bytes | None:
        """The last byte of a telegram in CoLa-B."""
        return one.payload[:-1] + bytes((one.payload[-1] ^ 0xFF,)) if one.payload.startswith(START) else None

    def with_length(self, one: Emission, change: int) -> bytes | None:
        """Of a telegram in CoLa-B."""
        if not one.payload.startswith(START) or len(one.payload) < HEAD_BYTES:
            return None
        length = max(0, int.from_bytes(one.payload[4:8], "big") + change) & 0xFFFFFFFF
        return one.payload[:4] + length.to_bytes(4, "big") + one.payload[8:]

    def with_counter(self, one: Emission, change: int) -> bytes | None:
        """Telegram counter and scan counter of a scan."""
        return _recounted(one.payload, one.payload, change)

    def stale(self, old: Emission, fresh: Emission) -> bytes | None:
        """An old scan with the counters of the fresh one; its stamps are old, as nothing on the wire is checked."""
        return _recounted(old.payload, fresh.payload)

    def to_be_refused(self, data: bytes) -> bytes | None:
        """A request for a name that does not exist: answered by sFA."""
        found = opened(data)
        if found is None or not NAME.match(found[1]):
            return None
        return frame(found[0], NAME.sub(rb"\1NoSuchName", found[1], count=1))

    def is_whole(self, data: bytes) -> bool:
        if data.startswith(START):
            return len(data) > HEAD_BYTES and len(data) > HEAD_BYTES + int.from_bytes(data[4:8], "big")
        return data.endswith(ETX)


def _recounted(telegram: bytes, of: bytes, change: int = 0) -> bytes | None:
    """A scan with the counters of another one, and so much more; None: one of them is no scan, or damaged."""
    source, target = _scan(of), _scan(telegram)
    if source is None or target is None:
        return None
    (spoken, counted), (dialect, found) = source, target
    numbers = [(number + change) & 0xFFFF for number in decode(COUNTERS, spoken, counted[2])]
    return frame(dialect, found[1] + encode(COUNTERS, dialect, numbers) + found.string[found.end() :])


def _scan(telegram: bytes) -> tuple[bytes, re.Match[bytes]] | None:
    """Dialect, and `SCAN` in the payload."""
    dialect, payload = opened(telegram) or (ASCII, b"")
    found = SCAN[dialect].match(payload)
    return None if found is None else (dialect, found)
