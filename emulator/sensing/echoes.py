"""From sub-echoes to echoes: which reflections the receiver cannot tell apart, and what it makes of each group.

Belongs here: clusters, threshold, choice of the echoes that the sensor reports, the noise of amplitude and range.
Not: where the sub-echoes come from (paths), laws of pulse and detector (physics).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from emulator.physics.arrays import Floats, Ints
from emulator.sensing.model import SensorModel
from emulator.sensing.paths import SubEchoes


@dataclass(frozen=True, eq=False)
class Echoes:
    """Candidates for what a sensor reports, sorted by beam, then range."""

    beam: Ints
    "(k,)"
    range_m: Floats
    "(k,) where the receiver puts the echo, before noise."
    amplitude: Floats
    "(k,) peak in rms noise."
    actor: NDArray[np.int32]
    "(k,) the one with the largest share, -1 for weather."

    def __len__(self) -> int:
        return len(self.beam)


def clusters(found: SubEchoes, gap_m: float) -> Ints:
    """First index of each cluster: neighbours in a beam whose gap is larger do not touch in the signal."""
    if not len(found):
        return np.zeros(0, np.int64)
    cut = (found.beam[1:] != found.beam[:-1]) | (found.range_m[1:] - found.range_m[:-1] > gap_m)
    return np.concatenate(([0], np.flatnonzero(cut) + 1))


def merged(found: SubEchoes, starts: Ints) -> Echoes:
    """Each cluster as one echo: amplitudes added, at the mean range weighted by them."""
    if len(starts) == len(found):
        return Echoes(found.beam, found.range_m, found.amplitude, found.actor)
    total = np.add.reduceat(found.amplitude, starts)
    first = found.range_m[starts]
    sizes = np.diff(np.append(starts, len(found)))
    # relative to the cluster's first range: a mean of equal numbers is that number
    beyond = found.range_m - np.repeat(first, sizes)
    mean = first + np.add.reduceat(found.amplitude * beyond, starts) / total
    return Echoes(found.beam[starts], mean, total, strongest_actor(found, starts, sizes))


def strongest_actor(found: SubEchoes, starts: Ints, sizes: Ints) -> NDArray[np.int32]:
    """The actor with the largest sum of amplitudes in each cluster."""
    actor = found.actor[starts]
    same = np.logical_and.reduceat(found.actor == np.repeat(actor, sizes), starts)
    for cluster in np.flatnonzero(~same):
        part = slice(starts[cluster], starts[cluster] + sizes[cluster])
        names, index = np.unique(found.actor[part], return_inverse=True)
        actor[cluster] = names[int(np.argmax(np.bincount(index, found.amplitude[part])))]
    return actor


def threshold_at(range_m: Floats, model: SensorModel) -> Floats | float:
    """Threshold over the noise at these ranges, sensitivity-time control included."""
    if model.floor_m2 == 0.0:
        return model.threshold
    return np.maximum(model.threshold, model.floor_m2 / (range_m * range_m + model.aperture_radius_m**2))
