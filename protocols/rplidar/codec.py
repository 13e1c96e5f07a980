"""RPLIDAR on the wire: requests, descriptors, and the six forms of measured data bit by bit; whole arrays at a time.

Belongs here: bytes and numbers. Not: what a request means (commands), which samples are sent when (device).
Angles are the device's own: clockwise seen from above, in degrees. Distances are in mm, 0: no return.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from protocols.checksums import xor8
from protocols.skeleton.descriptors import SYNC, descriptor

Words = NDArray[np.int64]
Floats = NDArray[np.float64]
Bytes = NDArray[np.uint8]

STANDARD, EXPRESS, HQ, ULTRA, DENSE, ULTRA_DENSE = 0x81, 0x82, 0x83, 0x84, 0x85, 0x86
NONE_OF_ULTRA = -512
BEAM_OFFSET_MM, BEAM_ANGLE_DEG, NEAREST_MM = 24.01, 8.0, 50.0
"Of the line of sight of triangulating models: its distance from the axis, its angle (sl_lidar_driver.cpp)."
CODES, STARTS_MM = np.array([0, 512, 1280, 1792, 3328]), np.array([0, 512, 2048, 4096, 16384])
"Of an ultra capsule's major, by level: the level is the shift too."
MOST_CODE = 4095


def request(code: int, payload: bytes = b"") -> bytes:
    """A host's request; codes from 0x80 on have a payload."""
    if code < 0x80:
        return bytes((SYNC, code))
    text = bytes((SYNC, code, len(payload))) + payload
    return text + bytes((xor8(text),))


@dataclass(frozen=True, eq=False)
class Samples:
    """Consecutive samples of a stream, (n,) each."""

    angle_deg: Floats
    "0 to 360, of the rotor."
    mm: Floats
    "0: no return."
    quality: Words
    "0..255"
    starts: NDArray[np.bool_]
    "The first of a turn."
    stamp_us: Floats

    def part(self, first: int, end: int | None = None) -> Samples:
        """Those from `first` to before `end`."""
        return Samples(*(column[first:end] for column in vars(self).values()))

    def then(self, other: Samples) -> Samples:
        """Both, one behind the other."""
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        return Samples(*(np.concatenate(pair) for pair in pairs))

    def __len__(self) -> int:
        return len(self.mm)


def _halves(words: Words) -> Bytes:
    """(..., n) numbers of 16 bits as (..., 2 n) bytes."""
    return words.astype("<u2").view(np.uint8)


def _capsules(first_deg: Floats, restart: bool, body: Bytes, before: Bytes | None = None) -> Bytes:
    """(c, bytes) with sync nibbles, sum and start angle; `restart`: the flag of the first."""
    angle = np.floor(first_deg * 64.0).astype(np.int64) % 23040
    angle[:1] |= 0x8000 * restart
    parts = [_halves(angle[:, None]), body] if before is None else [before, _halves(angle[:, None]), body]
    rest = np.concatenate(parts, axis=1)
    total = np.bitwise_xor.reduce(rest, axis=1)
    head = np.stack([0xA0 | total & 0x0F, 0x50 | total >> 4], axis=1)
    return np.concatenate([head, rest], axis=1)


def standard(samples: Samples, restart: bool) -> Bytes:
    """(n, 5): nodes with their own angle and start flag."""
    angle = np.floor(samples.angle_deg * 64.0).astype(np.int64) % 23040 << 1 | 1
    quarter = np.rint(4.0 * samples.mm).astype(np.int64)
    quarter = np.where(quarter <= 0xFFFF, quarter, 0)
    first = np.where(samples.starts, 1, 2) | samples.quality & 0xFC
    body = _halves(np.stack([angle, quarter], axis=1))
    return np.concatenate([first.astype(np.uint8)[:, None], body], axis=1)


def _mm(samples: Samples, most: int) -> Words:
    found = np.rint(samples.mm).astype(np.int64)
    return np.where(found <= most, found, 0)


def express(samples: Samples, restart: bool) -> Bytes:
    """(c, 84) of 32 samples each; the offsets of angles are 0, as the start angles are true."""
    word = _halves(_mm(samples, 0x3FFF).reshape(-1, 16, 2) << 2)
    body = np.concatenate([word, np.zeros((*word.shape[:2], 1), np.uint8)], axis=2)
    return _capsules(samples.angle_deg[::32], restart, body.reshape(-1, 80))


def dense(samples: Samples, restart: bool) -> Bytes:
    """(c, 84) of 40 samples each."""
    return _capsules(samples.angle_deg[::40], restart, _halves(_mm(samples, 0xFFFF).reshape(-1, 40)))


def major_of(mm: Words) -> Words:
    """Code of a distance in 12 bits; what is too far is 0."""
    level = np.searchsorted(STARTS_MM, mm, side="right") - 1
    code = CODES[level] + (mm - STARTS_MM[level] >> level)
    return np.where(code <= MOST_CODE, code, 0)


def distance_of(code: Words) -> tuple[Words, Words]:
    """Distance in mm and level of a code."""
    level = np.searchsorted(CODES, code, side="right") - 1
    return STARTS_MM[level] + (code - CODES[level] << level), level


def ultra(samples: Samples, restart: bool) -> Bytes:
    """(c, 132) of 96 samples each; one sample more, the next capsule's first, is the base of the last predictions."""
    mm = np.rint(samples.mm).astype(np.int64)
    major = major_of(mm[::3])
    base, level = distance_of(major)
    this, nxt, groups = slice(None, -1), slice(1, None), mm[:-1].reshape(-1, 3)
    lacks = (major[this] == 0) & (major[nxt] != 0)
    base1, level1 = np.where(lacks, base[nxt], base[this]), np.where(lacks, level[nxt], level[this])
    words = [major[this]]
    for at, b, shift in ((1, base1, level1), (2, base[nxt], level[nxt])):
        guess = groups[:, at] - b + (1 << shift >> 1) >> shift
        fits = (groups[:, at] > 0) & (guess > NONE_OF_ULTRA) & (guess < 511)
        words.append(np.where(fits, guess, NONE_OF_ULTRA) & 0x3FF)
    return ultra_capsules(samples.angle_deg[:-1:96], words[2] << 22 | words[1] << 12 | words[0], restart)


def ultra_capsules(first_deg: Floats, words: Words, restart: bool) -> Bytes:
    """(c, 132) of start angles (c,) and words (32 c,)."""
    return _capsules(first_deg, restart, words.astype("<u4").view(np.uint8).reshape(-1, 128))


SCALES = ((0, 2, 0, 10, 0), (2046, 3, 1, 11, 1), (8187, 4, 2, 12, 2), (24567, 5, 3, 13, 3))
"Of an ultra dense sample: from mm, mm per count, scale, bits of the count, bits of quality that are lost."


def ultra_dense(samples: Samples, restart: bool) -> Bytes:
    """(c, 170) of 64 samples each."""
    mm, quality = np.rint(samples.mm).astype(np.int64), samples.quality
    scale = np.searchsorted([start for start, *_ in SCALES], mm, side="right") - 1
    words = [quality >> lost << bits + 2 | (mm - start) // step << 2 | s for start, step, s, bits, lost in SCALES]
    word = np.choose(scale, words)
    word = np.where((mm > 0) & (mm < 24567 + 5 * 8192), word & 0xFFFFF, 0).reshape(-1, 32, 2)
    high = word >> 16
    body = np.concatenate([_halves(word & 0xFFFF), (high[..., :1] | high[..., 1:] << 4).astype(np.uint8)], axis=2)
    stamp = (samples.stamp_us[::64].astype(np.int64) & 0xFFFFFFFF).astype("<u4")[:, None].view(np.uint8)
    before = np.concatenate([stamp, np.zeros((len(stamp), 2), np.uint8)], axis=1)
    return _capsules(samples.angle_deg[::64], restart, body.reshape(-1, 160), before)


HQ_NODE = np.dtype([("angle", "<u2"), ("quarter", "<u4"), ("quality", "u1"), ("flag", "u1")])


def hq(samples: Samples, restart: bool) -> Bytes:
    """(c, 781) of 96 samples each, with a CRC of the block filled up to a multiple of four."""
    node = np.zeros(len(samples), HQ_NODE)
    node["angle"] = np.floor(samples.angle_deg * (16384 / 90)).astype(np.int64) % 0x10000
    node["quarter"] = np.rint(4.0 * samples.mm)
    node["quality"], node["flag"] = samples.quality, np.where(samples.starts, 1, 2)
    body = node.view(np.uint8).reshape(-1, 96 * HQ_NODE.itemsize)
    stamp = samples.stamp_us[::96].astype("<u8")[:, None].view(np.uint8)
    whole = np.concatenate([np.full((len(body), 1), SYNC, np.uint8), stamp, body], axis=1)
    sums = [struct.pack("<I", zlib.crc32(row.tobytes() + bytes(3))) for row in whole]
    return np.concatenate([whole, np.frombuffer(b"".join(sums), np.uint8).reshape(-1, 4)], axis=1)


@dataclass(frozen=True)
class Form:
    """One form of measured data."""

    kind: int
    samples: int
    "Of a group."
    size: int
    "Bytes of a group."
    encode: Callable[[Samples, bool], Bytes]
    "(samples of whole groups, whether the first starts a stream) -> (groups, size)"
    further: int = 0
    "Samples behind a group that it needs."
    turned: bool = False
    "The host subtracts the angle between rotor and line of sight."

    @property
    def descriptor(self) -> bytes:
        """Sent once, before the groups."""
        return descriptor(self.kind, self.size, multiple=True)


FORMS: Mapping[int, Form] = {
    form.kind: form
    for form in (
        Form(STANDARD, 1, 5, standard),
        Form(EXPRESS, 32, 84, express),
        Form(HQ, 96, 781, hq),
        Form(ULTRA, 96, 132, ultra, further=1, turned=True),
        Form(DENSE, 40, 84, dense),
        Form(ULTRA_DENSE, 64, 170, ultra_dense),
    )
}


def line_of_sight_deg(mm: Floats) -> Floats:
    """Angle by which the line of sight to a target lags behind the rotor, target's distance from the axis in mm."""
    far = np.maximum(mm, NEAREST_MM)
    return np.where(mm < NEAREST_MM, 7.5, BEAM_ANGLE_DEG - np.degrees(np.arcsin(BEAM_OFFSET_MM / far)))
