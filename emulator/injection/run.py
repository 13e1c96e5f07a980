"""The faults of a run, sensor by sensor, and the hooks by which an instrument asks.

Belongs here: who is asked in which order, what goes to those who measure. Not: single faults (running,
the layers). A run without faults has none of this: `Instrument.faults` is None.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from emulator.config.expressions import evaluate, names, truth
from emulator.faults.events import FaultEvent
from emulator.faults.kinds import VEHICLE, Target
from emulator.faults.reading import FaultError, read, target_of
from emulator.injection.late import LateTelegrams
from emulator.injection.running import Running
from emulator.injection.scene_events import LastScans
from emulator.instrument.fault_hooks import Made, Passed
from emulator.instrument.instrument import SWITCHED_OFF, Instrument
from emulator.measuring.conditions import ActiveFault
from emulator.scenario.quantities import check_expression
from emulator.scenario.vehicle_options import vehicle_target
from emulator.transports.link import Received
from protocols.scan import ScanPlan
from protocols.session import CommandHandled, Emission, Event

if TYPE_CHECKING:
    from emulator.scenario.scenario import Scenario

MOST_FAULTS = 1000
"That a run remembers: of more, those that are over are forgotten, the oldest first."
MEASURED_KEPT_NS = 10_000_000_000
"Faults of what is measured go with plans so long after their end: no plan begins that long ago."


class SensorFaults:
    """The faults of one sensor, and what its instrument asks."""

    def __init__(self, run: FaultRun, instrument: Instrument) -> None:
        self.run = run
        self.instrument = instrument
        self.running: list[Running] = []
        "All that the run remembers."
        self.live: list[Running] = []
        "Those that can still do something."
        self.settling = False
        "Some of them may be over."
        self._before: dict[str, dict[str, int]] = {}
        "Counts of faults that are over and forgotten."
        self.late = LateTelegrams(len(instrument.links))
        "What leaves later because of them."
        self.taker: str | None = None
        "Name of the fault that took the scan of the telegram looked at last."
        self.counted = False
        "The telegram looked at last has been counted as sent: a fault holds it back."
        self.sweep: int | None = None
        "The scan that it carried when the device sent it."
        self.own_speeds: dict[int, list[int | None]] = {}
        "Of lines with a wrong speed: their own, and once more for each fault that holds."
        self.scan_labels: set[str] = set()
        "Labels of telegrams that carried a scan."

    def tell(self, event: FaultEvent) -> None:
        """Something has happened."""
        self.instrument.tell_fault(event)
        for listener in self.run.listeners:
            listener(self.instrument.sensor, event)

    def advance(self, now_ns: int) -> None:
        """Begin and end what is due."""
        for one in self.live:
            one.advance(now_ns)
        if self.settling:
            self.live = [one for one in self.live if one.can_act]
            self.settling = any(one.state == "over" for one in self.live)

    def add(self, one: Running) -> None:
        """One more."""
        self.running.append(one)
        self.live.append(one)

    def forget(self, one: Running) -> None:
        """A fault that is over goes out of the list; its counts stay."""
        self.running.remove(one)
        row = self._before.setdefault(one.fault.kind.name, {"begun": 0, "hits": 0})
        row["begun"] += one.begun
        row["hits"] += one.hits

    def cut(self) -> int:
        """The power is away: bytes that faults have held back; their scans have not left."""
        lost = self.late.clear() + [held for one in self.live if one.act is not None for held in one.act.cut()]
        for emission in {one.sweep: one for one in lost if one.sweep is not None}.values():
            self.instrument.stats.note_lost(emission, SWITCHED_OFF)
        return sum(len(one.payload) for one in lost)

    def next_ns(self) -> int | None:
        """When `advance` or `released` has something to do."""
        found = self.late.next_ns()
        for one in self.live:
            time_ns = one.next_ns()
            if time_ns is not None and (found is None or time_ns < found):
                found = time_ns
        return found

    def passed(self, emission: Emission, now_ns: int) -> Passed:
        """What becomes of a telegram."""
        if emission.sweep is not None:
            self.scan_labels.add(emission.label)
        return self._passed(emission, None, self.live, now_ns)

    def _passed(
        self, emission: Emission, only: int | None, faults: Sequence[Running], now_ns: int, counted: bool = False
    ) -> Passed:
        self.taker, self.counted, self.sweep = None, counted, emission.sweep
        made = self._through([(emission, only, 0)], faults, now_ns)
        leaving = [piece for one, index, by in made for piece in self.late.put(one, index, by, now_ns)]
        return Passed(None if counted else emission, made, leaving, self.taker, self.counted)

    def released(self, now_ns: int) -> list[Passed]:
        """What was held back and goes on now."""
        late = self.late.release(now_ns)
        found = [Passed(None, [], late, None, True)] if late else []
        for place, one in enumerate(self.live):
            if one.act is not None and one.releases:
                only = one.indices[0] if one.partial and len(one.indices) == 1 else None
                behind = self.live[place + 1 :]
                for emission in one.act.release(now_ns):
                    link = only if emission.address is None else None
                    found.append(self._passed(emission, link, behind, now_ns, one.act.counts_itself))
        return found

    def _through(self, pieces: list[Made], faults: Sequence[Running], now_ns: int) -> list[Made]:
        links = len(self.instrument.links)
        for one in faults:
            if one.passes:
                continue
            out: list[Made] = []
            for emission, only, by in pieces:
                targets: Sequence[int | None] = (only,)
                if emission.address is None and only is None and one.partial and links > 1:
                    targets = range(links)
                for index in targets:
                    at = index if emission.address is None else emission.address.link
                    if at is not None and at not in one.indices:
                        out.append((emission, index, by))
                        continue
                    first = at is None or emission.address is not None or at == one.indices[0]
                    out += [
                        (sent, index, one.number if sent.due_ns > emission.due_ns else by)
                        for sent in one.sends(emission, now_ns, first)
                    ]
            pieces = out
        return pieces

    def incoming(self, received: Received, index: int, now_ns: int) -> list[Received]:
        """What the device gets instead of what came in."""
        found = [received]
        for one in self.live:
            if index in one.indices and one.state != "over":
                found = [part for item in found for part in one.hears(item, index, now_ns)]
        return found

    def noted(self, event: Event) -> None:
        """Something that the session reported."""
        if isinstance(event, CommandHandled):
            for one in self.live:
                one.commanded(event)

    def asked(self, plan: ScanPlan) -> None:
        """A sweep is asked for: the faults that will show in it have hit."""
        active = self.instrument.conditions.of(self.instrument.sensor, plan.start_ns)
        if active:
            numbers = {fault.number for fault in active}
            for one in self.running:
                if one.number in numbers:
                    one.hit(plan.start_ns)

    def counts(self) -> dict[str, dict[str, int]]:
        """By name: how often begun, how many hits."""
        found = {name: dict(row) for name, row in self._before.items()}
        for one in self.running:
            row = found.setdefault(one.fault.kind.name, {"begun": 0, "hits": 0})
            row["begun"] += one.begun
            row["hits"] += one.hits
        return found

    def hits_of(self, name: str) -> int:
        """How often faults of that name have hit."""
        before = self._before.get(name, {"hits": 0})["hits"]
        return before + sum(one.hits for one in self.running if one.fault.kind.name == name)


class FaultRun:
    """All faults of a run."""

    def __init__(self, scenario: Scenario, instruments: Sequence[Instrument]) -> None:
        """Those of the scenario, judged; `FaultError` (reported by `check` with file and line) for one that cannot
        be."""
        self.seed = scenario.seed
        self._scenario = scenario
        self._instruments = {one.sensor: one for one in instruments}
        self._actors = ("world", *(actor.id for actor in scenario.actors))
        self._of: dict[str, SensorFaults] = {}
        self._faults: dict[int, Running] = {}
        self._numbers = 0
        self._measured: dict[int, ActiveFault] = {}
        self._last: LastScans | None = None
        self.listeners: list[Callable[[str, FaultEvent], None]] = []
        "Informed of every event: (sensor, event)."
        for entry in scenario.faults:
            self.add(entry.model_dump(exclude_none=True), 0, live=False)

    def add(self, entry: Mapping[str, Any], now_ns: int, live: bool = True) -> int:
        """One more fault, by the same keys as in a scenario; without a trigger it begins at once. Its number."""
        if "on" not in entry:
            raise FaultError(f"on: missing; want {', '.join(self._instruments)}")
        sensor = entry["on"]
        instrument = self._instruments.get(str(sensor))
        if instrument is None:
            from emulator.config.names import nearest

            raise FaultError(f"on: {sensor!r}; want {nearest(sensor, self._instruments)}")
        target = self._target(str(sensor))
        target = replace(target, links=tuple(link.kind for link in instrument.links) if live else target.links)
        fault = read(entry, target, self._check, live)
        self._make_room()
        self._numbers += 1
        number = self._numbers
        if str(sensor) not in self._of:
            instrument.faults = self._of[str(sensor)] = SensorFaults(self, instrument)
            instrument.faults.scan_labels |= set(target.messages or ())  # what a vehicle sends are its values
        at_ns = now_ns if fault.common.at_s is None else round(fault.common.at_s * 1e9)
        self._faults[number] = running = Running(number, fault, self._of[str(sensor)], self.seed, at_ns)
        running.of.add(running)
        if running.tree is not None:
            self._watch_scans({name.parts[0] for name in names(running.tree)})
        instrument.poked = True
        return number

    def _target(self, sensor: str) -> Target:
        if sensor == VEHICLE and self._scenario.vehicle_bus is not None:
            return vehicle_target(self._scenario.vehicle_bus.model_dump(), self._scenario.folder)
        config = next(one for one in self._scenario.sensors if one.id == sensor)
        actors = [actor.id for actor in self._scenario.actors]
        return target_of(config.id, config.model, config.links, config.device, actors)

    def _make_room(self) -> None:
        if len(self._faults) < MOST_FAULTS:
            return
        oldest = next((number for number, one in self._faults.items() if one.state == "over"), None)
        if oldest is None:
            raise FaultError(f"{MOST_FAULTS} faults are waiting or active; want some of them cleared")
        gone = self._faults.pop(oldest)
        gone.of.forget(gone)

    def clear(self, number: int, now_ns: int) -> dict[str, object]:
        """End a fault for good; what it did."""
        running = self._faults.get(number)
        if running is None:
            reported = ", ".join(map(str, self._faults)) or "none: the list is empty"
            raise FaultError(f"number: {number}; want {reported}")
        running.end(now_ns, for_good=True)
        running.of.late.let_go(number, now_ns)
        self._instruments[running.fault.sensor].poked = True
        return running.row()

    def rows(self) -> list[dict[str, object]]:
        """All faults of the run so far."""
        return [one.row() for one in self._faults.values()]

    # what is measured

    def install(self, fault: ActiveFault) -> None:
        """From now on plans go with it."""
        self._measured[fault.number] = fault
        self._share()

    def close_measured(self, number: int, now_ns: int) -> None:
        """It holds until now at most; forgotten once no plan can begin before."""
        fault = self._measured.get(number)
        if fault is not None and (fault.until_ns is None or fault.until_ns > now_ns):
            self._measured[number] = replace(fault, until_ns=max(now_ns, fault.from_ns))
        oldest_ns = now_ns - MEASURED_KEPT_NS
        kept = {one.number: one for one in self._measured.values() if one.until_ns is None or one.until_ns > oldest_ns}
        self._measured = kept
        self._share()

    def _share(self) -> None:
        faults = tuple(self._measured[number] for number in sorted(self._measured))
        for instrument in self._instruments.values():
            instrument.conditions = replace(instrument.conditions, faults=faults)

    # expressions

    def _check(self, text: str) -> None:
        check_expression(text, [name for name in self._instruments if name != VEHICLE], self._actors)

    def _watch_scans(self, sensors: set[str]) -> None:
        if self._last is None:
            self._last = LastScans(self._instruments, self._actors, self._judge)
        for sensor in sensors:
            self._last.watch(sensor)

    def _judge(self, sensor: str, at_ns: int) -> None:
        """A scan has been measured: expressions that name its sensor are looked at."""
        assert self._last is not None
        for one in self._faults.values():
            tree = one.tree
            if tree is None or one.state == "over" or all(name.parts[0] != sensor for name in names(tree)):
                continue
            one.judged(truth(evaluate(tree, self._last.value)), at_ns)
