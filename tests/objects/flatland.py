"""A flat world of boxes, scanned by geometry alone: what trackers are tested with. No noise unless asked for.

Rays meet rectangles; the nearest hit counts. Every hit knows its actor, as scans of the emulator do.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from emulator.objects.points import SensorMotion, View
from protocols.scan import Scan, ScanPlan

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Box:
    """A rectangle that moves straight on."""

    actor: int
    x_m: float
    y_m: float
    length_m: float = 4.4
    width_m: float = 1.8
    yaw_rad: float = 0.0
    vx_m_s: float = 0.0
    vy_m_s: float = 0.0

    def at(self, t_s: float) -> Box:
        return replace(self, x_m=self.x_m + self.vx_m_s * t_s, y_m=self.y_m + self.vy_m_s * t_s)


def plan_of(beams: int, field_rad: float, t_s: float, sweep: int = 0, scan_s: float = 0.0) -> ScanPlan:
    azimuth = np.linspace(-0.5 * field_rad, 0.5 * field_rad, beams)
    return ScanPlan(
        epoch=0,
        sweep=sweep,
        start_ns=round(t_s * 1e9),
        azimuth_rad=azimuth,
        elevation_rad=np.zeros(beams),
        fire_offset_s=np.linspace(0.0, scan_s, beams),
        duration_s=scan_s,
    )


def look(
    boxes: Sequence[Box],
    t_s: float,
    *,
    beams: int = 721,
    field_rad: float = math.pi,
    reach_m: float = 100.0,
    noise_m: float = 0.0,
    rng: np.random.Generator | None = None,
    motion: SensorMotion | None = None,
) -> View:
    """One scan of the boxes as they are at `t_s`, by a sensor at the origin or moving as told."""
    motion = motion or SensorMotion()
    plan = plan_of(beams, field_rad, t_s)
    direction = np.stack([np.cos(plan.azimuth_rad + motion.yaw_rad), np.sin(plan.azimuth_rad + motion.yaw_rad)], -1)
    nearest = np.full(beams, np.inf)
    actor = np.full(beams, -1, dtype=np.int32)
    for box in boxes:
        now = box.at(t_s)
        distance = hits(now, direction, motion.x_m, motion.y_m)
        closer = distance < nearest
        nearest[closer], actor[closer] = distance[closer], box.actor
    nearest[nearest > reach_m] = np.nan
    actor[np.isnan(nearest)] = -1
    if noise_m and rng is not None:
        nearest = nearest + rng.normal(0.0, noise_m, beams)
    scan = Scan.empty(plan)
    intensity = np.where(np.isnan(nearest), np.nan, (reach_m / np.nan_to_num(nearest, nan=1.0)) ** 2)
    return View(replace(scan, range_m=nearest[:, None], intensity=intensity[:, None], actor=actor[:, None]))


def hits(box: Box, direction: Floats, x_m: float, y_m: float) -> Floats:
    """(n,) distance of each ray's first meeting with a rectangle, inf without one."""
    c, s = math.cos(box.yaw_rad), math.sin(box.yaw_rad)
    dx, dy = x_m - box.x_m, y_m - box.y_m
    start = np.array([c * dx + s * dy, c * dy - s * dx])
    turned = np.stack([c * direction[:, 0] + s * direction[:, 1], c * direction[:, 1] - s * direction[:, 0]], -1)
    half = 0.5 * np.array([box.length_m, box.width_m])
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        one, other = (-half - start) / turned, (half - start) / turned
    enter = np.fmin(one, other).max(axis=1)
    leave = np.fmax(one, other).min(axis=1)
    return np.where((enter <= leave) & (enter > 0.0), enter, np.inf)
