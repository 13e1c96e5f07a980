"""What a beam brings back that looks at one plane: from its axis ray alone, without a bundle.

Belongs here: sub-echoes of plain beams by the moments of a tilted plane (physics.tilted), where these hold; the ranges
that a bundle would have found, where they do not. Not: which beams are plain (plain).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from emulator.physics.arrays import Bools, Floats, Ints, clamped, indexes
from emulator.physics.pulse import stretch_peak_gauss, stretch_peak_sin2
from emulator.physics.subechoes import SubEchoes
from emulator.sensing.contracts import Hits, Medium
from emulator.sensing.model import SensorModel
from emulator.sensing.paths import Surfaces, collected, windows
from emulator.sensing.rays import Rays

STEEPEST = 0.3
"Largest share by which ranges within k radii may differ: beyond it the plane is nearly seen from its edge."
SECOND_ORDER = 1e-3
"Change of the reflectance across the beam that the moments of a Lambert plane do not know."
SPREAD_LSB = 10.0
"""Spread of ranges, in steps of the range, up to which a bundle is no better.

The mean of 61 nodes of a spiral lies 0.028 standard deviations off the axis. Beyond it the bundle's own ranges are
computed, so that a scan does not depend on what was left out.
"""


SHIFT_LSB = 0.125
"Shift of the crossing by that spread, in steps of the range, from which the bundle's ranges are computed."
LEAN_LSB = 0.25
"Shift of the mean range by a reflectance that leans across the beam, in steps of the range, from which they are too."


@dataclass(frozen=True, eq=False)
class Planes:
    """The planes that beams' axes meet, as far as the moments of a tilted plane go."""

    cosine: Floats
    "(n,) of incidence, > 0; 1 where nothing is met."
    spread: Floats
    "(n,) standard deviation of the slant range over the range."
    steep: Floats
    "(n,) largest relative difference of range within k radii."


def planes(rays: Rays, hits: Hits, model: SensorModel, radii: float) -> Planes:
    """Planes of the axis rays' hits, (n,)."""
    met = np.isfinite(hits.range_m)
    cosine = np.where(met, clamped(-np.einsum("ij,ij->i", hits.normal, rays.axis), 0.0, 1.0), 1.0)
    tangent = np.sqrt(np.maximum(1.0 - cosine * cosine, 0.0)) / np.maximum(cosine, 1e-12)
    range_m = np.where(met, np.maximum(hits.range_m, 1e-9), 1.0)
    width = np.tan(model.beam.half_angle_x_rad) + model.beam.exit_radius_m / range_m
    return Planes(cosine, 0.5 * width * tangent, radii * width * tangent)


@dataclass(frozen=True, eq=False)
class Shifts:
    """What the moments of a plane may be wrong by in beams that have their echo from them."""

    lean_m: Floats
    "(n,) of the mean range, NaN in other beams; less than `LEAN_LSB` of a step."
    crossing_m: Floats
    "(n,) of the crossing, NaN in other beams; at most `SHIFT_LSB` of a step."


def holds(
    seen: Planes, hits: Hits, scene: Surfaces, air: Medium, model: SensorModel, plain: Bools
) -> tuple[Bools, Floats]:
    """(n,) plain beams whose echo the moments give, and by how much it may lean, NaN where they do not."""
    beam, leans = model.beam, np.full(len(plain), np.nan)
    if air.uneven or beam.profile != "gauss" or beam.half_angle_x_rad != beam.half_angle_y_rad:
        return np.zeros(len(plain), bool), leans
    good = plain & (hits.range_m > model.overlap_full_m * (1.0 + STEEPEST))
    good &= seen.spread * hits.range_m < SPREAD_LSB * model.lsb_m
    at = indexes(good)
    kind, c = hits.material[at].astype(np.int64), seen.cosine[at]
    step = 2.0 * beam.half_angle_x_rad * np.sqrt(np.maximum(1.0 - c * c, 0.0))
    distance = hits.range_m[at]
    middle = scene.table.back(kind, c, distance)
    some = np.where(middle > 0.0, middle, 1.0)
    more, less = np.minimum(c + step, 1.0), np.maximum(c - step, 0.0)
    up = scene.table.back(kind, more, distance) / some - more / c
    down = scene.table.back(kind, less, distance) / some - less / c
    lean, bow = 0.5 * np.abs(up - down), np.abs(up + down)
    shift = 0.5 * lean * seen.spread[at] * hits.range_m[at]
    good[at] = (bow < SECOND_ORDER) & (shift < LEAN_LSB * model.lsb_m)
    leans[at] = np.where(good[at], shift, np.nan)
    return good, leans


def echoes(
    beams: Ints, rays: Rays, seen: Planes, hits: Hits, scene: Surfaces, air: Medium, model: SensorModel, gain: float,
    reach_m: float,
) -> tuple[SubEchoes, Ints, Floats]:  # fmt: skip
    """Sub-echoes of these beams (k,), whose planes are met by their whole cones; beams whose spread would show.

    And (n,) by how much the crossings of those echoes may be shifted, NaN where there is none.
    """
    beams = beams[hits.range_m[beams] <= reach_m]
    range_m, c, relative = hits.range_m[beams], seen.cosine[beams], seen.spread[beams]
    kind = hits.material[beams].astype(np.int64)
    variance = relative * relative
    half = 0.5 * np.tan(model.beam.half_angle_x_rad)
    energy = 1.0 + 3.0 * variance - 3.0 * half * half
    mean = range_m * (1.0 + variance - 2.0 * half * half) / energy
    depth = air.depth(rays.origin_m[beams], rays.direction[beams], mean, rays.t_s[beams])
    # the energy's second order is that of 1/r^2 about the axis' range
    amplitude = collected(range_m, depth, model) * scene.table.back(kind, c, mean) * energy
    if gain != 1.0 or model.windscreen is not None:
        amplitude = amplitude * windows(rays, model, gain)[beams]
    spread_m, pulse = relative * range_m, model.pulse
    # far above the threshold the nearest edge of the spot is timed, not its middle
    x = clamped(model.threshold / np.maximum(amplitude, 1e-12), 1e-12, 0.9)
    shift = spread_m**2 * np.pi / (4.0 * pulse.fwhm_m * np.sqrt(x * (1.0 - x)))
    wide = (shift > SHIFT_LSB * model.lsb_m) | (spread_m > 0.02 * pulse.fwhm_m)
    one = indexes(~wide)
    stretch = stretch_peak_sin2 if pulse.shape == "sin2" else stretch_peak_gauss
    amplitude = amplitude[one] * stretch(pulse.fwhm_s, spread_m[one])
    source = hits.actor[beams[one]].astype(np.int64)
    shifts = np.full(len(hits.range_m), np.nan)
    shifts[beams[one]] = shift[one]
    return SubEchoes.of(beams[one], mean[one], amplitude, np.ones(len(one)), source), beams[wide], shifts


def plane_ranges(rays: Rays, hits: Hits, beam_of: Ints) -> Floats:
    """Distances of a bundle's rays to the planes that their beams' axes `beam_of` (r,) meet."""
    normal, range_m = hits.normal[beam_of], hits.range_m[beam_of]
    level = np.where(np.isfinite(range_m), range_m, 0.0)
    centre, axis = rays.centre_m[rays.beam], rays.axis[rays.beam]
    offset = level[:, None] * axis - (rays.origin_m - centre)
    facing = np.einsum("ij,ij->i", normal, rays.direction)
    safe = np.where(facing < 0.0, facing, -1.0)
    distance = np.einsum("ij,ij->i", normal, offset) / safe
    return np.where(np.isfinite(range_m) & (facing < 0.0) & (distance >= 0.0), distance, np.nan)
