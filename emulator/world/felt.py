"""What an inertial unit at a sensor's mount feels: specific force and rate of its true motion.

Belongs here: these quantities of the motion in the scenario's file. Not: errors of the unit (protocols).
"""

from __future__ import annotations

import numpy as np

from emulator.scenario.scenario import Scenario
from emulator.world.motion import Floats, Motion, Steady, whole_turns
from emulator.world.scene import motion_of

STEP_S = 5e-3
"Rates are differences over this time: the bandwidth of the unit. A corner between waypoints is a push as long."
G_M_S2 = 9.80665


class MountMotion:
    """That of one sensor of a scenario."""

    def __init__(self, scenario: Scenario, index: int) -> None:
        mount = scenario.sensors[index].mount
        self._place = Steady(mount.at_m, mount.yaw_deg, mount.pitch_deg, mount.roll_deg)
        self._carrier: Motion | None = None
        if mount.actor is not None:
            self._carrier = next(motion_of(one.motion) for one in scenario.actors if one.id == mount.actor)
        self._round_s = scenario.round_s
        still = self._carrier is None or self._carrier.still
        self._still = self._felt(0.0) if still else None

    def at(self, now_ns: int) -> tuple[Floats, Floats]:
        """Specific force and rate (3,) in the sensor's frame at an instant of the run. [m/s^2, rad/s]"""
        if self._still is not None:
            return self._still
        t_s = now_ns * 1e-9
        return self._felt(t_s if self._round_s is None else t_s - float(whole_turns(t_s, 0.0, self._round_s)))

    def _felt(self, t_s: float) -> tuple[Floats, Floats]:
        times = t_s + STEP_S * np.array([-1.0, 0.0, 1.0])
        pose = self._place.pose(times)
        if self._carrier is not None:
            pose = pose.after(self._carrier.pose(times))
        before, here, after = pose.position_m
        force = (before - 2.0 * here + after) / STEP_S**2 + np.array([0.0, 0.0, G_M_S2])
        turned = pose.rotation[0].T @ pose.rotation[2]
        axis = 0.5 * np.array([turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]])
        sine = float(np.linalg.norm(axis))
        angle = np.arctan2(sine, 0.5 * (float(np.trace(turned)) - 1.0))
        rate = axis / (2.0 * STEP_S) if sine < 1e-9 else axis * (angle / sine) / (2.0 * STEP_S)
        return pose.rotation[1].T @ force, rate
