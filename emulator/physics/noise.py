"""Noise of the receiver and what it does to detection.

Here: noise current of a photodiode with amplifier and converter, tail of the normal law, probability of detection,
false alarms. Not here: where background light comes from (background), counting of photons (photons).
"""

from __future__ import annotations

import numpy as np
from scipy import special

from emulator.physics.arrays import Floats, Values, exp_or_zero, floats
from emulator.physics.constants import BOLTZMANN_J_K, ELEMENTARY_CHARGE_C, SPEED_OF_LIGHT_M_S


def excess_noise(gain: Values, k_ratio: Values) -> Floats:
    """McIntyre's excess noise factor of an avalanche diode; 1 at gain 1."""
    m = floats(gain)
    return k_ratio * m + (1.0 - floats(k_ratio)) * (2.0 - 1.0 / m)


def noise_current(
    signal_w: Values,
    background_w: Values,
    responsivity: Values,
    gain: Values,
    k_ratio: Values,
    dark_bulk_a: Values,
    dark_surface_a: Values,
    amplifier_a_rthz: Values,
    load_ohm: Values,
    temperature_k: Values,
    bandwidth_hz: Values,
    adc_noise_a: Values = 0.0,
) -> Floats:
    """Rms noise current at the input of the preamplifier. [A]

    Shot noise of signal, background and both dark currents, thermal noise of the load, the amplifier's own density and
    the converter's rms noise. ``dark_bulk_a`` is multiplied by the gain, ``dark_surface_a`` is not.
    """
    m = floats(gain)
    primary = floats(responsivity) * (floats(signal_w) + background_w) + dark_bulk_a
    shot = 2.0 * ELEMENTARY_CHARGE_C * (primary * m**2 * excess_noise(m, k_ratio) + dark_surface_a)
    thermal = 4.0 * BOLTZMANN_J_K * floats(temperature_k) / load_ohm
    return np.sqrt((shot + thermal + floats(amplifier_a_rthz) ** 2) * bandwidth_hz + floats(adc_noise_a) ** 2)


def signal_shot_factor(gain: Values, k_ratio: Values, bandwidth_hz: Values, noise_a: Values) -> Floats:
    """s in (noise at an echo / noise of the baseline)^2 = 1 + s SNR: the shot noise of the signal itself."""
    return 2.0 * ELEMENTARY_CHARGE_C * excess_noise(gain, k_ratio) * floats(gain) * bandwidth_hz / noise_a


def noise_equivalent_power(noise_a: Values, responsivity: Values, gain: Values) -> Floats:
    """Optical power whose signal current equals the rms noise current. [W]"""
    return floats(noise_a) / (floats(responsivity) * gain)


def adc_noise(full_scale_a: Values, bits: Values) -> Floats:
    """Rms quantisation noise of an ideal converter: full scale/(2^bits sqrt 12). [A]"""
    return floats(floats(full_scale_a) / np.exp2(bits) / np.sqrt(12.0))


def noise_bandwidth(fwhm_s: Values) -> Floats:
    """Default bandwidth for a pulse: 1/(2 FWHM). [Hz]"""
    return 0.5 / floats(fwhm_s)


# ------------------------------------------------------------------------------- statistics
def normal_tail(x: Values) -> Floats:
    """Q(x), upper tail of the normal law; 0 beyond x = 38."""
    return floats(special.ndtr(-floats(x)))


def log10_normal_tail(x: Values) -> Floats:
    """log10 Q(x), also where Q underflows."""
    return floats(floats(special.log_ndtr(-floats(x))) / np.log(10.0))


def detection_probability(tnr: Values, snr: Values) -> Floats:
    """Probability that an echo crosses the threshold, noise equal with and without signal: Q(TNR - SNR)."""
    return normal_tail(floats(tnr) - snr)


def false_alarm_samples(tnr: Values, samples: Values) -> Floats:
    """Probability of a false alarm in n independent samples: 1 - (1 - Q(TNR))^n."""
    return -np.expm1(floats(samples) * np.log1p(-normal_tail(tnr)))


def false_alarm_rice(tnr: Values, bandwidth_hz: Values, max_range_m: Values) -> Floats:
    """Mean number of noise crossings in a gate of this range: (B/sqrt 3) exp(-TNR^2/2) 2 R/c (Rice)."""
    gate_s = 2.0 * floats(max_range_m) / SPEED_OF_LIGHT_M_S
    return floats(floats(bandwidth_hz) / np.sqrt(3.0) * gate_s * exp_or_zero(-0.5 * floats(tnr) ** 2))


def tnr_for_false_alarms(mean_crossings: Values, bandwidth_hz: Values, max_range_m: Values) -> Floats:
    """Threshold over noise for a mean number of noise crossings a gate; 0 where any threshold is quiet enough."""
    at_zero = false_alarm_rice(0.0, bandwidth_hz, max_range_m)
    return np.sqrt(2.0 * np.maximum(np.log(at_zero / floats(mean_crossings)), 0.0))


def noise_echo_amplitude(tnr: Values, uniform: Values) -> Floats:
    """Height over the rms noise of a noise maximum that is above the threshold, from a uniform number in (0, 1].

    Maxima of narrow-band noise follow Rayleigh's law: P(> a) = exp(-(a^2 - TNR^2)/2).
    """
    return np.sqrt(floats(tnr) ** 2 - 2.0 * np.log(np.maximum(floats(uniform), 1e-300)))


def speed_noise(range_sigma_m: Values, interval_s: Values) -> Floats:
    """Noise of a radial speed from two ranges: sqrt 2 sigma/dt. [m/s]"""
    return floats(np.sqrt(2.0) * floats(range_sigma_m) / interval_s)
