"""What a CoLa device remembers and says of itself: stored and delivered settings, start-up, calendar, window, outputs.

Belongs here: state over power, and the values of variables that are computed. Not: requests (asking), scans (session).
"""

from __future__ import annotations

from abc import abstractmethod
from collections import deque
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

import numpy as np

from protocols.cola import filters
from protocols.cola.commands import EVENTS, VARIABLES, default_passwords
from protocols.cola.models import Pair
from protocols.cola.scandata import Body
from protocols.cola.settings import Settings
from protocols.cola.shapes import TICK_NS, Setup, Shape
from protocols.cola.watching import Watching
from protocols.device_clock import DeviceStamp
from protocols.session import Address, Emission
from protocols.skeleton.instants import SECOND_NS
from protocols.skeleton.requests import RequestSession

SPIN_UP_SHARES = (0.2, 0.5, 0.8)
"Of the time until it measures: STlms says motor start, then rotating, in preparation, ready."
NO_NETWORK_NS = SECOND_NS
"A device that has just been switched on has no network yet; at most half of the time until it measures."
HOUR_US = 3_600_000_000
EPOCH, LATEST_US = datetime(1970, 1, 1), 4_102_444_800_000_000
"The calendar ends with 2099."

Host = Address | None


@dataclass
class Held:
    """A scan that has been measured, for hosts that subscribe before it leaves, and the last one for polls."""

    start_ns: int
    due_ns: int
    body: Body
    reported: DeviceStamp
    sweep: int
    stream: int | None
    sent: bool
    "To anybody."


class ColaState(RequestSession):
    """One device, without its conversation and its scans."""

    clock_tick_ns = TICK_NS
    clock_bits = 32
    count_bits = 16
    restart_hangs_up = True

    @abstractmethod
    def rearrange(self, now_ns: int) -> None:
        """Something that scans depend on has changed."""

    @abstractmethod
    def reconfigure(self, pair: Pair, now_ns: int) -> None:
        """Another frequency or step."""

    def __init__(self, settings: Settings) -> None:
        model = settings.model
        ready_ns = round(1e9 * settings.ready_s)
        super().__init__(min(NO_NETWORK_NS, ready_ns // 2), model.telegram_ns(settings.pair))
        self.settings = settings
        self._kept: tuple[dict[str, Any], dict[int, int], Pair] = self._delivered()
        "What mEEwriteall has stored: variables, passwords, scan configuration."
        self.values, self.passwords, self.pair = self._delivered()
        self.power_ups = settings.power_ups
        self.window = 1.0
        self._first_power_ns: int | None = None
        self._powered_ns = 0
        self._chain = filters.Chain()
        self._watching = Watching(model.fields)
        self._challenges = 0
        self._reset_state(0)

    def _delivered(self) -> tuple[dict[str, Any], dict[int, int], Pair]:
        settings = self.settings
        values = {
            name: one.factory(settings)
            for name, one in VARIABLES.items()
            if one.factory is not None and one.on(settings.model)
        }
        return values, default_passwords(settings), settings.pair

    def _reset_state(self, now_ns: int) -> None:
        self._began_ns, self._up_ns = now_ns, now_ns + round(1e9 * self.settings.ready_s)
        self._measuring, self._motor_stopped, self._cold = True, False, True
        self._levels: dict[Host, int] = {}
        self._dialects: dict[Host, bytes] = {}
        self._listeners: dict[str, set[Host]] = {name: set() for name in EVENTS}
        self._asking: dict[Host, bytes] = {}
        self._asked: dict[Host, bytes] = {}
        "Challenges that wait for their response."
        self._held: deque[Held] = deque()
        self._poll_until_ns = 0
        self._telegrams_made = 0
        self._date_us: int | None = None
        "Date less device time, in microseconds since 1970; None: it has not been set."
        self._shapes: dict[tuple[int, int], Shape] = {}
        self._line_free_ns: dict[int, int] = {}
        self._imu_goes = False
        self._chain.clear()
        self._watching.clear()

    # power

    def power_on(self, now_ns: int) -> None:
        """What was not stored is lost; for a while without network, measuring later."""
        self.power_ups += 1
        super().power_on(now_ns)

    def _reset(self, now_ns: int) -> None:
        self._powered_ns = now_ns
        values, passwords, self.pair = self._kept
        self.values, self.passwords = dict(values), dict(passwords)
        if self._first_power_ns is None:
            self._first_power_ns = now_ns
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
        self.values, self.passwords, pair = self._delivered()
        self.reconfigure(pair, now_ns)
        self.rearrange(now_ns)

    # state

    def state(self, now_ns: int) -> int:
        """SCdevicestate."""
        if self._motor_stopped or self.contamination()[1]:
            return 2
        if now_ns < self._up_ns or (self.settings.old and any(self._levels.values())):
            return 0
        return self.settings.model.usable_state

    def status(self, now_ns: int) -> list[Any]:
        """STlms."""
        phase = 7
        if not self._measuring or self._motor_stopped:
            phase = 3
        elif now_ns < self._up_ns:
            share = (now_ns - self._began_ns) / max(1, self._up_ns - self._began_ns)
            phase = (1 if self._cold else 4, 4, 5, 6)[sum(share >= one for one in SPIN_UP_SHARES)]
        year, month, day, hour, minute, second, _ = self.date(now_ns)
        return [phase, 0, f"{hour:02}:{minute:02}:{second:02}", f"{day:02}.{month:02}.{year % 100:02}", 0, 0, 0]

    def contamination(self) -> list[int]:
        """Warning and error of the window."""
        return [int(self.window < 0.7), int(self.window < 0.4)]

    def hours(self, now_ns: int) -> int:
        """Operating hours, in 0.1 h."""
        return self.settings.hours + (now_ns - (self._first_power_ns or 0)) // (360 * SECOND_NS)

    def celsius(self, now_ns: int) -> float:
        """Inside the housing: from 25 deg towards 35 in half an hour."""
        return 35.0 - 10.0 * float(np.exp((self._began_ns - now_ns) / (600.0 * SECOND_NS)))

    def ident(self) -> list[str]:
        """Name and version."""
        return [self.settings.model.ident, self.settings.firmware]

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
        """The window, and the motor of the mirror."""
        self.advance(now_ns)
        if what == "window":
            self.window = degree
        elif what == "busy":
            self._busy = degree != 0.0
        elif what == "login":
            self._refuses_login = degree != 0.0
        elif what == "motor stopped":
            self._motor_stopped = degree != 0.0
            if self._running:
                self.rearrange(now_ns)
        elif what == "motor status":
            self._motor_wrong = degree != 0.0
        else:
            return super().impair(now_ns, what, degree)
        return True

    def results(self, now_ns: int) -> list[Any]:
        """LFErec."""
        micro, date = self.clock.ticks(now_ns, TICK_NS, 32), list(self.date(now_ns))
        return self._watching.results(self.values, micro, date)

    def outputs(self, now_ns: int) -> list[Any]:
        """LIDoutputstate."""
        count = self.settings.model.outputs
        flat = [word for pair in self._watching.outputs(count) for word in pair]
        return [0, self.clock.ticks(now_ns, TICK_NS, 32), *flat, [list(self.date(now_ns))]]

    def inputs(self, now_ns: int) -> list[Any]:
        """LIDinputstate: nothing is wired to them."""
        return [0, self.clock.ticks(now_ns, TICK_NS, 32), 0, 0, 0, 0, [list(self.date(now_ns))]]

    @property
    def _still(self) -> bool:
        quiet = self.settings.quiet_login and any(self._levels.values())
        return not self._measuring or self._motor_stopped or quiet

    @property
    def _setup(self) -> Setup:
        """The settings that scans depend on."""
        return Setup(self.settings, self.values, self.pair)

    _motor_wrong = _busy = _refuses_login = False
