"""State of the device, independent of hosts: modes, motor, clock, signals, configuration and sectors.

It does not know links or telegrams. Times are arguments; `next_deadline` is the time of its next change.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from protocols.device_clock import DeviceClock, Knot
from protocols.ld import config as cfg
from protocols.ld.files import Files
from protocols.ld.head import DELAYS, MS, Rotation, azimuths_rad, beam_ticks
from protocols.ld.models import Model
from protocols.ld.routing import Attached
from protocols.ld.sectors import TICKS, MeasureError, Sector, Span, Table, check, spans, with_sector
from protocols.ld.settings import Settings
from protocols.ld.telegrams import Mode, Motor, status_words
from protocols.quartz import TRUE, Quartz
from protocols.scan import Floats
from protocols.session import Address

HOST_SIGNALS = 0x00F3
"Bits of PORTVAL that a host sets: two yellow LEDs and four outputs. Green (2) and red (3) belong to the device."
RED_LED = 0x0008
CLOCK_TICK_NS = Fraction(MS)


@dataclass(frozen=True, eq=False)
class Geometry:
    """What is measured in a revolution; fixed from TRANS_MEASURE until MEASURE is left."""

    facts: tuple[tuple[Span, ...], int, float]
    "Sectors, angle step in ticks, and the range below which echoes are ignored (0 while the filter is off)."
    azimuth_rad: Floats
    elevation_rad: Floats
    fire_offset_s: Floats

    @property
    def sectors(self) -> tuple[Span, ...]:
        return self.facts[0]

    @property
    def step(self) -> int:
        return self.facts[1]

    @property
    def near_field_m(self) -> float:
        return self.facts[2]

    @property
    def first(self) -> int:
        """Direction at which a revolution begins, in ticks."""
        return self.sectors[0].start


@dataclass(frozen=True)
class Caller:
    """Who asks for a service."""

    address: Address
    route: int
    "What telegrams to it need beside its channel."
    interface: int
    "1 serial, 2 CAN, 0 any other: as services 0601 to 0605 number them."


@dataclass(frozen=True)
class SpinUp:
    """The motor on its way to another speed."""

    hz: int
    ready_ns: int


class Device:
    """State of one device. Every method that changes it takes the time."""

    def __init__(self, model: Model, settings: Settings) -> None:
        self.model = model
        self.settings = settings
        self.delays = DELAYS[settings.delays]
        self.config: cfg.Config = settings.config
        self.flash_sectors: Table = settings.sectors
        self.near_field = settings.near_field
        "Kept over power-off: SET_FILTER writes to flash (sicktoolbox, EnableNearfieldSuppression)."
        self.files: Files = {}
        "Kept over power-off."
        self.caller: Caller | None = None
        "Of the request that is being served."
        self.restarts = 0
        self.turns: Quartz = TRUE
        "The motor against what it should do."
        self.found = Motor.OK
        "What the supervision finds of the motor while it turns."
        begin_ns = settings.clock_ms * MS
        self.clock = DeviceClock(begin_ns, origin=Knot(0, begin_ns, 1000 * settings.clock_ppm))
        self._lose_volatile(0)

    def _lose_volatile(self, now_ns: int) -> None:
        self.mode = Mode.IDLE
        self.motor = self.found
        self.rotation: Rotation | None = None
        self.spin_up: SpinUp | None = None
        self.geometry: Geometry | None = None
        self.sectors: Table = self.flash_sectors
        self.signals = 0
        self.identity = dict(self.settings.identity)
        self.attached: dict[int, Attached] = {}
        self.monitor: Caller | None = None
        self.monitors_profiles = False
        self.booted_ns: int | None = None
        self._next_first_sweep = 0  # of the first revolution after a standstill
        self.clock = self.clock.powered_on(now_ns)

    def boot(self, now_ns: int, boot_ns: int) -> None:
        """Restart: all but the flash is lost, and nothing is answered until the device has started."""
        self._lose_volatile(now_ns)
        if self.motor is Motor.STOPPED:
            self.mode = Mode.ERROR
        self.restarts += 1
        self.booted_ns = now_ns + boot_ns

    def is_booting(self, now_ns: int) -> bool:
        """Whether it is off or not yet listening."""
        return self.booted_ns is None or now_ns < self.booted_ns

    @property
    def sensor_id(self) -> int:
        return self.config[cfg.GLOBAL][0]

    @property
    def configured_hz(self) -> int:
        return self.config[cfg.GLOBAL][1]

    @property
    def baud(self) -> int:
        """Configured speed of the serial line."""
        return cfg.BAUD_CODES[self.config[cfg.SERIAL][0]]

    @property
    def can(self) -> tuple[int, ...]:
        """Rate code, host base, host mask, sensor base, broadcast identifier."""
        return self.config[cfg.CAN]

    @property
    def can_bitrate(self) -> int:
        """Bit rate of the CAN bus, fixed at start: a rate that a host stores is only reported back. [bit/s]"""
        return 1000 * cfg.CAN_RATE_CODES[self.settings.config[cfg.CAN][0]]

    @property
    def status(self) -> tuple[int, int]:
        """SENSTAT."""
        return status_words(self.mode, Motor.TOO_SLOW if self.spin_up else self.motor)

    @property
    def port(self) -> int:
        """PORTVAL as GET_SIGNAL gives it."""
        return self.signals | (RED_LED if self.mode is Mode.ERROR else 0)

    # motor and modes

    def next_deadline(self) -> int | None:
        """When `advance` has something to do."""
        return self.spin_up.ready_ns if self.spin_up else None

    def advance(self, now_ns: int) -> bool:
        """Take the motor to its speed when it is due; whether it has just got there."""
        if self.spin_up is None or now_ns < self.spin_up.ready_ns:
            return False
        first_sweep = self.rotation.sweep_after(self.spin_up.ready_ns) if self.rotation else self._next_first_sweep
        origin_ns = self.turns.own_ns(self.spin_up.ready_ns)
        self.rotation = Rotation(origin_ns, self.spin_up.hz, first_sweep, self.turns)
        self.spin_up = None
        return True

    def rotate(self, now_ns: int, hz: int) -> None:
        """Laser off, head to `hz`; at speed at once when it turns so fast already."""
        self.geometry = None
        self.mode = Mode.ROTATE
        from_hz = self.rotation.hz if self.rotation and not self.spin_up else 0
        if from_hz == hz:
            return
        if self.spin_up and self.spin_up.hz == hz:
            return
        wanted = self.settings.spin_up_ns
        takes_ns = self.delays.spin_ns(from_hz, hz) if wanted is None else wanted
        self.spin_up = SpinUp(hz, now_ns + takes_ns)
        self.advance(now_ns)

    def skip_spin_up(self, now_ns: int) -> None:
        """The head has been at the requested speed for long."""
        if self.spin_up is not None:
            self.spin_up = SpinUp(self.spin_up.hz, now_ns)
            self.advance(now_ns)

    def idle(self, now_ns: int) -> None:
        """Laser off, motor off."""
        if self.rotation is not None:
            self._next_first_sweep = self.rotation.sweep_after(now_ns)
        self.geometry = self.rotation = self.spin_up = None
        self.mode = Mode.IDLE

    def measure(self) -> MeasureError:
        """Laser on, when speed, step and sectors allow; else nothing changes. The head must be at speed."""
        if self.rotation is None or self.spin_up is not None:
            raise RuntimeError("the head is not at speed")
        step = self.config[cfg.GLOBAL][2]
        verdict = check(self.sectors, self.rotation.hz, step)
        if verdict is MeasureError.OK:
            sectors = spans(self.sectors, step)
            near_field_m = self.model.near_field_m if self.near_field else 0.0
            if self.geometry and (sectors, step, near_field_m) == self.geometry.facts:
                return verdict
            ticks = beam_ticks(sectors, step)
            self.geometry = Geometry(
                facts=(sectors, step, near_field_m),
                azimuth_rad=azimuths_rad(ticks, sectors[0].start, self.settings.zero_ticks),
                elevation_rad=np.zeros(len(ticks)),
                fire_offset_s=ticks / float(TICKS * self.rotation.hz),
            )
            self.mode = Mode.MEASURE
        return verdict

    # clock

    def clock_ms(self, instant_ns: int) -> int:
        """The device's own time at an instant, 32 bits wide."""
        return self.clock.ticks(instant_ns, CLOCK_TICK_NS, 32)

    def shift_clock(self, now_ns: int, by_ms: int) -> None:
        """Put the clock forward, or back."""
        self.clock = self.clock.stepped(now_ns, by_ms * MS)

    # configuration

    def set_config(self, item: int, words: tuple[int, ...]) -> bool:
        """Store a block for good; whether the device takes it. Surplus words are left out (Miro sends one)."""
        block = cfg.ITEMS.get(item)
        if block is None or len(words) < block.words or (item == cfg.INTERLACE and not self.model.has_interlace):
            return False
        words = words[: block.words]
        if not block.allows(words) or (item == cfg.GLOBAL and words[1] > self.model.fastest_hz):
            return False
        changed = {**self.config, item: words}
        if changed[cfg.CAN][3] + changed[cfg.GLOBAL][0] > cfg.MAX_CAN_ID:
            return False
        self.config = changed
        return True

    def set_sector(self, number: int, sector: Sector, in_flash: bool) -> None:
        """Change one sector; in flash too when it is to outlast power-off."""
        self.sectors = with_sector(self.sectors, number, sector)
        if in_flash:
            self.flash_sectors = with_sector(self.flash_sectors, number, sector)

    def turn_at(self, now_ns: int, factor: float) -> None:
        """The motor turns so many times as fast as it should."""
        self.turns = self.turns.at_rate(now_ns, round(1e9 * (factor - 1.0)))
        if self.rotation is not None:
            self.rotation = replace(self.rotation, motor=self.turns)

    def find_motor(self, found: Motor) -> None:
        """The supervision finds the motor right or wrong, after a restart too; one that stands stays so."""
        self.found = found
        if self.motor is not Motor.STOPPED:
            self.motor = found

    def fail_motor(self, now_ns: int, motor: Motor) -> None:
        """Make the motor run wrong, stop it, or (OK) heal it; a stopped motor puts the device into ERROR."""
        if motor is Motor.STOPPED:
            self.idle(now_ns)
            self.mode = Mode.ERROR
        elif self.motor is Motor.STOPPED:
            self.mode = Mode.IDLE
        self.motor = motor
