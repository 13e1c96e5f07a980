"""A solid-state sensor that only sends: slices of its pattern, and the packets that they leave in.

A frame is cut into packets, and these into slices that are measured as a whole. Belongs here: what is measured and sent
when. Not: directions (patterns), bytes (codec).
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from protocols.livox import codec
from protocols.livox.patterns import Pattern
from protocols.livox.settings import Build
from protocols.scan import Scan
from protocols.skeleton.instants import SECOND_NS, Raster
from protocols.skeleton.one_way import OneWaySession
from protocols.skeleton.reflectivity import calibrated
from protocols.skeleton.sweeps import Sweep, Telegram

SLICE_NS = 5_000_000
TICK_NS = Fraction(1)


@dataclass(frozen=True)
class Frames:
    """When slices begin: those of a frame at fixed instants within it. Numbered over all frames."""

    zero_ns: int
    frame_ns: Fraction
    begin_ns: tuple[int, ...]
    "Of the slices of a frame, after its beginning."

    @property
    def period_ns(self) -> Fraction:
        """From slice to slice, on average."""
        return self.frame_ns / len(self.begin_ns)

    def at(self, number: int) -> int:
        """Instant of a slice."""
        frame, part = divmod(number, len(self.begin_ns))
        return Raster(self.zero_ns, self.frame_ns).at(frame) + self.begin_ns[part]

    def first_from(self, instant_ns: int) -> int:
        """The least number whose instant is `instant_ns` or later."""
        frames = Raster(self.zero_ns, self.frame_ns)
        frame = frames.first_from(instant_ns) - 1  # of a frame that has begun before
        part = bisect_left(self.begin_ns, instant_ns - frames.at(frame))
        return frame * len(self.begin_ns) + part


def cut(pattern: Pattern, slice_packets: int) -> list[list[tuple[int, int]]]:
    """Slices of a frame, each a list of packets: first point and the one after the last.

    Runs are cut evenly, so that no packet has a gap in it; `slice_packets` 0: as many as fit into 5 ms, at least one.
    """
    rate_hz = float(pattern.rate_hz)
    most_s = codec.MOST_INTERVAL * codec.INTERVAL_NS * 1e-9
    size = min(codec.MOST_POINTS, 1 + math.floor(most_s * rate_hz))
    parts = math.ceil(pattern.run / size)
    packets = [
        (run + pattern.run * part // parts, run + pattern.run * (part + 1) // parts)
        for run in range(0, pattern.points, pattern.run)
        for part in range(parts)
    ]
    times = pattern.fire_s(np.array(packets, dtype=np.int64).reshape(-1))
    begin_s, end_s = times[::2], times[1::2]
    slices: list[list[tuple[int, int]]] = []
    since_s = 0.0
    for packet, begins_s, ends_s in zip(packets, begin_s.tolist(), end_s.tolist(), strict=True):
        full = len(slices[-1]) >= slice_packets if slices and slice_packets else 1e9 * (ends_s - since_s) > SLICE_NS
        if not slices or full:
            slices.append([])
            since_s = begins_s
        slices[-1].append(packet)
    return slices


class PatternSession(OneWaySession):
    """One sensor."""

    clock_tick_ns = TICK_NS
    clock_bits = 63
    count_bits = 8

    def __init__(self, build: Build) -> None:
        self.build, self.pattern = build, build.pattern
        self._slices = cut(build.pattern, build.slice_packets)
        firsts = build.pattern.fire_s(np.array([one[0][0] for one in self._slices], dtype=np.int64))
        self._begin_ns = tuple(math.floor(1e9 * first_s) for first_s in firsts.tolist())
        self._packets = np.cumsum([0, *map(len, self._slices)]).tolist()
        self._frame_ns = SECOND_NS * build.pattern.frame_s
        self._made: tuple[int, Sweep] | None = None
        super().__init__(build.boot_ns, self._frame_ns / len(self._slices))

    def _schedule(self) -> Frames:
        return Frames(self._raster.zero_ns, self._frame_ns, self._begin_ns)

    def impair(self, now_ns: int, what: str, degree: float) -> bool:
        """It has no part that can be impaired."""
        self.advance(now_ns)
        return False

    def _sweep(self, number: int) -> Sweep:
        if self._made is not None and self._made[0] == number:
            return self._made[1]
        frame, part = divmod(number, len(self._slices))
        packets = self._slices[part]
        index = np.arange(packets[0][0], packets[-1][1])
        azimuth, elevation = self.pattern.aim(frame, index)
        after_s = self.pattern.fire_s(index) - 1e-9 * self._begin_ns[part]
        sweep = Sweep(azimuth, elevation, after_s, float(after_s[-1]), wants_intensity=True, turn=frame)
        self._made = number, sweep
        return sweep

    def _telegrams(self, scan: Scan) -> Iterator[Telegram]:
        plan = scan.plan
        frame, part = divmod(plan.sweep, len(self._slices))
        range_m, level = scan.range_m[:, 0], np.cos(plan.elevation_rad)
        xyz = np.stack([level * np.cos(plan.azimuth_rad), level * np.sin(plan.azimuth_rad), np.sin(plan.elevation_rad)])
        points = (range_m * xyz).T
        bright = calibrated(range_m, scan.intensity[:, 0], self.build.white_m2, codec.WHITE)
        origin = self._slices[part][0][0]
        for number, (first, end) in enumerate(self._slices[part], self._packets[part]):
            beams = slice(first - origin, end - origin)
            fires_s = plan.fire_offset_s[beams]
            reported = self.clock.reported(plan.start_ns + round(1e9 * fires_s[0]), TICK_NS, self.clock_bits)
            payload = codec.encode(
                reported.ticks, number, frame + self.first_count, 1e9 * float(fires_s[-1] - fires_s[0]), points[beams],
                bright[beams],
            )  # fmt: skip
            yield Telegram(math.ceil(1e9 * float(fires_s[-1])), payload, "points", reported)
