"""How well this machine keeps deadlines: the sender's way of waiting against asyncio.sleep, in the same seconds."""

from __future__ import annotations

import asyncio
import os
import select
from dataclasses import dataclass

from emulator.process.clock import SystemClock
from emulator.process.waiting import Waiter, be_realtime, be_usual, sharpen_timers
from emulator.runtime.daemon import Lateness

PERIOD_NS = 13_333_333
"75 Hz, the scan rate of an LMS2xx at 1 degree."


@dataclass(frozen=True)
class Pacing:
    """Lateness of both ways of waiting."""

    ours: Lateness
    asyncio_sleep: Lateness
    realtime: Lateness
    "Ours, scheduled before all others; no figures where that is refused."
    awake_share: float
    "Of one core, while ours waited: what waking early costs."


class _Ours:
    """As `Daemon` waits: an absolute deadline, an epoll set, awake for the last of it."""

    def __init__(self) -> None:
        self._clock = SystemClock()
        self._set = select.epoll()
        self._bell, self._ring = os.pipe()
        self._set.register(self._bell, select.EPOLLIN)
        self._waiter = Waiter(self._clock, self._set.fileno())
        self._took_ns = 0

    def turn(self, count: int) -> list[int]:
        """Lateness of so many deadlines."""
        late = []
        start_ns = self._clock.now_ns()
        for number in range(1, count + 1):
            deadline_ns = start_ns + number * PERIOD_NS
            while self._clock.now_ns() < deadline_ns:
                self._waiter.until(deadline_ns)
            late.append(self._clock.now_ns() - deadline_ns)
        self._took_ns += self._clock.now_ns() - start_ns
        return late

    @property
    def awake_share(self) -> float:
        """Time awake over all time so far."""
        return self._waiter.awake_ns / max(1, self._took_ns)

    def close(self) -> None:
        """Release the descriptors."""
        self._set.close()
        os.close(self._bell)
        os.close(self._ring)


async def _asyncio(count: int) -> list[int]:
    """As asyncio code is mostly written, already with absolute deadlines."""
    clock = SystemClock()
    late = []
    for number in range(1, count + 1):
        deadline_ns = number * PERIOD_NS
        await asyncio.sleep(max(0, deadline_ns - clock.now_ns()) * 1e-9)
        late.append(max(0, clock.now_ns() - deadline_ns))
    return late


def measure(seconds: float) -> Pacing:
    """The same time for each, in turns of at most half a second, so that both meet the same disturbances."""
    sharpen_timers()
    ours: list[int] = []
    others: list[int] = []
    first: list[int] = []
    waiting = _Ours()
    turn = max(1, min(37, int(seconds * 1e9 / PERIOD_NS / 4)))
    waiting.turn(min(8, turn))  # how late this machine wakes is learned first
    while (len(ours) + len(others) + len(first)) * PERIOD_NS < seconds * 1e9:
        ours += waiting.turn(turn)
        others += asyncio.run(_asyncio(turn))
        if not be_realtime():
            first += waiting.turn(turn)
            be_usual()
    share = waiting.awake_share
    waiting.close()
    return Pacing(Lateness.of(ours), Lateness.of(others), Lateness.of(first), share)
