"""How long our own processes are waited for: time in which we ran ourselves, deadlines, pauses between attempts.

Belongs here: the numbers, each with its reason, and the arithmetic on them. Not: what is done then (supervision,
liveness). docs/process_faults.md reports the same numbers; a test holds it to these.
"""

from __future__ import annotations

from collections import deque

SECOND_NS = 1_000_000_000
TICK_NS = SECOND_NS // 10
"Between two looks at the processes and sensors."
MOST_AT_ONCE_NS = 2 * TICK_NS
"What passes beyond it between two looks is not ours: we were stopped, or did not get the processor."

SWEEP_NS = 5 * SECOND_NS
SWEEP_TIMES = 20
"A sweep may take so long, and so many times as long as the longest of the last sweeps of that sensor."
FIRST_SWEEP_NS = 300 * SECOND_NS
"The first sweep of a sensor in a process compiles and fills tables: so long, as long as it uses the processor."
QUESTION_NS = 30 * SECOND_NS
BUILD_NS = 1800 * SECOND_NS
"So long a scene may be built, as long as that uses the processor."
IDLE_NS = 10 * SECOND_NS
"A first sweep that uses no processor time for so long stands still."
IDLE_BUILD_NS = 60 * SECOND_NS
"Building a scene reads files, from slow disks too."
STALLED_NS = SECOND_NS // 2
STALLED_TIMES = 10
"After so long, and so many times as long as the longest of the last, sweeps that wait are given up when they are late."
LIVED_NS = 10 * SECOND_NS
"A process that was ready for so long counts as sound: the one after it is started at once."
FIRST_PAUSE_NS, LONGEST_PAUSE_NS = SECOND_NS // 4, 30 * SECOND_NS
"After a second failure in a row, and the most that doubling comes to."
LATEST_KEPT = 16


class RunningTime:
    """Time that has passed while this process ran: a SIGSTOP of it, or a frozen container, does not count."""

    def __init__(self) -> None:
        self.ns = 0
        self._last_ns: int | None = None

    def pass_to(self, now_ns: int) -> int:
        """It is `now_ns` on a monotonic clock; the running time."""
        if self._last_ns is not None:
            self.ns += max(0, min(now_ns - self._last_ns, MOST_AT_ONCE_NS))
        self._last_ns = now_ns
        return self.ns


class Pace:
    """How long the sweeps of one sensor take, and so how long the next one may."""

    def __init__(self) -> None:
        self._took_ns: deque[int] = deque(maxlen=LATEST_KEPT)
        self.fresh = True
        "None has been measured in the present process."
        self.longest_ns = 0
        "Of the last ones; 0 before there were any."
        self.usual_ns = 0
        "The median of the last ones; 0 before there were any."

    def add(self, took_ns: int) -> None:
        """One more has been measured; 0: it came together with the one before, and says nothing."""
        if took_ns and not self.fresh:  # nor does the first say anything of the others
            self._took_ns.append(took_ns)
            ascending = sorted(self._took_ns)
            self.longest_ns, self.usual_ns = ascending[-1], ascending[len(ascending) // 2]
        self.fresh = False

    @property
    def deadline_ns(self) -> int:
        """A sweep that takes longer has stopped its process."""
        return FIRST_SWEEP_NS if self.fresh else SWEEP_NS + SWEEP_TIMES * self.longest_ns

    @property
    def stalled_ns(self) -> int:
        """A sweep that takes longer holds others up."""
        return IDLE_NS if self.fresh else max(STALLED_NS, STALLED_TIMES * self.longest_ns)


def pause_ns(failures: int) -> int:
    """Before the next attempt after so many failures in a row: none after the first, then doubling."""
    return 0 if failures < 2 else min(LONGEST_PAUSE_NS, FIRST_PAUSE_NS << min(failures - 2, 16))


class Stillness:
    """How long a process has used no processor time."""

    def __init__(self, now_ns: int) -> None:
        self._cpu_ns: int | None = None
        self._since_ns = now_ns

    def look(self, now_ns: int, cpu_ns: int | None) -> int:
        """For how long; 0 where that cannot be known."""
        if cpu_ns is None or cpu_ns != self._cpu_ns:
            self._cpu_ns, self._since_ns = cpu_ns, now_ns
        return now_ns - self._since_ns
