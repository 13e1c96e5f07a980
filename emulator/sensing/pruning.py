"""Sweeps that cast bundles only where beams see more than one plane; the axis ray alone serves the others.

Belongs here: the order of the steps, and what is kept for a sensor at rest. Not: the test of edges (plain), the echoes
of planes (closed), the paths of bundles (paths).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from emulator.physics import beams
from emulator.physics.arrays import Bools, Floats, Ints, indexes
from emulator.physics.subechoes import SubEchoes
from emulator.sensing import closed
from emulator.sensing.adapt import COLUMNS, CellHits
from emulator.sensing.air import AirNow
from emulator.sensing.contracts import FacedCaster, FacedHits
from emulator.sensing.daylight import surfaces_show
from emulator.sensing.model import SensorModel
from emulator.sensing.paths import Seen, Surfaces, reach_of, returned
from emulator.sensing.plain import MOST_PAIRS, Edges, Pieces, sights_of
from emulator.sensing.rays import Bundles, Rays, cast_rays, part_of, pose_at, turned
from emulator.world.motion import Pose
from emulator.world.outlines import outlines_of
from protocols.scan import ScanPlan

if TYPE_CHECKING:
    from emulator.world.scene import Scene

TYPICAL_M = 20.0
EDGES_SHARE = 0.5
"Of the time that could be saved, at most to be spent on looking at edges."
MOST_FACES = 2_000_000
"Of different shapes: finding their edges would take many seconds."
FEWEST = 12
"Bundles of fewer sub-beams cost less than to find out where they are needed."
EDGE_NS, PAIR_NS, RAY_NS = 2_000.0, 300.0, 300.0
"About what an edge with all its beams, a pair of edge and beam, and a ray cost; only their ratios matter."
PROBES = 8
SAME_NORMAL = 1e-8
"One less the cosine of an angle of 1.4e-4."
PROBED_RADII = 1.0
"Where the probing rays go when edges are too many: what slips between them is narrower than 0.77 radii."


@dataclass(frozen=True, eq=False)
class Looked:
    """A sweep of the axes, and which beams are plain."""

    rays: Rays
    hits: FacedHits
    plain: Bools
    cast: int


@dataclass(frozen=True, eq=False)
class Pruned:
    """What came of a sweep."""

    rays: Rays
    "One to each beam."
    seen: Seen
    plain: Bools
    "(n,) beams of which one plane is seen, or nothing."
    cast: int
    "Rays cast."
    shifts: closed.Shifts
    "Of the plain beams that have their echo from the moments of their plane."


def wanted(model: SensorModel, scene: Scene) -> bool:
    """The rule may save something for this sensor in this scene."""
    if model.sidelobe_share > 0.0:  # they see more than one plane
        return False
    if model.prune_bundles == "never" or model.rule in ("adaptive", "axis") or model.beam.is_ray:
        return False
    if any(body.frames is not None for body in scene.bodies):
        return False  # edges of what changes its shape are not followed
    faces = {id(body.geometry): len(body.faces) for body in scene.bodies}
    return sum(faces.values()) <= MOST_FACES and (model.prune_bundles == "always" or thin(model))


def thin(model: SensorModel) -> bool:
    """Planes up to 45 degrees from face-on need no ranges of their bundle at a typical range."""
    beam = model.beam
    width = max(beam.half_angle_x_rad, beam.half_angle_y_rad) * TYPICAL_M + beam.exit_radius_m
    return 0.5 * width <= closed.SPREAD_LSB * model.lsb_m


class Pruning:
    """Finds out where one sensor's bundles are needed."""

    def __init__(self, scene: Scene, model: SensorModel, caster: FacedCaster, at_rest: bool) -> None:
        at_rest = at_rest and model.leave_out.resting
        self._model, self._caster, self._at_rest = model, caster, at_rest
        self._bare = caster.bare
        "For what is asked of planes and edges."
        self.radii = model.plain_radii if model.beam.profile == "gauss" else 1.0 + 1e-6
        # of what a feed may bring no edges are known: with it in a sweep, none are looked at
        outlines = outlines_of(replace(scene, bodies=tuple(body for body in scene.bodies if not body.motion.may_come)))
        self.edges, self._pieces = Edges(outlines, model, self.radii), Pieces(outlines)
        self._all_still = at_rest and all(body.motion.still for body in scene.bodies)
        moving = np.array([not body.motion.still for body in outlines.bodies], bool)
        # edges of resting bodies are looked at once by a sensor at rest
        self._looked_at = int(np.count_nonzero(moving[outlines.body])) if at_rest else len(outlines)
        self._kept: tuple[bytes, float, Looked] | None = None
        self._group: tuple[Bundles, bytes, Rays] | None = None
        self._axes: tuple[Bundles, Rays] | None = None
        self._all: tuple[tuple[object, ...], tuple[object, ...], Pruned] | None = None
        "Where nothing moves: the last sweep, what it depends on, and what that is the identity of."

    def pays(self, beams_: int, sub_beams: int) -> bool:
        """Looking at the edges costs clearly less than the rays that may be saved."""
        if self._model.prune_bundles == "always":
            return True
        if sub_beams < FEWEST:
            return False
        if self._at_rest:  # what bundles meet of resting bodies is known without a ray
            return self._all_still
        return self.edges.too_many or self._looked_at * EDGE_NS < EDGES_SHARE * beams_ * (sub_beams - 1) * RAY_NS

    def sweep(
        self, plan: ScanPlan, bundles: Bundles, pose: Pose, t_s: Floats, surfaces: Surfaces, air: AirNow
    ) -> Pruned:
        """Everything that comes back from surfaces in a sweep; where nothing moves, that of the last one."""
        if not self._all_still or air.uneven:
            return self._swept(plan, bundles, pose, t_s, surfaces, air)
        key = id(bundles), id(surfaces), id(air), plan.gain, plan.max_range_m
        if self._all is None or self._all[0] != key:
            made = self._swept(plan, bundles, pose, t_s, surfaces, air)
            self._all = key, (bundles, surfaces, air), replace(made, cast=0)
            return made
        kept = self._all[2]
        return replace(kept, rays=kept.rays.at(t_s))

    def _swept(
        self, plan: ScanPlan, bundles: Bundles, pose: Pose, t_s: Floats, surfaces: Surfaces, air: AirNow
    ) -> Pruned:
        model, gain = self._model, plan.gain
        reach = reach_of(model, plan.max_range_m)
        looked = self._looked(plan, bundles, pose, t_s, reach, far=surfaces_show(air.sun, model) or not model.prune_far)
        rays, hits = looked.rays, looked.hits
        planes = closed.planes(rays, hits, model, self.radii)
        met = np.isfinite(hits.range_m)
        plain = looked.plain & (planes.steep < closed.STEEPEST)
        if surfaces.sends_on and model.bounces > 0:
            plain[met] &= ~surfaces.onward[hits.material[met]]
        if surfaces.detailed is not None:
            plain[met] &= ~surfaces.detailed[hits.material[met]]
        short, leans = closed.holds(planes, hits, surfaces, air, model, plain & met)
        if model.rule == "laguerre" or not model.leave_out.plane_moments:
            short[:] = False  # that rule is chosen for its exact sums
        found, wide, crossings = closed.echoes(indexes(short), rays, planes, hits, surfaces, air, model, gain, reach)
        short[wide] = False
        group = indexes(~plain | (met & ~short))
        nearest = np.where(met, hits.range_m, np.inf)
        material, normal = hits.material.copy(), hits.normal.copy()
        cast = looked.cast
        if len(group):
            part, count = self._bundle_part(bundles, pose, t_s, group, plain, looked, surfaces, air, gain, plan, reach)
            cast += count
            echoes = replace(part.echoes, beam=group[part.echoes.beam])
            found = SubEchoes.joined(found, echoes) if len(found) else echoes
            nearest[group] = part.nearest_m
            material[group], normal[group] = part.axis_material, part.axis_normal
        if air.particles and bool(short.any()):
            self._exact_nearest(nearest, indexes(short), bundles, pose, t_s, looked)
        shifts = closed.Shifts(np.where(np.isnan(crossings), np.nan, leans), crossings)
        return Pruned(rays, Seen(found, nearest, material, hits.range_m, normal), plain, cast, shifts)

    def _bundle_part(
        self, bundles: Bundles, pose: Pose, t_s: Floats, group: Ints, plain: Bools, looked: Looked,
        surfaces: Surfaces, air: AirNow, gain: float, plan: ScanPlan, reach: float,
    ) -> tuple[Seen, int]:  # fmt: skip
        """Bundles of these beams: cast, or where they meet one plane for certain, computed from it."""
        rays, again = self._rays(bundles, pose, t_s, group)
        far = np.inf if surfaces_show(air.sun, self._model) or not self._model.prune_far else reach
        known = plain[group][rays.beam]
        if not bool(known.any()):
            first = self._caster.first_hits(rays.origin_m, rays.direction, rays.t_s, max_range_m=far, again=again)
            hits = CellHits.of(first)
            return returned(hits, rays, self._caster, surfaces, air, self._model, gain, plan.max_range_m), len(known)
        axes, owner = looked.hits, group[rays.beam]
        columns = CellHits(
            np.full(len(owner), np.nan), axes.body[owner], axes.actor[owner], axes.material[owner],
            axes.normal[owner], -np.einsum("ij,ij->i", axes.normal[owner], rays.direction), axes.inner[owner],
        )  # fmt: skip
        columns.range_m[known] = closed.plane_ranges(_taken(rays, known), _at(looked, group), rays.beam[known])
        cast = indexes(~known)
        if len(cast):
            met = self._caster.first_hits(
                rays.origin_m[cast], rays.direction[cast], rays.t_s[cast], max_range_m=far
            )  # fmt: skip
            for name in COLUMNS:
                getattr(columns, name)[cast] = getattr(met, name)
        return returned(columns, rays, self._caster, surfaces, air, self._model, gain, plan.max_range_m), len(cast)

    def _exact_nearest(
        self, nearest: Floats, chosen: Ints, bundles: Bundles, pose: Pose, t_s: Floats, looked: Looked
    ) -> None:
        """Falling particles are drawn up to the nearest sub-beam's range: that of the bundle, so that none differs."""
        rays = cast_rays(part_of(bundles, chosen), pose_at(pose, chosen), t_s[chosen])
        ranges = closed.plane_ranges(rays, _at(looked, chosen), rays.beam)
        nearest[chosen] = np.fmin(np.fmin.reduceat(ranges, np.arange(len(chosen)) * bundles.sub_beams), np.inf)

    # ------------------------------------------------------------------ which beams are plain
    def _looked(self, plan: ScanPlan, bundles: Bundles, pose: Pose, t_s: Floats, reach: float, far: bool) -> Looked:
        cut = np.inf if far else reach
        key = plan.azimuth_rad.tobytes() + plan.elevation_rad.tobytes()
        if self._all_still and self._kept is not None and self._kept[:2] == (key, cut):
            kept = self._kept[2]
            return Looked(kept.rays.at(t_s), kept.hits, kept.plain, 0)
        rays, again = self._axis_rays(bundles, pose, t_s)
        hits = self._bare.first_hits(rays.origin_m, rays.direction, rays.t_s, max_range_m=cut, again=again)
        found = self._judged(plan, rays, hits, pose, t_s, reach if not far else math.inf, bundles.sub_beams)
        if self._all_still:
            self._kept = key, cut, found
        return found

    def _judged(
        self, plan: ScanPlan, rays: Rays, hits: FacedHits, pose: Pose, t_s: Floats, reach: float, sub_beams: int
    ) -> Looked:
        n, met = len(t_s), np.isfinite(hits.range_m)
        cast = n
        if self.edges.too_many:
            every = indexes(met)
            plain = np.zeros(n, bool)
            plain[every] = self._probed(plan, every, rays, hits, pose, PROBED_RADII)
            return Looked(rays, hits, plain, cast + PROBES * len(every))
        most_pairs = int(0.5 * n * sub_beams * RAY_NS / PAIR_NS)
        if self._model.prune_bundles == "always":
            most_pairs = MOST_PAIRS
        sights = sights_of(pose, rays.axis, t_s)
        crossings = self.edges.crossings(sights, min(reach, 1e9), self._at_rest, most_pairs, self._cover_m(rays, hits))
        if crossings is None:
            return Looked(rays, hits, np.zeros(n, bool), cast)
        plain = ~crossings.uncovered(n, hits.range_m, hits.normal, rays.axis)
        at = indexes(plain & met)
        cosine = np.maximum(-np.einsum("ij,ij->i", hits.normal[at], rays.axis[at]), 1e-3)
        shape = self._model.beam
        width = max(math.tan(shape.half_angle_x_rad), math.tan(shape.half_angle_y_rad)) * hits.range_m[at]
        around = self.radii * (width + shape.exit_radius_m) / cosine * (1.0 + closed.STEEPEST)
        point = rays.origin_m[at] + hits.range_m[at, None] * rays.direction[at]
        doubt = at[self._pieces.doubtful(hits.body[at].astype(np.int64), hits.face[at], point, around, t_s)]
        if len(doubt):
            plain[doubt] = self._probed(plan, doubt, rays, hits, pose, self.radii)
        return Looked(rays, hits, plain, cast + PROBES * len(doubt))

    def _cover_m(self, rays: Rays, hits: FacedHits) -> Floats:
        """(n,) distance from which on everything in a beam's cone is behind the plane that its axis meets."""
        steep = closed.planes(rays, hits, self._model, self.radii).steep
        bounded = np.isfinite(hits.range_m) & (steep < closed.STEEPEST)
        shape = self._model.beam
        slant = 1.0 + self.radii * math.tan(max(shape.half_angle_x_rad, shape.half_angle_y_rad))
        farthest = (
            slant * (hits.range_m + self.radii * shape.exit_radius_m) / (1.0 - np.minimum(steep, closed.STEEPEST))
        )
        # a beam whose plane is nearly seen from its edge keeps its bundle anyhow
        steep_beams = np.isfinite(hits.range_m) & ~bounded
        return np.where(bounded, farthest + 0.1, np.where(steep_beams, 0.0, np.inf))

    def _probed(self, plan: ScanPlan, at: Ints, rays: Rays, hits: FacedHits, pose: Pose, radii: float) -> Bools:
        """Rays around the axes of these beams meet the same plane of the same body."""
        turn = 2.0 * np.pi * np.arange(PROBES) / PROBES
        ring = beams.Bundle(radii * np.cos(turn), radii * np.sin(turn), np.full(PROBES, 1.0 / PROBES))
        own, start = beams.spread(
            ring, self._model.beam, plan.azimuth_rad[at], plan.elevation_rad[at], np.zeros(len(at))
        )  # fmt: skip
        rotation = pose_at(pose, at).rotation
        direction = turned(rotation, own).reshape(-1, 3)
        origin = rays.centre_m[at].repeat(PROBES, axis=0) + turned(rotation, start).reshape(-1, 3)
        owner = at.repeat(PROBES)
        found = self._bare.first_hits(origin, direction, rays.t_s[owner])
        same = (found.body == hits.body[owner]) & (found.material == hits.material[owner])
        normal = hits.normal[owner]
        same &= np.einsum("ij,ij->i", found.normal, normal) > 1.0 - SAME_NORMAL
        apart = origin - rays.origin_m[owner] - hits.range_m[owner, None] * rays.direction[owner]
        met = np.where(np.isfinite(found.range_m), found.range_m, 0.0)
        off = np.abs(np.einsum("ij,ij->i", normal, apart + met[:, None] * direction))
        same &= off < 0.25 * self._model.lsb_m
        return np.asarray(same.reshape(-1, PROBES).all(axis=1))

    def _axis_rays(self, bundles: Bundles, pose: Pose, t_s: Floats) -> tuple[Rays, bool]:
        """Rays of all axes, and whether the very same were cast before."""
        if not self._at_rest:
            return cast_rays(_axes(bundles), pose, t_s), False
        again = self._axes is not None and self._axes[0] is bundles
        if self._axes is None or not again:
            self._axes = bundles, cast_rays(_axes(bundles), pose, t_s)
        return self._axes[1].at(t_s), again

    def _rays(self, bundles: Bundles, pose: Pose, t_s: Floats, group: Ints) -> tuple[Rays, bool]:
        """Rays of these beams' bundles, numbered again, and whether the very same were cast before."""
        if not self._at_rest:
            return cast_rays(part_of(bundles, group), pose_at(pose, group), t_s[group]), False
        key = group.tobytes()
        again = self._group is not None and self._group[0] is bundles and self._group[1] == key
        if self._group is None or not again:
            made = cast_rays(part_of(bundles, group), pose_at(pose, group), t_s[group])
            self._group = bundles, key, made
        return self._group[2].at(t_s[group]), again


def _axes(bundles: Bundles) -> Bundles:
    each = np.arange(len(bundles.axis))
    one = np.ones(1)
    return Bundles(bundles.axis, bundles.axis[:, None, :], None, one, each, np.ones(len(each)), each)


def _taken(rays: Rays, chosen: Bools) -> Rays:
    return replace(rays, origin_m=rays.origin_m[chosen], direction=rays.direction[chosen], beam=rays.beam[chosen])


def _at(looked: Looked, beams_: Ints) -> CellHits:
    hits = looked.hits
    return CellHits(
        hits.range_m[beams_], hits.body[beams_], hits.actor[beams_], hits.material[beams_], hits.normal[beams_],
        hits.cosine[beams_], hits.inner[beams_],
    )  # fmt: skip
