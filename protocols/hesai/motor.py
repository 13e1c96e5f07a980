"""Where the rotor or the mirror is at an instant, and what time the device has: its own, that of PTP or GPS.

Belongs here: angles and time. Not: who sets the speed, and what fires (device).
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from protocols.device_clock import DeviceClock
from protocols.skeleton.instants import SECOND_NS
from protocols.skeleton.ramping import Ramping
from protocols.skeleton.utc import FullSeconds

NEAR = 1e-3
"Share of the speed within which a rotor that holds its phase is at the speed set."
LOCK_STEP = 0.05
"Share of the speed by which the phase lock changes it; ours."
LOCK_SECONDS = 3
"Full seconds until the clock follows its source; ours."
FREEZE_NS = 60 * SECOND_NS
"From the loss of PTP to free run; ours."
COLD_NS = int(datetime(2017, 1, 1, tzinfo=UTC).timestamp()) * SECOND_NS
"Date of a clock that was never set, as in public captures."
FREE, TRACKING, LOCKED, FROZEN = range(4)


class Rotor(Ramping):
    """Turns clockwise; backwards turns are negative."""

    def drive(self, at_ns: int, hz: float, ramp_ns: int) -> None:
        """To another speed from an instant on; what was foreseen is forgotten."""
        self._knots = [one for one in self._knots if one.at_ns < at_ns] or self._knots[:1]
        now_hz = self.speed_hz(at_ns)
        if ramp_ns and now_hz != hz:
            self._put(at_ns, now_hz, (hz - now_hz) / (1e-9 * ramp_ns))
            at_ns += ramp_ns
        self._put(at_ns, hz, 0.0)

    def correct(self, at_ns: int, hz: float, to_turns: float) -> None:
        """At a full second: aim at being at `to_turns` at the next one, by going slightly faster or slower."""
        behind = (to_turns - float(self.turns(np.array(at_ns))) - hz + 0.5) % 1.0 - 0.5
        most = LOCK_STEP * abs(hz)
        self._put(at_ns, hz + min(max(behind, -most), most), 0.0)


@dataclass
class Source(FullSeconds):
    """A PTP grandmaster or a GPS receiver, and what the device's clock makes of it."""

    ptp: bool
    "There is a grandmaster."
    pps: bool
    nmea: bool
    by_ptp: bool
    "Which the device follows."

    @property
    def there(self) -> bool:
        """Whether what it follows is there."""
        return self.ptp if self.by_ptp else self.pps and self.nmea

    def switch(self, at_ns: int, **what: bool) -> None:
        """Other sources are there, or another one is followed."""
        if all(getattr(self, name) == value for name, value in what.items()):
            return
        if self.locked(at_ns):
            self.held = self.last(at_ns)
        for name, value in what.items():
            setattr(self, name, value)
        self.since_ns = at_ns

    def locked(self, at_ns: int) -> bool:
        """Whether the clock follows it."""
        return self.there and self.utc(at_ns) // SECOND_NS - self.utc(self.since_ns) // SECOND_NS >= LOCK_SECONDS

    def ptp_state(self, at_ns: int) -> int:
        """As it is reported."""
        if not self.by_ptp:
            return FREE
        if self.ptp:
            return LOCKED if self.locked(at_ns) else TRACKING
        return FROZEN if self.held is not None and at_ns - self.since_ns < FREEZE_NS else FREE

    def shown_ns(self, clock: DeviceClock, at_ns: int) -> tuple[int, int]:
        """Time of the device since 1970, and what it has when the run begins."""
        second = self.last(at_ns) if self.locked(at_ns) else self.held
        if second is None:
            return COLD_NS + clock.shown_ns(at_ns), COLD_NS
        return second[1] + clock.shown_ns(at_ns) - clock.shown_ns(second[0]), self.utc_ns
