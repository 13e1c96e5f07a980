"""Faults of single bytes and bits, whatever they mean: noise, lost and foreign bytes, pauses, a stuck line.

Both ways, where that makes sense: what goes to the host is hit telegram by telegram, what comes from it by what has
come in at once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from emulator.faults.acts import Act, Gear
from emulator.faults.kinds import BOTH_WAYS, TO_HOST, Keys, Kind
from emulator.transports.link import Received
from protocols.session import Emission, LinkKind

WIRES = (LinkKind.SERIAL, LinkKind.STREAM, LinkKind.DATAGRAM)
LINES = (LinkKind.SERIAL, LinkKind.STREAM)
CLEAN = "The next telegram is intact; a host that resynchronises loses no more than one."

Place = Annotated[int, Field(ge=0, le=10**9)] | None
Number = Annotated[int, Field(ge=1, le=65_536)]


class Bytes(Act):
    """Bytes changed both ways by one rule."""

    def change(self, data: bytes) -> tuple[bytes, str] | None:
        """Other bytes and what was done; None: nothing."""
        raise NotImplementedError

    def send(self, emission: Emission, now_ns: int) -> list[Emission] | None:
        done = self.change(emission.payload)
        if done is None:
            return None
        self.gear.hit(now_ns, f"{emission.label}: {done[1]}" if emission.label else done[1])
        self.gear.took("bytes", max(0, len(emission.payload) - len(done[0])))
        return [self.gear.spoilt(emission, done[0])]

    def hear(self, received: Received, link: int, now_ns: int) -> list[Received] | None:
        done = self.change(received.data) if received.data and self.gear.direction == "from_host" else None
        if done is None:
            return None
        self.gear.hit(now_ns, done[1])
        self.gear.swallowed(max(0, len(received.data) - len(done[0])))
        return [replace(received, data=done[0])]

    def place(self, given: int | None, size: int) -> int:
        """A place in the telegram: the given one, or any."""
        return self.gear.integer(size, "place") if given is None else min(given, size - 1)


class FlipKeys(Keys):
    """Of flipped bits."""

    bits: Annotated[int, Field(ge=1, le=64)] = 1
    "How many."
    at_byte: Place = None
    "Byte of the telegram that they are in; None: anywhere."


class Flip(Bytes):
    """Bits turned over."""

    def __init__(self, keys: FlipKeys, gear: Gear) -> None:
        super().__init__(gear)
        self._keys = keys

    def change(self, data: bytes) -> tuple[bytes, str]:
        changed = bytearray(data)
        places: set[int] = set()
        first, span = 0, 8 * len(data)
        if self._keys.at_byte is not None:
            first, span = 8 * self.place(self._keys.at_byte, len(data)), 8
        while len(places) < min(self._keys.bits, span):
            places.add(first + self.gear.integer(span, "bit"))
        for bit in places:
            changed[bit // 8] ^= 1 << bit % 8
        return bytes(changed), "bits " + ", ".join(map(str, sorted(places)))


class SomeBytesKeys(Keys):
    """Of bytes lost or added."""

    number: Number = 1
    "How many bytes."
    at_byte: Place = None
    "Before or at which byte of the telegram; None: anywhere."


class ValueKeys(SomeBytesKeys):
    """Of foreign bytes."""

    value: Annotated[int, Field(ge=0, le=255)] | None = None
    "Of each foreign byte; None: any."


class Insert(Bytes):
    """Foreign bytes in a telegram."""

    def __init__(self, keys: ValueKeys, gear: Gear) -> None:
        super().__init__(gear)
        self._keys = keys

    def change(self, data: bytes) -> tuple[bytes, str]:
        at = self.place(self._keys.at_byte, len(data))
        return data[:at] + _foreign(self.gear, self._keys.number, self._keys.value) + data[at:], f"before byte {at}"


class Replace(Bytes):
    """Other bytes in place of a telegram's own."""

    def __init__(self, keys: ValueKeys, gear: Gear) -> None:
        super().__init__(gear)
        self._keys = keys

    def change(self, data: bytes) -> tuple[bytes, str]:
        at = self.place(self._keys.at_byte, len(data))
        number = min(self._keys.number, len(data) - at)
        return data[:at] + _foreign(self.gear, number, self._keys.value) + data[at + number :], f"bytes from {at}"


class Delete(Bytes):
    """Bytes of a telegram missing."""

    def __init__(self, keys: SomeBytesKeys, gear: Gear) -> None:
        super().__init__(gear)
        self._keys = keys

    def change(self, data: bytes) -> tuple[bytes, str]:
        at = self.place(self._keys.at_byte, len(data))
        return data[:at] + data[at + self._keys.number :], f"bytes from {at}"


def _foreign(gear: Gear, number: int, value: int | None) -> bytes:
    if value is not None:
        return bytes((value,)) * number
    return (gear.uniform(number, "bytes") * 256).astype(np.uint8).tobytes()


class NoiseKeys(Keys):
    """Of a noisy line."""

    bit_error_rate: Annotated[float, Field(gt=0.0, le=0.5)]
    "Chance of each bit to be turned over."


class Noise(Bytes):
    """Each bit by its own chance."""

    def __init__(self, keys: NoiseKeys, gear: Gear) -> None:
        super().__init__(gear)
        self._rate = keys.bit_error_rate

    def change(self, data: bytes) -> tuple[bytes, str] | None:
        turned = self.gear.uniform(8 * len(data), "noise") < self._rate
        if not turned.any():
            return None
        mask = np.packbits(turned)
        changed = np.frombuffer(data, dtype=np.uint8) ^ mask
        return changed.tobytes(), f"{int(turned.sum())} bits"


class GapKeys(Keys):
    """Of a pause inside a telegram."""

    gap_s: Annotated[float, Field(gt=0.0, le=3600.0)]
    "How long."
    at_byte: Place = None
    "Before which byte of the telegram; None: anywhere."


class Gap(Act):
    """A telegram in two pieces with a pause between them."""

    def __init__(self, keys: GapKeys, gear: Gear) -> None:
        super().__init__(gear)
        self._keys = keys

    def send(self, emission: Emission, now_ns: int) -> list[Emission] | None:
        data = emission.payload
        if len(data) < 2:
            return None
        given = self._keys.at_byte
        at = 1 + self.gear.integer(len(data) - 1, "place") if given is None else min(max(1, given), len(data) - 1)
        self.gear.hit(now_ns, f"before byte {at}")
        due_ns = emission.due_ns + round(self._keys.gap_s * 1e9)
        first = replace(emission, payload=data[:at], line_speed=None)
        return [first, replace(emission, payload=data[at:], due_ns=due_ns, sweep=None)]


class Garbage(Act):
    """Foreign bytes between two telegrams."""

    def __init__(self, keys: ValueKeys, gear: Gear) -> None:
        super().__init__(gear)
        self._keys = keys

    def send(self, emission: Emission, now_ns: int) -> list[Emission]:
        self.gear.hit(now_ns, f"{self._keys.number} bytes")
        foreign = _foreign(self.gear, self._keys.number, self._keys.value)
        garbage = replace(emission, payload=foreign, sweep=None, line_speed=None, label="garbage")
        return [garbage, emission]


class GarbageKeys(ValueKeys):
    """Of foreign bytes between telegrams."""

    number: Number = 16
    "How many bytes."


class StuckKeys(Keys):
    """Of a line that does not move."""

    level: Literal["break", "zeros", "ones", "idle"] = "break"
    """break: the line stays low, a receiver reads one 0x00 and then nothing. zeros, ones: each byte reads 0x00 or 0xFF.
    idle: the line stays high, nothing comes."""


class Stuck(Bytes):
    """A line that stands still; the device does not know of it."""

    def __init__(self, keys: StuckKeys, gear: Gear) -> None:
        super().__init__(gear)
        self._level = keys.level
        self._broken = False

    def begin(self, now_ns: int) -> None:
        self._broken = False

    def change(self, data: bytes) -> tuple[bytes, str]:
        if self._level in ("zeros", "ones"):
            return (b"\0" if self._level == "zeros" else b"\xff") * len(data), self._level
        first, self._broken = not self._broken, True
        return (b"\0" if first and self._level == "break" else b""), self._level


def _kind(name: str, summary: str, act: Callable[..., Act], keys: type[Keys], **more: object) -> Kind:
    given: dict[str, object] = {"directions": BOTH_WAYS, "links": WIRES} | more
    return Kind(name, "byte", summary, str(given.pop("ends", CLEAN)), keys, act, **given)  # type: ignore[arg-type]


KINDS: tuple[Kind, ...] = (
    _kind("flip_bits", "Bits of a telegram are inverted.", Flip, FlipKeys, links=()),
    _kind("insert_bytes", "Extra bytes are inserted into a telegram.", Insert, ValueKeys),
    _kind("delete_bytes", "Bytes of a telegram are missing, as after an overrun.", Delete, SomeBytesKeys),
    _kind("replace_bytes", "Bytes of a telegram are replaced.", Replace, ValueKeys, links=()),
    _kind(
        "gap",
        "A telegram is interrupted and continues after a pause.",
        Gap,
        GapKeys,
        directions=TO_HOST,
        links=LINES,
        ends="Telegrams are contiguous again; data queued behind the pause follows at line speed.",
    ),
    _kind("garbage", "Extra bytes are sent between two telegrams.", Garbage, GarbageKeys, directions=TO_HOST),
    _kind(
        "stuck_line",
        "The line is stuck: a break, zeros, ones, or silence.",
        Stuck,
        StuckKeys,
        lasts="state",
        links=(LinkKind.SERIAL,),
        ends="The device continues in the middle of its output; lost data is not sent again.",
    ),
    _kind(
        "line_noise",
        "Each bit is inverted with a given probability.",
        Noise,
        NoiseKeys,
        lasts="state",
        ends="No further bit errors.",
        links=(LinkKind.SERIAL, LinkKind.STREAM, LinkKind.DATAGRAM),
    ),
)
