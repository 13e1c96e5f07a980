"""Reflections too faint to matter: dropped before the receiver looks at them.

Belongs here: which of a sweep's sub-echoes. Not: what is detected (physics.detection).
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from emulator.physics.arrays import indexes
from emulator.physics.subechoes import SubEchoes
from emulator.sensing.model import SensorModel

if TYPE_CHECKING:
    from emulator.physics.softprofile import SoftProfile

ALONE = 1e-3
"Share of the threshold below which a reflection is faint."
TOGETHER = 1e-2
"Share of the threshold that all those dropped in a beam may have together."
"And they must not shift the crossing of another echo, see `SensorModel.unseen_amplitude`."
WORTH = 0.1
"Share of all reflections that must be faint: fewer cost more to drop than to keep."


def most_dropped(model: SensorModel) -> float:
    """Sum of the amplitudes that may be dropped from a beam."""
    return min(TOGETHER * model.threshold, model.unseen_amplitude)


def looked_at(found: SubEchoes, soft: SoftProfile | None, model: SensorModel) -> SubEchoes:
    """The sub-echoes that this sensor's receiver looks at: all but the faint, where these may be left out."""
    if not model.leave_out.faint or (soft is not None and soft.until_m == np.inf):
        return found
    beyond_m = -np.inf if soft is None else soft.until_m + 2.0 * model.pulse.half_support_m
    return without_faint(found, model.threshold, most_dropped(model), beyond_m)


def without_faint(found: SubEchoes, threshold: float, together: float, beyond_m: float = -np.inf) -> SubEchoes:
    """The sub-echoes but those that are faint; of each beam the nearest ones, until their sum would show.

    They also stop light: up to `beyond_m`, where a medium is followed, all are kept. So are those that stop none:
    drops, and points of a medium, which are faint each and an echo together.
    """
    low = found.amplitude < ALONE * threshold
    if np.count_nonzero(low) <= WORTH * len(found):
        return found
    at = indexes(low & (found.range_m > beyond_m) & (found.blocked > 0.0))
    if len(at) <= WORTH * len(found):
        return found
    amplitude, beam = found.amplitude[at], found.beam[at]
    total = amplitude.cumsum()
    head = beam.searchsorted(beam)
    dropped = at[total - (total[head] - amplitude[head]) <= together]
    kept = np.ones(len(found), bool)
    kept[dropped] = False
    spread = None if found.spread_m is None else found.spread_m[kept]
    return replace(
        found, beam=found.beam[kept], range_m=found.range_m[kept], amplitude=found.amplitude[kept],
        blocked=found.blocked[kept], source=found.source[kept], spread_m=spread,
    )  # fmt: skip
