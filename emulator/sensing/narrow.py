"""Narrow beams in one pass: their probes on what rests, and what becomes of those that are simple.

Belongs here: what such a pass is given and what it settles. Not: the pass (compiled.narrow), the same for all other
beams with arrays (probing).
"""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from emulator.compiled.pair import OTHERWISE, by_loops
from emulator.physics.arrays import Floats, Ints
from emulator.sensing import strips
from emulator.sensing.contracts import FacedCaster

NUMBERS, FEET = np.array(strips.COUNTS), np.array(strips.FEET)
LEFT = 4
"Of a beam nothing is known; other kinds are those of `probing`."


@dataclass(frozen=True, eq=False)
class Beams:
    """The beams of a sweep in the world, and their probes."""

    place: Floats
    "(3, n) of the lens."
    frame: Floats
    "(3, 3, n) axis, left and up of each."
    own_axis: Floats
    "(n, 3) in the sensor's frame."
    t_s: Floats
    order: Ints
    "(n,) in which they are cast: neighbours share a search."
    aim: Floats
    "(5, k) shares of the frame in a probe's direction, metres left and up of its origin."
    places: Floats
    "(3, k) lengths over that of the axis, and places on the disc."
    share: Floats

    def taken(self, at: Ints) -> Beams:
        """Some of them."""
        return Beams(
            self.place[:, at], self.frame[:, :, at], self.own_axis[at], self.t_s[at],
            np.arange(len(at)), self.aim, self.places, self.share,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Settled:
    """What became of beams."""

    kinds: Ints
    "(n,)"
    made: Floats
    "(2, n) nearest ranges, ranges along the axis."
    faces: strips.Faces
    "Of closed ones."
    material: NDArray[np.int32]
    "(n,) that the axis meets."
    actor: NDArray[np.int32]
    normal: Floats
    "(n, 3)"
    cast: int
    "Rays."
    around: Any = None
    "See `Caster.around`; None: there is no such pass."


def _settled_by_loops(
    loops: ModuleType, beams: Beams, caster: FacedCaster, far: float, reach_m: float, treated: Ints, factors: Floats,
    weight: Floats, bright: Floats, law: Floats,
) -> Settled:  # fmt: skip
    around = caster.around(beams.place.T, beams.t_s, far)
    if around is None:
        return OTHERWISE
    kinds, made, rows, count, what, normal, cast, crossed, wrong = loops.narrow(
        *around.how, beams.place, beams.frame, beams.order, beams.aim, beams.places, beams.share, around.centre, far,
        reach_m, around.suspicious, around.plane, around.body, around.offset, around.closed, around.actor_of,
        around.material, treated, factors, weight, around.others, bright, law, NUMBERS, FEET, strips.SHIFT,
        beams.t_s, around.crossing.spheres, *around.crossing.how, *around.crossing.columns, *around.parts,
    )  # fmt: skip
    around.counters.rays += cast
    around.counters.cast += cast + crossed
    around.counters.suspicious += wrong
    return Settled(kinds, made, strips.Faces(rows, count), what[0], what[1], normal.T, cast, around)


@by_loops(_settled_by_loops, "narrow")
def settled(
    beams: Beams, caster: FacedCaster, far: float, reach_m: float, treated: Ints, factors: Floats, weight: Floats,
    bright: Floats, law: Floats,
) -> Settled:  # fmt: skip
    """What becomes of the simple ones; with arrays every beam is left.

    `treated` : (materials,) the least that a beam on it needs; `factors` : (6, materials) of reflection; `weight` :
    (n,) of the light; `bright` : (4, .) spheres in which every beam needs its bundle; `law` : numbers of the sensor and
    the air, see `Probing`.
    """
    n = len(beams.t_s)
    none = np.full(n, -1, np.int32)
    return Settled(np.full(n, LEFT), np.zeros((2, n)), strips.Faces.none(n), none, none.copy(), np.zeros((n, 3)), 0)
