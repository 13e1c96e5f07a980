"""Ouster's datagrams: lidar packets of 16 columns in all profiles, and IMU packets, many at once as arrays.

Belongs here: bytes, rounding, and the words for no return. Not: when a column fires and where it looks.
Little-endian. Arrays of P packets, C = 16 P columns, H rows, E returns.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from protocols.checksums import crc64_xz
from protocols.scan import Floats, Scan

Words = NDArray[np.int64]
Bools = NDArray[np.bool_]
COLUMNS = 16
"Of a packet."
END = 32
"Bytes of a header, and of a footer."
ENCODER_TICKS = 90_112
RETRO = 1000.0
"Reflectivity over that of a white plate that is reported as 255; ours, no source states the logarithm's end."
PLACEHOLDER = bytes.fromhex("dec00000efbeadde")
"In place of a checksum, firmware 2.3 to 3.0."
LIDAR, IMU = 1, 2


@dataclass(frozen=True)
class Profile:
    """One form of lidar packets."""

    name: str
    pixel: Any
    "dtype; names end with the number of the return."
    returns: int = 1
    unit_mm: int = 1
    range_bits: int = 19
    since: tuple[int, int] = (2, 2)
    fusa: bool = False
    "It always has the header for functional safety."

    @property
    def legacy(self) -> bool:
        """Without header and footer."""
        return self.name == "LEGACY"

    @property
    def longest_mm(self) -> int:
        """What a range can be."""
        return ((1 << self.range_bits) - 1) * self.unit_mm

    def size(self, rows: int) -> int:
        """Bytes of a packet."""
        column = (20 if self.legacy else 12) + rows * int(np.dtype(self.pixel).itemsize)
        return COLUMNS * column + (0 if self.legacy else 2 * END)


def _at(size: int, **fields: tuple[int, str]) -> dict[str, Any]:
    names, places = list(fields), list(fields.values())
    return {
        "names": names, "offsets": [one for one, _ in places], "formats": [one for _, one in places], "itemsize": size,
    }  # fmt: skip


_LOW = {"range0": (0, "<u2"), "reflectivity0": (2, "u1"), "near_ir8": (3, "u1")}
_LOW_DUAL = _at(8, **_LOW, range1=(4, "<u2"), reflectivity1=(6, "u1"), window=(7, "u1"))
PROFILES: Mapping[str, Profile] = {
    one.name: one
    for one in (
        Profile(
            "LEGACY",
            _at(12, range0=(0, "<u4"), reflectivity0=(4, "<u2"), signal0=(6, "<u2"), near_ir=(8, "<u2")),
            range_bits=20, since=(2, 0),
        ),
        Profile(
            "RNG19_RFL8_SIG16_NIR16",
            _at(12, range0=(0, "<u4"), reflectivity0=(4, "u1"), signal0=(6, "<u2"), near_ir=(8, "<u2"),
                window=(11, "u1")),
        ),
        Profile(
            "RNG19_RFL8_SIG16_NIR16_DUAL",
            _at(16, range0=(0, "<u4"), reflectivity0=(3, "u1"), range1=(4, "<u4"), reflectivity1=(7, "u1"),
                signal0=(8, "<u2"), signal1=(10, "<u2"), near_ir=(12, "<u2"), window=(15, "u1")),
            returns=2,
        ),
        Profile("RNG15_RFL8_NIR8", _at(4, **_LOW), unit_mm=8, range_bits=15),
        Profile("RNG15_RFL8_NIR8_DUAL", _LOW_DUAL, returns=2, unit_mm=8, range_bits=15),
        Profile("FUSA_RNG15_RFL8_NIR8_DUAL", _LOW_DUAL, returns=2, unit_mm=8, range_bits=15, since=(3, 1), fusa=True),
    )
}  # fmt: skip
"By the name that `udp_profile_lidar` has."


@lru_cache(maxsize=32)
def packet_type(name: str, rows: int) -> np.dtype[np.void]:
    """dtype of a packet."""
    profile = PROFILES[name]
    pixels = ("pixels", profile.pixel, rows)
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

    def header(self, kind: int, frame: int) -> bytes:
        """32 bytes."""
        serial, init_id = self.serial.to_bytes(5, "little"), self.init_id.to_bytes(3, "little")
        alert = self.alert_flags if self.firmware >= (2, 5) else 0
        if self.fusa:
            first = bytes((kind,)) + init_id + frame.to_bytes(4, "little") + bytes((alert, 0, 0)) + serial
        else:
            first = struct.pack("<HH", kind, frame & 0xFFFF) + init_id + serial + bytes((alert, 0, 0, 0))
        counts = (self.shutdown_s, self.limiting_s, self.shutdown, self.limiting) if self.firmware >= (3, 0) else ()
        return (first + bytes(counts)).ljust(END, b"\0")

    def check(self, before: bytes | memoryview) -> bytes:
        """The last 8 bytes of a footer; of firmware from 3.1 on the checksum of all `before` them."""
        if self.fusa or self.firmware < (2, 3):
            return bytes(8)
        return PLACEHOLDER if self.firmware < (3, 1) else crc64_xz(before).to_bytes(8, "little")


@dataclass(frozen=True, eq=False)
class Columns:
    """What columns say."""

    number: Words
    "(C,) of the frame, `measurement_id`; 16 follow each other"
    stamp_ns: Words
    "(C,)"
    valid: Bools
    "(C,) pixels of others are 0"
    range_mm: Words
    "(E, C, H) 0: no return"
    reflectivity: Words
    "(E, C, H)"
    signal: Words
    "(E, C, H) photons"
    near_ir: Words
    "(C, H) photons"
    flags: Words = field(default_factory=lambda: np.zeros((), np.int64))
    "(E, C, H) or 0; bit 0: blooming"
    window: int = 0


def encode(profile: Profile, head: Head, frames: Words, columns: Columns, turn: int) -> list[bytes]:
    """Lidar packets, all at once. `frames` (P,) numbers of their frames, `turn`: columns of a turn."""
    rows = columns.range_mm.shape[2]
    packets = np.zeros(len(frames), packet_type(profile.name, rows))
    cells, shape = packets["columns"], (len(frames), COLUMNS)
    cells["stamp"], cells["number"] = columns.stamp_ns.reshape(shape), columns.number.reshape(shape)
    pixels, grid = cells["pixels"], (len(frames), COLUMNS, rows)
    names = pixels.dtype.names or ()
    ranges = np.rint(columns.range_mm / profile.unit_mm).astype(np.int64) if profile.unit_mm > 1 else columns.range_mm
    if columns.flags.any():
        flags = np.broadcast_to(columns.flags, columns.range_mm.shape)
        mark = 28 if profile.legacy else profile.range_bits
        ranges = ranges | (flags if profile.unit_mm == 1 else flags & 1) << mark
    for one in range(profile.returns):
        pixels[f"range{one}"] = ranges[one].reshape(grid)  # before what shares its bytes
        pixels[f"reflectivity{one}"] = columns.reflectivity[one].reshape(grid)
        if f"signal{one}" in names:
            pixels[f"signal{one}"] = columns.signal[one].reshape(grid)
    if "near_ir8" in names:
        pixels["near_ir8"] = np.minimum(columns.near_ir // 16, 255).reshape(grid)
    else:
        pixels["near_ir"] = columns.near_ir.reshape(grid)
    if columns.window and "window" in names:
        pixels["window"] = columns.window
    if not columns.valid.all():
        pixels[~columns.valid.reshape(shape)] = np.zeros((), pixels.dtype)
    if profile.legacy:
        cells["status"] = np.where(columns.valid, 0xFFFFFFFF, 0).reshape(shape)
        cells["frame"] = frames[:, None] & 0xFFFF
        cells["encoder"] = cells["number"].astype(np.int64) * ENCODER_TICKS // turn
        return [one.tobytes() for one in packets]
    cells["status"] = columns.valid.reshape(shape)
    made = []
    for packet, frame in zip(packets.view(np.uint8).reshape(len(frames), -1), frames.tolist(), strict=True):
        packet[:END] = np.frombuffer(head.header(LIDAR, frame), np.uint8)
        packet[-8:] = np.frombuffer(head.check(packet[:-8].data), np.uint8)
        made.append(packet.tobytes())
    return made


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
    pixels = cells["pixels"].reshape(-1, rows)
    mask, mark = (1 << profile.range_bits) - 1, 28 if profile.legacy else profile.range_bits
    words = np.stack([pixels[f"range{one}"].astype(np.int64) for one in range(profile.returns)])
    bright = np.stack([pixels[f"reflectivity{one}"].astype(np.int64) for one in range(profile.returns)])
    has = [pixels[f"signal{one}"].astype(np.int64) for one in range(profile.returns) if profile.unit_mm == 1]
    near = pixels["near_ir"].astype(np.int64) if profile.unit_mm == 1 else pixels["near_ir8"].astype(np.int64) * 16
    flags = words >> mark & (31 if profile.unit_mm == 1 else 1)
    columns = Columns(
        cells["number"].astype(np.int64).ravel(), cells["stamp"].astype(np.int64).ravel(),
        (cells["status"] & 1).astype(bool).ravel(), (words & mask) * profile.unit_mm, bright,
        np.stack(has) if has else np.zeros_like(words), near, flags,
    )  # fmt: skip
    if profile.legacy:
        return Said(cells["frame"][:, 0].astype(np.int64), 0, 0, columns)
    heads = [one.tobytes() for one in packets["header"]]
    if fusa or profile.fusa:
        frames, init_id, serial = [int.from_bytes(one[4:8], "little") for one in heads], heads[0][1:4], heads[0][11:16]
    else:
        frames, init_id, serial = [int.from_bytes(one[2:4], "little") for one in heads], heads[0][4:7], heads[0][7:12]
    return Said(np.array(frames), int.from_bytes(init_id, "little"), int.from_bytes(serial, "little"), columns)


def returns(scan: Scan, count: int, order: str, near_m: float) -> tuple[Floats, Floats]:
    """Range and intensity (E, n) of the returns that a profile reports, in their order; NaN: none.

    Of more echoes than `count` the strongest; of one return that which `order` puts first. Nearer than `near_m`: none.
    """
    there = np.ascontiguousarray(scan.range_m.T >= near_m)  # (echoes, n): sums over rows of four are slow
    some = np.flatnonzero(there.any(axis=1))
    found = np.full((2, count, len(scan.range_m)), np.nan)
    if not len(some):
        return found[0], found[1]
    for words, said in zip(found, (scan.range_m, scan.intensity), strict=True):
        np.copyto(words[0], said[:, some[0]], where=there[some[0]])
    several = np.flatnonzero(there[some[1:]].any(axis=0))  # the others have at most the echo in front
    if len(several):
        at = several[:, None], some
        range_m, strength = (np.where(there.T[at], one[at], np.nan) for one in (scan.range_m, scan.intensity))
        range_m, strength = _chosen(range_m, strength, count, order)
        found[0][: range_m.shape[1], several], found[1][: range_m.shape[1], several] = range_m.T, strength.T
    return found[0], found[1]


def _chosen(range_m: Floats, strength: Floats, count: int, order: str) -> tuple[Floats, Floats]:
    """(m, at most `count`) of beams with several echoes."""
    ordered = order in ("NEAREST_TO_FARTHEST", "FARTHEST_TO_NEAREST")
    if not ordered or range_m.shape[1] > count > 1:
        range_m, strength = _sorted(-strength, range_m, strength)
    if count > 1:
        range_m, strength = range_m[:, :count], strength[:, :count]
    if ordered:
        key = range_m if order == "NEAREST_TO_FARTHEST" else -range_m
        range_m, strength = _sorted(key, range_m, strength)
    return range_m[:, :count], strength[:, :count]


def _sorted(key: Floats, *values: Floats) -> tuple[Floats, Floats]:
    at = np.argsort(np.where(np.isnan(key), np.inf, key), axis=1, kind="stable")
    first, second = (np.take_along_axis(one, at, axis=1) for one in values)
    return first, second


def distances(range_m: Floats, offset_m: float, profile: Profile) -> Words:
    """Ranges from the lidar's axis along the beam; what the wire cannot say is no return. [mm]"""
    words = np.rint((range_m + offset_m) * (1000.0 / profile.unit_mm)) * profile.unit_mm
    return np.where((words > 0.0) & (words <= profile.longest_mm), words, 0.0).astype(np.int64)


def reflectivities(range_m: Floats, intensity: Floats, white_m2: float) -> Words:
    """Calibrated reflectivity: 0..100 as a diffuse plate seen straight, 101..255 by the logarithm beyond; 0: none.

    intensity over the threshold; its decrease with the distance is removed, that with air and incidence is not.
    """
    over_white = intensity * range_m * range_m / white_m2
    bright = 100.0 * over_white
    beyond = np.nonzero(over_white > 1.0)
    bright[beyond] = np.clip(100.0 + 155.0 * np.log(over_white[beyond]) / np.log(RETRO), 101.0, 255.0)
    return np.where(np.isnan(bright), 0.0, np.rint(bright)).astype(np.int64)


IMU_LEGACY = struct.Struct("<QQQ6f")
IMU_RECORD = np.dtype([("stamp", "<u8"), ("number", "<u2"), ("status", "<u2"), ("force", "<f4", 3), ("rate", "<f4", 3)])
IMU_FIRST, SENTENCE_BYTES = 132, 85


def encode_imu(head: Head, frame: int, nmea_ns: int, sentence: bytes, records: NDArray[np.void]) -> bytes:
    """A packet of ACCEL32_GYRO32_NMEA."""
    middle = struct.pack("<Q", nmea_ns) + sentence[:SENTENCE_BYTES].ljust(IMU_FIRST - END - 8, b"\0")
    before = head.header(IMU, frame) + middle + records.tobytes() + bytes(END - 8)
    return before + head.check(before)
