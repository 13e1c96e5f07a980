"""Interfaces that a host has taken over: services 0601 to 0605 (UPS p. 35-40).

An attached interface stops serving the protocol: what comes in on it goes to the host as COM_DATA, what the host gives
to COM_OUTPUT leaves on it. Belongs here: who holds what, and the words. Not: links and instants (`session`).
"""

from __future__ import annotations

from dataclasses import dataclass, field

from protocols.ld.config import BAUD_CODES, PARITY_CODES
from protocols.session import Address

SERIAL, CAN = 1, 2
COM_DATA = 0x0605
CAN_RATES = {1: 10, 2: 20, 3: 50, 4: 125, 5: 250, 6: 500, 7: 1000}
"kbit/s; one more than the codes of configuration item 0002."
EXTENDED_WORD, EXTENDED_PEER = 0x8000, 1 << 31
"Bit of ID_HIGH, and of a link's peer."
MAX_MESSAGES = 128
SERIAL_BUFFER = 64
"Characters; a full buffer is sent at once."
SILENT_CHARACTERS = 10
"Pause after which fewer are sent, in characters; according to the listing it depends on the rate. [I]"

Words = tuple[int, ...]


@dataclass(frozen=True)
class Routed:
    """Bytes that leave on an attached interface."""

    interface: int
    peer: int
    "CAN identifier, bit 31: extended; 0 on the serial line."
    data: bytes


@dataclass
class Attached:
    """One interface in a host's hands."""

    holder: Address
    route: int
    "What telegrams to the holder need beside its channel."
    baud: int
    received: bytearray = field(default_factory=bytearray)
    heard_ns: int = 0
    can_filter: tuple[bool, int, int] | None = None
    "Extended, identifier, bits that do not matter; None: as before COM_INIT, everything."

    def due_ns(self) -> int | None:
        """When characters that wait are sent."""
        return self.heard_ns + SILENT_CHARACTERS * 10 * 1_000_000_000 // self.baud if self.received else None

    def accepts(self, peer: int) -> bool:
        """Whether a CAN frame passes the filter."""
        if self.can_filter is None:
            return True
        extended, identifier, free = self.can_filter
        found = peer & ~EXTENDED_PEER
        return bool(peer & EXTENDED_PEER) == extended and not (found ^ identifier) & ~free


def identifier_of(high: int, low: int) -> tuple[bool, int]:
    """Whether it is extended, and the identifier, of ID_HIGH and ID_LOW."""
    extended = bool(high & EXTENDED_WORD)
    return extended, (high & 0x1FFF) << 16 | low if extended else low & 0x7FF


def serial_baud(words: Words) -> int | None:
    """Speed that COM_INIT of the serial line asks for: rate, parity, stop bits, data bits; None when it is invalid."""
    if len(words) < 4 or words[0] not in BAUD_CODES or words[1] not in PARITY_CODES:
        return None
    return BAUD_CODES[words[0]] if words[2] in (1, 2) and 1 <= words[3] <= 8 else None


def can_filter(words: Words) -> tuple[bool, int, int] | None:
    """Filter that COM_INIT of CAN asks for: rate, identifier and mask in two words each; None when it is invalid."""
    if len(words) < 5 or words[0] not in CAN_RATES:
        return None
    extended, identifier = identifier_of(words[1], words[2])
    free = (words[3] & 0x1FFF) << 16 | words[4] if extended else words[4] & 0x7FF
    return extended, identifier, free


def serial_output(words: Words) -> list[Routed] | None:
    """Characters of COM_OUTPUT; None when there are none."""
    return [Routed(SERIAL, 0, bytes(word & 0xFF for word in words))] if words else None


def can_output(words: Words) -> list[Routed] | None:
    """Messages of COM_OUTPUT: their number, then identifier, length and data words of each; None when invalid."""
    if not words or not 1 <= words[0] <= MAX_MESSAGES:
        return None
    found, at = [], 1
    for _ in range(words[0]):
        if len(words) < at + 3 or words[at + 2] > 8:
            return None
        high, low, length = words[at : at + 3]
        count = (length + 1) // 2
        data = b"".join(word.to_bytes(2, "big") for word in words[at + 3 : at + 3 + count])
        if len(data) < 2 * count:
            return None
        extended, identifier = identifier_of(high, low)
        found.append(Routed(CAN, identifier | (EXTENDED_PEER if extended else 0), data[:length]))
        at += 3 + count
    return found


def serial_data(clock_ms: int, characters: bytes) -> Words:
    """COM_DATA of the serial line."""
    return (COM_DATA, SERIAL, clock_ms & 0xFFFF, *characters)


def can_data(clock_ms: int, peer: int, data: bytes) -> Words:
    """COM_DATA of one CAN message."""
    extended, identifier = bool(peer & EXTENDED_PEER), peer & ~EXTENDED_PEER
    high = EXTENDED_WORD | identifier >> 16 if extended else 0
    padded = data + b"\0" * (len(data) % 2)
    words = (int.from_bytes(padded[at : at + 2], "big") for at in range(0, len(padded), 2))
    return (COM_DATA, CAN, clock_ms & 0xFFFF, high, identifier & 0xFFFF, len(data), *words)
