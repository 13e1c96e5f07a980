"""The emitted pulse: its shape, peak power, and where single echoes of it cross a threshold or reach their maximum.

Here: closed forms of one or two echoes. Not here: sums over the sub-echoes of a scan (waveform) and the choice of
echoes (detection). Apparent range x = c t / 2; t counts from the start of the emitted pulse for sin^2, from its centre
for the Gaussian pulse, which has no start.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from scipy import special

from emulator.physics.arrays import Floats, Values, exp_or_zero, floats
from emulator.physics.constants import FWHM_PER_SIGMA, SPEED_OF_LIGHT_M_S

C = SPEED_OF_LIGHT_M_S
PulseShape = Literal["sin2", "gauss"]


@dataclass(frozen=True)
class Pulse:
    """Shape and length of the emitted pulse; lengths in apparent range are half those in flight."""

    fwhm_s: float
    shape: PulseShape = "sin2"

    def __post_init__(self) -> None:
        if not (np.isfinite(self.fwhm_s) and self.fwhm_s > 0.0):
            raise ValueError(f"fwhm_s: {self.fwhm_s}; want a number > 0")
        if self.shape not in ("sin2", "gauss"):
            raise ValueError(f"shape: {self.shape!r}; want sin2 or gauss")

    @cached_property
    def fwhm_m(self) -> float:
        """Full width at half maximum in apparent range."""
        return 0.5 * C * self.fwhm_s

    @cached_property
    def sigma_m(self) -> float:
        """Standard deviation of the Gaussian of the same FWHM, in apparent range."""
        return self.fwhm_m / FWHM_PER_SIGMA

    @cached_property
    def half_support_m(self) -> float:
        """Distance from the centre beyond which the pulse is nothing: exactly for sin^2, below 1e-11 for Gauss."""
        return self.fwhm_m if self.shape == "sin2" else 3.0 * self.fwhm_m

    @cached_property
    def start_lead_m(self) -> float:
        """Distance from the instant that counts as zero to the centre: sin^2 counts from its start."""
        return self.fwhm_m if self.shape == "sin2" else 0.0

    @cached_property
    def wave_number(self) -> float:
        """k of `series`; 2 pi/(c tau) for sin^2, whose pulse is (1 + cos k x)/2. [1/m]"""
        return float(np.pi / self.half_support_m)

    @cached_property
    def series(self) -> Floats:
        """c_m of the pulse as a cosine series, sum of c_m cos(m k x) with k = pi/half_support_m, |x| < half_support_m.

        sin^2 is exactly two terms; the Gaussian's 18 leave 1e-12.
        """
        if self.shape == "sin2":
            return np.array([0.5, 0.5])
        m = np.arange(18.0)
        ratio = self.sigma_m / self.half_support_m
        terms = np.sqrt(2.0 * np.pi) * ratio * np.exp(-0.5 * (np.pi * ratio * m) ** 2)
        terms[0] *= 0.5
        return floats(terms)

    def profile(self, x_m: Values) -> Floats:
        """Pulse over its peak at apparent range x from its centre."""
        x = floats(x_m)
        if self.shape == "sin2":
            return np.where(np.abs(x) < self.fwhm_m, np.cos(0.5 * np.pi / self.fwhm_m * x) ** 2, 0.0)
        return exp_or_zero(-0.5 * (x / self.sigma_m) ** 2)

    def peak_power(self, energy_j: Values) -> Floats:
        """Peak power of a pulse of this energy. [W]"""
        if self.shape == "sin2":
            return peak_power_sin2(energy_j, self.fwhm_s)
        return peak_power_gauss(energy_j, self.fwhm_s)

    def lead(self, amplitude_over_threshold: Values) -> Floats:
        """Distance by which the threshold crossing precedes the centre of a single echo, 0 at amplitude 1. [m]"""
        if self.shape == "sin2":
            return self.fwhm_m - walk_sin2(self.fwhm_s, amplitude_over_threshold)
        return -walk_gauss(self.fwhm_s, amplitude_over_threshold)


# ------------------------------------------------------------------------------- energy and peak
def peak_power_sin2(energy_j: Values, fwhm_s: Values) -> Floats:
    """Peak of a sin^2 pulse: E / FWHM. [W]"""
    return floats(energy_j) / fwhm_s


def peak_power_gauss(energy_j: Values, fwhm_s: Values) -> Floats:
    """Peak of a Gaussian pulse: 2 sqrt(ln 2 / pi) E / FWHM. [W]"""
    return floats(2.0 * np.sqrt(np.log(2.0) / np.pi) * floats(energy_j) / fwhm_s)


# ------------------------------------------------------------------------------- crossings of one echo
def walk_sin2(fwhm_s: Values, amplitude_over_threshold: Values) -> Floats:
    """Leading edge on a sin^2 pulse, apparent range after its start; NaN below the threshold (no echo). [m]"""
    q = floats(amplitude_over_threshold)
    seen = q >= 1.0
    root = np.sqrt(1.0 / np.where(seen, q, 1.0))
    # near the maximum asin(root) loses digits; atan2 keeps them
    angle = np.arctan2(root, np.sqrt(np.where(seen, q, 1.0) - 1.0) * root)
    return np.where(seen, C * floats(fwhm_s) / np.pi * angle, np.nan)


def walk_gauss(fwhm_s: Values, amplitude_over_threshold: Values) -> Floats:
    """Leading edge on a Gaussian pulse, apparent range from its centre (<= 0); NaN below the threshold. [m]"""
    q = floats(amplitude_over_threshold)
    seen = q >= 1.0
    root = np.sqrt(2.0 * np.log1p(np.where(seen, q, 1.0) - 1.0))
    return np.where(seen, -0.5 * C * floats(fwhm_s) / FWHM_PER_SIGMA * root, np.nan)


def cfd_sin2(fwhm_s: Values, fraction: Values, delay_s: Values) -> Floats:
    """Constant fraction on a sin^2 pulse: zero of f s(t) - s(t - d), time from its start; 0 < d < 2 FWHM. [s]"""
    tau = floats(fwhm_s)
    d = 0.5 * np.pi * floats(delay_s) / tau
    return floats(2.0 * tau / np.pi * np.arctan2(np.sin(d), np.cos(d) - np.sqrt(fraction)))


def cfd_gauss(fwhm_s: Values, fraction: Values, delay_s: Values) -> Floats:
    """Constant fraction on a Gaussian pulse: zero of f s(t) - s(t - d), time from its centre. [s]"""
    sigma = floats(fwhm_s) / FWHM_PER_SIGMA
    return 0.5 * floats(delay_s) + sigma**2 * np.log(fraction) / delay_s


# ------------------------------------------------------------------------------- a tilted plane stretches the echo
def tilt_range_sigma(range_m: Values, half_angle_rad: Values, tilt_rad: Values) -> Floats:
    """Standard deviation of range over the beam on a tilted plane: R (theta/2) tan(tilt). [m]"""
    return 0.5 * floats(range_m) * half_angle_rad * np.tan(tilt_rad)


def tilt_peak_gauss(fwhm_s: Values, range_m: Values, half_angle_rad: Values, tilt_rad: Values) -> Floats:
    """Peak of a Gaussian pulse after a tilted plane over its peak after a normal one."""
    return stretch_peak_gauss(fwhm_s, tilt_range_sigma(range_m, half_angle_rad, tilt_rad))


def tilt_peak_sin2(fwhm_s: Values, range_m: Values, half_angle_rad: Values, tilt_rad: Values) -> Floats:
    """The same for a sin^2 pulse: int cos^2(pi t/(2 FWHM)) N(t; 0, s) dt."""
    return stretch_peak_sin2(fwhm_s, tilt_range_sigma(range_m, half_angle_rad, tilt_rad))


def stretch_peak_gauss(fwhm_s: Values, range_sigma_m: Values) -> Floats:
    """Peak of a Gaussian pulse spread over ranges of this standard deviation, over its unspread peak."""
    sigma_m = 0.5 * C * floats(fwhm_s) / FWHM_PER_SIGMA
    return 1.0 / np.hypot(1.0, floats(range_sigma_m) / sigma_m)


def stretch_peak_sin2(fwhm_s: Values, range_sigma_m: Values) -> Floats:
    """Peak of a sin^2 pulse spread over ranges of this standard deviation, over its unspread peak.

    Closed form with the Faddeeva function: ``(erf a + e^{-b^2} + e^{-a^2} Re w(-b + i a))/2``, a = L/(s sqrt 2),
    b = pi s/(L sqrt 2), L the half support in range.
    """
    half = 0.5 * C * floats(fwhm_s)
    ratio = np.maximum(floats(range_sigma_m) / half, 1e-9)
    a, b = 1.0 / (ratio * np.sqrt(2.0)), np.pi * ratio / np.sqrt(2.0)
    w = special.wofz(-b + 1j * np.minimum(a, 1e9))
    return floats(0.5 * (special.erf(a) + exp_or_zero(-b * b) + exp_or_zero(-a * a) * np.real(w)))


# ------------------------------------------------------------------------------- two echoes
def two_echo_limit_gauss(fwhm_s: Values) -> Floats:
    """Closest equal Gaussian echoes with two maxima: 2 sigma (Sparrow). [m]"""
    return C * floats(fwhm_s) / FWHM_PER_SIGMA


def two_echo_peak(fwhm_s: float, separation_m: float, amplitude_ratio: float) -> float:
    """Place of the highest maximum of two Gaussian echoes, apparent range from the first centre. [m]

    The ratio is that of the second over the first. Newton from the best point of a grid, kept inside its cell; the
    first of two equal maxima.
    """
    sigma = 0.5 * C * fwhm_s / FWHM_PER_SIGMA
    d = separation_m / sigma
    grid = np.linspace(0.0, d, 201)
    x = float(grid[int(np.argmax(_two(grid, d, amplitude_ratio)))])
    lo, hi = max(0.0, x - d / 200.0), min(d, x + d / 200.0)
    for _ in range(80):
        mid = 0.5 * (lo + hi)
        first, second = np.exp(-0.5 * mid * mid), amplitude_ratio * np.exp(-0.5 * (mid - d) ** 2)
        lo, hi = (mid, hi) if -mid * first - (mid - d) * second > 0.0 else (lo, mid)
    return 0.5 * (lo + hi) * sigma


def _two(x: Floats, d: float, ratio: float) -> Floats:
    return exp_or_zero(-0.5 * x * x) + ratio * exp_or_zero(-0.5 * (x - d) ** 2)


# ------------------------------------------------------------------------------- noise of the measured range
def crlb_sin2(fwhm_s: Values, snr: Values, bandwidth_hz: Values) -> Floats:
    """Cramer-Rao bound of range, sin^2 pulse in white noise: (c/2)(2/pi)(1/SNR) sqrt(FWHM/(2 B)). [m]"""
    return C / np.pi / floats(snr) * np.sqrt(floats(fwhm_s) / (2.0 * floats(bandwidth_hz)))


def crlb_gauss(fwhm_s: Values, snr: Values, bandwidth_hz: Values) -> Floats:
    """Cramer-Rao bound of range, Gaussian pulse in white noise: (c/2)(1/SNR) sqrt(sigma/(sqrt(pi) B)). [m]

    `bandwidth_hz`: in which the noise of the SNR is, one-sided.
    """
    sigma = floats(fwhm_s) / FWHM_PER_SIGMA
    return floats(0.5 * C / floats(snr) * np.sqrt(sigma / (np.sqrt(np.pi) * floats(bandwidth_hz))))


def centroid_sigma(pulse: Pulse, base: Values, snr: Values, bandwidth_hz: float) -> Floats:
    """Range noise of a centroid of samples v weighted with v^5/(v^2 + b^2)^2, white noise, to first order. [m]

    ``sqrt(N0/2 int (w'(s) x)^2 dx)/int w(s) dx`` with N0 = 1/(SNR^2 B), s the pulse and b the base over the peak. Not
    below the Cramer-Rao bound; for b = 0 and sin^2: (c/2) sqrt(FWHM/(3 B))/SNR.
    """
    x = np.linspace(-pulse.half_support_m, pulse.half_support_m, 1025)
    s = pulse.profile(x)
    share = np.clip(floats(base), 1e-4, 1.0)
    node = np.geomspace(1e-4, 1.0, 65)
    square, b2 = s * s, (node * node)[:, None]
    weight = s * square * square / (square + b2) ** 2
    slope = square * square * (square + 5.0 * b2) / (square + b2) ** 3
    step_s = 2.0 * (x[1] - x[0]) / C
    spread = np.sqrt(np.sum((slope * x) ** 2, axis=1) * step_s) / (np.sum(weight, axis=1) * step_s)
    return floats(np.interp(np.log(share), np.log(node), spread) * np.sqrt(0.5 / bandwidth_hz) / floats(snr))


def edge_range_sigma_sin2(fwhm_s: Values, tnr: Values, snr: Values) -> Floats:
    """Range noise of a leading edge on a sin^2 pulse: (c FWHM/(2 pi))/sqrt(TNR (SNR - TNR)), SNR > TNR. [m]"""
    t = floats(tnr)
    return C * floats(fwhm_s) / (2.0 * np.pi) / np.sqrt(t * (floats(snr) - t))


def edge_range_sigma_gauss(fwhm_s: Values, tnr: Values, snr: Values) -> Floats:
    """Range noise of a leading edge on a Gaussian pulse: sigma/(TNR sqrt(2 ln(SNR/TNR))), SNR > TNR. [m]"""
    t = floats(tnr)
    sigma_m = 0.5 * C * floats(fwhm_s) / FWHM_PER_SIGMA
    return sigma_m / (t * np.sqrt(2.0 * np.log(floats(snr) / t)))
