"""A decoder of Hesai's packets, written from the specification alone: struct, one packet at a time, nothing of ours."""

from __future__ import annotations

import csv
import hashlib
import io
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property


@dataclass
class Point:
    """A return; hesai's frame: azimuth clockwise from y."""

    block: int
    channel: int
    azimuth_deg: float
    "Of the block, or the encoder."
    range_m: float
    reflectivity: int
    at_s: float
    "Of the block, since 1970."


@dataclass
class Packet:
    """What a packet says."""

    model: str
    mode: int
    echoes: int
    rpm: int
    t0_s: float
    sequence: int
    shutdown: int
    azimuths: list[float]
    listed: Callable[[], list[Point]]
    safety: bytes = b""
    state_word: int = 0
    operation: int = 0
    imu: tuple[int, ...] = ()

    @cached_property
    def points(self) -> list[Point]:
        """All returns, block by block."""
        return self.listed()

    def state(self, block: int) -> int:
        """Azimuth state of a block."""
        return self.state_word >> (14 - 2 * block) & 3 if block < 2 else 0


MIRRORED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))


def crc(data: bytes) -> int:
    """CRC-32/MPEG-2: zlib's with the bits of every byte, and of the result, the other way round, and not inverted."""
    return int(f"{~zlib.crc32(data.translate(MIRRORED)) & 0xFFFFFFFF:032b}"[::-1], 2)


def _u(data: bytes, at: int, size: int) -> int:
    return int.from_bytes(data[at : at + size], "little")


def _date(six: bytes, base: int) -> float:
    if base == 0:
        assert six[0] == 0
        return float(int.from_bytes(six[1:6], "big"))
    return datetime(base + six[0], *six[1:6], tzinfo=UTC).timestamp()


# model: length, lasers, blocks, first block at, bytes of a channel, unit, shutdown, mode, rpm, utc, us, factory,
# sequence, base of the year, firing period
ROWS = {
    "xt32": (1080, 32, 8, 12, 4, 4, 1061, 1062, 1063, 1065, 1071, 1075, 1076, 1900, 50e-6),
    "xt32m2x": (820, 32, 6, 12, 4, 5, 801, 802, 803, 805, 811, 815, 816, 1900, 50e-6),
    "qt64": (1072, 64, 4, 12, 4, 4, 1050, 1060, 1054, 1062, 1056, 1061, 1068, 1900, 500e-6 / 3),
    "pandar128e3x": (861, 128, 2, 12, 3, 4, None, 817, 818, 820, 826, 830, 831, 1900, 500e-6 / 9),
    "ot128": (861, 128, 2, 12, 3, 4, None, 817, 818, 820, 826, 830, 831, 1900, 500e-6 / 9),
    "at128": (1118, 128, 2, 12, 4, 4, 1052, 1070, 1064, 1072, 1066, 1071, 1078, 0, 125e-6 / 3),
    "pandar40p": (1266, 40, 10, 0, 3, 4, 1245, 1254, 1248, 1256, 1250, 1255, 1262, 2000, 500e-6 / 9),
}


def model_of(data: bytes) -> str:
    if data[:2] == b"\xff\xee":
        return "pandar40p"
    assert data[:2] == b"\xee\xff"
    kind = data[2], data[3]
    if kind == (6, 1):
        return {8: "xt32", 6: "xt32m2x"}[data[7]]
    if kind == (1, 4):
        return "ot128" if data[4] >= 128 else "pandar128e3x"
    return {(3, 1): "qt64", (4, 3): "at128"}[kind]


def decode(data: bytes) -> Packet:
    model = model_of(data)
    size, lasers, blocks, at, each, unit, hot, mode, rpm, utc, us, factory, sequence, base, period = ROWS[model]
    signature = 32 * (at == 12 and model in ("ot128", "pandar128e3x") and bool(data[11] & 8))
    assert len(data) == size + signature
    assert data[factory] == 0x42
    if at == 12:
        assert (data[6], data[7], data[9]) == (lasers, blocks, unit)
    echoes = {0x37: 1, 0x38: 1, 0x33: 1, 0x39: 2, 0x3B: 2, 0x3C: 2, 0x3D: 3}[data[mode]]
    if at == 12:
        assert data[10] == echoes
    t0 = _date(data[utc : utc + 6], base) + 1e-6 * _u(data, us, 4)
    head = 4 if model == "pandar40p" else 3 if model == "at128" else 2
    step = head + lasers * each
    azimuths, offsets = [], []
    for b in range(blocks):
        begin = at + b * step
        if model == "pandar40p":
            assert data[begin : begin + 2] == b"\xff\xee"
            azimuth = _u(data, begin + 2, 2) / 100
        else:
            azimuth = (_u(data, begin, 2) + (data[begin + 2] / 256 if model == "at128" else 0)) / 100
        azimuths.append(azimuth)
        later = (blocks - 1 - b) // echoes
        offsets.append({
            "xt32": 5.632e-6 - period * later,
            "xt32m2x": 5.632e-6 - period * later,
            "qt64": 25.71e-6 + period * (b // echoes),
            "pandar128e3x": 3.148e-6 - period * later,
            "ot128": -period * later,
            "at128": -9.249e-6 - period * (1 + later),
            "pandar40p": -28.58e-6 - period * later,
        }[model])  # fmt: skip

    def listed() -> list[Point]:
        points = []
        for b in range(blocks):
            begin = at + b * step + head
            words = struct.iter_unpack("<HB" + (each - 3) * "x", data[begin : begin + lasers * each])
            for c, (distance, reflectivity) in enumerate(words):
                if distance:
                    points.append(Point(b, c, azimuths[b], distance * unit / 1000, reflectivity, t0 + offsets[b]))
        return points

    found = Packet(
        model,
        data[mode],
        echoes,
        _u(data, rpm, 2),
        t0,
        _u(data, sequence, 4),
        0 if hot is None else data[hot],
        azimuths,
        listed,
    )
    if model in ("ot128", "pandar128e3x"):
        assert _u(data, 784, 4) == crc(data[12:784])
        assert _u(data, 801, 4) == crc(data[789:801])
        assert _u(data, 857, 4) == crc(data[805:857])
        found.safety, found.state_word, found.operation = data[788:805], _u(data, 814, 2), data[816]
        found.imu = struct.unpack("<hHHI6h", data[835:857])
    if model == "at128":
        assert _u(data, 1042, 4) == crc(data[12:1042])
        assert _u(data, 1082, 4) == crc(data[1046:1082])
    return found


def csv_angles(text: bytes) -> list[tuple[float, float]]:
    """Elevation and azimuth offset of a calibration file, as drivers read it."""
    rows = list(csv.reader(io.StringIO(text.decode("ascii"))))[1:]
    assert [int(one[0]) for one in rows] == list(range(1, len(rows) + 1))
    return [(float(one[1]), float(one[2])) for one in rows]


class Channels:
    """A file of a spinning model."""

    def __init__(self, file: bytes) -> None:
        self._rows = csv_angles(file)

    def direction(self, azimuth_deg: float, channel: int, late_deg: float) -> tuple[float, float]:
        """True azimuth and elevation of a channel; the rotor has turned on by `late_deg` when it fires."""
        elevation, offset = self._rows[channel]
        return (azimuth_deg + late_deg + offset) % 360.0, elevation


class Mirrors:
    """The file of an AT128."""

    def __init__(self, file: bytes) -> None:
        assert file[:5] == bytes((0xEE, 0xFF, 1, 5, 128))
        assert hashlib.sha256(file[:-32]).digest() == file[-32:]
        self._unit = 0.01 * file[15]
        scale = self._unit / 256
        self.starts = [one * scale for one in struct.unpack_from("<3I", file, 16)]
        self.ends = [one * scale for one in struct.unpack_from("<3I", file, 28)]
        self._azimuth = [one * scale for one in struct.unpack_from("<128i", file, 40)]
        self._elevation = [one * scale for one in struct.unpack_from("<128i", file, 552)]
        self._adjust = struct.unpack_from("<23040b", file, 1064), struct.unpack_from("<23040b", file, 24104)

    def adjusted(self, which: int, channel: int, encoder_deg: float) -> float:
        """One value each two degrees of the encoder, and on a line between."""
        place = encoder_deg % 360.0 / 2.0
        before, share = int(place), place - int(place)
        values = [self._adjust[which][180 * channel + one % 180] for one in (before, before + 1)]
        return self._unit * (values[0] * (1.0 - share) + values[1] * share)

    def direction(self, azimuth_deg: float, channel: int, late_deg: float) -> tuple[float, float]:
        """As of a spinning model; `azimuth_deg` is the encoder's."""
        fields = zip(self.starts, self.ends, strict=True)
        (start,) = [low for low, high in fields if (azimuth_deg - low) % 360.0 < (high - low) % 360.0]
        fires = azimuth_deg + late_deg
        azimuth = 2.0 * ((azimuth_deg - start) % 360.0 + late_deg) - self._azimuth[channel]
        azimuth += self.adjusted(0, channel, fires)
        return azimuth, self._elevation[channel] + self.adjusted(1, channel, fires)


Angles = Channels | Mirrors
