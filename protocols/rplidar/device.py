"""An RPLIDAR between requests: motor, laser, health, the stream of samples, and the groups that carry it.

Belongs here: states and times. Not: what a request says (commands), how samples are written (codec).
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from protocols.rplidar.codec import FORMS, STANDARD, Form, Samples, line_of_sight_deg
from protocols.rplidar.models import Mode, Model
from protocols.rplidar.settings import Settings
from protocols.scan import Floats, Scan
from protocols.session import Address, Emission, LinkKind
from protocols.skeleton.instants import SECOND_NS, Raster
from protocols.skeleton.one_client import OneClientSession
from protocols.skeleton.requests import Request
from protocols.skeleton.rotor import LoadedRotor, Turns
from protocols.skeleton.serial_lines import BITS
from protocols.skeleton.sweeps import Sweep, Telegram

STABLE = 0.05
"Of the speed that is set: nearer to it the motor is stable."
STANDS_HZ = 0.2
"Below, it makes no turns that count."
AT_ONCE_S = 1e-10
"Time constant of a motor without spin-up."
TOGETHER_NS = 2_000_000
"Standard nodes are handed over in groups of so long at most."
STALL_NS = SECOND_NS
"A motor that stands so long while it should turn is a fault."
STALLED = 0x8001
"Error code of it; ours."
USUAL_MM = 2000.0
"Target for which the line of sight is planned; others take the neighbouring sample."
GOOD, ERROR = 0, 2
FORCED_TURN_NS = SECOND_NS // 10
"Samples of a motor that stands are measured so long at once."
CONFIRM_NS = SECOND_NS // 2
"A detected speed that is not confirmed by then is left again."
BLOCK, BLOCKS = 0x41, 64
"The byte by which a host shows its speed, and how many of them a device measures."
DETECTS_BAUD = 115_200, 512_000
"Least and most speed that it finds so."
FOLLOWS = 0.5
"Of the speed that is set: above, samples go on while the motor changes its speed."


@dataclass(frozen=True)
class Stream:
    """A scan that is carried out."""

    mode: Mode
    form: Form
    address: Address | None
    forced: bool


class RplidarDevice(OneClientSession):
    """The device without its commands."""

    clock_tick_ns = Fraction(1000)
    clock_bits = 32
    INTER_BYTE_NS = 5 * SECOND_NS
    IS_SERVER = False

    def __init__(self, model: Model, settings: Settings) -> None:
        self.model, self.settings = model, settings
        super().__init__(settings.boot_ns, Fraction(round(1e9 / settings.turn_hz)))
        self.REPLY_NS = settings.reply_ns  # type: ignore[misc]
        self.LINE_SPEED = model.baud  # type: ignore[misc]
        self.baud = model.baud
        self.health, self.error_code = settings.health, settings.error_code
        self.stream: Stream | None = None
        self.ip = bytes(12)
        "Kept over power-off."
        self._dtr = False
        self._factor, self._blocked = 1.0, False
        "Faults of the motor: on its speed, and whether it is blocked."
        self._set_hz = 0.0
        "By PWM or A8."
        settle_s = max(1e-9 * settings.spin_up_ns / math.log(1.0 / STABLE), AT_ONCE_S)
        self.rotor = LoadedRotor(0, 0.0, 0.0, 0.0, settle_s, load=settings.wobble)
        self._turns = Turns(self.rotor, self._raster)
        self._beginning = self._timers.alarm(self._restream)
        "When the samples of a requested scan begin, the motor being stable."
        self._stalling = self._timers.alarm(self._protect)
        self._left: Samples | None = None
        "Samples of no whole group yet."
        self._before = model.baud
        "Speed of the line before that of a host was found."
        self._reverting = self._timers.alarm(lambda now_ns: self._run_at(now_ns, self._before, "41 not confirmed"))
        "Set while that is not confirmed."
        self._blocks = 0
        "Of a run at another speed than the line's."
        self._follows: int | None = None
        "The sweep that continues the groups."

    # the motor

    def _wanted_hz(self) -> float:
        if self.model.motor == "dtr":
            return 0.0 if self._dtr else self.settings.turn_hz
        if self._dtr and self.model.motor == "pwm":
            return 0.0
        if self._set_hz == 0.0 and self.model.motor == "rpm" and self.stream is not None:
            return self.settings.turn_hz
        return self._set_hz

    def turn_at(self, now_ns: int, hz: float) -> None:
        """The speed that a host sets; 0: it stands."""
        self._set_hz = 0.0 if hz <= 0.0 else min(max(hz, self.model.least_hz), self.model.most_hz)
        self._drive(now_ns)

    def _drive(self, now_ns: int) -> None:
        """The motor goes to the speed that holds now; the samples go on from here at other angles."""
        wanted = self._wanted_hz()
        aim = 0.0 if self._blocked else wanted * self._factor
        blocked = wanted > 0.0 and aim < STANDS_HZ
        if aim != self.rotor.hz:
            self.rotor = self.rotor.driven(now_ns, aim)
            if self.stream is not None and self._running:
                near = self.stream.forced or (aim >= STANDS_HZ and self.rotor.speed_hz(now_ns) >= FOLLOWS * aim)
                self._begin(now_ns, now_ns if near else self._stable_ns())
        self._stalling.at_ns = None if not blocked else self._stalling.at_ns or now_ns + STALL_NS

    def _stable_ns(self) -> int | None:
        """From when on the motor is stable; None while it is set to stand."""
        return None if self.rotor.hz < STANDS_HZ else self.rotor.settled_ns(STABLE)

    def _protect(self, now_ns: int) -> None:
        """The motor has stood for too long."""
        self.health, self.error_code = ERROR, STALLED
        self.stop(now_ns)

    def modem_lines(self, dtr: bool, rts: bool, now_ns: int, address: Address) -> None:
        """DTR of the USB adapter: set, the motor stands (not of S models)."""
        self.advance(now_ns)
        self._dtr = dtr
        self._drive(now_ns)

    def _set_factor(self, now_ns: int, factor: float) -> None:
        self._factor = factor
        self._drive(now_ns)

    def _block(self, now_ns: int, blocked: bool) -> bool:
        self._blocked = blocked
        self._drive(now_ns)
        return True

    # states

    def _reset(self, now_ns: int) -> None:
        self.baud = self.model.baud
        self.health, self.error_code = self.settings.health, self.settings.error_code
        if self._restarted:  # RESET leaves the protection stop
            self.health = GOOD if self.health == ERROR else self.health
        self._restarted = False
        self.stream, self._left, self._set_hz = None, None, 0.0
        self.rotor = self.rotor.driven(now_ns, 0.0)
        self._drive(now_ns)

    _restarted = False

    def reset(self) -> None:
        """RESET was received: the protection stop is left."""
        self._restarted = True

    def _start(self, now_ns: int) -> None:
        model = self.model
        if model.boots_with_text:
            major, minor = model.firmware
            stage = " - rtm" if minor < 30 else ""
            lines = "RP LIDAR System.", f"Firmware Ver {major}.{minor}{stage}, HW Ver {model.hardware}"
            text = "\r\n".join((*lines, f"Model: {model.byte:x}", ""))
            self._outbox.send(Emission(now_ns, text.encode(), label="boot"))

    # scans

    def begin(self, request: Request, mode: Mode, kind: int, forced: bool = False) -> bytes:
        """Carry out a scan request; its descriptor."""
        form = FORMS[kind]
        self.stream = Stream(mode, form, request.address, forced)
        self._drive(request.now_ns)
        ready_ns = request.now_ns + self.REPLY_NS + 1
        stable_ns = ready_ns if forced else self._stable_ns()
        self._begin(request.now_ns, None if stable_ns is None else max(ready_ns, stable_ns))
        return form.descriptor

    def _begin(self, now_ns: int, at_ns: int | None) -> None:
        """Samples begin, or go on at other angles, at `at_ns`; None: not before the motor turns."""
        self._end_sweeps(now_ns)
        self._beginning.at_ns = at_ns

    def stop(self, now_ns: int) -> None:
        """The scan ends; of what is being sent the rest of one group."""
        self._beginning.at_ns = self.stream = self._left = None
        self._end_sweeps(now_ns)
        self._drive(now_ns)

    def _end_sweeps(self, now_ns: int) -> None:
        self._withdraw(now_ns, lambda sent: True)
        self._cut(now_ns)
        self._hosts.clear()
        self._wanted.renew()

    def _unsubscribe(self, now_ns: int, address: Address | None) -> None:
        if self.stream is not None and self.stream.address == address:
            self.stop(now_ns)

    def sample_ns(self, stream: Stream) -> Fraction:
        """From sample to sample: as the mode reports, and no faster than the line takes."""
        if self._connections.kind(stream.address) not in (None, LinkKind.SERIAL):
            return stream.mode.period_ns
        line = Fraction(stream.form.size * BITS * SECOND_NS, self.baud * stream.form.samples)
        return max(stream.mode.period_ns, line)

    def _restream(self, now_ns: int) -> None:
        """The first sample is taken now."""
        stream = self.stream
        if stream is None:
            return
        self._stream += 1
        self._left, self._follows = None, None
        samples = Raster(now_ns, self.sample_ns(stream))
        part = int(FORCED_TURN_NS // samples.period_ns) if self.rotor.hz < STANDS_HZ else 0
        self._turns = Turns(self.rotor, samples, numbered=self._next, part=part)
        self._hosts[stream.address] = now_ns

    def _schedule(self) -> Turns:
        return self._turns

    def _sweep(self, number: int) -> Sweep:
        assert self.stream is not None
        after_s, angle_deg = self._angles(number)
        if self._bent:
            angle_deg = angle_deg - float(line_of_sight_deg(np.array([USUAL_MM]))[0])
        return Sweep(
            azimuth_rad=-np.radians(angle_deg),
            elevation_rad=np.zeros(len(angle_deg)),
            fire_offset_s=after_s,
            duration_s=float(len(angle_deg) * self._turns.samples.period_ns) * 1e-9,
            max_range_m=float(self.stream.mode.most_m),
            wants_intensity=True,
        )

    @property
    def _bent(self) -> bool:
        return self.stream is not None and self.stream.form.turned

    def _angles(self, number: int) -> tuple[Floats, Floats]:
        """When each sample of a sweep is taken after the first, in s, and the angle of the rotor then, 0 to 360."""
        after_s, turned = self._turns.turned(number)
        return after_s, np.asarray(360.0 * (turned - np.floor(turned)), np.float64)

    def _samples(self, scan: Scan) -> Samples:
        """What was measured, in the rotor's angles."""
        plan, model = scan.plan, self.model
        mm = 1000.0 * np.nan_to_num(scan.range_m[:, 0])
        mm = np.where((mm >= model.least_mm) & (mm <= 1000.0 * plan.max_range_m), mm, 0.0)
        strength = np.nan_to_num(scan.intensity[:, 0], nan=1.0)
        quality = np.clip(np.rint(0.5 * model.best_quality * strength), 1, model.best_quality).astype(np.int64)
        quality = np.where(mm > 0.0, quality << 2, 0)
        angle = self._angles(plan.sweep)[1]
        whole = plan.sweep > self._turns.first
        if self._bent:  # the neighbour whose line of sight, by its own distance, belongs to this angle of the rotor
            seen = np.degrees(-plan.azimuth_rad) + line_of_sight_deg(np.where(mm > 0.0, mm, USUAL_MM))
            chosen = _nearest(seen, angle, whole)
            mm, quality = mm[chosen], quality[chosen]
        starts = np.zeros(len(mm), np.bool_)
        starts[:1] = whole and not self._turns.part
        stamp_us = self.clock.shown_ns(plan.start_ns) / 1000.0 + 1e6 * plan.fire_offset_s
        return Samples(angle, mm, quality, starts, stamp_us)

    def _telegrams(self, scan: Scan) -> list[Telegram]:
        stream, plan = self.stream, scan.plan
        assert stream is not None
        form, fresh = stream.form, self._samples(scan)
        kept = self._left if self._follows == plan.sweep else None
        restart, held = kept is None, 0 if kept is None else len(kept)
        samples = fresh if kept is None else kept.then(fresh)
        count = (len(samples) - form.further) // form.samples
        self._left, self._follows = samples.part(max(count, 0) * form.samples), plan.sweep + 1
        if count <= 0:
            return []
        groups = form.encode(samples.part(0, count * form.samples + form.further), restart)
        step_ns = 1e9 * plan.duration_s / max(len(plan), 1)
        together = max(1, int(TOGETHER_NS / (step_ns * form.samples))) if form.kind == STANDARD else 1
        ends = np.arange(together, count + together, together).clip(max=count)
        last = ends * form.samples + form.further - held
        after = np.maximum(np.rint(last * step_ns), 0).astype(np.int64)
        begins = [0, *ends[:-1].tolist()]
        return [
            Telegram(due, groups[a:b].tobytes(), f"{form.kind:02X}")
            for due, a, b in zip(after.tolist(), begins, ends.tolist(), strict=True)
        ]

    # speed of the line

    def other_speed(self, baud: int, sent: bytes, now_ns: int, address: Address) -> None:
        """A run of 41 is measured, at whatever speed it comes."""
        self.advance(now_ns)
        for byte in sent:
            self._blocks = self._blocks + 1 if byte == BLOCK else 0
            if self._blocks == BLOCKS:
                self.detect(now_ns, baud)

    def detect(self, now_ns: int, baud: int | None = None) -> None:
        """A run of 41 has come, None: at the speed of the line. That is reported, at it, and may be confirmed."""
        self._blocks = 0
        least, most = DETECTS_BAUD
        if not self.model.detects_baud or self.stream is not None or self.detected or not self._running:
            return
        if baud is not None and not least <= baud <= most:
            return
        self._reverting.at_ns, self._before = now_ns + CONFIRM_NS, self.baud
        self._run_at(now_ns, self.baud if baud is None else baud, "41")
        self._outbox.send(Emission(now_ns + self.REPLY_NS, struct.pack("<I", self.baud), label="41"))

    @property
    def detected(self) -> bool:
        """Whether a host may confirm a speed now."""
        return self._reverting.at_ns is not None

    def change_speed(self, now_ns: int, baud: int) -> None:
        """The line has another speed until the next power-on."""
        self._reverting.at_ns = None
        self._run_at(now_ns + self.REPLY_NS, baud, "90")

    def _run_at(self, due_ns: int, baud: int, label: str) -> None:
        if baud != self.baud:
            self.baud = baud
            self._outbox.send(Emission(due_ns, b"", line_speed=baud, label=label))


def _nearest(known: np.ndarray, wanted: np.ndarray, closed: bool) -> np.ndarray:
    """Index into `known` (degrees, in any order) of the nearest to each of `wanted`; `closed`: it is a whole turn."""
    order = np.argsort(known, kind="stable")
    table = known[order]
    if closed:
        order, table = np.tile(order, 3), np.concatenate([table - 360.0, table, table + 360.0])
    at = np.searchsorted(table, wanted).clip(1, len(table) - 1) if len(table) > 1 else np.zeros(len(wanted), np.int64)
    if len(table) > 1:
        at = at - (wanted - table[at - 1] <= table[at] - wanted)
    return np.asarray(order[at])
