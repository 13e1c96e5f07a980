"""Drops and flakes that a medium's own return hides: how bright one must be there to change what is reported.

Here: that level over range. Not here: which particles are drawn (particle_light), the medium's return (softprofile).

Behind its maximum a medium's return w(x) falls. A particle is seen there only if its pulse rises against the fall: the
steepest part of a pulse of amplitude a rises by a m, so none is with a < -w'/m. Next to w it changes no height, and
before the maximum it moves the crossing of the rise, at x0, as much as an amplitude a p(x0 - r) under the threshold.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from emulator.physics.arrays import Floats
from emulator.physics.softprofile import SoftProfile

WORTH = 2.0
"Thresholds that the largest return must reach."
LATE = 1.6
"Thresholds up to which noise may put off the crossing of the rise."


@dataclass(frozen=True, eq=False)
class Hidden:
    """The amplitude that an echo must reach where a medium stands over the threshold; 0 elsewhere."""

    range_m: Floats
    amplitude: Floats

    @classmethod
    def under(cls, soft: SoftProfile | None, threshold: float, near_gate_m: float) -> Hidden | None:
        """What this medium hides; None: nothing.

        Parameters
        ----------
        soft : the medium's return in noise units
        threshold : noise units
        near_gate_m : what is reported nearer than that is dropped: so may be the medium's own echo
        """
        if soft is None or soft.peak < WORTH * threshold:
            return None
        x, w, pulse = soft.grid, soft.free, soft.pulse
        top = int(np.argmax(w))
        here = x >= max(soft.start_m, 0.0)
        fall = np.maximum(-np.gradient(w, soft.bin_m), 0.0)
        # the least fall between a valley, half a pulse before at the most, and here
        level = np.minimum(w, np.where(np.arange(len(x)) > top, fall / _steepest(soft), w))
        late_m = float(x[np.flatnonzero(w[: top + 1] >= LATE * threshold)[0]])
        if late_m + pulse.half_support_m >= near_gate_m and late_m + _lead_m(soft, threshold) >= near_gate_m:
            share = np.maximum(pulse.profile(late_m - x), 1e-12)
            level = np.minimum(level, threshold / share)
        return cls(x[here], level[here])

    def level(self, range_m: Floats) -> Floats:
        """At these ranges; 0 beyond the table."""
        return np.interp(range_m, self.range_m, self.amplitude, right=0.0)


def _lead_m(soft: SoftProfile, threshold: float) -> float:
    """From the crossing of the medium's rise to what is reported, at the most."""
    return max(float(soft.pulse.lead(soft.peak / threshold)), soft.pulse.start_lead_m)


def _steepest(soft: SoftProfile) -> float:
    """Largest slope of a pulse of amplitude 1. [1/m]"""
    pulse = soft.pulse
    x = np.linspace(0.0, pulse.half_support_m, 512)
    return float(np.max(-np.gradient(pulse.profile(x), x)))
