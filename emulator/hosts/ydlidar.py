"""Hosts of YDLIDAR's scanners: one on an open line for `look` and `view`, one in virtual time for `lidaremu test`.

Belongs here: what a driver does: the speed of the line, stop, device info, scan, packets, the correction of angles.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from emulator.errors import LinkError
from emulator.hosts.describe import Described, Speaker, row_of, unknown
from emulator.hosts.lines import Line, LineClosed, SocketLine
from emulator.hosts.scans import HostScan
from emulator.hosts.scripted import SILENCE_NS, HostEnd
from emulator.hosts.turns import TurnAssembler
from emulator.process.clock import SystemClock
from protocols.scan import Floats
from protocols.skeleton.descriptors import REPLY_SYNC
from protocols.ydlidar.codec import HEAD, HEAD_BYTES, correction_deg
from protocols.ydlidar.models import MODELS
from protocols.ydlidar.session import COMMANDS

BAUDS = (128_000, 115_200, 230_400, 512_000)
STOP, INFO, SCAN = b"\xa5\x00\xa5\x65", b"\xa5\x90", b"\xa5\x60"
MOST_LSN = 80
WIDTHS = (2, 3, 4)
"Bytes per sample."
MOST_BAD = 3
"Damaged packets in a row after which the width of samples is looked for again."
ANSWER_S = 0.4
START_S = 4.0
TRY_NS = 400_000_000


class Packet(NamedTuple):
    """One packet as a host reads it, before the correction of angles."""

    kind: int
    "CT"
    angle_deg: Floats
    words: NDArray[np.uint16]
    intensity: Floats | None
    "As sent, of 8 or 16 bits; None: two bytes a sample."


def decode_packet(data: bytes, width: int) -> Packet | None:
    """One packet with samples of so many bytes; None if its checksum is wrong."""
    size = data[3]
    raw = np.frombuffer(data, np.uint8, size * width, HEAD_BYTES).reshape(size, width).astype(np.uint16)
    words = raw[:, -2] | raw[:, -1] << 8
    levels = None if width == 2 else raw[:, 0] | (raw[:, 1] << 8 if width == 4 else 0)
    head = np.frombuffer(data, "<u2", HEAD_BYTES // 2)
    check = np.bitwise_xor.reduce(words) ^ (0 if levels is None else np.bitwise_xor.reduce(levels))
    if np.bitwise_xor.reduce(head) ^ check:
        return None
    first, last = float(head[2] >> 1) / 64.0, float(head[3] >> 1) / 64.0
    span = (last - first) % 360.0
    angle = first + np.arange(size) * (span / (size - 1) if size > 1 else 0.0)
    angle_deg, shown = np.asarray(angle, np.float64), None if levels is None else levels.astype(np.float64)
    return Packet(data[2], angle_deg, np.asarray(words, np.uint16), shown)


class StreamReader:
    """Packets and replies out of bytes in any chunking.

    Bytes per sample are found by the checksum and the packet that follows: zeros at its end have no part in the XOR.
    """

    def __init__(self, width: int | None = None) -> None:
        self._held = b""
        self._width = width
        self._bad = 0
        self.errors = 0
        "Beginnings of packets that were none, or damaged."

    def feed(self, data: bytes) -> Iterator[Packet | bytes]:
        """Packets, and replies as bytes, that are whole by now."""
        held = self._held + data
        at = 0
        while at + HEAD_BYTES <= len(held):
            if held.startswith(REPLY_SYNC, at):
                size = 7 + (int.from_bytes(held[at + 2 : at + 6], "little") & 0xFF)
                size = 7 if held[at + 5] >> 6 else size
                if at + size > len(held):
                    break
                yield held[at : at + size]
                at += size
            elif held.startswith(HEAD, at) and held[at + 4] & held[at + 6] & 1 and 1 <= held[at + 3] <= MOST_LSN:
                found, size = self._packet(held[at:])
                if found is None and size:
                    break
                if found is not None:
                    yield found
                self.errors += found is None
                at += size or 1
            else:
                marks = [place for mark in (HEAD, REPLY_SYNC) if (place := held.find(mark, at + 1)) >= 0]
                at = min(marks, default=max(at, len(held) - 1))
        self._held = held[at:]

    def _packet(self, data: bytes) -> tuple[Packet | None, int]:
        """A packet and its size; None and 0: there is none; None and more: bytes are missing."""
        known = self._width is not None
        for width in WIDTHS if self._width is None else (self._width,):
            size = HEAD_BYTES + data[3] * width
            if size + (0 if known else len(HEAD)) > len(data):
                return None, size
            found = decode_packet(data, width)
            if found is not None and (known or data[size : size + len(HEAD)] in (HEAD, REPLY_SYNC)):
                self._width, self._bad = width, 0
                return found, size
        self._bad += 1
        if self._bad > MOST_BAD:
            self._width = None
        return None, 0


def range_mm(packet: Packet, unit_mm: float) -> Floats:
    """Distances of a packet, NaN where there is no return; 3 bytes a sample have whole millimetres."""
    words: Any = packet.words.astype(np.float64)
    if packet.intensity is not None and packet.intensity.size and unit_mm != 1.0:
        words = (packet.words & 0xFFFC).astype(np.float64)
    return np.where(words > 0, words * unit_mm, np.nan)


@dataclass(frozen=True)
class View:
    """What a host needs to know of a device to read its packets."""

    title: str = "YDLIDAR (sends only)"
    unit_mm: float = 0.25
    triangulates: bool = True

    @classmethod
    def of(cls, reply: bytes) -> View | None:
        """From the device info; None: another reply."""
        if len(reply) != 27 or reply[6] != 0x04:
            return None
        code = reply[7]
        known = [one for one in MODELS.values() if one.code == code and one.answers]
        name = known[0].model.removeprefix("ydlidar-").upper() if known else f"model {code}"
        time_of_flight = code >= 100
        whole = time_of_flight and code not in (140, 150, 151)
        return cls(f"YDLIDAR {name}, firmware {reply[9]}.{reply[8]}", 1.0 if whole else 0.25, not time_of_flight)

    def add(self, turns: TurnAssembler, packet: Packet) -> Iterator[HostScan]:
        """Turns that a packet completes."""
        found = range_mm(packet, self.unit_mm)
        angle = packet.angle_deg
        if self.triangulates:
            angle = angle + correction_deg(np.nan_to_num(found))
        # where a turn ends is reported by the rotor's own angles: corrected ones go back and forth
        yield from turns.add(packet.angle_deg, found / 1000.0, packet.intensity, angle)


class YdlidarHost:
    """Connects in the constructor; raises `LinkError` when nothing answers or sends."""

    def __init__(self, line: Line, baud: int | None) -> None:
        """`baud`: line speed tried first; None: the device is asked for its name alone, and left as it is."""
        self._line, self._reader, self._clock = line, StreamReader(), SystemClock()
        self._view: View | None = None
        self.listens = self._asked = False
        self.found_baud: int | None = None
        speeds = [None] if isinstance(line, SocketLine) else [*([] if baud is None else [baud]), *BAUDS]
        for speed in list(dict.fromkeys(speeds)) * (1 if baud is None else 2):
            if speed is not None:
                line.set_baud(speed)
            line.write(INFO if baud is None else STOP)
            if self._find(baud is None):
                self.found_baud = speed
                break
        else:
            raise LinkError("no YDLIDAR answers 90, or sends")
        assert self._view is not None
        self.title = self._view.title
        if baud is not None and not self.listens:
            self._asked = True
            line.write(SCAN)

    def _find(self, asked: bool) -> bool:
        reader, heard = StreamReader(), 0
        for again in (False, True):
            end_ns = self._clock.now_ns() + round(1e9 * ANSWER_S / 2)
            while (left_ns := end_ns - self._clock.now_ns()) > 0:
                for item in reader.feed(self._line.read(left_ns / 1e9)):
                    if isinstance(item, bytes):
                        self._view = View.of(item) or self._view
                    heard += not isinstance(item, bytes)
                    if self._view is not None:
                        return True
            if not again and not asked:  # the stream has ended: now it answers
                self._line.write(INFO)
                heard = 0
        self._view, self.listens = (View(), True) if heard else (None, False)
        return bool(heard)

    @property
    def errors(self) -> int:
        """Damaged packets so far."""
        return self._reader.errors

    def scans(self, timeout_s: float) -> Iterator[HostScan | None]:
        """Turns as they are complete; None when nothing came for `timeout_s`."""
        assert self._view is not None
        turns = TurnAssembler()
        while True:
            data = self._line.read(timeout_s)
            for item in self._reader.feed(data):
                if not isinstance(item, bytes):
                    yield from self._view.add(turns, item)
            if not data:
                yield None

    def close(self) -> None:
        """Stop the stream and hang up."""
        if self._asked:
            try:
                self._line.write(STOP)
            except LineClosed:
                pass  # it has gone already
        self._line.close()


class YdlidarScript:
    """A host in virtual time: stop, device info, scan; at the next speed when nothing comes."""

    def __init__(self, line: HostEnd, on_scan: Callable[[int, HostScan], None]) -> None:
        self._line, self._on_scan = line, on_scan
        self._reader, self._turns = StreamReader(), TurnAssembler()
        self._view: View | None = None
        self._tries = self._heard = 0
        self._again_ns = 0

    def step(self, now_ns: int) -> int | None:
        """Read, decode, ask; when to be called again."""
        for item in self._reader.feed(self._line.read()):
            if not isinstance(item, bytes):
                self._heard += 1
                if self._view is not None:
                    self._again_ns = now_ns + SILENCE_NS
                    for scan in self._view.add(self._turns, item):
                        self._on_scan(now_ns, scan)
            elif self._view is None and (view := View.of(item)) is not None:
                self._view, self._again_ns = view, now_ns + SILENCE_NS
                self._line.write(SCAN, now_ns)
        if now_ns >= self._again_ns:
            self._ask(now_ns)
        return self._again_ns

    def _ask(self, now_ns: int) -> None:
        if self._view is None and self._heard:  # it sends and does not answer
            self._view, self._again_ns = View(), now_ns + SILENCE_NS
            return
        self._line.baud = BAUDS[self._tries % len(BAUDS)]
        self._tries, self._heard, self._view = self._tries + 1, 0, None
        self._reader, self._turns = StreamReader(), TurnAssembler(self._turns.count)
        self._line.write(STOP + INFO, now_ns)
        self._again_ns = now_ns + TRY_NS


def ydlidar_script(line: HostEnd, on_scan: Callable[[int, HostScan], None], device: Mapping[str, Any]) -> YdlidarScript:
    """For `lidaremu test`."""
    return YdlidarScript(line, on_scan)


def fields(speaker: Speaker, data: bytes, kind: str, peer: int, sent: bool) -> list[Described]:
    """Of commands, replies and packets."""
    if not sent:
        pairs = [data[at : at + 2] for at in range(0, len(data), 2)]
        names = [Described("command", f"{one.hex(' ')}: {COMMANDS[one].name}") for one in pairs if one in COMMANDS]
        return names or [unknown(data, "no command")]
    found: list[Described] = []
    for item in StreamReader().feed(data):
        if isinstance(item, bytes):
            found += [Described("reply", f"{item[6]:02x}"), Described("data", item[7:].hex(" "))]
            continue
        found += [Described("type", f"{item.kind:02x}", "zero packet" if item.kind & 1 else "samples")]
        found += [Described("angles", row_of(item.angle_deg, 2), "deg, before correction")]
        found += [Described("words", row_of(item.words.astype(float)))]
        if item.intensity is not None:
            found += [Described("intensities", row_of(item.intensity))]
    return found or [unknown(data, "no whole packet or reply")]
