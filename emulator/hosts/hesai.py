"""Hosts for Hesai: one on a connection for `look` and `view`, one in virtual time for `lidaremu test`.

Belongs here: what a driver does with packets. It shares the codec with the device, and nothing else. A scan is the
layer nearest to the horizon of a turn, of an AT128 of a mirror's sweep.
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
from protocols.hesai.calibration import along_beam, directions, leads
from protocols.hesai.codec import GPS_BYTES, Read, decode, size_of_packet
from protocols.hesai.commands import COMMANDS

ASK = b"GET /point_cloud HTTP/1.1\r\n\r\n"
MARKS = b"\xee\xff", b"\xff\xee"
HEAD_BYTES = 126
"By which a packet is known."
START_S = 20.0
"A device starts its motor for ten seconds before it sends."
MOST_PACKETS = 8000
"Of a turn: an OT128 in high resolution and dual mode has 3600."
JUMP_DEG = 10.0
"A turn ends with half a turn back; a mirror's sweep with a jump."


class TurnReader:
    """Turns out of a stream of packets in any chunking."""

    def __init__(self) -> None:
        self._held = b""
        self._packets: list[bytes] = []
        self._last = 0.0
        self._scans = 0
        self.errors = 0
        "Places where no packet began, and turns that could not be read."
        self.title = "Hesai"

    def feed(self, data: bytes) -> Iterator[HostScan]:
        """Turns that are whole by now; what is before the first packet is passed over."""
        self._held += data
        while len(self._held) >= HEAD_BYTES:
            size = size_of_packet(self._held)
            if size is None:
                at = min((at for mark in MARKS if (at := self._held.find(mark, 1)) > 0), default=0)
                self.errors += not self._held.startswith(b"HTTP/")
                self._held = self._held[at:] if at else self._held[-1:]
                continue
            if len(self._held) < size:
                return
            packet, self._held = self._held[:size], self._held[size:]
            yield from self._take(packet)

    def _take(self, packet: bytes) -> Iterator[HostScan]:
        read = decode(packet[:-32] if len(packet) == 893 else packet)
        if read is None:
            self.errors += 1
            return
        azimuth = float(read.azimuth_deg[0, 0])
        jump = JUMP_DEG if read.model.layout.fine else 180.0
        if self._packets and (abs(azimuth - self._last) > jump or len(self._packets) >= MOST_PACKETS):
            scan = self._turn()
            self._packets.clear()
            if scan is not None:
                yield scan
        self._packets.append(packet[: read.model.layout.size])
        self._last = azimuth

    def _turn(self) -> HostScan | None:
        read = decode(b"".join(self._packets))
        if read is None:
            self.errors += 1
            return None
        model, (name, _, echoes) = read.model, read.model.returns(read.mode)
        self.title = f"Hesai {model.title}"
        azimuth, elevation = _directions(read, echoes)
        words = read.distance[:, ::echoes].reshape(azimuth.shape)
        bright = read.reflectivity[:, ::echoes].reshape(azimuth.shape)
        range_m = along_beam(words * (model.unit_mm / 1000.0), *leads(model))
        laser = int(np.argmin(np.abs(model.elevation_deg)))
        own = words[:, laser] > 0
        self._scans += 1
        detail = f"{name}, {model.elevation_deg[laser]:g} deg of {model.lasers} layers, {read.us[0]} us"
        firing, hit = np.nonzero(words)
        cloud = HostCloud(
            azimuth[firing, hit],
            elevation[firing, hit],
            range_m[firing, hit],
            bright[firing, hit].astype(np.float64),
        )
        return HostScan(
            self._scans - 1,
            azimuth[:, laser],
            np.where(own, range_m[:, laser], np.nan),
            detail,
            np.where(own, bright[:, laser], np.nan),
            cloud,
        )


def _directions(read: Read, echoes: int) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """(firings, lasers) of one turn. [rad]"""
    turns = (read.azimuth_deg[:, ::echoes] / 360.0).reshape(-1, 1)
    back = np.median((np.diff(turns[:, 0]) + 0.5) % 1.0 - 0.5) < 0.0 if len(turns) > 1 else False
    rate = abs(read.rpm) / 60e9 * (-1.0 if back else 1.0)
    late = np.nan_to_num(read.model.instants(read.high)[read.states[:, ::echoes].ravel()])
    azimuth, elevation = directions(read.model, turns + rate * late, turns)
    return np.asarray(np.pi - (np.pi - azimuth) % (2.0 * np.pi)), elevation


class HesaiHost(PacketHost):
    """Asks for packets on a TCP connection; raises `LinkError` when none come."""

    def __init__(self, line: Line, baud: int | None) -> None:
        """`baud`: of no meaning; None: the device is left as it is, which a request for packets does too."""
        super().__init__(line, TurnReader(), ASK, START_S, _begun)
        if not _begun(self._first):
            raise LinkError("no Hesai sends packets there")


def _begun(data: bytes) -> bool:
    """Whether a packet does, after the head of a reply."""
    head = data.partition(b"\r\n\r\n")[2] if data.startswith(b"HTTP/") else data
    return len(head) >= HEAD_BYTES and size_of_packet(head) is not None


def hesai_script(line: HostEnd, on_scan: Callable[[int, HostScan], None], device: Mapping[str, Any]) -> PacketScript:
    """For `lidaremu test`."""
    return PacketScript(line, on_scan, TurnReader, ASK)


def described(speaker: Speaker, data: bytes, kind: str, peer: int, sent: bool) -> list[Described]:
    """Fields of a packet, a GPS packet, a message of PTC, a request of HTTP or its reply."""
    if sent and len(data) == GPS_BYTES:
        sentence = data[18:118].partition(b"\0")[0].decode("ascii", "replace").strip()
        return [Described("date, digits reversed", data[2:14].decode("ascii", "replace")), Described("NMEA", sentence)]
    if data.startswith(b"\x47\x74") and len(data) >= 8:
        row = COMMANDS.get(f"{data[2]:02X}".encode())
        found = [Described("command", f"{data[2]:02X} {row.name if row is not None else ''}".strip())]
        found += [Described("return code", str(data[3]))] if sent else []
        return [*found, Described("payload", data[8:72].hex(" "))]
    if sent and len(data) >= HEAD_BYTES and (size := size_of_packet(data)) is not None and len(data) == size:
        read = decode(data[: size - 32] if size == 893 else data)
        if read is None:
            return [unknown(data, "no known return mode")]
        return [
            Described("model", read.model.title),
            Described("returns", read.model.returns(read.mode)[0]),
            Described("microseconds", str(read.us[0]), "us"),
            Described("sequence", str(read.sequence[0])),
            Described("azimuths", row_of(read.azimuth_deg[0], 2), "deg"),
            Described("distances", row_of(read.distance[0, 0] * read.model.unit_mm / 1000.0, 3), "m"),
            Described("reflectivities", row_of(read.reflectivity[0, 0])),
        ]
    head, _, body = data.partition(b"\r\n\r\n")
    lines = [*head.split(b"\r\n")[:1], body]
    return [Described("line", repr(line)[2:-1][:200]) for line in lines if line] or [unknown(data, "empty")]
