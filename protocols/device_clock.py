"""The clock of a device: its time at an instant of the run, as ticks of the width on the wire.

Belongs here: values and their integer arithmetic, from knots and never from a running sum. Not: the field of the
telegram that has it (the families), and a schedule that follows the device's quartz (timebase).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property
from typing import Literal

SECOND_NS = 1_000_000_000
BILLION = 1_000_000_000
MOST_CHANGES = 512
"Changes kept per clock; beyond that the oldest half becomes permanent."

Kind = Literal["step", "set", "rate", "stop", "go"]


@dataclass(frozen=True, init=False)
class DeviceStamp:
    """The time stamp of one telegram, and the true time."""

    true_ns: int
    "Instant of the run that the time stamp refers to."
    device_ns: int
    "The same on the device's clock, neither wrapped nor rounded to ticks."
    ticks: int
    "As on the wire."
    tick_ns: float
    bits: int
    "Width on the wire: it wraps at 2 to the power of it."

    def __init__(self, true_ns: int, device_ns: int, ticks: int, tick_ns: float, bits: int) -> None:
        # of each packet; what the decorator makes for a frozen class takes twice as long
        self.__dict__.update(true_ns=true_ns, device_ns=device_ns, ticks=ticks, tick_ns=tick_ns, bits=bits)


@dataclass(frozen=True)
class Change:
    """Something that happens to a clock."""

    at_ns: int
    kind: Kind
    value: int = 0
    "step: by this many ns; set: to this many ns; rate: error in parts per billion, positive: fast."


@dataclass(frozen=True)
class Knot:
    """From an instant on, the clock runs at a constant rate."""

    at_ns: int
    shows_ns: int
    ppb: int = 0
    goes: bool = True

    def shown_ns(self, at_ns: int) -> int:
        """What it shows at an instant, on this line; rounded down."""
        return self.shows_ns + ((at_ns - self.at_ns) * (BILLION + self.ppb) // BILLION if self.goes else 0)

    def after(self, change: Change) -> Knot:
        """The line from a change on."""
        shows_ns, ppb, goes = self.shown_ns(change.at_ns), self.ppb, self.goes
        if change.kind == "step":
            shows_ns += change.value
        elif change.kind == "set":
            shows_ns = change.value
        elif change.kind == "rate":
            ppb = change.value
        else:
            goes = change.kind == "go"
        return Knot(change.at_ns, shows_ns, ppb, goes)


@dataclass(frozen=True)
class DeviceClock:
    """A clock and its changes; immutable, a change gives a new one."""

    begin_ns: int = 0
    "Shown at power-on."
    runs_on: bool = False
    "Keeps running while the device is off, as one with a battery."
    changes: tuple[Change, ...] = ()
    "In order of time; those to come as well."
    origin: Knot = field(default=Knot(0, 0))
    begun: bool = False
    "It has been switched on once."

    @cached_property
    def _knots(self) -> tuple[Knot, ...]:
        knots = [self.origin]
        for change in self.changes:
            knots.append(knots[-1].after(change))
        return tuple(knots)

    def shown_ns(self, at_ns: int) -> int:
        """Time on the clock at an instant of the run, rounded down, not wrapped. [ns]"""
        knots = self._knots
        index = len(knots) - 1
        while index and knots[index].at_ns > at_ns:
            index -= 1
        return knots[index].shown_ns(at_ns)

    def ticks(self, at_ns: int, tick_ns: Fraction, bits: int) -> int:
        """The same counted in ticks of `tick_ns`, as wide as the wire has it."""
        return _wrapped(self.shown_ns(at_ns), tick_ns, bits)

    def reported(self, at_ns: int, tick_ns: Fraction, bits: int) -> DeviceStamp:
        """The time stamp of a telegram for an instant."""
        shown_ns = self.shown_ns(at_ns)
        return DeviceStamp(at_ns, shown_ns, _wrapped(shown_ns, tick_ns, bits), float(tick_ns), bits)

    def powered_on(self, at_ns: int) -> DeviceClock:
        """The device is switched on or restarts: the clock restarts, unless it runs on a battery."""
        if self.begun and self.runs_on:
            return self
        return replace(self.changed(Change(at_ns, "set", self.begin_ns)), begun=True)

    def stepped(self, at_ns: int, by_ns: int) -> DeviceClock:
        """Stepped forward or back at an instant."""
        return self.changed(Change(at_ns, "step", by_ns))

    def set_to(self, at_ns: int, shows_ns: int) -> DeviceClock:
        """Set to a value at an instant."""
        return self.changed(Change(at_ns, "set", shows_ns))

    def at_rate(self, at_ns: int, ppb: int) -> DeviceClock:
        """With this rate error from an instant on, positive: fast. [ppb]"""
        return self.changed(Change(at_ns, "rate", ppb))

    def stopped(self, at_ns: int) -> DeviceClock:
        """Stopped from an instant on."""
        return self.changed(Change(at_ns, "stop"))

    def going(self, at_ns: int) -> DeviceClock:
        """Continues from where it stopped."""
        return self.changed(Change(at_ns, "go"))

    def ppb(self, at_ns: int) -> int:
        """Rate error at an instant, positive: fast. [ppb]"""
        return next(knot.ppb for knot in reversed(self._knots) if knot.at_ns <= at_ns or knot is self._knots[0])

    def changed(self, change: Change) -> DeviceClock:
        """One more change; after those of the same instant."""
        place = len(self.changes)
        while place and self.changes[place - 1].at_ns > change.at_ns:
            place -= 1
        changes = (*self.changes[:place], change, *self.changes[place:])
        if len(changes) <= MOST_CHANGES:
            return replace(self, changes=changes)
        done = MOST_CHANGES // 2
        return replace(self, changes=changes[done:], origin=replace(self, changes=changes[:done])._knots[-1])


def _wrapped(shown_ns: int, tick_ns: Fraction, bits: int) -> int:
    return shown_ns * tick_ns.denominator // tick_ns.numerator & ((1 << bits) - 1)


def ns_of_ticks(ticks: int, tick_ns: Fraction) -> int:
    """The least time that shows so many ticks. [ns]"""
    return -(-ticks * tick_ns.numerator // tick_ns.denominator)
