"""Hosts in virtual time that come, go and misbehave, by a seeded script; and hosts that judge what they are sent.

On a serial line hosts follow each other, since they share it; on a stream a well-behaved one stays while others come
and go beside it; on a bus everybody speaks at once.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from emulator.endurance.scene import (
    COLA_BEAMS,
    COLA_RATE_HZ,
    DESK,
    DESK_WALL_M,
    LD_BEAMS,
    LD_RATE_HZ,
    LMS_BEAMS,
    LMS_RATE_HZ,
    STREET,
    WALL_M,
)
from emulator.hosts.cola import ColaScript
from emulator.hosts.families import BUILT_IN, found_at
from emulator.hosts.scans import HostScan
from emulator.hosts.scripted import LdScript, Lms2xxScript, Script
from protocols.ld.telegrams import payload_of
from protocols.ld.usp import encode_frame
from protocols.lms2xx.telegrams import request
from protocols.skeleton.cola_frames import frame
from protocols.skeleton.cola_values import ASCII, BINARY

SECOND_NS = 1_000_000_000
TIME_LIMIT_NS = 60 * SECOND_NS
"A well-behaved host has its first scan within this time of virtual or real seconds, whatever came before it."
RANGE_TOLERANCE_M = 0.3
FLOOD_NS = 500_000_000
"A flood of requests lasts so long, then its host is silent for the rest of its visit."


@dataclass
class Guestbook:
    """What well-behaved hosts got, and what the others did."""

    visits: Counter[str] = field(default_factory=Counter)
    clean_scans: int = 0
    faults: Counter[str] = field(default_factory=Counter)
    "What a well-behaved host found wrong; must stay empty."
    slowest_first_scan_s: float = 0.0


class HostEnd(Protocol):
    """A host's end of a link: in memory, a terminal or a socket."""

    baud: int | None

    def read(self) -> bytes: ...

    def write(self, data: bytes, at_ns: int) -> int: ...

    def close(self, at_ns: int) -> None: ...


class Reachable(Protocol):
    """A link that hosts can connect to."""

    def connect(self, at_ns: int = 0, baud: int | None = None) -> HostEnd: ...


class Judge:
    """Looks at every scan of one visit: its beams, its ranges, the time since the one before."""

    def __init__(
        self, book: Guestbook, beams: int, period_ns: float, came_ns: int, tongue: LineTongue | Tongue | None = None
    ) -> None:
        """`period_ns`: between two scans, to 2 % or as `tongue` has it; infinite where hosts read late."""
        self._book = book
        self._beams = tongue.beams if isinstance(tongue, LineTongue) else (beams,)
        self._period_ns = period_ns
        self._slack = (0.0, 0.02) if tongue is None else tongue.slack
        self._wall_m = WALL_M if tongue is None else tongue.wall_m
        self._came_ns = came_ns
        self._last_ns: int | None = None
        self.first_ns: int | None = None
        "When the first scan came."

    def __call__(self, now_ns: int, scan: HostScan) -> None:
        book = self._book
        range_m = scan.range_m
        if not any(abs(len(range_m) - beams) <= self._slack[0] * beams for beams in self._beams):
            book.faults[f"scan of {len(range_m)} beams"] += 1
            return
        # of five beams: one of 160 000 has an echo of noise alone before the wall's, as the device would have
        first = max(0, int(np.argmin(np.abs(scan.azimuth_rad))) - 2)
        ahead = np.sort(range_m[first : first + 5])[2]
        if not abs(ahead - self._wall_m) < RANGE_TOLERANCE_M:
            book.faults["wrong range"] += 1
        if self._last_ns is None:
            self.first_ns = now_ns
            book.slowest_first_scan_s = max(book.slowest_first_scan_s, (now_ns - self._came_ns) / 1e9)
        elif self._period_ns < np.inf and self._is_off(now_ns - self._last_ns):
            book.faults["gap between scans"] += 1
        self._last_ns = now_ns
        book.clean_scans += 1

    def _is_off(self, gap_ns: int) -> bool:
        return abs(gap_ns - self._period_ns) > self._slack[1] * self._period_ns


def noise(rng: np.random.Generator, size: int) -> bytes:
    """Random bytes."""
    return bytes(rng.integers(0, 256, size, dtype=np.uint8))


STATUS = request(b"\x31")
LD_IDENT = encode_frame(payload_of(0x0101, 0))


@dataclass(frozen=True)
class LineTongue:
    """What hosts of a family say on a serial line."""

    script: Callable[[HostEnd, Judge], Script]
    "The well-behaved one."
    beams: tuple[int, ...]
    "Any of them: a host may ask for another mode."
    rate_hz: float
    request: bytes
    "A whole one that costs the device a reply."
    bad: bytes
    "The same, damaged."
    speeds: tuple[int, ...] = (9600, 19_200, 38_400, 500_000)
    "Of hosts at a wrong speed; one of them may be the right one."
    slack: tuple[float, float] = (0.0, 0.02)
    "Shares by which beams and period may differ: a rotor turns freely, a turn ends with a packet."
    wall_m: float = WALL_M


LMS_TONGUE = LineTongue(Lms2xxScript, (LMS_BEAMS,), LMS_RATE_HZ, STATUS, STATUS[:-1] + b"\xff")
_FAST = (9600, 38_400, 115_200, 230_400, 500_000)


def _desk(name: str, beams: tuple[int, ...], rate_hz: float, request: bytes, bad: bytes) -> LineTongue:
    def script(line: HostEnd, judge: Judge) -> Script:
        line.baud = BAUD.get(name)
        made: Script = found_at(BUILT_IN[DESK[name][0].partition("-")[0].replace("hokuyo", "scip")].script or "")(
            line, judge, {}
        )
        return made

    return LineTongue(script, beams, rate_hz, request, bad, _FAST, (0.0 if name == "urg" else 0.05, 0.2), DESK_WALL_M)


BAUD = {"slam": 115_200, "ld": 230_400, "eai": 128_000}
DESK_TONGUES = {
    "urg": _desk("urg", (769,), 15.0, b"VV\n", b"VX\n"),
    "slam": _desk("slam", (281, 1125), 7.0, b"\xa5\x50", b"\xa5\x84\x04\x7c\0\0\0\0"),
    "ld": _desk("ld", (450,), 10.0, b"\x54\xa0\x04\0\0\0\0\x5e", b"\x54"),
    "eai": _desk("eai", (714,), 7.0, b"\xa5\x90", b"\xa5\xa5"),
}


class LineGuests:
    """Hosts of a serial line, one after the other."""

    KINDS = ("nobody", "half a telegram", "random bytes", "flood of requests", "wrong speed", "never reads",
             "flood of bad checksums", "breaks off in a telegram")  # fmt: skip

    def __init__(
        self,
        link: Reachable,
        rng: np.random.Generator,
        book: Guestbook,
        stay_s: tuple[float, float],
        period_ns: float | None = None,
        tongue: LineTongue = LMS_TONGUE,
    ) -> None:
        """`stay_s`: shortest and longest visit of a well-behaved host, beyond the time it may take to be served.

        `period_ns`: between two scans, None: that of the device.
        """
        self._tongue = tongue
        self._period_ns = SECOND_NS / tongue.rate_hz if period_ns is None else period_ns
        self._link = link
        self._rng = rng
        self._book = book
        self._stay_s = stay_s
        self._good: Script | None = None
        self._judge: Judge | None = None
        self._host: HostEnd | None = None
        self._until_ns = 0
        self._came_ns = 0
        self._stay_ns = 0
        self._next_ns = 0
        self._bad_turn = False
        self._act: Callable[[int], int] | None = None
        self._kind = ""

    def step(self, now_ns: int) -> int | None:
        """Read, write, come, go."""
        if self._good is not None:
            return self._step_good(now_ns)
        if now_ns >= self._until_ns:
            self._leave(now_ns)
            self._act = None
            if self._bad_turn:
                self._misbehave(now_ns)
            else:
                self._come(now_ns)
            self._bad_turn = not self._bad_turn
            return now_ns + 1
        if self._act is not None and now_ns >= self._next_ns:
            self._next_ns = self._act(now_ns)
        if self._host is not None and self._kind != "never reads":
            self._host.read()
        return min(self._until_ns, self._next_ns) if self._act is not None else self._until_ns

    def _step_good(self, now_ns: int) -> int | None:
        assert self._good is not None
        assert self._judge is not None
        wake = self._good.step(now_ns)
        first_ns = self._judge.first_ns
        self._until_ns = self._came_ns + TIME_LIMIT_NS if first_ns is None else first_ns + self._stay_ns
        if now_ns >= self._until_ns:
            if first_ns is None:
                self._book.faults["no scan in a visit"] += 1
            self._good = None
            return now_ns + 1
        return self._until_ns if wake is None else min(wake, self._until_ns)

    def _come(self, now_ns: int) -> None:
        self._book.visits["well-behaved"] += 1
        self._came_ns, self._stay_ns = now_ns, round(self._rng.uniform(*self._stay_s) * SECOND_NS)
        tongue = self._tongue
        self._judge = Judge(self._book, tongue.beams[0], self._period_ns, now_ns, tongue)
        self._host = self._link.connect(now_ns)
        self._good = tongue.script(self._host, self._judge)
        self._until_ns = now_ns + TIME_LIMIT_NS

    def _leave(self, now_ns: int) -> None:
        if self._host is not None:
            self._host.close(now_ns)
            self._host = None

    def _misbehave(self, now_ns: int) -> None:
        kind = self._kind = str(self._rng.choice(self.KINDS))
        self._book.visits[kind] += 1
        self._until_ns = now_ns + round(self._rng.uniform(0.5, min(10.0, self._stay_s[1])) * SECOND_NS)
        self._next_ns = now_ns
        baud = int(self._rng.choice(self._tongue.speeds)) if kind == "wrong speed" else None
        host = self._host = None if kind == "nobody" else self._link.connect(now_ns, baud)
        rng, request, bad = self._rng, self._tongue.request, self._tongue.bad

        def act(at_ns: int) -> int:
            pause_ns = 20_000_000
            if host is None or kind == "never reads":
                return at_ns + 10 * SECOND_NS
            if kind in ("half a telegram", "breaks off in a telegram"):
                host.write(request[: int(rng.integers(1, len(request)))], at_ns)
                return at_ns + round(rng.uniform(0.001, 0.1) * SECOND_NS)
            if kind == "wrong speed":
                host.write(request + noise(rng, 8), at_ns)
                return at_ns + SECOND_NS // 2
            if kind == "flood of requests":
                host.write(request * 100, at_ns)  # 50 000 bytes per second, as fast as the line can be
            elif kind == "flood of bad checksums":
                host.write(bad * 100, at_ns)
            else:
                host.write(noise(rng, 1000), at_ns)
            return at_ns + pause_ns

        self._act = act


@dataclass(frozen=True)
class Tongue:
    """What hosts of a family say on TCP."""

    script: Callable[[HostEnd, Judge], Script]
    "The well-behaved one."
    beams: int
    rate_hz: float
    request: bytes
    "A whole one that costs the device a reply."
    subscribe: bytes
    "Asked by a host that goes at once."
    huge: bytes
    "The beginning of a telegram whose length field is absurd."
    slack: tuple[float, float] = (0.0, 0.02)
    "Shares by which beams and period may differ: a turn ends with a packet."
    wall_m: float = WALL_M


LD_TONGUE = Tongue(
    LdScript, LD_BEAMS, LD_RATE_HZ, LD_IDENT, encode_frame(payload_of(0x0301, 3, 0x0A)), b"\x02USP\xff\xff\xff\xff"
)
COLA_TONGUE = Tongue(
    ColaScript, COLA_BEAMS, COLA_RATE_HZ, frame(BINARY, b"sRN DeviceIdent"), frame(ASCII, b"sEN LMDscandata 1"),
    b"\x02\x02\x02\x02\xff\xff\xff\xff",
)  # fmt: skip


def _street(name: str, beams: int, request: bytes, stream: bytes, huge: bytes) -> Tongue:
    def script(line: HostEnd, judge: Judge) -> Script:
        def turned(now_ns: int, scan: HostScan) -> None:
            if scan.number:  # it joins in the middle of a turn
                judge(now_ns, scan)

        made: Script = found_at(BUILT_IN[STREET[name][0].partition("-")[0]].script or "")(line, turned, {})
        return made

    return Tongue(script, beams, 10.0, request, b"GET " + stream + b" HTTP/1.1\r\n\r\n", huge, (0.05, 0.3))


_HUGE = b"POST /cgi/setting HTTP/1.1\r\nContent-Length: 4294967295\r\n\r\n"
STREET_TONGUES = {
    "velo": _street("velo", 1808, b"GET /cgi/status.json HTTP/1.1\r\n\r\n", b"/packets", _HUGE),
    "oust": _street("oust", 512, b"GET /api/v1/sensor/telemetry HTTP/1.1\r\n\r\n", b"/packets",
                    _HUGE.replace(b"cgi/setting", b"api/v1/sensor/config")),
    "hesa": _street("hesa", 2000, b"\x47\x74\x07\0\0\0\0\0", b"/point_cloud", b"\x47\x74\x20\0\xff\xff\xff\xff"),
}  # fmt: skip


class StreamGuests:
    """Hosts of a sensor on TCP: a well-behaved one that stays, and others beside it."""

    KINDS = ("silent", "half a frame", "random bytes", "flood of requests", "never reads", "huge length",
             "asks and goes")  # fmt: skip

    def __init__(
        self,
        link: Reachable,
        rng: np.random.Generator,
        book: Guestbook,
        period_ns: float | None = None,
        tongue: Tongue = LD_TONGUE,
    ) -> None:
        """`period_ns`: between two scans, None: that of the device; infinite where hosts read when they get round."""
        self._tongue = tongue
        self._link = link
        self._rng = rng
        self._book = book
        period_ns = SECOND_NS / tongue.rate_hz if period_ns is None else period_ns
        self._judge = Judge(book, tongue.beams, period_ns, 0, tongue)
        self._good = tongue.script(link.connect(0), self._judge)
        book.visits["well-behaved"] += 1
        self._other: HostEnd | None = None
        self._kind = ""
        self._came_ns = 0
        self._until_ns = 0
        self._next_ns = 0

    def step(self, now_ns: int) -> int | None:
        """Read, write, come, go."""
        wake = self._good.step(now_ns)
        if now_ns >= self._until_ns:
            self._change(now_ns)
        if self._other is not None:
            if self._kind != "never reads":
                self._other.read()
            if now_ns >= self._next_ns:
                self._next_ns = now_ns + self._act(self._other, now_ns)
        wakes = [self._until_ns, *([] if self._other is None else [self._next_ns]), *([] if wake is None else [wake])]
        return min(wakes)

    def _change(self, now_ns: int) -> None:
        if self._other is not None:
            self._other.close(now_ns)
            self._other = None
            self._until_ns = now_ns + round(self._rng.uniform(1.0, 30.0) * SECOND_NS)
            return
        self._kind = str(self._rng.choice(self.KINDS))
        self._book.visits[self._kind] += 1
        self._other = self._link.connect(now_ns)
        self._came_ns = now_ns
        self._until_ns = now_ns + round(self._rng.uniform(0.1, 8.0) * SECOND_NS)
        self._next_ns = now_ns

    def _act(self, host: HostEnd, now_ns: int) -> int:
        rng, request = self._rng, self._tongue.request
        if self._kind == "half a frame":
            host.write(request[: int(rng.integers(1, len(request)))], now_ns)
            return round(rng.uniform(0.01, 2.0) * SECOND_NS)
        if self._kind == "random bytes":
            host.write(noise(rng, 1000), now_ns)
        elif self._kind == "flood of requests":
            host.write(request * 50, now_ns)
            if now_ns >= self._came_ns + FLOOD_NS:
                return 10 * SECOND_NS
        elif self._kind == "huge length":
            host.write(self._tongue.huge + noise(rng, 100), now_ns)
        elif self._kind == "asks and goes":
            host.write(self._tongue.subscribe, now_ns)
            return 10 * SECOND_NS
        else:
            return 10 * SECOND_NS
        return SECOND_NS // 50
