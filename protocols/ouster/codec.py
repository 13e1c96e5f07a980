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

Words = NDArray[Any]
"Whole numbers."
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

    @property
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
    "(E, C, H), or one 0; bit 0: blooming"
    window: int = 0


def encode(profile: Profile, head: Head, frames: Words, columns: Columns, turn: int) -> list[bytes]:
    """Lidar packets, all at once. `frames` (P,) numbers of their frames, `turn`: columns of a turn."""
    rows, shape = columns.range_mm.shape[2], (len(frames), COLUMNS)
    packets = np.zeros(len(frames), packet_type(profile.name, rows))
    cells = packets["columns"]
    cells["stamp"], cells["number"] = columns.stamp_ns.reshape(shape), columns.number.reshape(shape)
    values: dict[str, Any] = {"near_ir": _in_units(columns.near_ir, profile.near_ir_unit, 0xFF)}
    flags = columns.flags if columns.flags.ndim and columns.flags.any() else None
    for one in range(profile.returns):
        values[f"range{one}"] = _in_units(columns.range_mm[one], profile.unit_mm)
        values[f"reflectivity{one}"], values[f"signal{one}"] = columns.reflectivity[one], columns.signal[one]
        if flags is not None:
            values[f"flags{one}"] = flags[one] & ((1 << profile.fields[f"flags{one}"][1]) - 1)
    if columns.window:
        values["window"] = np.uint32(columns.window)
    words: list[Any] = [None] * (profile.size_bits // 32)
    for name, (bit, _) in profile.fields.items():
        if name in values:
            word, shift = divmod(bit, 32)
            part = values[name].astype(np.uint32, copy=False)
            part = part << np.uint32(shift) if shift else part
            words[word] = part if words[word] is None else words[word] | part
    for at, word in enumerate(words):
        cells["pixels"][..., at] = word.reshape(*shape, rows)
    if not columns.valid.all():
        cells["pixels"][~columns.valid.reshape(shape)] = 0
    if profile.legacy:
        cells["status"] = np.where(columns.valid, 0xFFFFFFFF, 0).reshape(shape)
        cells["frame"] = frames[:, None] & 0xFFFF
        cells["encoder"] = cells["number"].astype(np.int64) * ENCODER_TICKS // turn
        return [one.tobytes() for one in packets]
    cells["status"] = columns.valid.reshape(shape)
    made, headers = [], {frame: np.frombuffer(head.header(LIDAR, frame), np.uint8) for frame in set(frames.tolist())}
    for packet, frame in zip(packets.view(np.uint8).reshape(len(frames), -1), frames.tolist(), strict=True):
        packet[:END] = headers[frame]
        packet[-8:] = np.frombuffer(head.check(packet[:-8].data), np.uint8)
        made.append(packet.tobytes())
    return made


def _in_units(values: Words, unit: int, most: int = 0) -> Words:
    """Whole units: of a range the nearest, of photons those that are full, `most` at most."""
    if unit == 1:
        return values
    return np.minimum(values // unit, most) if most else (values + unit // 2) // unit


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


def returns(scan: Scan, count: int, order: str, near_m: float) -> tuple[Words, Floats, Floats]:
    """Places (m,) in (E, n) of the returns that a profile reports, in their order; their range and intensity.

    Of more echoes than `count` the strongest; of one return that which `order` puts first. Nearer than `near_m`: none.
    """
    there = np.flatnonzero(scan.range_m >= near_m)
    beams, echoes = scan.range_m.shape
    place = there // echoes  # of the first return: the number of the beam
    range_m, strength = scan.range_m.reshape(-1)[there], scan.intensity.reshape(-1)[there]
    same = place[1:] == place[:-1]
    if not same.any():
        return place, range_m, strength
    several = np.flatnonzero(np.append(same, False) | np.append(False, same))
    sign = {"NEAREST_TO_FARTHEST": 1.0, "FARTHEST_TO_NEAREST": -1.0}.get(order)
    beam, rank = place[several], np.zeros(len(several), np.intp)
    if sign is None or count > 1:
        rank = _ranks(beam, -strength[several])
    kept = rank < count
    if sign is not None:
        rank[kept] = _ranks(beam[kept], sign * range_m[several][kept])
        kept &= rank < count
    place[several] = np.where(kept, rank * beams + beam, -1)
    reported = place >= 0
    return place[reported], range_m[reported], strength[reported]


def _ranks(beam: Words, key: Floats) -> Words:
    """Of each echo among those of its beam, the one with the least key first; beams ascend."""
    at = np.lexsort((key, beam))
    ranks = np.zeros(len(at), np.intp)
    ranks[at] = np.arange(len(at)) - np.searchsorted(beam, beam[at])
    return ranks


def distances(range_m: Floats, offset_m: float, profile: Profile) -> Words:
    """Ranges from the lidar's axis along the beam; what the wire cannot say is no return. [mm]"""
    words = np.rint((range_m + offset_m) * (1000.0 / profile.unit_mm))
    words *= words <= profile.longest_mm // profile.unit_mm
    return words.astype(np.uint32) * np.uint32(profile.unit_mm)


def reflectivities(range_m: Floats, intensity: Floats, white_m2: float) -> Words:
    """Calibrated reflectivity: 0..100 as a diffuse plate seen straight, 101..255 by the logarithm beyond.

    intensity over the threshold; its decrease with the distance is removed, that with air and incidence is not.
    """
    bright = (100.0 / white_m2) * intensity * range_m * range_m
    beyond = np.flatnonzero(bright > 100.0)
    brighter = np.log(0.01 * bright[beyond]) / np.log(RETRO)
    bright[beyond] = np.minimum(np.maximum(100.0 + 155.0 * brighter, 101.0), 255.0)
    return np.rint(bright).astype(np.uint32)


IMU_LEGACY = struct.Struct("<QQQ6f")
IMU_RECORD = np.dtype([("stamp", "<u8"), ("number", "<u2"), ("status", "<u2"), ("force", "<f4", 3), ("rate", "<f4", 3)])
IMU_FIRST, SENTENCE_BYTES = 132, 85


def encode_imu(head: Head, frame: int, nmea_ns: int, sentence: bytes, records: NDArray[np.void]) -> bytes:
    """A packet of ACCEL32_GYRO32_NMEA."""
    middle = struct.pack("<Q", nmea_ns) + sentence[:SENTENCE_BYTES].ljust(IMU_FIRST - END - 8, b"\0")
    before = head.header(IMU, frame) + middle + records.tobytes() + bytes(END - 8)
    return before + head.check(before)
