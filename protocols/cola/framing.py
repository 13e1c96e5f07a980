"""Frames of both dialects of CoLa, distinguished telegram by telegram; and telegrams changed on their way by faults.

    CoLa-A    STX text ETX
    CoLa-B    02 02 02 02, length of the payload (32 bits, big endian), payload, XOR of the payload

Belongs here: from bytes to payloads and back. Not: what a payload says (values, commands).
"""

from __future__ import annotations

import re

from protocols.checksums import xor8
from protocols.cola.values import ASCII, BINARY, ETX, STX
from protocols.framing import Framing
from protocols.session import DropReason, Emission
from protocols.skeleton.receiving import Fault, Splitter

START = STX * 4
HEAD_BYTES = 8
LONGEST = 16_384
"A host's longest telegram writes a segmented field of 1141 directions."

SCAN = b"LMDscandata "
COUNTER = re.compile(rb"(s(?:SN|RA) LMDscandata (?:[0-9A-F]+ ){5})([0-9A-F]+)( )([0-9A-F]+)( )")
"CoLa-A: what stands before the telegram counter, it, and the scan counter behind it."
COUNTER_AT = 10
"CoLa-B: of the telegram counter behind the name; the scan counter follows."
CONTROL = re.compile(rb"[\x00-\x1f]")
"The first of these behind STX ends a text, or it is none."
NAME = re.compile(rb"(s[RWEM]N )(\w+)")


def frame(dialect: bytes, payload: bytes) -> bytes:
    """A telegram on the wire."""
    if dialect == ASCII:
        return STX + payload + ETX
    return START + len(payload).to_bytes(4, "big") + payload + bytes((xor8(payload),))


def opened(telegram: bytes) -> tuple[bytes, bytes] | None:
    """Dialect and payload of one whole telegram; None: it is none, or damaged."""
    found = ColaSplitter(1 << 20).feed(telegram)
    one = found[0] if len(found) == 1 else None
    return (one[:1], one[1:]) if isinstance(one, bytes) else None


class ColaSplitter(Splitter[bytes]):
    """Finds telegrams; an item is the letter of its dialect and the payload.

    Of a false start only its first bytes are skipped; what follows them is read again.
    """

    def __init__(self, longest: int = LONGEST) -> None:
        super().__init__(longest + HEAD_BYTES + 1)
        self._longest = longest

    def expire(self) -> list[bytes | Fault]:
        """Give up the telegram that stopped half-way; what a false start swallowed is read again."""
        gone = len(self._buffer.take(1))
        return [Fault(DropReason.TIMEOUT, gone), *self.feed(b"")] if gone else []

    def _next(self) -> bytes | Fault | None:
        if skipped := self._buffer.skip_to(STX):
            return Fault(DropReason.NO_START_BYTE, skipped)
        held = self._buffer.peek(len(self._buffer)) or b""
        starts = len(held) - len(held.lstrip(STX))
        if starts >= len(START):
            return self._binary(held)
        if starts == len(held):
            return None  # either dialect
        if starts > 1:
            return Fault(DropReason.NO_START_BYTE, len(self._buffer.take(starts - 1)))
        control = CONTROL.search(held, 1)
        if control is None:
            return None
        end = control.start()
        if held[end : end + 1] != ETX:
            return Fault(DropReason.BAD_LENGTH, len(self._buffer.take(end)), "no ETX")
        self._buffer.take(end + 1)
        return ASCII + held[1:end]

    def _binary(self, held: bytes) -> bytes | Fault | None:
        if len(held) < HEAD_BYTES:
            return None
        length = int.from_bytes(held[4:8], "big")
        if length > self._longest:
            return Fault(DropReason.BAD_LENGTH, len(self._buffer.take(1)), f"{length} bytes")
        if len(held) < HEAD_BYTES + length + 1:
            return None
        payload = held[HEAD_BYTES : HEAD_BYTES + length]
        if held[HEAD_BYTES + length] != xor8(payload):
            return Fault(DropReason.BAD_CHECKSUM, len(self._buffer.take(len(START))), whole=True)
        self._buffer.take(HEAD_BYTES + length + 1)
        return BINARY + payload


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
