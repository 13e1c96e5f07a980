"""A decoder of our tests' own, written from the byte tables of the sources: it shares nothing with the product.

Belongs here: frames, LMDscandata in both dialects. Not: what a device answers when (rig).
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from functools import reduce


def ask_a(text: str) -> bytes:
    return b"\x02" + text.encode("latin-1") + b"\x03"


def ask_b(text: str, data: str | bytes = b"") -> bytes:
    raw = bytes.fromhex(data) if isinstance(data, str) else data
    payload = text.encode() + (b" " + raw if raw else b"")
    return b"\x02\x02\x02\x02" + struct.pack(">I", len(payload)) + payload + bytes([reduce(int.__xor__, payload)])


def frames(data: bytes) -> list[tuple[str, bytes]]:
    """Dialect and payload of each telegram; every byte must belong to one."""
    found = []
    while data:
        if data.startswith(b"\x02\x02\x02\x02"):
            (size,) = struct.unpack(">I", data[4:8])
            payload, check = data[8 : 8 + size], data[8 + size]
            assert check == reduce(int.__xor__, payload)
            found.append(("B", payload))
            data = data[9 + size :]
        else:
            assert data[:1] == b"\x02"
            text, end, data = data[1:].partition(b"\x03")
            assert end
            found.append(("A", text))
    return found


@dataclass
class ScanRead:
    """One LMDscandata."""

    head: str = ""
    version: int = 0
    device: int = 0
    serial: int = 0
    status: tuple[int, int] = (0, 0)
    telegrams: int = 0
    scans: int = 0
    scan_us: int = 0
    sent_us: int = 0
    inputs: tuple[int, int] = (0, 0)
    outputs: tuple[int, int] = (0, 0)
    layer: int = 0
    scan_frequency: int = 0
    measuring_frequency: int = 0
    encoders: list[tuple[int, int]] = field(default_factory=list)
    channels: dict[str, tuple[float, float, int, int, list[int]]] = field(default_factory=dict)
    "Name -> scale, offset, start angle, step, values."
    wide: list[str] = field(default_factory=list)
    "Names of the channels of 16 bit."
    name: str | None = None
    comment: str | None = None
    time: tuple[int, ...] | None = None

    def mm(self, channel: str = "DIST1") -> list[float]:
        scale, offset, _, _, values = self.channels[channel]
        return [value * scale + offset for value in values]


def read_b(payload: bytes) -> ScanRead:
    head, name, data = payload.split(b" ", 2)
    assert name == b"LMDscandata"
    at = 0

    def take(form: str) -> tuple[int, ...]:
        nonlocal at
        size = struct.calcsize(">" + form)
        values = struct.unpack(">" + form, data[at : at + size])
        at += size
        return values

    found = ScanRead(head=head.decode())
    found.version, found.device, found.serial = take("HHI")
    found.status = take("BB")  # type: ignore[assignment]
    found.telegrams, found.scans, found.scan_us, found.sent_us = take("HHII")
    found.inputs, found.outputs = take("BB"), take("BB")  # type: ignore[assignment]
    found.layer, found.scan_frequency, found.measuring_frequency = take("hII")
    found.encoders = [take("IH") for _ in range(take("H")[0])]  # type: ignore[misc]
    for letter in "HB":
        for _ in range(take("H")[0]):
            name, scale, offset, start, step, count = take("5sffiHH")  # type: ignore[assignment]
            values = list(take(f"{count}{letter}"))
            found.channels[name.decode()] = (scale, offset, start, step, values)  # type: ignore[assignment]
            found.wide += [name.decode()] if letter == "H" else []
    if take("H")[0]:
        take("ffffffB")
    for key in ("name", "comment"):
        if take("H")[0]:
            (size,) = take("H")
            setattr(found, key, data[at : at + size].decode())
            at += size
    found.time = take("HBBBBBI") if take("H")[0] else None
    assert take("H") == (0,)
    assert at == len(data)
    return found


def read_a(payload: bytes) -> ScanRead:
    words = payload.decode().split(" ")
    head, name, *rest = words
    assert name == "LMDscandata"
    line = iter(rest)

    def number() -> int:
        return int(next(line), 16)

    def single() -> float:
        word = next(line)
        assert len(word) == 8
        return float(struct.unpack(">f", bytes.fromhex(word))[0])

    def signed(bits: int) -> int:
        value = number()
        return value - (1 << bits) if value >> (bits - 1) else value

    found = ScanRead(head=head)
    found.version, found.device, found.serial = number(), number(), number()
    found.status = number(), number()
    found.telegrams, found.scans, found.scan_us, found.sent_us = number(), number(), number(), number()
    found.inputs, found.outputs = (number(), number()), (number(), number())
    found.layer, found.scan_frequency, found.measuring_frequency = signed(16), number(), number()
    found.encoders = [(number(), number()) for _ in range(number())]
    for wide in (True, False):
        for _ in range(number()):
            channel, scale, offset = next(line), single(), single()
            word = next(line)
            assert len(word) == 8, "a driver reads exactly eight characters"
            start = struct.unpack(">i", bytes.fromhex(word))[0]
            step, count = number(), number()
            found.channels[channel] = (scale, offset, start, step, [number() for _ in range(count)])
            found.wide += [channel] if wide else []
    if number():
        assert [single() for _ in range(6)]
        number()
    for key in ("name", "comment"):
        if number():
            size, text = number(), ""
            while len(text) < size:
                text += (" " if text else "") + next(line)
            setattr(found, key, text)
    found.time = tuple(number() for _ in range(7)) if number() else None
    assert number() == 0
    assert next(line, None) is None
    return found


def read(dialect: str, payload: bytes) -> ScanRead:
    return read_b(payload) if dialect == "B" else read_a(payload)
