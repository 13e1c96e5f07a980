"""Echoes of one smooth surface that fills a beam's disc: strips across its slope, computed and not cast.

Belongs here: how many strips a surface needs, ranges and strengths of them. Not: how a beam is found to see one surface
alone (probing), Gaussian beams (closed).

Over a plane the range depends on the place along its slope alone, and the light of a disc at that place falls as a half
ellipse. Strips are the nodes of the Gauss rule of that weight (Chebyshev, second kind), so few of them do. Where the
threshold is far below an echo's top, the foot of the summed pulse is timed, and it needs more.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from emulator.compiled.pair import by_loops
from emulator.physics.arrays import Floats, Ints, clamped, exp_or_zero
from emulator.physics.materials import SurfaceTable
from emulator.physics.radiometry import overlap
from emulator.physics.subechoes import SubEchoes, interleaved
from emulator.sensing.model import SensorModel

Words = NDArray[np.int32]
COUNTS = 2, 4, 6, 8, 12, 16, 24, 32
"Strips of a beam, or one, or none where no number of them does."
FEET = 1.0, 1e-1, 1e-2, 1e-3, 0.0
"Level of a sin^2 pulse's foot where the nearest ray has risen for as long as the lead, over the level crossed; least."
SHIFT = np.array([
    [8e-4, 7e-5, 4e-5, 2e-5, 6e-6, 2e-6, 8e-7, 3e-7],
    [2.5e-2, 5.5e-3, 2.3e-3, 1.2e-3, 7e-4, 7e-4, 1.3e-4, 5.5e-5],
    [1.7e-1, 2.2e-2, 5.5e-3, 3.5e-3, 1.2e-3, 9.5e-4, 9.2e-4, 1.2e-3],
    [3.1e-1, 3.1e-2, 1.3e-2, 7e-3, 2.2e-3, 9.5e-4, 3.5e-4, 3e-4],
    [3.5e-1, 9e-2, 2.5e-2, 8e-3, 4e-3, 2.4e-3, 7e-4, 4e-4],
])  # fmt: skip
"Largest shift of the crossing by so few strips (columns), over the lead, by `FEET` (rows); computed, see the tests."
SHIFT_LSB = 0.25
"Allowed shift of a crossing, in steps of the range."
WIDE = 4.0 * math.pi
"Strips a lead of one FWHM needs at the least, so that the sum has no ripple."
STEEPEST = 0.5
"Share by which the range may differ from the rim to the middle."
DEEPEST = 3.0
"Rms noise by which a level may be lowered."


@dataclass(frozen=True, eq=False)
class Faces:
    """Of n beams the surface each sees: at the place x along its slope, -1 to 1, the nearest first.

    The range is (above - leans x) / (facing + turns x) + beside, the cosine of incidence cosine + bends x.
    """

    rows: Floats
    "(7, n) above, leans, facing, turns, beside, cosine, bends."
    count: Ints
    "(n,) strips."

    @classmethod
    def none(cls, n: int) -> Faces:
        """Of no beam."""
        return cls(np.zeros((7, n)), np.zeros(n, np.int64))


def law(model: SensorModel) -> tuple[float, float, float, float]:
    """What the number of strips depends on: FWHM, level, level of the foot times squared metres, shift allowed."""
    fwhm = model.pulse.fwhm_m
    level = max(model.threshold - DEEPEST, 0.02 * model.threshold)
    return fwhm, level, (2.0 * fwhm / math.pi) ** 2 * level, SHIFT_LSB * model.lsb_m


def counts(lead_m: Floats, size: Floats, numbers: tuple[float, float, float, float]) -> Ints:
    """(n,) strips for surfaces whose nearest place is so much before the axis, of so high an echo; 0: too many."""
    fwhm, level, foot, allowed = numbers
    share = clamped(level / np.maximum(size, 1e-300), 1e-12, 0.9)
    single = math.pi / (16.0 * fwhm) * lead_m * lead_m / np.sqrt(share * (1.0 - share))
    row = np.searchsorted(-np.array(FEET), -foot / np.maximum(lead_m * lead_m * size, 1e-300))
    row = np.minimum(row, len(FEET) - 1)
    enough = (SHIFT[row] * lead_m[:, None] <= allowed) | (np.array(COUNTS) == COUNTS[-1])
    enough &= np.array(COUNTS) * fwhm >= WIDE * lead_m[:, None]
    found = np.where(enough.any(axis=1), np.array(COUNTS)[enough.argmax(axis=1)], 0)
    return np.where(single <= allowed, 1, found)


def nodes(count: int) -> tuple[Floats, Floats]:
    """Places, the nearest first, and shares of so many strips."""
    angle = math.pi * np.arange(1, count + 1) / (count + 1)
    return np.cos(angle), 2.0 / (count + 1) * np.sin(angle) ** 2


def _tabled() -> Floats:
    found = np.zeros((COUNTS[-1] + 1, 2, COUNTS[-1]))
    for count in (1, *COUNTS):
        found[count, :, :count] = nodes(count)
    return found


NODES = _tabled()
"(count, 2, strip) places and shares."


def _echoes_by_loops(
    loops: ModuleType, at: Ints, faces: Faces, material: Words, actor: Words, weight: Floats, table: SurfaceTable,
    extinction_per_m: float, model: SensorModel, others: list[SubEchoes],
) -> SubEchoes:  # fmt: skip
    others = [one for one in others if len(one)]
    pair = [interleaved(others[1:], len(weight)), *others[:1], SubEchoes.none()][:2]
    columns = [(one.beam, one.range_m, one.amplitude, one.blocked, one.source) for one in pair]
    whole, sizes = loops.strips(
        at, faces.rows, faces.count, material, actor, weight, table.factors, NODES, extinction_per_m,
        model.k_m2, model.aperture_radius_m**2, model.overlap_start_m, model.overlap_full_m, *columns[0], *columns[1],
    )  # fmt: skip
    return SubEchoes(whole[0], sizes[0], sizes[1], sizes[2], whole[1])


@by_loops(_echoes_by_loops, "strips")
def echoes(
    at: Ints, faces: Faces, material: Words, actor: Words, weight: Floats, table: SurfaceTable, extinction_per_m: float,
    model: SensorModel, others: list[SubEchoes],
) -> SubEchoes:  # fmt: skip
    """Sub-echoes of the beams `at`, ascending, with those of other beams, `others`, between them.

    `weight` : (n,) of their light; materials are none of `table.apart`.
    """
    count = faces.count[at]
    of = at.repeat(count)
    first = (count.cumsum() - count).repeat(count)
    place, share = NODES[faces.count[of], :, np.arange(len(of)) - first].T
    above, leans, facing, turns, beside, cosine, bends = faces.rows[:, of]
    range_m = (above - leans * place) / (facing + turns * place) + beside
    back = table.back(material[of].astype(np.int64), cosine + bends * place)
    height = weight[of] * model.k_m2 * share * back / (range_m * range_m + model.aperture_radius_m**2)
    if extinction_per_m > 0.0:
        height = height * exp_or_zero(-2.0 * extinction_per_m * range_m)
    height = height * overlap(range_m, model.overlap_start_m, model.overlap_full_m)
    found = SubEchoes(of, range_m, height, share, actor[of].astype(np.int64))
    return interleaved([*others, found], len(weight))
