"""What the objects really are: boxes of the scene's actors, as a sensor sees them move.

Belongs here: truth for judging lists, and the true motion of the sensor that lists them. Nothing of it is reported to
a host, but the ego motion that a device on a vehicle knows. Not: figures (`emulator.objects.metrics`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from emulator.objects.metrics import TruthObject
from emulator.objects.points import Floats, SensorMotion
from emulator.scenario.tables import Mount
from emulator.world.fed import Fed
from emulator.world.scene import Scene

STEP_S = 1e-3
"Over which turning is measured."
JUMP_RAD_S = 50.0
"Faster is no turning but a looping path that begins again."


@dataclass(frozen=True, eq=False)
class Carried:
    """A point fixed to an actor or to the world at one instant."""

    position_m: Floats
    "(3,) in the world"
    rotation: Floats
    "(3, 3) to the world"
    velocity_m_s: Floats
    "(3,) over ground"
    yaw_rate_rad_s: float


def carried(scene: Scene, actor: int, t_s: float, at_m: Floats, own: Floats) -> Carried:
    """Motion of a point `at_m` (3,) of an actor, with axes turned by `own` (3, 3) against the actor's."""
    times = np.array([t_s, t_s + STEP_S])
    pose = scene.pose(actor, times)
    axes = pose.rotation[:, :, 0]
    turned = np.diff(np.arctan2(axes[:, 1], axes[:, 0]))[0]
    rate = float((turned + math.pi) % (2.0 * math.pi) - math.pi) / STEP_S
    rate = rate if abs(rate) < JUMP_RAD_S else 0.0
    arm = pose.rotation[0] @ at_m
    velocity = scene.velocity(actor, times[:1])[0] + rate * np.array([-arm[1], arm[0], 0.0])
    return Carried(pose.position_m[0] + arm, pose.rotation[0] @ own, velocity, rate)


class Witness:
    """Knows where everything is, in the frame of one sensor."""

    def __init__(self, scene: Scene, mount: Mount) -> None:
        self._scene = scene
        self._carrier = 0 if mount.actor is None else scene.index[mount.actor]
        fixed = scene.sensor_pose(mount.model_copy(update={"actor": None}), np.zeros(1))
        self._at_m, self._own = fixed.position_m[0], fixed.rotation[0]
        corners: dict[int, list[Floats]] = {}
        for body in scene.bodies:
            if body.actor not in (0, self._carrier):
                ends = corners.setdefault(body.actor, [])
                ends += [body.vertices.min(axis=0), body.vertices.max(axis=0)]
        self._boxes = {actor: (np.min(ends, axis=0), np.max(ends, axis=0)) for actor, ends in corners.items()}

    def motion(self, t_s: float) -> SensorMotion:
        """Of the sensor itself."""
        own = self.sensor(t_s)
        return SensorMotion(
            x_m=float(own.position_m[0]),
            y_m=float(own.position_m[1]),
            yaw_rad=float(np.arctan2(own.rotation[1, 0], own.rotation[0, 0])),
            vx_m_s=float(own.velocity_m_s[0]),
            vy_m_s=float(own.velocity_m_s[1]),
            yaw_rate_rad_s=own.yaw_rate_rad_s,
        )

    def sensor(self, t_s: float) -> Carried:
        """Where the sensor is and how it moves."""
        return carried(self._scene, self._carrier, t_s, self._at_m, self._own)

    def objects(self, t_s: float) -> dict[int, TruthObject]:
        """Every actor that has a shape, but the one that carries the sensor; visible share 0 so far."""
        own = self.sensor(t_s)
        return {actor: self.object(actor, t_s, own) for actor in self._boxes if self._is_there(actor)}

    def _is_there(self, actor: int) -> bool:
        motion = self._scene.motions[actor]
        return not isinstance(motion, Fed) or motion.there

    def _box(self, actor: int) -> tuple[Floats, Floats]:
        """Least and largest corner about its origin; of an actor that a feed has brought as large as that says."""
        fed = self._scene.fed
        if fed is None or not self._scene.is_of_pool(actor):
            return self._boxes[actor]
        size = next((one.size_m for one in reversed(fed.of(self._scene.actors[actor])) if one.size_m is not None), None)
        if size is None:
            return self._boxes[actor]
        return np.array([-0.5 * size[0], -0.5 * size[1], 0.0]), np.array([0.5 * size[0], 0.5 * size[1], size[2]])

    def knows(self, actor: int) -> bool:
        """Whether that actor is to be listed: not the world, nor the sensor's own vehicle, nor without a
        shape."""
        return actor in self._boxes

    def object(self, actor: int, t_s: float, own: Carried | None = None) -> TruthObject:
        """One actor, from a sensor whose place and motion at that time are `own`."""
        own, (low, high) = own or self.sensor(t_s), self._box(actor)
        other = carried(self._scene, actor, t_s, 0.5 * (low + high), np.eye(3))
        apart = other.position_m - own.position_m
        swing = own.yaw_rate_rad_s * np.array([-apart[1], apart[0], 0.0])
        place = own.rotation.T @ apart
        velocity = own.rotation.T @ (other.velocity_m_s - own.velocity_m_s - swing)
        forward = own.rotation.T @ other.rotation[:, 0]
        size = high - low
        return TruthObject(
            actor=self._scene.actors[actor],
            position_m=(float(place[0]), float(place[1]), float(place[2])),
            velocity_m_s=(float(velocity[0]), float(velocity[1]), float(velocity[2])),
            size_m=(float(size[0]), float(size[1]), float(size[2])),
            yaw_rad=float(np.arctan2(forward[1], forward[0])),
            visible_share=0.0,
        )
