"""Waiting for descriptors and absolute instants, to the microsecond.

Belongs here: `ppoll`, which takes descriptors of any number (select ends at 1023) and nanoseconds (epoll counts
milliseconds), and the little that is waited awake before a deadline. Not: what is due when (daemon).
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import platform
import struct
import sys
from collections import deque
from collections.abc import Callable, Sequence

from emulator.process.clock import Clock

POLLIN = 1
FOREVER_NS = 10**15
PR_SET_TIMERSLACK = 29
SCHED_ATTR_SIZE = 48
"linux/sched/types.h: SCHED_ATTR_SIZE_VER0."
SLICE_NS = 300_000
"The kernel's own is about 3 ms."

AWAKE_SHARE = 0.05
"At most this share of one core is spent waiting awake."
MOST_AWAKE_NS = 200_000
"Longest time awake before one deadline: a machine that wakes later than this is busy, and would be more so."
MARGIN_NS = 10_000
STOCK_NS = 2_000_000
"Time awake that can be saved up."
OVERSHOOTS = 64


class _PollFd(ctypes.Structure):
    _fields_ = [("fd", ctypes.c_int), ("events", ctypes.c_short), ("revents", ctypes.c_short)]


class _TimeSpec(ctypes.Structure):
    _fields_ = [("seconds", ctypes.c_long), ("nanoseconds", ctypes.c_long)]


_LIBC = ctypes.CDLL(None)


class Poller:
    """Descriptors that are waited for together."""

    def __init__(self, numbers: Sequence[int]) -> None:
        self.numbers = tuple(numbers)
        self._array = (_PollFd * max(1, len(self.numbers)))()
        for place, number in enumerate(self.numbers):
            self._array[place].fd, self._array[place].events = number, POLLIN
        self._count = ctypes.c_ulong(len(self.numbers))
        self._time = _TimeSpec()
        self._time_at = ctypes.byref(self._time)

    def wait(self, timeout_ns: int) -> bool:
        """Whether one is readable, or its other end gone, within that time; a signal ends the wait early."""
        self._time.seconds, self._time.nanoseconds = divmod(min(max(0, timeout_ns), FOREVER_NS), 1_000_000_000)
        return bool(_LIBC.ppoll(self._array, self._count, self._time_at, None) > 0)


def sharpen_timers() -> None:
    """Ask the kernel to wake this process within a microsecond of its deadlines instead of fifty."""
    with contextlib.suppress(OSError, AttributeError):
        _LIBC.prctl(PR_SET_TIMERSLACK, 1000, 0, 0, 0)


def shorten_slices() -> None:
    """Ask for short turns on the processor: no more of it, but sooner, and over whoever asks for longer ones.

    Linux 6.12 and later (EEVDF); before, and elsewhere, nothing happens. It needs no rights.
    """
    number = {"x86_64": 314, "aarch64": 274, "riscv64": 274}.get(platform.machine())
    if sys.platform != "linux" or number is None:
        return
    attributes = struct.pack(
        "=IIQiIQQQ", SCHED_ATTR_SIZE, os.SCHED_OTHER, 0, os.getpriority(os.PRIO_PROCESS, 0), 0, SLICE_NS, 0, 0
    )
    with contextlib.suppress(OSError, AttributeError):
        if os.sched_getscheduler(0) == os.SCHED_OTHER:
            _LIBC.syscall(number, 0, attributes, 0)


def realtime_allowed() -> str:
    """Empty when this thread may be scheduled before all others, else why not."""
    try:
        before = os.sched_getscheduler(0), os.sched_getparam(0)
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(1))
        os.sched_setscheduler(0, *before)
    except OSError as error:
        return f"{error.strerror}; want CAP_SYS_NICE, or a limit of real-time priority (ulimit -r) over 0"
    return ""


def be_realtime() -> str:
    """Schedule this thread before all others, what it starts as usual; empty, or why that is refused."""
    refused = realtime_allowed()
    if not refused:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(1))
    return refused


def be_usual() -> None:
    """The end of `be_realtime`."""
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


class Waiter:
    """Sleeps until an instant, or until a descriptor is ready.

    A sleeper is woken some ten microseconds late, by a virtual machine up to a hundred. So it sleeps a little less, as
    much as four of five of its last sleeps were too long, and waits out the rest awake: never beyond `MOST_AWAKE_NS`,
    never more than `AWAKE_SHARE` of a core, and not at all where that is used up.
    """

    def __init__(self, clock: Clock, number: int, share: float = AWAKE_SHARE) -> None:
        """`number`: the descriptor, an epoll set's for many. `share`: 0 never waits awake."""
        self._clock = clock
        self._poller = Poller([number])
        self._share = share
        self._over: deque[int] = deque(maxlen=OVERSHOOTS)
        self._rehearsals: deque[int] = deque(maxlen=OVERSHOOTS)
        self._sleeps = 0
        self.margin_ns = 0
        "How much earlier than its deadline it wakes at present."
        self.awake_ns = 0
        "Time waited awake so far."
        self._stock_ns, self._stock_at_ns = STOCK_NS, clock.now_ns()

    def until(self, deadline_ns: int | None, rehearse: Callable[[int], object] = lambda now_ns: None) -> bool:
        """Wait; whether the descriptor was ready before that instant.

        `rehearse`: called once when awake before the deadline, with the present instant: what has run just before is
        still in the processor's caches when it counts.
        """
        if deadline_ns is None:
            return self._poller.wait(FOREVER_NS)
        now_ns = self._clock.now_ns()
        margin_ns = self._allowed_ns(now_ns)
        wake_ns = deadline_ns - margin_ns
        if wake_ns > now_ns:
            if self._poller.wait(wake_ns - now_ns):
                return True
            now_ns = self._clock.now_ns()
            if now_ns >= wake_ns:  # not ended by a signal
                self._learn(now_ns - wake_ns)
        elif self._poller.wait(0):  # no descriptor is forgotten where deadlines follow each other closely
            return True
        if deadline_ns - now_ns > MOST_AWAKE_NS:
            return False
        began_ns = now_ns
        if now_ns < deadline_ns:
            rehearse(now_ns)
            self._rehearsals.append(self._clock.now_ns() - began_ns)
        while now_ns < deadline_ns:
            now_ns = self._clock.now_ns()
        self.awake_ns += now_ns - began_ns
        self._stock_ns -= now_ns - began_ns
        return False

    def doze(self, until_ns: int) -> bool:
        """Wait for an instant that nothing is due at: not awake, and nothing is learned. Whether as `until`."""
        return self._poller.wait(until_ns - self._clock.now_ns())

    def _allowed_ns(self, now_ns: int) -> int:
        gained_ns = int((now_ns - self._stock_at_ns) * self._share)
        self._stock_ns = min(STOCK_NS, self._stock_ns + gained_ns) if self._share else 0
        self._stock_at_ns = now_ns
        return self.margin_ns if self._stock_ns > self.margin_ns else 0

    def _learn(self, over_ns: int) -> None:
        self._over.append(over_ns)
        self._sleeps += 1
        if self._sleeps % 8 == 0:
            wanted_ns = _usual(self._over) + _usual(self._rehearsals) + MARGIN_NS
            self.margin_ns = min(wanted_ns, MOST_AWAKE_NS) if self._share else 0


def _usual(found: Sequence[int]) -> int:
    """What four of five do not exceed."""
    return sorted(found)[len(found) * 4 // 5] if found else 0
