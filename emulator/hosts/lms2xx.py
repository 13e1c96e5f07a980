"""A host for the SICK LMS2xx: finds the line speed, asks for a stream, decodes it."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from emulator.errors import LinkError
from emulator.hosts.lines import Line, LineClosed, SocketLine
from emulator.hosts.scans import HostScan
from emulator.process.clock import SystemClock
from protocols.lms2xx.telegrams import MeasuredValues, Telegram, open_frame, read_values, request
from protocols.lms2xx.values import COUNTS_PER_METRE, MEASURING_MODES, MeasuringMode
from protocols.receive_buffer import ReceiveBuffer
from protocols.scan import Floats

RATE_CODES = {500_000: 0x48, 38_400: 0x40, 19_200: 0x41, 9_600: 0x42}
"Line speed -> sub-code of command 20."

HEADER_BYTES, OTHER_BYTES = 4, 6
MAX_PAYLOAD = 820
SECONDS_FOR_A_REPLY = 3.5
"A mode change may take three seconds."
FINDING_S = 0.8
"For each of two tries at each speed: a telegram of a stream at 9600 baud, which ends before the reply, lasts 0.76 s."


MOST_HEARD = 500
ENOUGH = 3
"Telegrams of values after a stop was acknowledged: one may have been on its way."
FOLLOW_S = 1.0
"A listener stays so long at a speed at which nothing is understood: the slowest stream sends a telegram in that time."
STATUS_BYTES = 110
"Of B1, up to the step."


class TelegramReader:
    """Finds a device's telegrams in a stream of bytes that may begin and break off anywhere."""

    def __init__(self) -> None:
        self._buffer = ReceiveBuffer(4 * MAX_PAYLOAD)
        self._more = b""
        self._enough = 0
        "Bytes of the telegram that has begun: with fewer there is nothing to find."
        self.errors = 0
        "Telegrams with a wrong CRC so far."

    def feed(self, data: bytes) -> None:
        """Bytes as they came."""
        self._more += data

    def take(self) -> Telegram | None:
        """The next telegram with a good CRC; None until more has come."""
        while True:
            self._more = self._more[self._buffer.add(self._more) :]
            telegram = self._next()
            if telegram is not None or not self._more:
                return telegram

    def _next(self) -> Telegram | None:
        if len(self._buffer) < self._enough:
            return None
        self._enough = 0
        while True:
            self._buffer.skip_to(b"\x02")
            head = self._buffer.peek(HEADER_BYTES)
            if head is None:
                return None
            length = int.from_bytes(head[2:4], "little")
            if not head[1] & 0x80 or not 1 <= length <= MAX_PAYLOAD:
                self._buffer.take(1)
                continue
            whole = self._buffer.peek(length + OTHER_BYTES)
            if whole is None:
                self._enough = length + OTHER_BYTES
                return None
            telegram = open_frame(whole)
            self._buffer.take(1 if telegram is None else len(whole))
            self.errors += telegram is None
            if telegram is not None:
                return telegram


@dataclass(frozen=True)
class Lms2xxView:
    """What a host must know of the device's settings to read its values."""

    mode: MeasuringMode
    field_deg: int
    step_deg: float

    @classmethod
    def of(cls, status: bytes) -> Lms2xxView:
        """From the data of the reply B1."""
        return cls(
            MEASURING_MODES.get(status[101], MEASURING_MODES[0]),
            int.from_bytes(status[106:108], "little"),
            int.from_bytes(status[108:110], "little") / 100.0,
        )

    @classmethod
    def guessed(cls, values: MeasuredValues) -> Lms2xxView:
        """Of a device that was never asked: field and step by the number of values, 181 being 180 by 1 degree."""
        field, step = COMMON.get(len(values.values), (180, 180.0 / max(1, len(values.values) - 1)))
        return cls(MEASURING_MODES[0], field, step)

    def decode(self, number: int, values: MeasuredValues) -> HostScan:
        """Metres and radians of one telegram."""
        raw = values.values & self.mode.mask
        metres = raw / COUNTS_PER_METRE.get(values.header.unit, 100)
        metres[raw > self.mode.largest] = np.nan
        beams = values.first - 1 + np.arange(len(raw))
        step, offset = self.step_deg, 0.0
        if values.header.partial is not None:
            step, offset = 1.0, 0.25 * values.header.partial
        field = 180.0 if values.header.partial is not None else self.field_deg
        azimuth = np.radians(beams * step + offset - field / 2.0)
        return HostScan(number, azimuth, metres, f"status {values.status:02X}", self._intensity(values))

    @staticmethod
    def _intensity(values: MeasuredValues) -> Floats | None:
        """Of a telegram whose intensities stand for all of its beams."""
        whole = len(values.extra) == len(values.values) > 0
        return values.extra.astype(np.float64) if whole else None


COMMON = {361: (180, 0.5), 181: (180, 1.0), 401: (100, 0.25), 201: (100, 0.5), 101: (100, 1.0)}
"Values of a telegram -> field and step, in degrees."
LISTENING = "LMS2xx that answers nothing (listening)"


class Lms2xxHost:
    """Connects in the constructor; raises `LinkError` when nothing answers and no values are heard.

    Where values come and nobody answers, as from a recording that is sent again, it listens: it asks for nothing more
    and follows the line's speed by trying.
    """

    def __init__(self, line: Line, baud: int | None, listen: bool = False) -> None:
        """`baud`: line speed to go to; None: the device is asked for its name alone, and left as it is."""
        if baud is not None and baud not in RATE_CODES:
            raise LinkError(f"line speed {baud}; an LMS2xx has {', '.join(map(str, sorted(RATE_CODES)))}")
        self._line = line
        self._clock = SystemClock()
        self._reader = TelegramReader()
        self._heard: deque[Telegram] = deque(maxlen=MOST_HEARD)
        "Values that came while something else was waited for."
        self._stopped = False
        "The device has said that it streams no more; whatever still streams is no device."
        self._view: Lms2xxView | None = None
        self._bauds = list(dict.fromkeys((baud or 9_600, *RATE_CODES)))
        self._leave = baud is None
        self.found_baud: int | None = None
        "Line speed that the device had; None: of a line without one."
        self.listens = listen
        self._heard_ns = self._clock.now_ns()
        self.title = LISTENING
        if listen:
            self._line.set_baud(self._bauds[0])
            return
        try:
            self._connect(baud)
        except LineClosed:
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
        self._stopped = True
        title = self._ask(b"\x3a", 0xBA).data[:-1].decode("ascii", "replace").strip()
        self.title = title
        if self._leave:
            return
        self._view = Lms2xxView.of(self._ask(b"\x31", 0xB1).data)
        self._ask(b"\x20\x24", 0xA0)

    @property
    def errors(self) -> int:
        """Telegrams with a wrong CRC so far."""
        return self._reader.errors

    def scans(self, timeout_s: float) -> Iterator[HostScan | None]:
        """Scans as they arrive; None when none came for `timeout_s`."""
        number = 0
        while True:
            telegram = self._heard.popleft() if self.listens and self._heard else self._next(timeout_s)
            values = read_values(telegram) if telegram is not None else None
            if telegram is None:
                yield None
            elif values is not None:
                yield (self._view or Lms2xxView.guessed(values)).decode(number, values)
                number += 1
            elif self.listens and telegram.command == 0xB1 and len(telegram.data) > STATUS_BYTES:
                self._view = Lms2xxView.of(telegram.data)  # somebody asked when it was recorded
            if self.listens and telegram is not None:
                self._heard_ns = self._clock.now_ns()
            elif self.listens:
                self._follow()

    def _follow(self) -> None:
        """Where nothing has come for a while at this speed, listen at the next."""
        if isinstance(self._line, SocketLine) or self._clock.now_ns() - self._heard_ns < FOLLOW_S * 1e9:
            return
        self._bauds.append(self._bauds.pop(0))
        self._line.set_baud(self._bauds[0])
        self._heard_ns = self._clock.now_ns()

    def close(self) -> None:
        """Back to request mode and 9600 baud, as the device was found after power-on."""
        try:
            for payload in () if self.listens or self._leave else (b"\x20\x25", b"\x20\x42"):
                self._ask(payload, 0xA0)
        except LinkError:
            pass  # a device that has gone need not be left tidy
        self._line.close()

    def _find(self, baud: int | None) -> None:
        """Stop a stream at whatever speed the device has, then change to `baud`."""
        if isinstance(self._line, SocketLine):
            try:
                self._ask(b"\x20\x25", 0xA0, tries=2, seconds=2.0)
            except LineClosed:
                raise
            except LinkError:
                if not self._heard:
                    raise
                self.listens = True
            return
        speeds = tuple(dict.fromkeys((9_600, baud or 9_600, *RATE_CODES)))
        for tried in speeds:
            self._line.set_baud(tried)
            self.found_baud = tried
            self._line.flush_input()
            try:
                self._ask(b"\x20\x25", 0xA0, tries=2, seconds=FINDING_S)
            except LineClosed:
                raise
            except LinkError:
                if not self._heard:
                    continue
                self.listens = True  # values at this speed, and `stop` is not answered
                self._bauds = list(dict.fromkeys((tried, *self._bauds)))
                return
            if baud is not None and tried != baud:
                self._ask(bytes((0x20, RATE_CODES[baud])), 0xA0)
                self._line.set_baud(baud)
            return
        reported = ", ".join(map(str, speeds))
        raise LinkError(f"no LMS2xx answers to `stop` (20 25); tried {reported} baud, twice each")

    def _ask(self, payload: bytes, reply: int, tries: int = 3, seconds: float = SECONDS_FOR_A_REPLY) -> Telegram:
        for _ in range(tries):
            self._line.write(request(payload))
            end_ns = self._clock.now_ns() + int(seconds * 1e9)
            while self._clock.now_ns() < end_ns:
                telegram = self._next((end_ns - self._clock.now_ns()) * 1e-9)
                if telegram is not None and telegram.command == reply:
                    return telegram
                if telegram is not None and read_values(telegram) is not None:
                    self._heard.append(telegram)
                    if self._stopped and len(self._heard) >= ENOUGH:
                        raise LinkError("values arrive although the device was stopped: it does not follow requests")
                if telegram is not None and telegram.command == 0x92:
                    raise LinkError(f"the device refuses request {payload.hex(' ')}")
        raise LinkError(f"no reply {reply:02X} to request {payload.hex(' ')}; tried {tries} times, {seconds:g} s each")

    def _next(self, timeout_s: float) -> Telegram | None:
        """The next telegram with a good CRC; None when there is none in time."""
        end_ns = self._clock.now_ns() + int(timeout_s * 1e9)
        while True:
            telegram = self._reader.take()
            if telegram is not None:
                return telegram
            left_ns = end_ns - self._clock.now_ns()
            data = self._line.read(max(0, left_ns) * 1e-9)
            if not data and left_ns <= 0:
                return None
            self._reader.feed(data)
