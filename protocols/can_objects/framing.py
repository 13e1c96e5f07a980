"""Frames of object lists changed on their way: signals by the DBC, counters, end-to-end protection right or wrong."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Protocol

from protocols.can_objects.e2e import Protection
from protocols.can_objects.layout import MessageLayout, SignalLayout
from protocols.framing import Framing
from protocols.session import Emission

COUNTERS = (
    "MeasCounter",
    "RollingCount",
    "RollingCount1",
    "RollingCount2",
    "RollingCount3",
    "ScanNumber",
    "ListCounter",
)
"Signals that count lists or frames, by their names in the DBC files."


class HasMessages(Protocol):
    """What is known of the frames of a sender."""

    @property
    def messages(self) -> Mapping[str, MessageLayout]:
        """By their names in the DBC."""


class CanFraming(Framing):
    """One frame an emission; its label is the message's name in the DBC."""

    def __init__(
        self, layout: HasMessages, protection: Protection | None, counters: Collection[str] = COUNTERS
    ) -> None:
        """`counters`: names of signals that count."""
        self._messages = layout.messages
        self._protection = protection
        self._counters = counters

    def _message(self, label: str) -> MessageLayout | None:
        return self._messages.get(label)

    def _of(self, one: Emission) -> MessageLayout | None:
        """The message of a whole frame; one that another fault has cut has no fields any more."""
        message = self._message(one.label)
        return None if message is None or len(one.payload) < message.length else message

    def signals(self, label: str) -> tuple[str, ...]:
        message = self._message(label)
        return () if message is None else tuple(message.signals)

    def all_ones(self, label: str, signal: str) -> int:
        message = self._message(label)
        return 0 if message is None or signal not in message.signals else (1 << message.signals[signal].bits) - 1

    def with_signal(self, one: Emission, signal: str, raw: int) -> bytes | None:
        message = self._of(one)
        if message is None or signal not in message.signals:
            return None
        return self._protected(one, _put(one.payload, message, message.signals[signal], raw))

    def with_counter(self, one: Emission, change: int) -> bytes | None:
        message = self._of(one)
        name = next((name for name in self._counters if message is not None and name in message.signals), None)
        if message is None or name is None:
            return None
        signal = message.signals[name]
        raw = _get(one.payload, message, signal) + change
        return self._protected(one, _put(one.payload, message, signal, raw))

    def stale(self, old: Emission, fresh: Emission) -> bytes | None:
        """The old frame with the fresh one's counters; frames of other messages or lengths have no old one."""
        if old.label != fresh.label or len(old.payload) != len(fresh.payload):
            return None
        message = self._of(old)
        if message is None:
            return None
        payload = old.payload
        for name in self._counters:
            if name in message.signals:
                signal = message.signals[name]
                payload = _put(payload, message, signal, _get(fresh.payload, message, signal))
        return self._protected(fresh, payload)

    def _protected(self, one: Emission, payload: bytes) -> bytes:
        """The changed frame with the check header counting as it did."""
        if self._protection is None or not self._protection.covers(one.label, one.payload):
            return payload
        return self._protection.counted(one.label, payload, one.payload, 0)

    # protection

    def with_e2e_counter(self, one: Emission, change: int) -> bytes | None:
        if self._protection is None or not self._protection.covers(one.label, one.payload):
            return None
        return self._protection.counted(one.label, one.payload, one.payload, change)

    def e2e_counter(self, one: Emission) -> int | None:
        if self._protection is None or not self._protection.covers(one.label, one.payload):
            return None
        return self._protection.counter(one.label, one.payload)

    def bad_e2e_check(self, one: Emission) -> bytes | None:
        if self._protection is None or not self._protection.covers(one.label, one.payload):
            return None
        place = self._protection.offset(one.label)
        return one.payload[:place] + bytes((one.payload[place] ^ 0xFF,)) + one.payload[place + 1 :]

    def bad_check(self, one: Emission) -> bytes | None:
        """The format has no check but the protection's; the bus has its own, which no receiver lets through."""
        return self.bad_e2e_check(one)


def _put(payload: bytes, message: MessageLayout, signal: SignalLayout, raw: int) -> bytes:
    mask = (1 << signal.bits) - 1
    order = "little" if signal.little_endian else "big"
    size = len(payload) if signal.little_endian else message.length
    number = int.from_bytes(payload[:size], "little" if signal.little_endian else "big")
    number = number & ~(mask << signal.shift) | (raw & mask) << signal.shift
    return number.to_bytes(size, "little" if order == "little" else "big") + payload[size:]


def _get(payload: bytes, message: MessageLayout, signal: SignalLayout) -> int:
    size = len(payload) if signal.little_endian else message.length
    number = int.from_bytes(payload[:size], "little" if signal.little_endian else "big")
    return number >> signal.shift & (1 << signal.bits) - 1
