"""Telegrams of CoLa changed on their way by faults.

Belongs here: where sum, length and counters stand in a telegram. Not: frames themselves (skeleton.cola_frames).
"""

from __future__ import annotations

import re

from protocols.framing import Framing
from protocols.session import Emission
from protocols.skeleton.cola_frames import HEAD_BYTES, START, frame, opened
from protocols.skeleton.cola_values import ASCII, ETX

SCAN = b"LMDscandata "
COUNTER = re.compile(rb"(s(?:SN|RA) LMDscandata (?:[0-9A-F]+ ){5})([0-9A-F]+)( )([0-9A-F]+)( )")
"CoLa-A: what stands before the telegram counter, it, and the scan counter behind it."
COUNTER_AT = 10
"CoLa-B: of the telegram counter behind the name; the scan counter follows."
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
        counters = self._counters(one.payload)
        if counters is None:
            return None
        return self._with(one.payload, [(number + change) & 0xFFFF for number in counters])

    def stale(self, old: Emission, fresh: Emission) -> bytes | None:
        """An old scan with the counters of the fresh one; its stamps are old, as nothing on the wire is checked."""
        counters = self._counters(fresh.payload)
        return None if counters is None else self._with(old.payload, counters)

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

    def _counters(self, telegram: bytes) -> list[int] | None:
        found = opened(telegram)
        if found is None or SCAN not in found[1][:20]:
            return None
        dialect, payload = found
        if dialect == ASCII:
            match = COUNTER.match(payload)
            return None if match is None else [int(match[2], 16), int(match[4], 16)]
        at = payload.index(SCAN) + len(SCAN) + COUNTER_AT
        return [int.from_bytes(payload[at + k : at + k + 2], "big") for k in (0, 2)]

    def _with(self, telegram: bytes, numbers: list[int]) -> bytes | None:
        if self._counters(telegram) is None:
            return None
        dialect, payload = opened(telegram) or (b"", b"")
        if dialect == ASCII:
            put = COUNTER.sub(lambda match: match[1] + b"%X %X " % tuple(numbers), payload, count=1)
            return frame(dialect, put)
        at = payload.index(SCAN) + len(SCAN) + COUNTER_AT
        words = b"".join(number.to_bytes(2, "big") for number in numbers)
        return frame(dialect, payload[:at] + words + payload[at + 4 :])
