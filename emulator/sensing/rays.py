"""The rays of a sweep: every beam's sub-beams in the world, each leaving at its own instant.

Belongs here: bundles by rule, directions in the sensor's frame (kept from sweep to sweep while the plan's angles stay
the same), and their turning into the world. Not: what they hit.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, replace

import numpy as np

from emulator.motion import Pose
from emulator.physics import beams
from emulator.physics.arrays import Floats, Ints
from emulator.sensing.model import SensorModel
from protocols.scan import ScanPlan

KEPT_PLANS = 8
"Different sets of angles remembered: a device switches between a handful (interlaced turns, sub-ranges)."


@dataclass(frozen=True, eq=False)
class Bundles:
    """Sub-beams of all beams of a plan, in the sensor's frame: m of them to each of n beams."""

    axis: Floats
    "(n, 3) unit vectors."
    direction: Floats
    "(n, m, 3) unit vectors."
    start_m: Floats | None
    "(n, m, 3) on the exit pupil; None: all from the optical centre."
    share: Floats
    "(m,) of the beam's power."
    beam: Ints
    "(n m,) of each sub-beam, flat."
    flat_share: Floats
    "(n m,)"
    nearest_axis: Ints
    "(n,) flat index of each beam's sub-beam nearest to its axis."

    @property
    def sub_beams(self) -> int:
        return len(self.share)


@dataclass(frozen=True, eq=False)
class Rays:
    """The same in the world, flat."""

    origin_m: Floats
    "(n m, 3)"
    direction: Floats
    "(n m, 3)"
    t_s: Floats
    "(n m,)"
    beam: Ints
    "(n m,) ascending."
    share: Floats
    "(n m,) of the beam's power."
    nearest_axis: Ints
    "(n,) the ray of each beam that is nearest to its axis."
    centre_m: Floats
    "(n, 3) optical centre at each beam's instant."
    axis: Floats
    "(n, 3)"
    own_axis: Floats
    "(n, 3) in the sensor's frame."

    def at(self, t_s: Floats) -> Rays:
        """The same rays, cast at other instants (n,) by a sensor at rest."""
        return replace(self, t_s=t_s[self.beam])


class BundleCache:
    """Bundles of the last few plans' angles."""

    def __init__(self, model: SensorModel) -> None:
        self._model = model
        rule = "axis" if model.beam.is_ray else "spiral" if model.rule == "adaptive" else model.rule
        self._nodes = beams.bundle(rule, model.sub_beams, model.beam.profile)
        self._kept: OrderedDict[tuple[bytes, bytes], Bundles] = OrderedDict()

    def of(self, plan: ScanPlan) -> Bundles:
        """Bundles for the plan's angles."""
        key = plan.azimuth_rad.tobytes(), plan.elevation_rad.tobytes()
        found = self._kept.get(key)
        if found is None:
            found = self._spread(plan.azimuth_rad, plan.elevation_rad)
            self._kept[key] = found
            if len(self._kept) > KEPT_PLANS:
                self._kept.popitem(last=False)
        else:
            self._kept.move_to_end(key)
        return found

    def _spread(self, azimuth_rad: Floats, elevation_rad: Floats) -> Bundles:
        axis = beams.axis_directions(azimuth_rad, elevation_rad)
        nodes, n, m = self._nodes, len(axis), len(self._nodes)
        first = int(np.argmin(nodes.u**2 + nodes.v**2))
        flat = np.arange(n).repeat(m), np.tile(nodes.share, n), np.arange(n) * m + first
        if m == 1:
            return Bundles(axis, axis[:, None, :], None, nodes.share, *flat)
        direction, start_m = beams.spread(nodes, self._model.beam, azimuth_rad, elevation_rad)
        has_width = self._model.beam.exit_radius_m > 0.0
        return Bundles(axis, direction, start_m if has_width else None, nodes.share, *flat)


def cast_rays(bundles: Bundles, pose: Pose, t_s: Floats) -> Rays:
    """Rays in the world: `pose` of the sensor at the instants `t_s` (n,) of the beams."""
    n, m = len(t_s), bundles.sub_beams
    direction = turned(pose.rotation, bundles.direction)
    axis = direction[:, 0, :] if m == 1 else turned(pose.rotation, bundles.axis[:, None, :])[:, 0, :]
    if bundles.start_m is None:
        origin = np.broadcast_to(pose.position_m[:, None, :], (n, m, 3))
    else:
        origin = pose.position_m[:, None, :] + turned(pose.rotation, bundles.start_m)
    return Rays(
        origin_m=np.ascontiguousarray(origin).reshape(n * m, 3),
        direction=direction.reshape(n * m, 3),
        t_s=t_s.repeat(m),
        beam=bundles.beam,
        share=bundles.flat_share,
        nearest_axis=bundles.nearest_axis,
        centre_m=pose.position_m,
        axis=axis,
        own_axis=bundles.axis,
    )


def turned(rotation: Floats, vectors: Floats) -> Floats:
    """Vectors (n, m, 3) turned by rotations (n or more, 3, 3), at once where all rotations are the same."""
    first = rotation[0] if len(rotation) else np.eye(3)
    if rotation.strides[0] == 0 or bool((rotation == first).all()):
        return rotated(first, vectors.reshape(-1, 3)).reshape(vectors.shape)
    return np.asarray(vectors @ rotation.transpose(0, 2, 1))


def rotated(rotation: Floats, vectors: Floats) -> Floats:
    """Vectors (k, 3) turned by one rotation (3, 3), by columns.

    A matrix product of so flat a shape goes to a threaded library, whose threads wait for each other: a hundred times
    slower at 176 000 rays on a busy machine.
    """
    out = np.zeros_like(vectors)
    for row, into in zip(rotation, out.T, strict=True):
        for weight, column in zip(row, vectors.T, strict=True):
            if weight != 0.0:
                into += weight * column
    return out
