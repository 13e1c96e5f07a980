"""Hosts for Velodyne: one on a connection for `look` and `view`, one in virtual time for `lidaremu test`.

Belongs here: what a driver does with packets. It shares the codec with the device, and nothing else. A scan is the
layer nearest to the horizon of a turn.
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
from protocols.scan import Floats
from protocols.velodyne import own as own_lasers
from protocols.velodyne.codec import DATA_BYTES, PACKET, POSITION, POSITION_BYTES, TURN_CDEG, Firings, decode
from protocols.velodyne.models import MODELS, MODES, Model

ASK = b"GET /packets HTTP/1.1\r\n\r\n"
MARK = b"\xff\xee"
ENDS = frozenset(bytes((mode, model.product)) for mode in MODES.values() for model in MODELS.values())
"Return mode and model, the last bytes of a packet."
START_S = 5.0
"A device whose motor starts sends dark packets, but sends."
OUSTERS = b"\r\nX-Metadata: "
"In the head of an Ouster's reply to the same request."
MOST_PACKETS = 8000
"Of a turn: 300/min of a VLS-128 in dual mode have 3752."


class TurnReader:
    """Turns out of a stream of packets in any chunking; a turn ends where the azimuth passes 0."""

    def __init__(self) -> None:
        self._held = b""
        self._packets: list[bytes] = []
        self._last = 0
        self._scans = 0
        self._own: Model | None = None
        "As reported in the reply's head, of a sensor that is none of the maker's."
        self.errors = 0
        "Places where no packet began, and turns that could not be read."
        self.title = "Velodyne"

    def feed(self, data: bytes) -> Iterator[HostScan]:
        """Turns that are whole by now; what is before the first packet is passed over."""
        self._held += data
        while len(self._held) >= DATA_BYTES:
            if self._held.startswith(b"HTTP/"):
                head, end, _ = self._held.partition(b"\r\n\r\n")
                self._own = own_lasers.read(head) if end else self._own
            if not self._begins():
                at = self._held.find(MARK, 1)
                self.errors += not self._held.startswith(b"HTTP/")
                self._held = self._held[at:] if at > 0 else b""
                continue
            packet, self._held = self._held[:DATA_BYTES], self._held[DATA_BYTES:]
            azimuth = int.from_bytes(packet[2:4], "little")
            if self._packets and (azimuth < self._last or len(self._packets) >= MOST_PACKETS):
                if (scan := self._turn()) is not None:
                    yield scan
                self._packets.clear()
            self._packets.append(packet)
            self._last = azimuth

    def _begins(self) -> bool:
        """Whether a packet does: blocks have the same mark, so its end must be right too."""
        return self._held.startswith(MARK) and self._held[DATA_BYTES - 2 : DATA_BYTES] in ENDS

    def _turn(self) -> HostScan | None:
        read = decode(np.frombuffer(b"".join(self._packets), PACKET), self._own)
        if read is None:
            self.errors += 1
            return None
        model, mode, said = read
        self.title = f"Velodyne {model.title}"
        laser = int(np.argmin(np.abs(model.elevation_deg)))
        heads = np.unwrap(2.0 * np.pi / TURN_CDEG * said.azimuth_cdeg.ravel())
        steps = np.diff(heads)
        if len(steps):  # not over what the field of view omits
            steps = steps[np.abs(steps) <= 4.0 * np.abs(np.median(steps))]
        rate = float(steps.mean()) / model.cycle_ns if len(steps) else 0.0
        azimuth = np.radians(model.offset_deg[laser]) - heads - rate * model.laser_ns[laser]
        words = said.distance[0, :, :, laser].ravel()
        range_m = np.where(words > 0, words * model.unit_mm / 1000.0, np.nan)
        bright = np.where(words > 0, said.reflectivity[0, :, :, laser].ravel(), np.nan)
        self._scans += 1
        detail = f"{mode}, {model.elevation_deg[laser]:g} deg of {model.lasers} layers, {said.stamp_us[0]} us"
        wrapped = np.pi - (np.pi - azimuth) % (2.0 * np.pi)
        return HostScan(self._scans - 1, wrapped, range_m, detail, bright, _cloud(model, said, heads, rate))


def _cloud(model: Model, said: Firings, heads: Floats, rate: float) -> HostCloud:
    """Every laser's first return. `heads` in radians, `rate` per nanosecond."""
    words = said.distance[0].reshape(len(heads), model.lasers)
    firing, laser = np.nonzero(words)
    instants, offsets = np.asarray(model.laser_ns), np.radians(np.asarray(model.offset_deg))
    azimuth = offsets[laser] - heads[firing] - rate * instants[laser]
    return HostCloud(
        np.pi - (np.pi - azimuth) % (2.0 * np.pi),
        np.radians(np.asarray(model.elevation_deg))[laser],
        words[firing, laser] * model.unit_mm / 1000.0,
        said.reflectivity[0].reshape(words.shape)[firing, laser].astype(np.float64),
    )


class VelodyneHost(PacketHost):
    """Asks for packets on a TCP connection; raises `LinkError` when none come."""

    def __init__(self, line: Line, baud: int | None) -> None:
        """`baud`: of no meaning; None: the device is left as it is, which a request for packets does too."""
        super().__init__(line, TurnReader(), ASK, START_S, lambda first: MARK in first or OUSTERS in first)
        if OUSTERS in self._first:
            raise LinkError("an Ouster sends packets there")
        if MARK not in self._first or (line.asks and not self._first.startswith(b"HTTP/1.1 200")):
            raise LinkError("no Velodyne sends packets there")


class VelodyneScript(PacketScript):
    """A host in virtual time."""

    def __init__(self, line: HostEnd, on_scan: Callable[[int, HostScan], None]) -> None:
        super().__init__(line, on_scan, TurnReader, ASK)


def velodyne_script(
    line: HostEnd, on_scan: Callable[[int, HostScan], None], device: Mapping[str, Any]
) -> VelodyneScript:
    """For `lidaremu test`."""
    return VelodyneScript(line, on_scan)


def described(speaker: Speaker, data: bytes, kind: str, peer: int, sent: bool) -> list[Described]:
    """Fields of a data packet, a position packet, a request or its reply."""
    if sent and len(data) == POSITION_BYTES:
        position = np.frombuffer(data, POSITION)[0]
        state = ("absent", "synchronising", "locked", "error")[min(3, int(position["pps"]))]
        said = bytes(position["sentence"]).decode("ascii", "replace").strip()
        return [Described("time stamp", str(position["stamp"]), "us"), Described("PPS", state), Described("NMEA", said)]
    if sent and len(data) == DATA_BYTES:
        if (read := decode(np.frombuffer(data, PACKET))) is None:
            return [unknown(data, "no known model or mode")]
        model, mode, said_all = read
        return [
            Described("model", model.title),
            Described("returns", mode),
            Described("time stamp", str(said_all.stamp_us[0]), "us"),
            Described("azimuths", row_of(said_all.azimuth_cdeg[0] / 100.0, 2), "deg"),
            Described("distances", row_of(said_all.distance[0, 0, 0] * model.unit_mm / 1000.0, 3), "m"),
            Described("reflectivities", row_of(said_all.reflectivity[0, 0, 0])),
        ]
    head, _, body = data.partition(b"\r\n\r\n")
    lines = [*head.split(b"\r\n")[:1], body]
    return [Described("line", repr(line)[2:-1][:200]) for line in lines if line] or [unknown(data, "empty")]
