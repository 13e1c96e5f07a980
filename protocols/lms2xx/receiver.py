"""From what a host sends to telegrams: search STX, check length, address and CRC, give up what stays incomplete.

Which telegrams come out depends on the bytes and on the pauses between them, never on the pieces they came in.
"""

from __future__ import annotations

from protocols.lms2xx.telegrams import (
    HEADER_BYTES,
    MAX_REQUEST_PAYLOAD,
    OVERHEAD_BYTES,
    STX,
    Telegram,
    open_frame,
)
from protocols.receive_buffer import ReceiveBuffer
from protocols.session import DropReason
from protocols.skeleton.receiving import Fault


class Receiver:
    """One line's input."""

    def __init__(self, known_commands: frozenset[int], gap_ns: int, strict: bool) -> None:
        """`gap_ns`: longest pause inside a telegram.

        `strict`: after it everything incomplete is dropped, as the device does after 6 ms. Otherwise only
        the first STX is dropped, and complete telegrams after it are accepted: a pty or a network may delay bytes.
        `known_commands` distinguish a telegram for another address from noise that begins with 02.
        """
        self._known = known_commands
        self._gap_ns = gap_ns
        self._strict = strict
        self._buffer = ReceiveBuffer(MAX_REQUEST_PAYLOAD + OVERHEAD_BYTES)
        self._last_ns = 0
        self._noise = 0

    def deadline(self) -> int | None:
        """When half a telegram will have waited too long; None while nothing waits."""
        return self._last_ns + self._gap_ns + 1 if len(self._buffer) else None

    def clear(self) -> int:
        """Forget what has come; how many bytes that was."""
        return self._buffer.clear()

    def feed(self, data: bytes, now_ns: int, address: int) -> list[Telegram | Fault]:
        """Take bytes; what they complete, for the device of this address, in order."""
        found = self.expire(now_ns, address)
        rest = memoryview(data)
        while len(rest):
            rest = rest[self._buffer.add(rest) :]
            self._parse(address, found)
        self._last_ns = now_ns
        self._tell_noise(found)
        return found

    def expire(self, now_ns: int, address: int) -> list[Telegram | Fault]:
        """What the pause since the last byte decides."""
        found: list[Telegram | Fault] = []
        deadline = self.deadline()
        if deadline is None or now_ns < deadline:
            return found
        lost = self._buffer.clear() if self._strict else 0
        while len(self._buffer):
            lost += len(self._buffer.take(1)) + self._buffer.skip_to(STX)
            whole = self._whole_frame()
            telegram = open_frame(whole) if whole else None
            if whole and telegram and telegram.address in (0, address):
                self._buffer.take(len(whole))
                found.append(telegram)
                self._parse(address, found)
        return [Fault(DropReason.TIMEOUT, lost), *found]

    def _whole_frame(self) -> bytes | None:
        header = self._buffer.peek(HEADER_BYTES)
        if header is None:
            return None
        length = int.from_bytes(header[2:], "little")
        return self._buffer.peek(length + OVERHEAD_BYTES) if 1 <= length <= MAX_REQUEST_PAYLOAD else None

    def _parse(self, address: int, found: list[Telegram | Fault]) -> None:
        """Take every telegram that is complete; stop where more bytes are needed."""
        while True:
            self._noise += self._buffer.skip_to(STX)
            header = self._buffer.peek(HEADER_BYTES + 1)
            if header is None:
                return
            length = int.from_bytes(header[2:4], "little")
            if not 1 <= length <= MAX_REQUEST_PAYLOAD:
                self._tell_noise(found)
                reason = DropReason.OVERLONG if length else DropReason.BAD_LENGTH
                found.append(Fault(reason, len(self._buffer.take(1)), f"length field {length}"))
                continue
            foreign = header[1] not in (0, address)
            if foreign and (header[1] > 0x7F or header[4] not in self._known):
                self._noise += len(self._buffer.take(1))
                continue
            whole = self._buffer.peek(length + OVERHEAD_BYTES)
            if whole is None:
                return
            self._tell_noise(found)
            telegram = open_frame(whole)
            if foreign and telegram is None:
                self._noise += len(self._buffer.take(1))
                continue
            self._buffer.take(len(whole))
            if telegram is None:
                found.append(Fault(DropReason.BAD_CHECKSUM, len(whole), f"command {whole[4]:02X}"))
            elif foreign:
                found.append(Fault(DropReason.OTHER_ADDRESS, len(whole), f"address {telegram.address}"))
            else:
                found.append(telegram)

    def _tell_noise(self, found: list[Telegram | Fault]) -> None:
        if self._noise:
            found.append(Fault(DropReason.NO_START_BYTE, self._noise))
            self._noise = 0
