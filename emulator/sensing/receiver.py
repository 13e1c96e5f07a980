"""The receiver: echoes over the threshold, with their noise, as the scan that a device reports.

Belongs here: noise of amplitude and range, threshold, choice and order of echoes. Not: how sub-echoes merge (echoes).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from emulator.draws import Draws
from emulator.physics import pulse as pulses
from emulator.physics.arrays import Bools, Floats, Ints
from emulator.sensing.echoes import Echoes, clusters, merged, threshold_at
from emulator.sensing.model import SensorModel
from emulator.sensing.paths import SubEchoes
from protocols.scan import SATURATED, Scan, ScanPlan

LIKELY_RMS = 6.0
"An echo this many rms under the threshold is lifted over it once in a billion."


def receive(plan: ScanPlan, found: SubEchoes, model: SensorModel, draws: Draws) -> Scan:
    """The scan of a sweep from its sub-echoes."""
    echoes = merged(found, clusters(found, 2.0 * model.pulse.half_support_m))
    return report(plan, echoes, model, draws)


def report(plan: ScanPlan, echoes: Echoes, model: SensorModel, draws: Draws) -> Scan:
    """Noise, threshold and choice of echoes."""
    n = len(plan)
    echoes = _likely(echoes, model)
    place = place_in_beam(echoes.beam)
    amplitude = echoes.amplitude
    threshold = threshold_at(echoes.range_m, model)
    columns = int(place.max(initial=0)) + 1
    if model.noise and len(echoes):
        rms = np.sqrt(1.0 + model.signal_shot * amplitude)
        amplitude = amplitude + rms * draws.normal("amplitude", plan.sweep, columns, n)[place, echoes.beam]
    seen = amplitude >= threshold
    range_m = echoes.range_m + model.systematic_m
    if model.noise and len(echoes):
        sigma = range_sigma(amplitude, threshold, model)
        range_m = range_m + sigma * draws.normal("range", plan.sweep, columns, n)[place, echoes.beam]
    chosen = choose(echoes.beam, amplitude, seen, model, plan.max_echoes)
    return _scan(plan, echoes, chosen, range_m, np.minimum(amplitude, model.full_scale), amplitude, model)


def _likely(echoes: Echoes, model: SensorModel) -> Echoes:
    """Without what no noise lifts over the threshold: a weak echo takes no random number from a strong one."""
    margin = LIKELY_RMS if model.noise else 0.0
    rms = np.sqrt(1.0 + model.signal_shot * echoes.amplitude)
    kept = echoes.amplitude >= threshold_at(echoes.range_m, model) - margin * rms
    kept &= (echoes.range_m >= model.near_gate_m) & (echoes.range_m <= model.gate_m)
    if bool(np.all(kept)):
        return echoes
    return Echoes(echoes.beam[kept], echoes.range_m[kept], echoes.amplitude[kept], echoes.actor[kept])


def range_sigma(amplitude: Floats, threshold: Floats | float, model: SensorModel) -> Floats:
    """Standard deviation of the measured range: the sensor's own, and the leading edge's on a noisy signal.

    The edge's law is infinite at the threshold; a crossing cannot stray farther than over the pulse's rise, which as a
    uniform law has the standard deviation fwhm / sqrt 12.
    """
    law = pulses.edge_range_sigma_sin2 if model.pulse.shape == "sin2" else pulses.edge_range_sigma_gauss
    least = threshold * (1.0 + 1e-9)
    edge = law(model.pulse.fwhm_s, threshold, np.maximum(amplitude, least))
    edge = np.minimum(edge, model.pulse.fwhm_m / math.sqrt(12.0))
    return np.hypot(model.range_noise_m, edge)


def place_in_beam(beam: Ints) -> Ints:
    """Number of each echo within its beam, 0 the nearest; `beam` sorted."""
    if not len(beam):
        return np.zeros(0, np.int64)
    starts = np.concatenate(([True], beam[1:] != beam[:-1]))
    index = np.arange(len(beam))
    return np.asarray(index - np.maximum.accumulate(np.where(starts, index, 0)))


def choose(beam: Ints, amplitude: Floats, seen: Bools, model: SensorModel, most: int) -> Ints:
    """Indexes of the echoes that are reported, in order."""
    index = np.flatnonzero(seen)
    most = min(most, model.max_echoes)
    if model.echoes == "last":
        rank = place_in_beam(beam[index][::-1])[::-1]
    elif model.echoes == "strongest":
        order = np.lexsort((-amplitude[index], beam[index]))
        rank = np.zeros(len(index), np.int64)
        rank[order] = place_in_beam(beam[index][order])
    else:
        rank = place_in_beam(beam[index])
    return index[rank < most]


def _scan(
    plan: ScanPlan,
    echoes: Echoes,
    chosen: Ints,
    range_m: Floats,
    peak: Floats,
    amplitude: Floats,
    model: SensorModel,
) -> Scan:
    n = len(plan)
    beam = echoes.beam[chosen]
    column = place_in_beam(beam)
    k = int(column.max(initial=0)) + 1
    ranges, intensity = np.full((n, k), np.nan), np.full((n, k), np.nan)
    actor = np.full((n, k), -1, np.int32)
    ranges[beam, column] = range_m[chosen]
    intensity[beam, column] = np.maximum(peak[chosen] / model.threshold, 1.0)
    actor[beam, column] = echoes.actor[chosen]
    flags: NDArray[np.uint8] = np.zeros(n, np.uint8)
    clipped = beam[amplitude[chosen] > model.full_scale]
    flags[clipped] |= SATURATED
    return Scan(plan, ranges, intensity, flags, actor)
