"""Where the light goes: rays cast on the scene, continued at mirrors and through glass, and what each brings back.

Belongs here: hits -> sub-echoes (beam, range, amplitude, actor). Not: how a receiver makes echoes of them (echoes),
what the air does between (air), reflection models (physics.brdf).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from emulator.compiled.pair import OTHERWISE, by_loops
from emulator.physics import brdf, radiometry
from emulator.physics.arrays import Floats, Ints, exp_or_zero, indexes
from emulator.physics.materials import SurfaceTable
from emulator.physics.subechoes import Kept, SubEchoes
from emulator.sensing.contracts import Caster, Hits, Medium
from emulator.sensing.model import SensorModel
from emulator.sensing.order import MOST_EMPTY, Part, in_order, joined
from emulator.sensing.rays import Rays
from emulator.sensing.through import Ways

UNSEEN = 0.05
"A ray is not continued when the best surface, met by the whole beam, would return less than this of the threshold."
BEHIND_M = 1e-4
"A second ray starts this far behind the surface, and a thousandth of it more per metre: the caster works in float32."
MOST_FACES = 12
"Of bodies of glass that lie one in the other, met on one way."


@dataclass(frozen=True, eq=False)
class Surfaces:
    """The scene's materials, and what is asked of them for every sweep."""

    table: SurfaceTable
    sends_on: bool
    "A surface mirrors or transmits enough that rays are continued."
    strongest: float
    "Largest equivalent reflectance of any of them."
    onward: NDArray[np.bool_]
    "(materials,) those that mirror or transmit."
    special: NDArray[np.bool_]
    "(materials,) those, and those that the loops leave to arrays."
    solid: NDArray[np.bool_] | None = None
    "(bodies,) closed and of glass alone: light leaves them again where it meets their inside; None: there is none."
    detailed: NDArray[np.bool_] | None = None
    "(materials,) those whose faces stand for more than a plane of one reflectance; None: there is none."

    @classmethod
    def of(cls, table: SurfaceTable, solid: NDArray[np.bool_] | None = None) -> Surfaces:
        """Those of a table."""
        onward = np.array([m.model in ("glass", "mirror") for m in table.materials], bool)
        detailed = table.detailed if bool(table.detailed.any()) else None
        strongest = float(table.largest.max(initial=0.0))
        return cls(table, table.sends_on, strongest, onward, onward | table.apart, solid, detailed)


@dataclass(frozen=True, eq=False)
class Seen:
    """What the rays of a sweep met."""

    found: SubEchoes
    "Single reflections; amplitudes in rms noise of the dark receiver, `source` the actor. See `kept`."
    nearest_m: Floats
    "(n,) first surface of any sub-beam, infinite where there is none."
    axis_material: NDArray[np.int32]
    "(n,) material of the surface that the sub-beam nearest the axis meets, -1 none."
    axis_m: Floats
    "(n,) how far along the axis it is; NaN or infinite: none."
    axis_normal: Floats
    "(n, 3)"
    kept: Kept | None = None
    "Sub-echoes of beams that see what they saw before; `found` holds those of the others alone."

    @property
    def echoes(self) -> SubEchoes:
        """Those of all beams."""
        return self.found if self.kept is None else self.kept.whole(self.found)


@dataclass(eq=False)
class _Front:
    """Rays under way: what has been met so far."""

    origin_m: Floats
    direction: Floats
    t_s: Floats
    beam: Ints
    weight: Floats
    "Share of the beam's power, times all losses there and back."
    length_m: Floats | float
    depth: Floats | float
    entered: Ints | None = None
    "Body of glass that each has just entered, -1 none; None: there is no such body."
    bent: Floats | None = None
    "(m, 3) its direction in there."
    index: Floats | None = None
    "Of refraction there."
    air: Floats | None = None
    "Share of the beam whose light on the air is theirs: of rays that came straight, or through panes."
    inside: Ints | None = None
    "Body that each has gone into through a pane of it, or stayed in, -1 none; None: of none it is known."


def trace(
    rays: Rays,
    caster: Caster,
    scene: Surfaces,
    air: Medium,
    model: SensorModel,
    gain: float = 1.0,
    farthest_m: float = np.inf,
) -> Seen:
    """Everything that comes back from surfaces, for all sub-beams of a sweep."""
    hits = caster.first_hits(rays.origin_m, rays.direction, rays.t_s)
    return returned(hits, rays, caster, scene, air, model, gain, farthest_m)


def returned(
    hits: Hits,
    rays: Rays,
    caster: Caster,
    scene: Surfaces,
    air: Medium,
    model: SensorModel,
    gain: float = 1.0,
    farthest_m: float = np.inf,
    ways: Ways | None = None,
) -> Seen:
    """The same from the first hits of the rays; what rays that go on meet is noted in `ways`."""
    reach = reach_of(model, farthest_m)
    front = _first(rays, model, gain)
    first, onward, nearest = _first_met(front, hits, rays, scene, air, model, reach)
    parts = [] if onward is None else _continue(front, hits, onward, caster, scene, air, model, rays, reach, ways)
    if isinstance(first, SubEchoes):
        echoes = SubEchoes.joined(first, in_order(*joined(parts))) if parts else first
    else:
        echoes = in_order(*joined(first + parts))
    at_axis = rays.nearest_axis
    return Seen(echoes, nearest, hits.material[at_axis], hits.range_m[at_axis], hits.normals(at_axis))


def _first(rays: Rays, model: SensorModel, gain: float) -> _Front:
    weight = rays.share
    if gain != 1.0 or model.windscreen is not None:
        weight = weight * windows(rays, model, gain)[rays.beam]
    return _Front(rays.origin_m, rays.direction, rays.t_s, rays.beam, weight, 0.0, 0.0, air=rays.share)


def best_behind(
    hits: Hits, rays: Rays, scene: Surfaces, air: Medium, model: SensorModel, gain: float = 1.0,
    farthest_m: float = np.inf,
) -> Floats:  # fmt: skip
    """Amplitudes of the best surface behind each mirror and pane that the rays meet; below `UNSEEN` none is looked for.

    Of the first of them: what is behind a second one is fainter.
    """
    reach = reach_of(model, farthest_m)
    index = indexes(hits.range_m <= reach)
    if not len(index):
        return np.zeros(0)
    front = _first(rays, model, gain)
    _, onward = _meet(front, hits, index, rays, scene, air, model)
    whole = len(rays.beam) / len(rays.axis)
    if onward is None:
        return np.zeros(0)
    return _best(front.weight[onward.index] * onward.share**2, onward, whole, scene, model)[onward.length_m < reach]


def reach_of(model: SensorModel, farthest_m: float = np.inf) -> float:
    """Range beyond which nothing that comes back is looked at."""
    return min(model.gate_m, farthest_m) + 4.0 * model.pulse.half_support_m


def windows(rays: Rays, model: SensorModel, gain: float) -> Floats:
    """Factor on each beam's light there and back: the plan's gain, and a windscreen in front of the sensor."""
    return window_factors(rays.own_axis, model, gain)


def window_factors(own_axis: Floats, model: SensorModel, gain: float) -> Floats:
    """The same of beams by their axes in the sensor's frame."""
    factor = np.full(len(own_axis), gain)
    if model.windscreen is not None:
        screen = model.windscreen
        rake = math.radians(screen.rake_deg)
        cosine = np.abs(own_axis @ np.array([math.cos(rake), 0.0, math.sin(rake)]))
        factor *= brdf.pane_internal_transmission_cos(screen.index, cosine, screen.internal_transmission) ** 2
    return factor


@dataclass(eq=False)
class _Onward:
    """Where met surfaces send light, mirrors first: indexes into the front that met them, direction, share one way."""

    index: Ints
    direction: Floats
    share: Floats
    length_m: Floats
    depth: Floats
    passed: int
    "So many of them are mirrored; all others go on through panes as they came."
    entered: Ints | None = None
    bent: Floats | None = None
    refraction: Floats | None = None
    "Of these three see the front; None: there is no body of glass."


def _meet(
    front: _Front,
    hits: Hits,
    chosen: Ints | None,
    rays: Rays,
    scene: Surfaces,
    air: Medium,
    model: SensorModel,
    last: bool = False,
) -> tuple[tuple[Ints, Floats, Floats], _Onward | None]:
    """Sub-echoes of the surfaces met by the chosen rays, and the rays that go on from them, if these are not the last.

    Whole vectors are only picked out where something needs them: most hits want a range and a cosine.
    """
    range_m, material, beam, weight = hits.range_m, hits.material, front.beam, front.weight
    way = front.origin_m, front.direction, front.t_s
    before_m, before = front.length_m, front.depth
    cosine = hits.cosine
    if chosen is not None:
        cosine, range_m, material = cosine[chosen], range_m[chosen], material[chosen]
        beam, weight = beam[chosen], weight[chosen]
        before_m, before = _part(before_m, chosen), _part(before, chosen)
        if air.uneven:
            way = way[0][chosen], way[1][chosen], way[2][chosen]
    length = before_m + range_m
    depth = before + air.depth(way[0], way[1], range_m, way[2])
    reflectance = scene.table.back(material.astype(np.int64), cosine, length)
    lit = _Lit(beam, length, cosine, reflectance, material)
    onward = None if last else _sent_on(lit, depth.__getitem__, front, hits, chosen, rays, scene, model)
    return (beam, length, weight * collected(length, depth, model) * reflectance), onward


@dataclass(frozen=True, eq=False)
class _Lit:
    """Surfaces that rays of a front have met."""

    beam: Ints
    length_m: Floats
    cosine: Floats
    reflectance: Floats
    material: NDArray[np.int32]


_FirstMet = tuple[SubEchoes | list[Part], _Onward | None, Floats]
"Sub-echoes in order, or parts that are still to be put in order."


def _first_met_by_loops(
    loops: ModuleType, front: _Front, hits: Hits, rays: Rays, scene: Surfaces, air: Medium, model: SensorModel,
    reach_m: float,
) -> _FirstMet:  # fmt: skip
    """In even air; the sub-echoes in order."""
    if air.uneven:
        return OTHERWISE
    onward = None
    index, more, alpha = np.zeros(0, np.int64), np.zeros(0), air.extinction_per_m
    if bool(scene.special.any()):
        index = loops.special(hits.range_m, hits.material, scene.special, reach_m)
    if len(index):
        kind, length, cosine = hits.material[index], hits.range_m[index], hits.cosine[index]
        more = np.where(scene.table.apart.take(kind), scene.table.back(kind.astype(np.int64), cosine, length), 0.0)
        lit = _Lit(front.beam[index], length, cosine, more, kind)
        onward = _sent_on(lit, lambda at: alpha * length[at], front, hits, index, rays, scene, model)
    amplitude, keys, seen, nearest = loops.strengths(
        hits.range_m, hits.material, hits.cosine, front.beam, front.weight, len(rays.axis), reach_m, MOST_EMPTY,
        scene.table.factors, alpha, model.clear_depth if model.leave_out.clear_air else 0.0, model.k_m2,
        model.aperture_radius_m, model.overlap_start_m, model.overlap_full_m, index, more,
    )  # fmt: skip
    stopped = _stopped(front, onward)
    if seen and not len(keys):  # bundles of very different sizes
        at = indexes(hits.range_m <= reach_m)
        found = in_order(front.beam[at], hits.range_m[at], amplitude[at], stopped[at], hits.actor[at])
        return found, onward, nearest
    keys.sort(axis=1)
    (beam, source), (range_m, amplitude, blocked) = loops.in_order(
        keys, front.beam, hits.range_m, amplitude, stopped, hits.actor
    )
    return SubEchoes(beam, range_m, amplitude, blocked, source), onward, nearest


@by_loops(_first_met_by_loops, "special", "strengths", "in_order")
def _first_met(
    front: _Front, hits: Hits, rays: Rays, scene: Surfaces, air: Medium, model: SensorModel, reach_m: float
) -> _FirstMet:
    """What first rays meet: sub-echoes, what goes on, and (n,) the nearest range of each beam."""
    nearest = np.full(len(rays.axis), np.inf)
    index = indexes(hits.range_m <= reach_m)
    if not len(index):
        return [], None, nearest
    every = len(index) == len(rays.beam)
    found, onward = _meet(front, hits, None if every else index, rays, scene, air, model)
    starts = rays.beam.searchsorted(np.arange(len(rays.axis)))
    nearest = np.fmin.reduceat(hits.range_m, starts)
    nearest[np.isnan(nearest)] = np.inf
    share = _stopped(front, onward)
    share, actor = (share, hits.actor) if every else (share[index], hits.actor[index])
    return [(*found, share, actor)], onward, nearest


def _stopped(front: _Front, onward: _Onward | None) -> Floats:
    """Share of the light on the air before them that surfaces met by a front stop: all, or what a pane takes.

    Also behind panes of which no ray goes on: no surface is seen there, and the air sends back less than one.
    """
    assert front.air is not None
    if onward is None:
        return front.air
    stopped, through = front.air.copy(), onward.index[onward.passed :]
    stopped[through] -= front.air[through] * onward.share[onward.passed :] ** 2
    return stopped


def _sent_on(
    lit: _Lit, depth: Callable[[Ints], Floats], front: _Front, hits: Hits, chosen: Ints | None, rays: Rays,
    scene: Surfaces, model: SensorModel,
) -> _Onward | None:  # fmt: skip
    """Rays that go on from mirrors and panes; what these send straight back is added to the reflectance."""
    if not scene.sends_on or model.bounces < 1:
        return None
    glossy = indexes(scene.onward.take(lit.material))
    if not len(glossy):
        return None
    kind, facing = lit.material[glossy].astype(np.int64), lit.cosine[glossy]
    mirrored, through = scene.table.sent_on(kind, facing)
    turning, passing = indexes(mirrored > 0.0), indexes(through > 0.0)
    share, both = np.concatenate([mirrored[turning], through[passing]]), np.concatenate([turning, passing])
    index, count = glossy[both], len(turning)
    row = index if chosen is None else chosen[index]  # their numbers in the front
    direction, length = front.direction[row], lit.length_m[index]  # `take` would first copy all: coordinates are rows
    if count:
        normal = hits.normals(row[:count])
        if isinstance(front.length_m, float):  # a beam already turned has no axis to measure the tilt from
            at = index[:count]
            axis = rays.axis[lit.beam[at]]
            lit.reflectance[at] += _face_on(axis, normal, share[:count], length[:count], model)
        direction[:count] += 2.0 * facing[turning, None] * normal
    onward = _Onward(row, direction, share, length, depth(index), count)
    if scene.solid is not None:
        _enter(onward, hits, facing[passing], scene.table.refraction[kind[passing]], scene.solid)
    return onward


def _enter(one: _Onward, hits: Hits, cosine: Floats, refraction: Floats, solid: NDArray[np.bool_]) -> None:
    """Rays that enter a body of glass are bent; a sensor within one is taken for one in a hollow shell.

    `cosine`, `refraction` : of those that go through panes.
    """
    one.entered, one.refraction = np.full(len(one.index), -1, np.int64), np.ones(len(one.index))
    one.bent = one.direction.copy()
    through = one.index[one.passed :]
    body = hits.bodies(through)
    into = indexes(solid[body] & ~hits.inner[through])
    at = into + one.passed
    one.entered[at], one.refraction[at] = body[into], refraction[into]
    normal = hits.normals(through[into])
    one.bent[at] = brdf.refracted(one.direction[at], normal, cosine[into], 1.0 / refraction[into])


def collected(length_m: Floats, depth: Floats, model: SensorModel) -> Floats:
    """Amplitude of a white plate met face-on by the whole beam."""
    overlap: Floats | float = 1.0
    if length_m.size and float(length_m.min()) < max(model.overlap_start_m, model.overlap_full_m):
        overlap = radiometry.overlap(length_m, model.overlap_start_m, model.overlap_full_m)
    if model.leave_out.clear_air and depth.size and 2.0 * float(depth.min()) < model.clear_depth:
        lost = 1.0 - 2.0 * depth * (1.0 - depth)  # wrong by 2e-10 at the most, and no exponential
        dim = 2.0 * depth >= model.clear_depth  # each by its own depth: it does not depend on the others
        if bool(dim.any()):
            lost = np.where(dim, exp_or_zero(-2.0 * depth), lost)
    else:
        lost = exp_or_zero(-2.0 * depth)
    return np.asarray(model.k_m2 * overlap * lost / (length_m * length_m + model.aperture_radius_m**2))


def _face_on(axis: Floats, normal: Floats, mirrored: Floats, length: Floats, model: SensorModel) -> Floats:
    """Equivalent reflectance of a flat mirror that sends the beam back into the lens.

    The lens collects the share of the mirrored beam that falls on it: a disc off axis in a beam of radius w(2 R). Over
    what a white plate sends there, a^2 / (R^2 + a^2).
    """
    (n, m, o), (x, y, z) = normal.T, axis.T
    across = np.sqrt((m * z - o * y) ** 2 + (o * x - n * z) ** 2 + (n * y - m * x) ** 2)
    along = np.abs(n * x + m * y + o * z)
    radius_x, radius_y = model.beam.radius_m(2.0 * length)
    offset = 2.0 * length * across / np.maximum(along, 1e-6)
    near = offset < 6.0 * np.maximum(radius_x, radius_y) + model.aperture_radius_m
    extra = np.zeros(len(length))
    if bool(near.any()):
        a = model.aperture_radius_m
        fill = radiometry.fill_disc_offset(a, np.sqrt(radius_x * radius_y)[near], offset[near])
        lens = a * a / (length[near] ** 2 + a * a)
        extra[near] = mirrored[near] * fill / lens
    return extra


def _continue(
    front: _Front,
    hits: Hits,
    onward: _Onward | None,
    caster: Caster,
    scene: Surfaces,
    air: Medium,
    model: SensorModel,
    rays: Rays,
    reach_m: float,
    ways: Ways | None = None,
) -> list[Part]:
    """Ghost points and what lies behind glass: rays continued up to the allowed number of bounces."""
    # the first fronts carry their share of the beam: the bound is for a beam whose sub-rays all go the same way
    whole = len(rays.beam) / len(rays.axis)
    parts: list[Part] = []
    way = np.zeros(len(front.beam) if ways is not None else 0, np.int64)
    for bounce in range(model.bounces):
        if onward is None:
            break
        weight = front.weight[onward.index] * onward.share**2
        least = UNSEEN * model.threshold if model.leave_out.second_rays else 0.0
        kept = indexes((_best(weight, onward, whole, scene, model) > least) & (onward.length_m < reach_m))
        if not len(kept):
            break
        if ways is not None:
            way = 2 * way[onward.index[kept]] + (kept >= onward.passed)
        front = _sent(front, onward, kept, weight, hits)
        if scene.solid is not None:
            front = _come_out(front, caster, scene.solid)
        left = max(reach_m - float(np.min(front.length_m)), 0.0)
        hits = caster.first_hits(front.origin_m, front.direction, front.t_s, max_range_m=left, inside=front.inside)
        met = indexes(front.length_m + hits.range_m <= reach_m)
        if ways is not None and not len(met):
            ways.note(front.beam, way, hits, met, np.zeros(0), np.zeros(0))
        if not len(met):
            break
        found, onward = _meet(front, hits, met, rays, scene, air, model, last=bounce == model.bounces - 1)
        if ways is not None:
            ways.note(front.beam, way, hits, met, found[1], found[2])
        parts.append((*found, _stopped(front, onward)[met], hits.actor[met]))
    return parts


def _best(weight: Floats, onward: _Onward, whole: float, scene: Surfaces, model: SensorModel) -> Floats:
    """Amplitude of the best surface right behind, met by the whole beam; `weight` : of the rays that go on."""
    most = whole * scene.strongest * model.k_m2
    return np.asarray(most * weight / (onward.length_m**2 + model.aperture_radius_m**2))


def _sent(front: _Front, onward: _Onward, kept: Ints, weight: Floats, hits: Hits) -> _Front:
    """Those of the rays that are kept, from right behind the surfaces (`hits`) that sent them on."""
    assert front.air is not None
    index, length = onward.index[kept], onward.length_m[kept]
    direction, step = onward.direction.take(kept, axis=0), BEHIND_M * (1.0 + length / 1000.0)
    reached, first = length - _part(front.length_m, index), int(kept.searchsorted(onward.passed))
    origin = front.direction[index]
    origin *= reached[:, None]
    origin += front.origin_m[index]
    own, air = weight[kept], np.zeros(len(kept))
    air[first:] = front.air[index[first:]] * onward.share[kept[first:]] ** 2
    t_s, beam, depth = front.t_s[index], front.beam[index], onward.depth[kept]
    outward = hits.inner[index] == (kept >= onward.passed)  # mirrored outside, or let out
    inside = np.where(outward, -1, hits.bodies(index))
    if onward.entered is None:
        origin += direction * step[:, None]
        return _Front(origin, direction, t_s, beam, own, length + step, depth, air=air, inside=inside)
    assert onward.bent is not None
    assert onward.refraction is not None
    entered, bent, refraction = onward.entered[kept], onward.bent[kept], onward.refraction[kept]
    inside[entered >= 0] = -1  # of these it is followed where they come out
    length = length + step * np.where(entered >= 0, refraction, 1.0)
    return _Front(
        origin + bent * step[:, None], direction, t_s, beam, own, length, depth, entered, bent, refraction, air, inside
    )  # fmt: skip


def _come_out(front: _Front, caster: Caster, solid: NDArray[np.bool_]) -> _Front:
    """Rays in bodies of glass, where they leave them: later by the index, beside where they would have been.

    All losses of the pane, both its faces, were taken where it was entered. What is reflected wholly is lost. Bodies of
    glass that lie one in the other are one body. A ray that does not meet the body's inside goes straight on: the body
    is thinner than the step behind its face, or something stands in it.
    """
    assert front.entered is not None
    assert front.bent is not None
    assert front.index is not None
    inside = indexes(front.entered >= 0)
    if not len(inside):
        return front
    out, way, normal, cosine = _left(front, inside, caster, solid)
    at, bent = inside[out], front.bent[inside[out]]
    direction = brdf.refracted(bent, normal, cosine, front.index[at])
    lost = np.isnan(direction[:, 0])
    direction[lost] = bent[lost]
    length = np.array(front.length_m, np.float64)
    step = BEHIND_M * (1.0 + length[at] / 1000.0)
    columns = front.origin_m.copy(), front.direction.copy(), front.weight.copy()
    columns[0][at] += way[:, None] * bent + step[:, None] * direction
    columns[1][at] = direction
    columns[2][at] *= ~lost
    length[at] += front.index[at] * way + step
    origin, turned, weight = columns
    return _Front(
        origin, turned, front.t_s, front.beam, weight, length, front.depth, air=front.air, inside=front.inside
    )


def _left(front: _Front, inside: Ints, caster: Caster, solid: NDArray[np.bool_]) -> tuple[Ints, Floats, Floats, Floats]:
    """Which of the rays in glass come out, how far on, and normal and cosine of the face there."""
    assert front.entered is not None
    assert front.bent is not None
    origin, bent, t_s = front.origin_m[inside], front.bent[inside], front.t_s[inside]
    way = np.zeros(len(inside))
    within = np.full((len(inside), MOST_FACES), -1, np.int64)  # bodies that each is in
    within[:, 0] = front.entered[inside]
    going, found = np.arange(len(inside)), []
    for face in range(1, MOST_FACES):
        hits = caster.first_hits(origin[going] + way[going, None] * bent[going], bent[going], t_s[going])
        body = hits.body.astype(np.int64)
        glass = np.isfinite(hits.range_m) & (body >= 0) & solid[body]
        same = (within[going] == body[:, None]) & (glass & hits.inner)[:, None]
        within[going] = np.where(same, -1, within[going])
        out = indexes(same.any(axis=1) & (within[going] < 0).all(axis=1))
        found.append((going[out], way[going[out]] + hits.range_m[out], hits.normals(out), hits.cosine[out]))
        glass[out] = False
        on = indexes(glass)
        if not len(on):
            break
        row = going[on]
        within[row, face] = np.where(hits.inner[on], -1, body[on])
        way[row] += hits.range_m[on] + BEHIND_M
        going = row
    rows, ways, normals, cosines = (np.concatenate(column) for column in zip(*found, strict=True))
    order = np.argsort(rows)
    return rows[order], ways[order], normals[order], cosines[order]


def _part(column: Any, index: Ints) -> Any:
    """Those elements of a column, or the one number that stands for all of them."""
    return column if isinstance(column, float) else column[index]
