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
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from emulator.physics import beams
from emulator.physics.arrays import Bools, Floats, Ints, indexes
from emulator.physics.subechoes import SubEchoes
from emulator.sensing import closed
from emulator.sensing.air import AirNow
from emulator.sensing.contracts import FacedCaster, Hits
from emulator.sensing.daylight import surfaces_show
from emulator.sensing.model import SensorModel
from emulator.sensing.paths import Seen, Surfaces, reach_of, returned
from emulator.sensing.pruning import Pruned
from emulator.sensing.rays import BundleCache, Rays, cast_rays, pose_at, turned
from emulator.sensing.sheets import bright_of
from emulator.world.connected import pieces_of
from emulator.world.motion import Pose
from protocols.scan import ScanPlan

if TYPE_CHECKING:
    from emulator.world.scene import Body, Scene

ONE_RING = 10
"Probes up to which all of them are on the rim."
INNER = 0.6
"Radius of the second ring: its shares, from the moments of the disc up to the fourth, are positive."
OFF_PLANE_LSB = 0.5
"Of a probe from the plane through the others of its beam, in steps of the range: more is an edge or a crease."
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
    if model.probes == 0 or not model.leave_out.narrow_beams or model.leave_out.closed_form == "never":
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
        self.nodes = probe_nodes(model.probes)
        beam = model.beam
        x, y = math.tan(beam.half_angle_x_rad), math.tan(beam.half_angle_y_rad)
        self._rim = max(x, y), beam.exit_radius_m
        # opposite rays, and how the inverse range of each follows from those on the axes of the ellipse
        u, v = self.nodes.u, self.nodes.v
        self._fit = _planes_fit(u, v)
        self._slant = np.sqrt(1.0 + (x * u) ** 2 + (y * v) ** 2)
        "Length of each ray whose part along the axis is 1."
        self._bright = _bright_spheres(scene, bright_of(dry.table))

    @property
    def too_bright(self) -> bool:
        """So many bright bodies that every beam would have to be looked at for them."""
        return self._bright is None

    def sweep(self, plan: ScanPlan, pose: Pose, t_s: Floats, surfaces: Surfaces, air: AirNow) -> Pruned:
        """Everything that comes back from surfaces in a sweep."""
        model, gain = self._model, plan.gain
        reach = reach_of(model, plan.max_range_m)
        far = np.inf if surfaces_show(air.sun, model) or not model.spare_far else reach
        rays = self._rays(plan, pose, t_s)
        hits = self._caster.first_hits(rays.origin_m, rays.direction, rays.t_s, max_range_m=far)
        plain = self.plain(hits, rays, t_s, reach)
        n, count = len(plan), len(self.nodes)
        what = self._caster, surfaces, air, model, gain, plan.max_range_m
        nearest, material, normal = np.full(n, np.inf), np.full(n, -1, np.int32), np.zeros((n, 3))
        found, cast = SubEchoes.none(), len(rays.beam)
        for chosen in (plain, ~plain):
            at = indexes(chosen)
            if not len(at):
                continue
            if chosen is plain:
                own = (at[:, None] * count + np.arange(count)).ravel() if len(at) < n else None
                part = rays if own is None else _rays_at(rays, at, own)
                seen = returned(hits if own is None else _Picked.of(hits, own), part, *what)
            else:
                part = cast_rays(self._bundles.part(plan, at), pose_at(pose, at), t_s[at])
                first = self._caster.first_hits(part.origin_m, part.direction, part.t_s, max_range_m=far)
                seen, cast = returned(first, part, *what), cast + len(part.beam)
            nearest[at], material[at], normal[at] = seen.nearest_m, seen.axis_material, seen.axis_normal
            echoes = seen.echoes if len(at) == n else replace(seen.echoes, beam=at[seen.echoes.beam])
            found = SubEchoes.joined(found, echoes)
        none = np.full(n, np.nan)
        axes = _axes(rays, n, count)
        return Pruned(axes, Seen(found, nearest, material, normal), plain, cast, closed.Shifts(none, none))

    def plain(self, hits: Hits, rays: Rays, t_s: Floats, reach: float) -> Bools:
        """(n,) beams whose probes meet one material of one actor on one plane, or nothing."""
        n, count = len(rays.axis), len(self.nodes)
        range_m = hits.range_m.reshape(n, count)
        met = range_m <= reach
        some, every = met.any(axis=1), met.all(axis=1)
        with np.errstate(invalid="ignore", divide="ignore"):
            inverse = self._slant / range_m
            off = np.abs(inverse @ self._fit) * (range_m[:, :1] ** 2)
            flat = off.max(axis=1) <= OFF_PLANE_LSB * self._model.lsb_m
        material, actor = hits.material.reshape(n, count), hits.actor.reshape(n, count)
        same = (material == material[:, :1]).all(axis=1) & (actor == actor[:, :1]).all(axis=1)
        plain = ~some | (every & flat & same)
        for one in self._bright or ():
            plain &= ~self._looks_at(one, rays, t_s)
        return np.asarray(plain)

    def _looks_at(self, one: _Bright, rays: Rays, t_s: Floats) -> Bools:
        """(n,) beams whose cone comes into that sphere."""
        times = np.array([0.5 * (t_s.min() + t_s.max()), t_s.min(), t_s.max()])
        places = one.body.motion.pose(times).to_world(one.centre_m)
        slack = 2.0 * float(np.linalg.norm(places - places[0], axis=1).max())
        to = places[0] - rays.centre_m
        along = np.einsum("ij,ij->i", to, rays.axis)
        across = np.einsum("ij,ij->i", to, to) - along * along
        room = one.radius_m + slack + self._rim[1] + self._rim[0] * np.maximum(along, 0.0)
        return np.asarray((across <= room * room) & (along > -room))

    def _rays(self, plan: ScanPlan, pose: Pose, t_s: Floats) -> Rays:
        """The probes of all beams in the world."""
        n, count = len(plan), len(self.nodes)
        own, start = beams.spread(self.nodes, self._model.beam, plan.azimuth_rad, plan.elevation_rad, np.zeros(n))
        direction = turned(pose.rotation, own)
        origin = pose.position_m.T.repeat(count, axis=1)
        if self._rim[1] > 0.0:
            origin += turned(pose.rotation, start).reshape(n * count, 3).T
        beam = np.arange(n).repeat(count)
        return Rays(
            origin_m=origin.T,
            direction=direction.reshape(n * count, 3),
            t_s=t_s.repeat(count),
            beam=beam,
            share=np.tile(self.nodes.share, n),
            nearest_axis=np.arange(n) * count,
            centre_m=pose.position_m,
            axis=direction[:, 0, :],
            own_axis=own[:, 0, :],
        )


def _planes_fit(u: Floats, v: Floats) -> Floats:
    """(k, k) that takes inverse ranges of k probes to what they differ from those of a plane.

    On a plane the inverse of the distance along the axis is linear in the place within the beam.
    """
    terms = np.stack([np.ones_like(u), u, v], axis=1)
    return np.asarray((np.eye(len(u)) - terms @ np.linalg.pinv(terms)).T)


def _bright_spheres(scene: Scene, bright: Bools) -> tuple[_Bright, ...] | None:
    """Around each piece of bright faces; None where there are too many, or one changes its shape."""
    found = []
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


def _rays_at(rays: Rays, at: Ints, own: Ints) -> Rays:
    """Those of some beams, numbered anew."""
    count = len(own) // len(at)
    return Rays(
        rays.origin_m[own], rays.direction[own], rays.t_s[own], np.arange(len(at)).repeat(count), rays.share[own],
        np.arange(len(at)) * count, rays.centre_m[at], rays.axis[at], rays.own_axis[at],
    )  # fmt: skip


def _axes(rays: Rays, n: int, count: int) -> Rays:
    """The middle ray of each beam, for those who look along beams."""
    each, at = np.arange(n), np.arange(n) * count
    return Rays(
        rays.origin_m[at], rays.direction[at], rays.t_s[at], each, np.ones(n), each, rays.centre_m, rays.axis,
        rays.own_axis,
    )  # fmt: skip
