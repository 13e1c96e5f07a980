"""Blooming: light of an echo that saturates, scattered in the receiver onto detectors that listen at the same time.

Belongs here: the sub-echoes that other beams get of it. Not: light that leaves the sensor beside its beam (the
sidelobes of the bundle, rays), and what a saturated receiver does afterwards (physics.shaped).

A detector hears it at the instant at which it arrives: beams that were fired at another time have it at another range,
and those of a scanner whose next beam is fired after the gate have none.
"""

from __future__ import annotations

import numpy as np

from emulator.physics.arrays import indexes
from emulator.physics.constants import SPEED_OF_LIGHT_M_S
from emulator.physics.subechoes import SubEchoes
from emulator.sensing.model import SensorModel
from protocols.scan import ScanPlan

MOST_RADII = 3.0
"Scattered light is followed so far: 1.5e-8 of it on the axis."


def bloomed(found: SubEchoes, plan: ScanPlan, model: SensorModel) -> SubEchoes:
    """The sub-echoes, and `bloom_share` of the saturating ones exp(-2 angle^2/bloom^2) in beams so far away."""
    if model.bloom_share == 0.0 or not len(found):
        return found
    bright = indexes(found.amplitude >= model.full_scale)
    if not len(bright):
        return found
    cosine = np.cos(plan.elevation_rad)
    axis = np.stack(
        [cosine * np.cos(plan.azimuth_rad), cosine * np.sin(plan.azimuth_rad), np.sin(plan.elevation_rad)], axis=1
    )
    parts = [found]
    for source in np.unique(found.beam[bright]):
        mine = bright[found.beam[bright] == source]
        apart = 2.0 * np.arcsin(np.minimum(0.5 * np.linalg.norm(axis - axis[source], axis=1), 1.0))
        near = indexes(apart <= MOST_RADII * model.bloom_rad)
        near = near[near != source]
        if not len(near):
            continue
        late_s = plan.fire_offset_s[source] - plan.fire_offset_s[near]
        range_m = found.range_m[mine] + 0.5 * SPEED_OF_LIGHT_M_S * late_s[:, None]
        share = model.bloom_share * np.exp(-2.0 * (apart[near] / model.bloom_rad) ** 2)
        amplitude = share[:, None] * found.amplitude[mine]
        heard = (range_m > 0.0) & (range_m <= model.gate_m + model.pulse.half_support_m)
        beam, tag = np.broadcast_to(near[:, None], heard.shape), np.broadcast_to(found.source[mine], heard.shape)
        parts.append(SubEchoes.of(beam[heard], range_m[heard], amplitude[heard], None, tag[heard]))
    return SubEchoes.joined(*parts)
