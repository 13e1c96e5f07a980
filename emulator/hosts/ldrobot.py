"""Hosts of LDROBOT's scanners: one on an open line for `look` and `view`, one in virtual time for `lidaremu test`.

Belongs here: reading packets, finding the speed of the line. They send nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from emulator.errors import LinkError
from emulator.hosts.describe import Described, Speaker, row_of, unknown
from emulator.hosts.lines import Line, SocketLine
from emulator.hosts.scans import HostScan
from emulator.hosts.scripted import SILENCE_NS, HostEnd
from emulator.hosts.turns import TurnAssembler
from emulator.process.clock import SystemClock
from protocols.ldrobot.codec import HEAD, PACKET, SAMPLES, SIZE, TURN_CDEG, with_crc
from protocols.scan import Floats

BAUDS = (230_400, 921_600)
LISTEN_S = 0.6
"At each speed."
TRIES = 4
"Rounds over the speeds: a device that has just been switched on is silent for up to 3 s."
NEXT_NS = 600_000_000


class Packet(NamedTuple):
    """One packet as a host reads it."""

    speed_dps: int
    angle_deg: Floats
    "(12,)"
    range_m: Floats
    "(12,) NaN where there is no echo."
    intensity: Floats
    stamp_ms: int


def decode_packet(data: bytes) -> Packet | None:
    """One packet; None if it is damaged."""
    if len(data) != SIZE or data[:2] != HEAD or with_crc(data) != data:
        return None
    one = np.frombuffer(data, PACKET)[0]
    start, end = int(one["start"]), int(one["end"])
    angle = (start + np.arange(SAMPLES) * ((end - start) % TURN_CDEG) / (SAMPLES - 1)) % TURN_CDEG / 100.0
    mm, intensity = one["samples"]["mm"].astype(float), one["samples"]["intensity"].astype(float)
    return Packet(int(one["speed"]), angle, np.where(mm > 0, mm / 1000.0, np.nan), intensity, int(one["stamp"]))


class PacketReader:
    """Packets out of bytes in any chunking."""

    def __init__(self) -> None:
        self._held = b""
        self.errors = 0
        "Beginnings of packets that were none, or damaged."

    def feed(self, data: bytes) -> Iterator[Packet]:
        """Packets that are whole by now."""
        held = self._held + data
        at = 0
        while (at := held.find(HEAD, at)) >= 0 and at + SIZE <= len(held):
            found = decode_packet(held[at : at + SIZE])
            if found is None:
                self.errors += 1
                at += 1
                continue
            yield found
            at += SIZE
        self._held = held[at:] if at >= 0 else held[-1:]


class LdrobotHost:
    """Listens in the constructor; raises `LinkError` when no packet comes."""

    title = "LDROBOT"
    listens = True

    def __init__(self, line: Line, baud: int | None) -> None:
        """`baud`: line speed tried first; None: one round over the speeds."""
        self._line, self._reader, self._clock = line, PacketReader(), SystemClock()
        self.found_baud: int | None = None
        speeds = [None] if isinstance(line, SocketLine) else [*([] if baud is None else [baud]), *BAUDS]
        for speed in list(dict.fromkeys(speeds)) * (1 if baud is None else TRIES):
            if speed is not None:
                line.set_baud(speed)
            if self._hears_a_packet():
                self.found_baud = speed
                return
        raise LinkError("no LDROBOT packet arrives")

    def _hears_a_packet(self) -> bool:
        reader, end_ns = PacketReader(), self._clock.now_ns() + round(1e9 * LISTEN_S)
        while (left_ns := end_ns - self._clock.now_ns()) > 0:
            if any(True for _ in reader.feed(self._line.read(left_ns / 1e9))):
                return True
        return False

    @property
    def errors(self) -> int:
        """Damaged packets so far."""
        return self._reader.errors

    def scans(self, timeout_s: float) -> Iterator[HostScan | None]:
        """Turns as they are complete; None when nothing came for `timeout_s`."""
        turns = TurnAssembler()
        while True:
            data = self._line.read(timeout_s)
            for packet in self._reader.feed(data):
                yield from turns.add(packet.angle_deg, packet.range_m, packet.intensity)
            if not data:
                yield None

    def close(self) -> None:
        """Hang up; the stream goes on."""
        self._line.close()


class LdrobotScript:
    """A host in virtual time: listens, at the other speed when nothing comes."""

    def __init__(self, line: HostEnd, on_scan: Callable[[int, HostScan], None]) -> None:
        self._line, self._on_scan = line, on_scan
        self._reader, self._turns = PacketReader(), TurnAssembler()
        self._at = 0
        self._next_ns: int | None = None
        line.baud = BAUDS[0]

    def step(self, now_ns: int) -> int | None:
        """Read, decode; when to be called again."""
        if self._next_ns is None:
            self._next_ns = now_ns + NEXT_NS
        for packet in self._reader.feed(self._line.read()):
            self._next_ns = now_ns + SILENCE_NS
            for scan in self._turns.add(packet.angle_deg, packet.range_m, packet.intensity):
                self._on_scan(now_ns, scan)
        if now_ns >= self._next_ns:
            self._at, self._next_ns = self._at + 1, now_ns + NEXT_NS
            self._line.baud = BAUDS[self._at % len(BAUDS)]
            self._reader, self._turns = PacketReader(), TurnAssembler(self._turns.count)
        return self._next_ns


def ldrobot_script(line: HostEnd, on_scan: Callable[[int, HostScan], None], device: Mapping[str, Any]) -> LdrobotScript:
    """For `lidaremu test`."""
    return LdrobotScript(line, on_scan)


def fields(speaker: Speaker, data: bytes, kind: str, peer: int, sent: bool) -> list[Described]:
    """Of packets, one after the other."""
    if not sent:
        return [unknown(data, "ignored: it takes no commands")]
    found: list[Described] = []
    for packet in PacketReader().feed(data):
        found += [
            Described("speed", f"{packet.speed_dps}", "deg/s"),
            Described("angles", row_of(packet.angle_deg, 2), "deg"),
            Described("distances", row_of(packet.range_m, 3), "m"),
            Described("intensities", row_of(packet.intensity)),
            Described("time stamp", f"{packet.stamp_ms}", "ms"),
        ]
    return found or [unknown(data, "no whole packet with a right CRC")]
