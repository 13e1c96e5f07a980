"""The only reader of a clock. Everything else takes `now_ns` as an argument."""

from __future__ import annotations

import time
from typing import Protocol


class Clock(Protocol):
    """Nanoseconds since the run began."""

    def now_ns(self) -> int: ...


class SystemClock:
    """Monotonic time since this object was made, or since `restart`."""

    def __init__(self) -> None:
        self._start_ns = time.monotonic_ns()

    def restart(self) -> None:
        """Begin again at zero; before the run begins, never during it."""
        self._start_ns = time.monotonic_ns()

    def now_ns(self) -> int:
        return time.monotonic_ns() - self._start_ns


def wall_ns(clock: Clock, at_ns: int) -> int:
    """An instant of a run in real time, `at_ns` since it began, as nanoseconds since 1970 (UTC)."""
    return time.time_ns() - clock.now_ns() + at_ns


def utc_ns() -> int:
    """Now, as nanoseconds since 1970: what the kernel stamps with. It may be set, and go back."""
    return time.time_ns()


class ManualClock:
    """Time that moves when it is set."""

    def __init__(self, now_ns: int = 0) -> None:
        self._now_ns = now_ns

    def now_ns(self) -> int:
        return self._now_ns

    def set(self, now_ns: int) -> None:
        """Move to `now_ns`; time never runs backwards."""
        if now_ns < self._now_ns:
            raise ValueError(f"clock at {self._now_ns} ns cannot go back to {now_ns} ns")
        self._now_ns = now_ns


class CpuClock:
    """Time that this process has computed for since the object was made; what others do meanwhile does not count."""

    def __init__(self) -> None:
        self._start_ns = time.process_time_ns()

    def now_ns(self) -> int:
        return time.process_time_ns() - self._start_ns


class ThreadClock:
    """Time that the calling thread has computed for; only differences mean something, and only within one thread."""

    def now_ns(self) -> int:
        return time.thread_time_ns()
