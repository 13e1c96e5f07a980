"""Message layouts: a DBC file read by cantools is the only place where a bit position is written down.

Belongs here: the DBC's own signal metadata turned once into shifts and masks, so that a list of objects is packed as
arrays; single host messages are read by cantools itself. Not: what the values mean.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from protocols.errors import EncodeError

RawInts = NDArray[np.int64]
MOST_BYTES = 16 << 20
"Of a DBC file."


@dataclass(frozen=True)
class SignalLayout:
    """One signal of a message: how a physical value becomes an integer, and where its bits lie."""

    name: str
    scale: float
    offset: float
    raw_min: int
    "Smallest raw value that both the bits and the DBC's range allow."
    raw_max: int
    bits: int
    little_endian: bool
    shift: int
    "Of its least significant bit: in the message read as one big-endian number, or little-endian from byte 0."

    def quantise(self, physical: ArrayLike) -> RawInts:
        """Nearest raw value, ends of the range for what lies outside, the lower end for NaN."""
        raw = np.rint((np.asarray(physical, dtype=np.float64) - self.offset) / self.scale)
        clipped = np.fmin(np.fmax(raw, self.raw_min), self.raw_max)  # of NaN and a number they take the number
        return np.asarray(clipped, dtype=np.int64)

    def quantise_one(self, physical: float) -> int:
        """The same for one value."""
        if physical != physical:
            return self.raw_min
        raw = (physical - self.offset) / self.scale
        return (
            min(max(round(raw), self.raw_min), self.raw_max)
            if abs(raw) < 2.0**53
            else (self.raw_max if raw > 0 else self.raw_min)
        )


@dataclass(frozen=True)
class MessageLayout:
    """One message without alternatives: packs any number of frames at once."""

    name: str
    identifier: int
    length: int
    signals: Mapping[str, SignalLayout]
    used_bytes: frozenset[int]
    "Bytes that carry at least one bit of a signal."

    def frames(self, count: int, raw: Mapping[str, ArrayLike] | None = None, **physical: ArrayLike) -> list[bytes]:
        """Pack `count` frames; signals that are not named are raw 0.

        Parameters
        ----------
        count : number of frames.
        raw : raw integers by signal, (count,) or scalar; for codes that have no physical value.
        **physical : values by signal in the DBC's units, (count,) or scalar; saturated at the signal's range.
        """
        columns: dict[str, RawInts] = {name: self._signal(name).quantise(value) for name, value in physical.items()}
        for name, value in (raw or {}).items():
            signal, column = self._signal(name), np.asarray(value, dtype=np.int64)
            low = -(1 << signal.bits - 1) if signal.raw_min < 0 else 0
            if column.size and (column.min() < low or column.max() >= low + (1 << signal.bits)):
                raise EncodeError(f"{self.name}.{name}: {value!r} does not fit into {signal.bits} bits")
            columns[name] = column
        big = np.zeros(count, dtype=np.uint64)
        little = np.zeros(count, dtype=np.uint64)
        for name, column in columns.items():
            signal = self.signals[name]
            bits = (column & ((1 << signal.bits) - 1)).astype(np.uint64) << np.uint64(signal.shift)
            if signal.little_endian:
                little |= bits
            else:
                big |= bits
        words = (big << np.uint64(8 * (8 - self.length))).astype(">u8").view(np.uint8)
        packed = (words | little.astype("<u8").view(np.uint8)).tobytes()
        return [packed[start : start + self.length] for start in range(0, 8 * count, 8)]

    def frame(self, raw: Mapping[str, int] | None = None, **physical: float) -> bytes:
        """Pack one frame: the same as `frames`, without arrays."""
        big = little = 0
        values = [(name, self._signal(name).quantise_one(value)) for name, value in physical.items()]
        for name, value in [*values, *(raw or {}).items()]:
            signal = self._signal(name)
            low = -(1 << signal.bits - 1) if signal.raw_min < 0 else 0
            if not low <= value < low + (1 << signal.bits):
                raise EncodeError(f"{self.name}.{name}: {value!r} does not fit into {signal.bits} bits")
            bits = (int(value) & ((1 << signal.bits) - 1)) << signal.shift
            if signal.little_endian:
                little |= bits
            else:
                big |= bits
        return (big | int.from_bytes(little.to_bytes(self.length, "little"), "big")).to_bytes(self.length, "big")

    def _signal(self, name: str) -> SignalLayout:
        if name not in self.signals:
            raise EncodeError(f"{self.name} has no signal {name}; it has {', '.join(self.signals)}")
        return self.signals[name]


class DecodedSignal(NamedTuple):
    """One signal of a frame as text."""

    name: str
    value: str
    "In the DBC's unit, or its name for the value."
    unit: str


class Layout:
    """All messages of one DBC file."""

    def __init__(self, file_name: str) -> None:
        import cantools

        self.file_name = file_name
        text = files(__package__).joinpath(file_name).read_text(encoding="utf-8")
        database: Any = cantools.database.load_string(text, database_format="dbc", strict=True)
        self._database = database
        self.messages: Mapping[str, MessageLayout] = {
            message.name: layout_of(message) for message in self._database.messages if not message.is_multiplexed()
        }

    def __getitem__(self, name: str) -> MessageLayout:
        return self.messages[name]

    def identifier(self, name: str) -> int:
        """Identifier of a message as the DBC has it, before any shift."""
        return int(self._database.get_message_by_name(name).frame_id)

    def length(self, name: str) -> int:
        """Bytes of a message."""
        return int(self._database.get_message_by_name(name).length)

    def cycle_ns(self, name: str) -> int:
        """Cycle time that the DBC states, 0 when it has none."""
        return int(self._database.get_message_by_name(name).cycle_time or 0) * 1_000_000

    def decode(self, name: str, data: bytes) -> dict[str, float]:
        """Physical values of one frame; shorter data are filled with zeros, longer ones cut."""
        message = self._database.get_message_by_name(name)
        padded = data[: message.length].ljust(message.length, b"\0")
        return dict(message.decode(padded, decode_choices=False))

    def name_of(self, identifier: int) -> str | None:
        """The message of an identifier as the DBC has it; None: there is none."""
        try:
            return str(self._database.get_message_by_frame_id(identifier).name)
        except KeyError:
            return None

    def decoded_signals(self, name: str, data: bytes) -> list[DecodedSignal]:
        """Every signal of one frame as text, in the order of its bits; shorter data are padded with zeros."""
        message = self._database.get_message_by_name(name)
        values = message.decode(data[: message.length].ljust(message.length, b"\0"), decode_choices=True)
        found = []
        for signal in message.signals:
            if signal.name in values:
                value = values[signal.name]
                shown = f"{value:.6g}" if isinstance(value, float) else str(value)
                found.append(DecodedSignal(signal.name, shown, signal.unit or ""))
        return found

    def encode(self, name: str, values: Mapping[str, float]) -> bytes:
        """One frame of a message with alternatives (a multiplexer), packed by cantools itself."""
        message = self._database.get_message_by_name(name)
        return bytes(message.encode(dict(values), scaling=True, strict=False))

    def alternatives(self, name: str) -> Mapping[int, tuple[str, ...]]:
        """Signals of a multiplexed message by the value of its multiplexer."""
        found: dict[int, tuple[str, ...]] = {}
        for signal in self._database.get_message_by_name(name).signals:
            for value in signal.multiplexer_ids or ():
                found[value] = (*found.get(value, ()), signal.name)
        return found


def database_of(path: Path) -> Any:
    """The cantools database of somebody else's DBC file; `ValueError` with what is wrong with it, `OSError`."""
    import cantools

    if path.stat().st_size > MOST_BYTES:
        raise ValueError(f"more than {MOST_BYTES >> 20} MB")
    try:
        return cantools.database.load_file(str(path), database_format="dbc", strict=True)
    except Exception as error:  # whatever a parser says of a strange file
        raise ValueError(" ".join(str(error).split())[:200] or type(error).__name__) from None


@cache
def load(file_name: str) -> Layout:
    """The layout of a DBC file of this package, read once."""
    return Layout(file_name)


def layout_of(message: Any) -> MessageLayout:
    """Of a cantools message without alternatives and of at most 8 bytes."""
    signals = {signal.name: _signal_layout(signal, message.length) for signal in message.signals}
    used: set[int] = set()
    for layout in signals.values():
        for bit in range(layout.shift, layout.shift + layout.bits):
            used.add(bit // 8 if layout.little_endian else message.length - 1 - bit // 8)
    return MessageLayout(message.name, message.frame_id, message.length, signals, frozenset(used))


def _signal_layout(signal: Any, length_bytes: int) -> SignalLayout:
    little = signal.byte_order == "little_endian"
    if little:
        shift = signal.start
    else:
        first = 8 * (signal.start // 8) + 7 - signal.start % 8  # most significant bit, counted as the bits are sent
        shift = 8 * length_bytes - first - signal.length
    scale, offset = float(signal.scale), float(signal.offset)
    low = -(1 << signal.length - 1) if signal.is_signed else 0
    high = low + (1 << signal.length) - 1
    slack = 1e-6  # of one step: limits are printed with few digits
    if signal.minimum is not None:
        low = max(low, int(np.ceil((float(signal.minimum) - offset) / scale - slack)))
    if signal.maximum is not None:
        high = min(high, int(np.floor((float(signal.maximum) - offset) / scale + slack)))
    return SignalLayout(signal.name, scale, offset, low, high, signal.length, little, shift)
