"""How well this machine keeps deadlines: the sender's way of waiting against asyncio.sleep, in the same seconds."""

from __future__ import annotations

import asyncio
import select
from dataclasses import dataclass

from emulator.clock import SystemClock
from emulator.daemon import Lateness, sharpen_timers

PERIOD_NS = 13_333_333
"75 Hz, the scan rate of an LMS2xx at 1 degree."


@dataclass(frozen=True)
class Pacing:
    """Lateness of both ways of waiting."""

    ours: Lateness
    asyncio_sleep: Lateness


def _ours(count: int) -> list[int]:
    """As `Daemon` waits: an absolute deadline, select on descriptors to the microsecond."""
    clock = SystemClock()
    late = []
    for number in range(1, count + 1):
        deadline_ns = number * PERIOD_NS
        while (left_ns := deadline_ns - clock.now_ns()) > 0:
            select.select([], [], [], left_ns * 1e-9)
        late.append(clock.now_ns() - deadline_ns)
    return late


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
    """Half of the time for each, in turns of at most half a second, so that both meet the same disturbances."""
    sharpen_timers()
    ours: list[int] = []
    others: list[int] = []
    turn = max(1, min(37, int(seconds * 1e9 / PERIOD_NS / 4)))
    while (len(ours) + len(others)) * PERIOD_NS < seconds * 1e9:
        ours += _ours(turn)
        others += asyncio.run(_asyncio(turn))
    return Pacing(Lateness.of(ours), Lateness.of(others))
