"""When each byte of a payload has left a line of a given speed. Integer nanoseconds, nothing here reads a clock.

A byte takes ten bit times (start, eight data bits, stop). Payloads that follow each other without a pause form a run;
byte k of a run has left `ceil(k * 10**10 / baud)` ns after the run began, so that no rounding adds up, however long
the line stays busy. Groups: a caller that sleeps until `next_ns` wakes for the last byte of a payload exactly, and on
the way to it about every `GROUP_NS`, never for one byte at a time on a fast line.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

BYTE_NS_BAUD = 10_000_000_000
"Ten bit times in nanoseconds, times the speed in baud."

GROUP_NS = 2_000_000
"""Bytes are handed over in groups of this duration. Measured on one core, sleeping by `select`: waking every 0.5 ms
costs 7.6 % of the core, every 1 ms 5.1 %, every 2 ms 3.2 %, every 4 ms 2.3 %. Drivers bear pauses of 6 ms and more
between bytes (14 ms are the device's own limit), and a flush by the host loses at most this much."""

QUEUE_LIMIT = 262_144
"""Bytes that may wait for a line; one payload more is refused. Four minutes of 9 600 baud: a session that looks at its
line never comes near, one that does not cannot fill the memory."""


@dataclass(slots=True)
class Left:
    """Bytes of one payload that have left the line."""

    data: bytes
    speed: int | None
    "Baud of the line while they left; None: not paced."
    starts: bool
    "The payload's first byte is among them."
    ends: bool
    "Its last byte is among them."
    run_ns: int
    "When the run they belong to began (not paced: when they were due)."
    run_index: int
    "Bytes of the run before these."

    @property
    def last_ns(self) -> int:
        """When the last of them had left."""
        return leave_ns(self.run_ns, self.run_index + len(self.data), self.speed)

    def times_ns(self) -> NDArray[np.int64]:
        """When each of them had left, (len(data),). [ns]"""
        if self.speed is None:
            return np.full(len(self.data), self.run_ns, dtype=np.int64)
        count = np.arange(self.run_index + 1, self.run_index + 1 + len(self.data), dtype=np.int64)
        return np.int64(self.run_ns) - (-count * BYTE_NS_BAUD) // self.speed


def leave_ns(run_ns: int, count: int, speed: int | None) -> int:
    """When `count` bytes of a run that began at `run_ns` have left, rounded up to a nanosecond."""
    return run_ns if speed is None else run_ns - (-count * BYTE_NS_BAUD) // speed


@dataclass(slots=True)
class _Waiting:
    data: bytes
    due_ns: int
    speed_after: int | None
    sent: int = 0
    begun: bool = False
    "It is on the line: the run it belongs to is known."
    parted: bool = False
    "Some of it left at another speed."


class PacedLine:
    """A line that sends one byte after the other; payloads wait in the order in which they were put."""

    def __init__(
        self, speed: int | None = None, whole: bool = False, limit: int = QUEUE_LIMIT, group_ns: int = GROUP_NS
    ) -> None:
        """`whole`: payloads are given out only when their last byte has left (datagrams)."""
        self._check(speed)
        self._speed = speed
        self._whole = whole
        self._limit = limit
        self._group_ns = group_ns
        self._queue: deque[_Waiting] = deque()
        self._queued = 0
        self._run_ns = 0
        self._run_count = 0
        "Bytes of the present run that had left before the head of the queue."

    @staticmethod
    def _check(speed: int | None) -> None:
        if speed is not None and speed < 1:
            raise ValueError(f"line speed {speed}; want baud > 0, or None for a line that is not paced")

    @property
    def speed(self) -> int | None:
        """Baud in force after all that was taken so far; None: not paced."""
        return self._speed

    @property
    def busy_until_ns(self) -> int:
        """When the last byte taken has left."""
        return leave_ns(self._run_ns, self._run_count, self._speed)

    @property
    def queued(self) -> int:
        """Bytes that have not been taken yet."""
        return self._queued

    @property
    def waiting(self) -> bool:
        """Whether something has not been taken yet, be it only a change of speed."""
        return bool(self._queue)

    def put(self, payload: bytes, due_ns: int, speed_after: int | None = None) -> bool:
        """Queue a payload; False, and nothing queued, when too much waits already.

        Its first byte starts at the later of `due_ns` and the end of what waits before it; after its last bit the line
        has the speed `speed_after`. A payload alone in the queue is taken whatever its size, an empty one always: it
        only changes the speed.
        """
        self._check(speed_after)
        if not payload and speed_after is None:
            return True
        if self._queued and payload and self._queued + len(payload) > self._limit:
            return False
        self._queue.append(_Waiting(payload, due_ns, speed_after))
        self._queued += len(payload)
        return True

    def take(self, now_ns: int) -> list[Left]:
        """What has left by `now_ns` and was not taken before, in order."""
        taken = []
        while self._queue:
            head = self._queue[0]
            if not head.begun:
                run_ns, run_count = self._run_of(head)
                if leave_ns(run_ns, run_count, self._speed) > now_ns:
                    break
                self._run_ns, self._run_count, head.begun = run_ns, run_count, True
            end = len(head.data)
            if self._speed is not None:
                gone = (now_ns - self._run_ns) * self._speed // BYTE_NS_BAUD - self._run_count
                if gone < end:
                    end = max(head.sent, gone)
            if end < len(head.data) and self._whole:
                break
            finished = end == len(head.data)
            if end > head.sent:
                taken.append(self._left(head, end, finished))
            if not finished:
                break
            self._queue.popleft()
            self._run_count += end
            self._shorten_run()
            if head.speed_after is not None:
                self.set_speed(head.speed_after)
        return taken

    def _left(self, head: _Waiting, end: int, finished: bool) -> Left:
        data = head.data[head.sent : end]
        left = Left(
            data=data,
            speed=self._speed,
            starts=head.sent == 0 and not head.parted,
            ends=finished,
            run_ns=self._run_ns,
            run_index=self._run_count + head.sent,
        )
        head.sent = end
        self._queued -= len(data)
        return left

    def _run_of(self, head: _Waiting) -> tuple[int, int]:
        """The run that the head of the queue belongs to and the bytes before it: the present one, or a new one."""
        if head.begun:
            return self._run_ns, self._run_count
        if self._speed is None:
            return max(head.due_ns, self._run_ns), 0
        if (head.due_ns - self._run_ns) * self._speed > self._run_count * BYTE_NS_BAUD:
            return head.due_ns, 0
        return self._run_ns, self._run_count

    def _shorten_run(self) -> None:
        """Move the run's beginning forward where that is exact: its numbers stay small, its schedule stays the same."""
        if self._speed is None:
            self._run_count = 0
            return
        exact = self._speed // math.gcd(self._speed, BYTE_NS_BAUD)
        whole = self._run_count - self._run_count % exact
        self._run_ns += whole * BYTE_NS_BAUD // self._speed
        self._run_count -= whole

    def next_ns(self, now_ns: int, whole: bool = False) -> int | None:
        """When `take` should be called again: the end of the payload on the line, or of a group of its bytes.

        `whole`: nobody is waiting for a part of a payload.
        """
        if not self._queue:
            return None
        head = self._queue[0]
        run_ns, run_count = self._run_of(head)
        start_ns = leave_ns(run_ns, run_count, self._speed)
        if self._speed is None or not head.data:
            return start_ns
        count = len(head.data)
        if not (whole or self._whole):
            group_end_ns = max(now_ns, start_ns) + self._group_ns
            grouped = (group_end_ns - run_ns) * self._speed // BYTE_NS_BAUD - run_count
            count = min(max(grouped, head.sent + 1), count)
        return leave_ns(run_ns, run_count + count, self._speed)

    def set_speed(self, speed: int | None) -> None:
        """Change the speed behind the last byte taken; the rest of a payload goes on at the new one."""
        self._check(speed)
        head = self._queue[0] if self._queue else None
        sent = head.sent if head is not None and head.begun else 0
        self._run_ns = leave_ns(self._run_ns, self._run_count + sent, self._speed)
        self._run_count = 0
        self._speed = speed
        if head is not None and head.begun:
            head.parted = head.parted or head.sent > 0
            head.data, head.sent, head.begun = head.data[head.sent :], 0, False

    def cut(self, now_ns: int) -> int:
        """End what is leaving with the byte that is on its way, and forget what waits behind it.

        Returns how many payloads are gone whole. Changes of speed stay; on a line that is not paced all has left.
        """
        if self._speed is None or not self._queue:
            return 0
        gone = 0
        while len(self._queue) > 1 and self._queue[-1].speed_after is None:
            self._queued -= len(self._queue.pop().data)
            gone += 1
        head = self._queue[0]
        run_ns, run_count = self._run_of(head)
        begun = (now_ns - run_ns) * self._speed // BYTE_NS_BAUD - run_count + 1
        keep = min(len(head.data), max(begun, head.sent, 1))
        self._queued -= len(head.data) - keep
        head.data = head.data[:keep]
        return gone

    def clear(self) -> int:
        """Forget what has not been taken; how many bytes those were."""
        forgotten, self._queued = self._queued, 0
        if self._queue and self._queue[0].begun:
            self._run_count += self._queue[0].sent
        self._queue.clear()
        return forgotten
