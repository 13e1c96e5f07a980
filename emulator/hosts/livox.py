"""Hosts for point packets of Livox: one on a line for `look` and `view`, one in virtual time for `lidaremu test`.

Belongs here: what a driver does with packets. They send nothing. A scan is what a frame has near the horizon.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from emulator.errors import LinkError
from emulator.hosts.describe import Described, Speaker, row_of, unknown
from emulator.hosts.lines import Line
from emulator.hosts.packets import PacketHost, PacketScript
from emulator.hosts.scans import HostCloud, HostScan
from emulator.hosts.scripted import HostEnd
from protocols.livox.codec import HEAD_BYTES, Packets, Read, decode, size_of

START_S = 5.0
BAND_RAD = np.radians(1.0)
"Points so near to the horizon are a scan."
MOST_POINTS = 5_000_000
"Of a frame; one that does not end is cut there."


class FrameReader:
    """Frames out of a stream of packets in any chunking; a frame ends where another number begins."""

    title = "Livox point packets"

    def __init__(self) -> None:
        self._packets, self._frame, self._points, self._scans = Packets(), list[Read](), 0, 0
        self.errors = 0
        "Places where no packet began, and damaged packets."

    def feed(self, data: bytes) -> Iterator[HostScan]:
        """Frames that are whole by now."""
        for packet in self._packets.feed(data):
            self.errors = self._packets.errors
            if self._frame and (packet.frame != self._frame[0].frame or self._points >= MOST_POINTS):
                yield self._scan()
                self._frame, self._points = [], 0
            self._frame.append(packet)
            self._points += len(packet.xyz_m)
        self.errors = self._packets.errors

    def _scan(self) -> HostScan:
        xyz = np.concatenate([one.xyz_m for one in self._frame])
        bright = np.concatenate([one.reflectivity for one in self._frame])
        seen = xyz.any(axis=1)
        xyz, bright = xyz[seen], bright[seen]
        range_m = np.linalg.norm(xyz, axis=1)
        azimuth, elevation = np.arctan2(xyz[:, 1], xyz[:, 0]), np.arcsin(xyz[:, 2] / range_m)
        level = np.flatnonzero(np.abs(elevation) <= BAND_RAD)
        level = level[np.argsort(azimuth[level], kind="stable")]
        detail = f"{len(range_m)} of {self._points} points, frame {self._frame[0].frame}"
        cloud = HostCloud(azimuth, elevation, range_m, bright, layered=False)
        self._scans += 1
        return HostScan(self._scans - 1, azimuth[level], range_m[level], detail, bright[level], cloud)


def _begun(data: bytes) -> bool:
    """Whether a packet has arrived."""
    return any(
        size_of(data[at : at + HEAD_BYTES]) is not None for at in range(max(0, min(len(data), 2000) - HEAD_BYTES))
    )


class LivoxHost(PacketHost):
    """Listens; raises `LinkError` when no packet comes."""

    def __init__(self, line: Line, baud: int | None) -> None:
        """`baud`: of no meaning."""
        super().__init__(line, FrameReader(), b"", START_S, _begun)
        if not _begun(self._first):
            raise LinkError("no point packets of Livox arrive")
        self.listens = True


def livox_script(line: HostEnd, on_scan: Callable[[int, HostScan], None], device: Mapping[str, Any]) -> PacketScript:
    """For `lidaremu test`."""
    return PacketScript(line, on_scan, FrameReader, b"")


def described(speaker: Speaker, data: bytes, kind: str, peer: int, sent: bool) -> list[Described]:
    """Fields of a packet."""
    if not sent:
        return [unknown(data, "ignored: it takes no commands")]
    if (read := decode(data)) is None:
        return [unknown(data, "no packet of points with a right CRC")]
    return [
        Described("frame", str(read.frame)),
        Described("packet", str(read.count)),
        Described("time stamp", str(read.stamp_ns), "ns"),
        Described("first to last point", f"{read.interval_ns / 1000:g}", "us"),
        *(Described(axis, row_of(read.xyz_m[:, at], 3), "m") for at, axis in enumerate("xyz")),
        Described("reflectivities", row_of(read.reflectivity)),
    ]
