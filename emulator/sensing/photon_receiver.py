"""A receiver that counts single photons, or photon pairs: histograms of arrival times, and the range in each.

Belongs here: mean counts of a beam's bins, their draw, the correlation with the pulse. Not: the laws of counting
(physics.photons), the analogue receiver (receiver).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from emulator.physics import dead_time, photons
from emulator.physics.arrays import Floats, Ints, clamped, indexes, ramp
from emulator.physics.constants import PLANCK_J_S, SPEED_OF_LIGHT_M_S
from emulator.physics.random_streams import RandomStreams
from emulator.physics.softprofile import SoftProfile
from emulator.physics.subechoes import SubEchoes
from emulator.sensing.daylight import NIGHT, Daylight
from emulator.sensing.model import SensorModel
from emulator.sensors.physics_options import PhotonOptions
from protocols.scan import Scan, ScanPlan

PEAK_AT_ONCE = 2_000_000
"Most bins of all beams that are held in memory together."
FINEST_BIN_SHARE = 1024
"Bins of a pulse's FWHM at the most: a parabola finds a peak to far less than its noise with a hundredth of them."
MOST_BINS = 100_000
"Bins of a gate at the most: a beam of so many takes some 20 ms."
LONG_PULSE = 257
"Bins of a pulse from which a sum under it is faster by a Fourier transform."


class PhotonReceiver:
    """Turns what the light brings back into scans, photon by photon. One echo a beam: the highest correlation."""

    def __init__(self, model: SensorModel, options: PhotonOptions, draws: RandomStreams) -> None:
        self.draws = draws
        self._model, self._options = model, options
        self.bin_m = 0.5e-9 * SPEED_OF_LIGHT_M_S * options.bin_ns
        # a thousandth more, so that what a refusal reports is allowed
        if options.pair_rate_hz is None and 1.001 * self.bin_m * FINEST_BIN_SHARE < model.pulse.fwhm_m:
            least_ns = 1e9 * model.pulse.fwhm_s / FINEST_BIN_SHARE
            raise ValueError(
                f"photons.bin_ns {options.bin_ns:g} under a pulse of {1e9 * model.pulse.fwhm_s:g} ns;"
                f" want at least {least_ns:.4g}"
            )
        if model.gate_m > 1.001 * MOST_BINS * self.bin_m:
            least_ns = 2e9 * model.gate_m / (MOST_BINS * SPEED_OF_LIGHT_M_S)
            raise ValueError(
                f"photons.bin_ns {options.bin_ns:g} makes {model.gate_m / self.bin_m:.4g} bins of gate_m"
                f" {model.gate_m:g}; want at most {MOST_BINS}: bin_ns from {least_ns:.4g}, or gate_m to"
                f" {MOST_BINS * self.bin_m:.4g}"
            )
        self._dead: dead_time.DeadTime | None = None
        if options.dead_time_ns is not None:
            if options.dead_time_ns < 0.999 * options.bin_ns:
                raise ValueError(
                    f"photons.dead_time_ns {options.dead_time_ns:g} shorter than photons.bin_ns {options.bin_ns:g};"
                    " want it as long, or finer bins"
                )
            self._dead = dead_time.DeadTime(
                options.dead_time_ns / options.bin_ns, options.dead_time_law == "paralysable", options.cells,
                options.afterpulse_probability, options.trap_time_ns / options.bin_ns,
            )  # fmt: skip
        self._bins = math.ceil(model.gate_m / self.bin_m) + 1
        reach = math.ceil(model.pulse.half_support_m / self.bin_m)
        shape = model.pulse.profile(self.bin_m * np.arange(-reach, reach + 1, dtype=np.float64))
        self._pulse = shape / shape.sum() if options.pair_rate_hz is None else np.ones(1)

    def receive(
        self, plan: ScanPlan, found: SubEchoes, soft: SoftProfile | None = None, daylight: Daylight = NIGHT
    ) -> Scan:
        """The scan of a sweep."""
        n = len(plan)
        step = max(1, PEAK_AT_ONCE // self._bins)
        generator = self.draws.generator("photons", plan.sweep)
        result = Scan.empty(plan)
        for begin in range(0, n, step):
            end = min(begin + step, n)
            counts, expected = self._histogram(found, begin, end, soft, daylight, generator)
            range_m, snr = self._ranges(counts, expected)
            part = slice(begin, end)
            seen = snr >= self._model.threshold
            seen &= (range_m >= self._model.near_gate_m) & (range_m <= self._model.gate_m)
            result.range_m[part, 0] = np.where(seen, np.maximum(range_m + self._model.systematic_m, 0.0), np.nan)
            result.intensity[part, 0] = np.where(seen, np.maximum(snr / self._model.threshold, 1.0), np.nan)
            result.actor[part, 0] = np.where(seen, self._actors(found, begin, end, range_m), -1)
        return result

    def mean_counts(
        self, found: SubEchoes, begin: int, end: int, soft: SoftProfile | None, daylight: Daylight
    ) -> tuple[Floats, Floats]:
        """Mean photoelectrons of every bin of beams begin..end from our light and, one number a beam, from all else.

        For pulses a shot; for pairs a pair that was sent, and a second.
        """
        model, options = self._model, self._options
        beams = end - begin
        mine = slice(*np.searchsorted(found.beam, [begin, end]))
        energy_j = model.nep_w * model.pulse_energy_j / model.peak_w
        per_amplitude = float(photons.photoelectrons(energy_j, model.wavelength_m, options.quantum_efficiency))
        if options.pair_rate_hz is not None:
            # of each pair one photon is sent; its chance to come back is the power's share
            per_amplitude = options.quantum_efficiency * model.nep_w / model.peak_w
        place = found.range_m[mine] / self.bin_m
        low = np.floor(place).astype(np.int64)
        part = place - low
        row = (found.beam[mine] - begin) * self._bins
        kept = (low >= 0) & (low < self._bins - 1)
        weight = per_amplitude * found.amplitude[mine]
        flat = np.bincount((row + low)[kept], (weight * (1.0 - part))[kept], beams * self._bins)
        flat += np.bincount((row + low + 1)[kept], (weight * part)[kept], beams * self._bins)
        signal: Floats = np.asarray(flat, np.float64).reshape(beams, self._bins)
        if len(self._pulse) > 1:
            signal = np.maximum(_correlated(signal, self._pulse), 0.0)
        if soft is not None:
            behind = row + np.ceil(place).astype(np.int64)
            at = indexes((place > -1.0) & (place <= self._bins - 1))
            stopped = np.bincount(behind[at], found.blocked[mine][at], beams * self._bins).reshape(beams, -1)
            open_ = clamped(1.0 - stopped.cumsum(axis=1), 0.0, 1.0)
            wave = soft.wave(self.bin_m * np.arange(self._bins, dtype=np.float64)) * self.bin_m / model.pulse.fwhm_m
            signal = signal + per_amplitude * open_ * wave
        background_w = np.zeros(beams) if daylight.power_w is None else daylight.power_w[begin:end]
        hertz = options.quantum_efficiency * background_w * model.wavelength_m / (PLANCK_J_S * SPEED_OF_LIGHT_M_S)
        return signal, hertz + options.dark_count_hz

    def _histogram(
        self,
        found: SubEchoes,
        begin: int,
        end: int,
        soft: SoftProfile | None,
        daylight: Daylight,
        generator: np.random.Generator,
    ) -> tuple[Floats, Floats]:
        """Counts (beams, bins), and what the background alone would bring into each bin on average (beams, bins)."""
        options, bin_s = self._options, 1e-9 * self._options.bin_ns
        signal, hertz = self.mean_counts(found, begin, end, soft, daylight)
        if options.pair_rate_hz is None:
            background = np.broadcast_to((hertz * bin_s)[:, None], signal.shape)
            if self._dead is not None:
                alone = self._dead.histogram(background, options.shots, None)
                chance = generator if self._model.noise else None
                return self._dead.histogram(signal + background, options.shots, chance), alone
            alone = photons.first_photon_distribution(background) * options.shots
            if not self._model.noise:
                return photons.first_photon_distribution(signal + background) * options.shots, alone
            drawn = photons.first_photon_counts(signal + background, options.shots, generator)
            return drawn.astype(np.float64), alone
        seconds, pairs = 1e-3 * options.integration_ms, options.pair_rate_hz
        true = pairs * options.idler_efficiency * seconds * signal
        singles = pairs * signal.sum(axis=1) + hertz
        if self._dead is not None:
            counted = self._counted(singles)
            true = true * (self._live(singles))[:, None]
            singles = counted
        accidental = singles * pairs * options.idler_efficiency * bin_s * seconds
        alone = np.broadcast_to(accidental[:, None], signal.shape)
        if not self._model.noise:
            return true + alone, alone
        return generator.poisson(true + alone).astype(np.float64), alone

    def _live(self, rate_hz: Floats) -> Floats:
        """Share of the time in which steady light finds a cell ready."""
        options = self._options
        dead_s = 1e-9 * (options.dead_time_ns or 0.0)
        each = rate_hz / options.cells
        if options.dead_time_law == "paralysable":
            return dead_time.rate_paralysable(1.0, each * dead_s)
        return 1.0 / (1.0 + each * dead_s)

    def _counted(self, rate_hz: Floats) -> Floats:
        """Counts a second of steady light, afterpulses included."""
        options = self._options
        dead_s, trap_s = 1e-9 * (options.dead_time_ns or 0.0), 1e-9 * options.trap_time_ns
        more = 1.0 - dead_time.afterpulse_after_dead_time(options.afterpulse_probability, dead_s, trap_s)
        return rate_hz / more * self._live(rate_hz / more)

    def _ranges(self, counts: Floats, alone: Floats) -> tuple[Floats, Floats]:
        """Range and signal to noise of the highest correlation with the pulse in every beam.

        The noise is that of the counts themselves under the pulse, and of the background at the least.
        """
        weight = self._pulse / self._pulse.max()
        score = _correlated(counts - alone, weight)
        best = np.argmax(score, axis=1)
        row = np.arange(len(best))
        squared = weight * weight
        spread = _correlated(np.maximum(counts, alone), squared)[row, best]
        snr = score[row, best] / np.sqrt(np.maximum(spread, 1.0))
        inner = np.clip(best, 1, self._bins - 2)
        left, mid, right = score[row, inner - 1], score[row, inner], score[row, inner + 1]
        curve = left - 2.0 * mid + right
        shift = np.where(curve < 0.0, 0.5 * (left - right) / np.where(curve < 0.0, curve, -1.0), 0.0)
        return self.bin_m * (inner + np.clip(shift, -0.5, 0.5)), snr

    def _actors(self, found: SubEchoes, begin: int, end: int, range_m: Floats) -> NDArray[np.int32]:
        """Source of the reflection nearest to each beam's range; -1 where none is within a pulse."""
        heads = np.searchsorted(found.beam, np.arange(begin, end + 1))
        count: Ints = np.diff(heads)
        owner = np.repeat(np.arange(end - begin), count)
        at = np.repeat(heads[:-1], count) + ramp(count)
        off = np.abs(found.range_m[at] - range_m[owner])
        order = np.lexsort((off, owner))
        first = np.concatenate(([True], owner[order][1:] != owner[order][:-1])) if len(order) else order
        nearest = order[np.flatnonzero(first)]
        actor = np.full(end - begin, -1, np.int32)
        near = nearest[off[nearest] <= self._model.pulse.half_support_m + self.bin_m]
        actor[owner[near]] = found.source[at[near]]
        return actor


def _correlated(counts: Floats, weight: Floats) -> Floats:
    """Counts (beams, bins) under the weight (odd, symmetric) around each bin; nothing lies beyond the ends."""
    if len(weight) < LONG_PULSE:
        from scipy import ndimage  # takes long to import, and few sensors count photons

        return np.asarray(ndimage.correlate1d(counts, weight, axis=1, mode="constant"), np.float64)
    from scipy import signal

    found = np.asarray(signal.oaconvolve(counts, weight[None, :], mode="same", axes=1), np.float64)
    # the transform leaves its rounding where there is nothing under the weight
    reach, bins = len(weight) // 2, counts.shape[1]
    filled = np.zeros((len(counts), bins + 1), np.int64)
    np.cumsum(counts != 0.0, axis=1, out=filled[:, 1:])
    at = np.arange(bins)
    some = filled[:, np.minimum(at + reach + 1, bins)] > filled[:, np.maximum(at - reach, 0)]
    return np.where(some, found, 0.0)
