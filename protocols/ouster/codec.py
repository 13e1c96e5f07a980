"""Ouster's datagrams: lidar packets of 16 columns in all profiles, and IMU packets, many at once as arrays.

Belongs here: bytes, rounding, and the words for no return. Not: when a column fires and where it looks.
Little-endian. Arrays of P packets, C = 16 P columns, H rows, E returns.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from protocols.checksums import crc64_xz
from protocols.scan import Floats
from protocols.skeleton.reflectivity import whole

Words = NDArray[Any]
"Whole numbers."
Bools = NDArray[np.bool_]
COLUMNS = 16
"Of a packet."
END = 32
"Bytes of a header, and of a footer."
ENCODER_TICKS = 90_112
WHITE = 100.0
"Reflectivity of a diffuse white plate; beyond, up to 255, by the logarithm."
PLACEHOLDER = bytes.fromhex("dec00000efbeadde")
"In place of a checksum, firmware 2.3 to 3.0."
LIDAR, IMU = 1, 2
ZERO = np.zeros((), np.uint32)
"Of all pixels."


@dataclass(frozen=True)
class Profile:
    """One form of lidar packets."""

    name: str
    size_bits: int
    "Of a pixel."
    fields: Mapping[str, tuple[int, int]]
    "First bit and width, little-endian; names end with the number of the return."
    returns: int = 1
    unit_mm: int = 1
    since: tuple[int, int] = (2, 2)
    fusa: bool = False
    "It always has the header for functional safety."

    @property
    def legacy(self) -> bool:
        """Without header and footer."""
        return self.name == "LEGACY"

    @cached_property
    def places(self) -> Mapping[str, tuple[int, np.uint32]]:
        """Word of 32 bits, and bit in it, by field."""
        return {name: (first // 32, np.uint32(first % 32)) for name, (first, _) in self.fields.items()}

    @property
    def has_signal(self) -> bool:
        """Whether it says photons of returns."""
        return "signal0" in self.fields

    @cached_property
    def longest_mm(self) -> int:
        """What a range can be."""
        return ((1 << self.fields["range0"][1]) - 1) * self.unit_mm

    @property
    def near_ir_unit(self) -> int:
        """Photons of near-infrared that are one on the wire."""
        return 16 if self.fields["near_ir"][1] == 8 else 1

    def size(self, rows: int) -> int:
        """Bytes of a packet."""
        column = (20 if self.legacy else 12) + rows * self.size_bits // 8
        return COLUMNS * column + (0 if self.legacy else 2 * END)


_SINGLE = {
    "range0": (0, 19), "flags0": (19, 5), "reflectivity0": (32, 8), "signal0": (48, 16), "near_ir": (64, 16),
    "window": (88, 8),
}  # fmt: skip
_DUAL = {
    "range0": (0, 19), "flags0": (19, 5), "reflectivity0": (24, 8), "range1": (32, 19), "flags1": (51, 5),
    "reflectivity1": (56, 8), "signal0": (64, 16), "signal1": (80, 16), "near_ir": (96, 16), "window": (120, 8),
}  # fmt: skip
_LOW = {"range0": (0, 15), "flags0": (15, 1), "reflectivity0": (16, 8), "near_ir": (24, 8)}
_LOW_DUAL = _LOW | {"range1": (32, 15), "flags1": (47, 1), "reflectivity1": (48, 8), "window": (56, 8)}
_LEGACY = {"range0": (0, 20), "flags0": (28, 4), "reflectivity0": (32, 16), "signal0": (48, 16), "near_ir": (64, 16)}
PROFILES: Mapping[str, Profile] = {
    one.name: one
    for one in (
        Profile("LEGACY", 96, _LEGACY, since=(2, 0)),
        Profile("RNG19_RFL8_SIG16_NIR16", 96, _SINGLE),
        Profile("RNG19_RFL8_SIG16_NIR16_DUAL", 128, _DUAL, 2),
        Profile("RNG15_RFL8_NIR8", 32, _LOW, 1, 8),
        Profile("RNG15_RFL8_NIR8_DUAL", 64, _LOW_DUAL, 2, 8),
        Profile("FUSA_RNG15_RFL8_NIR8_DUAL", 64, _LOW_DUAL, 2, 8, (3, 1), fusa=True),
    )
}
"By the name that `udp_profile_lidar` has. No field crosses a word of 32 bits."


@lru_cache(maxsize=32)
def packet_type(name: str, rows: int) -> np.dtype[np.void]:
    """dtype of a packet; pixels are words of 32 bits."""
    profile = PROFILES[name]
    pixels = ("pixels", "<u4", (rows, profile.size_bits // 32))
    if profile.legacy:
        column = [("stamp", "<u8"), ("number", "<u2"), ("frame", "<u2"), ("encoder", "<u4"), pixels, ("status", "<u4")]
        return np.dtype([("columns", column, COLUMNS)])
    column = [("stamp", "<u8"), ("number", "<u2"), ("status", "<u2"), pixels]
    return np.dtype([("header", f"V{END}"), ("columns", column, COLUMNS), ("footer", f"V{END}")])


@dataclass(frozen=True)
class Head:
    """What headers and footers say beside numbers of frames."""

    serial: int
    init_id: int
    firmware: tuple[int, int] = (3, 1)
    fusa: bool = False
    alert_flags: int = 0
    shutdown_s: int = 0
    "Countdown to thermal shutdown; 0: none."
    limiting_s: int = 0
    "The same to shot limiting."
    shutdown: int = 0
    limiting: int = 0
    "0 normal, 1 imminent, 2..9 reduction."

    @cached_property
    def _around(self) -> tuple[bytes, bytes]:
        """What is before the number of the frame, but for the kind, and behind it."""
        serial, init_id = self.serial.to_bytes(5, "little"), self.init_id.to_bytes(3, "little")
        alert = self.alert_flags if self.firmware >= (2, 5) else 0
        counts = (self.shutdown_s, self.limiting_s, self.shutdown, self.limiting) if self.firmware >= (3, 0) else ()
        if self.fusa:
            return init_id, (bytes((alert, 0, 0)) + serial + bytes(counts)).ljust(END - 8, b"\0")
        return b"\0", (init_id + serial + bytes((alert, 0, 0, 0, *counts))).ljust(END - 4, b"\0")

    def header(self, kind: int, frame: int) -> bytes:
        """32 bytes."""
        before, behind = self._around
        number = frame.to_bytes(4, "little") if self.fusa else (frame & 0xFFFF).to_bytes(2, "little")
        return bytes((kind,)) + before + number + behind

    def check(self, before: bytes | memoryview) -> bytes:
        """The last 8 bytes of a footer; of firmware from 3.1 on the checksum of all `before` them."""
        if self.fusa or self.firmware < (2, 3):
            return bytes(8)
        return PLACEHOLDER if self.firmware < (3, 1) else crc64_xz(before).to_bytes(8, "little")


@dataclass(eq=False, slots=True)
class Others:
    """Second returns of the m pixels that have one; few do."""

    pixel: Words
    "(m,) of C H"
    range_mm: Words
    "In the unit of the first ones."
    reflectivity: Words
    signal: Words
    dark: int = 0
    "Signal of pixels without one."


@dataclass(eq=False, slots=True)
class Columns:
    """What columns say."""

    number: Words
    "(C,) of the frame, `measurement_id`; 16 follow each other"
    stamp_ns: Words
    "(C,)"
    valid: Bools
    "(C,) pixels of others are 0"
    range_mm: Words
    "(E, C, H) in `unit_mm`, 0: no return; of the first ones alone (1, C, H), with `others`"
    reflectivity: Words
    "(E, C, H)"
    signal: Words
    "(E, C, H) photons; of profiles that do not say them, anything"
    near_ir: Words
    "(C, H) photons"
    flags: Words | None = None
    "(E, C, H); bit 0: blooming; None: 0"
    window: int = 0
    others: Others | None = None
    unit_mm: int = 1
    "Of ranges."


class Room:
    """Packets of a slice, which those of the next one are written over; `turn`: columns of a turn."""

    def __init__(self, profile: Profile, rows: int, packets: int, turn: int) -> None:
        self.profile, self.turn = profile, turn
        self.packets = np.zeros(packets, packet_type(profile.name, rows))
        self.cells = self.packets["columns"]
        self.status, self.pixels = self.cells["status"], self.cells["pixels"]
        self.stamps, self.numbers = self.cells["stamp"], self.cells["number"]
        self.words = [self.pixels[..., at] for at in range(profile.size_bits // 32)]
        self.flat = self.packets.view("<u4")
        "All words of 32 bits; and where the first one of each pixel is there."
        self.words[0][...] = 1
        (self.first,) = np.nonzero(self.flat)
        size, bare = self.packets.itemsize, self.packets.view(np.uint8).data
        self.each = [bare[at * size : (at + 1) * size] for at in range(packets)]
        self.said = False
        "Its columns all are valid."
        self.same: list[int | None] = [None] * len(self.words)
        "What a word is of all pixels, but of these: those with a second return."
        self.but: list[Words] = [self.first[:0]] * len(self.words)


def encode(room: Room, head: Head, frame: int, columns: Columns) -> list[bytes]:
    """Lidar packets of a frame, all at once."""
    profile, shape = room.profile, room.status.shape
    every, legacy = np.count_nonzero(columns.valid) == columns.valid.size, profile.legacy
    room.stamps[...], room.numbers[...] = columns.stamp_ns.reshape(shape), columns.number.reshape(shape)
    few, unit = columns.others, profile.unit_mm // columns.unit_mm
    values: dict[str, Any] = {"near_ir": columns.near_ir, "window": np.uint32(columns.window)}
    if profile.near_ir_unit > 1 and columns.near_ir.ndim:
        values["near_ir"] = np.minimum(_in_units(columns.near_ir, profile.near_ir_unit), 0xFF)
    for one in range(min(profile.returns, len(columns.range_mm))):
        values[f"range{one}"] = _in_units(columns.range_mm[one], unit, unit // 2)
        values[f"reflectivity{one}"] = columns.reflectivity[one]
        values[f"signal{one}"] = columns.signal[one] if columns.signal.ndim else columns.signal
        if columns.flags is not None:
            values[f"flags{one}"] = columns.flags[one] & ((1 << profile.fields[f"flags{one}"][1]) - 1)
    if few is not None:
        values["signal1"] = np.uint32(few.dark)
    for at, (place, word) in enumerate(zip(room.words, _words(profile, values), strict=True)):
        if word.ndim:
            place[...], room.same[at] = word.reshape(place.shape), None
        elif room.same[at] != word:
            place[...], room.same[at] = word, int(word)
        elif len(room.but[at]):
            room.flat[room.but[at]] = word
        room.but[at] = room.first[:0]
    if few is not None and len(few.pixel):
        first = room.first[few.pixel]
        values = {"range1": _in_units(few.range_mm, unit, unit // 2), "reflectivity1": few.reflectivity}
        if few.signal.ndim:
            values["signal1"] = few.signal - np.uint32(few.dark)
        for at, word in enumerate(_words(profile, values)):
            if word.ndim:
                room.but[at] = places = first + at
                room.flat[places] += word
    if not every:
        room.pixels[~columns.valid.reshape(shape)] = 0
        room.same = [None] * len(room.words)
    if not every or not room.said:
        room.status[...] = (columns.valid * np.uint32(0xFFFFFFFF if legacy else 1)).reshape(shape)
        room.said = every
    if legacy:
        room.cells["frame"] = frame & 0xFFFF
        room.cells["encoder"] = (columns.number * ENCODER_TICKS // room.turn).reshape(shape)
        return [one.tobytes() for one in room.each]
    header = head.header(LIDAR, frame)
    for packet in room.each:
        packet[:END] = header
        packet[-8:] = head.check(packet[:-8])
    return [one.tobytes() for one in room.each]


def _words(profile: Profile, values: Mapping[str, Any]) -> list[Any]:
    """Words of pixels by fields that do not overlap; those that it has not are left out."""
    words: list[Any] = [ZERO] * (profile.size_bits // 32)
    places = profile.places
    for name, value in values.items():
        if name in places and (value.ndim or value):
            word, shift = places[name]
            part, held = value.astype(np.uint32, copy=False), words[word]
            part = part << shift if shift else part
            words[word] = part if held is ZERO else held | part
    return words


def _in_units(values: Words, unit: int, more: int = 0) -> Words:
    """Whole units, a power of two, in values and so much `more`."""
    return values if unit == 1 else (values + more) >> (unit.bit_length() - 1)


@dataclass(frozen=True, eq=False)
class Said:
    """What lidar packets say."""

    frame: Words
    "(P,)"
    init_id: int
    serial: int
    columns: Columns


def decode(profile: Profile, rows: int, data: bytes, fusa: bool = False) -> Said:
    """Packets of one profile, joined; `fusa`: with the header for functional safety."""
    packets = np.frombuffer(data, packet_type(profile.name, rows))
    cells = packets["columns"]
    pixels = cells["pixels"].reshape(len(packets) * COLUMNS, rows, -1)

    def field(name: str) -> Words:
        if name not in profile.fields:
            return np.zeros(pixels.shape[:2], np.int64)
        (word, shift), width = divmod(profile.fields[name][0], 32), profile.fields[name][1]
        return (pixels[..., word] >> np.uint32(shift) & np.uint32((1 << width) - 1)).astype(np.int64)

    def fields(name: str) -> Words:
        return np.stack([field(f"{name}{one}") for one in range(profile.returns)])

    columns = Columns(
        cells["number"].astype(np.int64).ravel(), cells["stamp"].astype(np.int64).ravel(),
        (cells["status"] & 1).astype(bool).ravel(), fields("range") * profile.unit_mm, fields("reflectivity"),
        fields("signal"), field("near_ir") * profile.near_ir_unit, fields("flags"),
    )  # fmt: skip
    if profile.legacy:
        return Said(cells["frame"][:, 0].astype(np.int64), 0, 0, columns)
    heads = [one.tobytes() for one in packets["header"]]
    if fusa or profile.fusa:
        frames, init_id, serial = [int.from_bytes(one[4:8], "little") for one in heads], heads[0][1:4], heads[0][11:16]
    else:
        frames, init_id, serial = [int.from_bytes(one[2:4], "little") for one in heads], heads[0][4:7], heads[0][7:12]
    return Said(np.array(frames), int.from_bytes(init_id, "little"), int.from_bytes(serial, "little"), columns)


def distances(range_m: Floats, offset_m: float, profile: Profile) -> Words:
    """Ranges from the lidar's axis along the beam; what the wire cannot say is no return. [mm]"""
    return in_steps(range_m, offset_m, profile) * np.uint32(profile.unit_mm)


def in_steps(range_m: Floats, offset_m: float, profile: Profile) -> Words:
    """The same in the profile's unit."""
    words = range_m + offset_m
    words *= 1000.0 / profile.unit_mm
    found, longest = whole(words), profile.longest_mm // profile.unit_mm
    if len(found) and np.maximum.reduce(found) > longest:
        found[found > longest] = 0
    return found


IMU_LEGACY = struct.Struct("<QQQ6f")
IMU_RECORD = np.dtype([("stamp", "<u8"), ("number", "<u2"), ("status", "<u2"), ("force", "<f4", 3), ("rate", "<f4", 3)])
IMU_FIRST, SENTENCE_BYTES = 132, 85


def encode_imu(head: Head, frame: int, nmea_ns: int, sentence: bytes, records: NDArray[np.void]) -> bytes:
    """A packet of ACCEL32_GYRO32_NMEA."""
    middle = struct.pack("<Q", nmea_ns) + sentence[:SENTENCE_BYTES].ljust(IMU_FIRST - END - 8, b"\0")
    before = head.header(IMU, frame) + middle + records.tobytes() + bytes(END - 8)
    return before + head.check(before)
