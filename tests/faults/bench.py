"""A sensor on a link in memory with faults: no scene, every beam sees 5 m; what left, and what the host heard."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from emulator.faults.events import FaultEvent
from emulator.hosts.cola import ColaScript
from emulator.hosts.scans import HostScan
from emulator.hosts.scripted import LdScript, Lms2xxScript
from emulator.injection.run import FaultRun
from emulator.instrument.instrument import Instrument
from emulator.instrument.observer import Observer, Payload
from emulator.judging.trial import SilentBus
from emulator.measuring.conditions import NORMAL, Conditions
from emulator.runtime import assembly
from emulator.runtime.virtual import VirtualHost, VirtualRun
from emulator.scenario import scenario
from emulator.transports.can_link import CanPorts
from emulator.transports.can_wire import CanWire
from emulator.transports.link import Link
from emulator.transports.loopback import Loops
from emulator.transports.schemes import open_link
from protocols.scan import DetectedObject, Scan, ScanPlan
from protocols.session import Event

RANGE_M = 5.0
MODELS = {"line": "sick-lms291-s05", "tcp": "sick-ld-lrs1000", "can": "can-ars408", "cola": "sick-lms111"}
E2E = {"profile": "p05", "messages": {"ObjListHeader": {"data_id": 0x1234, "offset_bytes": 4}}}
DEVICES: dict[str, dict[str, Any]] = {
    "line": {"real_time_indices": True},
    "tcp": {"step_deg": 1.0},
    "cola": {"ready_s": 1},
    "can": {"e2e": E2E, "counter_step": 1},
}
OBJECTS = tuple(
    DetectedObject(number, (10.0 + number, 1.0, 0.0), (1.0, 0.0, 0.0), (4.0, 1.8, 1.5), 0.0, "car")
    for number in range(3)
)


class FlatMeasuring:
    """Whatever is asked for, 5 m away."""

    def __init__(self) -> None:
        self.done: dict[str, list[Scan]] = {}
        self.asked: list[tuple[ScanPlan, Conditions]] = []

    def request(self, sensor: str, plan: ScanPlan, conditions: Conditions = NORMAL) -> None:
        self.asked.append((plan, conditions))
        shape = (len(plan), 1)
        scan = Scan(
            plan,
            np.full(shape, RANGE_M),
            np.full(shape, 20.0),
            np.zeros(len(plan), np.uint8),
            np.zeros(shape, np.int32),
            OBJECTS if plan.wants_objects else (),
        )
        self.done.setdefault(sensor, []).append(scan)

    def collect(self, sensor: str) -> list[Scan]:
        return self.done.pop(sensor, [])


@dataclass
class Heard(Observer):
    """Everything that an instrument tells."""

    sent: list[Payload] = field(default_factory=list)
    got: list[Payload] = field(default_factory=list)
    events: list[Event | FaultEvent] = field(default_factory=list)

    def payload(self, payload: Payload) -> None:
        (self.sent if payload.sent else self.got).append(payload)

    def event(self, sensor: str, event: Event | FaultEvent) -> None:
        self.events.append(event)


class Bench:
    """One sensor of a kind: `line` (LMS291), `tcp` (LD), `cola` (LMS111) or `can` (object lists), a host of ours."""

    def __init__(
        self,
        kind: str,
        *faults: dict[str, Any],
        seed: int = 1,
        device: dict[str, Any] | None = None,
        hosts: bool = True,
        links: int = 1,
    ) -> None:
        self.kind = kind
        entries = [{"on": "front", **fault} for fault in faults]
        self.scenario = load(kind, entries, seed, {**DEVICES[kind], **(device or {})})
        session = assembly.new_session(self.scenario, 0)
        self.loops = Loops()
        self.links: list[Link] = [self._link(kind, number) for number in range(links)]
        self.measuring = FlatMeasuring()
        self.instrument = Instrument("front", session, self.links, self.measuring)
        self.instrument.family = assembly.family_of(self.scenario, 0)
        self.heard = Heard()
        self.instrument.watch(self.heard)
        self.scans: list[tuple[int, HostScan]] = []
        self.host_bytes: list[tuple[int, bytes]] = []
        self.faults = FaultRun(self.scenario, [self.instrument])
        self.run = VirtualRun([self.instrument], self._hosts(kind) if hosts else ())
        self.run.power_on()

    def _link(self, kind: str, number: int) -> Link:
        if kind == "can":
            return CanPorts().link("can:x", lambda: (CanWire(500_000), SilentBus()))
        return open_link(f"loop:front{number}", kind == "line", loops=self.loops)

    def _hosts(self, kind: str) -> list[VirtualHost]:
        if kind == "can":
            return []
        self.end = end = self.loops["front0"].connect()
        read = end.read

        def log() -> bytes:
            data = read()
            if data:
                self.host_bytes.append((self.run.clock.now_ns(), data))
            return data

        end.read = log  # type: ignore[method-assign]
        script = {"line": Lms2xxScript, "tcp": LdScript, "cola": ColaScript}[kind]
        return [script(end, self._scan)]

    def _scan(self, now_ns: int, scan: HostScan) -> None:
        self.scans.append((now_ns, scan))

    def until(self, second: float) -> Bench:
        """Let time pass."""
        self.run.advance(round(second * 1e9))
        return self

    def sent(self, from_s: float = 0.0, to_s: float = 1e6, label: str | None = None) -> list[Payload]:
        """What left within a time."""
        return [
            one
            for one in self.heard.sent
            if from_s * 1e9 <= one.start_ns < to_s * 1e9 and (label is None or one.label == label)
        ]

    def heard_between(self, from_s: float, to_s: float) -> bytes:
        """What the host has read within a time."""
        return b"".join(data for at_ns, data in self.host_bytes if from_s * 1e9 <= at_ns < to_s * 1e9)

    def decoded(self, from_s: float, to_s: float) -> int:
        """Scans that the host decoded, all of them right."""
        found = [scan for at_ns, scan in self.scans if from_s * 1e9 <= at_ns < to_s * 1e9]
        for scan in found:
            assert np.nanmax(np.abs(scan.range_m - RANGE_M)) < 0.02
        return len(found)

    def reported(self, what: str) -> list[FaultEvent]:
        """Events of faults."""
        return [event for event in self.heard.events if isinstance(event, FaultEvent) and event.what == what]

    def row(self, number: int = 1) -> dict[str, Any]:
        """What a fault says of itself."""
        return dict(self.faults.rows()[number - 1])


@cache
def faultless(kind: str, until_s: float) -> Bench:
    """One without faults, up to an instant: made once, to be looked at."""
    return Bench(kind).until(until_s)


def load(kind: str, faults: list[dict[str, Any]], seed: int, device: dict[str, Any]) -> scenario.Scenario:
    """A scenario with one sensor of that kind."""
    import json

    front: dict[str, Any] = {"id": "front", "model": MODELS[kind], "device": device}
    sensors = [front]
    if kind == "can":
        front["from"] = ["eye"]
        sensors.append({"id": "eye", "model": MODELS["line"]})
    data = {"schema": 1, "seed": seed, "sensors": sensors, "faults": faults}
    return scenario.loads(json.dumps(data), Path("bench.yaml"))
