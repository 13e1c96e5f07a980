"""Hosts of SICK's CoLa scanners: one on an open line for `look`, `probe` and `view`, one in virtual time for `test`.

Belongs here: start-up, decoding of LMDscandata, giving up. Not: bytes (protocols.cola).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from emulator.errors import LinkError
from emulator.hosts.lines import Line, LineClosed, SocketLine
from emulator.hosts.scans import HostScan
from emulator.hosts.scripted import Connection, HostEnd
from emulator.process.clock import SystemClock
from protocols.cola.commands import VARIABLES
from protocols.cola.layouts import LAYOUT
from protocols.cola.settings import AUTHORISED, PASSWORDS
from protocols.scan import Floats
from protocols.skeleton.cola_frames import ColaSplitter, frame
from protocols.skeleton.cola_values import ASCII, BINARY, Rejected, decode, encode, short_hash

LONGEST = 1 << 19
REPLY_S, REPEAT_S = 2.0, 0.4
"A device that is just being switched on hears the first requests not at all: its name is asked for again."
STARTS_S, LOOK_S = 60.0, 0.25
"An LMS1xx may need so long until it measures; how often it is asked."
MEASURES = 7
"STlms."
BAUDS = (57_600, 115_200, 38_400, 19_200, 9_600)
"Speeds of a serial line, the one as delivered first."
OTHER_S = 0.9
"So long a device is asked at each of the others."
SILENCE_NS, AGAIN_NS = 2_000_000_000, 500_000_000
STATUS = str(VARIABLES["STlms"].layout)
DAZZLED = 15
"Values up to this one are no distances."
LISTENING = "CoLa device that answers nothing (listening)"


class Silent(LinkError):
    """No answer came."""


def exact_step(wire: int) -> float:
    """A step as devices make it: the wire rounds sixths of a degree. [1/10000 deg]"""
    sixths = round(wire * 6 / 10_000)
    return sixths * 10_000 / 6 if sixths and round(sixths * 10_000 / 6) == wire else float(wire)


def read_scan(number: int, dialect: bytes, data: bytes) -> HostScan | None:
    """A scan out of the arguments of LMDscandata; None: they are none, or have no first echo."""
    try:
        values = decode(LAYOUT, dialect, data)
    except Rejected:
        return None
    channels = {str(one[0]): one for one in [*values[17], *values[18]]}
    if "DIST1" not in channels:
        return None
    _, scale, offset, start, step, counts = channels["DIST1"]
    directions = start + np.arange(len(counts)) * exact_step(step)
    range_m = np.where(counts > DAZZLED, (counts * scale + offset) / 1000.0, np.nan)
    rssi = channels.get("RSSI1")
    strength: Floats | None = None
    if rssi is not None and len(rssi[5]) == len(counts):
        strength = np.where(counts > DAZZLED, rssi[5].astype(float), np.nan)
    layer = values[13]
    detail = f"telegram {values[5]}" + (f", layer {-layer / 100:+.1f} deg" if layer else "")
    return HostScan(number, np.radians(directions / 1e4 - 90.0), range_m, detail, strength)


class Reader:
    """Telegrams out of bytes in any chunking."""

    def __init__(self) -> None:
        self._splitter = ColaSplitter(LONGEST)
        self.errors = 0

    def feed(self, data: bytes) -> Iterator[tuple[bytes, bytes, bytes, bytes]]:
        """Dialect, head (`sSN`), name and arguments of what is whole by now."""
        for item in self._splitter.feed(data):
            if not isinstance(item, bytes):
                self.errors += 1
                continue
            head, _, rest = item[1:].partition(b" ")
            name, _, arguments = rest.partition(b" ")
            yield item[:1], head, name, arguments


class ColaHost:
    """Connects in the constructor; raises `LinkError` when nothing answers. It speaks CoLa-B on TCP, else CoLa-A."""

    def __init__(self, line: Line, baud: int | None, listen: bool = False) -> None:
        """`baud`: where its serial line is tried first; None: it is asked for its name alone, and left as it is."""
        self._line, self._reader, self._clock = line, Reader(), SystemClock()
        self._dialect = BINARY if isinstance(line, SocketLine) else ASCII
        self._scans: list[HostScan] = []
        self._count = 0
        self._streams = False
        self.listens, self.title = listen, LISTENING
        speeds = () if isinstance(line, SocketLine) else tuple(dict.fromkeys((baud or BAUDS[0], *BAUDS)))
        self.found_baud = speeds[0] if speeds else None
        if self.found_baud is not None:
            line.set_baud(self.found_baud)
        if listen:
            return
        try:
            answer = self._find(speeds) if speeds else self._ask(b"sRN DeviceIdent", again_s=REPEAT_S)
            name, version = (str(word).strip() for word in decode("str str", self._dialect, answer))
        except (LineClosed, Rejected):
            raise LinkError("no CoLa device answers") from None
        self.title = f"{name} {version}"
        if baud is None:
            return
        self._ask(
            b"sMN SetAccessMode", encode("u8 u32", self._dialect, [AUTHORISED, short_hash(PASSWORDS[AUTHORISED])])
        )
        self._ask(b"sMN LMCstartmeas")
        self._ask(b"sMN Run")
        self._wait_until_it_measures()
        self._ask(b"sEN LMDscandata", encode("u8", self._dialect, [1]))
        self._streams = True

    @property
    def errors(self) -> int:
        """Damaged telegrams so far."""
        return self._reader.errors

    def scans(self, timeout_s: float) -> Iterator[HostScan | None]:
        """Scans as they arrive; None when none came for `timeout_s`."""
        while True:
            end_ns = self._clock.now_ns() + int(timeout_s * 1e9)
            while not self._scans and (left_ns := end_ns - self._clock.now_ns()) > 0:
                self._take(left_ns * 1e-9)
            if self._scans:
                yield self._scans.pop(0)
            else:
                yield None

    def close(self) -> None:
        """Stop the stream and hang up."""
        try:
            if self._streams:
                self._ask(b"sEN LMDscandata", encode("u8", self._dialect, [0]))
        except LinkError:
            pass  # it has gone, or is silent
        self._line.close()

    def _find(self, speeds: tuple[int, ...]) -> bytes:
        """Arguments of the name, at the first of those speeds at which the device answers at all."""
        for speed in speeds:
            self._line.set_baud(speed)
            self.found_baud = speed
            try:
                return self._ask(b"sRN DeviceIdent", b"", REPEAT_S, REPLY_S if speed == speeds[0] else OTHER_S)
            except Silent:
                self._reader = Reader()
        raise LinkError(f"no CoLa device answers at {', '.join(map(str, speeds))} baud")

    def _wait_until_it_measures(self) -> None:
        """Scans come when the mirror is at speed; a device without STlms is not waited for."""
        end_ns = self._clock.now_ns() + int(STARTS_S * 1e9)
        try:
            while self._clock.now_ns() < end_ns:
                status = decode(STATUS, self._dialect, self._ask(b"sRN STlms"))
                if status[0] == MEASURES:
                    return
                self._take(LOOK_S)
        except (LinkError, Rejected):
            return

    def _ask(self, request: bytes, arguments: bytes = b"", again_s: float = REPLY_S, reply_s: float = REPLY_S) -> bytes:
        """Arguments of the answer, `LinkError` if the device refuses, `Silent` when none comes within `reply_s`.

        Asked again every `again_s`.
        """
        wanted = request.partition(b" ")[2]
        end_ns = self._clock.now_ns() + int(reply_s * 1e9)
        next_ns = self._clock.now_ns()
        while (now_ns := self._clock.now_ns()) < end_ns:
            if now_ns >= next_ns:
                self._line.write(frame(self._dialect, request + (b" " + arguments if arguments else b"")))
                next_ns += int(again_s * 1e9)
            for head, name, data in self._take((min(end_ns, next_ns) - now_ns) * 1e-9):
                if head.startswith(b"sFA"):
                    raise LinkError(f"the device refuses {request.decode()}")
                if name == wanted and head != b"sSN":
                    return data
        raise Silent(f"no reply to {request.decode()}")

    def _take(self, timeout_s: float) -> list[tuple[bytes, bytes, bytes]]:
        found = []
        for dialect, head, name, data in self._reader.feed(self._line.read(max(0.0, timeout_s))):
            if name == b"LMDscandata" and head == b"sSN":
                scan = read_scan(self._count, dialect, data)
                self._reader.errors += scan is None
                if scan is not None:
                    self._scans.append(scan)
                    self._count += 1
            else:
                found.append((head, name, data))
        return found


class ColaScript:
    """A host in virtual time: subscribes in CoLa-B, and again when nothing comes."""

    def __init__(self, line: HostEnd, on_scan: Callable[[int, HostScan], None]) -> None:
        self._line, self._on_scan, self._reader = line, on_scan, Reader()
        self._connection = line if isinstance(line, Connection) else None
        self._again_ns, self._count = 0, 0

    def step(self, now_ns: int) -> int | None:
        """Read, decode, ask again; when to be called again."""
        for dialect, head, name, data in self._reader.feed(self._line.read()):
            if head == b"sSN" and name == b"LMDscandata":
                scan = read_scan(self._count, dialect, data)
                if scan is not None:
                    self._on_scan(now_ns, scan)
                    self._count += 1
                    self._again_ns = now_ns + SILENCE_NS
        if now_ns >= self._again_ns:
            line = self._connection
            if line is None or line.connected or line.reconnect(now_ns):
                self._line.write(frame(BINARY, b"sEN LMDscandata \x01"), now_ns)
            self._again_ns = now_ns + AGAIN_NS
        return self._again_ns


def cola_script(line: HostEnd, on_scan: Callable[[int, HostScan], None], device: Mapping[str, Any]) -> ColaScript:
    """For `lidaremu test`."""
    return ColaScript(line, on_scan)
