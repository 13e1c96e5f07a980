"""Adaptive bundles: cells of every beam, split where the scene changes between neighbours, with what they met.

Belongs here: casting for cells and the label that says whether two cells see the same plane. Not: the cells themselves
(physics.adaptive).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from emulator.physics import adaptive, beams
from emulator.physics.arrays import Floats, Ints, indexes
from emulator.sensing.contracts import Caster, Hits
from emulator.sensing.model import SensorModel
from emulator.sensing.rays import Rays, turned
from emulator.world.motion import Pose
from protocols.scan import ScanPlan

START_LEVEL = 3
"64 cells a beam: as fine as the default spiral."
SAME_NORMAL = 1e-4
SAME_PLANE_M = 1e-3
"Cells whose planes agree to this see the same facet."
COLUMNS = ("range_m", "body", "actor", "material", "normal", "cosine", "inner")


@dataclass(frozen=True, eq=False)
class CellHits:
    """What the rays of cells met."""

    range_m: Floats
    body: NDArray[np.int32]
    actor: NDArray[np.int32]
    material: NDArray[np.int32]
    normal: Floats
    cosine: Floats
    inner: NDArray[np.bool_]
    "Met from inside of a closed shell."

    def normals(self, rays: Ints) -> Floats:
        """(k, 3) of some rays."""
        return self.normal[rays]

    def bodies(self, rays: Ints) -> Ints:
        """(k,) of some rays."""
        return self.body[rays].astype(np.int64)

    @classmethod
    def of(cls, hits: Hits) -> CellHits:
        """The columns that are needed here."""
        return cls(*(getattr(hits, name) for name in COLUMNS))

    def taken(self, rays: Ints) -> CellHits:
        """Those of some rays."""
        return CellHits(*(getattr(self, name)[rays] for name in COLUMNS))

    def renewed(self, parent: Ints, index: Ints, hits: Hits) -> CellHits:
        """Those of the parents, with new hits at `index`."""
        columns = []
        for name in COLUMNS:
            column = getattr(self, name)[parent]
            column[index] = getattr(hits, name)
            columns.append(column)
        return CellHits(*columns)


def adaptive_rays(plan: ScanPlan, pose: Pose, t_s: Floats, caster: Caster, model: SensorModel) -> tuple[Rays, CellHits]:
    """Rays through the cells of every beam, after splitting, and what they met."""
    cells = adaptive.start(len(plan), START_LEVEL)
    rays = _rays(cells, plan, pose, t_s, model)
    hits = CellHits.of(caster.first_hits(rays.origin_m, rays.direction, rays.t_s))
    for _ in range(model.depth):
        chosen = adaptive.differing(cells, _planes(rays, hits))
        chosen = adaptive.worthwhile(cells, chosen, model.beam.profile)
        if not bool(chosen.any()):
            break
        parent = adaptive.parents(cells, chosen)
        cells = adaptive.split(cells, chosen)
        rays = _rays(cells, plan, pose, t_s, model)
        new = indexes(chosen[parent])
        found = caster.first_hits(rays.origin_m[new], rays.direction[new], rays.t_s[new])
        hits = hits.renewed(parent, new, found)
    return rays, hits


def _rays(cells: adaptive.Cells, plan: ScanPlan, pose: Pose, t_s: Floats, model: SensorModel) -> Rays:
    beam, share = cells.beam, cells.shares(model.beam.profile)
    u, v = cells.nodes(model.beam.profile)
    nodes = beams.Bundle(u[:, None], v[:, None], share[:, None])
    azimuth, elevation = plan.azimuth_rad[beam], plan.elevation_rad[beam]
    direction, start = beams.spread(nodes, model.beam, azimuth, elevation, np.zeros(len(beam)))
    rotation = pose.rotation if pose.rotation.strides[0] == 0 else pose.rotation[beam]
    origin = pose.position_m[beam]
    if model.beam.exit_radius_m > 0.0:
        origin = origin + turned(rotation, start)[:, 0, :]
    axis = beams.axis_directions(plan.azimuth_rad, plan.elevation_rad)
    off = u * u + v * v
    # sorted by beam: the cell nearest to the axis is the first of the least distances
    order = np.lexsort((off, beam))
    first = beam.searchsorted(np.arange(len(plan)))
    return Rays(
        origin_m=origin,
        direction=turned(rotation, direction)[:, 0, :],
        t_s=t_s[beam],
        beam=beam,
        share=share,
        nearest_axis=order[first],
        centre_m=pose.position_m,
        axis=turned(pose.rotation, axis[:, None, :])[:, 0, :],
        own_axis=axis,
    )


def _planes(rays: Rays, hits: CellHits) -> Ints:
    """A number for the plane of a body that each ray met; -1 for a miss."""
    met = hits.body >= 0
    range_m = np.where(met, hits.range_m, 0.0)
    point = rays.origin_m - rays.centre_m[rays.beam] + range_m[:, None] * rays.direction
    offset = np.rint(np.einsum("ij,ij->i", point, hits.normal) / SAME_PLANE_M).astype(np.int64)
    key = hits.body.astype(np.int64)
    for column in (*np.rint(hits.normal / SAME_NORMAL).astype(np.int64).T, offset):
        key = key * 1_000_003 + column  # wraps around; equal planes stay equal
    return np.where(met, key, -1)
