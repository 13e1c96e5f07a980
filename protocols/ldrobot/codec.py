"""LDROBOT's packets: twelve samples, start and end angle, speed, time stamp, CRC.

Belongs here: bytes and numbers. Not: when a packet is sent (the device), reading packets (`emulator.hosts.ldrobot`).
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from protocols.scan import Floats

SAMPLES = 12
HEAD = b"\x54\x2c"
"Start, and type 1 with 12 samples."
POLYNOMIAL = 0x4D
STAMP_MS = 30_000
"The time stamp counts ms from 0 to one less."
TURN_CDEG = 36_000
PACKET = np.dtype(
    [
        ("head", "S2"), ("speed", "<u2"), ("start", "<u2"),
        ("samples", np.dtype([("mm", "<u2"), ("intensity", "u1")]), SAMPLES),
        ("end", "<u2"), ("stamp", "<u2"), ("crc", "u1"),
    ]
)  # fmt: skip
SIZE = PACKET.itemsize


@lru_cache(maxsize=1)
def _places() -> NDArray[np.uint8]:
    """Entry [k, b]: what byte b at place k of a packet adds to its CRC, which is linear; (46, 256)."""
    step: NDArray[np.int64] = np.arange(256, dtype=np.int64)
    for _ in range(8):
        step = (step << 1) ^ np.where(step & 0x80, POLYNOMIAL | 0x100, 0)
    table = np.zeros((SIZE - 1, 256), np.uint8)
    table[-1] = step
    for place in range(SIZE - 3, -1, -1):
        table[place] = step[table[place + 1]]
    table.setflags(write=False)
    return table


def crc8(packets: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """CRC of packets without their last byte, (p, 46) -> (p,); start 0, not reflected."""
    return np.asarray(np.bitwise_xor.reduce(_places()[np.arange(SIZE - 1), packets], axis=1), np.uint8)


def encode_packets(
    speed_dps: int, angle_deg: Floats, range_m: Floats, intensity: Floats, stamp_ms: NDArray[Any], most_m: float
) -> list[bytes]:
    """Packets of whole groups of twelve samples.

    angle_deg, range_m (NaN: no echo), intensity (0..255) (12 p,); stamp_ms (p,). Farther than `most_m` is no echo.
    """
    packets = np.zeros(len(angle_deg) // SAMPLES, PACKET)
    packets["head"], packets["speed"] = HEAD, min(speed_dps, 0xFFFF)
    cdeg = np.rint(100.0 * angle_deg).astype(np.int64).reshape(-1, SAMPLES) % TURN_CDEG
    packets["start"], packets["end"], packets["stamp"] = cdeg[:, 0], cdeg[:, -1], stamp_ms % STAMP_MS
    good = (range_m > 0.0) & (range_m <= most_m)  # false for NaN
    words = np.where(good, np.clip(np.nan_to_num(np.rint(1000.0 * range_m)), 1, 0xFFFF), 0)
    packets["samples"]["mm"] = words.reshape(-1, SAMPLES)
    packets["samples"]["intensity"] = np.where(good, np.nan_to_num(intensity), 0).reshape(-1, SAMPLES)
    bytes_ = packets.view(np.uint8).reshape(-1, SIZE)
    bytes_[:, -1] = crc8(bytes_[:, :-1])
    return [row.tobytes() for row in bytes_]


def with_crc(data: bytes) -> bytes:
    """A packet with its CRC made right."""
    return data[:-1] + bytes(crc8(np.frombuffer(data[:-1], np.uint8)[None]))
