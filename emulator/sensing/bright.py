"""Bright edges: the tail of a beam beside surfaces so bright that the millionth part of it is seen.

Belongs here: which beams those are, what their bright faces get of the beam, and which part of that is hidden. Not:
bundles (rays), the light on a polygon (physics.polygons), which faces are bright and where they are (sheets).

A bundle of equal shares ends where its outermost ray goes, and counts an edge in whole rays. Of a beam near a bright
face's edge, what bright faces send back is therefore not taken from its bundle: the light on each face is known in
closed form, and rays to it show how much of that is hidden, and from how far the rest comes. All else that the beam
meets is still its bundle's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from emulator.physics import beams, polygons
from emulator.physics.arrays import Bools, Floats, Ints, indexes, ramp
from emulator.physics.subechoes import Kept, SubEchoes
from emulator.sensing.contracts import FacedCaster, Medium
from emulator.sensing.model import SensorModel
from emulator.sensing.paths import Seen, Surfaces, collected, reach_of, window_factors
from emulator.sensing.rays import Bundles, turned
from emulator.sensing.sheets import Faced, Frames, Radii, Sheets, across_own, bright_of
from emulator.world.motion import Pose

if TYPE_CHECKING:
    from emulator.world.scene import Scene

UNSEEN = 0.02
"Of the threshold: what bright faces may bring back before a beam is looked after."
INSIDE = 0.25
"A beam of which so much falls on bright faces has them to a few per cent by its bundle: fifteen rays of 61."
MOST_RADII = 4.5
LEAST_RADII = 1.0
"Where any of it is seen: 1e-6 of a half plane's light then keeps its two digits."
ROUGH = 0.35, 9
"Between rings, in beam radii, and rays on each: whether anything hides a part of a face."
FINE = 0.08, 48
"The same where something does: how much of it."
MIDDLE = 0.5
"Of a face's light for the ray to its middle, where nothing hides it."
NEARER_M = 2e-3
"What is met so much before a face, and 1e-4 of the way, hides it."
SAME, AS_BRIGHT = 1e-3, 0.01
"Of range, and of amplitude: an echo of the bundle that comes from a bright face."


@dataclass(frozen=True, eq=False)
class Tails:
    """What was done for bright edges in a sweep."""

    beams: Ints
    "Whose bright faces have their own rays."
    rays: int
    "Cast for it, also to faces that were hidden."


@dataclass(frozen=True, eq=False)
class _Nodes:
    """Places in beams where faces are."""

    pair: Ints
    u: Floats
    v: Floats
    weight: Floats

    def __len__(self) -> int:
        return len(self.pair)


_NONE = _Nodes(np.zeros(0, np.int64), np.zeros(0), np.zeros(0), np.zeros(0))


@dataclass(frozen=True, eq=False)
class _Ways:
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

    def taken(self, at: Ints) -> _Ways:
        """Some of them."""
        return _Ways(*(column[at] for column in vars(self).values()))

    @classmethod
    def joined(cls, one: _Ways, other: _Ways) -> _Ways:
        """Both."""
        return cls(*(np.concatenate(both) for both in zip(vars(one).values(), vars(other).values(), strict=True)))


def wanted(model: SensorModel, scene: Scene, surfaces: Surfaces) -> bool:
    """Beams of this sensor have a tail, and there is a surface that may show it."""
    if model.sidelobe_share > 0.0:  # their rays are there instead
        return False
    if model.beam.is_ray or model.beam.profile != "gauss" or model.rule in ("axis", "adaptive"):
        return False
    bright = bright_of(surfaces.table)
    return any(body.frames is None and bool(bright[body.face_material].any()) for body in scene.bodies)


class BrightEdges:
    """Finds the beams of one sensor near the edges of bright surfaces, and what these send back."""

    def __init__(
        self, scene: Scene, model: SensorModel, caster: FacedCaster, surfaces: Surfaces, at_rest: bool
    ) -> None:
        self._model, self._caster = model, caster
        self._sheets = Sheets(scene, surfaces.table)
        self._all_still = at_rest and model.leave_out.resting and all(body.still for body in scene.bodies)
        self._kept: tuple[tuple[object, ...], tuple[object, ...], tuple[SubEchoes, Tails]] | None = None

    @np.errstate(under="ignore")
    def put_into(
        self, seen: Seen, bundles: Bundles, pose: Pose, t_s: Floats, surfaces: Surfaces, air: Medium, gain: float,
        farthest_m: float,
    ) -> tuple[Seen, Tails]:  # fmt: skip
        """What a sweep brings back, the beams near bright edges renewed."""
        key = id(bundles), id(surfaces), id(air), gain, farthest_m
        if self._kept is None or self._kept[0] != key or not self._all_still or air.uneven:
            made = self._made(seen, bundles, pose, t_s, surfaces, air, gain, farthest_m)
            self._kept = key, (bundles, surfaces, air), made
        echoes, tails = self._kept[2]
        if not len(tails.beams):
            return seen, tails
        mine = np.zeros(len(bundles.axis), bool)
        mine[tails.beams] = True
        found = SubEchoes.joined(seen.found.of_beams(~mine), echoes)
        kept = None if seen.kept is None else Kept(seen.kept.found, seen.kept.changed | mine)
        return replace(seen, found=found, kept=kept), tails

    def _made(
        self, seen: Seen, bundles: Bundles, pose: Pose, t_s: Floats, surfaces: Surfaces, air: Medium, gain: float,
        farthest_m: float,
    ) -> tuple[SubEchoes, Tails]:  # fmt: skip
        """All sub-echoes of the beams near bright edges."""
        model, reach = self._model, reach_of(self._model, farthest_m)
        axis = turned(pose.rotation, bundles.axis[:, None, :])[:, 0]
        none = SubEchoes.none(), Tails(np.zeros(0, np.int64), 0)
        frames = Frames(pose, bundles.axis, axis, t_s, model.beam)
        radii = self._radii(gain)
        faced = self._sheets.near(frames, radii, reach)
        if not len(faced):
            return none
        share, middle = polygons.gaussian_share(faced.corner)
        middle_m = faced.range_m(np.arange(len(faced)), middle[:, 0], middle[:, 1], model.beam)
        light = radii.bound(middle_m, faced.strength)
        whole = np.bincount(faced.beam, share, len(t_s))
        asked = (whole < INSIDE) & (np.bincount(faced.beam, share * light, len(t_s)) >= UNSEEN)
        chosen = indexes(asked[faced.beam] & (share * light > 0.1 * UNSEEN))
        if not len(chosen):
            return none
        faced, share, middle, light = faced.taken(chosen), share[chosen], middle[chosen], light[chosen]
        ahead, seen_of, cast = self._towards(faced, middle, light, frames, reach)
        lit = indexes(ahead.open)
        if not len(lit):
            return SubEchoes.none(), Tails(np.zeros(0, np.int64), cast)
        sums = np.maximum(np.bincount(ahead.pair, ahead.weight, len(faced)), 1e-300)
        ahead = replace(ahead, weight=ahead.weight * (share / sums)[ahead.pair]).taken(lit)
        factor = window_factors(bundles.axis, model, gain)
        bright = self._echoes(faced, ahead, factor, frames, surfaces, air)
        mine = np.zeros(len(t_s), bool)
        mine[faced.beam[ahead.pair]] = True
        others = seen.found.of_beams(mine)
        if seen.kept is not None:
            others = SubEchoes.joined(others, seen.kept.found.of_beams(mine & ~seen.kept.changed))
        own = self._bundled(faced, bundles, seen_of, frames)
        # those of the bundle's rays that are hidden are no echoes
        others = _without(others, self._echoes(faced, own, factor, frames, surfaces, air))
        return SubEchoes.joined(others, bright), Tails(indexes(mine), cast)

    def _towards(
        self, faced: Faced, middle: Floats, light: Floats, frames: Frames, reach_m: float
    ) -> tuple[_Ways, Bools, int]:
        """Rays to faces, finer ones where something hides a part; of which faces any is seen; how many were cast."""
        outer = np.clip(np.sqrt(0.5 * np.log(np.maximum(light / UNSEEN, 1.0))), 1.0, MOST_RADII)
        outer = np.maximum(outer, faced.offset + 0.3)
        ahead = self._open(_with_middle(_rings(faced, *ROUGH, outer), middle), faced, frames, reach_m)
        cast, seen, hidden = (
            len(ahead),
            *(np.bincount(ahead.pair, k, len(faced)) > 0 for k in (ahead.open, ~ahead.open)),
        )
        part = seen & hidden
        if not bool(part.any()):
            return ahead, seen, cast
        more = self._open(_rings(faced, *FINE, outer, indexes(part)), faced, frames, reach_m)
        part &= np.bincount(more.pair, minlength=len(faced)) > 0  # slivers between all of these keep what they have
        return _Ways.joined(ahead.taken(indexes(~part[ahead.pair])), more), seen, cast + len(more)

    def _radius(self, bundles: Bundles) -> float:
        """Where the outermost ray of these bundles goes, in beam radii, and a little more; infinite: not known."""
        shape = self._model.beam
        narrow = min(shape.half_angle_x_rad, shape.half_angle_y_rad)
        if narrow < beams.NO_WIDTH or not len(bundles.axis):
            return math.inf
        along = np.minimum(bundles.direction[0] @ bundles.axis[0], 1.0).min()
        return 1.01 * math.tan(math.acos(float(along))) / math.tan(narrow)

    # ------------------------------------------------------------------ bounds
    def _radii(self, gain: float) -> Radii:
        """Beam radii beyond which all the light on such a surface cannot be seen."""
        model = self._model
        floor_m = math.sqrt(model.floor_m2 / model.threshold)
        white = model.k_m2 * max(gain, 1e-12) / model.threshold
        return Radii(floor_m, white, model.aperture_radius_m**2, UNSEEN, LEAST_RADII, MOST_RADII)

    # ------------------------------------------------------------------ rays
    def _bundled(self, faced: Faced, bundles: Bundles, some: Bools, frames: Frames) -> _Ways:
        """Rays of the beams' own bundles towards some of these faces."""
        shape = self._model.beam
        inner = indexes(some & (faced.offset <= self._radius(bundles)))
        if not len(inner):
            return self._ways(faced, _NONE, frames)
        beam, row = np.unique(faced.beam[inner], return_inverse=True)
        across = across_own(bundles.axis[beam], shape)
        if shape.half_angle_x_rad >= beams.NO_WIDTH and shape.half_angle_y_rad >= beams.NO_WIDTH:
            own = np.einsum("nmj,nij->nmi", bundles.direction[beam], across)
            scale = np.array([math.tan(shape.half_angle_x_rad), math.tan(shape.half_angle_y_rad)])
            place = own[:, :, :2] / np.maximum(own[:, :, 2:], 1e-9) / scale
        else:
            assert bundles.start_m is not None
            place = np.einsum("nmj,nij->nmi", bundles.start_m[beam], across)[:, :, :2] / shape.exit_radius_m
        pair, node = np.nonzero(polygons.within(faced.corner[inner], place[row]))
        spot = place[row[pair], node]
        return self._ways(faced, _Nodes(inner[pair], spot[:, 0], spot[:, 1], bundles.share[node]), frames)

    def _ways(self, faced: Faced, nodes: _Nodes, frames: Frames) -> _Ways:
        """Their rays in the world up to the faces' planes, whatever stands before them."""
        range_m = faced.range_m(nodes.pair, nodes.u, nodes.v, self._model.beam)
        origin, ray = frames.rays(faced.beam[nodes.pair], faced.across[nodes.pair], nodes.u, nodes.v)
        return _Ways(nodes.pair, nodes.weight, origin, ray, range_m, range_m > 0.0)

    def _open(self, nodes: _Nodes, faced: Faced, frames: Frames, reach_m: float) -> _Ways:
        """The same, and whether anything does."""
        ways = self._ways(faced, nodes, frames)
        if not len(ways):
            return ways
        t_s, range_m = frames.t_s[faced.beam[ways.pair]], ways.range_m
        hits = self._caster.first_hits(ways.origin_m, ways.ray, t_s, max_range_m=reach_m)
        nearer = hits.range_m < range_m - NEARER_M - 1e-4 * range_m
        return replace(ways, open=~nearer & (range_m > 0.0) & (range_m <= reach_m))

    def _echoes(
        self, faced: Faced, ways: _Ways, factor: Floats, frames: Frames, surfaces: Surfaces, air: Medium
    ) -> SubEchoes:
        """Of faces at the ends of rays."""
        pair = ways.pair
        if not len(pair):
            return SubEchoes.none()
        beam = faced.beam[pair]
        depth = air.depth(ways.origin_m, ways.ray, ways.range_m, frames.t_s[beam])
        normal = np.einsum("kij,ki->kj", faced.across[pair], faced.normal[pair])
        cosine = np.minimum(np.abs(np.einsum("ki,ki->k", normal, ways.ray)), 1.0)
        back = surfaces.table.back(faced.material[pair], cosine, ways.range_m)
        amplitude = ways.weight * factor[beam] * collected(ways.range_m, depth, self._model) * back
        return SubEchoes.of(beam, ways.range_m, amplitude, None, faced.actor[pair])


def _rings(faced: Faced, step: float, count: int, outer: Floats, pairs: Ints | None = None) -> _Nodes:
    """Nodes on rings that fall on faces, weighted by the light on their cells; from a face's nearest place outwards."""
    pairs = np.arange(len(faced)) if pairs is None else pairs
    if not len(pairs):
        return _NONE
    edge = np.arange(0.0, float(outer[pairs].max()) + step, step)
    radius = 0.5 * (edge[1:] + edge[:-1])
    light = np.exp(-2.0 * edge[:-1] ** 2) - np.exp(-2.0 * edge[1:] ** 2)
    turn = 2.0 * np.pi / count * (np.arange(count) + beams.GOLDEN_ANGLE_RAD * np.arange(len(radius))[:, None])
    u, v = (radius[:, None] * np.cos(turn)).ravel(), (radius[:, None] * np.sin(turn)).ravel()
    ring, place = np.repeat(radius, count), np.stack([u, v], axis=1)[None]
    # as far as the rings would go for this face alone: what it brings back does not depend on the others
    near, far = (faced.offset[pairs] - step)[:, None], (outer[pairs] + 0.5 * step)[:, None]
    row, node = np.nonzero((ring >= near) & (ring < far) & polygons.within(faced.corner[pairs], place))
    return _Nodes(pairs[row], u[node], v[node], np.repeat(light / count, count)[node])


def _with_middle(nodes: _Nodes, middle: Floats) -> _Nodes:
    """And one in the middle of each face's light."""
    pairs = len(middle)
    rest = np.bincount(nodes.pair, nodes.weight, pairs)
    weight = np.where(rest > 0.0, rest * (MIDDLE / (1.0 - MIDDLE)), 1.0)
    return _Nodes(
        np.concatenate([np.arange(pairs), nodes.pair]), np.concatenate([middle[:, 0], nodes.u]),
        np.concatenate([middle[:, 1], nodes.v]), np.concatenate([weight, nodes.weight]),
    )  # fmt: skip


def _without(others: SubEchoes, counted: SubEchoes) -> SubEchoes:
    """Echoes of bundles less those that are counted otherwise; what these stand before stays dark."""
    if not len(others) or not len(counted):
        return others
    amplitude = others.amplitude.copy()
    length = float(others.range_m[-1] if len(others) == 1 else others.range_m.max()) + 1e3
    key, middle = others.beam * length + others.range_m, counted.beam * length + counted.range_m
    about = SAME * counted.range_m
    first, last = key.searchsorted(middle - about), key.searchsorted(middle + about)
    many = last - first
    mine, at = np.arange(len(counted)).repeat(many), first.repeat(many) + ramp(many)
    same = (others.beam[at] == counted.beam[mine]) & (others.source[at] == counted.source[mine])
    same &= np.abs(others.amplitude[at] - counted.amplitude[mine]) <= AS_BRIGHT * counted.amplitude[mine]
    amplitude[at[same]] = 0.0
    kept = indexes((amplitude > 0.0) | (others.blocked > 0.0))
    dark = replace(others, amplitude=amplitude)
    spread = None if dark.spread_m is None else dark.spread_m[kept]
    return SubEchoes(
        dark.beam[kept], dark.range_m[kept], dark.amplitude[kept], dark.blocked[kept], dark.source[kept], spread
    )
