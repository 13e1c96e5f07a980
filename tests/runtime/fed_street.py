"""A fed LMS291 on a clock of the test: one process measures its sweeps, whole or in slices of time.

The real thing are the feed, its choice of slices and the instants of asking; the process takes as long as the test
says. The sender wakes up 0.2 ms late in the mean and needs 0.3 ms for a telegram.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from emulator.instrument.slices import Slices
from emulator.live.json_lines import update_of
from emulator.measuring.conditions import NORMAL, Conditions
from emulator.runtime.feeding import Feeding
from emulator.scenario.scenario import loads
from protocols.lms2xx.variants import STANDARD, comb
from protocols.scan import ScanPlan

MS = 1_000_000
PERIOD_NS = 2e9 / 75
TELEGRAM_NS = 300_000
CASE = """
schema: 1
actors: [{id: ego}, {id: car}]
sensors: [{id: front, model: sick-lms291-s05, links: ["pty:./front"]}]
live: {feed: 'json-udp://127.0.0.1:0'}
"""


class FedStreet:
    """So many sweeps of it."""

    def __init__(self, takes_ms: float, share: float, may: bool = True, spread: float = 0.03, late_ms: float = 0.05):
        """`takes_ms`: a whole sweep; `share` of it one of two slices. `late_ms`: samples are that late in the mean."""
        self.now_ns = 0.0
        self._takes_ns = {1: takes_ms * MS, 2: share * takes_ms * MS}
        self._spread, self._late_ms = spread, late_ms
        self._rng = np.random.default_rng(1)
        scenario = loads(CASE, Path("case.yaml"))
        assert scenario.live is not None
        front = SimpleNamespace(sensor="front", poked=False, ledger=SimpleNamespace(now_ns=0))
        self.feeding = Feeding(scenario, scenario.live, [front], lambda: round(self.now_ns))  # type: ignore[list-item]
        self.may: Callable[[], bool] = lambda: may
        self.feeding.has_slices = lambda sensor, plan: self.may()
        self.ages: list[np.ndarray] = []
        self.feeding.book.ages.note = lambda age_s, beyond: self.ages.append(age_s)  # type: ignore[method-assign]
        self.slices = Slices("front", self)
        self.late = 0
        self.slices_of: list[int] = []
        "Of each sweep."
        self.begun_ns: list[list[float]] = []
        "Of each sweep, before its end."
        self._owed: deque[tuple[ScanPlan, bool, int]] = deque()
        self._done_ns: float | None = None
        self._sample, self._sample_ns = 0, 0.0
        self._number = 0

    def request_slice(self, sensor: str, plan: ScanPlan, conditions: Conditions, number: int, of: int) -> None:
        """As `Workers`."""
        if number == 0:
            self.slices_of.append(of)
            self.begun_ns.append([])
        self.begun_ns[-1].append(plan.start_ns + PERIOD_NS - self.now_ns)
        self._owed.append((plan, number == of - 1, of))
        self._work()

    def _work(self) -> None:
        if self._owed and self._done_ns is None:
            took = self._takes_ns[self._owed[0][2]] * np.exp(self._spread * self._rng.standard_normal())
            self._done_ns = self.now_ns + took

    def _plan(self) -> ScanPlan:
        beams = comb(STANDARD, None)
        start_ns = 1000 * MS + round(self._number * PERIOD_NS)
        angles = beams.azimuth_rad, beams.elevation_rad, beams.fire_offset_s
        return ScanPlan(0, self._number, start_ns, *angles, PERIOD_NS * 1e-9)

    def run(self, sweeps: int) -> None:
        """Go on until so many have come."""
        until, asked = self._number + sweeps, False
        while self._number < until:
            plan = self._plan()
            if asked:
                ask_ns = self.slices.begin_due(round(self.now_ns))
            else:
                ask_ns = self.feeding.ask_ns("front", plan, plan.start_ns - 250 * MS)
                if ask_ns <= self.now_ns:
                    asked = True
                    if not self.slices.open(plan, NORMAL, self.feeding, round(self.now_ns)):
                        self.feeding.world("front", plan, round(self.now_ns))
                        self.request_slice("front", plan, NORMAL, 0, 1)
                    continue
            wake_ns = np.inf if ask_ns is None else max(ask_ns, self.now_ns) + self._rng.exponential(0.2 * MS)
            done_ns = np.inf if self._done_ns is None else self._done_ns
            if self._sample_ns <= min(wake_ns, done_ns):
                self._tell()
            elif wake_ns <= done_ns:
                self.now_ns = wake_ns
            else:
                self.now_ns = max(self.now_ns, done_ns)
                self._done_ns = None
                of, is_last, _ = self._owed.popleft()
                self._work()
                if is_last:
                    self.late += self.now_ns + TELEGRAM_NS > of.start_ns + PERIOD_NS
                    self.feeding.came("front", of, round(self.now_ns))
                    self.slices.came(of)
                    self._number, asked = self._number + 1, False

    def _tell(self) -> None:
        self.now_ns = max(self.now_ns, self._sample_ns)
        row = {"id": "car", "at_m": [0.1 * self._sample, 0, 0]}
        update = update_of({"t_ns": 10 * MS * self._sample, "actors": [row]})
        self.feeding.take(update, round(self.now_ns))
        self._sample += 1
        self._sample_ns = 10 * MS * self._sample + (0.1 + self._rng.exponential(self._late_ms)) * MS

    def median_ms(self, after: int = 0) -> float:
        """Age of poses at the beams; without so many notes of the beginning."""
        return 1e3 * float(np.median(np.concatenate(self.ages[after:])))
