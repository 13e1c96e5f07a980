"""What a CoLa device remembers: stored and delivered settings, user levels, start-up, calendar, window, faults.

Belongs here: state over power, whether it measures. Not: what variables say of it (answers), requests (asking), scans
(session).
"""

from __future__ import annotations

from abc import abstractmethod
from collections import defaultdict, deque
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from typing import Any

from protocols.cola import filters
from protocols.cola.fields import Watching
from protocols.cola.models import Pair
from protocols.cola.scandata import Body
from protocols.cola.settings import RUN, Settings
from protocols.cola.shapes import TICK_NS, Setup, Shape
from protocols.device_clock import DeviceStamp
from protocols.scan import ScanPlan
from protocols.session import Address, DropReason, Emission
from protocols.skeleton.cola_frames import telegram
from protocols.skeleton.cola_values import short_hash
from protocols.skeleton.instants import SECOND_NS, Raster
from protocols.skeleton.requests import RequestSession
from protocols.skeleton.serial_lines import SerialLines

NO_NETWORK_NS = SECOND_NS
"A device that has just been switched on has no network yet; at most half of the time until it measures."
HOUR_US = 3_600_000_000
EPOCH, LATEST_US = datetime(1970, 1, 1), 4_102_444_800_000_000
"The calendar ends with 2099."
FAULTS = ("busy", "login", "motor stopped", "motor status")
"What may be wrong with it, beside window and speed: it refuses requests, or logins; the mirror stands; it says so."

Host = Address | None
SCANS = "LMDscandata"
STARTED_NS = 20 * SECOND_NS
"So long after LMCstartmeas the device measures for a poll: MRPT waits ten seconds before its first one."
POLL, WATCH = Address(-1, 0), Address(-1, 1)
"Not hosts, but reasons to measure: polls, and fields."


@dataclass
class Held:
    """A scan that has been measured, for hosts that subscribe before it leaves, and the last one for polls."""

    plan: ScanPlan
    due_ns: int
    body: Body
    reported: DeviceStamp
    sent: bool = False
    "To anybody."
    made: dict[tuple[bytes, bytes], bytes] = field(default_factory=dict)

    def telegram(self, head: bytes, dialect: bytes) -> bytes:
        """It on the wire, as an event (sSN) or an answer (sRA); encoded once for all hosts."""
        if (head, dialect) not in self.made:
            self.made[head, dialect] = telegram(dialect, head, SCANS.encode(), self.body.encoded(dialect))
        return self.made[head, dialect]


class ColaState(RequestSession):
    """One device, without its conversation and its scans."""

    clock_tick_ns = TICK_NS
    clock_bits = 32
    count_bits = 16
    restart_hangs_up = True

    @abstractmethod
    def delivered(self) -> dict[str, Any]:
        """Variables as the factory delivers them."""

    def __init__(self, settings: Settings) -> None:
        model = settings.model
        ready_ns = round(1e9 * settings.ready_s)
        super().__init__(min(NO_NETWORK_NS, ready_ns // 2), model.telegram_ns(settings.pair))
        self.settings = settings
        self.values, self.passwords, self.pair = self._factory()
        self.power_ups = settings.power_ups
        self.window = 1.0
        self.faults: set[str] = set()
        "Of `FAULTS`."
        self.challenges = 0
        "Drawn so far."
        self.first_power_ns: int | None = None
        self._powered_ns = 0
        self._chain = filters.Chain()
        self.watching = Watching(model.fields)
        self.store()
        self._reset_state(0)

    def _factory(self) -> tuple[dict[str, Any], dict[int, int], Pair]:
        """Variables, hashes of passwords by level, and scan configuration as delivered."""
        hashes = {level: short_hash(text) for level, text in self.settings.passwords.items()}
        return self.delivered(), hashes, self.settings.pair

    def _reset_state(self, now_ns: int) -> None:
        self.began_ns, self.up_ns = now_ns, now_ns + round(1e9 * self.settings.ready_s)
        self.measures, self.cold = True, True
        self.faults.discard("motor stopped")
        self.levels: dict[Host, int] = {}
        "User levels of the hosts that have logged in."
        self.asked: dict[Host, bytes] = {}
        "Challenges that wait for their response."
        self._dialects: dict[Host, bytes] = {}
        self._listeners: defaultdict[str, set[Host]] = defaultdict(set)
        self._asking: dict[Host, bytes] = {}
        "Hosts that wait for a scan, and in which dialect."
        self._held: deque[Held] = deque()
        self._poll_until_ns = 0
        self._telegrams_made = 0
        self._date_us: int | None = None
        "Date less device time, in microseconds since 1970; None: it has not been set."
        self._shapes: dict[tuple[int, int], Shape] = {}
        self._lines = SerialLines()
        self._imu_goes = False
        self._chain.clear()
        self.watching.clear()

    # power

    def power_on(self, now_ns: int) -> None:
        """What was not stored is lost; for a while without network, measuring later."""
        self.power_ups += 1
        super().power_on(now_ns)

    def _reset(self, now_ns: int) -> None:
        values, passwords, self.pair = self._kept
        self.values, self.passwords = dict(values), dict(passwords)
        self._powered_ns = now_ns
        if self.first_power_ns is None:
            self.first_power_ns = now_ns
        self._nominal_ns = self.settings.model.telegram_ns(self.pair)
        self._reset_state(now_ns)
        if self.settings.model.serial_line:
            self._outbox.send(Emission(now_ns, b"", line_speed=self.settings.serial_baud, label="power-on"))
        self._events.mode(now_ns, "starting")

    def store(self) -> None:
        """Everything survives the next power-off."""
        self._kept = dict(self.values), dict(self.passwords), self.pair

    def forget(self, now_ns: int) -> None:
        """As delivered; what is stored stays until the next `store`."""
        self.values, self.passwords, pair = self._factory()
        self.reconfigure(pair, now_ns)
        self.rearrange(now_ns)

    # user levels

    def set_level(self, address: Host, level: int, now_ns: int) -> None:
        """A host has that level from now on; where a login holds scans back, they stop or go on."""
        was_still = self._still
        if level == RUN:
            self.levels.pop(address, None)
        else:
            self.levels[address] = level
        if self._still != was_still:
            self.rearrange(now_ns)

    @property
    def _still(self) -> bool:
        quiet = self.settings.quiet_login and bool(self.levels)
        return not self.measures or self.stands or quiet

    # state

    @property
    def stands(self) -> bool:
        """The motor of the mirror is blocked."""
        return "motor stopped" in self.faults

    def contamination(self) -> list[int]:
        """Warning and error of the window."""
        return [int(self.window < 0.7), int(self.window < 0.4)]

    def ticks(self, now_ns: int) -> int:
        """Microseconds since power-on, as the device has them."""
        return self.clock.ticks(now_ns, TICK_NS, 32)

    def date(self, at_ns: int) -> tuple[int, ...]:
        """Year to second, and microseconds: from 1970 on since power-on, unless it was set, or has an NTP server."""
        if self.values["TSCRole"] == [1] and self.settings.ntp_epoch_s:
            micro = round(self.settings.ntp_epoch_s * 1e6) + at_ns // 1000 + HOUR_US * self.values["TSCTCtimezone"][0]
        else:
            micro = self.clock.shown_ns(at_ns) // 1000 + (self._date_us or 0)
        date = EPOCH + timedelta(microseconds=min(max(0, micro), LATEST_US))
        return (*date.timetuple()[:6], date.microsecond)

    def set_date(self, micro: int, now_ns: int) -> None:
        """The device's calendar says so many microseconds since 1970 now."""
        self._date_us = micro - self.clock.shown_ns(now_ns) // 1000

    def impair(self, now_ns: int, what: str, degree: float) -> bool:
        """The window, the motor of the mirror, and `FAULTS`."""
        if what == "window":
            self.advance(now_ns)
            self.window = degree
        elif what in FAULTS:
            self.advance(now_ns)
            (self.faults.add if degree else self.faults.discard)(what)
            if what == "motor stopped" and self._running:
                self.rearrange(now_ns)
        else:
            return super().impair(now_ns, what, degree)
        return True

    @property
    def _setup(self) -> Setup:
        """The settings that scans depend on."""
        return Setup(self.settings, self.values, self.pair)

    # measuring

    def start_measuring(self, now_ns: int) -> None:
        """The mirror turns; one that turned goes on. A driver may poll soon: scans are measured for it."""
        if not self._still or not self.measures:
            self._poll_until_ns = max(self._poll_until_ns, now_ns + STARTED_NS)
            self._subscribe(now_ns, POLL)
        if not self.measures:
            self.measures = True
            self._pause(now_ns)

    def stop_measuring(self, now_ns: int) -> None:
        """No scans until it is started again."""
        if self.measures:
            self.measures = False
            self.rearrange(now_ns)

    def reconfigure(self, pair: Pair, now_ns: int) -> None:
        """Another frequency or step, after a pause."""
        if pair == self.pair:
            return
        self.pair = pair
        model = self.settings.model
        if model.series in ("lms1", "lms5"):  # the step is that of the scans, the limits stay
            ((_, first, last),) = self.values["LMPoutputRange"][0]
            self.values["LMPoutputRange"] = [[[pair[1], first, last]]]
        self._nominal_ns = model.telegram_ns(pair)
        self._pause(now_ns)

    def _pause(self, now_ns: int) -> None:
        self.cold = self.cold and now_ns < self.up_ns
        self.began_ns, self.up_ns = now_ns, max(self.up_ns, now_ns + round(1e9 * self.settings.change_s))
        self.rearrange(now_ns)

    def rearrange(self, now_ns: int) -> None:
        """Something that scans depend on has changed: those of before are withdrawn."""
        self._shapes.clear()
        self._chain.clear()
        self.watching.clear()
        self._give_up_held(now_ns)
        self._change(now_ns)
        if now_ns < self.up_ns:
            self._raster = Raster(self.up_ns, self._nominal_ns * self._slowed, self._next)
        self._watch_or_not(now_ns)

    def _watch_or_not(self, now_ns: int) -> None:
        self.watching.use(self.values)
        if self.watching.active:
            self._subscribe(now_ns, WATCH)
        else:
            self._unsubscribe(now_ns, WATCH)

    def _give_up_held(self, now_ns: int) -> None:
        while self._held:
            self._note_unsent(self._held.popleft(), now_ns)

    def _note_unsent(self, held: Held, now_ns: int) -> None:
        if not held.sent:
            self._events.unsent(now_ns, DropReason.KEPT, held.plan.sweep, "", held.plan.stream)
