"""Triangles of two resting bodies that lie on each other: which of them a beam meets is arbitrary.

Belongs here: finding them in world coordinates. Not: those inside one mesh (triangles), the warning's words (scene).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import permutations
from typing import Protocol

import numpy as np

from emulator.world.motion import Motion
from emulator.world.triangles import Floats, Geometry, Ints

MOST_SEARCHED = 2_000_000
"Triangles of resting bodies beyond which coplanar ones are not looked for: so many take some seconds."
ALIKE_M = 1e-6
"Of corners: rounding of float64 at 1e9 m. Smaller triangles: a thousandth of their longest side."
NEIGHBOURS = 8
"Triangles after each, along a line through the scene, that are looked at."
ALONG = np.array([0.5403023058681398, 0.7080734182735712, 0.4546487134128409])
"Direction of that line: a unit vector along no edge that people build."


class Placed(Protocol):
    """A body as far as coplanar surfaces are concerned."""

    @property
    def still(self) -> bool:
        """Never moves, turns or changes."""

    @property
    def motion(self) -> Motion:
        """Where it is."""

    @property
    def geometry(self) -> Geometry:
        """Its mesh."""

    @property
    def vertices(self) -> Floats:
        """(v, 3) about the body's own origin."""

    @property
    def faces(self) -> Ints:
        """(f, 3)"""

    @property
    def face_material(self) -> Ints:
        """(f,) index of its material."""


@np.errstate(under="ignore")
def coplanar_triangles(bodies: Sequence[Placed]) -> Counter[tuple[int, int]]:
    """How many triangles of two resting bodies lie on one another, by the bodies' indexes, the lesser first.

    Their materials differ. Faces of two closed shells back to back are none: no beam comes between them.
    """
    still = [number for number, body in enumerate(bodies) if body.still]
    found: Counter[tuple[int, int]] = Counter()
    if len(still) < 2 or sum(len(bodies[number].faces) for number in still) > MOST_SEARCHED:
        return found
    posed = [(bodies[number], bodies[number].motion.pose(np.zeros(1))) for number in still]
    corners = np.concatenate(
        [(body.vertices @ pose.rotation[0].T + pose.position_m[0])[body.faces] for body, pose in posed]
    )
    owner = np.repeat(still, [len(body.faces) for body, _ in posed])
    along: Floats = corners.mean(axis=1) @ ALONG
    order = np.argsort(along, kind="stable")
    along, owner = along[order], owner[order]
    normals = np.concatenate([body.geometry.normals @ pose.rotation[0].T for body, pose in posed])
    closed = np.concatenate([body.geometry.closed for body, _ in posed])
    material = np.concatenate([body.face_material for body, _ in posed])[order]
    for step in range(1, min(NEIGHBOURS, len(order) - 1) + 1):
        near = (along[step:] - along[:-step] <= ALIKE_M) & (owner[step:] != owner[:-step])
        at = np.flatnonzero(near & (material[step:] != material[:-step]))
        one, two = order[at], order[at + step]
        back_to_back = closed[one] & closed[two] & (np.einsum("ij,ij->i", normals[one], normals[two]) < 0.0)
        alike = _alike(corners[one], corners[two]) & ~back_to_back
        first, second = owner[at[alike]], owner[at[alike] + step]
        pairs = np.column_stack([np.minimum(first, second), np.maximum(first, second)])
        found.update((int(low), int(high)) for low, high in pairs)
    return found


def _alike(one: Floats, two: Floats) -> np.typing.NDArray[np.bool_]:
    """Which of the triangles (n, 3, 3) have the same corners, in whatever order."""
    sides = one - one[:, [1, 2, 0]]
    within = np.minimum(ALIKE_M, 1e-3 * np.sqrt((sides * sides).sum(axis=2).max(axis=1, initial=0.0)))
    off = [np.abs(one - two[:, list(order)]).max(axis=(1, 2), initial=0.0) for order in permutations(range(3))]
    return np.asarray(np.min(off, axis=0) <= within)
