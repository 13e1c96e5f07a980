"""Where the head is at an instant: a motor that ramps to its speed, and holds its phase against the pulses of a GPS.

Belongs here: angles and pulses over time. Not: who sets the speed, and what fires (device).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from protocols.device_clock import DeviceClock
from protocols.scan import Floats
from protocols.skeleton.instants import SECOND_NS

SAFE_HZ = 4.5
"Slower than that no laser fires: a little under 300 revolutions a minute."
LOCK_STEP = 0.05
"Share of the speed by which the phase lock changes it."
LOCK_PULSES = 3
"Pulses until the clock follows them; ours, the maker states none."
KNOTS_KEPT = 64


@dataclass(frozen=True)
class Knot:
    """From an instant on, a constant acceleration."""

    at_ns: int
    turns: float
    hz: float
    acceleration: float = 0.0
    "[Hz/s]"
    whole: int = 0
    "Turns before, which `turns` leaves out."


class Motor:
    """Piecewise: each piece begins at a knot, and is computed from it."""

    def __init__(self, at_ns: int, hz: float, spin_up_ns: int) -> None:
        """At rest at azimuth 0; it takes `spin_up_ns` to reach `hz`."""
        self._knots = [Knot(at_ns, 0.0, 0.0)]
        self._acceleration = hz / (spin_up_ns * 1e-9) if spin_up_ns else float("inf")
        self.hz = hz
        "What it is set to."
        self.set_speed(at_ns, hz)

    def turns(self, at_ns: NDArray[np.int64]) -> Floats:
        """Turns of the head since its start, modulo whole ones at knots; any shape, after the first knot kept."""
        knots = self._knots
        begun = np.array([one.at_ns for one in knots])
        place = np.maximum(np.searchsorted(begun, (at_ns.min(), at_ns.max()), side="right") - 1, 0)
        if place[0] == place[1]:  # as nearly always: one piece
            return self._on(knots[place[0]], at_ns)
        pieces = np.maximum(np.searchsorted(begun, at_ns, side="right") - 1, 0)
        found = np.zeros(at_ns.shape)
        for index in range(place[0], place[1] + 1):
            found[pieces == index] = self._on(knots[index], at_ns[pieces == index])
        return found

    def turn(self, at_ns: int) -> int:
        """Whole turns of the head since its start."""
        knot = next((one for one in reversed(self._knots) if one.at_ns <= at_ns), self._knots[0])
        return knot.whole + int(self._on(knot, np.array(at_ns)) // 1.0)

    @staticmethod
    def _on(knot: Knot, at_ns: NDArray[np.int64]) -> Floats:
        after_s = np.asarray(1e-9 * (at_ns - knot.at_ns), np.float64)
        if knot.acceleration == 0.0:
            return knot.turns + knot.hz * after_s
        return knot.turns + after_s * (knot.hz + 0.5 * knot.acceleration * after_s)

    def speed_hz(self, at_ns: int) -> float:
        """Turns per second."""
        knot = next((one for one in reversed(self._knots) if one.at_ns <= at_ns), self._knots[0])
        return knot.hz + knot.acceleration * 1e-9 * (at_ns - knot.at_ns)

    def is_steady(self, at_ns: int) -> bool:
        """Whether it does not ramp."""
        return next((one for one in reversed(self._knots) if one.at_ns <= at_ns), self._knots[0]).acceleration == 0.0

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
        behind = (to_turns - float(self.turns(np.array(at_ns))) + 0.5) % 1.0 - 0.5
        most = LOCK_STEP * self.hz
        self._put(at_ns, self.hz + min(max(behind, -most), most), 0.0)

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

    def _put(self, at_ns: int, hz: float, acceleration: float) -> None:
        turns, whole = float(self.turns(np.array(at_ns))) % 1.0, self.turn(at_ns)
        self._knots = [one for one in self._knots if one.at_ns < at_ns][-KNOTS_KEPT:]
        self._knots.append(Knot(at_ns, turns, hz, acceleration, whole))


@dataclass
class Gps:
    """Pulses of a receiver at full seconds of UTC, and what a clock makes of them."""

    utc_ns: int
    "Since 1970, at the beginning of the run."
    pulses: bool
    sentences: bool
    true_ns: Callable[[int], int] = field(default=lambda own_ns: own_ns)
    "From the device's own instants to the run's, and back."
    own_ns: Callable[[int], int] = field(default=lambda true_ns: true_ns)
    since_ns: int = 0
    "Pulses come, or do not, since then."
    held: tuple[int, int] | None = None
    "Of pulses that have ended: the last one, and its UTC; the clock goes on from there."

    def powered_on(self, at_ns: int) -> None:
        """Nothing is known of pulses before."""
        self.since_ns, self.held = at_ns, None

    def switch(self, at_ns: int, pulses: bool) -> None:
        """Pulses end, or come again."""
        if pulses == self.pulses:
            return
        if self.pulses and self.locked(at_ns):
            self.held = self._last(at_ns)
        self.pulses, self.since_ns = pulses, at_ns

    def utc(self, at_ns: int) -> int:
        """True UTC. [ns since 1970]"""
        return self.utc_ns + self.true_ns(at_ns)

    def _last(self, at_ns: int) -> tuple[int, int]:
        second_ns = self.utc(at_ns) // SECOND_NS * SECOND_NS
        return self.own_ns(second_ns - self.utc_ns), second_ns

    def after(self, at_ns: int) -> int:
        """The first pulse later than an instant, if they come."""
        # by a nanosecond, the conversion's rounding, so that the next one is another
        return self.own_ns((self.utc(at_ns) // SECOND_NS + 1) * SECOND_NS - self.utc_ns) + 1

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
        pulse = self._last(at_ns) if self.locked(at_ns) else self.held
        if pulse is None:
            return clock.shown_ns(at_ns), 0
        return pulse[1] + clock.shown_ns(at_ns) - clock.shown_ns(pulse[0]), self.utc_ns
