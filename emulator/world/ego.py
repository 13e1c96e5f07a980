"""What a vehicle's own sensors would tell of its motion: speed, yaw rate, steering angle at an instant.

Belongs here: these quantities of an actor's true motion, of file or feed. Not: signals and frames (instrument).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from emulator.live.tracks import World
from emulator.scenario.scenario import Scenario
from emulator.world.fed import NOWHERE_M, Fed, FedNow
from emulator.world.motion import Motion, whole_turns
from emulator.world.scene import motion_of

STEP_S = 1e-4
"Rates are differences over this time, from the instant on."
FASTEST_M_S = 400.0
"Faster is a jump, of which no sensor of a vehicle knows."
SLOWEST_M_S = 0.1
"Slower, the steering angle does not follow from the motion; it stays."


@dataclass(frozen=True)
class EgoState:
    """The vehicle's motion at one instant; ISO 8855 signs: forwards and to the left are positive."""

    speed_m_s: float = 0.0
    "Along its own x axis."
    yaw_rate_rad_s: float = 0.0
    "About its own z axis."
    curvature_1_m: float = 0.0
    "Of the way of its rear axle, where it moves; else as it was last."

    def steering_rad(self, wheelbase_m: float) -> float:
        """Angle of the front wheels by the kinematic single-track model."""
        return math.atan(wheelbase_m * self.curvature_1_m)


class EgoMotion:
    """One actor's, at rising instants."""

    def __init__(self, scenario: Scenario, actor: str) -> None:
        """Of the scenario's file, until `feed`."""
        self._motion: Motion = next(motion_of(one.motion) for one in scenario.actors if one.id == actor)
        self.actor = actor
        self._now = FedNow()
        self._world_of: Callable[[str, int], World] | None = None
        self._round_s = scenario.round_s
        self._last = EgoState()

    def feed(self, world_of: Callable[[str, int], World]) -> None:
        """From now on `world_of` says where a feed has the actor around an instant."""
        self._world_of = world_of
        self._motion = Fed(self._now, self.actor, self._motion, None)

    def at(self, now_ns: int) -> EgoState:
        """At an instant of the run; while the actor jumps, or is not there, as it was before."""
        t_s = now_ns * 1e-9
        turned_s = 0.0 if self._round_s is None else float(whole_turns(t_s, 0.0, self._round_s))
        if self._world_of is not None:
            world = self._world_of(self.actor, now_ns)
            self._now.use(world.earlier(turned_s) if turned_s else world)
        pose = self._motion.pose(np.array([t_s - turned_s, t_s - turned_s + STEP_S]))
        if float(np.abs(pose.position_m).max()) >= 0.5 * NOWHERE_M:
            return self._last
        velocity = (pose.position_m[1] - pose.position_m[0]) / STEP_S
        if math.hypot(*velocity) > FASTEST_M_S:
            return self._last
        turn = pose.rotation[0].T @ pose.rotation[1]
        speed = float(pose.rotation[0][:, 0] @ velocity)
        yaw_rate = math.atan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1]) / STEP_S
        curvature = yaw_rate / speed if abs(speed) > SLOWEST_M_S else self._last.curvature_1_m
        self._last = EgoState(speed, yaw_rate, curvature)
        return self._last
