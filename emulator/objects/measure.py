"""The measuring function of a sensor that lists objects: a plan in, a list with its truth out.

Belongs here: which sweeps of the sources are looked at for a list, and what is remembered from list to list. The same
plans in the same order give the same lists. Rules:

- Each list looks at the newest sweep of each source that has been evaluated by the list's instant, once; sweeps
  between two lists are not measured. With none that is new, objects move on as predicted.
- A sweep older than the coasting time is not looked at any more.
- A plan given again gives the same list. Lists that are made again after a changed setting go on from what was known
  before their instant. After a restart of the device (its sweep 0), or after a pause longer than the coasting time,
  nothing is known.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from emulator.measuring.conditions import NORMAL, Conditions
from emulator.measuring.measuring import Measure, measured
from emulator.objects.metrics import ListedScan, TruthObject, visible_share
from emulator.objects.options import TrackerOptions, options_of
from emulator.objects.points import View
from emulator.objects.sweeps import Sweeps, end_ns, sweeps_of
from emulator.objects.tracker import ObjectTracker, Snapshot
from emulator.objects.truth import Witness
from emulator.scenario.scenario import Scenario
from emulator.scenario.tables import Mount
from emulator.sensors.spec import load_spec
from emulator.world.scene import Scene
from protocols.scan import DetectedObject, Scan, ScanPlan
from protocols.session import Session

REMEMBERED = 64
"Lists that can be gone back to: a quarter of a second of look-ahead at the shortest cycle, 5 ms."
ROUNDING_S = 1e-9
LEAST_PAUSE_S = 0.25
"Shorter pauses between lists are no restart, however short the coasting time is."


@dataclass(frozen=True, eq=False)
class Source:
    """A sensor from whose scans objects are made."""

    sweeps: Sweeps
    measure: Measure
    mount: Mount


@dataclass(frozen=True, eq=False)
class _Memory:
    """What is known after a list."""

    at_ns: int
    "-1: nothing yet"
    tracker: Snapshot
    looked_ns: int
    "Instant of the last list with a new sweep."
    sweeps: Mapping[int, int]
    "Source -> the sweep that was looked at last."
    shares: Mapping[int, float]
    "Actor -> visible share in the last sweeps."


class ObjectMeasure:
    """Lists the objects of one sensor."""

    def __init__(
        self, scene: Scene, mount: Mount, options: TrackerOptions, sources: Sequence[Source], sensor: str = ""
    ) -> None:
        self._sensor = sensor
        self._frozen: dict[int, tuple[DetectedObject, ...]] = {}
        "Of faults by number: the list that each has frozen."
        self._scene = scene
        self._witness = Witness(scene, mount)
        self._mount = mount
        self._sources = tuple(sources)
        self._tracker = ObjectTracker(options, scene.actors)
        self._pause_ns = round(1e9 * max(options.coast_s, LEAST_PAUSE_S))
        self._memories: deque[_Memory] = deque([self._nothing()], maxlen=REMEMBERED)
        self._last: ListedScan | None = None

    @property
    def warnings(self) -> tuple[str, ...]:
        """What its sources computed outside the range where it is known to hold."""
        return tuple(text for source in self._sources for text in getattr(source.measure, "warnings", ()))

    def state(self) -> object:
        """All that is remembered from list to list, for another process that goes on; see `restore`."""
        return tuple(self._memories), self._last, self._frozen

    def restore(self, state: Any) -> None:
        """Go on from the `state` of another one of the same sensor and scenario."""
        memories, self._last, self._frozen = state
        self._memories = deque(memories, maxlen=REMEMBERED)

    def __call__(self, plan: ScanPlan, conditions: Conditions = NORMAL) -> Scan:
        """The list that a plan asks for; its sources are measured under the same conditions."""
        made = self._made(plan, conditions)
        faults = conditions.of(self._sensor, plan.start_ns) if conditions.faults else ()
        if not faults:
            self._frozen.clear()
            return made
        from emulator.objects.fault_lists import listed
        from emulator.sensing.faulty.held import held

        return listed(made, held(faults, plan), self._frozen)

    def _made(self, plan: ScanPlan, conditions: Conditions) -> Scan:
        """The list as it is made, whatever the device then makes of it."""
        if self._last is not None and _key(self._last.plan) == _key(plan):
            return replace(self._last, plan=plan)
        before = self._before(plan)
        self._tracker.restore(before.tracker)
        t_s = 1e-9 * plan.start_ns
        views, sweeps = self._look(plan.start_ns, before.sweeps, conditions)
        objects = self._tracker.update(views, t_s, self._witness.motion(self._scene.local_s(t_s)))
        looked_ns = plan.start_ns if views else before.looked_ns
        if looked_ns >= 0:
            # seen in the newest sweep there is: nothing has been missed since
            objects = tuple(_fresher(item, 1e-9 * (plan.start_ns - looked_ns)) for item in objects)
        shares = self._shares(views) if views else before.shares
        truth = self._truth(t_s, shares)
        self._memories.append(_Memory(plan.start_ns, self._tracker.snapshot(), looked_ns, sweeps, shares))
        empty = Scan.empty(plan)
        self._last = ListedScan(plan, empty.range_m, empty.intensity, empty.flags, empty.actor, objects, truth=truth)
        return self._last

    def _nothing(self) -> _Memory:
        self._tracker.clear()
        return _Memory(-1, self._tracker.snapshot(), -1, {}, {})

    def _before(self, plan: ScanPlan) -> _Memory:
        """What is known when a list is made; later lists are forgotten."""
        while self._memories and self._memories[-1].at_ns >= plan.start_ns:
            self._memories.pop()
        known = self._memories[-1] if self._memories else None
        if known is None or plan.sweep == 0 or plan.start_ns - known.at_ns > self._pause_ns:
            self._memories.clear()
            self._memories.append(self._nothing())
        return self._memories[-1]

    def _look(self, at_ns: int, before: Mapping[int, int], conditions: Conditions) -> tuple[list[View], dict[int, int]]:
        """Views of the sources' newest sweeps that were not looked at before."""
        views, looked = [], dict(before)
        for number, source in enumerate(self._sources):
            wanted = source.sweeps.newest(at_ns)
            if wanted is None or wanted.sweep == before.get(number) or at_ns - end_ns(wanted) > self._pause_ns:
                continue
            looked[number] = wanted.sweep
            views.append(self._view(source, measured(source.measure, wanted, conditions)))
        return views, looked

    def _view(self, source: Source, scan: Scan) -> View:
        t_s = np.array([self._middle_s(scan)])
        here, there = self._scene.sensor_pose(self._mount, t_s), self._scene.sensor_pose(source.mount, t_s)
        back = here.rotation[0].T
        return View(scan, back @ (there.position_m[0] - here.position_m[0]), back @ there.rotation[0])

    def _shares(self, views: Sequence[View]) -> dict[int, float]:
        """Visible share of every actor that has an echo, in the view that shows most of it."""
        shares: dict[int, float] = {}
        for view in views:
            t_s = self._middle_s(view.scan)
            own = self._witness.sensor(t_s)
            for actor in np.unique(view.scan.actor).tolist():
                if self._witness.knows(actor):
                    share = visible_share(view, self._witness.object(actor, t_s, own), actor)
                    shares[actor] = max(share, shares.get(actor, 0.0))
        return shares

    def _truth(self, t_s: float, shares: Mapping[int, float]) -> tuple[TruthObject, ...]:
        there = self._witness.objects(self._scene.local_s(t_s))
        return tuple(replace(item, visible_share=shares.get(actor, 0.0)) for actor, item in there.items())

    def _middle_s(self, scan: Scan) -> float:
        """Of a sweep, in the scene's own time: that of the round in which it began."""
        plan = scan.plan
        local_ns = plan.start_ns - self._scene.turned_ns(plan.start_ns)
        return 1e-9 * local_ns + (float(plan.fire_offset_s.mean()) if len(plan) else 0.0)


def _key(plan: ScanPlan) -> tuple[int, int, int]:
    return plan.epoch, plan.sweep, plan.start_ns


def _fresher(item: DetectedObject, by_s: float) -> DetectedObject:
    if by_s <= 0.0 or not item.coasting_s:
        return item
    left_s = item.coasting_s - by_s
    # formats ask for exactly zero: what rounding leaves of it is none
    return replace(item, coasting_s=left_s if left_s > ROUNDING_S else 0.0)


class ClassesNow(Mapping[str, str]):
    """Classes of the actors of a scene to which a feed brings some."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene

    def __getitem__(self, name: str) -> str:
        if name not in self._scene.index:
            raise KeyError(name)
        return self._scene.class_of(name)

    def __iter__(self) -> Iterator[str]:
        return iter(self._scene.actors)

    def __len__(self) -> int:
        return len(self._scene.actors)


def build(
    scenario: Scenario, scene: Scene, measures: Mapping[str, Measure], sessions: Mapping[str, Session], sensor_id: str
) -> ObjectMeasure:
    """The measuring function of one sensor that lists objects.

    Parameters
    ----------
    measures : of the sensors that measure
    sessions : switched off, one for each source that has a protocol; nobody else may use them
    """
    config = next(one for one in scenario.sensors if one.id == sensor_id)
    by_id = {one.id: one for one in scenario.sensors}
    spec = load_spec(config.model)
    classes: Mapping[str, str] = dict(zip(scene.actors, scene.classes, strict=True))
    if scene.pool:
        classes = ClassesNow(scene)
    options = options_of(config.objects.model_dump(exclude_none=True), classes, str(spec.device.get("format", "")))
    sources = [
        Source(sweeps_of(load_spec(by_id[name].model), sessions.get(name)), measures[name], by_id[name].mount)
        for name in config.from_
    ]
    return ObjectMeasure(scene, config.mount, options, sources, sensor_id)
