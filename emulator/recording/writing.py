"""When pieces of a recording reach the disk: at once, or from a thread of its own.

Belongs here: the order of pieces, what waits, and the one trouble that ends it all. Not: what is written (chunks,
pcapng, can_logs), nor into what (folder).

A sender that writes itself stands still while the disk does. So in a run that hosts wait for, it puts pieces into a
queue, and a thread packs, sums up and writes them; those computations leave Python to the sender.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from dataclasses import dataclass

from emulator.process.clock import SystemClock

MOST_WAITING = 64 << 20
"Bytes for a disk that takes less than the run gives."
TIME_LIMIT_S = 30.0
"For a disk that takes nothing at all."
STUCK = f"the disk has taken nothing for {TIME_LIMIT_S:g} s"


@dataclass(frozen=True)
class Manner:
    """How a recording is written."""

    flush_s: float | None
    "Real seconds after which everything is handed to the system, and files are looked after; None: no thread."
    waits: bool = False
    "The run waits for a disk that is too slow; else the recording ends."
    sync: bool = False
    "The end waits until the disk has everything."
    late: bool = False
    "Payloads leave later than they are due: both instants are recorded."


IN_STEP = Manner(None)
"Written by who records: the same run makes the same bytes. For runs in virtual time without hosts outside."
LIVE = Manner(0.5, sync=True, late=True)
VIRTUAL = Manner(0.5, waits=True)

Job = Callable[[], None]


class Writing:
    """Carries out jobs in their order, in this thread or in its own, until one of them fails."""

    def __init__(self, manner: Manner, tick: Job, trouble: Callable[[Exception], None]) -> None:
        """`tick` is called every `flush_s` in the thread; `trouble` once, with what a job or `tick` raised."""
        self._manner = manner
        self._tick = tick
        self.in_step = manner.flush_s is None
        "No thread: whoever puts something does it."
        self._trouble = trouble
        self._failed = False
        self._jobs: queue.SimpleQueue[tuple[Job, int] | None] = queue.SimpleQueue()
        self._put = 0
        self._done = 0
        self._room = threading.Condition()
        self._thread: threading.Thread | None = None
        if manner.flush_s is not None:
            self._thread = threading.Thread(target=self._serve, name="lidaremu-recorder", daemon=True)
            self._thread.start()

    def put(self, job: Job, size: int) -> None:
        """Have a piece of so many bytes written; callers see to it that only one of them is here at a time."""
        if self._thread is None:
            self.do(job)
        elif not self._failed:
            self._put += size
            self._jobs.put((job, size))

    def make_room(self) -> None:
        """Wait for a disk that is too slow, or give up; not while holding what `tick` wants."""
        if self._put - self._done <= MOST_WAITING or self._failed:
            return
        if not self._manner.waits:
            self.fail(OSError(0, f"the disk is too slow: {MOST_WAITING >> 20} MB are queued"))
            return
        with self._room:
            before = -1
            while before != self._done and not self._failed:
                before = self._done
                if self._room.wait_for(
                    lambda: self._failed or self._put - self._done <= MOST_WAITING // 2, TIME_LIMIT_S
                ):
                    return
        self.fail(OSError(0, STUCK))

    def do(self, job: Job) -> None:
        """One job, here and now; its trouble is reported and ends the writing."""
        if self._failed:
            return
        try:
            job()
        except Exception as error:  # whatever it is, it ends the recording with a reason and not the run
            self.fail(error)

    def fail(self, error: Exception) -> None:
        """End the writing because of that; reported the first time."""
        with self._room:
            first, self._failed = not self._failed, True
            self._room.notify_all()
        if first:
            self._trouble(error)

    def _serve(self) -> None:
        assert self._manner.flush_s is not None
        clock = SystemClock()
        span_ns = round(self._manner.flush_s * 1e9)
        next_ns = span_ns
        while True:
            if clock.now_ns() >= next_ns:
                self.do(self._tick)
                next_ns = clock.now_ns() + span_ns
            try:
                item = self._jobs.get(timeout=max(0.0, (next_ns - clock.now_ns()) * 1e-9))
            except queue.Empty:
                continue
            if item is None:
                return
            self.do(item[0])
            with self._room:
                self._done += item[1]
                self._room.notify_all()

    def close(self) -> bool:
        """Everything that was put is done, or has failed. False: the disk stands still, and the thread with it."""
        if self._thread is None:
            return True
        self._jobs.put(None)
        before = -1
        while self._thread.is_alive() and before != self._done:
            before = self._done
            self._thread.join(TIME_LIMIT_S)
        if self._thread.is_alive():
            self.fail(OSError(0, STUCK))
            return False
        self._thread = None
        return True
