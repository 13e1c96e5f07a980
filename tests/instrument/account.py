"""Sensors whose scans are measured late, in virtual time, for tests of the account of every scan."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np

from emulator.injection.run import FaultRun
from emulator.instrument.instrument import Instrument
from emulator.judging.trial import SilentBus
from emulator.measuring.conditions import NORMAL, Conditions
from emulator.runtime import assembly
from emulator.runtime.virtual import VirtualRun
from emulator.transports.can_link import CanPorts
from emulator.transports.can_wire import CanWire
from emulator.transports.link import Link
from emulator.transports.loopback import LoopHost, Loops
from emulator.transports.schemes import open_link
from protocols.scan import Scan, ScanPlan
from protocols.session import Session
from tests.faults.bench import DEVICES, OBJECTS, load

SECOND = 1_000_000_000
TAKES_NS = 1_000_000
"Measuring one sweep, when nothing holds it up."


class SlowMeasuring:
    """One worker that takes sweeps in turn and may stand still; a host of the run, so that time moves on with it."""

    def __init__(self) -> None:
        self.run: VirtualRun | None = None
        self.plans: list[ScanPlan] = []
        self._owed: deque[tuple[int, str, ScanPlan]] = deque()
        self._free_ns = 0

    @property
    def now_ns(self) -> int:
        return 0 if self.run is None else self.run.clock.now_ns()

    def stand_still(self, span_ns: int) -> None:
        """Nothing comes back for so long, from now on."""
        until_ns = self.now_ns + span_ns
        self._owed = deque((max(ready_ns, until_ns), sensor, plan) for ready_ns, sensor, plan in self._owed)
        self._free_ns = max(self._free_ns, until_ns)

    def request(self, sensor: str, plan: ScanPlan, conditions: Conditions = NORMAL) -> None:
        self.plans.append(plan)
        self._free_ns = max(self._free_ns, self.now_ns) + TAKES_NS
        self._owed.append((self._free_ns, sensor, plan))

    def collect(self, sensor: str) -> list[Scan]:
        found = []
        while self._owed and self._owed[0][0] <= self.now_ns:
            found.append(measured(self._owed.popleft()[2]))
        return found

    def settle(self) -> set[str]:
        return {sensor for ready_ns, sensor, _ in self._owed if ready_ns <= self.now_ns}

    def step(self, now_ns: int) -> int | None:
        return max(now_ns, self._owed[0][0]) if self._owed else None


def measured(plan: ScanPlan) -> Scan:
    """Everything 5 m away."""
    shape = (len(plan), 1)
    flags, actor = np.zeros(len(plan), np.uint8), np.zeros(shape, np.int32)
    objects = OBJECTS if plan.wants_objects else ()
    return Scan(plan, np.full(shape, 5.0), np.full(shape, 20.0), flags, actor, objects)


class Yard:
    """One sensor, `line`, `tcp` or `can` as in the benches of faults, or a session of one's own; no host of ours."""

    def __init__(self, kind: str, device: dict[str, Any] | None = None, session: Session | None = None) -> None:
        self.scenario = load(kind, [], 1, {**DEVICES[kind], **(device or {})})
        self.loops = Loops()
        self.link: Link
        if kind == "can":
            self.wire = CanWire(500_000)
            self.link = CanPorts().link("can:x", lambda: (self.wire, SilentBus()))
        else:
            self.link = open_link("loop:front", kind == "line", loops=self.loops)
        self.measuring = SlowMeasuring()
        self.session = session or assembly.new_session(self.scenario, 0)
        self.instrument = Instrument("front", self.session, [self.link], self.measuring)
        if session is None:
            self.instrument.family = assembly.family_of(self.scenario, 0)
        self.faults = FaultRun(self.scenario, [self.instrument])
        self.run = VirtualRun([self.instrument], [self.measuring], self.measuring.settle)
        self.measuring.run = self.run
        self.run.power_on()

    @property
    def now_ns(self) -> int:
        return self.run.clock.now_ns()

    def connect(self) -> LoopHost:
        """One more host."""
        return self.loops["front"].connect(self.now_ns)

    def wait(self, seconds: float) -> Yard:
        """Let time pass."""
        self.run.advance(self.now_ns + round(seconds * SECOND))
        return self

    @property
    def account(self) -> dict[str, Any]:
        """Of the sensor, by now."""
        self.instrument.ledger.now_ns = self.now_ns
        return self.instrument.ledger.account()
