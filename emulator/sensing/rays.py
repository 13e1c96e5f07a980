"""The rays of a sweep: every beam's sub-beams in the world, each leaving at its own instant.

Belongs here: bundles by rule, directions in the sensor's frame (kept from sweep to sweep while the plan's angles stay
the same), and their turning into the world. Not: what they hit.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from emulator.compiled.switch import kernels
from emulator.physics import beams
from emulator.physics.arrays import Floats, Ints
from emulator.sensing.model import SensorModel
from emulator.world.motion import Pose
from protocols.scan import ScanPlan

KEPT_PLANS = 8
"Different sets of angles remembered: a device switches between a handful (interlaced turns, sub-ranges)."
RAYS_KEPT = 400_000
"Of a sensor, over all its sets of angles."
SHARED_RAYS = 50_000
"Of a set of angles at the most, to be kept from run to run."
TILE = 1024
"Rays that are put in order together: a part of the blocks that the caster takes."


SIDELOBE_RAYS = 256
"Rays of a beam's sidelobes: a plate a tenth of their width across then has some twenty in the middle."


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

    @cached_property
    def order(self) -> Ints:
        """(n m,) in which they are best searched for, see `in_bands`."""
        return in_bands(self.axis, self.direction)


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
    steady: bool = False
    "`direction` is the array of an earlier sweep."
    order: Ints | None = None
    "(n m,) of the bundles; None: as they come."

    def at(self, t_s: Floats) -> Rays:
        """The same rays, cast at other instants (n,) by a sensor at rest."""
        return replace(self, t_s=t_s[self.beam])


@dataclass(frozen=True, eq=False)
class Turned:
    """Bundles turned into the world: the same ones as long as the sensor does not turn, wherever it drives."""

    bundles: Bundles
    rotation: Floats
    "(n, 3, 3)"
    direction: Floats
    "(n m, 3), not to be written to."
    axis: Floats
    "(n, 3)"
    start_m: Floats | None
    "(n m, 3) on the exit pupil, from its centre."

    @classmethod
    def of(cls, bundles: Bundles, rotation: Floats) -> Turned:
        """By a rotation of each beam."""
        n, m = len(rotation), bundles.sub_beams
        direction = turned(rotation, bundles.direction)
        axis = direction[:, 0, :] if m == 1 else turned(rotation, bundles.axis[:, None, :])[:, 0, :]
        direction.flags.writeable = False
        start = None if bundles.start_m is None else turned(rotation, bundles.start_m).reshape(n * m, 3)
        return cls(bundles, rotation, direction.reshape(n * m, 3), axis, start)


class BundleCache:
    """Bundles of the last few plans' angles."""

    def __init__(self, model: SensorModel) -> None:
        self._model = model
        rule = "axis" if model.beam.is_ray else "spiral" if model.rule == "adaptive" else model.rule
        self._nodes = beams.together(beams.bundle(rule, model.sub_beams, model.beam.profile))
        self._core = self._nodes
        if model.sidelobe_share > 0.0 and not model.beam.is_ray:
            self._nodes = _with_sidelobes(self._nodes, model)
        self._kept: OrderedDict[tuple[bytes, bytes], Bundles] = OrderedDict()
        self._turned: tuple[Turned, ...] = ()
        self.again = False
        "The bundles asked for last had been asked for before: what takes long to find out of them is worth it."

    @property
    def nodes(self) -> beams.Bundle:
        """Of each beam."""
        return self._nodes

    @property
    def sub_beams(self) -> int:
        """Of each beam."""
        return len(self._nodes)

    @property
    def radius(self) -> float:
        """Where the outermost sub-beam goes, in beam radii, sidelobes aside."""
        return float(np.sqrt((self._core.u**2 + self._core.v**2).max()))

    def turned(self, bundles: Bundles, rotation: Floats) -> tuple[Turned, bool]:
        """Bundles turned by rotations (n, 3, 3), and whether they are those of an earlier sweep."""
        for one in self._turned:
            if one.bundles is bundles and _same(one.rotation, rotation):
                return one, True
        made = Turned.of(bundles, rotation)
        kept = [made, *(one for one in self._turned if one.bundles is not bundles)][:KEPT_PLANS]
        while len(kept) > 1 and sum(len(one.direction) for one in kept) > RAYS_KEPT:
            kept.pop()
        self._turned = tuple(kept)
        return made, False

    def of(self, plan: ScanPlan) -> Bundles:
        """Bundles for the plan's angles."""
        key = plan.azimuth_rad.tobytes(), plan.elevation_rad.tobytes()
        found = self._kept.get(key)
        self.again = found is not None
        if found is None:
            found = self._spread(plan.azimuth_rad, plan.elevation_rad)
            self._kept[key] = found
            if len(self._kept) > KEPT_PLANS:
                self._kept.popitem(last=False)
        else:
            self._kept.move_to_end(key)
        return found

    def part(self, plan: ScanPlan, at: Ints) -> Bundles:
        """Bundles of some of the plan's beams, numbered again; not kept."""
        return self._spread(plan.azimuth_rad[at], plan.elevation_rad[at], beams.beam_phase(at))

    def _spread(self, azimuth_rad: Floats, elevation_rad: Floats, phase_rad: Floats | None = None) -> Bundles:
        nodes, shape = self._nodes, self._model.beam
        if phase_rad is not None or len(azimuth_rad) * len(nodes) > SHARED_RAYS:
            return _spread(nodes, shape, azimuth_rad, elevation_rad, phase_rad)
        columns = nodes.u, nodes.v, nodes.share, azimuth_rad, elevation_rad
        return _shared(shape, *(np.ascontiguousarray(one, np.float64).tobytes() for one in columns))


@lru_cache(maxsize=8)
def _shared(shape: beams.BeamShape, u: bytes, v: bytes, share: bytes, azimuth: bytes, elevation: bytes) -> Bundles:
    """For a process that runs many scenarios with the same sensor, one after the other."""
    nodes = beams.Bundle(np.frombuffer(u), np.frombuffer(v), np.frombuffer(share))
    return _spread(nodes, shape, np.frombuffer(azimuth), np.frombuffer(elevation), None)


def _spread(
    nodes: beams.Bundle, shape: beams.BeamShape, azimuth_rad: Floats, elevation_rad: Floats, phase_rad: Floats | None
) -> Bundles:
    axis = beams.axis_directions(azimuth_rad, elevation_rad)
    n, m = len(axis), len(nodes)
    first = int(np.argmin(nodes.u**2 + nodes.v**2))
    flat = np.arange(n).repeat(m), np.tile(nodes.share, n), np.arange(n) * m + first
    if m == 1:
        return Bundles(axis, axis[:, None, :], None, nodes.share, *flat)
    direction, start_m = beams.spread(nodes, shape, azimuth_rad, elevation_rad, phase_rad)
    return Bundles(axis, direction, start_m if shape.exit_radius_m > 0.0 else None, nodes.share, *flat)


def _with_sidelobes(core: beams.Bundle, model: SensorModel) -> beams.Bundle:
    """A bundle less a share of its light, which fills a wider Gaussian in equal shares."""
    wide, share = beams.bundle("spiral", SIDELOBE_RAYS, "gauss"), model.sidelobe_share
    half = 0.5 * model.sidelobe_rad
    x, y = (half / max(angle, 1e-9) for angle in (model.beam.half_angle_x_rad, model.beam.half_angle_y_rad))
    return beams.Bundle(
        np.concatenate([core.u, x * wide.u]),
        np.concatenate([core.v, y * wide.v]),
        np.concatenate([(1.0 - share) * core.share, share * wide.share]),
    )


def part_of(bundles: Bundles, at: Ints) -> Bundles:
    """Those of some beams, numbered again."""
    n, m = len(at), bundles.sub_beams
    start = None if bundles.start_m is None else bundles.start_m[at]
    first = int(bundles.nearest_axis[0])
    return Bundles(
        bundles.axis[at], bundles.direction[at], start, bundles.share, np.arange(n).repeat(m),
        np.tile(bundles.share, n), np.arange(n) * m + first,
    )  # fmt: skip


def pose_at(pose: Pose, at: Ints) -> Pose:
    """That of some beams."""
    if pose.rotation.strides[0] == 0:  # one rotation for all
        return Pose(pose.position_m[at], np.broadcast_to(pose.rotation[0], (len(at), 3, 3)))
    return Pose(pose.position_m[at], pose.rotation[at])


def cast_rays(bundles: Bundles, pose: Pose, t_s: Floats) -> Rays:
    """Rays in the world: `pose` of the sensor at the instants `t_s` (n,) of the beams."""
    return rays_of(Turned.of(bundles, pose.rotation), pose.position_m, t_s)


def rays_of(spread: Turned, position_m: Floats, t_s: Floats, steady: bool = False, ordered: bool = False) -> Rays:
    """The same of turned bundles, from the places (n, 3); `ordered`: packets of them are worth their order."""
    bundles = spread.bundles
    m = bundles.sub_beams
    origin, times = position_m.T.repeat(m, axis=1), t_s.repeat(m)
    if spread.start_m is not None:
        origin += spread.start_m.T
    return Rays(
        origin_m=origin.T,
        direction=spread.direction,
        t_s=times,
        beam=bundles.beam,
        share=bundles.flat_share,
        nearest_axis=bundles.nearest_axis,
        centre_m=position_m,
        axis=spread.axis,
        own_axis=bundles.axis,
        steady=steady,
        order=bundles.order if ordered and m > 1 and kernels() is not None else None,
    )


def _same(one: Floats, other: Floats) -> bool:
    """Equal rotations (n, 3, 3), of which one may stand for all."""
    if len(one) and one.shape == other.shape and not (one.strides[0] or other.strides[0]):
        return bool((one[0] == other[0]).all())
    return np.array_equal(one, other)


def in_bands(axis: Floats, direction: Floats) -> Ints:
    """Order of sub-beams (n, m, 3) in which neighbours meet the same: by azimuth, upper and lower halves apart.

    Rays that lie beside each other in one row of a planar scanner share more of a search than those of one beam, whose
    ranges on the ground differ. Some beams at a time, so that what is known of them stays in the processor's cache.
    """
    ray = direction.reshape(-1, 3)
    tile, height = np.arange(len(ray)) // TILE, axis[:, 2].repeat(direction.shape[1])
    return np.lexsort((np.arctan2(ray[:, 1], ray[:, 0]), ray[:, 2] >= height, height, tile))


def turned(rotation: Floats, vectors: Floats) -> Floats:
    """Vectors (n, m, 3) turned by rotations (n or more, 3, 3); each coordinate of the result is one long row.

    A product of matrices of so flat a shape goes to a threaded library, whose threads wait for each other: a hundred
    times slower at 176 000 rays on a busy machine.
    """
    first = rotation[0] if len(rotation) else np.eye(3)
    weights = rotation.transpose(1, 2, 0)[:, :, : len(vectors), None]
    if rotation.strides[0] == 0 or bool((rotation == first).all()):
        weights = first[:, :, None, None]
    out = np.zeros((3, *vectors.shape[:2]))
    for row, into in zip(weights, out, strict=True):
        for number, weight in enumerate(row):
            if weight.any():
                into += weight * vectors[:, :, number]
    return np.asarray(out.transpose(1, 2, 0))


def rotated(rotation: Floats, vectors: Floats) -> Floats:
    """Vectors (k, 3) turned by one rotation (3, 3)."""
    return np.asarray(turned(rotation[None], vectors[None])[0])
