"""What the air itself sends back: one table where it is the same everywhere, points along each beam where it is not.

Belongs here: which of both, and the points. Not: the tables (physics.softprofile), the media (air).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache, partial
from typing import TypeAlias

import numpy as np

from emulator.physics import radiometry
from emulator.physics.arrays import Floats, Ints, exp_or_zero
from emulator.physics.cosines import FAINT
from emulator.physics.softprofile import SoftProfile
from emulator.physics.subechoes import SubEchoes
from emulator.sensing.air import AirNow
from emulator.sensing.model import SensorModel
from emulator.sensing.particles import Particles
from emulator.sensing.rays import Rays

POINTS_A_PULSE = 5
"Points to a pulse's FWHM: sums of pulses so close are smooth to 1e-6."
UNSEEN = 0.1
"Share of the threshold which a medium's strongest return must reach to be computed."
POINTS_AT_ONCE = 4096
"Most points along one beam."


Undrawn: TypeAlias = Callable[[tuple[Particles, ...], float, float, SoftProfile], float]
SHARED_BINS = 100_000
"Of a gate at the most, for its tables to be kept from run to run."


class SoftTargets:
    """Media as one sensor sees them."""

    def __init__(self, model: SensorModel, bin_m: float, undrawn: Undrawn | None = None) -> None:
        """`undrawn`: backscatter of what falls in an air, at a gain, that this medium hides. [1/(m sr)]"""
        self._model = model
        self._bin_m = bin_m
        self._undrawn = undrawn
        shared = model.leave_out.soft_table and model.gate_m < SHARED_BINS * bin_m and _hashable(model)
        made = partial(_shared_table, model, bin_m) if shared else self._made
        self._table = lru_cache(maxsize=16)(made) if model.leave_out.soft_table else made

    def _made(self, extinction_per_m: float, backscatter: float, gain: float) -> SoftProfile | None:
        model = self._model
        start_m = max(model.overlap_start_m, model.near_gate_m)
        bound = self._bound(backscatter, extinction_per_m, start_m) * gain
        if model.leave_out.backscatter and bound < min(UNSEEN * model.threshold, model.unseen_amplitude):
            return None
        made = SoftProfile.of_medium(
            model.pulse,
            self._bin_m,
            math.pi * model.k_m2 * gain,
            extinction_per_m,
            backscatter,
            model.overlap_start_m,
            model.overlap_full_m,
            # where the middle of a pulse is out of sight, its begin is not yet
            min(self._sight_m(extinction_per_m, backscatter * gain) + model.pulse.half_support_m, model.gate_m),
        )
        if made is None or not model.leave_out.backscatter:
            return made
        return self._nearby(replace(made, shows=self._shows(made)))

    def everywhere(self, air: AirNow, gain: float = 1.0) -> SoftProfile | None:
        """The table of a medium that fills all the air; None where it is not seen."""
        if not self._model.weather_echoes or self.uneven(air):
            return None
        alpha, backscatter = air.everywhere.extinction_per_m, air.everywhere.backscatter_per_m_sr
        made = self._table(alpha, backscatter, gain)
        if made is None or not air.particles or self._undrawn is None:
            return made
        more = self._undrawn(air.particles, alpha, gain, made)
        return self._table(alpha, backscatter + more, gain) if more > 0.0 else made

    def uneven(self, air: AirNow) -> bool:
        """Some volume sends back enough to be seen: all the air is then taken point by point."""
        start_m = max(self._model.overlap_start_m, self._model.near_gate_m)
        return self._model.weather_echoes and any(
            not self._model.leave_out.backscatter
            or self._bound(volume.medium.backscatter_per_m_sr, 0.0, start_m) >= UNSEEN * self._model.threshold
            for volume in air.volumes
        )

    def _sight_m(self, extinction_per_m: float, backscatter: float) -> float:
        """Range beyond which the return is below a hundredth of the threshold and shifts nothing by half a step."""
        model = self._model
        r = np.geomspace(model.overlap_full_m, max(model.gate_m, model.overlap_full_m), 256)
        level = (
            math.pi * model.k_m2 * backscatter * model.pulse.fwhm_m / (r * r) * exp_or_zero(-2.0 * extinction_per_m * r)
        )
        unseen = min(0.1 * UNSEEN * model.threshold, model.unseen_amplitude)
        hidden = np.flatnonzero(level < unseen)
        return float(r[hidden[0]]) if len(hidden) and model.leave_out.backscatter else model.gate_m

    def _shows(self, made: SoftProfile) -> bool:
        """Its return comes within a tenth of the threshold somewhere, sensitivity-time control included."""
        model = self._model
        x = np.linspace(made.start_m, made.end_m, 512)
        x = np.unique(np.concatenate([x, made.start_m * 1.05 ** np.arange(100), [made.peak_m]]))
        wanted = np.maximum(model.threshold, model.floor_m2 / np.maximum(x, 1e-3) ** 2)
        return bool(np.any(made.wave(x) >= UNSEEN * wanted))

    def _nearby(self, made: SoftProfile) -> SoftProfile | None:
        """The medium as far as it shifts echoes of surfaces; None: nowhere by half a step, and no echo of its own."""
        model = self._model
        if model.photons is not None:
            return made if made.shows else None
        if made.pulse.shape != "sin2" or model.method != "leading_edge":
            return made  # what is timed by more than the foot of a pulse is shifted by less
        x = made.bin_m * np.arange(made.first, made.first + len(made.upper), dtype=np.float64)
        # what is crossed before is not reported
        reported = x > model.near_gate_m - made.pulse.half_support_m
        shown = np.flatnonzero(reported & (made.wave(x) >= model.unseen_under(model.least_amplitude(x))))
        if not len(shown):
            return replace(made, until_m=-np.inf) if made.shows else None
        high = np.flatnonzero(made.wave(x) >= FAINT * model.threshold)
        high_m = float(x[high[-1]]) + made.bin_m if len(high) else -np.inf
        return replace(made, until_m=float(x[shown[-1]]) + made.bin_m, high_m=high_m)

    def _bound(self, backscatter: float, extinction_per_m: float, start_m: float) -> float:
        """Upper bound of the return in rms noise, from `start_m` on: the pulse integrates to its FWHM."""
        model = self._model
        r = np.array([start_m, model.overlap_full_m, 2.0 * model.overlap_start_m])
        r = np.maximum(r, start_m)
        seen = radiometry.overlap(r, model.overlap_start_m, model.overlap_full_m) / (r * r)
        lost = math.exp(-min(2.0 * extinction_per_m * start_m, 500.0))
        return float(math.pi * model.k_m2 * abs(backscatter) * model.pulse.fwhm_m * seen.max() * lost)

    def points(self, air: AirNow, rays: Rays, found: SubEchoes, t_s: Floats, gain: float = 1.0) -> SubEchoes | None:
        """Media as point scatterers along the axis of every beam, as far as the beam is not stopped by surfaces."""
        model, n = self._model, len(rays.axis)
        edges = self._edges()
        if len(edges) < 2:
            return None  # the gate ends before the overlap begins
        middle, step = 0.5 * (edges[1:] + edges[:-1]), np.diff(edges)
        m = len(middle)
        backscatter = np.full((n, m), air.everywhere.backscatter_per_m_sr)
        depth = np.broadcast_to(air.everywhere.extinction_per_m * middle, (n, m)).copy()
        for volume in air.volumes:
            enter, leave = volume.place.crossed(rays.centre_m, rays.axis, t_s)
            if not bool(np.any(leave > enter)):
                continue
            strength = np.broadcast_to(volume.strength(t_s), (n,))[:, None]
            low = np.clip(enter[:, None] - edges[:-1], 0.0, step)
            high = np.clip(leave[:, None] - edges[:-1], 0.0, step)
            filled = np.maximum(high - low, 0.0) / step
            backscatter += filled * strength * volume.medium.backscatter_per_m_sr
            inside = np.maximum(np.minimum(middle, leave[:, None]) - enter[:, None], 0.0)
            depth += strength * volume.medium.extinction_per_m * inside
        overlap = radiometry.overlap(middle, model.overlap_start_m, model.overlap_full_m)
        scale = gain * math.pi * model.k_m2 * overlap * step / (middle * middle)
        amplitude = scale * np.maximum(backscatter, 0.0) * exp_or_zero(-2.0 * depth)
        kept = amplitude > UNSEEN * model.threshold / (4.0 * POINTS_A_PULSE)
        if not bool(np.any(kept)):
            return None
        beam, column = (np.asarray(index, np.int64) for index in np.nonzero(kept))
        clear = _clear_share(found, beam, middle[column], n)
        return SubEchoes.of(beam, middle[column], amplitude[beam, column] * clear)

    def _edges(self) -> Floats:
        """Borders of the pieces: finer near the window, where 1/r^2 is steep, then a share of the pulse."""
        model = self._model
        start_m = max(model.overlap_start_m, model.near_gate_m)
        step = model.pulse.fwhm_m / POINTS_A_PULSE
        if model.gate_m <= start_m:
            return np.zeros(0)
        near = start_m * 1.1 ** np.arange(200)
        near = near[(np.diff(near, append=np.inf) < step) & (near < model.gate_m)]
        begin = float(near[-1]) if len(near) else start_m
        count = min(int((model.gate_m - begin) / step) + 2, POINTS_AT_ONCE)
        return np.unique(np.concatenate([near, np.linspace(begin, model.gate_m, count)]))


@lru_cache(maxsize=16)
def _shared_table(
    model: SensorModel, bin_m: float, extinction_per_m: float, backscatter: float, gain: float
) -> SoftProfile | None:
    """For a process that runs many scenarios with the same sensor in the same air, one after the other."""
    return SoftTargets(model, bin_m)._made(extinction_per_m, backscatter, gain)


def _hashable(model: SensorModel) -> bool:
    try:
        hash(model)
    except TypeError:  # it has arrays
        return False
    return True


def _clear_share(found: SubEchoes, beam: Ints, range_m: Floats, beams: int) -> Floats:
    """Share of a beam that no surface stops before a range; `found` sorted."""
    length = float(max(range_m.max(initial=0.0), found.range_m.max(initial=0.0))) + 1.0
    passed = np.concatenate([[0.0], np.cumsum(found.blocked)])
    head = np.searchsorted(found.beam, np.arange(beams))
    at = np.searchsorted(found.beam * length + found.range_m, beam * length + range_m)
    return np.asarray(np.clip(1.0 - (passed[at] - passed[head[beam]]), 0.0, 1.0))
