"""One scenario in virtual time without hardware: links in memory, built-in hosts, expectations judged.

For `lidaremu test`. Every sensor gets a loop in place of its links; sensors on CAN keep their bus, without a way out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from emulator.errors import ScenarioError
from emulator.hosts.families import BUILT_IN, found_at, is_on_can
from emulator.hosts.scripted import HasScript
from emulator.injection.run import FaultRun
from emulator.instrument.instrument import Instrument, Measuring
from emulator.instrument.ledger import check_accounts
from emulator.instrument.observer import Observer
from emulator.instrument.series import SeriesWatcher
from emulator.instrument.summary import summary
from emulator.judging.expectations import Judgement, Judgements, Run, understand, verdicts
from emulator.measuring.conditions import NORMAL, Conditions
from emulator.measuring.measuring import InPlace, Measure
from emulator.measuring.supervision import Workers
from emulator.process.incidents import Incidents
from emulator.recording.reader import WirePayload
from emulator.recording.transcript import Transcript
from emulator.recording.writer import Recorder
from emulator.runtime import assembly
from emulator.runtime.liveness import Liveness
from emulator.runtime.virtual import VirtualHost, VirtualRun, nothing_owed
from emulator.scenario.scenario import Scenario
from emulator.scenario.vehicle_options import NAME as VEHICLE_BUS
from emulator.sensors.spec import load_spec
from emulator.transports.can_link import BITRATE, CanPorts, LoopOutlet
from emulator.transports.can_wire import CanWire, Carried
from emulator.transports.link import Link
from emulator.transports.loopback import LoopHost, LoopLink, Loops
from emulator.transports.schemes import open_link
from protocols.scan import Scan, ScanPlan
from protocols.session import Family

DEFAULT_S = 5.0
"Length of a trial whose scenario has no duration."
PARTS = 50
"Of a trial's time, between reports of its progress; the bytes are the same."


@dataclass(frozen=True)
class Verdict:
    """What a trial has shown."""

    scenario: str
    judgements: tuple[Judgement, ...]
    sha256: str
    duration_s: float
    sensors: tuple[dict[str, Any], ...]
    warnings: tuple[str, ...] = ()
    "What was computed outside the range where it is known to hold, and sensors that are silent at the end."
    incidents: tuple[dict[str, object], ...] = ()
    "Incidents of the run's processes, files and links."
    exit_code: int = 0
    "Of those incidents."
    recording: dict[str, Any] | None = None
    "How it stands with the recording, as `Recorder.state` reports it; None when there is none."

    @property
    def held(self) -> bool:
        """Whether every expectation held."""
        return all(item.held for item in self.judgements)


class SilentBus(LoopOutlet):
    """A bus of sensors alone, heard by one silent node."""

    def __init__(self, url: str = "loop:can") -> None:
        super().__init__()
        self._url = url

    @property
    def url(self) -> str:
        return self._url

    def poll(self, now_ns: int) -> None:
        pass

    def deliver(self, carried: Sequence[Carried], now_ns: int) -> bool:
        return True


class Trial:
    """A scenario set up in memory."""

    def __init__(
        self,
        scenario: Scenario,
        workers: int = 0,
        watchers: Sequence[Observer] = (),
        record: Path | None = None,
        measuring: Measuring | None = None,
        heard: Mapping[str, Sequence[WirePayload]] | None = None,
        measures: Callable[[Scenario], Mapping[str, Measure]] | None = None,
    ) -> None:
        """`workers`: measuring processes; 0 measures in place. The result is the same. `record`: a folder for it.

        `measuring`: something else that makes scans of plans. `heard`: what a sensor heard of its hosts, in place of a
        built-in one. `measures`: as `build_measures`.
        """
        self._heard = heard or {}
        self.outcome: Run | None = None
        "What the run has left, once it is finished."
        self.scenario = scenario
        self.expected = understand(scenario)
        self.incidents = Incidents()
        sessions = assembly.new_sessions(scenario)
        names = [sensor.id for sensor in scenario.sensors]
        build = partial(measures or assembly.build_measures, scenario)
        shared = assembly.shared_sensors(scenario)
        own_processes = workers and measuring is None
        self._workers = Workers(build, names, workers, shared=shared) if own_processes else None
        own = self._workers if self._workers is not None else InPlace(build()) if measuring is None else None
        self._warnings = () if own is None else own.warnings
        measuring = measuring if own is None else own
        assert measuring is not None
        self.transcript = Transcript(names if scenario.vehicle_bus is None else [*names, VEHICLE_BUS])
        self.series = SeriesWatcher(names)
        loops, buses = Loops(), CanPorts()
        self.instruments: list[Instrument] = []
        hosts: list[VirtualHost] = []
        for index, (sensor, session) in enumerate(zip(scenario.sensors, sessions, strict=True)):
            family = assembly.family_of(scenario, index)
            links = [_link_of(scenario, index, family.tcp_is_line, loops, buses)]
            instrument = Instrument(sensor.id, session, links, measuring)
            instrument.family = family
            for watcher in (self.transcript, self.series, *watchers):
                instrument.watch(watcher)
            self.instruments.append(instrument)
            host = self._host_of(index, family, loops)
            hosts += [] if host is None else [host]
        for vehicle in assembly.open_vehicle(scenario, measuring, partial(_bus_of, buses)):
            for watcher in (self.transcript, *watchers):
                vehicle.watch(watcher)
            self.instruments.append(vehicle)
        self.faults = FaultRun(scenario, self.instruments)
        self.feeding = assembly.feeding_of(scenario, self.instruments, None)
        assembly.tell_vehicle(self.instruments, self.incidents)
        "Who moves the world from outside: a file, here; of others nothing comes."
        self.run = VirtualRun(self.instruments, hosts, nothing_owed if self._workers is None else self._settle)
        self.recorder = None if record is None else self._record(record)
        if self.feeding is not None and self.recorder is not None:
            self.feeding.on_update = self.recorder.feed
        self.liveness = Liveness(self.instruments, self.incidents)
        self.run.on_look = lambda now_ns: self.liveness.look(now_ns, now_ns)
        self.run.power_on()

    def _settle(self) -> set[str]:
        assert self._workers is not None
        fresh = self._workers.settle()
        for kind, worker, text in self._workers.incidents:
            self.incidents.note(kind, self.run.clock.now_ns(), worker, text)
        self._workers.incidents.clear()
        return fresh

    def _record(self, folder: Path) -> Recorder:
        now_ns = self.run.clock.now_ns
        return Recorder(folder, self.scenario, self.instruments, incidents=self.incidents, now_ns=now_ns)

    def _host_of(self, index: int, family: Family, loops: Loops) -> VirtualHost | None:
        sensor = self.scenario.sensors[index]
        if sensor.id in self._heard and family.name != "can_objects":
            return _AsRecorded(loops[sensor.id], self._heard[sensor.id])
        on_scan = partial(self.series.host_read, sensor.id)
        if family.name in BUILT_IN:
            place = BUILT_IN[family.name].script
            if place is None:
                return None
            made: VirtualHost = found_at(place)(loops[sensor.id].connect(), on_scan, sensor.device)
            # a fault may end a line in the middle of a telegram: its parts are heard as they come
            loops[sensor.id].wakes_whole = getattr(made, "takes_whole", False) and not self.scenario.faults
            return made
        if isinstance(family, HasScript):
            return family.script(loops[sensor.id].connect(), on_scan)
        return None

    def finish(self, progress: Callable[[float], None] | None = None) -> Verdict:
        """Run to the end, finish the recording, and judge. `progress` gets the share of the time that has
        passed."""
        duration_s = self.scenario.duration_s or DEFAULT_S
        end_ns = round(duration_s * 1e9)
        if progress is not None:
            for part in range(1, PARTS):
                self.run.advance(end_ns * part // PARTS)
                progress(part / PARTS)
        self.run.advance(end_ns)
        by_name = {item.sensor: item for item in self.instruments}
        for instrument in self.instruments:
            for link in instrument.links:
                instrument.stats.lateness.extend(link.stats.lateness_ns)
        self.outcome = Run(self.scenario, self.series, by_name, end_ns)
        judged = verdicts(self.expected, self.outcome)
        failures = [] if self._workers is None else self._workers.failures
        check_accounts(self.instruments, self.incidents, end_ns)
        lost = [row for row in self.incidents.rows() if row["kind"] == "scans unaccounted"]
        judged += [Judgement(f"scans of {row['on']} unaccounted", False, str(row["text"]), "0") for row in lost]
        judged += [Judgement("every sweep can be measured", False, text, "no failure") for text in failures]
        sensors = tuple(summary(item) for item in self.instruments)
        name, digest = str(self.scenario.source), self.transcript.sha256()
        if self.recorder is not None:
            note_verdict(self.recorder, judged, end_ns)
            self.recorder.close()  # what it meets at its end belongs to the verdict
        return Verdict(
            name,
            tuple(judged),
            digest,
            duration_s,
            sensors,
            (*self._warnings, *judged.warnings),
            tuple(self.incidents.rows()),
            self.incidents.exit_code,
            None if self.recorder is None else self.recorder.state(),
        )

    def close(self) -> None:
        """Release everything, finish the recording."""
        if self.recorder is not None:
            self.recorder.close()
        for instrument in self.instruments:
            instrument.close()
        if self._workers is not None:
            self._workers.close()


class _AsRecorded:
    """Hosts that say again what they said, at the same instants, whatever they hear."""

    def __init__(self, link: LoopLink, payloads: Sequence[WirePayload]) -> None:
        self._hosts: dict[int, LoopHost] = {}
        for one in payloads:
            if one.peer not in self._hosts:
                self._hosts[one.peer] = link.connect(one.start_ns)
            self._hosts[one.peer].write(one.data, one.start_ns)

    def step(self, now_ns: int) -> int | None:
        """Read; nothing is wanted."""
        for host in self._hosts.values():
            host.read()
        return None


class _Nothing:
    """Measures nothing."""

    def request(self, sensor: str, plan: ScanPlan, conditions: Conditions = NORMAL) -> None:
        """Forget it."""

    def collect(self, sensor: str) -> list[Scan]:
        """None."""
        return []


def rehearse(scenario: Scenario) -> None:
    """Set a scenario up without measuring: `ScenarioError` has all that a trial or a run would refuse."""
    reported: list[str] = []
    without = scenario.model_copy(update={"expect": ()})
    for refused in (partial(understand, scenario), lambda: Trial(without, measuring=_Nothing()).close()):
        try:
            refused()
        except ScenarioError as error:
            reported += [line for line in error.lines if line not in reported]
    if reported:
        raise ScenarioError.of(reported)


def note_verdict(recorder: Recorder, judged: Judgements, end_ns: int) -> None:
    """Write into a recording what was expected and found; the last verdict of a run counts."""
    if not len(judged) and not judged.warnings:
        return
    rows = [item.as_json() for item in judged]
    recorder.note(end_ns, {"event": "Verdict", "expect": rows, "warnings": list(judged.warnings)})


def _link_of(scenario: Scenario, index: int, tcp_is_line: bool, loops: Loops, buses: CanPorts) -> Link:
    sensor = scenario.sensors[index]
    if not is_on_can(assembly.family_of(scenario, index).name):
        return open_link(f"loop:{sensor.id}", tcp_is_line, loops=loops)
    bus = next((url for url in sensor.links), f"loop:{sensor.id}").partition("?")[0]
    bitrate = load_spec(sensor.model).device.get("bitrate", BITRATE)
    return buses.link(bus, lambda: (CanWire(int(sensor.device.get("bitrate", bitrate))), SilentBus(bus)))


def _bus_of(buses: CanPorts, url: str) -> Link:
    """The vehicle's link: on the bus of sensors that name the same one, else on one of its own."""
    bus = url.partition("?")[0]
    return buses.link(bus, lambda: (CanWire(BITRATE), SilentBus(bus)))


def run_trial(
    scenario: Scenario,
    workers: int = 0,
    name: str | None = None,
    record: Path | None = None,
    progress: Callable[[float], None] | None = None,
    heard: Mapping[str, Sequence[WirePayload]] | None = None,
) -> Verdict:
    """Run one scenario and judge its expectations; raises `EmulatorError` when it cannot run."""
    trial = Trial(scenario, workers, record=record, heard=heard)
    try:
        verdict = trial.finish(progress)
    finally:
        trial.close()
    return verdict if name is None else replace(verdict, scenario=name)
