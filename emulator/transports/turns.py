"""Limits of the CPU time that the sender spends on the input of one link or sensor.

Belongs here: the bucket of time, and the rest when it is empty. Not: what is left undone meanwhile (`InputBudget`,
`can_link`). In virtual time nothing rests: there is no clock, and the same run gives the same bytes.
"""

from __future__ import annotations

from collections.abc import Callable

AT_ONCE_NS = 1_000_000
"Longest work at once; what has come by then and is not yet done waits."
STOCK_NS = 3_000_000
"So much may be worked ahead: a host that behaves is not kept waiting for one long step."
REST = 3
"So many times as long who is alone does nothing then: a quarter of one core."
CROWD_REST = 5
"The same times all who share the time, where they are several: a fifth of one core for all."

CROWD_NS = 250_000_000
"Who has rested counts for so long as one of those who want the same time, though it works just now."


class Turn:
    """Who has worked for `STOCK_NS` more than its share rests until all of it is made up for."""

    def __init__(self) -> None:
        self.clock_ns: Callable[[], int] | None = None
        "Reports the processor time of the thread that works; None: there is no limit."
        self.wall_ns: Callable[[], int] | None = None
        """Reports the time, where that is sooner reported than processor time; less of it than `AT_ONCE_NS` is
        never too much."""
        self._wall_began_ns = 0
        self.resting = 1
        "How many share the time at present, this one included."
        self._spent_ns = 0.0
        self._at_ns = 0
        self._until_ns = -CROWD_NS

    def rests(self, now_ns: int) -> bool:
        """Nothing is to be done now."""
        return now_ns < self._until_ns

    def crowds(self, now_ns: int) -> bool:
        """It rests, or did a moment ago: one of those among whom the time is shared."""
        return now_ns < self._until_ns + CROWD_NS

    def wake_ns(self, now_ns: int) -> int | None:
        """When it wants to go on; None: it does not rest."""
        return self._until_ns if self.rests(now_ns) else None

    def begin(self) -> int:
        """To be handed to `end`."""
        self._wall_began_ns = 0 if self.wall_ns is None else self.wall_ns()
        return 0 if self.clock_ns is None else self.clock_ns()

    def over(self, began_ns: int) -> bool:
        """Whether that is enough for one go."""
        if self.clock_ns is None:
            return False
        if self.wall_ns is not None and self.wall_ns() - self._wall_began_ns < AT_ONCE_NS:
            return False
        return self.clock_ns() - began_ns > AT_ONCE_NS

    def end(self, began_ns: int, now_ns: int) -> bool:
        """Count what was spent since `begin`; whether it rests from now on."""
        if self.clock_ns is None:
            return False
        slower = 1 + (REST if self.resting <= 1 else CROWD_REST * self.resting)
        self._spent_ns = max(0.0, self._spent_ns - max(0, now_ns - self._at_ns) / slower)
        self._spent_ns += self.clock_ns() - began_ns
        self._at_ns = now_ns
        if self._spent_ns <= STOCK_NS:
            return False
        self._until_ns = now_ns + round(self._spent_ns * slower)
        return True
