"""Counting single photons and photon pairs, and the coherent receiver: the outlook of the base paper.

Here: closed forms for single-photon and correlated-photon timing and for the Doppler shift. Not here: the analogue
receiver (noise).
"""

from __future__ import annotations

import numpy as np

from emulator.physics.arrays import Floats, Ints, Values, exp_or_zero, floats
from emulator.physics.constants import PLANCK_J_S, SPEED_OF_LIGHT_M_S


def photoelectrons(energy_j: Values, wavelength_m: Values, efficiency: Values) -> Floats:
    """Mean number of photoelectrons of an echo of this energy: eta E lambda/(h c)."""
    return floats(efficiency) * energy_j * wavelength_m / (PLANCK_J_S * SPEED_OF_LIGHT_M_S)


def first_photon_bin(background_per_bin: Values, signal: Values, bin_index: Values) -> Floats:
    """Probability that the first photon falls in bin i, equal background in every bin and the signal in bin i only."""
    b = floats(background_per_bin)
    return exp_or_zero(-b * bin_index) * -np.expm1(-(b + signal))


def first_photon_distribution(mean_counts: Floats) -> Floats:
    """Probability of the first photon in each bin (last axis) from the mean counts of all bins; pile-up included.

    P(i) = exp(-sum_{j<i} m_j) (1 - exp(-m_i)); what is missing to 1 is no photon at all.
    """
    m = floats(mean_counts)
    before = np.zeros(m.shape)
    np.cumsum(m[..., :-1], axis=-1, out=before[..., 1:])
    return exp_or_zero(-before) * -np.expm1(-m)


def first_photon_counts(mean_counts: Floats, shots: int, generator: np.random.Generator) -> Ints:
    """Histogram of the first photons of many shots, drawn by the law of `first_photon_distribution`.

    Parameters
    ----------
    mean_counts : (beams, bins) mean counts of the bins of one gate, >= 0
    shots : pulses a beam

    Notes
    -----
    The gate is halved until each part is one bin. Of the photons of a part, each falls in its first half with the
    chance (1 - exp(-m1))/(1 - exp(-(m1 + m2))) of the halves' mean counts: no sum of chances has to be 1.
    """
    m = floats(mean_counts)
    bins = m.shape[-1]
    parts = [np.concatenate([m, np.zeros((len(m), (1 << (bins - 1).bit_length()) - bins))], axis=1)]
    while parts[-1].shape[1] > 1:
        parts.append(parts[-1][:, ::2] + parts[-1][:, 1::2])
    counts: Ints = generator.binomial(shots, -np.expm1(-parts.pop()))
    while parts:
        half = parts.pop()
        seen, first = -np.expm1(-(half[:, ::2] + half[:, 1::2])), -np.expm1(-half[:, ::2])
        filled = counts > 0
        here = counts[filled]
        early = generator.binomial(here, np.minimum(first[filled] / seen[filled], 1.0))
        finer = np.zeros(half.shape, np.int64)
        finer[:, ::2][filled], finer[:, 1::2][filled] = early, here - early
        counts = finer
    return counts[:, :bins]


def first_photon_draw(mean_counts: Floats, uniform: Floats) -> Ints:
    """Bin of the first photon of each shot from a uniform number a shot; -1 for none.

    Parameters
    ----------
    mean_counts : (b,) mean counts of the bins of one gate
    uniform : any shape, in (0, 1)
    """
    reached = np.cumsum(floats(mean_counts))
    bins = np.searchsorted(reached, -np.log1p(-floats(uniform)), side="left")
    return np.where(bins < reached.size, bins, -1)


def correlation_snr(signal_per_shot: Values, background_per_shot: Values, shots: Values) -> Floats:
    """SNR of the histogram's correlation with the pulse: n_s K/sqrt(K (n_s + n_b)), counts in the pulse's bins."""
    s = floats(signal_per_shot)
    total = np.maximum(s + background_per_shot, 1e-300)
    return s * np.sqrt(floats(shots) / total)


def correlation_range(histogram: Floats, pulse_counts: Floats, bin_m: float) -> float:
    """Range of the largest correlation of a histogram of arrivals with the pulse, from the start of the gate. [m]

    `pulse_counts` is the pulse sampled in the same bins from its start; a parabola through the maximum refines it.
    """
    score = np.correlate(floats(histogram), floats(pulse_counts), mode="full")[len(pulse_counts) - 1 :]
    best = int(np.argmax(score))
    if 0 < best < len(score) - 1:
        left, mid, right = (float(score[best + k]) for k in (-1, 0, 1))
        curve = left - 2.0 * mid + right
        if curve < 0.0:
            return bin_m * (best + 0.5 * (left - right) / curve)
    return bin_m * best


def coincidence_ratio(
    pair_rate_hz: Values,
    eff_signal: Values,
    eff_idler: Values,
    singles_signal_hz: Values,
    singles_idler_hz: Values,
    window_s: Values,
) -> Floats:
    """Coincidences over accidentals of photon pairs: r e_s e_i/(S_s S_i dt)."""
    return floats(pair_rate_hz) * eff_signal * eff_idler / (floats(singles_signal_hz) * singles_idler_hz * window_s)


def doppler_shift(speed_m_s: Values, wavelength_m: Values) -> Floats:
    """Doppler shift of a coherent lidar: 2 v/lambda. [Hz]"""
    return 2.0 * floats(speed_m_s) / wavelength_m
