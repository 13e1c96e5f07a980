"""An RPLIDAR's session in virtual time, a world that answers its plans, and a decoder independent of `protocols`.

The decoder follows the maker's SDK (sl_lidar_driver.cpp, handler of each answer), sample by sample.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from protocols.rplidar import FAMILY
from protocols.rplidar.session import RplidarSession
from protocols.scan import Scan, ScanPlan
from protocols.session import Address, Dropped, DropReason, Emission, LinkKind

MS, SECOND = 1_000_000, 1_000_000_000
LOOK_AHEAD_NS = 250 * MS
LINE = Address(0, 0)
World = Callable[[ScanPlan], Scan]
SIZES = {0x81: 5, 0x82: 84, 0x83: 781, 0x84: 132, 0x85: 84, 0x86: 170}


def ten_mm_per_degree(plan: ScanPlan) -> Scan:
    """The worked scene of the specification, d = 1000 + 10 a mm, clockwise; from 300 degrees on nothing."""
    scan = Scan.empty(plan)
    angle = np.degrees(-plan.azimuth_rad) % 360.0
    scan.range_m[:, 0] = np.where(angle < 300.0, (1000.0 + 10.0 * angle) / 1000.0, np.nan)
    scan.intensity[:, 0] = 10.0
    return scan


def room(plan: ScanPlan) -> Scan:
    """A square room of 6 m by 6 m, closed all around."""
    scan = Scan.empty(plan)
    azimuth = plan.azimuth_rad
    scan.range_m[:, 0] = 3.0 / np.maximum(np.abs(np.cos(azimuth)), np.abs(np.sin(azimuth)))
    scan.intensity[:, 0] = 3.0
    return scan


def request(code: int, payload: bytes | None = None) -> bytes:
    text = bytes([0xA5, code]) if payload is None else bytes([0xA5, code, len(payload)]) + payload
    if payload is None:
        return text
    total = 0
    for one in text:
        total ^= one
    return text + bytes([total])


@dataclass
class Point:
    angle: float
    mm: float
    start: bool = False
    quality: int = 0


def _checked(capsule: bytes) -> bytes:
    total = 0
    for one in capsule[2:]:
        total ^= one
    assert (capsule[0], capsule[1]) == (0xA0 | total & 15, 0x50 | total >> 4)
    return capsule


def _start(capsule: bytes, at: int = 2) -> float:
    return (struct.unpack_from("<H", capsule, at)[0] & 0x7FFF) / 64.0


def restarts(capsules: list[bytes], at: int = 2) -> list[bool]:
    return [bool(struct.unpack_from("<H", one, at)[0] & 0x8000) for one in capsules]


def _ultra_major(code: int) -> tuple[int, int]:
    for level, (start, mm) in reversed(
        list(enumerate([(0, 0), (512, 512), (1280, 2048), (1792, 4096), (3328, 16384)]))
    ):
        if code >= start:
            return mm + ((code - start) << level), level
    raise AssertionError


def _signed10(value: int) -> int:
    return value - 1024 if value & 512 else value


def _ultra_values(capsule: bytes, following: bytes) -> list[int]:
    words = [*struct.unpack_from("<32I", capsule, 4), *struct.unpack_from("<I", following, 4)]
    found = []
    for word, after in pairwise(words):
        major, level1 = _ultra_major(word & 0xFFF)
        base2, level2 = _ultra_major(after & 0xFFF)
        base1 = major
        if not major and base2:
            base1, level1 = base2, level2
        found.append(major)
        for base, level, bits in ((base1, level1, word >> 12), (base2, level2, word >> 22)):
            predict = _signed10(bits & 0x3FF)
            found.append(0 if predict in (-512, 511) else (predict << level) + base)
    return found


def _ultra_dense_values(capsule: bytes) -> list[tuple[int, int]]:
    found = []
    for at in range(10, 170, 5):
        low0, low1, high = struct.unpack_from("<HHB", capsule, at)
        for v in (low0 | (high & 15) << 16, low1 | (high >> 4) << 16):
            scale = v & 3
            if scale == 0:
                found.append(((v >> 2 & 0x3FF) * 2, v >> 12))
            elif scale == 1:
                found.append(((v >> 2 & 0x7FF) * 3 + 2046, (v >> 13) << 1))
            elif scale == 2:
                found.append(((v >> 2 & 0xFFF) * 4 + 8187, (v >> 14) << 2))
            else:
                found.append(((v >> 2 & 0x1FFF) * 5 + 24567, (v >> 15) << 3))
    return found


def points_of(kind: int, data: bytes) -> list[Point]:
    """All samples of a stream behind its descriptor, as the maker's SDK computes them."""
    groups = [data[at : at + SIZES[kind]] for at in range(0, len(data), SIZES[kind])]
    assert all(len(one) == SIZES[kind] for one in groups)
    if kind == 0x81:
        found = []
        for one in groups:
            first, angle, quarter = struct.unpack("<BHH", one)
            assert (first & 1) != (first >> 1 & 1)
            assert angle & 1
            found.append(Point((angle >> 1) / 64.0, quarter / 4.0, bool(first & 1), first >> 2))
        return found
    if kind == 0x83:
        found = []
        for one in groups:
            assert one[0] == 0xA5
            assert struct.unpack_from("<I", one, 777)[0] == zlib.crc32(one[:777] + bytes(3))
            for at in range(9, 777, 8):
                angle, quarter, quality, flag = struct.unpack_from("<HIBB", one, at)
                found.append(Point(angle * 90.0 / 16384.0, quarter / 4.0, flag == 1, quality))
        return found
    found = []
    place = 8 if kind == 0x86 else 2
    for one, after in pairwise(groups):
        start, diff = _start(_checked(one), place), _start(after, place) - _start(one, place)
        diff += 360.0 if diff < 0 else 0.0
        quality = [0] * 96
        if kind == 0x82:
            values = []
            for at in range(4, 84, 5):
                d1, d2, offsets = struct.unpack_from("<HHB", one, at)
                assert not (d1 & 3 | d2 & 3 | offsets)
                values += [d1 >> 2, d2 >> 2]
        elif kind == 0x85:
            values = list(struct.unpack_from("<40H", one, 4))
        elif kind == 0x84:
            values = _ultra_values(one, after)
        else:
            values, quality = (list(part) for part in zip(*_ultra_dense_values(one), strict=True))
        for i, mm in enumerate(values):
            angle = start + i * diff / len(values)
            if kind == 0x84:
                x = 24.01 / mm if mm >= 50 else None
                angle -= 7.5 if x is None else 8.0 - math.degrees(x + x**3 / 6.0)
            found.append(Point(angle % 360.0, mm, False, quality[i]))
    return found


class Rig:
    """One session switched on, its motor at speed."""

    def __init__(
        self,
        model: str = "rplidar-a1m8",
        device: Mapping[str, Any] | None = None,
        world: World = ten_mm_per_degree,
        kind: LinkKind = LinkKind.SERIAL,
        ready: bool = True,
    ) -> None:
        settings = {"boot_s": 0.0, "spin_up_s": 0.0, **(device or {})}
        self.session: RplidarSession = FAMILY.new_session(settings, {"model": model})
        self.world, self.kind, self.now_ns = world, kind, 0
        self.sent: list[Emission] = []
        self.events: list[Any] = []
        self.plans: list[ScanPlan] = []
        if kind is not LinkKind.STREAM:
            self.session.connected(0, LINE, kind)
        self.session.power_on(0)
        if ready:
            self.run(10 * MS)
            self.raw()

    def step(self) -> int | None:
        session = self.session
        session.advance(self.now_ns)
        while (plan := session.next_plan()) is not None and plan.start_ns <= self.now_ns + LOOK_AHEAD_NS:
            self.plans.append(plan)
            session.submit(self.world(plan))
        self.sent += session.take_emissions(self.now_ns)
        self.events += session.take_events()
        plan = session.next_plan()
        wakes = [session.next_deadline(), None if plan is None else plan.start_ns - LOOK_AHEAD_NS]
        return min((wake for wake in wakes if wake is not None), default=None)

    def run(self, duration_ns: int) -> None:
        until_ns = self.now_ns + duration_ns
        while (wake_ns := self.step()) is not None and wake_ns <= until_ns:
            self.now_ns = max(self.now_ns, wake_ns)
        self.now_ns = until_ns

    def raw(self) -> bytes:
        found, self.sent = b"".join(one.payload for one in self.sent), []
        return found

    def put(self, data: bytes, address: Address = LINE) -> None:
        self.session.receive(data, self.now_ns, address)

    def ask(self, data: bytes, within_ns: int = 2 * MS) -> bytes:
        """All that is sent within some time of a request."""
        self.put(data)
        self.run(within_ns)
        return self.raw()

    def conf(self, entry: int, data: bytes = b"") -> bytes:
        """The value of an entry."""
        said = self.ask(request(0x84, struct.pack("<I", entry) + data))
        assert said[6] == 0x20
        assert said[7:11] == struct.pack("<I", entry)
        return said[11:]

    def stream(self, data: bytes, duration_ns: int) -> tuple[int, bytes]:
        """A scan: type of its answer, and the bytes behind the descriptor."""
        said = self.ask(data, duration_ns)
        assert said[:2] == b"\xa5\x5a", said[:20]
        assert struct.unpack_from("<I", said, 2)[0] == SIZES[said[6]] | 1 << 30
        return said[6], said[7:]

    def dropped(self) -> list[DropReason]:
        found = [one.reason for one in self.events if isinstance(one, Dropped)]
        self.events = []
        return found
