"""Sweeps of narrow beams: a few rays of each beam first, its bundle only where these do not lie on one smooth surface.

Belongs here: the probing rays, what a beam must show to do with them, the order of the steps. Not: the paths of rays
(paths), bundles (rays). For sensors whose angles never repeat and whose spec has `probes`; sensors with wide beams
have their plain beams by the scene's edges instead (pruning).

The probes of a plain beam are its bundle: their shares are those of a quadrature of the disc, so that mean, spread and
strength over a smooth surface have no error of second order.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from emulator.physics import beams
from emulator.physics.arrays import Bools, Floats, Ints, indexes
from emulator.physics.beams import beam_phase
from emulator.physics.subechoes import SubEchoes
from emulator.sensing import closed, strips
from emulator.sensing.air import AirNow
from emulator.sensing.contracts import FacedCaster, Hits
from emulator.sensing.daylight import surfaces_show
from emulator.sensing.model import SensorModel
from emulator.sensing.narrow import LEFT, Beams, settled
from emulator.sensing.paths import Seen, Surfaces, reach_of, returned, window_factors
from emulator.sensing.pruning import Pruned
from emulator.sensing.rays import BundleCache, Rays, cast_rays, pose_at
from emulator.sensing.sheets import bright_of
from emulator.sensing.through import Ways
from emulator.sensing.traced import DONE, UNEVEN, Bundle, traced
from emulator.sensing.traced import LEFT as UNTRACED
from emulator.world.connected import pieces_of
from emulator.world.motion import Motion, Pose
from protocols.scan import ScanPlan

if TYPE_CHECKING:
    from emulator.world.scene import Body, Scene

ONE_RING = 10
"Probes up to which all of them are on the rim."
INNER = 0.6
"Radius of the second ring: its shares, from the moments of the disc up to the fourth, are positive."
OFF_PLANE_LSB = 0.5
"Of a probe from the plane through the others of its beam, in steps of the range: more is an edge or a crease."
MOST_BEHIND = 0.1
"Share of the light behind an edge between probes: of four it is 0.091."
NOTHING, CLOSED, PROBED, BUNDLE, PANE = 0, 1, 2, 3, 5
"""What becomes of a beam: no echo; strips of one surface; the paths of its probes; those of its bundle; those of its
probes if what these see through a pane or in it is smooth too."""
FEWEST_PANES = 40
"Beams of a sweep: to look through fewer panes with probes first costs more than it saves."
UNTURNED = np.eye(3)
MOST_BRIGHT = 64
"Pieces of bright faces around each of which a sphere is looked at."


def probe_nodes(probes: int) -> beams.Bundle:
    """The axis and so many more rays of a top-hat: on the rim, or on it and on a ring of `INNER` radii between.

    Shares give the mean of every polynomial up to the third degree over the disc; with two rings up to the fifth.
    """
    if probes <= ONE_RING:
        rings, shares = [(1.0, probes, 0.0)], [0.5]
    else:
        outer = (probes + 1) // 2
        rings = [(1.0, outer, 0.0), (INNER, probes - outer, math.pi / outer)]
        inner = (0.5 - 1.0 / 3.0) / (INNER**2 - INNER**4)
        shares = [0.5 - inner * INNER**2, inner]
    u, v, share = [np.zeros(1)], [np.zeros(1)], [np.array([1.0 - sum(shares)])]
    for (radius, count, first), whole in zip(rings, shares, strict=True):
        turn = first + 2.0 * np.pi * np.arange(count) / count
        u, v = [*u, radius * np.cos(turn)], [*v, radius * np.sin(turn)]
        share.append(np.full(count, whole / count))
    return beams.Bundle(np.concatenate(u), np.concatenate(v), np.concatenate(share))


def most_missed(probes: int) -> tuple[float, float]:
    """Share of the light behind a straight edge, and within a straight strip, that may slip between the probes."""
    nodes = probe_nodes(probes)
    edge = strip = 0.0
    for turn in np.linspace(0.0, np.pi, 721):
        place = np.sort(nodes.u * math.cos(turn) + nodes.v * math.sin(turn))
        below = 0.5 + (place * np.sqrt(np.maximum(1.0 - place**2, 0.0)) + np.arcsin(np.clip(place, -1, 1))) / np.pi
        edge, strip = max(edge, float(below[0])), max(strip, float(np.diff(below).max()))
    return edge, strip


def wanted(model: SensorModel) -> bool:
    """The rule is for this sensor: its spec has probes, and its beam an edge."""
    if model.probes == 0 or not model.leave_out.narrow_beams:
        return False
    if model.rule in ("axis", "adaptive") or model.beam.is_ray or model.beam.profile != "tophat":
        return False
    return model.sidelobe_share == 0.0 and model.sub_beams > model.probes + 1


@dataclass(frozen=True, eq=False)
class _Picked:
    """Hits of some rays; what few ask for is looked up when they do."""

    hits: Hits
    at: Ints
    range_m: Floats
    actor: NDArray[np.int32]
    material: NDArray[np.int32]
    cosine: Floats
    inner: Bools

    @classmethod
    def of(cls, hits: Hits, at: Ints) -> _Picked:
        """Those of the rays `at`."""
        return cls(hits, at, hits.range_m[at], hits.actor[at], hits.material[at], hits.cosine[at], hits.inner[at])

    @property
    def body(self) -> NDArray[np.int32]:
        return self.hits.body[self.at]

    @property
    def normal(self) -> Floats:
        return self.hits.normals(self.at)

    def normals(self, rays: Ints) -> Floats:
        """(k, 3) of some rays."""
        return self.hits.normals(self.at[rays])

    def bodies(self, rays: Ints) -> Ints:
        """(k,) of some rays."""
        return self.hits.bodies(self.at[rays])


@dataclass(frozen=True, eq=False)
class _Bright:
    """A sphere around a piece of bright faces of a body, in its frame."""

    body: Body
    centre_m: Floats
    radius_m: float


class Probing:
    """Measures the surfaces of one sensor's sweeps by probes, and by bundles where these do not do."""

    def __init__(self, scene: Scene, model: SensorModel, caster: FacedCaster, bundles: BundleCache, dry: Surfaces):
        self._model, self._caster, self._bundles = model, caster, bundles
        self.nodes = nodes = probe_nodes(model.probes)
        beam = model.beam
        x, y = math.tan(beam.half_angle_x_rad), math.tan(beam.half_angle_y_rad)
        self._rim = max(x, y), beam.exit_radius_m
        cr, sr = math.cos(beam.roll_rad), math.sin(beam.roll_rad)
        across, upward = cr * x * nodes.u - sr * y * nodes.v, sr * x * nodes.u + cr * y * nodes.v
        length = np.sqrt(1.0 + across * across + upward * upward)
        pupil = beam.exit_radius_m
        self._aim = np.array([
            1.0 / length, across / length, upward / length,
            pupil * (cr * nodes.u - sr * nodes.v), pupil * (sr * nodes.u + cr * nodes.v),
        ])  # fmt: skip
        self._places = np.array([length, nodes.u, nodes.v])
        self._bright = _bright_spheres(scene, bright_of(dry.table))
        every = _by_motion(self._bright or ())
        resting = [_around(*one, np.zeros(1)) for one in every if one[0].still]
        self._bright_at_rest = np.concatenate([np.zeros((4, 0)), *resting], axis=1)
        self._bright_moving = [one for one in every if not one[0].still]
        self._law = self._numbers()
        self._tilts = np.zeros(0), np.ones(0), np.zeros(0), np.zeros(0, np.int64)
        "Elevations of the latest sweep, their cosines and sines, and the order of its beams by them."

    @property
    def too_bright(self) -> bool:
        """So many bright bodies that every beam would have to be looked at for them."""
        return self._bright is None

    def sweep(self, plan: ScanPlan, pose: Pose, t_s: Floats, surfaces: Surfaces, air: AirNow) -> Pruned:
        """Everything that comes back from surfaces in a sweep."""
        model, gain, n = self._model, plan.gain, len(plan)
        reach = reach_of(model, plan.max_range_m)
        far = np.inf if surfaces_show(air.sun, model) or not model.prune_far else reach
        beams_ = self._beams(plan, pose, t_s)
        weight = np.ones(n)
        if gain != 1.0 or model.windscreen is not None:
            weight = window_factors(beams_.own_axis, model, gain)
        treated, spheres = _treated(surfaces, air, model), self._spheres(t_s)
        first = settled(beams_, self._caster, far, reach, treated, surfaces.table.factors, weight, spheres, self._law)
        kinds, made, material, actor, normal = first.kinds, first.made, first.material, first.actor, first.normal
        faces = first.faces
        what, cast = (self._caster, surfaces, air, model, gain, plan.max_range_m), first.cast
        count, step = len(self.nodes), OFF_PLANE_LSB * model.lsb_m
        others: list[SubEchoes] = []
        rest = first.around, far, reach, weight, surfaces, air, model, step
        left = indexes(kinds == LEFT)
        traceable = np.full(n, first.around is not None)
        if first.around is not None and first.around.others.shape[1]:
            traceable[left] = False
        if len(left):
            some = beams_ if len(left) == n else beams_.taken(left)
            rays = _probes(some)
            hits = self._caster.first_hits(rays.origin_m, rays.direction, rays.t_s, max_range_m=far)
            sort, made[0, left], some_faces = _judged(some, hits, weight[left], treated, reach, surfaces, model)
            faces.rows[:, left], faces.count[left] = some_faces.rows, some_faces.count
            for k in range(spheres.shape[1]):
                sort[(sort != BUNDLE) & self._looks_at(spheres[:, k], rays)] = BUNDLE
            at = np.arange(len(left)) * count
            kinds[left], material[left], actor[left] = sort, hits.material[at], hits.actor[at]
            made[1, left] = hits.range_m[at]
            normal[left], cast = hits.normals(at), cast + len(rays.beam)
            chosen = indexes(sort == PROBED)
            if len(chosen):
                own = (at[chosen][:, None] + np.arange(count)).ravel()
                seen = returned(_Picked.of(hits, own), _rays_at(rays, chosen, own), *what)
                made[0, left[chosen]] = seen.nearest_m
                others.append(_of(left[chosen], seen.echoes))
        panes = indexes(kinds == PANE)
        if len(panes) < FEWEST_PANES:
            kinds[panes] = BUNDLE
        else:
            own = panes[traceable[panes]]
            if len(own):
                through = traced(beams_, own, Bundle(self.nodes, np.zeros(len(own)), judged=True), *rest)
                kinds[own[through.verdict == UNEVEN]] = BUNDLE
                others.append(through.found)
                own = own[through.verdict == UNTRACED]
            own = np.concatenate([panes[~traceable[panes]], own])
            own.sort()
            if len(own):
                met: Hits
                if len(left) and bool(np.isin(own, left, assume_unique=True).all()):  # they have been cast
                    mine = left.searchsorted(own)
                    which = (mine[:, None] * count + np.arange(count)).ravel()
                    met, through_rays = _Picked.of(hits, which), _rays_at(rays, mine, which)
                else:
                    through_rays = _probes(beams_.taken(own))
                    origin, direction, when = through_rays.origin_m, through_rays.direction, through_rays.t_s
                    met = self._caster.first_hits(origin, direction, when, max_range_m=far)
                good, seen = self._looked_through(met, through_rays, weight[own], what)
                kinds[own] = np.where(good, PANE, BUNDLE)
                made[0, own] = seen.nearest_m
                others.append(_of(own, seen.echoes.of_beams(good)))
        chosen = indexes(kinds == BUNDLE)  # what was put down of them as panes is replaced
        own = chosen[traceable[chosen]]
        if len(own):
            edges = traced(beams_, own, Bundle(self._bundles.nodes, beam_phase(own), judged=False), *rest)
            done = edges.verdict == DONE
            own, left_ = own[done], own[~done]
            made[0, own], material[own], normal[own] = edges.nearest_m[done], edges.material[done], edges.normal[done]
            others.append(edges.found)
            chosen, cast = np.concatenate([chosen[~traceable[chosen]], left_]), cast + edges.cast
            chosen.sort()
        if len(chosen):
            part = cast_rays(self._bundles.part(plan, chosen), pose_at(pose, chosen), t_s[chosen])
            hits = self._caster.first_hits(part.origin_m, part.direction, part.t_s, max_range_m=far)
            seen, cast = returned(hits, part, *what), cast + len(part.beam)
            material[chosen], normal[chosen] = seen.axis_material, seen.axis_normal
            made[0, chosen] = seen.nearest_m
            others.append(_of(chosen, seen.echoes))
        found = strips.echoes(
            indexes(kinds == CLOSED),
            faces,
            material,
            actor,
            weight,
            surfaces.table,
            air.extinction_per_m,
            model,
            others,
        )
        none, each = np.full(n, np.nan), np.arange(n)
        axis = beams_.frame[0].T
        axes = Rays(pose.position_m, axis, t_s, each, np.ones(n), each, pose.position_m, axis, beams_.own_axis)
        whole = Seen(found, made[0], material, made[1], normal)
        return Pruned(axes, whole, kinds != BUNDLE, cast, closed.Shifts(none, none))

    def _looked_through(self, hits: Hits, rays: Rays, weight: Floats, what: Any) -> tuple[Bools, Seen]:
        """What probes of beams on panes see through these and in them, and of which beams they do for that."""
        caster, surfaces, air, model, gain, farthest_m = what
        ways = Ways()
        seen = returned(hits, rays, caster, surfaces, air, model, gain, farthest_m, ways)
        first_m, axes = hits.range_m.reshape(len(weight), -1), rays.nearest_axis
        # what a pane sends straight back as a mirror has a spread of nothing
        light = weight * model.k_m2 / (first_m.min(axis=1) ** 2 + model.aperture_radius_m**2)
        light *= surfaces.table.back(hits.material[axes].astype(np.int64), hits.cosine[axes])
        return ways.smooth(first_m, light, self._places, OFF_PLANE_LSB * model.lsb_m, model), seen

    def _numbers(self) -> Floats:
        """Numbers by which a beam is judged, in the order of `compiled.narrow`."""
        model, beam = self._model, self._model.beam
        return np.array([
            *self._rim, float((self._places[1] ** 2).sum()), OFF_PLANE_LSB * model.lsb_m, model.k_m2,
            model.aperture_radius_m**2, math.tan(beam.half_angle_x_rad), math.tan(beam.half_angle_y_rad),
            beam.exit_radius_m, math.cos(beam.roll_rad), math.sin(beam.roll_rad),
            _length(self._places, self.nodes.share), strips.STEEPEST, *strips.law(model), strips.WIDE,
        ])  # fmt: skip

    def _spheres(self, t_s: Floats) -> Floats:
        """(4, b) around bright faces during a sweep."""
        if not self._bright_moving:
            return self._bright_at_rest
        begin, end = t_s.min(), t_s.max()
        times = np.array([0.5 * (begin + end), begin, end])
        moving = [_around(motion, centre, radius, times) for motion, centre, radius in self._bright_moving]
        return np.concatenate([self._bright_at_rest, *moving], axis=1)

    def _looks_at(self, sphere: Floats, rays: Rays) -> Bools:
        """(n,) beams whose cone comes into that sphere."""
        to = sphere[:3] - rays.centre_m
        along = np.einsum("ij,ij->i", to, rays.axis)
        across = np.einsum("ij,ij->i", to, to) - along * along
        room = sphere[3] + self._rim[1] + self._rim[0] * np.maximum(along, 0.0)
        return np.asarray((across <= room * room) & (along > -room))

    def _beams(self, plan: ScanPlan, pose: Pose, t_s: Floats) -> Beams:
        """All beams in the world."""
        n = len(plan)
        ca, sa = np.cos(plan.azimuth_rad), np.sin(plan.azimuth_rad)
        if not np.array_equal(plan.elevation_rad, self._tilts[0]):  # layers are the same in every slice
            sines = np.sin(plan.elevation_rad)
            order = np.argsort(np.round(sines, 6), kind="stable")
            self._tilts = plan.elevation_rad, np.cos(plan.elevation_rad), sines, order
        _, ce, se, order = self._tilts
        own = np.zeros((3, 3, n))
        np.multiply(ce, ca, out=own[0, 0])
        np.multiply(ce, sa, out=own[0, 1])
        np.negative(sa, out=own[1, 0])
        np.multiply(-se, ca, out=own[2, 0])
        np.multiply(-se, sa, out=own[2, 1])
        own[0, 2], own[1, 1], own[2, 2] = se, ca, ce
        place, rotation = np.ascontiguousarray(pose.position_m.T), pose.rotation
        one = n > 0 and (rotation.strides[0] == 0 or bool((rotation == rotation[0]).all()))
        if one and bool((rotation[0] == UNTURNED).all()):
            frame = own + 0.0
        else:
            frame = np.zeros((3, 3, n))
            for row in range(3):
                for column in range(3):
                    weight = rotation[0, row, column] if one else rotation[:, row, column]
                    if one and weight == 1.0:
                        frame[:, row] += own[:, column]
                    elif np.any(weight):
                        frame[:, row] += weight * own[:, column]
        return Beams(place, frame, own[0].T, t_s, order, self._aim, self._places, self.nodes.share)


def _probes(beams_: Beams) -> Rays:
    """The probes of these beams."""
    n, count = len(beams_.t_s), len(beams_.share)
    origin, direction = _aimed(beams_.frame, beams_.place, beams_.aim)
    return Rays(
        origin_m=origin.T,
        direction=direction.T,
        t_s=beams_.t_s.repeat(count),
        beam=np.arange(n).repeat(count),
        share=np.tile(beams_.share, n),
        nearest_axis=np.arange(n) * count,
        centre_m=beams_.place.T,
        axis=beams_.frame[0].T,
        own_axis=beams_.own_axis,
    )


def _aimed(frame: Floats, place: Floats, aim: Floats) -> Floats:
    """Origins and directions (2, 3, n k): of `aim` (5, k) shares of the frame in a direction, metres left and up."""
    n, k = place.shape[1], aim.shape[1]
    forward, left, up = frame[..., None]
    direction = forward * aim[0] + left * aim[1] + up * aim[2]
    origin = place[..., None] + left * aim[3] + up * aim[4]
    return np.array([origin.reshape(3, n * k), direction.reshape(3, n * k)])


def _treated(surfaces: Surfaces, air: AirNow, model: SensorModel) -> Ints:
    """(materials,) the least that a beam on it needs."""
    table = surfaces.table
    needs = np.where(table.apart | air.uneven, PROBED, CLOSED)
    if surfaces.sends_on and model.bounces > 0:
        needs = np.where(surfaces.onward, PANE, needs)
    if surfaces.detailed is not None:
        needs = np.where(surfaces.detailed, BUNDLE, needs)
    return needs.astype(np.int64)


def _length(places: Floats, share: Floats) -> float:
    """Mean length of a ray of the beam over that of the axis, between planes across it."""
    return float((share * places[0]).sum())


@dataclass(frozen=True, eq=False)
class _Planes:
    """Of n beams: the range is (above - above_uv . w) / (facing + turns_uv . w) at the place w on the disc, (2, n)."""

    above: Floats
    above_uv: Floats
    facing: Floats
    turns_uv: Floats

    def away(self, range_m: Floats, places: Floats) -> Floats:
        """(n, k) of probes behind them, along the probes."""
        w = places[1:]
        top = self.above[:, None] - self.above_uv.T @ w
        return np.asarray(range_m - places[0] * (top / (self.facing[:, None] + self.turns_uv.T @ w)))


def _planes(beams_: Beams, normal: Floats, axis_m: Floats, model: SensorModel) -> _Planes:
    """Those that the axes meet; `normal` (n, 3), `beams_` of the same n."""
    shape = model.beam
    ahead, left, up = np.einsum("bij,ji->bj", beams_.frame, normal) if len(axis_m) else np.zeros((3, 0))
    cr, sr = math.cos(shape.roll_rad), math.sin(shape.roll_rad)
    both = np.array([cr * left + sr * up, cr * up - sr * left])
    wide = np.array([[math.tan(shape.half_angle_x_rad)], [math.tan(shape.half_angle_y_rad)]])
    return _Planes(ahead * axis_m, shape.exit_radius_m * both, ahead, wide * both)


def _smooth(range_m: Floats, places: Floats) -> _Planes:
    """Those through the probes, whose inverse ranges are fitted."""
    inverse, n = places[0] / range_m, len(range_m)
    slopes = (inverse @ places[1:].T).T / float((places[1] * places[1]).sum())
    return _Planes(np.ones(n), np.zeros((2, n)), inverse.mean(axis=1), slopes)


def _judged(
    beams_: Beams, hits: Hits, weight: Floats, treated: Ints, reach_m: float, surfaces: Surfaces, model: SensorModel
) -> tuple[Ints, Floats, strips.Faces]:
    """What becomes of beams (n,), their nearest ranges, and the faces of the closed ones."""
    n, share, places = len(weight), beams_.share, beams_.places
    range_m, material, actor = (one.reshape(n, -1) for one in (hits.range_m, hits.material, hits.actor))
    met = range_m <= reach_m
    nearest = np.fmin.reduce(np.where(met, range_m, np.inf), axis=1)
    every, some = met.all(axis=1), met.any(axis=1)
    same = (material == material[:, :1]).all(axis=1) & (actor == actor[:, :1]).all(axis=1)
    kinds, faces = np.where(some, BUNDLE, NOTHING), strips.Faces.none(n)
    at = indexes(every & same)
    at = at[treated[material[at, 0]] != BUNDLE]
    if not len(at):
        return kinds, nearest, faces
    r, step = range_m[at], OFF_PLANE_LSB * model.lsb_m
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        plane = _planes(beams_.taken(at), hits.normals(at * len(share)), r[:, 0], model)
        away = plane.away(r, places)
        curved = indexes(~(np.abs(away).max(axis=1) <= step))
        other = _smooth(r[curved], places)
        away[curved] = other.away(r[curved], places)
        for name in ("above", "above_uv", "facing", "turns_uv"):
            getattr(plane, name)[..., curved] = getattr(other, name)
        flat = np.abs(away).max(axis=1) <= step
        slope = plane.turns_uv / plane.facing + plane.above_uv / plane.above
    steep = np.hypot(*slope)
    kinds[at[flat]] = treated[material[at[flat], 0]]
    flat &= treated[material[at, 0]] == CLOSED
    kinds[at[flat]] = BUNDLE
    chosen = indexes(flat & (steep <= strips.STEEPEST))
    at, r, away, steep = at[chosen], r[chosen], away[chosen], steep[chosen]
    above, facing, to = plane.above[chosen], plane.facing[chosen], slope[:, chosen]
    to = np.where(steep > 0.0, to / np.where(steep > 0.0, steep, 1.0), [[1.0], [0.0]])
    cosines = np.abs(hits.cosine.reshape(n, -1)[at])
    cosine = cosines.mean(axis=1)
    bends = ((cosines @ places[1:].T).T * to).sum(axis=0) / float((places[1] * places[1]).sum())
    leans, turns = (plane.above_uv[:, chosen] * to).sum(axis=0), (plane.turns_uv[:, chosen] * to).sum(axis=0)
    length = _length(places, share)
    near = length * (above - leans) / (facing + turns)
    back = surfaces.table.back(material[at, 0].astype(np.int64), cosine)
    size = weight[at] * model.k_m2 * back / (near * near + model.aperture_radius_m**2)
    lead = np.maximum(length * above / facing - near, 0.0)
    count = strips.counts(lead, size, strips.law(model))
    kinds[at[count > 0]] = CLOSED
    faces.count[at] = count
    faces.rows[:, at] = [length * above, length * leans, facing, turns, (share * away).sum(axis=1), cosine, bends]
    return kinds, nearest, faces


def _bright_spheres(scene: Scene, bright: Bools) -> tuple[_Bright, ...] | None:
    """Around each piece of bright faces; None where there are too many, or one changes its shape."""
    found: list[Any] = []
    for body in scene.bodies:
        faces = bright[body.face_material]
        if not bool(faces.any()):
            continue
        corners = body.faces[faces]
        _, piece = pieces_of(len(body.vertices), corners[:, :2].ravel(), corners[:, 1:].ravel())
        own = np.unique(piece[corners[:, 0]])
        if body.frames is not None or len(found) + len(own) > MOST_BRIGHT:
            return None
        for number in own:
            points = body.vertices[corners[piece[corners[:, 0]] == number]].reshape(-1, 3)
            centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
            found.append(_Bright(body, centre, float(np.linalg.norm(points - centre, axis=1).max())))
    return tuple(found)


def _of(beams_: Ints, found: SubEchoes) -> SubEchoes:
    """Sub-echoes by the numbers of their beams in the sweep."""
    return replace(found, beam=beams_[found.beam])


def _by_motion(bright: tuple[_Bright, ...]) -> list[tuple[Motion, Floats, Floats]]:
    """Centres (p, 3) and radii (p,) of the pieces of each body, which move together."""
    bodies = {id(one.body): one.body for one in bright}
    found = []
    for number, body in bodies.items():
        own = [one for one in bright if id(one.body) == number]
        found.append((body.motion, np.array([one.centre_m for one in own]), np.array([one.radius_m for one in own])))
    return found


def _around(motion: Motion, centre_m: Floats, radius_m: Floats, times: Floats) -> Floats:
    """(4, p) spheres about where pieces of a body are first, that hold these at all of these times."""
    pose = motion.pose(times)
    places = np.einsum("tij,pj->pti", pose.rotation, centre_m) + pose.position_m
    moved = places - places[:, :1]
    far = np.sqrt((moved * moved).sum(axis=2).max(axis=1))
    return np.concatenate([places[:, 0].T, (radius_m + 2.0 * far)[None]])


def _rays_at(rays: Rays, at: Ints, own: Ints) -> Rays:
    """Those of some beams, numbered again."""
    count = len(own) // len(at)
    return Rays(
        rays.origin_m[own], rays.direction[own], rays.t_s[own], np.arange(len(at)).repeat(count), rays.share[own],
        np.arange(len(at)) * count, rays.centre_m[at], rays.axis[at], rays.own_axis[at],
    )  # fmt: skip
