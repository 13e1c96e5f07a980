"""Embree's structures and searches in float32, and what they find in float64; with deforming the only user of embreex.

Belongs here: building, one search for many rays, distances recomputed from planes. Not: which rays are searched where
(raycast, moving_cast).
"""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType
from typing import Any, TypeAlias

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from emulator.casting.hits import Counters
from emulator.casting.structures import Content, Table
from emulator.compiled.pair import OTHERWISE, by_loops
from emulator.world.batched_poses import Flags, Longs
from emulator.world.triangles import Floats, Ints

Singles = NDArray[np.float32]
Structure: TypeAlias = Any
"Of embreex, or for packets of rays where loops are compiled."

SUSPICIOUS = 1e-3
"Refined and float32 distance differ by more than this times (1 + distance): the plane is not to be trusted."


def _packets(loops: ModuleType, content: Content) -> Structure:
    return OTHERWISE if loops.library() is None else loops.Packets(content.vertices, content.faces)


@by_loops(_packets, "library", "Packets")
def structure(content: Content) -> Structure:
    """A search structure over triangles, built."""
    made = EmbreeScene(robust=True)  # without it 8 % of rays aimed at shared edges slip through
    TriangleMesh(made, content.vertices, content.faces)
    run(made, np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32), np.ones(1, np.float32))  # builds it
    return made


def in_packets(made: Sequence[Structure]) -> bool:
    """These structures, all of the same kind, are for packets of rays."""
    return bool(made) and not isinstance(made[0], EmbreeScene)


def run(made: Structure, origin: Singles, ray: Singles, until: Singles) -> tuple[Ints, Singles]:
    """Triangle (-1: none) and distance of each ray's first hit; `until` is overwritten."""
    if isinstance(made, EmbreeScene):
        answer = made.run(origin, ray, dists=until, output=1)
        return answer["primID"], answer["tfar"]
    triangle, distance = made.run(origin, ray, until)
    return triangle, distance


def refined(
    table: Table,
    counters: Counters,
    triangle: Longs,
    origin: Floats,
    ray: Floats,
    distance: NDArray[np.floating],
    hit: Flags | None = None,
) -> tuple[Floats, Floats, Floats]:
    """Distance to the plane of each triangle, its normal and normal . ray, all in float64; misses as they come."""
    plane = table.plane.take(triangle, axis=0, mode="wrap").T
    normal = plane[:3]
    facing = np.einsum("ik,ik->k", normal, ray)
    with np.errstate(divide="ignore", invalid="ignore"):
        range_m = np.einsum("ik,ik->k", normal, origin)
        np.subtract(plane[3], range_m, out=range_m)
        range_m /= facing
        good = np.abs(range_m - distance) <= SUSPICIOUS * (1.0 + distance)
    if hit is not None:
        good |= ~hit
    if not good.all():
        counters.suspicious += int(len(good) - np.count_nonzero(good))
        range_m = np.where(good, range_m, distance)
    np.maximum(range_m, 0.0, out=range_m)  # a surface that the ray begins on may lie a hair behind
    return range_m, normal, facing
