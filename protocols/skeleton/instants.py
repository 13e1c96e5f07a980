"""Instants computed from an index and never from a running sum, timers, and execution in order of time.

Belongs here: arithmetic on integer nanoseconds. Not: what happens at an instant.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from fractions import Fraction
from typing import Protocol

SECOND_NS = 1_000_000_000
FAR_BEHIND = 10
"Missed periods of a timer beyond which they are not made up one by one."


def earliest(instants: Iterable[int | None]) -> int | None:
    """The first of them; None when there is none."""
    first: int | None = None
    for instant in instants:
        if instant is not None and (first is None or instant < first):
            first = instant
    return first


def run_until(now_ns: int, from_ns: int, next_instant: Callable[[], int | None], happen: Callable[[int], None]) -> int:
    """Execute everything that is due by `now_ns`, each at its own instant; the time reached.

    `next_instant` is called again after each `happen`, which must advance it. An instant in the past is executed at the
    time already reached, at first `from_ns`.
    """
    while (instant := next_instant()) is not None and instant <= now_ns:
        from_ns = max(from_ns, instant)
        happen(from_ns)
    return max(from_ns, now_ns)


class Numbered(Protocol):
    """Instants by their numbers, ascending."""

    @property
    def period_ns(self) -> Fraction:
        """From one to the next, nominally."""

    def at(self, number: int) -> int:
        """Instant of a number."""

    def first_from(self, instant_ns: int) -> int:
        """The least number whose instant is `instant_ns` or later."""


@dataclass(frozen=True)
class Raster:
    """Numbered instants: number `first` at `zero_ns`, then one per period, rounded down to nanoseconds."""

    zero_ns: int
    period_ns: Fraction
    "May be a fraction: 40/3 ms is a rate of 75 per second."
    first: int = 0

    def at(self, number: int) -> int:
        """Instant of a number; before `first` too."""
        return self.zero_ns + (number - self.first) * self.period_ns.numerator // self.period_ns.denominator

    def first_from(self, instant_ns: int) -> int:
        """The least number whose instant is `instant_ns` or later."""
        # at(n) >= t is floor((n - first) p) >= t - zero, and that is (n - first) p >= t - zero, as the right is whole
        behind = (instant_ns - self.zero_ns) * self.period_ns.denominator
        return self.first - (-behind // self.period_ns.numerator)

    def going_on(self, number: int, period_ns: Fraction) -> Raster:
        """With another period from the instant of that number on."""
        return Raster(self.at(number), period_ns, number)


def rounded(period_ns: Fraction, count: int) -> list[int]:
    """`round(at * period_ns)` of the numbers from 0 on, without a fraction for each."""
    above, below = period_ns.numerator, period_ns.denominator
    found = []
    for at in range(count):
        whole, rest = divmod(at * above, below)
        found.append(whole + (2 * rest > below or (2 * rest == below and whole & 1)))
    return found


@dataclass
class Timer:
    """A periodic action."""

    due_ns: int
    period_ns: int
    action: Callable[[int], None]


@dataclass(eq=False)
class Alarm:
    """An action at one instant, once, whenever one is set."""

    action: Callable[[int], None]
    at_ns: int | None = None
    "None: not set."


class Timers:
    """The timers and alarms of one device."""

    def __init__(self) -> None:
        self._timers: list[Timer] = []
        self._alarms: list[Alarm] = []

    def add(self, first_ns: int, period_ns: int, action: Callable[[int], None]) -> Timer:
        """Call `action(instant)` periodically, first at `first_ns`."""
        timer = Timer(first_ns, period_ns, action)
        self._timers.append(timer)
        return timer

    def alarm(self, action: Callable[[int], None]) -> Alarm:
        """One that is not set; `clear` keeps it."""
        alarm = Alarm(action)
        self._alarms.append(alarm)
        return alarm

    def clear(self) -> None:
        """Remove all timers; no alarm is set any more."""
        self._timers.clear()
        for alarm in self._alarms:
            alarm.at_ns = None

    def next_ns(self) -> int | None:
        """When the next one is due."""
        first: int | None = None
        for timer in self._timers:  # asked several times for each packet: no tuple, no generator
            if first is None or timer.due_ns < first:
                first = timer.due_ns
        for alarm in self._alarms:
            if alarm.at_ns is not None and (first is None or alarm.at_ns < first):
                first = alarm.at_ns
        return first

    def run(self, now_ns: int) -> None:
        """Execute what is due, in order; a timer that is more than `FAR_BEHIND` periods late is executed once."""
        for alarm in self._alarms:
            if alarm.at_ns is not None and alarm.at_ns <= now_ns:
                alarm.at_ns = None
                alarm.action(now_ns)
        while due := [timer for timer in self._timers if timer.due_ns <= now_ns]:
            timer = min(due, key=lambda timer: timer.due_ns)
            if now_ns - timer.due_ns > FAR_BEHIND * timer.period_ns:
                timer.due_ns += (now_ns - timer.due_ns) // timer.period_ns * timer.period_ns
            at_ns = timer.due_ns
            timer.due_ns += timer.period_ns
            timer.action(at_ns)
