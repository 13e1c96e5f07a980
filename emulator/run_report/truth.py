"""True ranges of recorded sweeps: the axis of each beam cast again into the recorded scene, at the beam's own instant.

No noise, no footprint, no weather: the range at which the axis meets the first surface. Belongs here: sweeps in batches
to the ray caster. Not: what is made of the differences (errors).
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from emulator.casting import raycast
from emulator.casting.detail import detailed
from emulator.casting.hits import Hits, LateHits
from emulator.errors import EmulatorError
from emulator.recording.layout import RecordedScan
from emulator.run_report.errors import RangeTally
from emulator.scenario import scenario as scenario_file
from emulator.scenario.scenario import Scenario
from emulator.world import scene
from emulator.world.feed_record import Played
from emulator.world.scene import Scene
from protocols.scan import Floats, Ints, points_of

BATCH_BEAMS = 30_000


class Truth:
    """The recorded scene."""

    def __init__(self, scenario: Scenario, world: Scene, played: Played | None = None) -> None:
        """`played`: the recorded feed, where somebody else moved the world."""
        self._played = played
        self._caster = detailed(raycast.Caster(world), world, scenario)
        self._mounts = {sensor.id: sensor.mount for sensor in scenario.sensors}
        self.scene = world

    @property
    def is_fed(self) -> bool:
        """Somebody else moved the world."""
        return self._played is not None

    def place(self, begin_s: float, end_s: float, turned_s: float = 0.0) -> None:
        """Everything where it was from `begin_s` to `end_s`; `turned_s`: what finished rounds had taken."""
        if self._played is not None and self.scene.fed is not None:
            world = self._played.world(begin_s + turned_s, end_s + turned_s)
            self.scene.fed.use(world.earlier(turned_s) if turned_s else world)

    def tally_of(self, sensor: str) -> SensorTruth:
        """Adds up one sensor's sweeps."""
        return SensorTruth(self, sensor)

    def first(self, origin_m: Floats, direction: Floats, t_s: float) -> Hits | LateHits:
        """What rays from one point meet first, all at one instant."""
        origins = np.ascontiguousarray(np.broadcast_to(origin_m, direction.shape))
        return self._caster.first_hits(origins, np.ascontiguousarray(direction), np.full(len(direction), t_s))

    def ranges(
        self, sensor: str, t_s: Floats, azimuth_rad: Floats, elevation_rad: Floats, origin_m: Floats | None = None
    ) -> tuple[Floats, Ints]:
        """True range, NaN where the axis meets nothing, and index of the actor met, -1; (b,) each.

        `origin_m` (b, 3): where beams begin, in the sensor's frame.
        """
        pose = self.scene.sensor_pose(self._mounts[sensor], t_s)
        direction = np.einsum("nij,nj->ni", pose.rotation, points_of(azimuth_rad, elevation_rad, np.ones(len(t_s))))
        begun = pose.position_m if origin_m is None else pose.to_world(origin_m)
        hits = self._caster.first_hits(np.ascontiguousarray(begun), np.ascontiguousarray(direction), t_s)
        return hits.range_m, hits.actor


class SensorTruth:
    """Sweeps of one sensor, cast some at a time."""

    def __init__(self, truth: Truth, sensor: str) -> None:
        self._truth, self._sensor = truth, sensor
        self.tally = RangeTally(truth.scene.actors)
        self.offsets_s: Floats | None = None
        "When beams are fired after their sweep's start; None: not recorded, then all at the start."
        self.without_offsets = 0
        self._waiting: list[tuple[RecordedScan, Floats]] = []
        self._beams = 0

    def add(self, scan: RecordedScan) -> None:
        """One sweep; it may wait until more are there."""
        n = len(scan.azimuth_rad)
        offsets = self.offsets_s
        if offsets is None or len(offsets) != n:
            self.without_offsets += 1
            offsets = np.zeros(n)
        self._waiting.append((scan, offsets))
        self._beams += n
        if self._beams >= BATCH_BEAMS:
            self.flush()

    def flush(self) -> None:
        """Cast what waits. Sweeps of other numbers of echoes a beam are cast apart."""
        while self._waiting:
            k = self._waiting[0][0].range_m.shape[1]
            batch = [one for one in self._waiting if one[0].range_m.shape[1] == k]
            if self._truth.is_fed:  # poses are known for a stretch of one round
                turned = self._truth.scene.turned_ns(batch[0][0].start_ns)
                batch = [one for one in batch if self._truth.scene.turned_ns(one[0].start_ns) == turned]
            taken = {id(scan) for scan, _ in batch}
            self._waiting = [one for one in self._waiting if id(one[0]) not in taken]
            scans = [scan for scan, _ in batch]
            starts_s = np.array([scan.start_ns for scan in scans], dtype=np.float64) * 1e-9
            turned_ns = np.array([self._truth.scene.turned_ns(scan.start_ns) for scan in scans])
            local_s = (np.array([scan.start_ns for scan in scans]) - turned_ns) * 1e-9
            sweep = np.repeat(np.arange(len(scans)), [len(scan.azimuth_rad) for scan in scans])
            t_s = local_s[sweep] + np.concatenate([offsets for _, offsets in batch])
            azimuth = np.concatenate([scan.azimuth_rad for scan in scans])
            elevation = np.concatenate(
                [np.zeros_like(one.azimuth_rad) if one.elevation_rad is None else one.elevation_rad for one in scans]
            )
            self._truth.place(float(t_s.min()), float(t_s.max()), float(turned_ns[0]) * 1e-9)
            origin = None
            if any(one.origin_m is not None for one in scans):
                begun = [np.zeros((len(one.azimuth_rad), 3)) if one.origin_m is None else one.origin_m for one in scans]
                origin = np.concatenate(begun)
            true_m, true_actor = self._truth.ranges(self._sensor, t_s, azimuth, elevation, origin)
            range_m = np.concatenate([scan.range_m for scan in scans])
            actor = np.concatenate([scan.actor for scan in scans])
            self.tally.add(starts_s, range_m, actor, true_m, true_actor, sweep)
        self._beams = 0


def truth_of(text: str, path: Path, tell: Callable[[str], None]) -> tuple[Scenario | None, Truth | None]:
    """The recorded scenario and its scene; `tell` gets the reason why there is none, as when a mesh has gone."""
    try:
        loaded = scenario_file.loads(text, path)
    except (EmulatorError, ValueError) as error:
        tell(f"The recorded scenario cannot be read by this version: {str(error).splitlines()[0]}")
        return None, None
    try:
        played = None if loaded.live is None else Played(loaded, path.parent)
        return loaded, Truth(loaded, scene.build(loaded), played)
    except (EmulatorError, ValueError) as error:
        tell(f"The recorded scene cannot be built: {str(error).splitlines()[0]}")
        return loaded, None
