"""A rotor that turns freely: its angle at an instant, and which samples of a fixed rate fall into which turn.

Belongs here: closed forms of angle and time, numbers of samples. Not: what a device measures or sends.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property

import numpy as np

from protocols.scan import Floats
from protocols.skeleton.instants import SECOND_NS, Raster

WOBBLES = ((0.7, 1.3), (0.3, 0.37))
"Share and frequency [Hz] of what the speed of a motor wobbles by; no source has figures, these are ours."
LOAD_TURNS = 7.3
"One up and down of the speed of a `LoadedRotor`; ours."
ROUNDS = 60
"Of Newton's method; it takes about five."
KEPT = 8
"Turns whose first sample is kept: the present one and its neighbours are asked for again and again."


@dataclass(frozen=True)
class Rotor:
    """Speed ``hz (1 + wobble w(t)) + (from_hz - hz) exp(-t / settle)``, its integral in turns; t from `at_ns` on."""

    at_ns: int
    turns: float
    "Turns made by `at_ns`."
    hz: float
    "Speed that the motor is controlled to; > 0."
    from_hz: float
    "Speed at `at_ns`."
    settle_s: float
    "Time constant of a change of speed."
    wobble: float = 0.0
    "The speed is within this share of `hz` when it has settled."

    def _since_s(self, at_ns: int) -> float:
        return max(0, at_ns - self.at_ns) / SECOND_NS

    def speed_hz(self, at_ns: int) -> float:
        """Speed at an instant; before `at_ns` that at `at_ns`."""
        t = self._since_s(at_ns)
        swing = 0.0
        for share, hz in WOBBLES if self.wobble else ():
            swing += share * math.sin(2.0 * math.pi * hz * t)
        settled = self.hz * (1.0 + self.wobble * swing)
        return settled if self.from_hz == self.hz else settled + (self.from_hz - self.hz) * math.exp(-t / self.settle_s)

    def turned(self, at_ns: int) -> float:
        """Turns made by an instant; before `at_ns` those at `at_ns`."""
        t = self._since_s(at_ns)
        swing = 0.0
        for share, hz in WOBBLES if self.wobble else ():
            swing += share * (1.0 - math.cos(2.0 * math.pi * hz * t)) / (2.0 * math.pi * hz)
        turned = self.turns + self.hz * (t + self.wobble * swing)
        if self.from_hz == self.hz:
            return turned
        return turned + (self.from_hz - self.hz) * (self.settle_s * -math.expm1(-t / self.settle_s))

    def turned_at(self, since_s: Floats) -> Floats:
        """The same for times after `at_ns`, any shape."""
        swing = np.zeros_like(since_s)
        for share, hz in WOBBLES if self.wobble else ():
            swing += share * (1.0 - np.cos(2.0 * np.pi * hz * since_s)) / (2.0 * np.pi * hz)
        settled = self.settle_s * -np.expm1(-since_s / self.settle_s)
        return np.asarray(
            self.turns + self.hz * (since_s + self.wobble * swing) + (self.from_hz - self.hz) * settled, np.float64
        )

    def instant_of(self, turns: float) -> int:
        """When it has made so many turns, to about a nanosecond; `at_ns` if it has made them before."""
        if turns <= self.turned(self.at_ns):
            return self.at_ns
        t = (turns - self.turns) / self.hz
        for _ in range(ROUNDS):
            at_ns = self.at_ns + round(t * SECOND_NS)
            step = (turns - self.turned(at_ns)) / max(self.speed_hz(at_ns), 1e-3 * self.hz)
            t = max(0.0, (at_ns - self.at_ns) / SECOND_NS + step)
            if abs(step) < 1e-9:
                break
        return self.at_ns + round(t * SECOND_NS)

    def driven(self, at_ns: int, hz: float) -> Rotor:
        """With another controlled speed from an instant on; the angle goes on from there."""
        return replace(self, at_ns=at_ns, turns=self.turned(at_ns), hz=hz, from_hz=self.speed_hz(at_ns))

    def settled_ns(self, share: float) -> int:
        """From when on the speed, without its wobble, is within this share of `hz`, which is not 0."""
        off = abs(self.from_hz - self.hz) / (share * self.hz)
        return self.at_ns + (round(SECOND_NS * self.settle_s * math.log(off)) if off > 1.0 else 0)


@dataclass(frozen=True)
class LoadedRotor(Rotor):
    """One whose speed goes up and down with its angle, as under an uneven load; `hz` may be 0: it is to stand.

    `turns` and `speed_hz` are without that.
    """

    load: float = 0.0
    "Share of the speed by which it goes up and down."

    def turned(self, at_ns: int) -> float:
        """Turns made by an instant; before `at_ns` those at `at_ns`."""
        even = super().turned(at_ns)
        rate = 2.0 * math.pi / LOAD_TURNS
        return even + self.load / rate * math.sin(rate * even)

    def turned_at(self, since_s: Floats) -> Floats:
        """The same for times after `at_ns`, any shape."""
        even = super().turned_at(since_s)
        rate = 2.0 * math.pi / LOAD_TURNS
        return np.asarray(even + self.load / rate * np.sin(rate * even), np.float64)

    def driven(self, at_ns: int, hz: float) -> LoadedRotor:
        """With another controlled speed from an instant on; the angle goes on from there."""
        return replace(self, at_ns=at_ns, turns=super().turned(at_ns), hz=hz, from_hz=self.speed_hz(at_ns))


@dataclass(frozen=True)
class Turns:
    """The turns of a rotor as sweeps of samples: turn n has the samples taken from its n-th passing of zero on."""

    rotor: Rotor
    samples: Raster
    "Instants of all samples."
    since: int = 0
    "The first sample of the stream; the turn that it is in is not whole."
    group: int = 1
    "A turn begins with the next whole group of samples, counted from `since`: a packet is not cut."
    numbered: int | None = None
    "Number of the turn in which the stream begins; None: as many as the rotor has made."
    part: int = 0
    "Of a rotor that stands so many samples count as a turn; 0: it turns."

    @property
    def period_ns(self) -> Fraction:
        """Of a turn at the controlled speed."""
        return self.part * self.samples.period_ns if self.part else Fraction(SECOND_NS) / Fraction(self.rotor.hz)

    _found: dict[int, int] = field(default_factory=dict, init=False, repr=False, compare=False)
    "First samples of the turns asked for last."

    @cached_property
    def first(self) -> int:
        """Number of the turn in which the stream begins."""
        return self._made if self.numbered is None else self.numbered

    @cached_property
    def _made(self) -> int:
        """Turns that the rotor has made when the stream begins."""
        return math.floor(self.rotor.turned(self.samples.at(self.since)))

    def sample(self, number: int) -> int:
        """Number of the first sample of a turn."""
        found = self._found.get(number)
        if found is None:
            while len(self._found) >= KEPT:
                self._found.pop(next(iter(self._found)), None)
            found = self._found[number] = self._first_of(number)
        return found

    def _first_of(self, number: int) -> int:
        if number <= self.first:
            return self.since
        if self.part:
            return self.since + (number - self.first) * self.part
        turns = number - self.first + self._made
        index = max(self.since, self.samples.first_from(self.rotor.instant_of(turns)))
        while self.rotor.turned(self.samples.at(index)) < turns:
            index += 1
        while index > self.since and self.rotor.turned(self.samples.at(index - 1)) >= turns:
            index -= 1
        return self.since - (self.since - index) // self.group * self.group

    def at(self, number: int) -> int:
        """When a turn begins."""
        return self.samples.at(self.sample(number))

    def first_from(self, instant_ns: int) -> int:
        """The least number whose turn begins at `instant_ns` or later."""
        if self.part:
            return self.first + max(0, -((self.since - self.samples.first_from(instant_ns)) // self.part))
        number = max(self.first, math.floor(self.rotor.turned(instant_ns)) - self._made + self.first)
        while self.at(number) < instant_ns:
            number += 1
        while number > self.first and self.at(number - 1) >= instant_ns:
            number -= 1
        return number

    def turned(self, number: int) -> tuple[Floats, Floats]:
        """Of the samples of a turn: when each is taken after the first, in s, and the turns that the rotor has made."""
        first, end = self.sample(number), self.sample(number + 1)
        after_s = np.asarray(np.arange(end - first) * (float(self.samples.period_ns) / SECOND_NS), np.float64)
        begin_s = (self.samples.at(first) - self.rotor.at_ns) / SECOND_NS
        return after_s, self.rotor.turned_at(np.asarray(begin_s + after_s, np.float64))
