"""One YDLIDAR: requests in, replies and packets out.

Belongs here: commands, states, when a packet leaves. Not: bytes of packets (codec), facts of a model (models).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from fractions import Fraction
from typing import Any, ClassVar

import numpy as np

from protocols.scan import Floats, Scan
from protocols.session import Address, DropReason, Emission, LinkKind
from protocols.skeleton.descriptors import descriptor, reply
from protocols.skeleton.outbox import Outgoing
from protocols.skeleton.receiving import FrameSplitter, Refusal
from protocols.skeleton.requests import Answer, Command, Refused, Request, RequestSession
from protocols.skeleton.sweeps import Sweep, Telegram
from protocols.skeleton.turning import Samples, TurningSession
from protocols.ydlidar import codec
from protocols.ydlidar.models import Model, Settings

START = 0xA5
TICK_NS = Fraction(1_000_000)
MODULE_INFO_NS = 200_000_000
"From the beginning of the stream (spec 3.2)."
INFO, HEALTH, SCAN, PITCH = 0x04, 0x06, 0x81, 0x10
"Types of replies."
STALLED = 1
"Error code of a motor that stands; no source has the bits."
SCANS = descriptor(SCAN, 5, multiple=True)
"Before packets; the length is formal."
EVEN_SCANNING = (b"\xa5\x60", b"\xa5\x61", b"\xa5\x65", b"\xa5\x00")
RESTARTS = (b"\xa5\x40", b"\xa5\x80")
"A model has one of them."
ON, OFF = 1, 0


class Requests(FrameSplitter):
    """A5 and a command; no length, no checksum."""

    START = bytes((START,))
    HEAD_BYTES = 2

    def _size(self, head: bytes) -> int | Refusal:
        return 2

    def _open(self, frame: bytes) -> bytes | Refusal:
        return (DropReason.NO_START_BYTE, "A5 twice") if frame[1] == START else frame


class YdlidarSession(TurningSession, RequestSession):
    """The device with its commands."""

    clock_tick_ns = TICK_NS
    clock_bits = 32

    def __init__(self, model: Model, settings: Settings) -> None:
        super().__init__(settings.boot_ns, settings.motor, model.rates_hz[model.rate])
        self.model, self.settings = model, settings
        self.LINE_SPEED = model.baud  # type: ignore[misc]
        self.flags: dict[str, int] = {}
        "States that a command sets and another one asks for."
        self.rate = model.rate
        self._kept: tuple[float, int] | None = None
        "Speed and low power that a G4 keeps over a restart by command."
        self._motor_on = True
        "As DTR has it."
        self._blocked = False
        self._seen: tuple[Floats, Floats] | None = None
        "Angles of the last turn, and the correction of each: where its line will meet something next time."
        self._cast: tuple[Samples, Floats] | None = None
        self._module: Outgoing | None = None

    # states

    @property
    def scanning(self) -> bool:
        """Whether a host has started the stream, or the model always sends."""
        return bool(self._hosts)

    @property
    def health(self) -> tuple[int, int]:
        """Status and error code."""
        return (2, STALLED) if self._blocked and self._motor_on else (self.settings.health, 0)

    def _reset(self, now_ns: int) -> None:
        self.flags = {"low power": OFF, "turns left": OFF, "constant": ON, "exposure": OFF, "heartbeat": ON}
        self.rate, self._rate_hz = self.model.rate, self.model.rates_hz[self.model.rate]
        self._seen = self._cast = self._module = None

    def _boot(self, now_ns: int) -> None:
        super()._boot(now_ns)
        if self._kept is not None:
            self._hz, self.flags["low power"] = self._kept
            self._drive()
        self._kept = None

    def power_on(self, now_ns: int) -> None:
        """Everything is lost, also what a restart by command keeps."""
        self._kept = None
        super().power_on(now_ns)

    def _start(self, now_ns: int) -> None:
        if not self.model.answers:
            self._subscribe(now_ns, None)

    def modem_lines(self, dtr: bool, rts: bool, now_ns: int, address: Address) -> None:
        """DTR switches the motor where the board does so."""
        self.advance(now_ns)
        if self.settings.dtr_drives_motor and dtr != self._motor_on:
            self._motor_on = dtr
            self._stall(now_ns, self._blocked or not dtr)

    def _block(self, now_ns: int, blocked: bool) -> bool:
        self._blocked = blocked
        self._stall(now_ns, blocked or not self._motor_on)
        return True

    def receive(self, data: bytes, now_ns: int, address: Address | None = None) -> None:
        """Bytes of a host, in any chunking; ignored by those that only send. Never raises."""
        if self.model.answers:
            super().receive(data, now_ns, address)
            return
        self.advance(now_ns)
        if data:
            self._events.drop(now_ns, DropReason.UNKNOWN_COMMAND, "it takes no commands", len(data))

    # turns

    def _sweep_of(self, samples: Samples) -> Sweep:
        angle = samples.angle_deg
        cast = angle
        if self.model.triangulates:
            cast = angle + (codec.FAR_DEG if self._seen is None else np.interp(angle, *self._seen, period=360.0))
        self._cast = samples, cast
        azimuth = np.asarray(-np.radians(cast % 360.0), np.float64)
        return Sweep(azimuth, np.zeros(len(angle)), samples.after_s, samples.end_s, self.model.most_m,
                     wants_intensity=self.settings.bits > 0)  # fmt: skip

    def _telegrams(self, scan: Scan) -> Iterator[Telegram]:
        assert self._cast is not None
        samples, cast = self._cast
        found, level = 1000.0 * scan.range_m[:, 0], scan.intensity[:, 0]
        good = (scan.range_m[:, 0] >= self.model.least(self.rate)) & (scan.range_m[:, 0] <= self.model.most_m)
        found = np.where(good, found, np.nan)
        if self.model.triangulates:
            chosen = codec.seen_from(samples.angle_deg, cast, found)
            found, level = found[chosen], level[chosen]
            far = np.where(np.isnan(found), np.inf, found)
            self._seen = samples.angle_deg, codec.correction_deg(far)
        rows = codec.encode_samples(found, brightness(level), self.settings.bits, self.model.unit_mm)
        speed = round(10.0 * (samples.hz - self.model.speed_offset))
        kind = 1 | min(max(speed, 0), 127) << 1 if samples.is_whole else 0
        start_ns, after_s = scan.plan.start_ns, samples.after_s
        if kind and self.settings.has_stamps:
            reported = self.clock.reported(start_ns, TICK_NS, self.clock_bits)
            yield Telegram(0, stamp_packet(reported.ticks), "stamp", reported)
        last = -1
        for packet in codec.encode_packets(kind, samples.angle_deg, rows):
            last += packet[3]
            yield Telegram(int(np.ceil(1e9 * after_s[last])), packet, "zero" if packet[2] & 1 else "samples")

    # requests

    def _splitter(self, kind: LinkKind | None) -> Requests:
        return Requests(64)

    def _parse(self, request: bytes) -> tuple[bytes, bytes]:
        return request, b""

    def _reply(self, request: Request, payload: bytes) -> bytes:
        return payload

    def _not_now(self, request: Request) -> Refused | None:
        code = request.code
        if (code in RESTARTS and code[1] != self.model.restart) or not (self.model.sets or code in EVERY):
            return Refused(DropReason.UNKNOWN_COMMAND, code.hex(" "))
        if self.scanning and code in self.COMMANDS and code not in EVEN_SCANNING:
            return Refused(DropReason.WRONG_MODE, f"{code.hex(' ')} while it scans")
        return None

    def _scan(self, request: Request) -> bytes | Answer | Refused:
        if self._hosts:  # a heartbeat, or a host that did not stop the stream of the one before it
            return SCANS
        now_ns = request.now_ns + self.REPLY_NS
        if self.settings.health == 2:
            return SCANS
        if self.model.sets:
            self._start_motor(now_ns)
        self._subscribe(now_ns, None)
        if self.settings.has_module_info and not self._stalled:
            due_ns = max(now_ns, self._speed_ns) + MODULE_INFO_NS
            info = Emission(due_ns, reply(INFO, self.info()), request.address, label="module info")
            self._module = self._outbox.send(info)
        return SCANS

    def _stop(self, request: Request) -> Answer:
        self._unsubscribe(request.now_ns, None)
        return Answer(None)

    def _unsubscribe(self, now_ns: int, address: Address | None) -> None:
        module, self._module = self._module, None
        self._outbox.withdraw(lambda sent: sent is module)
        super()._unsubscribe(now_ns, address)

    def info(self) -> bytes:
        """Model, firmware, hardware, serial number."""
        settings = self.settings
        major, minor = settings.firmware
        return bytes((self.model.code, minor, major, settings.hardware, *map(int, settings.serial)))

    def _info(self, request: Request) -> bytes:
        return reply(INFO, self.info())

    def _health(self, request: Request) -> bytes:
        status, code = self.health
        return reply(HEALTH, bytes((status,)) + code.to_bytes(2, "little"))

    def _restarted(self, request: Request) -> Answer:
        if self.model.model == "ydlidar-g4":
            self._kept = self._hz, self.flags["low power"]
        return Answer(None, restarts=True)

    def _flag(self, name: str, value: int | None, request: Request) -> bytes:
        """Set a state (None: ask for it, 2: the other one), and its reply."""
        state = self.flags[name] if value is None else 1 - self.flags[name] if value == 2 else value
        self.flags[name] = state
        return reply(INFO, bytes((state,)))

    def _heartbeat(self, request: Request) -> bytes:
        self.flags["heartbeat"] = 1 - self.flags["heartbeat"]
        return reply(INFO, bytes((self.flags["heartbeat"],)))

    def _aim(self, change_hz: float, request: Request) -> bytes:
        least, _, most = self.model.hz
        if change_hz:
            self._spin(request.now_ns, min(max(round(self._hz + change_hz, 2), least), most))
        hundredths = round(100.0 * self._hz) + (self.model.aim_offset if not change_hz else 0)
        return reply(INFO, hundredths.to_bytes(4, "little"))

    def _rate(self, step: int, request: Request) -> bytes:
        rates = self.model.rates_hz
        fitting = sum(line_share(self.model, rate, self.settings.bits) <= 1.0 for rate in rates)
        if step:
            self.rate = (self.rate + step) % max(1, fitting)
            self._spin(request.now_ns, rate_hz=rates[self.rate])
        return reply(INFO, bytes((self.rate,)))

    def _value(self, kind: int, value: int, request: Request) -> bytes:
        return reply(kind, value.to_bytes(4, "little", signed=True))

    COMMANDS: ClassVar[Mapping[bytes, Command]] = {}


def brightness(level: Floats) -> Floats:
    """Share of full scale; no source has the law: 0.4 at the threshold, 0.08 more for each doubling."""
    with np.errstate(invalid="ignore", divide="ignore"):
        found = 0.4 + 0.08 * np.log2(level)
    return np.clip(np.nan_to_num(found, nan=0.0), 0.0, 1.0)


def stamp_packet(ticks: int) -> bytes:
    """The time in ms (spec 3.3)."""
    body = ticks.to_bytes(4, "little") + b"\0"
    check = 0xAA ^ 0x66
    for byte in body:
        check ^= byte
    return b"\xaa\x66" + bytes((check,)) + body


def line_share(model: Model, rate_hz: int, bits: int) -> float:
    """What the samples of a rate need of the line."""
    bytes_ = codec.WIDTHS[bits] + codec.HEAD_BYTES / codec.MOST_SAMPLES
    return 10.0 * rate_hz * bytes_ / model.baud


def _flagged(name: str, flag: str, value: int | None, note: str = "") -> Command:
    def act(session: Any, request: Request) -> bytes:
        found: bytes = session._flag(flag, value, request)
        return found

    return Command(name, act, "spec 3.2", note)


def _row(name: str, act: Any, note: str = "") -> Command:
    return Command(name, act, "spec 3.2", note)


def _aims(change_hz: float) -> Any:
    return lambda session, request: session._aim(change_hz, request)


_KEPT = "the state alone: beams do not change"
_S = YdlidarSession
_ROWS = {
    0x60: _row("scan", _S._scan),
    0x61: _row("forced scan", _S._scan),
    0x65: _row("stop", _S._stop),
    0x00: _row("forced stop", _S._stop),
    0x90: _row("device info", _S._info),
    0x91: _row("health", _S._health),
    0x92: _row("health", _S._health),
    0x80: _row("restart", _S._restarted, "X4"),
    0x40: _row("restart", _S._restarted, "G4, T"),
    0x01: _flagged("low power on", "low power", ON, _KEPT),
    0x02: _flagged("low power off", "low power", OFF, _KEPT),
    0x05: _flagged("low power?", "low power", None),
    0x06: _flagged("turn clockwise", "turns left", OFF),
    0x07: _flagged("turn counter-clockwise", "turns left", ON, _KEPT),
    0x08: _flagged("direction?", "turns left", None),
    0x09: _row("speed +0.1 Hz", _aims(0.1)),
    0x0A: _row("speed -0.1 Hz", _aims(-0.1)),
    0x0B: _row("speed +1 Hz", _aims(1.0)),
    0x0C: _row("speed -1 Hz", _aims(-1.0)),
    0x0D: _row("speed?", _aims(0.0), "TG: 0.4 Hz more"),
    0x0E: _flagged("constant frequency on", "constant", ON),
    0x0F: _flagged("constant frequency off", "constant", OFF, _KEPT),
    0xD0: _row("next sampling rate", lambda session, request: session._rate(1, request)),
    0xD1: _row("sampling rate?", lambda session, request: session._rate(0, request)),
    0x93: _row("zero offset angle", lambda session, request: session._value(INFO, 0, request), "always 0"),
    0x94: _flagged("exposure: save", "exposure", None, _KEPT),
    0x95: _flagged("exposure: low", "exposure", None, _KEPT),
    0x96: _flagged("exposure +", "exposure", None, _KEPT),
    0x97: _flagged("exposure -", "exposure", None, _KEPT),
    0x98: _row("pitch angle", lambda session, request: session._value(PITCH, 0, request), "always 0"),
    0xD9: _row("heartbeat on or off", _S._heartbeat, "the stream does not depend on it"),
}
COMMANDS: Mapping[bytes, Command] = {bytes((START, code)): row for code, row in _ROWS.items()}
YdlidarSession.COMMANDS = COMMANDS
EVERY = frozenset(bytes((START, code)) for code in (0x60, 0x61, 0x65, 0x00, 0x90, 0x91, 0x92, 0x80))
"What an X4 has; others do not answer further ones either, if they have no settings."
