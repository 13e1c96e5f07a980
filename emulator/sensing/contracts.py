"""What sensing asks of those who cast rays and who know the air.

Belongs here: contracts alone. Not: casters (raycast, hits), the air (air).
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from emulator.physics.arrays import Floats, Ints


class Hits(Protocol):
    """What a cast gives, see raycast."""

    @property
    def range_m(self) -> Floats: ...
    @property
    def body(self) -> NDArray[np.int32]: ...
    @property
    def actor(self) -> NDArray[np.int32]: ...
    @property
    def material(self) -> NDArray[np.int32]: ...
    @property
    def normal(self) -> Floats: ...
    @property
    def cosine(self) -> Floats: ...
    @property
    def inner(self) -> NDArray[np.bool_]: ...

    def normals(self, rays: Ints) -> Floats:
        """(k, 3) of some rays."""

    def bodies(self, rays: Ints) -> Ints:
        """(k,) of some rays, -1 for a miss."""


class FacedHits(Hits, Protocol):
    """The same with the face of the body that is met."""

    @property
    def face(self) -> Ints: ...


class AgainHits(FacedHits, Protocol):
    """Hits of which parts are taken and set."""

    def taken(self, rays: Ints) -> AgainHits: ...
    def put(self, rays: Ints, others: Any) -> None: ...


class Renewed(Protocol):
    """Hits of rays that come again, see hits."""

    @property
    def resting(self) -> AgainHits: ...
    @property
    def rays(self) -> Ints: ...
    @property
    def now(self) -> AgainHits: ...
    @property
    def hits(self) -> AgainHits: ...


class Caster(Protocol):
    """Whoever finds the first surface on rays, up to where they end."""

    def first_hits(
        self, origin_m: Floats, direction: Floats, t_s: Floats, *, max_range_m: float = np.inf,
        inside: Ints | None = None,
    ) -> Hits: ...  # fmt: skip


class FacedCaster(Protocol):
    """The same with faces, and rays that come again."""

    @property
    def bare(self) -> FacedCaster:
        """One that finds faces alone, also where these stand for more."""

    @property
    def moves(self) -> bool: ...
    @property
    def movers(self) -> int: ...

    def may_lie_beyond(self, origin_m: Floats, direction: Floats, t_s: Floats, beyond_m: float) -> NDArray[np.bool_]:
        """(m,) rays on which something may lie farther than that."""

    def first_hits(
        self, origin_m: Floats, direction: Floats, t_s: Floats, *, max_range_m: float = np.inf, again: bool = False,
        aimed: bool = False, order: Ints | None = None, inside: Ints | None = None,
    ) -> FacedHits: ...  # fmt: skip

    def around(self, origin_m: Floats, t_s: Floats, far: float) -> Any:
        """What a single pass over rays needs; None: there is no such pass."""

    def renewed(self, origin_m: Floats, direction: Floats, t_s: Floats, max_range_m: float) -> Renewed: ...


class Medium(Protocol):
    """Whoever knows the extinction along rays."""

    @property
    def uneven(self) -> bool:
        """It differs from place to place, so that `depth` needs to know where the rays are."""

    @property
    def extinction_per_m(self) -> float:
        """Of what fills all the air."""

    def depth(self, origin_m: Floats, direction: Floats, length_m: Floats, t_s: Floats) -> Floats: ...
