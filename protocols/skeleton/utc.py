"""UTC as a receiver of GPS or a PTP master has it, at instants of a device that may have a quartz of its own.

Belongs here: true time and its full seconds. Not: what a clock makes of them (families).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from protocols.skeleton.instants import SECOND_NS


@dataclass
class TrueTime:
    """What time it is."""

    utc_ns: int
    "Since 1970, at the beginning of the run."
    true_ns: Callable[[int], int] = field(default=lambda own_ns: own_ns, kw_only=True)
    "From the device's own instants to the run's, and back."
    own_ns: Callable[[int], int] = field(default=lambda true_ns: true_ns, kw_only=True)

    def utc(self, at_ns: int) -> int:
        """True UTC. [ns since 1970]"""
        return self.utc_ns + self.true_ns(at_ns)


@dataclass
class FullSeconds(TrueTime):
    """With a signal at each full second, that can be lost."""

    since_ns: int = field(default=0, kw_only=True)
    "It is there, or not, since then."
    held: tuple[int, int] | None = field(default=None, kw_only=True)
    "Of a signal that was lost: the last full second, and its UTC; the clock goes on from there."

    def powered_on(self, at_ns: int) -> None:
        """Nothing is known from before."""
        self.since_ns, self.held = at_ns, None

    def last(self, at_ns: int) -> tuple[int, int]:
        """The newest full second, and its UTC."""
        second_ns = self.utc(at_ns) // SECOND_NS * SECOND_NS
        return self.own_ns(second_ns - self.utc_ns), second_ns

    def after(self, at_ns: int) -> int:
        """The first full second later than an instant, if the signal comes."""
        # by a nanosecond, the conversion's rounding, so that the next one is another
        return self.own_ns((self.utc(at_ns) // SECOND_NS + 1) * SECOND_NS - self.utc_ns) + 1
