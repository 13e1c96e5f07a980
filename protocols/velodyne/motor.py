"""Where the head is at an instant: a motor that ramps to its speed, and holds its phase against the pulses of a GPS.

Belongs here: angles and pulses over time. Not: who sets the speed, and what fires (device).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from protocols.device_clock import DeviceClock
from protocols.skeleton.instants import SECOND_NS
from protocols.skeleton.ramping import Ramping
from protocols.skeleton.utc import FullSeconds

SAFE_HZ = 4.5
"Slower than that no laser fires: a little under 300 revolutions a minute."
LOCK_STEP = 0.05
"Share of the speed by which the phase lock changes it."
LOCKED_TURNS = 5.0 / 360.0
"So near to its angle at a pulse the phase counts as locked: the tolerance of the maker's manual."
LOCK_PULSES = 3
"Pulses until the clock follows them; ours, the maker states none."


class Motor(Ramping):
    """It ramps by one acceleration, and holds its phase."""

    def __init__(self, at_ns: int, hz: float, spin_up_ns: int) -> None:
        """At rest at azimuth 0; it takes `spin_up_ns` to reach `hz`."""
        super().__init__(at_ns)
        self._acceleration = hz / (spin_up_ns * 1e-9) if spin_up_ns else float("inf")
        self.hz = hz
        "What it is set to."
        self.set_speed(at_ns, hz)

    def set_speed(self, at_ns: int, hz: float) -> None:
        """Ramp to another speed from an instant on."""
        now_hz = self.speed_hz(at_ns)
        self.hz = hz
        if now_hz == hz:
            return
        ramp_s = abs(hz - now_hz) / self._acceleration
        if ramp_s:
            self._put(at_ns, now_hz, (hz - now_hz) / ramp_s)
        self._put(at_ns + round(1e9 * ramp_s), hz, 0.0)

    def correct(self, at_ns: int, to_turns: float) -> None:
        """At a pulse: aim at being at `to_turns` at the next one, by going slightly faster or slower."""
        most = LOCK_STEP * self.hz
        self._put(at_ns, self.hz + min(max(self.behind(at_ns, to_turns), -most), most), 0.0)

    def behind(self, at_ns: int, turns: float) -> float:
        """By how much the head has not come to an angle yet; -0.5..0.5 turns."""
        return (turns - float(self.turns(np.array(at_ns))) + 0.5) % 1.0 - 0.5

    def forget_after(self, at_ns: int) -> None:
        """Corrections that were foreseen, and are not to be."""
        while self._knots[-1].at_ns > at_ns and self._knots[-1].acceleration == 0.0 and len(self._knots) > 1:
            if self._knots[-2].acceleration != 0.0:
                return  # the end of a ramp
            self._knots.pop()

    def passes_ns(self, at_ns: int) -> int | None:
        """When it passes `SAFE_HZ` on the present ramp; None: it does not any more."""
        for one, following in zip(self._knots, self._knots[1:], strict=False):
            if one.acceleration and following.at_ns > at_ns and (one.hz < SAFE_HZ) != (following.hz < SAFE_HZ):
                passes_ns = one.at_ns + round(1e9 * (SAFE_HZ - one.hz) / one.acceleration)
                return passes_ns + 1 if passes_ns >= at_ns else None
        return None


@dataclass
class Gps(FullSeconds):
    """Pulses of a receiver at full seconds of UTC, and what a clock makes of them."""

    pulses: bool
    sentences: bool

    def switch(self, at_ns: int, pulses: bool) -> None:
        """Pulses end, or come again."""
        if pulses == self.pulses:
            return
        if self.pulses and self.locked(at_ns):
            self.held = self.last(at_ns)
        self.pulses, self.since_ns = pulses, at_ns

    def _seen(self, at_ns: int) -> int:
        return self.utc(at_ns) // SECOND_NS - self.utc(self.since_ns) // SECOND_NS if self.pulses else 0

    def locked(self, at_ns: int) -> bool:
        """Whether the clock follows the pulses."""
        return self.sentences and self._seen(at_ns) >= LOCK_PULSES

    def state(self, at_ns: int) -> int:
        """0 absent, 1 synchronising, 2 locked."""
        return 2 if self.locked(at_ns) else min(1, self._seen(at_ns))

    def shown_ns(self, clock: DeviceClock, at_ns: int) -> tuple[int, int]:
        """Time on the clock, and what it shows when the run begins: its own, or since the newest pulse it followed."""
        pulse = self.last(at_ns) if self.locked(at_ns) else self.held
        if pulse is None:
            return clock.shown_ns(at_ns), 0
        return pulse[1] + clock.shown_ns(at_ns) - clock.shown_ns(pulse[0]), self.utc_ns
