"""A run in virtual time: instruments step from deadline to deadline as fast as they can be computed.

Time moves only in `advance`; what hosts write between two calls is taken at the present instant.
"""

from __future__ import annotations

from collections.abc import Sequence

from emulator.clock import ManualClock
from emulator.instrument import Instrument

MAX_STEPS_AT_ONCE = 10_000
"Steps of one instrument without time moving; more means that it never comes to rest."


class VirtualRun:
    """Steps instruments on a clock of its own."""

    def __init__(self, instruments: Sequence[Instrument]) -> None:
        self.clock = ManualClock()
        self.instruments = tuple(instruments)
        self._wakes: list[int | None] = [None] * len(self.instruments)

    def power_on(self) -> None:
        """Switch every device on at the present instant."""
        for index, instrument in enumerate(self.instruments):
            instrument.power_on(self.clock.now_ns())
            self._wakes[index] = self.clock.now_ns()

    def advance(self, until_ns: int) -> None:
        """Move to `until_ns`, doing on the way all that is due, in order of time, then of the sensors."""
        self._wakes = [self.clock.now_ns()] * len(self.instruments)  # hosts may have written meanwhile
        still = 0
        while True:
            due = [wake for wake in self._wakes if wake is not None]
            if not due or min(due) > until_ns:
                break
            wake = max(min(due), self.clock.now_ns())
            still = still + 1 if wake == self.clock.now_ns() else 0
            if still > MAX_STEPS_AT_ONCE:
                raise RuntimeError(f"a sensor does not come to rest at {wake} ns")
            self.clock.set(wake)
            for index, instrument in enumerate(self.instruments):
                mine = self._wakes[index]
                if mine is not None and mine <= wake:
                    self._wakes[index] = instrument.step(wake)
        self.clock.set(until_ns)
