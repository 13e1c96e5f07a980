"""Narrow beams with an edge or a pane in them, in one pass where all that they meet rests and is plain or clear.

Belongs here: what such a pass is given and what it gives. Not: the pass (compiled.tracing), the same for all other
beams with arrays (paths, through), which beams need it (probing).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from emulator.compiled.pair import OTHERWISE, by_loops
from emulator.physics import beams
from emulator.physics.arrays import Floats, Ints
from emulator.physics.subechoes import SubEchoes
from emulator.sensing import strips
from emulator.sensing.air import AirNow
from emulator.sensing.model import SensorModel
from emulator.sensing.narrow import FEET, NUMBERS, Beams
from emulator.sensing.paths import BEHIND_M, UNSEEN, Surfaces
from emulator.sensing.through import MOST_STRIPS

LEFT, DONE, UNEVEN = 0, 1, 2
"""What becomes of a beam: it is left to arrays; it is done; its probes do not stand for what they see through a pane
or in it."""
PLACE_BITS = 12
"As in `compiled.tracing`; a beam of more sub-echoes is left to arrays."
PLAIN, GLASS, MIRROR, REFUSED = 0, 1, 2, 3
"Materials, as in `compiled.tracing`."


@dataclass(frozen=True, eq=False)
class Bundle:
    """The rays of each beam, and what is wanted of them."""

    nodes: beams.Bundle
    phase_rad: Floats
    "(k,) by which each is turned."
    judged: bool
    "They are probes: they must see nothing but smooth surfaces through a pane or in it."


@dataclass(frozen=True, eq=False)
class Sensor:
    """One that is itself, whatever others are like."""

    model: SensorModel
    step_m: float
    "A probe may be off a smooth surface."


@dataclass(frozen=True, eq=False)
class Traced:
    """What came back to k beams."""

    verdict: Ints
    "(k,)"
    found: SubEchoes
    "Of those that are done, by their numbers in the sweep."
    nearest_m: Floats
    "(k,) of these and the next two nothing holds for beams that are left."
    material: NDArray[np.int32]
    "(k,) at the ray nearest the axis."
    normal: Floats
    "(k, 3)"
    cast: int
    "Rays of beams that are not left, without those that go on."


@dataclass(frozen=True, eq=False)
class _Fixed:
    """What the pass is given that is the same in many sweeps."""

    kinds: Ints
    "(materials,)"
    limits: Floats
    "Numbers in the order of `compiled.tracing`; those of a sweep are put in."
    judge: Floats
    places: Floats
    "(3, m) lengths over that of the axis, and places on the disc."
    first: int
    "The ray nearest the axis."


@lru_cache(maxsize=32)
def _fixed(nodes: beams.Bundle, surfaces: Surfaces, sensor: Sensor, extinction_per_m: float) -> _Fixed:
    model, table, shape = sensor.model, surfaces.table, sensor.model.beam
    refused = table.apart if surfaces.detailed is None else table.apart | surfaces.detailed
    kinds = np.where(refused, REFUSED, np.where(surfaces.onward, GLASS, PLAIN))
    spread = math.tan(shape.half_angle_x_rad), math.tan(shape.half_angle_y_rad)
    limits = np.array([
        *spread, shape.exit_radius_m, math.cos(shape.roll_rad), math.sin(shape.roll_rad), 0.0, 0.0,
        extinction_per_m, model.clear_depth if model.leave_out.clear_air else 0.0, model.k_m2,
        model.aperture_radius_m**2, model.overlap_start_m, model.overlap_full_m, surfaces.strongest,
        UNSEEN * model.threshold if model.leave_out.second_rays else 0.0, BEHIND_M, 0.0, *spread,
    ])  # fmt: skip
    judge = np.array([sensor.step_m, float((nodes.u * nodes.u).sum()), *strips.law(model), strips.WIDE])
    places = np.array([_lengths(nodes, spread, shape.roll_rad), nodes.u, nodes.v])
    mirrors = table.mirrors & (kinds == GLASS)
    first = int(np.argmin(nodes.u**2 + nodes.v**2))
    return _Fixed(np.where(mirrors, MIRROR, kinds), limits, judge, places, first)


def _traced_by_loops(
    loops: ModuleType, beams_: Beams, at: Ints, bundle: Bundle, around: Any, far: float, reach_m: float, weight: Floats,
    surfaces: Surfaces, air: AirNow, sensor: Sensor,
) -> Traced:  # fmt: skip
    bounces = sensor.model.bounces if surfaces.sends_on else 0
    if around is None or air.uneven or len(bundle.nodes) * 2 ** (bounces + 1) > 1 << PLACE_BITS:
        return OTHERWISE
    nodes, table = bundle.nodes, surfaces.table
    fixed = _fixed(nodes, surfaces, sensor, air.extinction_per_m)
    limits = fixed.limits.copy()
    limits[5], limits[6], limits[16] = far, reach_m, around.suspicious
    solid = np.zeros(len(around.actor_of), np.bool_) if surfaces.solid is None else surfaces.solid
    verdict, nearest, material, normal, whole, sizes, cast, wrong = loops.traced(
        *around.how, beams_.place, beams_.frame, at, bundle.phase_rad, fixed.places[1:], nodes.share, fixed.first,
        around.centre, limits, around.plane, around.body, around.offset, around.closed, around.actor_of,
        around.material, solid, around.others, table.factors, fixed.kinds, table.optics, weight, bounces, bundle.judged,
        fixed.places, fixed.judge, NUMBERS, FEET, strips.SHIFT, MOST_STRIPS,
        beams_.t_s, around.crossing.spheres, *around.crossing.how, *around.crossing.columns, *around.parts,
    )  # fmt: skip
    around.counters.rays += cast
    around.counters.cast += cast
    around.counters.suspicious += wrong
    found = SubEchoes(whole[0], sizes[0], sizes[1], sizes[2], whole[1])
    return Traced(verdict, found, nearest, material, normal.T, int(np.count_nonzero(verdict)) * len(nodes))


@by_loops(_traced_by_loops, "traced")
def traced(
    beams_: Beams, at: Ints, bundle: Bundle, around: Any, far: float, reach_m: float, weight: Floats,
    surfaces: Surfaces, air: AirNow, sensor: Sensor,
) -> Traced:  # fmt: skip
    """What comes back to the beams `at`, ascending; with arrays every one is left.

    `around` : see `Caster.around`; `weight` : (n,) of the light of all beams.
    """
    k = len(at)
    nothing = np.full(k, -1, np.int32)
    return Traced(np.full(k, LEFT), SubEchoes.none(), np.full(k, np.inf), nothing, np.zeros((k, 3)), 0)


def _lengths(nodes: beams.Bundle, spread: tuple[float, float], roll_rad: float) -> Floats:
    """Of rays between two planes across the axis, over that of the axis."""
    cr, sr = math.cos(roll_rad), math.sin(roll_rad)
    x, y = spread[0] * nodes.u, spread[1] * nodes.v
    return np.asarray(np.sqrt(1.0 + (cr * x - sr * y) ** 2 + (sr * x + cr * y) ** 2))
