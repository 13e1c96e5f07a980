"""Rays to bright faces: where in a beam they lie, from there into the world, and how far the face is on each.

Belongs here: rays on rings over a face, rays of a beam's own bundle that go to one. Not: what these rays meet, and what
comes back on them (bright).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from types import ModuleType

import numpy as np

from emulator.compiled.pair import by_loops
from emulator.physics import beams, polygons
from emulator.physics.arrays import Bools, Floats, Ints, indexes
from emulator.sensing.rays import Bundles
from emulator.sensing.sheets import Faced, Frames, across_own

MIDDLE = 0.5
"Of a face's light for the ray to its middle, where nothing hides it."


@dataclass(frozen=True, eq=False)
class Nodes:
    """Places in beams where faces are."""

    pair: Ints
    u: Floats
    v: Floats
    weight: Floats


@dataclass(frozen=True, eq=False)
class Ways:
    """Rays to such places."""

    pair: Ints
    weight: Floats
    origin_m: Floats
    ray: Floats
    range_m: Floats
    open: Bools
    "Nothing stands before the face, and it is within reach."

    def __len__(self) -> int:
        return len(self.pair)

    def taken(self, at: Ints) -> Ways:
        """Some of them."""
        return Ways(*(column[at] for column in vars(self).values()))

    @classmethod
    def joined(cls, one: Ways, other: Ways) -> Ways:
        """Both."""
        return cls(*(np.concatenate(both) for both in zip(vars(one).values(), vars(other).values(), strict=True)))


def _ways(faced: Faced, nodes: Nodes, frames: Frames) -> Ways:
    """Rays in the world up to the faces' planes, whatever stands before them."""
    range_m = faced.range_m(nodes.pair, nodes.u, nodes.v, frames.shape)
    origin, ray = frames.rays(faced.beam[nodes.pair], faced.across[nodes.pair], nodes.u, nodes.v)
    return Ways(nodes.pair, nodes.weight, origin, ray, range_m, range_m > 0.0)


def _into_world(faced: Faced, frames: Frames) -> tuple[Floats, Floats, Ints, Floats, Floats, Floats]:
    """What loops need for it: tangents and radius at the pupil, then of the beams, then of the faces."""
    shape = frames.shape
    law = np.array([math.tan(shape.half_angle_x_rad), math.tan(shape.half_angle_y_rad), shape.exit_radius_m])
    return law, frames.pose.position_m, faced.beam, faced.across, faced.normal, faced.behind_m


# ---------------------------------------------------------------- rings
@lru_cache(maxsize=8)
def _grid(step: float, count: int, farthest: int) -> tuple[Floats, Floats, Floats, Floats]:
    """Rings up to so many beam radii: radius, light of each node; (rings, count) u and v. Not to be written to."""
    edge = np.arange(0.0, farthest + step, step)
    radius = 0.5 * (edge[1:] + edge[:-1])
    light = np.exp(-2.0 * edge[:-1] ** 2) - np.exp(-2.0 * edge[1:] ** 2)
    turn = 2.0 * np.pi / count * (np.arange(count) + beams.GOLDEN_ANGLE_RAD * np.arange(len(radius))[:, None])
    return radius, light / count, radius[:, None] * np.cos(turn), radius[:, None] * np.sin(turn)


def _on_rings_by_loops(
    loops: ModuleType, faced: Faced, frames: Frames, step: float, count: int, outer: Floats, pairs: Ints,
    middle: Floats | None,
) -> Ways:  # fmt: skip
    grid = _grid(step, count, math.ceil(outer.max(initial=0.0)))
    at = np.zeros((0, 2)) if middle is None else middle
    near, far = faced.offset - step, outer + 0.5 * step
    pair, sizes, origin, ray = loops.on_rings(
        pairs, at, near, far, *grid, faced.corner, *_into_world(faced, frames), MIDDLE / (1.0 - MIDDLE)
    )
    return Ways(pair, sizes[0], origin, ray, sizes[1], sizes[1] > 0.0)


@by_loops(_on_rings_by_loops, "on_rings")
def on_rings(
    faced: Faced, frames: Frames, step: float, count: int, outer: Floats, pairs: Ints, middle: Floats | None
) -> Ways:
    """Rays on rings that fall on faces, weighted by the light on their cells; from a face's nearest place outwards.

    Parameters
    ----------
    step, count : between rings, in beam radii; rays on each
    outer : (k,) how far the rings of each face go, in beam radii
    pairs : which faces
    middle : (k, 2) in beam radii; all faces then have one more ray, to the middle of their light, first. None: not
    """
    radius, light, u, v = _grid(step, count, math.ceil(outer[pairs].max(initial=0.0)))
    u, v = u.ravel(), v.ravel()
    ring, place = np.repeat(radius, count), np.stack([u, v], axis=1)[None]
    # as far as the rings would go for this face alone: what it brings back does not depend on the others
    near, far = (faced.offset[pairs] - step)[:, None], (outer[pairs] + 0.5 * step)[:, None]
    row, node = np.nonzero((ring >= near) & (ring < far) & polygons.within(faced.corner[pairs], place))
    nodes = Nodes(pairs[row], u[node], v[node], np.repeat(light, count)[node])
    return _ways(faced, nodes if middle is None else _with_middle(nodes, middle), frames)


def _with_middle(nodes: Nodes, middle: Floats) -> Nodes:
    """And one in the middle of each face's light."""
    pairs = len(middle)
    rest = np.bincount(nodes.pair, nodes.weight, pairs)
    weight = np.where(rest > 0.0, rest * (MIDDLE / (1.0 - MIDDLE)), 1.0)
    return Nodes(
        np.concatenate([np.arange(pairs), nodes.pair]), np.concatenate([middle[:, 0], nodes.u]),
        np.concatenate([middle[:, 1], nodes.v]), np.concatenate([weight, nodes.weight]),
    )  # fmt: skip


# ---------------------------------------------------------------- bundles
def _reach(bundles: Bundles, frames: Frames) -> float:
    """Where the outermost ray of these bundles goes, in beam radii, and a little more; infinite: not known."""
    shape = frames.shape
    narrow = min(shape.half_angle_x_rad, shape.half_angle_y_rad)
    if narrow < beams.NO_WIDTH or not len(bundles.axis):
        return math.inf
    along = np.minimum(bundles.direction[0] @ bundles.axis[0], 1.0).min()
    return 1.01 * math.tan(math.acos(float(along))) / math.tan(narrow)


def of_bundles(faced: Faced, bundles: Bundles, some: Bools, frames: Frames) -> Ways:
    """Rays of the beams' own bundles that go to `some` (k,) of these faces, whatever stands before them."""
    return _bundled(faced, bundles, indexes(some & (faced.offset <= _reach(bundles, frames))), frames)


def _has_width(frames: Frames) -> bool:
    """Its rays are known by their directions; else by where they start."""
    return frames.shape.half_angle_x_rad >= beams.NO_WIDTH and frames.shape.half_angle_y_rad >= beams.NO_WIDTH


def _bundled_by_loops(loops: ModuleType, faced: Faced, bundles: Bundles, inner: Ints, frames: Frames) -> Ways:
    shape, wide = frames.shape, _has_width(frames)
    spread = bundles.direction if wide else bundles.start_m
    assert spread is not None
    roll = np.array([math.cos(shape.roll_rad), math.sin(shape.roll_rad)])
    pair, sizes, origin, ray = loops.bundled(
        inner,
        faced.corner,
        bundles.axis,
        spread[faced.beam[inner]],
        wide,
        bundles.share,
        roll,
        *_into_world(faced, frames),
    )
    return Ways(pair, sizes[0], origin, ray, sizes[1], sizes[1] > 0.0)


@by_loops(_bundled_by_loops, "bundled")
def _bundled(faced: Faced, bundles: Bundles, inner: Ints, frames: Frames) -> Ways:
    """The same of the faces `inner`."""
    shape = frames.shape
    if not len(inner):
        return _ways(faced, Nodes(inner, np.zeros(0), np.zeros(0), np.zeros(0)), frames)
    beam, row = np.unique(faced.beam[inner], return_inverse=True)
    across = across_own(bundles.axis[beam], shape)
    if _has_width(frames):
        own = np.einsum("nmj,nij->nmi", bundles.direction[beam], across)
        scale = np.array([math.tan(shape.half_angle_x_rad), math.tan(shape.half_angle_y_rad)])
        place = own[:, :, :2] / np.maximum(own[:, :, 2:], 1e-9) / scale
    else:
        assert bundles.start_m is not None
        place = np.einsum("nmj,nij->nmi", bundles.start_m[beam], across)[:, :, :2] / shape.exit_radius_m
    pair, node = np.nonzero(polygons.within(faced.corner[inner], place[row]))
    spot = place[row[pair], node]
    return _ways(faced, Nodes(inner[pair], spot[:, 0], spot[:, 1], bundles.share[node]), frames)
