"""The rotating head: when it passes a direction, and how long the motor takes to its speed.

Everything is counted in whole ticks from one origin, so that no revolution's instant depends on the one before it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from protocols.ld.sectors import TICKS, Span
from protocols.quartz import TRUE, Quartz
from protocols.scan import Floats

Counts = NDArray[np.int64]

SECOND_NS = 1_000_000_000


@dataclass(frozen=True)
class Rotation:
    """A head that turns at one speed."""

    origin_ns: int
    "Instant, as its motor counts, at which it passed direction 0 of revolution 0."
    hz: int
    first_sweep: int
    "Number of revolution 0 since power-on."
    motor: Quartz = TRUE
    "How fast the motor turns against what it should."

    def passes_ns(self, revolution: int, ticks: int) -> int:
        """When it passes `ticks` (any integer) of a revolution, to the nearest nanosecond; never drifts."""
        rate = TICKS * self.hz
        return self.motor.true_ns(self.origin_ns + ((revolution * TICKS + ticks) * SECOND_NS + rate // 2) // rate)

    def first_from(self, instant_ns: int, ticks: int) -> int:
        """The first revolution whose `ticks` are passed at or after the instant."""
        rate = TICKS * self.hz
        revolution = ((self.motor.own_ns(instant_ns) - self.origin_ns) * rate // SECOND_NS - ticks) // TICKS
        while self.passes_ns(revolution, ticks) < instant_ns:
            revolution += 1
        return max(revolution, 0)

    def slowed(self, instant_ns: int) -> float:
        """By how much a revolution takes longer than it should."""
        return 1e9 / (1e9 + self.motor.ppb(instant_ns))

    def sweep_after(self, instant_ns: int) -> int:
        """A sweep number that no revolution up to the instant has had."""
        return self.first_sweep + self.first_from(instant_ns, 0) + 1


def beam_ticks(sectors: tuple[Span, ...], step: int) -> Counts:
    """(n,) ticks of all measured beams after the beginning of the revolution, ascending."""
    measuring = [span.offset + step * np.arange(span.points, dtype=np.int64) for span in sectors if span.points]
    return np.concatenate(measuring) if measuring else np.zeros(0, np.int64)


def azimuths_rad(ticks: Counts, first: int, zero_ticks: float) -> Floats:
    """Azimuths, positive to the left, of beams `ticks` after direction `first`; the wire's directions grow clockwise.

    `zero_ticks` is the azimuth of direction 0 in ticks. The result lies in [-pi, pi).
    """
    left = (zero_ticks - (first + ticks).astype(np.float64) + TICKS / 2) % TICKS - TICKS / 2
    return left * (2.0 * np.pi / TICKS)


@dataclass(frozen=True)
class Delays:
    """How long the device takes; times of neither profile are documented by the vendor."""

    response_ns: int
    spin_up_ns_per_hz: int
    shortest_spin_up_ns: int
    "From standstill."
    boot_ns: int
    "Power-on, and DO_RESET 0."
    restart_ns: int
    "DO_RESET 1."

    def spin_ns(self, from_hz: int, to_hz: int) -> int:
        """From one speed to another; 0 when it is reached already."""
        if from_hz == to_hz:
            return 0
        ramp = abs(to_hz - from_hz) * self.spin_up_ns_per_hz
        return ramp if from_hz else max(ramp, self.shortest_spin_up_ns)


MS = 1_000_000

DELAYS = {
    # 1 s to 5 Hz, 1.5 s to 10 Hz, 3 s to 20 Hz: "a few seconds"; hosts give up after 5 s (sicktoolbox) or 10 s
    "real": Delays(5 * MS, 150 * MS, 1000 * MS, 3000 * MS, 1000 * MS),
    "fast": Delays(1 * MS, 1 * MS, 20 * MS, 100 * MS, 50 * MS),
}
