"""Kills and stops the measuring processes of a soak test, by the table of process faults and a seeded script.

Belongs here: when and whom. Not: what must be seen then (process_faults), hosts of the links (real_guests).
"""

from __future__ import annotations

import contextlib
import os
import signal
from collections import Counter

import numpy as np

from emulator.endurance.process_faults import drawn
from emulator.process.driver import family_of

SECOND_NS = 1_000_000_000
LONGEST_PAUSE_S = 60.0


class Saboteur:
    """Comes every now and then, takes a row of the table, and does it to one of the daemon's workers."""

    def __init__(self, pid: int, rng: np.random.Generator, visits: Counter[str], seconds: float) -> None:
        """`pid`: the daemon's; `seconds`: how long the soak is. `visits` counts what was done."""
        self._pid = pid
        self._rng = rng
        self._visits = visits
        self._pause_s = min(seconds, LONGEST_PAUSE_S)
        self._rows = drawn()
        self._stopped: dict[int, int] = {}
        "Processes that go on at an instant."
        self.ended = 0
        "Processes that another one must have replaced."
        self._next_ns = self._drawn_ns(0)

    def _drawn_ns(self, now_ns: int) -> int:
        return now_ns + round(self._rng.uniform(0.2, 0.4) * self._pause_s * SECOND_NS)

    def step(self, now_ns: int) -> None:
        """Do what is due."""
        for pid, until_ns in list(self._stopped.items()):
            if now_ns >= until_ns:
                self._send(pid, signal.SIGCONT)
                del self._stopped[pid]
        if now_ns < self._next_ns:
            return
        self._next_ns = self._drawn_ns(now_ns)
        workers = [one.number for one in family_of(self._pid) if one.number != self._pid]
        if not workers:
            return
        row = self._rows[int(self._rng.integers(len(self._rows)))]
        pid = workers[int(self._rng.integers(len(workers)))]
        assert row.drawn is not None
        if not self._send(pid, row.drawn.number):
            return
        self._visits[f"{row.on}: {row.do}, {row.when}"] += 1
        if row.drawn.for_s:
            self._stopped[pid] = now_ns + round(row.drawn.for_s * SECOND_NS)
        elif row.drawn.number == signal.SIGKILL:
            self.ended += 1

    @staticmethod
    def _send(pid: int, number: signal.Signals) -> bool:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, number)
            return True
        return False

    def reported(self, incidents: dict[str, int]) -> list[str]:
        """What the daemon should have reported and has not, in words."""
        found = []
        if incidents.get("worker replaced", 0) < self.ended:
            found.append(f"processes: {self.ended} killed, {incidents.get('worker replaced', 0)} reported as replaced")
        if "worker lost" in incidents:
            found.append("processes: a worker was lost, though it could be started")
        return found
