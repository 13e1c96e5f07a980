"""What a sensor at rest sees of what rests: computed once, and looked up for all beams before which nothing moves.

Belongs here: the rays that come again, which of their beams differ in a sweep, and these beams alone. Not: what any
beam brings back (paths), whose signals the receiver keeps (receiver).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from emulator.physics.arrays import Ints, indexes
from emulator.physics.subechoes import Kept, SubEchoes
from emulator.sensing.contracts import AgainHits, FacedCaster, Medium
from emulator.sensing.model import SensorModel
from emulator.sensing.paths import Seen, Surfaces, returned
from emulator.sensing.rays import Bundles, Rays

MOST_CHANGED = 0.6
"Share of beams that may differ: beyond it all are computed."


class Resting:
    """Rays of a sensor that does not move."""

    def __init__(self, bundles: Bundles, rays: Rays) -> None:
        self.bundles, self.rays = bundles, rays
        self._base: Seen | None = None
        self._same: Seen
        "The base, for sweeps in which nothing differs from it."
        self._of: tuple[object, ...] = ()
        "What the base depends on."
        self._held: tuple[object, ...] = ()
        "Holds those whose identity is in `_of`."
        self._onward = np.zeros(0, np.int64)
        "Beams of which light goes on: it may meet what moves."

    def seen(
        self, rays: Rays, caster: FacedCaster, far: float, surfaces: Surfaces, air: Medium, model: SensorModel,
        gain: float, farthest_m: float,
    ) -> Seen:  # fmt: skip
        """What `rays`, these at the instants of a sweep, bring back; the same object where nothing differs."""
        hits = caster.renewed(rays.origin_m, rays.direction, rays.t_s, far)
        if air.uneven:
            return returned(hits.hits, rays, caster, surfaces, air, model, gain, farthest_m)
        base = self._at_rest(hits.resting, rays, caster, surfaces, air, model, gain, farthest_m)
        changed = np.zeros(len(rays.axis), bool)
        changed[rays.beam[hits.rays]] = True
        changed[self._onward] = True
        beams = indexes(changed)
        if not len(beams):
            return self._same
        if len(beams) > MOST_CHANGED * len(changed):
            return returned(hits.hits, rays, caster, surfaces, air, model, gain, farthest_m)
        index = _rays_of(beams, self.bundles.sub_beams)
        now = hits.resting.taken(index)
        now.put(index.searchsorted(hits.rays), hits.now)
        part = returned(now, _part(rays, beams, index), caster, surfaces, air, model, gain, farthest_m)
        nearest, material, normal = base.nearest_m.copy(), base.axis_material.copy(), base.axis_normal.copy()
        nearest[beams], material[beams], normal[beams] = part.nearest_m, part.axis_material, part.axis_normal
        axis_m = base.axis_m.copy()
        axis_m[beams] = part.axis_m
        found = replace(part.found, beam=beams[part.found.beam])
        return Seen(found, nearest, material, axis_m, normal, Kept(base.found, changed))

    def _at_rest(
        self, hits: AgainHits, rays: Rays, caster: FacedCaster, surfaces: Surfaces, air: Medium, model: SensorModel,
        gain: float, farthest_m: float,
    ) -> Seen:  # fmt: skip
        of = id(hits), id(surfaces), id(air), gain, farthest_m
        if self._base is None or self._of != of:
            self._base = returned(hits, rays, caster, surfaces, air, model, gain, farthest_m)
            self._of, self._held = of, (hits, surfaces, air)
            kept = Kept(self._base.found, np.zeros(len(rays.axis), bool))
            self._same = replace(self._base, found=SubEchoes.none(), kept=kept)
            self._onward = np.zeros(0, np.int64)
            if caster.moves and surfaces.sends_on and model.bounces > 0:
                on = indexes((hits.material >= 0) & surfaces.onward[hits.material])
                self._onward = np.unique(rays.beam[on])
        return self._base


def with_others(seen: Seen, others: list[SubEchoes]) -> tuple[SubEchoes, Kept | None]:
    """The sub-echoes of a sweep with those of drops and the like, and what is kept of it all the same."""
    if not others:
        return seen.found, seen.kept
    kept = seen.kept
    if kept is None:
        return SubEchoes.joined(seen.found, *others), None
    changed = kept.changed.copy()
    for one in others:
        changed[one.beam] = True
    if np.count_nonzero(changed) > MOST_CHANGED * len(changed):
        return SubEchoes.joined(seen.echoes, *others), None
    more = kept.found.of_beams(changed & ~kept.changed)
    return SubEchoes.joined(seen.found, more, *others), Kept(kept.found, changed)


def _rays_of(beams: Ints, sub_beams: int) -> Ints:
    return np.asarray((beams[:, None] * sub_beams + np.arange(sub_beams)).ravel())


def _part(rays: Rays, beams: Ints, index: Ints) -> Rays:
    """Those of some beams, numbered again."""
    sub_beams = len(index) // len(beams)
    number = np.arange(len(beams))
    return Rays(
        origin_m=rays.origin_m[index],
        direction=rays.direction[index],
        t_s=rays.t_s[index],
        beam=number.repeat(sub_beams),
        share=rays.share[index],
        nearest_axis=rays.nearest_axis[beams] + (number - beams) * sub_beams,
        centre_m=rays.centre_m[beams],
        axis=rays.axis[beams],
        own_axis=rays.own_axis[beams],
    )
