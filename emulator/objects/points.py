"""Echoes of scans as points in the frame of the sensor that lists the objects.

Belongs here: geometry of a scan and the motion of the listing sensor. Not: which points belong together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from protocols.scan import Scan
from protocols.scan import points_of as in_frame

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


def _identity() -> Floats:
    return np.eye(3)


@dataclass(frozen=True, eq=False)
class View:
    """A scan, and where its sensor is in the frame of the sensor that lists the objects."""

    scan: Scan
    position_m: Floats = field(default_factory=lambda: np.zeros(3))
    "(3,)"
    rotation: Floats = field(default_factory=_identity)
    "(3, 3) from the scanning to the listing sensor."


@dataclass(frozen=True)
class SensorMotion:
    """Where the listing sensor is in the world, and how it moves; tracks are kept in the world's frame."""

    x_m: float = 0.0
    y_m: float = 0.0
    yaw_rad: float = 0.0
    vx_m_s: float = 0.0
    "In the world's frame."
    vy_m_s: float = 0.0
    yaw_rate_rad_s: float = 0.0

    def to_world(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Points of the sensor's frame in the world's."""
        c, s = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        return c * x - s * y + self.x_m, s * x + c * y + self.y_m

    def to_sensor(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Points of the world's frame in the sensor's."""
        dx, dy = x - self.x_m, y - self.y_m
        return self.turn(dx, dy)

    def turn(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Directions of the world's frame in the sensor's."""
        c, s = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        return c * x + s * y, c * y - s * x

    def straightened(self, points: Points, t_s: float) -> Points:
        """Points as the sensor would have seen them at `t_s`: its own motion since each echo is taken out."""
        if not (self.vx_m_s or self.vy_m_s or self.yaw_rate_rad_s):
            return points
        since = t_s - points.t_s
        yaw = self.yaw_rad - self.yaw_rate_rad_s * since
        c, s = np.cos(yaw), np.sin(yaw)
        x = c * points.x_m - s * points.y_m + self.x_m - self.vx_m_s * since
        y = s * points.x_m + c * points.y_m + self.y_m - self.vy_m_s * since
        x_m, y_m = self.to_sensor(x, y)
        return replace(points, x_m=x_m, y_m=y_m)

    def relative_velocity(self, x: Floats, y: Floats, vx: Floats, vy: Floats) -> tuple[Floats, Floats]:
        """Velocities over ground of world points as the sensor sees them: its own motion and turning taken away."""
        dx, dy = x - self.x_m, y - self.y_m
        return self.turn(
            vx - self.vx_m_s + self.yaw_rate_rad_s * dy,
            vy - self.vy_m_s - self.yaw_rate_rad_s * dx,
        )


@dataclass(frozen=True, eq=False)
class Points:
    """n echoes; the frame is the listing sensor's."""

    x_m: Floats
    y_m: Floats
    z_m: Floats
    range_m: Floats
    "From the sensor that measured it."
    t_s: Floats
    intensity: Floats
    actor: Integers
    step_rad: Floats
    "Angle between neighbouring beams of the scan it comes from."

    def __len__(self) -> int:
        return len(self.x_m)

    def take(self, index: NDArray[np.bool_] | Integers) -> Points:
        """The points at `index`."""
        return Points(
            self.x_m[index],
            self.y_m[index],
            self.z_m[index],
            self.range_m[index],
            self.t_s[index],
            self.intensity[index],
            self.actor[index],
            self.step_rad[index],
        )


def beam_step_rad(azimuth_rad: Floats) -> float:
    """Usual angle between neighbouring directions of a scan; 0 for a single one."""
    directions = np.unique(np.round(azimuth_rad, 6))
    return float(np.median(np.diff(directions))) if len(directions) > 1 else 0.0


def points_of(view: View, height_m: tuple[float, float]) -> Points:
    """All echoes of a scan that lie within the height band."""
    scan, plan = view.scan, view.scan.plan
    beam, echo = np.nonzero(np.isfinite(scan.range_m))
    range_m = scan.range_m[beam, echo]
    origin = None if plan.origin_m is None else plan.origin_m[beam]
    own = in_frame(plan.azimuth_rad[beam], plan.elevation_rad[beam], range_m, origin)
    place = view.position_m + own @ view.rotation.T
    points = Points(
        x_m=place[:, 0],
        y_m=place[:, 1],
        z_m=place[:, 2],
        range_m=range_m,
        t_s=plan.start_ns * 1e-9 + plan.fire_offset_s[beam],
        intensity=scan.intensity[beam, echo],
        actor=scan.actor[beam, echo].astype(np.int64),
        step_rad=np.full(len(beam), beam_step_rad(plan.azimuth_rad)),
    )
    low, high = height_m
    return points if low == -np.inf and high == np.inf else points.take((points.z_m >= low) & (points.z_m <= high))


def joined(parts: Sequence[Points]) -> Points:
    """Points of several scans as one set."""
    if len(parts) == 1:
        return parts[0]
    empty = np.zeros(0)
    if not parts:
        return Points(empty, empty, empty, empty, empty, empty, np.zeros(0, dtype=np.int64), empty)
    return Points(
        *(
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("x_m", "y_m", "z_m", "range_m", "t_s", "intensity", "actor", "step_rad")
        )
    )
