"""Instants of something that goes too fast or too slow, against those of the run: a quartz, a motor.

Belongs here: the arithmetic, in whole numbers, exact both ways. Not: what follows the quartz (timebase, the families).
"""

from __future__ import annotations

from dataclasses import dataclass

BILLION = 1_000_000_000


@dataclass(frozen=True)
class Pace:
    """From an instant on, the quartz runs too fast by parts per billion."""

    true_ns: int
    own_ns: int
    ppb: int


@dataclass(frozen=True)
class Quartz:
    """The device's own time against the run's; both are the same before the first pace."""

    paces: tuple[Pace, ...] = (Pace(0, 0, 0),)

    def own_ns(self, true_ns: int) -> int:
        """The device's own instant, rounded down."""
        pace = self.paces[0]
        if len(self.paces) > 1:
            pace = next((one for one in reversed(self.paces) if one.true_ns <= true_ns), pace)
        return pace.own_ns + (true_ns - pace.true_ns) * (BILLION + pace.ppb) // BILLION

    def true_ns(self, own_ns: int) -> int:
        """The first instant of the run at which the device's own one has been reached."""
        # a pace that begins with that instant has it from the one before, maybe earlier
        pace = self.paces[0]
        if len(self.paces) > 1:
            pace = next((one for one in reversed(self.paces) if one.own_ns < own_ns), pace)
        return pace.true_ns - (pace.own_ns - own_ns) * BILLION // (BILLION + pace.ppb)

    def ppb(self, true_ns: int) -> int:
        """How much too fast it runs at an instant."""
        return next((one.ppb for one in reversed(self.paces) if one.true_ns <= true_ns), self.paces[0].ppb)

    def at_rate(self, true_ns: int, ppb: int) -> Quartz:
        """Another rate from an instant on."""
        if ppb == self.ppb(true_ns):
            return self
        return Quartz((*self.paces[-255:], Pace(true_ns, self.own_ns(true_ns), ppb)))

    @property
    def is_true(self) -> bool:
        """It has never been off."""
        return self == TRUE


TRUE = Quartz()
"Goes with the run."
