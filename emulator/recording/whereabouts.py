"""Where sensors and actors are at an instant of a run, for formats that tell it beside what was measured.

Belongs here: poses of a scenario's scene, of fed actors too. Not: what they are written as (foxglove, osi_out).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from emulator.live.tracks import World
from emulator.scenario.scenario import Scenario
from emulator.scenario.tables import Mount
from emulator.world import scene
from emulator.world.fed import NOWHERE_M
from emulator.world.motion import Pose
from protocols.scan import Floats, Scan, points_of

Poses = Callable[[float, float], World]
"Tracks of a feed between two instants. [s]"


@dataclass(frozen=True)
class Boxed:
    """One actor's box in the world."""

    index: int
    name: str
    centre_m: Floats
    rotation: Floats
    size_m: Floats


class Whereabouts:
    """Of one run; its own copy of the scene."""

    def __init__(self, scenario: Scenario, poses: Poses | None = None) -> None:
        """`poses`: of the feed, if there is one. `SceneError` as when the run is begun."""
        self.scene = scene.build(scenario)
        self._poses = poses
        self._mounts: dict[str, Mount] = {one.id: one.mount for one in scenario.sensors}
        self.sensors = [one.id for one in scenario.sensors]
        self.ego = None if scenario.live is None else scenario.live.ego
        shapes: dict[int, list[scene.Body]] = {}
        for body in self.scene.bodies:
            if body.actor != scene.WORLD:
                shapes.setdefault(body.actor, []).append(body)
        self._shapes = shapes

    def mount(self, sensor: str) -> Mount:
        """Where a sensor sits."""
        return self._mounts[sensor]

    def _local(self, begin_s: float, end_s: float) -> float:
        """What the scene's own time is less than the run's; it knows the feed of that time from now on."""
        away_s = begin_s - self.scene.local_s(begin_s)
        if self.scene.fed is not None and self._poses is not None:
            world = self._poses(begin_s - 0.01, end_s + 0.01)
            self.scene.fed.use(world.earlier(away_s) if away_s else world)
        return away_s

    def sensor(self, name: str, times_s: Floats) -> Pose:
        """A sensor's pose at instants of the run."""
        away_s = self._local(float(times_s.min()), float(times_s.max()))
        return self.scene.sensor_pose(self._mounts[name], times_s - away_s)

    def actor(self, name: str, at_s: float) -> Pose:
        """An actor's pose at an instant of the run."""
        away_s = self._local(at_s, at_s)
        return self.scene.pose(self.scene.index[name], np.array([at_s - away_s]))

    def points(self, name: str, scan: Scan) -> tuple[Floats, Floats, Floats, Floats]:
        """Echoes in the world, by the pose at each beam's instant: (e, 3) m, intensity, actor, beam."""
        plan = scan.plan
        beam, place = np.nonzero(np.isfinite(scan.range_m))
        if not len(beam):
            nothing = np.zeros(0)
            return np.zeros((0, 3)), nothing, nothing, nothing
        origin = None if plan.origin_m is None else plan.origin_m[beam]
        own = points_of(plan.azimuth_rad[beam], plan.elevation_rad[beam], scan.range_m[beam, place], origin)
        points = self.sensor(name, plan.start_ns * 1e-9 + plan.fire_offset_s[beam]).to_world(own)
        return points, scan.intensity[beam, place], scan.actor[beam, place].astype(float), beam.astype(float)

    def boxes(self, at_s: float) -> list[Boxed]:
        """Of every actor with a shape that is there."""
        away_s = self._local(at_s, at_s)
        now = np.array([at_s - away_s])
        found = []
        for actor, bodies in self._shapes.items():
            for body in bodies:
                pose = body.motion.pose(now)
                if np.abs(pose.position_m[0]).max() >= 0.5 * abs(NOWHERE_M):
                    continue
                low, high = body.vertices.min(axis=0), body.vertices.max(axis=0)
                scale = np.asarray(getattr(body.motion, "scale", (1.0, 1.0, 1.0)))
                centre = pose.to_world(0.5 * (low + high) * scale)[0]
                found.append(Boxed(actor, self.scene.actors[actor], centre, pose.rotation[0], (high - low) * scale))
                break
        return found
