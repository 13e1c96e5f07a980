"""What an inertial unit at a sensor's mount feels: specific force and rate of its true motion.

Belongs here: these quantities of the motion in the scenario's file, or in a feed. Not: errors of the unit (protocols).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from emulator.live.tracks import World
from emulator.scenario.scenario import Scenario
from emulator.world.fed import Box, Fed, FedNow
from emulator.world.motion import Floats, Motion, Pose, Steady, whole_turns
from emulator.world.scene import motion_of

STEP_S = 5e-3
"Rates are differences over this time: the bandwidth of the unit. A corner between waypoints is a push as long."
G_M_S2 = 9.80665
LATEST_S = 0.25
"Newer poses than the newest sample of a feed are guesses that feel nothing: the unit is as late as that, at most."
LONGEST_STEP_S = 0.1
"Between samples without velocities actors move in straight lines: rates are then differences over the samples."
BEFORE_S = LATEST_S + 2.0 * LONGEST_STEP_S
"Poses of a feed are wanted from so long before an instant."
FASTEST_M_S = 400.0
"Faster is a jump of a feed, which no unit feels."


class MountMotion:
    """That of one sensor of a scenario."""

    def __init__(self, scenario: Scenario, index: int) -> None:
        mount = scenario.sensors[index].mount
        self._place = Steady(mount.at_m, mount.yaw_deg, mount.pitch_deg, mount.roll_deg)
        self._scenario, self.actor = scenario, mount.actor
        "`actor`: which it is mounted on; None: the world."
        self._carrier: Motion | None = None
        self._carries = next((one for one in scenario.actors if one.id == mount.actor), None)
        if self._carries is not None:
            self._carrier = motion_of(self._carries.motion)
        self._round_s = scenario.round_s
        self._now = FedNow()
        self._world_of: Callable[[str, int], World] | None = None
        still = self._carrier is None or self._carrier.still
        self._still = self._felt(0.0) if still else None

    def feed(self, world_of: Callable[[str, int], World]) -> None:
        """From now on `world_of` says where a feed has the actor, from `BEFORE_S` before an instant on."""
        live = self._scenario.live
        if self.actor is None or live is None:
            return
        shape = None if self._carries is None else self._carries.shape
        box = None
        if (
            shape is not None and shape.box is not None
        ):  # its base is at its origin; of a mesh the feeder tells the size
            half = tuple(0.5 * one for one in shape.box.size_m)
            box = Box((0.0, 0.0, half[2]), (half[0], half[1], half[2]))
        self._world_of, self._still = world_of, None
        self._carrier = Fed(self._now, self.actor, self._carrier, box, mount=live.mount)

    def at(self, now_ns: int) -> tuple[Floats, Floats]:
        """Specific force and rate (3,) in the sensor's frame at an instant of the run. [m/s^2, rad/s]"""
        if self._still is not None:
            return self._still
        t_s = now_ns * 1e-9
        turned_s = 0.0 if self._round_s is None else float(whole_turns(t_s, 0.0, self._round_s))
        if self._world_of is None or self.actor is None:
            return self._felt(t_s - turned_s)
        world = self._world_of(self.actor, now_ns)
        self._now.use(world.earlier(turned_s) if turned_s else world)
        known = max(self._now.of(self.actor), key=lambda track: track.last_s, default=None)
        t_s -= turned_s
        if known is None:
            return self._felt(t_s)
        step_s = STEP_S
        if len(known.t_s) > 1 and np.isnan(known.velocity_m_s[-1, 0]):
            step_s = float(np.clip(np.diff(known.t_s[-3:]).max(), STEP_S, LONGEST_STEP_S))
        return self._felt(min(t_s, max(known.last_s - step_s, t_s - LATEST_S)), step_s)

    def _felt(self, t_s: float, step_s: float = STEP_S) -> tuple[Floats, Floats]:
        times = t_s + step_s * np.array([-1.0, 0.0, 1.0])
        pose = self._place.pose(times)
        if self._carrier is not None:
            pose = pose.after(self._carrier.pose(times))
        if float(np.abs(np.diff(pose.position_m, axis=0)).max()) > FASTEST_M_S * step_s:
            pose = Pose(pose.position_m[[1, 1, 1]], pose.rotation[[1, 1, 1]])
        before, here, after = pose.position_m
        force = (before - 2.0 * here + after) / step_s**2 + np.array([0.0, 0.0, G_M_S2])
        turned = pose.rotation[0].T @ pose.rotation[2]
        axis = 0.5 * np.array([turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]])
        sine = float(np.linalg.norm(axis))
        angle = np.arctan2(sine, 0.5 * (float(np.trace(turned)) - 1.0))
        rate = axis / (2.0 * step_s) if sine < 1e-9 else axis * (angle / sine) / (2.0 * step_s)
        return pose.rotation[1].T @ force, rate
