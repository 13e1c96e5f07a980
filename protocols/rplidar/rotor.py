"""The motor of an RPLIDAR, which turns freely: its speed goes to what is set and wobbles, its angle is measured.

Belongs here: angles and instants. Not: who sets the speed (device).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from protocols.skeleton.instants import Raster

STABLE = 0.05
"Of the speed that is set: nearer to it the motor is stable."
WOBBLE_TURNS = 7.3
"One up and down of its speed, in turns; ours."
RATE = 2.0 * math.pi / WOBBLE_TURNS
NEVER_NS = 1 << 62
STANDS_HZ = 0.2
"Below, it makes no turns that count."


@dataclass(frozen=True)
class Rotor:
    """The motor since its speed was set last."""

    since_ns: int
    turns: float
    "At that instant."
    hz: float
    "Speed at that instant."
    aim_hz: float
    "The speed that is set."
    tau_s: float
    "Of the approach, which is exponential."
    wobble: float

    def at(self, instants_ns: NDArray[np.float64]) -> NDArray[np.float64]:
        """Turns since power-on, of instants after `since_ns`; never falling."""
        s = np.maximum((instants_ns - self.since_ns) * 1e-9, 0.0)
        lag = 0.0 if self.tau_s <= 0.0 else (self.hz - self.aim_hz) * self.tau_s * -np.expm1(-s / self.tau_s)
        u = self.turns + self.aim_hz * s + lag
        return np.asarray(u + self.wobble / RATE * np.sin(RATE * u), np.float64)

    def _even(self, now_ns: int) -> float:
        """Turns without the wobble."""
        s = max(now_ns - self.since_ns, 0) * 1e-9
        lag = 0.0 if self.tau_s <= 0.0 else (self.hz - self.aim_hz) * self.tau_s * -math.expm1(-s / self.tau_s)
        return self.turns + self.aim_hz * s + lag

    def now(self, now_ns: int) -> float:
        """Turns since power-on, of one instant."""
        u = self._even(now_ns)
        return u + self.wobble / RATE * math.sin(RATE * u)

    def speed(self, now_ns: int) -> float:
        """Without the wobble. [Hz]"""
        s = max(now_ns - self.since_ns, 0) * 1e-9
        return self.aim_hz + (0.0 if self.tau_s <= 0.0 else (self.hz - self.aim_hz) * math.exp(-s / self.tau_s))

    def set(self, now_ns: int, aim_hz: float) -> Rotor:
        """Another speed from now on."""
        return replace(self, since_ns=now_ns, turns=self._even(now_ns), hz=self.speed(now_ns), aim_hz=aim_hz)

    def stable_ns(self) -> int:
        """From when on it is stable; `NEVER_NS` while it is set to stand."""
        if self.aim_hz < STANDS_HZ:
            return NEVER_NS
        off = abs(self.hz - self.aim_hz) / (STABLE * self.aim_hz)
        return self.since_ns + (round(1e9 * self.tau_s * math.log(off)) if off > 1.0 else 0)

    def reaches_ns(self, turns: float, from_ns: int) -> int:
        """The first instant from `from_ns` on at which it has made so many turns."""
        low, high = from_ns, from_ns + 1
        if self.now(low) >= turns:
            return low
        while self.now(high) < turns:
            low, high = high, from_ns + 2 * (high - from_ns)
            if high - from_ns > 1 << 50:
                return NEVER_NS
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (middle, high) if self.now(middle) < turns else (low, middle)
        return high


@dataclass(frozen=True)
class Turns(Raster):
    """Sweeps of a stream of samples: the first begins with it, each other one with the first sample of a turn."""

    rotor: Rotor = field(kw_only=True)
    sample_ns: Fraction = field(kw_only=True)

    def sample_at(self, index: int) -> int:
        """When a sample is taken; sample 0 at `zero_ns`."""
        return self.zero_ns + index * self.sample_ns.numerator // self.sample_ns.denominator

    def index(self, number: int) -> int:
        """The first sample of a sweep."""
        return _index(self, number)

    def at(self, number: int) -> int:
        """Instant of the first sample of a sweep."""
        return self.sample_at(self.index(number))

    def first_from(self, instant_ns: int) -> int:
        """The least sweep that begins at that instant or later."""
        if instant_ns <= self.zero_ns:
            return self.first
        passed = math.floor(self.rotor.now(instant_ns)) - math.floor(self.rotor.now(self.zero_ns) + 1e-9)
        number = self.first + max(passed, 0)
        while self.at(number) < instant_ns:
            number += 1
        return number


@lru_cache(maxsize=256)
def _index(turns: Turns, number: int) -> int:
    if number <= turns.first:
        return 0
    begun = math.floor(turns.rotor.now(turns.zero_ns) + 1e-9)
    turn_ns = turns.rotor.reaches_ns(begun + number - turns.first, turns.zero_ns)
    return -((turns.zero_ns - turn_ns) * turns.sample_ns.denominator // turns.sample_ns.numerator)
