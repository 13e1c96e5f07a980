"""A host for the SICK LD-LRS and its relatives: brings the head to speed, asks for profiles, decodes them.

Speaks to a TCP port (USP frames) and to a serial line (ASCII-hex packages). A device found measuring is left measuring.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from enum import IntEnum
from typing import NamedTuple, Protocol

import numpy as np

from emulator.errors import LinkError
from emulator.hosts.lines import Line, LineClosed, SocketLine
from emulator.hosts.scans import HostScan
from emulator.process.clock import SystemClock
from protocols.ld.packages import Package, PackageJoiner, PackageReader, encode_packages, swapped
from protocols.ld.profiles import RANGE_LSB_PER_M, Field
from protocols.ld.sectors import TICKS, MeasureError
from protocols.ld.telegrams import GET_PROFILE_REPLY, REPLY_BIT, SERVICE_FAILURE, Mode, Motor, payload_of, words_of
from protocols.ld.usp import UspReader, encode_frame
from protocols.scan import Floats

Words = Sequence[int]

FORM = 0x39FF
"Everything but amplitudes and single directions: what sicktoolbox asks for, so that any device has been asked for it."
FORM_WITH_ECHO = FORM | Field.ECHO
"The same with amplitudes, for colours; asked for first on a network."
FORM_SLOW = Field.SECTORNUM | Field.DIRSTEP | Field.POINTNUM | Field.STARTDIR | Field.DISTANCE
"On a serial line, which is slow."
REPLY_S = 5.0
SPIN_UP_S = 15.0
"sicktoolbox waits five seconds for the head, Miro and the Stanford module ten."
BAUDS = (115_200, 57_600, 38_400, 19_200, 9_600, 4_800)
SENSOR_ID = 0x10
"Sensor ID of a device as it is delivered; Miro's."
HOST_ID = 0x14
"As COMTEST calls itself."
LONGEST_PROFILE = 4 * TICKS * 3 + 1024


MOST_HEARD = 500
LISTENING = "LD that answers nothing (listening)"


class Framing(Protocol):
    """How messages travel on one kind of line."""

    def pack(self, payload: bytes) -> bytes: ...

    def feed(self, data: bytes) -> list[bytes]:
        """Whole messages; damaged ones are passed over."""

    @property
    def errors(self) -> int:
        """Damaged frames or packages so far."""


class UspFraming:
    """TCP."""

    def __init__(self) -> None:
        self._reader = UspReader(LONGEST_PROFILE)
        self.errors = 0

    def pack(self, payload: bytes) -> bytes:
        return encode_frame(payload)

    def feed(self, data: bytes) -> list[bytes]:
        items = self._reader.feed(data)
        whole = [item for item in items if isinstance(item, bytes)]
        self.errors += len(items) - len(whole)
        return whole


class PackageFraming:
    """RS-232 and RS-422."""

    def __init__(self, sensor_id: int = SENSOR_ID) -> None:
        self._address = HOST_ID << 8 | sensor_id
        self._reader = PackageReader()
        self._joiner = PackageJoiner()
        self.errors = 0

    def pack(self, payload: bytes) -> bytes:
        return encode_packages(payload, self._address).upper()

    def feed(self, data: bytes) -> list[bytes]:
        found = []
        for package in self._reader.feed(data):
            self.errors += not isinstance(package, Package)
            if isinstance(package, Package) and package.address == swapped(self._address):
                message = self._joiner.add(package)
                if isinstance(message, bytes):
                    found.append(message)
        return found


class Refused(LinkError):
    """The device has answered that it refuses."""


class LdHost:
    """Connects in the constructor; raises `LinkError` when nothing answers, or the device will not measure.

    Where profiles come and nobody answers, as from a recording that is sent again, it listens.
    """

    def __init__(self, line: Line, baud: int | None, listen: bool = False) -> None:
        """`baud`: line speed to go to; None: the device is asked for its name alone, and left as it is."""
        self._line = line
        self._clock = SystemClock()
        self._framing: Framing = UspFraming() if isinstance(line, SocketLine) else PackageFraming()
        self._messages: deque[tuple[int, ...]] = deque()
        self._form = int(FORM_WITH_ECHO) if isinstance(line, SocketLine) else int(FORM_SLOW)
        self._heard: deque[tuple[int, ...]] = deque(maxlen=MOST_HEARD)
        "Profiles that came while something else was waited for."
        self._leave = baud is None
        self.found_baud: int | None = None
        "Line speed that the device had; None: of a line without one."
        self.listens = listen
        self._found: int | None = None
        "Mode in which the device was found."
        self.title = LISTENING
        if listen:
            line.set_baud(baud or BAUDS[0])
            return
        try:
            self._connect(baud)
        except (LineClosed, Refused):
            raise
        except LinkError:
            if not self._heard:
                raise
            self.listens = True  # a recording has replies too, to what was asked then

    def _connect(self, baud: int | None) -> None:
        self._find(baud)
        if self.listens:
            return
        self._heard.clear()
        name = b"".join(word.to_bytes(2, "big") for word in self._ask(0x0101, 1)[1:7])
        title = name.partition(b"\0")[0].decode("ascii", "replace").strip() or "LD"
        if self._leave:
            self.title = title
            return
        self._found = self._ask(0x0102)[2] & 0xF
        if self._found != Mode.MEASURE:
            self._ask(0x0403, 0, seconds=SPIN_UP_S)
            verdict = self._ask(0x0404, seconds=SPIN_UP_S)[3]
            if verdict:
                reported = name_of(MeasureError, verdict)
                raise Refused(f"the device refuses to measure: error {verdict} ({reported})")
        self._send(0x0301, 0, self._form)
        self.title = title

    @property
    def errors(self) -> int:
        """Damaged frames or packages so far."""
        return self._framing.errors

    def scans(self, timeout_s: float) -> Iterator[HostScan | None]:
        """Scans as they arrive; None when none came for `timeout_s`."""
        number = 0
        while True:
            words = self._heard.popleft() if self.listens and self._heard else self._next(timeout_s)
            if words is None:
                yield None
            elif self.listens:
                profile = read_profile(words) if words[0] == GET_PROFILE_REPLY else None
                if profile is not None:
                    yield HostScan(number, profile.azimuth_rad, profile.range_m, status_text(words), profile.amplitude)
                    number += 1
            elif words[0] == SERVICE_FAILURE:
                if self._form != FORM_WITH_ECHO:
                    raise LinkError("the device refuses to send profiles")
                self._form = FORM
                self._send(0x0301, 0, self._form)
            elif words[:2] in ((GET_PROFILE_REPLY, self._form), (GET_PROFILE_REPLY, FORM)):
                profile = read_profile(words)
                if profile is not None:
                    yield HostScan(number, profile.azimuth_rad, profile.range_m, status_text(words), profile.amplitude)
                    number += 1

    def close(self) -> None:
        """Stop the profiles and leave the device in the mode in which it was found."""
        try:
            if not (self.listens or self._leave):
                self._ask(0x0302)
            if self._found in (Mode.IDLE, Mode.ROTATE):
                self._ask(0x0403, 0)
            if self._found == Mode.IDLE:
                self._ask(0x0402)
        except LinkError:
            pass  # a device that has gone need not be left tidy
        self._line.close()

    def _find(self, baud: int | None) -> None:
        """End profiles of an earlier host; on a serial line, at whatever speed the device has."""
        if isinstance(self._line, SocketLine):
            try:
                self._cancel(REPLY_S)
            except LineClosed:
                raise
            except LinkError:
                if not self._heard:
                    raise
                self.listens = True
            return
        for tried in dict.fromkeys((BAUDS[0], baud or BAUDS[0], *BAUDS)):
            if tried in BAUDS:
                self.found_baud = tried
                self._line.set_baud(tried)
                self._line.flush_input()
                try:
                    self._cancel(1.5)
                    return
                except LineClosed:
                    raise
                except LinkError:
                    if not self._heard:
                        continue
                    self.listens = True
                    return
        raise LinkError(f"no LD answers at {', '.join(map(str, BAUDS))} baud")

    def _send(self, *words: int) -> None:
        self._line.write(self._framing.pack(payload_of(*words)))

    def _cancel(self, seconds: float) -> None:
        """End profiles; a device that is not measuring has none, and says that it fails."""
        self._ask(0x0302, seconds=seconds, may_fail=True)

    def _ask(self, *words: int, seconds: float | None = None, may_fail: bool = False) -> tuple[int, ...]:
        """Send a request; the words of its reply. Profiles on the way are passed over.

        `may_fail`: SERVICE_FAILURE is a reply too.
        """
        self._send(*words)
        wanted = words[0] | REPLY_BIT
        end_ns = self._clock.now_ns() + int((REPLY_S if seconds is None else seconds) * 1e9)
        while (left_ns := end_ns - self._clock.now_ns()) > 0:
            reply = self._next(left_ns * 1e-9)
            if reply is not None and reply[0] == GET_PROFILE_REPLY:
                self._heard.append(reply)
            if reply is not None and (reply[0] == wanted or (may_fail and reply[0] == SERVICE_FAILURE)):
                return (*reply, *(0,) * (8 - len(reply)))  # a short one reads as zeros
            if reply is not None and reply[0] == SERVICE_FAILURE:
                raise Refused(f"the device refuses service {words[0]:04X}")
        raise LinkError(f"no reply to service {words[0]:04X}")

    def _next(self, timeout_s: float) -> tuple[int, ...] | None:
        """The next message; None when there is none in time."""
        end_ns = self._clock.now_ns() + int(timeout_s * 1e9)
        while not self._messages:
            left_ns = end_ns - self._clock.now_ns()
            data = self._line.read(max(0, left_ns) * 1e-9)
            if not data and left_ns <= 0:
                return None
            self._messages.extend(filter(None, map(words_of, self._framing.feed(data))))
        return self._messages.popleft()


class Profile(NamedTuple):
    """What a profile's points are, (n,) each, in the device's order."""

    azimuth_rad: Floats
    "Positive to the left, in [-pi, pi)."
    range_m: Floats
    "NaN without an echo."
    amplitude: Floats | None
    "NaN without an echo; None: not in this format."


def read_profile(words: Words, zero_rad: float = 0.0) -> Profile | None:
    """Points of a profile in any format that has step, points, first direction and distance of a sector.

    `zero_rad`: azimuth of the device's direction 0. None: the words do not hold what the format says.
    """
    if len(words) < 3:
        return None
    form, sectors = Field(words[1] & 0x3FFF), words[2] & 0xFF
    at = 3 + (form & 0x0007).bit_count()
    columns = (form & (Field.DISTANCE | Field.DIRECTION | Field.ECHO)).bit_count()
    tail = (form & (Field.TEND | Field.ENDDIR)).bit_count()
    before = [kind for kind in SECTOR_HEAD if kind in form]
    if not NEEDED <= set(before) or Field.DISTANCE not in form:
        return None
    ticks, counts, peaks = [], [], []
    for _ in range(sectors):
        head = dict(zip(before, words[at : at + len(before)], strict=False))
        at += len(before)
        points = head.get(Field.POINTNUM, 0)
        block = words[at : at + columns * points]
        at += columns * points + tail
        if len(head) < len(before) or at > len(words):
            return None
        if points:
            ticks.append(head[Field.STARTDIR] + head[Field.DIRSTEP] * np.arange(points))
            counts.append(np.array(block[::columns], np.float64))
            peaks.append(np.array(block[columns - 1 :: columns], np.float64))  # the echo is the last of a point's words
    clockwise = np.concatenate([np.zeros(0), *ticks])
    range_m = np.concatenate([np.zeros(0), *counts]) / RANGE_LSB_PER_M
    left = (TICKS / 2 - clockwise + zero_rad * (TICKS / (2.0 * np.pi))) % TICKS - TICKS / 2
    seen = range_m > 0.0
    amplitude = np.where(seen, np.concatenate([np.zeros(0), *peaks]), np.nan) if Field.ECHO in form else None
    return Profile(left * (2.0 * np.pi / TICKS), np.where(seen, range_m, np.nan), amplitude)


SECTOR_HEAD = (Field.SECTORNUM, Field.DIRSTEP, Field.POINTNUM, Field.TSTART, Field.STARTDIR)
"Fields before the points of a sector, in their order."
NEEDED = {Field.DIRSTEP, Field.POINTNUM, Field.STARTDIR}


def status_text(words: Words) -> str:
    """Mode and motor at the end of a profile that has them."""
    if not words[1] & Field.SENSTAT:
        return ""
    mode, motor = words[-1] & 0xF, words[-1] >> 4 & 0xF
    return name_of(Mode, mode) if motor == Motor.OK else f"{name_of(Mode, mode)}, motor {name_of(Motor, motor)}"


def name_of(kind: type[IntEnum], code: int) -> str:
    """The name of a code; the code itself when it is none of ours."""
    try:
        return kind(code).name.lower().replace("_", " ")
    except ValueError:
        return f"code {code:X}"
