"""A host's reader of the LD user protocol, written from the protocol's description alone.

It imports nothing of `protocols`: what it reads out of our bytes is a stranger's judgement. Plain and slow on purpose.
"""

from __future__ import annotations

from dataclasses import dataclass, field


def words(data: bytes) -> list[int]:
    assert len(data) % 2 == 0
    return [data[i] << 8 | data[i + 1] for i in range(0, len(data), 2)]


# TCP


def read_frames(stream: bytes) -> list[bytes]:
    """Payloads of a stream that holds whole frames and nothing else."""
    payloads = []
    at = 0
    while at < len(stream):
        assert stream[at : at + 4] == b"\x02USP", stream[at : at + 8].hex(" ")
        length = stream[at + 4] << 24 | stream[at + 5] << 16 | stream[at + 6] << 8 | stream[at + 7]
        payload = stream[at + 8 : at + 8 + length]
        assert len(payload) == length
        check = 0
        for byte in payload:
            check ^= byte
        assert stream[at + 8 + length] == check
        payloads.append(payload)
        at += 9 + length
    return payloads


def frame(payload: bytes) -> bytes:
    """What a host sends."""
    check = 0
    for byte in payload:
        check ^= byte
    return b"\x02USP" + bytes([0, 0, len(payload) >> 8, len(payload) & 255]) + payload + bytes([check])


def request(*message: int) -> bytes:
    """A host's telegram of these words."""
    return frame(b"".join(bytes([word >> 8, word & 255]) for word in message))


# serial


def crc(data: bytes) -> int:
    """The vendor's recurrence with its table of the polynomial 1021, one byte after the other."""
    table = []
    for index in range(256):
        value = index << 8
        for _ in range(8):
            value = (value << 1 ^ 0x1021 if value & 0x8000 else value << 1) & 0xFFFF
        table.append(value)
    value = 0xFFFF
    for byte in data:
        value = (value << 8 & 0xFFFF | byte) ^ table[value >> 8]
    return value


def package(*message: int, lower_case: bool = False) -> bytes:
    """A package of these words, the CRC added."""
    data = b"".join(bytes([word >> 8, word & 255]) for word in message)
    text = (data + crc(data).to_bytes(2, "big")).hex()
    return b"\x02" + (text if lower_case else text.upper()).encode() + b"\x03"


def read_packages(stream: bytes) -> list[tuple[int, list[int]]]:
    """Address word and message of all packages; several packages of one message are put together."""
    messages = []
    parts: list[int] = []
    left = 0
    for piece in stream.split(b"\x03")[:-1]:
        assert piece[:1] == b"\x02"
        assert piece[1:] == piece[1:].lower(), "as the listing's example of a reply (p. 52)"
        data = bytes.fromhex(piece[1:].decode())
        assert crc(data[:-2]) == int.from_bytes(data[-2:], "big")
        address, count, number, *rest = words(data)
        assert count == len(rest) + 1
        assert count <= 126  # Miro's limit
        rest = rest[:-1]
        if number == 0:
            assert left == 0
            messages.append((address, rest))
        elif number == 0xFFFF:
            assert left == 0
            left, parts = rest[0] - 1, rest[1:]
        else:
            assert number == left
            left -= 1
            parts += rest
            if left == 0:
                messages.append((address, parts))
    assert left == 0
    assert stream.endswith(b"\x03")
    return messages


# CAN


def can_frames(identity: int, *message: int) -> list[bytes]:
    """The frames that Fawkes sends."""

    def data(*part: int) -> bytes:
        return b"".join(bytes([word >> 8, word & 255]) for word in part)

    if len(message) <= 2:
        return [data(0, identity, *message)]
    count = 1 + (len(message) - 1 + 2) // 3
    frames = [data(0xFFFF, count, identity, message[0])]
    rest = list(message[1:])
    for number in range(count - 1, 0, -1):
        frames.append(data(number, *rest[:3]))
        rest = rest[3:]
    return frames


def read_can(frames: list[bytes]) -> list[tuple[int, list[int]]]:
    """ID word and words of each message, as Fawkes puts them together."""
    messages = []
    at = 0
    while at < len(frames):
        first = words(frames[at])
        at += 1
        if first[0] == 0:
            messages.append((first[1], first[2:]))
            continue
        assert first[0] == 0xFFFF
        assert len(first) == 4
        message = [first[3]]
        for number in range(first[1] - 1, 0, -1):
            later = words(frames[at])
            at += 1
            assert later[0] == number
            assert len(later) == 4 or number == 1
            message += later[1:]
        messages.append((first[2], message))
    return messages


# profiles


@dataclass
class SectorRead:
    number: int | None = None
    step: int | None = None
    count: int | None = None
    start_ms: int | None = None
    start: int | None = None
    distances: list[int] = field(default_factory=list)
    directions: list[int] = field(default_factory=list)
    echoes: list[int] = field(default_factory=list)
    end_ms: int | None = None
    end: int | None = None


@dataclass
class ProfileRead:
    form: int
    layers: int
    sent: int | None = None
    counter: int | None = None
    layer: int | None = None
    sectors: list[SectorRead] = field(default_factory=list)
    status: int | None = None


def read_profile(payload: bytes, points: list[int] | None = None) -> ProfileRead:
    """A profile; `points` of each sector must be known to a host that did not ask for POINTNUM."""
    values = iter(words(payload))
    assert next(values) == 0x8301
    form = next(values)
    layers_sectors = next(values)
    profile = ProfileRead(form, layers_sectors >> 8)
    if form & 0x0001:
        profile.sent = next(values)
    if form & 0x0002:
        profile.counter = next(values)
    if form & 0x0004:
        profile.layer = next(values)
    for index in range(layers_sectors & 0xFF):
        sector = SectorRead()
        if form & 0x0008:
            sector.number = next(values)
        if form & 0x0010:
            sector.step = next(values)
        if form & 0x0020:
            sector.count = next(values)
        if form & 0x0040:
            sector.start_ms = next(values)
        if form & 0x0080:
            sector.start = next(values)
        count = sector.count if points is None else points[index]
        if count is None:
            assert not form & 0x0700  # a host that wants points must know how many
            count = 0
        for _ in range(count):
            if form & 0x0100:
                sector.distances.append(next(values))
            if form & 0x0200:
                sector.directions.append(next(values))
            if form & 0x0400:
                sector.echoes.append(next(values))
        if form & 0x0800:
            sector.end_ms = next(values)
        if form & 0x1000:
            sector.end = next(values)
        profile.sectors.append(sector)
    if form & 0x2000:
        profile.status = next(values) << 16 | next(values)
    assert list(values) == []
    return profile
