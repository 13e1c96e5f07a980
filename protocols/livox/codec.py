"""Point packets of Livox's second protocol (SDK 2, data type 1): x, y, z, reflectivity and tag of each point.

Belongs here: bytes and numbers. Not: which points there are (patterns), when a packet leaves (device).

Source: Livox-SDK2 and the maker's protocol text; bytes of a public description are in the tests.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from protocols.scan import Floats

POINT = np.dtype([("xyz", "<i4", 3), ("reflectivity", "u1"), ("tag", "u1")])
HEAD = np.dtype(
    [
        ("version", "u1"), ("length", "<u2"), ("interval", "<u2"), ("points", "<u2"), ("count", "<u2"),
        ("frame", "u1"), ("type", "u1"), ("time_type", "u1"), ("reserved", "u1", 12), ("crc", "<u4"), ("stamp", "<u8"),
    ]
)  # fmt: skip
HEAD_BYTES = HEAD.itemsize
CRC_AT, CHECKED = 24, 28
"Where the CRC is, and what follows it is checked."
MOST_POINTS = 96
CARTESIAN = 1
INTERVAL_NS = 100
"Unit of the time from the first point to the last."
MOST_INTERVAL = 0xFFFF
WHITE = 150.0
"Reflectivity of a white plate; beyond are retro-reflectors."


def encode(
    stamp_ns: int, count: int, frame: int, interval_ns: float, xyz_m: Floats, reflectivity: NDArray[Any]
) -> bytes:
    """A packet of up to 96 points.

    stamp_ns of the first point; interval_ns from it to the last; xyz_m (n, 3), NaN: no echo, as zeros on the wire;
    reflectivity (n,) 0..255.
    """
    points = np.zeros(len(xyz_m), POINT)
    seen = ~np.isnan(xyz_m[:, 0])
    points["xyz"][seen] = np.rint(1000.0 * xyz_m[seen])
    points["reflectivity"][seen] = reflectivity[seen]
    head = np.zeros(1, HEAD)
    head["length"], head["points"] = HEAD_BYTES + points.nbytes, len(points)
    head["interval"] = min(round(interval_ns / INTERVAL_NS), MOST_INTERVAL)
    head["count"], head["frame"], head["type"], head["stamp"] = count & 0xFFFF, frame & 0xFF, CARTESIAN, stamp_ns
    return with_crc(head.tobytes() + points.tobytes())


def with_crc(data: bytes) -> bytes:
    """A packet with its CRC made right."""
    return data[:CRC_AT] + zlib.crc32(data[CHECKED:]).to_bytes(4, "little") + data[CHECKED:]


def is_packet(data: bytes) -> bool:
    """Whether it is a whole packet of points with a right CRC."""
    return size_of(data) == len(data) and with_crc(data) == data


def size_of(data: bytes) -> int | None:
    """Length of the packet of points that begins there; None: none does."""
    if len(data) < HEAD_BYTES or data[0] or data[10] != CARTESIAN:
        return None
    head = np.frombuffer(data, HEAD, 1)[0]
    size = HEAD_BYTES + POINT.itemsize * int(head["points"])
    return (
        size if not head["reserved"].any() and 1 <= head["points"] <= MOST_POINTS and head["length"] == size else None
    )


@dataclass(frozen=True, eq=False)
class Read:
    """What a packet says."""

    count: int
    frame: int
    stamp_ns: int
    interval_ns: int
    xyz_m: Floats
    "(n, 3) zeros: no echo."
    reflectivity: Floats
    "(n,)"


def decode(data: bytes) -> Read | None:
    """A packet of points; None: it is none, or damaged."""
    if not is_packet(data):
        return None
    head, points = np.frombuffer(data, HEAD, 1)[0], np.frombuffer(data, POINT, offset=HEAD_BYTES)
    return Read(
        int(head["count"]),
        int(head["frame"]),
        int(head["stamp"]),
        INTERVAL_NS * int(head["interval"]),
        points["xyz"] / 1000.0,
        points["reflectivity"].astype(np.float64),
    )


class Packets:
    """Packets out of a stream of datagrams in any chunking."""

    def __init__(self) -> None:
        self._held, self._lost = b"", False
        self.errors = 0
        "Places where no packet began, and damaged packets."

    def feed(self, data: bytes) -> Iterator[Read]:
        """Packets that are whole by now."""
        held, at = self._held + data, 0
        while len(held) - at >= HEAD_BYTES:
            size = size_of(held[at : at + HEAD_BYTES])
            if size is not None and len(held) - at < size:
                break
            read = None if size is None else decode(held[at : at + size])
            if read is None:
                self.errors += not self._lost
                next_at = held.find(b"\0", at + 1)  # the version, with which it begins
                self._lost, at = True, len(held) if next_at < 0 else next_at
                continue
            self._lost, at = False, at + (size or 0)
            yield read
        self._held = held[at:]
