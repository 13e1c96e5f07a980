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

from emulator.physics import polygons
from emulator.physics.arrays import Bools, Floats, Ints, indexes, ramp
from emulator.physics.subechoes import Kept, SubEchoes
from emulator.sensing.contracts import FacedCaster, Medium
from emulator.sensing.model import SensorModel
from emulator.sensing.paths import Seen, Surfaces, collected, reach_of, window_factors
from emulator.sensing.rays import Bundles, turned
from emulator.sensing.sheets import Faced, Frames, Radii, Sheets, bright_of
from emulator.sensing.tails import Ways, of_bundles, on_rings
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
        found = seen.found.replaced(mine, echoes)
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
        mine = np.zeros(len(t_s), bool)
        mine[faced.beam[ahead.pair]] = True
        others = seen.found.of_beams(mine)
        if seen.kept is not None:
            others = SubEchoes.joined(others, seen.kept.found.of_beams(mine & ~seen.kept.changed))
        own = of_bundles(faced, bundles, seen_of, frames)
        amplitude = self._amplitudes(faced, Ways.joined(ahead, own), factor, frames, surfaces, air)
        # those of the bundle's rays that are hidden are no echoes
        others = _without(others, _echoes(faced, own, amplitude[len(ahead) :]))
        return SubEchoes.joined(others, _echoes(faced, ahead, amplitude[: len(ahead)])), Tails(indexes(mine), cast)

    def _towards(
        self, faced: Faced, middle: Floats, light: Floats, frames: Frames, reach_m: float
    ) -> tuple[Ways, Bools, int]:
        """Rays to faces, finer ones where something hides a part; of which faces any is seen; how many were cast."""
        outer = np.clip(np.sqrt(0.5 * np.log(np.maximum(light / UNSEEN, 1.0))), 1.0, MOST_RADII)
        outer = np.maximum(outer, faced.offset + 0.3)
        every = np.arange(len(faced))
        ahead = self._open(on_rings(faced, frames, *ROUGH, outer, every, middle), faced, frames, reach_m)
        cast, seen, hidden = (
            len(ahead),
            *(np.bincount(ahead.pair, k, len(faced)) > 0 for k in (ahead.open, ~ahead.open)),
        )
        part = seen & hidden
        if not bool(part.any()):
            return ahead, seen, cast
        more = self._open(on_rings(faced, frames, *FINE, outer, indexes(part), None), faced, frames, reach_m)
        part &= np.bincount(more.pair, minlength=len(faced)) > 0  # slivers between all of these keep what they have
        return Ways.joined(ahead.taken(indexes(~part[ahead.pair])), more), seen, cast + len(more)

    # ------------------------------------------------------------------ bounds
    def _radii(self, gain: float) -> Radii:
        """Beam radii beyond which all the light on such a surface cannot be seen."""
        model = self._model
        floor_m = math.sqrt(model.floor_m2 / model.threshold)
        white = model.k_m2 * max(gain, 1e-12) / model.threshold
        return Radii(floor_m, white, model.aperture_radius_m**2, UNSEEN, LEAST_RADII, MOST_RADII)

    # ------------------------------------------------------------------ rays
    def _open(self, ways: Ways, faced: Faced, frames: Frames, reach_m: float) -> Ways:
        """Rays to faces, and before which of these nothing stands."""
        if not len(ways):
            return ways
        t_s, range_m = frames.t_s[faced.beam[ways.pair]], ways.range_m
        hits = self._caster.first_hits(ways.origin_m, ways.ray, t_s, max_range_m=reach_m)
        nearer = hits.range_m < range_m - NEARER_M - 1e-4 * range_m
        return replace(ways, open=~nearer & (range_m > 0.0) & (range_m <= reach_m))

    def _amplitudes(
        self, faced: Faced, ways: Ways, factor: Floats, frames: Frames, surfaces: Surfaces, air: Medium
    ) -> Floats:
        """(k,) of what comes back from faces at the ends of rays."""
        pair = ways.pair
        beam = faced.beam[pair]
        depth = air.depth(ways.origin_m, ways.ray, ways.range_m, frames.t_s[beam])
        normal = np.einsum("kij,ki->kj", faced.across[pair], faced.normal[pair])
        cosine = np.minimum(np.abs(np.einsum("ki,ki->k", normal, ways.ray)), 1.0)
        back = surfaces.table.back(faced.material[pair], cosine, ways.range_m)
        return np.asarray(ways.weight * factor[beam] * collected(ways.range_m, depth, self._model) * back)


def _echoes(faced: Faced, ways: Ways, amplitude: Floats) -> SubEchoes:
    """Of faces at the ends of rays."""
    return SubEchoes.of(faced.beam[ways.pair], ways.range_m, amplitude, None, faced.actor[ways.pair])


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
