"""First hits where a face is not all there is to see: bodies full of leaves, and faces with textures.

Belongs here: rays that go on behind the hull of a body of leaves, and what stands within and behind it; the material
and the normal of a texel. Not: faces (raycast), where leaves are (physics.foliage), what a picture says (mesh_maps).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar, cast

import numpy as np

from emulator.casting.hits import Around, Hits, LateHits, Renewed
from emulator.casting.raycast import Caster
from emulator.physics import foliage
from emulator.physics.arrays import indexes
from emulator.physics.foliage import Walks
from emulator.physics.materials import LEVELS, Material, material_from_mapping, with_levels
from emulator.scenario.scenario import Scenario
from emulator.world.batched_poses import Flags, Longs
from emulator.world.scene import Scene
from emulator.world.triangles import Floats

AnyCaster = TypeVar("AnyCaster")
BEHIND_M = 1e-4
"Behind a hull a search begins so far, and a thousandth of it more per metre: the caster works in float32."
MOST_HULLS = 256
"Faces of hulls that one ray passes; beyond them it meets nothing."
NESTED = 8
"Hulls within each other that a ray is in at a time; of more the outermost is forgotten."
KEPT = 16
PLAIN = Material("", ())
"Of those that ship with the package none has leaves or maps."


@dataclass(eq=False)
class _Front:
    """k rays on their way: their number among all, how far they are, and the hulls that they are in."""

    ray: Longs
    gone_m: Floats
    "To the last hull."
    within: Longs
    "(k, NESTED) body and material as one number, the last entered first; -1: none."

    def taken(self, at: Longs) -> _Front:
        return _Front(self.ray[at], self.gone_m[at], self.within[at])


class DetailedCaster:
    """A caster that knows what faces stand for; of a scene without such bodies none is made."""

    def __init__(self, bare: Caster, scene: Scene, materials: Sequence[Material], seed: int) -> None:
        """`materials`: those of the scene."""
        self.bare = bare
        "Of faces alone."
        self._scene = scene
        self.materials = materials
        self._leaves = [one.foliage for one in materials]
        self._leafy = np.array([one is not None for one in self._leaves], bool)
        self._maps = [one.maps for one in materials]
        self._mapped = np.array([one is not None for one in self._maps], bool)
        self._first = with_levels(materials)[1]
        self._keys = [foliage.key_of(seed, number) for number in range(len(scene.bodies))]
        self._kept: tuple[tuple[Hits, Hits, Longs], ...] = ()
        "Of rays that come again: hits on faces, what is made of them, rays that go on. The latest last."

    @property
    def moves(self) -> bool:
        """As of the bare one."""
        return self.bare.moves

    @property
    def movers(self) -> int:
        """As of the bare one."""
        return self.bare.movers

    def may_lie_beyond(self, origin_m: Floats, direction: Floats, t_s: Floats, beyond_m: float) -> Flags:
        """As of the bare one."""
        return self.bare.may_lie_beyond(origin_m, direction, t_s, beyond_m)

    def around(self, origin_m: Floats, t_s: Floats, far: float) -> Around | None:
        """None: hits are not all that is to be known of faces."""
        return None

    def first_hits(
        self, origin_m: Floats, direction: Floats, t_s: Floats | float, *, max_range_m: float = np.inf,
        again: bool = False, aimed: bool = False, order: Longs | None = None, inside: Longs | None = None,
    ) -> Hits | LateHits:  # fmt: skip
        """What each ray meets first, as of `raycast.Caster`; a leaf has its own normal, and no inside."""
        if again:
            return self.renewed(origin_m, direction, t_s, max_range_m).hits
        hits = self.bare.first_hits(
            origin_m, direction, t_s, max_range_m=max_range_m, aimed=aimed, order=order, inside=inside
        )
        at = self._onward(hits)
        if len(at):
            hits = self._behind(_writable(hits), at, origin_m, direction, t_s, max_range_m)
        return self._put_maps(hits, origin_m, direction, t_s)

    def renewed(self, origin_m: Floats, direction: Floats, t_s: Floats | float, max_range_m: float = np.inf) -> Renewed:
        """First hits of rays that come again, distinguished; those that go on behind a hull are new where bodies
        move."""
        bare = self.bare.renewed(origin_m, direction, t_s, max_range_m)
        known = next((one for one in self._kept if one[0] is bare.resting), None)
        if known is None:
            onward = self._onward(bare.resting)
            hits: Hits | LateHits = bare.resting
            if len(onward):
                hits = self._behind(_writable(hits), onward, origin_m, direction, t_s, max_range_m)
            hits = self._put_maps(hits, origin_m, direction, t_s)
            known = bare.resting, hits if isinstance(hits, Hits) else hits.whole, onward
            self._kept = (*self._kept[-KEPT + 1 :], known)
        _, made, onward = known
        rays = np.union1d(onward, bare.rays) if self.bare.moves else bare.rays
        if not len(rays):
            return Renewed(made, bare.rays, bare.now)
        times = np.broadcast_to(np.asarray(t_s, np.float64), (len(direction),))[rays]
        now = self.first_hits(origin_m[rays], direction[rays], times, max_range_m=max_range_m)
        return Renewed(made, rays, now if isinstance(now, Hits) else now.whole)

    def _put_maps(
        self, hits: Hits | LateHits, origin_m: Floats, direction: Floats, t_s: Floats | float
    ) -> Hits | LateHits:
        """The hits with the reflectance and the normal of the texel, or the vertices, where faces have such."""
        at = indexes(self._mapped.take(hits.material, mode="wrap") & (hits.material >= 0))
        if not len(at):
            return hits
        found = _writable(hits)
        origin = np.broadcast_to(np.asarray(origin_m, np.float64), direction.shape)
        times = np.broadcast_to(np.asarray(t_s, np.float64), (len(direction),))
        body = found.body[at]
        for number in np.unique(body).tolist():
            rays = at[body == number]
            one = self._scene.bodies[number]
            geometry, maps = one.geometry, one.geometry.maps
            if maps is None:
                continue
            pose = one.motion.pose(times[rays])
            place = origin[rays] + found.range_m[rays, None] * direction[rays] - pose.position_m
            local = np.einsum("nji,nj->ni", pose.rotation, place)
            face = found.face[rays]
            corner = geometry.faces[face].astype(np.int64)
            corners = geometry.vertices[corner]
            share = _shares(local, corners)
            part = geometry.face_part[face]
            for which in np.unique(part).tolist():
                k = indexes(part == which)
                material = int(one.part_material[which])
                wanted = self._maps[material]
                if wanted is None:
                    continue
                if wanted.reflectance is not None:
                    light = maps.luminance(which, corner[k], share[k])
                    level = np.rint(light * (LEVELS - 1)).astype(np.int32)
                    found.material[rays[k]] = self._first[material] + level
                if wanted.normals:
                    flat = geometry.normals[face[k]]
                    normal = maps.normals(which, corner[k], share[k], corners[k], flat)
                    along = direction[rays[k]]
                    side = np.where(np.einsum("nij,nj,ni->n", pose.rotation[k], flat, along) > 0.0, -1.0, 1.0)
                    world = side[:, None] * np.einsum("nij,nj->ni", pose.rotation[k], normal)
                    found.normal[rays[k]] = world
                    found.cosine[rays[k]] = np.maximum(-np.einsum("ij,ij->i", world, along), 0.0)
        return found

    def _onward(self, hits: Hits | LateHits) -> Longs:
        """Rays that meet a hull first."""
        return indexes(self._leafy.take(hits.material, mode="wrap") & (hits.material >= 0))

    def _behind(
        self, hits: Hits, at: Longs, origin_m: Floats, direction: Floats, t_s: Floats | float, far_m: float
    ) -> Hits:
        """The hits, with what the rays `at` meet in hulls and behind them."""
        count = len(direction)
        origin = np.broadcast_to(np.asarray(origin_m, np.float64), (count, 3))
        times = np.broadcast_to(np.asarray(t_s, np.float64), (count,))
        front = _Front(at, np.zeros(len(at)), np.full((len(at), NESTED), -1, np.int64))
        met = hits.taken(at)
        for _ in range(MOST_HULLS):
            hull = self._leafy.take(met.material, mode="wrap") & (met.material >= 0)
            medium = front.within[:, 0].copy()
            started = hull & met.inner & (medium < 0)  # the ray began in it
            medium[started] = self._medium(met)[started]
            inside = indexes((medium >= 0) & ((met.range_m > front.gone_m) | (met.body < 0)))
            stopped = np.zeros(len(front.ray), bool)
            if len(inside):
                end = np.where(met.body[inside] >= 0, met.range_m[inside], far_m)
                end = np.where(np.isfinite(end), end, front.gone_m[inside])
                rays = front.ray[inside]
                found, which = self._leaves_met(
                    medium[inside], origin[rays], direction[rays], times[rays], front.gone_m[inside], end
                )
                hits.put(rays[which], found)
                stopped[inside[which]] = True
            done = ~stopped & ~hull
            hits.put(front.ray[done], met.taken(indexes(done)))
            on = indexes(~stopped & hull)
            if not len(on):
                return hits
            front, met = front.taken(on), met.taken(on)
            _pass(front, met, self._medium(met), len(self._leaves))
            step = BEHIND_M * (1.0 + met.range_m / 1000.0)
            front.gone_m = met.range_m
            rays = front.ray
            start = origin[rays] + (front.gone_m + step)[:, None] * direction[rays]
            left = max(far_m - float(front.gone_m.min()), 0.0)
            next_ = self.bare.first_hits(start, direction[rays], times[rays], max_range_m=left)
            met = _writable(next_)
            met.range_m[:] += front.gone_m + step
            beyond = indexes(met.range_m > far_m)
            met.put(beyond, Hits.misses(len(beyond)))
        hits.put(front.ray, Hits.misses(len(front.ray)))
        return hits

    def _leaves_met(
        self, medium: Longs, origin: Floats, direction: Floats, times: Floats, begin: Floats, end: Floats
    ) -> tuple[Hits, Longs]:
        """Hits on leaves of rays within these bodies (k,), and which of the rays these are."""
        parts, which = [Hits.misses(0)], [np.zeros(0, np.int64)]
        for one in np.unique(medium).tolist():
            rays = indexes(medium == one)
            number, material = divmod(one, len(self._leaves))
            body, leaves = self._scene.bodies[number], self._leaves[material]
            assert leaves is not None
            pose = body.motion.pose(times[rays])
            local = np.einsum("nji,nj->ni", pose.rotation, origin[rays] - pose.position_m)
            along = np.einsum("nji,nj->ni", pose.rotation, direction[rays])
            rate = leaves.leaf_area_density_m2_m3 * foliage.projection(leaves.leaf_angle, along[:, 2])
            walks = Walks(local, along, begin[rays], end[rays], rate, leaves.cell_m, self._keys[number])
            stop, word = foliage.first_leaves(walks)
            hit = indexes(~np.isnan(stop))
            if not len(hit):
                continue
            normal = foliage.leaf_normals(leaves.leaf_angle, word[hit], along[hit])
            cosine = np.abs(np.einsum("ij,ij->i", normal, along[hit]))
            count, world = len(hit), np.einsum("nij,nj->ni", pose.rotation[hit], normal)
            body_of, actor_of = np.full(count, number, np.int32), np.full(count, body.actor, np.int32)
            parts.append(Hits(
                stop[hit], body_of, actor_of, np.zeros(count, np.int64), np.full(count, material, np.int32), world,
                np.zeros(count, bool), cosine,
            ))  # fmt: skip
            which.append(rays[hit])
        return Hits.joined(parts), np.concatenate(which)

    def _medium(self, met: Hits) -> Longs:
        """Body and material of hits as one number."""
        return np.asarray(met.body.astype(np.int64) * len(self._leaves) + met.material)


def _shares(place: Floats, corners: Floats) -> Floats:
    """(k, 3) barycentric shares of points on triangles (k, 3, 3)."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    to = place - corners[:, 0]
    aa, ab, bb = (np.einsum("ij,ij->i", *pair) for pair in ((first, first), (first, second), (second, second)))
    pa, pb = np.einsum("ij,ij->i", to, first), np.einsum("ij,ij->i", to, second)
    det = aa * bb - ab * ab
    v, w = (bb * pa - ab * pb) / det, (aa * pb - ab * pa) / det
    share = np.clip(np.stack([1.0 - v - w, v, w], axis=1), 0.0, 1.0)
    return np.asarray(share / share.sum(axis=1, keepdims=True))


def _pass(front: _Front, met: Hits, medium: Longs, materials: int) -> None:
    """Hulls are entered and left; of the last entered of a body first."""
    within = front.within
    enter = indexes(~met.inner)
    within[enter, 1:] = within[enter, :-1]
    within[enter, 0] = medium[enter]
    leave = indexes(met.inner)
    same = within[leave] // materials == met.body[leave, None]
    leave, at = leave[same.any(axis=1)], same.argmax(axis=1)[same.any(axis=1)]
    for place in range(NESTED - 1):
        rows = leave[at <= place]
        within[rows, place] = within[rows, place + 1]
    within[leave, NESTED - 1] = -1


def _writable(hits: Hits | LateHits) -> Hits:
    """A copy of them."""
    whole = hits if isinstance(hits, Hits) else hits.whole
    return Hits(*(column.copy() for column in vars(whole).values()))


def detailed(caster: AnyCaster, scene: Scene, scenario: Scenario) -> AnyCaster | DetailedCaster:
    """The caster itself where no body has leaves or maps."""
    own = {name: material_from_mapping(name, entry) for name, entry in scenario.materials.items()}
    materials = [own.get(name, PLAIN) for name in scene.materials]
    if all(one.foliage is None and one.maps is None for one in materials):
        return caster
    return DetailedCaster(cast("Caster", caster), scene, materials, scenario.seed)
