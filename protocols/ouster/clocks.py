"""What time an Ouster stamps with: its oscillator, pulses each second, or PTP.

Belongs here: times over instants. Not: which of them is chosen (config), how a stamp is written (codec).
"""

from __future__ import annotations

from dataclasses import dataclass

from protocols.device_clock import DeviceClock
from protocols.ouster.config import OSCILLATOR, PTP
from protocols.skeleton.instants import SECOND_NS
from protocols.skeleton.utc import TrueTime

TAI_NS = 37 * SECOND_NS
"TAI over UTC since 2017; what the usual masters send."


@dataclass
class Sources(TrueTime):
    """Master and receiver, as far as they are there."""

    ptp: bool
    ptp_lock_ns: int
    "From power-on until the clock follows the master."
    pulses: bool
    sentences: bool
    on_ns: int = 0
    "Power-on."
    ptp_lost: tuple[int, int] | None = None
    "Instant from which no master is there, and what the clock showed then."

    def follows_ptp(self, at_ns: int) -> bool:
        """Whether the clock is the master's."""
        return self.ptp and self.ptp_lost is None and at_ns >= self.on_ns + self.ptp_lock_ns

    def pulses_seen(self, at_ns: int) -> int:
        """Pulses since power-on."""
        return self.utc(at_ns) // SECOND_NS - self.utc(self.on_ns) // SECOND_NS if self.pulses else 0

    def locked(self, mode: str, at_ns: int) -> bool:
        """Whether the time of a mode comes from outside by now."""
        if mode == PTP:
            return self.follows_ptp(at_ns)
        return mode != OSCILLATOR and self.pulses_seen(at_ns) > 0

    def lose_ptp(self, at_ns: int, clock: DeviceClock, lost: bool) -> None:
        """The master goes, or comes back."""
        if lost and self.ptp_lost is None and self.follows_ptp(at_ns):
            self.ptp_lost = at_ns, self.shown_ns(PTP, False, 0, clock, at_ns)[0]
        elif not lost:
            self.ptp_lost = None

    def shown_ns(self, mode: str, nmea: bool, leap_s: int, clock: DeviceClock, at_ns: int) -> tuple[int, int]:
        """Time in a mode at an instant, and what it shows when the run begins."""
        if mode == PTP and self.ptp_lost is not None and self.ptp:
            since_ns, showed_ns = self.ptp_lost
            return showed_ns + clock.shown_ns(at_ns) - clock.shown_ns(since_ns), self.utc_ns + TAI_NS
        if not self.locked(mode, at_ns):
            return clock.shown_ns(at_ns), 0
        utc_ns = self.utc(at_ns)
        if mode == PTP:
            return utc_ns + TAI_NS, self.utc_ns + TAI_NS
        if nmea and self.sentences:
            return utc_ns + leap_s * SECOND_NS, self.utc_ns + leap_s * SECOND_NS
        first_ns = (self.utc(self.on_ns) // SECOND_NS) * SECOND_NS
        return utc_ns - first_ns, self.utc_ns - first_ns
