"""How a receiver turns its signal into echoes: the settings of `detection.detect`, and what it gives back.

Here: method of timing, threshold, which echoes are kept, range noise of each method. Not here: the detection itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from emulator.physics.arrays import Bools, Floats, Ints, Values, floats
from emulator.physics.constants import SPEED_OF_LIGHT_M_S
from emulator.physics.pulse import Pulse, centroid_sigma, cfd_gauss, cfd_sin2, crlb_gauss, crlb_sin2

BASE_OF_THRESHOLD, BASE_OF_ECHO = 0.5, 0.1
"What is below the lesser of these shares of the threshold and of the echo's height weighs little in a centroid."
Method = Literal["leading_edge", "constant_fraction", "peak", "centroid"]
Keep = Literal["first", "strongest", "last", "all"]


@dataclass(frozen=True)
class Detector:
    """How the receiver turns its signal into echoes. Lengths in m of apparent range, amplitudes in noise units."""

    pulse: Pulse
    threshold: float
    "TNR: threshold over the nominal rms noise."
    method: Method = "leading_edge"
    walk_table: bool = True
    "Leading edge: subtract the walk of a single echo of the measured height; wrong for mixed echoes, as in sensors."
    keep: Keep = "first"
    max_echoes: int = 1
    resolution_m: float = 0.01
    "Least step of the reported range; sub-echoes within a quarter of it are one."
    bin_s: float | None = None
    "Step of the sampled waveform; None: a sixteenth of the pulse's FWHM, 1 ns for 16 ns."
    full_scale: float = float("inf")
    "Amplitude at which the signal clips."
    recovery_s: float = 0.0
    "Time for which a clipped echo leaves the receiver blind."
    offset_m: float = 0.0
    "Subtracted from every range: calibration of a leading edge without walk table."
    fraction: float = 0.5
    "Constant fraction."
    delay_s: float | None = None
    "Constant fraction; None: half the FWHM."
    shot_factor: float = 0.0
    "Signal shot noise: (noise at an echo)^2 = noise^2 + shot_factor * amplitude there, see `noise.signal_shot_factor`."
    sampled: bool = False
    "Every cluster is sampled, also those that have a closed form."
    follows_noise: bool = False
    "The threshold is so many times each beam's own noise; else of the nominal one, whatever the light outside."
    floor_m2: float = 0.0
    "Echoes fainter than floor_m2/R^2 are dropped: fog correction by a least reflectance, K times rho."
    bandwidth_hz: float | None = None
    "One-sided, in which the noise is: for the range noise of maxima and centroids; None: 1/(2 FWHM)."
    near_gate_m: float = 0.0
    far_gate_m: float = float("inf")

    def __post_init__(self) -> None:
        if not (np.isfinite(self.threshold) and self.threshold > 0.0):
            raise ValueError(f"threshold: {self.threshold}; want a number > 0")
        if self.method not in ("leading_edge", "constant_fraction", "peak", "centroid"):
            raise ValueError(f"method: {self.method!r}; want leading_edge, constant_fraction, peak or centroid")
        if self.keep not in ("first", "strongest", "last", "all"):
            raise ValueError(f"keep: {self.keep!r}; want first, strongest, last or all")
        if self.max_echoes < 1:
            raise ValueError(f"max_echoes: {self.max_echoes}; want at least 1")
        if self.full_scale <= self.threshold:
            raise ValueError(f"full_scale: {self.full_scale}; want more than the threshold, {self.threshold}")
        if not 0.0 < self.fraction < 1.0:
            raise ValueError(f"fraction: {self.fraction}; want a number between 0 and 1")
        if not 0.0 < self.cfd_delay_s < 2.0 * self.pulse.fwhm_s:
            raise ValueError(f"delay_s: {self.delay_s}; want a number between 0 and {2.0 * self.pulse.fwhm_s}")

    @property
    def bin_m(self) -> float:
        """Step of the sampled waveform in apparent range."""
        return self.pulse.fwhm_m / 16.0 if self.bin_s is None else 0.5 * SPEED_OF_LIGHT_M_S * self.bin_s

    @property
    def closed_form(self) -> bool:
        """Short clusters have one: sums of sin^2 pulses under a leading edge."""
        return self.pulse.shape == "sin2" and self.method == "leading_edge"

    def thresholds(self, rms: Floats) -> Floats:
        """(n,) threshold of beams with this rms noise (n,), in nominal noise units."""
        return self.threshold * rms if self.follows_noise else np.full(len(rms), self.threshold)

    @property
    def cfd_delay_s(self) -> float:
        """Delay of the constant fraction."""
        return 0.5 * self.pulse.fwhm_s if self.delay_s is None else self.delay_s

    @property
    def cfd_lead_m(self) -> float:
        """Where the constant-fraction zero of a single echo lies, from the centre of its pulse."""
        timing = cfd_sin2 if self.pulse.shape == "sin2" else cfd_gauss
        zero_s = float(timing(self.pulse.fwhm_s, self.fraction, self.cfd_delay_s))
        return 0.5 * SPEED_OF_LIGHT_M_S * zero_s - self.pulse.start_lead_m

    def sigma_m(self, amplitude: Values, noise: Values = 1.0, threshold: Values | None = None) -> Floats:
        """Range noise of the method for single echoes; for the leading edge `detect` shifts the threshold instead."""
        snr = np.maximum(floats(amplitude) / noise, 1e-9)
        tau = self.pulse.fwhm_s
        if self.method == "constant_fraction":
            lead, delay, h = self.cfd_lead_m, 0.5 * SPEED_OF_LIGHT_M_S * self.cfd_delay_s, 1e-6 * self.pulse.fwhm_m
            x = np.array([lead - h, lead + h])
            y = self.fraction * self.pulse.profile(x) - self.pulse.profile(x - delay)
            slope = abs(float(y[1] - y[0])) / (2.0 * h)
            return floats(np.sqrt(1.0 + self.fraction**2) / (slope * snr))
        bandwidth = 0.5 / tau if self.bandwidth_hz is None else self.bandwidth_hz
        if self.method == "centroid":
            level = self.threshold if threshold is None else threshold
            base = np.minimum(BASE_OF_ECHO, BASE_OF_THRESHOLD * level / np.maximum(floats(amplitude), 1e-9))
            return centroid_sigma(self.pulse, base, snr, bandwidth)
        # the maximum behind the filter that fits the pulse: the Cramer-Rao bound
        bound = crlb_sin2 if self.pulse.shape == "sin2" else crlb_gauss
        return bound(tau, snr, bandwidth)


@dataclass(frozen=True, eq=False)
class Echoes:
    """Reported echoes of n beams, up to k each, nearest first, NaN where there is none."""

    range_m: Floats
    "(n, k)"
    amplitude: Floats
    "(n, k) measured peak in noise units, at least the threshold"
    saturated: Bools
    "(n, k)"
    source: Ints
    "(n, k) source of the sub-echo that the echo is mostly made of; -1 medium, noise or none"

    @property
    def count(self) -> Ints:
        """(n,) echoes of each beam."""
        return np.asarray(np.count_nonzero(np.isfinite(self.range_m), axis=1), np.int64)
