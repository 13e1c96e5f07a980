"""What rays met, and what is known of them under way: the columns that the ray caster fills.

Belongs here: hits, counters, and parts of them that are put together. Not: casting (raycast).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from emulator.physics.arrays import indexes
from emulator.world.batched_poses import Cones, Flags, Longs
from emulator.world.triangles import Floats, Ints

MISS = np.int32(-1)


@dataclass(frozen=True, eq=False)
class Hits:
    """What m rays met first."""

    range_m: Floats
    "(m,) along the ray from its origin; NaN for a miss."
    body: Ints
    "(m,) index into `Scene.bodies`, -1 for a miss."
    actor: Ints
    "(m,) index into `Scene.actors`, -1 for a miss."
    face: Longs
    "(m,) index into the body's faces, -1 for a miss."
    material: Ints
    "(m,) index into `Scene.materials`, -1 for a miss."
    normal: Floats
    "(m, 3) unit, in the world, on the side the ray came from; zeros for a miss."
    inner: Flags
    "(m,) met from inside of a closed shell."
    cosine: Floats
    "(m,) of incidence; 0 for a miss."

    def __len__(self) -> int:
        return len(self.range_m)

    def normals(self, rays: Longs) -> Floats:
        """(k, 3) of some rays."""
        return self.normal[rays]

    def bodies(self, rays: Longs) -> Longs:
        """(k,) of some rays."""
        return self.body[rays].astype(np.int64)

    @classmethod
    def misses(cls, count: int) -> Hits:
        """Hits of rays that met nothing."""
        body, actor, material = (np.full(count, MISS) for _ in range(3))
        return cls(
            np.full(count, np.nan),
            body,
            actor,
            np.full(count, -1, np.int64),
            material,
            np.zeros((3, count)).T,
            np.zeros(count, bool),
            np.zeros(count),
        )

    @classmethod
    def joined(cls, parts: list[Hits]) -> Hits:
        """Those of several blocks of rays."""
        if len(parts) == 1:
            return parts[0]
        return cls(*map(np.concatenate, zip(*(vars(part).values() for part in parts), strict=True)))

    def taken(self, rays: Longs) -> Hits:
        """Those of some rays."""
        return Hits(*(column[rays] for column in vars(self).values()))

    def put(self, rays: Longs, others: Hits) -> None:
        """Set those of some rays."""
        for column, other in zip(vars(self).values(), vars(others).values(), strict=True):
            column[rays] = other


@dataclass(frozen=True, eq=False)
class LateHits:
    """The same where bodies, faces and normals are only looked up if somebody asks for them."""

    range_m: Floats
    actor: Ints
    material: Ints
    inner: Flags
    cosine: Floats
    parts: tuple[tuple[Nearest, Callable[[], Hits]], ...]
    "What was found for the rays, one block after another, and how all of it is reported."

    def __len__(self) -> int:
        return len(self.range_m)

    @classmethod
    def joined(cls, parts: list[LateHits]) -> LateHits:
        """Those of several blocks of rays."""
        if len(parts) == 1:
            return parts[0]
        return cls(
            np.concatenate([part.range_m for part in parts]),
            np.concatenate([part.actor for part in parts]),
            np.concatenate([part.material for part in parts]),
            np.concatenate([part.inner for part in parts]),
            np.concatenate([part.cosine for part in parts]),
            tuple(one for part in parts for one in part.parts),
        )

    @cached_property
    def whole(self) -> Hits:
        return Hits.joined([reported() for _, reported in self.parts])

    @property
    def body(self) -> Ints:
        return self.whole.body

    @property
    def face(self) -> Longs:
        return self.whole.face

    @property
    def normal(self) -> Floats:
        return self.whole.normal

    def bodies(self, rays: Longs) -> Longs:
        """(k,) of some rays."""
        if len(self.parts) == 1:
            body = self.parts[0][0].body[rays]
        else:
            body = np.concatenate([found.body for found, _ in self.parts])[rays]
        body[np.isnan(self.range_m[rays])] = MISS
        return body

    def normals(self, rays: Longs) -> Floats:
        """(k, 3) of some rays."""
        normal, side = np.zeros((3, len(rays))), np.zeros(len(rays))
        begin = 0
        for found, _ in self.parts:
            end = begin + len(found.range_m)
            at = indexes((rays >= begin) & (rays < end)) if len(self.parts) > 1 else slice(None)
            normal[:, at] = found.normals(rays[at] - begin)
            side[at] = np.where(found.facing[rays[at] - begin] > 0.0, -1.0, 1.0)
            begin = end
        side[np.isnan(self.range_m[rays])] = 0.0
        return np.asarray((normal * side).T)


@dataclass(frozen=True, eq=False)
class Renewed:
    """Hits of rays that come again: most of them may be as they were."""

    resting: Hits
    "On resting bodies; the same object each time, not to be written to."
    rays: Longs
    "(k,) ascending: those whose hits may differ."
    now: Hits
    "Of these k."

    @classmethod
    def of(cls, resting: Hits, parts: list[tuple[Longs, Hits]]) -> Renewed:
        """From the changes of several blocks of rays."""
        if not parts:
            return cls(resting, np.zeros(0, np.int64), Hits.misses(0))
        if len(parts) == 1:
            return cls(resting, *parts[0])
        return cls(resting, np.concatenate([rays for rays, _ in parts]), Hits.joined([hits for _, hits in parts]))

    @property
    def hits(self) -> Hits:
        """All of them; those at rest themselves where none differs."""
        if not len(self.rays):
            return self.resting
        hits = Hits(*(column.copy() for column in vars(self.resting).values()))
        hits.put(self.rays, self.now)
        return hits


@dataclass
class Counters:
    """What happened in all casts so far; approximate when several threads cast."""

    rays: int = 0
    "Asked for."
    cast: int = 0
    "Searches that were needed for them: those whose resting part is known are cast on moving bodies alone."
    suspicious: int = 0
    "Hits whose float32 distance was kept because the refined one did not agree."
    leaks: int = 0
    "Rays that had slipped between triangles into a closed shell and were cast again."


@dataclass(eq=False)
class Nearest:
    """The nearest hits so far."""

    range_m: Floats
    triangle: Longs
    body: Longs
    normal: Floats
    "(3, m) by the winding, not yet turned to the ray's side; see `plane`."
    facing: Floats
    "normal . direction; 0 for a miss."
    plane: Floats | None = None
    "(F, 4) of triangles, of which the first `flat` have their normal here, and not in `normal`; None: none has."
    flat: int = 0

    @classmethod
    def nothing(cls, count: int) -> Nearest:
        no = np.full(count, -1, np.int64)
        return cls(np.full(count, np.inf), no, no.copy(), np.zeros((3, count)), np.zeros(count))

    @property
    def written(self) -> tuple[Floats, Longs, Longs, Floats, Floats]:
        """The columns of a hit, in the order in which loops have them."""
        return self.range_m, self.triangle, self.body, self.normal, self.facing

    def normals(self, rays: Longs | None = None) -> Floats:
        """(3, k) of some rays, or all."""
        if self.plane is None:
            return self.normal if rays is None else self.normal[:, rays]
        triangle = self.triangle if rays is None else self.triangle[rays]
        normal = self.plane.take(triangle, axis=0, mode="wrap")[:, :3].T
        own = indexes(triangle >= self.flat)
        normal[:, own] = self.normal[:, own if rays is None else rays[own]]
        return normal

    def taken(self, rays: Longs) -> Nearest:
        """Those of some rays."""
        return Nearest(self.range_m[rays], self.triangle[rays], self.body[rays], self.normals(rays), self.facing[rays])


@dataclass(frozen=True, eq=False)
class Met:
    """Rays that met something else than is known so far."""

    rays: Longs
    "(k,) may repeat."
    triangle: Longs
    body: Longs
    range_m: Floats
    normal: Floats
    "(3, k)"
    facing: Floats


@dataclass(frozen=True, eq=False)
class Passing:
    """Pairs of a moving body and a ray that comes into its box, in the body's frame."""

    which: Longs
    "(k,) of the movers."
    rays: Longs
    enter: Floats
    leave: Floats
    turned: Floats
    "(3, 3, k) body to world."
    local: Floats
    "(3, k) origins about the centre of the sphere."
    along: Floats

    def taken(self, chosen: Longs) -> Passing:
        """Some of them."""
        return Passing(*(column[..., chosen] for column in vars(self).values()))


def extent(vectors: Floats) -> tuple[Floats, Floats]:
    """Least and largest of each coordinate of (3, m), m > 0; what is no number does not count."""
    return np.fmin.reduce(vectors, axis=1), np.fmax.reduce(vectors, axis=1)


def rows(vectors: Floats) -> NDArray[np.float32]:
    """(3, m) in float64 to (m, 3) in float32."""
    return vectors.T.astype(np.float32, order="C")


@dataclass(frozen=True, eq=False)
class Aim:
    """Directions of rays, and what follows from them alone: those that come again have it ready."""

    ray: Floats
    "(3, m)"
    order: Longs = field(default_factory=lambda: np.zeros(0, np.int64))
    "(m,) in which packets of them are searched for; (0,): as they come."
    lasts: bool = False
    "They come again."

    def __len__(self) -> int:
        return len(self.ray[0])

    @cached_property
    def rows(self) -> NDArray[np.float32]:
        """(m, 3), as embree wants them."""
        return rows(self.ray)

    @cached_property
    def cones(self) -> Cones:
        """Neighbouring rays, together."""
        return Cones.of(self.ray)


@dataclass(frozen=True, eq=False)
class Block:
    """Some rays of a fan, and what they meet of resting bodies."""

    here: slice
    origin: Floats
    "(3, m)"
    aim: Aim
    box: tuple[Floats, Floats]
    "Least and largest origin."
    nearest: Nearest
    unsettled: Longs
    "Rays that met an inside, and may have slipped past a moving body."


@dataclass(frozen=True, eq=False)
class Fan:
    """Rays that come again and again."""

    origin_m: Floats
    direction: Floats
    far: float
    blocks: tuple[Block, ...]
    hits: Hits
    "On resting bodies; not to be written to."

    def is_of(self, origin_m: Floats, direction: Floats, far: float) -> bool:
        return self.origin_m is origin_m and self.direction is direction and self.far == far


@dataclass(frozen=True, eq=False)
class Crossing:
    """The moving bodies within reach of a sweep that such a search can follow: rigid ones that move straight."""

    spheres: Floats
    "(4, b) that hold them meanwhile."
    how: tuple[int, int, int, int]
    columns: tuple[Floats | Longs, ...]
    "In the order of `compiled.moving`, from `at` to `body_of`."


@dataclass(frozen=True, eq=False)
class Around:
    """All that a search for many rays needs which begin among resting bodies of one structure."""

    how: tuple[int, int, int, int]
    "As of `compiled.packets`."
    centre: Floats
    "(3,) of the structure."
    offset: int
    "Global number of its first triangle."
    plane: Floats
    "(F, 4) of triangles, as in `structures.Table`."
    body: Longs
    closed: Flags
    actor_of: Ints
    "(bodies,)"
    material: Ints
    "(F,) of the structure's triangles."
    suspicious: float
    counters: Counters
    crossing: Crossing
    others: Floats
    "(4, .) centres and radii of spheres that hold the moving bodies within reach which are not in `crossing`."
    parts: tuple[Longs, Longs, Ints]
    "Part of each triangle, first part of each body, material of each part."


def all_met(parts: list[Met]) -> Met | None:
    if len(parts) < 2:
        return parts[0] if parts else None
    columns = zip(*(vars(part).values() for part in parts), strict=True)
    return Met(*(np.concatenate(column, axis=-1) for column in columns))


def keep_nearer(found: Nearest, rays: Longs, met: Met) -> None:
    """Put hits of `rays` (which may repeat) where nothing is nearer."""
    best = found.range_m.copy()
    np.minimum.at(best, rays, met.range_m)
    wins = indexes(met.range_m == best[rays])
    target = rays[wins]
    found.range_m[target] = met.range_m[wins]
    found.triangle[target] = met.triangle[wins]
    found.body[target] = met.body[wins]
    found.normal[:, target] = met.normal[:, wins]
    found.facing[target] = met.facing[wins]
