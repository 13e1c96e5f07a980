"""The receiver's electronics as a linear filter: how it shapes the pulse, and the noise that it correlates.

Here: closed forms of pulses behind a pole or a Gaussian low-pass, their tails and undershoot, rates of noise crossings.
Not here: clipping, noise draws and echoes of a scan (shaped). Apparent range counts from the centre of the pulse.

References
----------
G. F. Knoll, Radiation Detection and Measurement, 4th ed., ch. 16.III and 17.I: CR-RC shaping, undershoot of an AC
coupling, overload recovery. S. O. Rice, Mathematical Analysis of Random Noise, Bell Syst. Tech. J. 23/24 (1944/45),
eq. 3.3-11: rate of crossings. D. B. Owen, Ann. Math. Statist. 27 (1956) 1075: bivariate normal tail.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from scipy import special

from emulator.physics.arrays import Floats, Values, exp_or_zero, floats
from emulator.physics.constants import FWHM_PER_SIGMA, SPEED_OF_LIGHT_M_S
from emulator.physics.pulse import Pulse

ResponseShape = Literal["single_pole", "gauss"]
Clips = Literal["before", "after"]
RatedAt = Literal["input", "output"]

FINEST = 1024
"Steps of the shaped pulse's table in the pulse's FWHM."
MOST_STEPS = 1_000_000
TIME_CONSTANTS = 15.0
"After so many an exponential is nothing: 3e-7."


@dataclass(frozen=True)
class Response:
    """A receiver's electronics."""

    shape: ResponseShape
    corner_hz: float
    "Where the power has fallen to a half."
    clips: Clips = "after"
    "The full scale limits the current before the filter, or the voltage after it."
    rated_at: RatedAt = "output"
    "Where amplitudes are those of an ideal receiver: `output`: a single echo keeps its peak."
    coupling_s: float = math.inf
    "Time constant of an AC coupling, whose undershoot lasts so long; infinite: coupled directly."
    tail_share: float = 0.0
    "Share of the charge that comes late, from carriers that diffuse into the detector or an amplifier in overload."
    tail_s: float = 1e-9
    "Time constant with which it comes."

    @property
    def pole_s(self) -> float:
        """Time constant of the pole: 1/(2 pi f)."""
        return 0.5 / (math.pi * self.corner_hz)

    @property
    def sigma_s(self) -> float:
        """Standard deviation of the Gaussian impulse response: sqrt(ln 2)/(2 pi f)."""
        return math.sqrt(math.log(2.0)) / (2.0 * math.pi * self.corner_hz)

    @property
    def noise_bandwidth_hz(self) -> float:
        """Of the ideal low-pass that passes as much white noise."""
        if self.shape == "single_pole":
            return 0.5 * math.pi * self.corner_hz
        return math.sqrt(math.pi / math.log(16.0)) * self.corner_hz

    def correlation(self, lag_s: Values) -> Floats:
        """Of the noise with itself after a lag."""
        if self.shape == "single_pole":
            return exp_or_zero(-np.abs(lag_s) / self.pole_s)
        return exp_or_zero(-((floats(lag_s) / (2.0 * self.sigma_s)) ** 2))

    def crossings_hz(self, tnr: Values, step_s: float) -> Floats:
        """Rate at which noise rises through a threshold from one sample to the next.

        ``2 T(TNR, sqrt((1 - r)/(1 + r)))/step``, T Owen's function, r the correlation of neighbours. For short steps
        Rice's formula with the rms frequency of the Gaussian, f/sqrt(2 ln 2); a pole has none: it grows without bound.
        """
        r = float(self.correlation(step_s))
        if self.shape == "gauss":
            q = 0.5 * step_s / self.sigma_s
            least = -math.expm1(-q * q)
        else:
            least = -math.expm1(-step_s / self.pole_s)
        return floats(2.0 * special.owens_t(floats(tnr), math.sqrt(least / (1.0 + r))) / step_s)

    def taps(self, step_s: float) -> Floats:
        """White normal numbers a step apart, weighted so and summed, are the noise at rms 1."""
        if self.shape == "single_pole":
            g = np.exp(-step_s / self.pole_s * np.arange(math.ceil(12.0 * self.pole_s / step_s) + 1))
        else:
            reach = math.ceil(6.0 * self.sigma_s / step_s)
            g = np.exp(-0.5 * (step_s / self.sigma_s * np.arange(-reach, reach + 1)) ** 2)
        return np.asarray(g / np.sqrt(np.sum(g * g)), np.float64)


# ------------------------------------------------------------------------------- closed forms
def pole_on_sin2(time_s: Values, fwhm_s: float, pole_s: float) -> Floats:
    """sin^2 pulse of peak 1 behind a pole, time from its start: physics_joins section 12."""
    t = floats(time_s)
    w = math.pi / fwhm_s
    q = (w * pole_s) ** 2
    inside = np.clip(t, 0.0, 2.0 * fwhm_s)
    y = 0.5 * (
        1.0 - (np.cos(w * inside) + w * pole_s * np.sin(w * inside)) / (1.0 + q)
        - q / (1.0 + q) * exp_or_zero(-inside / pole_s)
    )  # fmt: skip
    return np.where(t < 0.0, 0.0, y * exp_or_zero(-np.maximum(t - 2.0 * fwhm_s, 0.0) / pole_s))


def pole_on_sin2_end(fwhm_s: Values, pole_s: Values) -> Floats:
    """What is left of it at the end of the pulse, over the pulse's own peak."""
    q = (np.pi / floats(fwhm_s) * pole_s) ** 2
    return 0.5 * q / (1.0 + q) * -np.expm1(-2.0 * floats(fwhm_s) / pole_s)


def blind_after_sin2(amplitude: Values, threshold: Values, fwhm_s: Values, pole_s: Values) -> Floats:
    """Time from the start of a sin^2 pulse until its tail behind a pole is under the threshold, if later than 2 FWHM.

    ``2 FWHM + T ln(A y_e/threshold)``; NaN where the tail never is above it.
    """
    over = floats(amplitude) * pole_on_sin2_end(fwhm_s, pole_s) / threshold
    later = np.log(np.maximum(over, 1.0)) * pole_s
    return np.where(over > 1.0, 2.0 * floats(fwhm_s) + later, np.nan)


def pole_on_gauss(time_s: Values, fwhm_s: float, pole_s: float) -> Floats:
    """Gaussian pulse of peak 1 behind a pole, time from its centre: the exponentially modified Gaussian."""
    sigma = fwhm_s / FWHM_PER_SIGMA
    t = floats(time_s)
    z = (sigma / pole_s - t / sigma) / math.sqrt(2.0)
    front = sigma / pole_s * math.sqrt(0.5 * math.pi)
    early = exp_or_zero(-0.5 * (t / sigma) ** 2) * special.erfcx(np.maximum(z, 0.0))
    late = exp_or_zero(0.5 * (sigma / pole_s) ** 2 - np.maximum(t, 0.0) / pole_s) * special.erfc(np.minimum(z, 0.0))
    return floats(front * np.where(z >= 0.0, early, late))


def gauss_on_gauss(time_s: Values, fwhm_s: float, sigma_s: float) -> Floats:
    """Gaussian pulse of peak 1 behind a Gaussian low-pass: widths add in squares."""
    own = fwhm_s / FWHM_PER_SIGMA
    both = math.hypot(own, sigma_s)
    return floats(own / both * exp_or_zero(-0.5 * (floats(time_s) / both) ** 2))


def gauss_on_sin2(time_s: Values, fwhm_s: float, sigma_s: float) -> Floats:
    """sin^2 pulse of peak 1 behind a Gaussian low-pass, time from its centre; error functions of complex argument."""
    t, k = floats(time_s), math.pi / fwhm_s
    wide = sigma_s * math.sqrt(2.0)
    near = np.clip(t, -fwhm_s - 9.0 * sigma_s, fwhm_s + 9.0 * sigma_s)
    flat = special.erf((fwhm_s - near) / wide) - special.erf((-fwhm_s - near) / wide)
    turn = 1j * k * sigma_s**2
    wave = special.erf((fwhm_s - near - turn) / wide) - special.erf((-fwhm_s - near - turn) / wide)
    swing = np.real(np.exp(1j * k * near) * wave) * math.exp(-0.5 * (k * sigma_s) ** 2)
    return np.where(near == t, np.maximum(0.25 * (flat + swing), 0.0), 0.0)


# ------------------------------------------------------------------------------- the whole shaped pulse
@dataclass(frozen=True)
class ShapedPulse:
    """A pulse of peak 1 behind the electronics, tabulated over apparent range up to where it is nothing."""

    pulse: Pulse
    response: Response
    farthest_m: float
    "Nobody looks farther behind a pulse than this."

    @cached_property
    def lead_m(self) -> float:
        """How far before its centre it begins."""
        early = 8.0 * self.response.sigma_s if self.response.shape == "gauss" else 0.0
        return self.pulse.half_support_m + 0.5 * SPEED_OF_LIGHT_M_S * early

    @cached_property
    def trail_m(self) -> float:
        """How far behind its centre it is followed."""
        r = self.response
        longest = r.pole_s if r.shape == "single_pole" else r.sigma_s
        if math.isfinite(r.coupling_s):
            longest = max(longest, r.coupling_s)
        if r.tail_share > 0.0:
            longest = max(longest, r.tail_s)
        late = self.pulse.half_support_m + 0.5 * SPEED_OF_LIGHT_M_S * TIME_CONSTANTS * longest
        return min(late, max(self.farthest_m, 4.0 * self.pulse.half_support_m))

    @cached_property
    def step_m(self) -> float:
        """Of the table."""
        return max(self.pulse.fwhm_m / FINEST, (self.lead_m + self.trail_m) / MOST_STEPS)

    @cached_property
    def x_m(self) -> Floats:
        """(k,) apparent range from the pulse's centre."""
        count = math.ceil((self.lead_m + self.trail_m) / self.step_m) + 1
        return -self.lead_m + self.step_m * np.arange(count, dtype=np.float64)

    @cached_property
    def value(self) -> Floats:
        """(k,) there; the peak is 1 where the receiver is rated at its output."""
        y = self.filtered(self._low_passed(), self.step_m)
        return y / y.max() if self.response.rated_at == "output" else y

    @cached_property
    def gain(self) -> float:
        """By which the filter multiplies a constant current so that `value` has its scale."""
        if self.response.rated_at == "input":
            return 1.0
        return float(1.0 / self.filtered(self._low_passed(), self.step_m).max())

    @cached_property
    def peak(self) -> float:
        """Largest value."""
        return float(self.value.max())

    @cached_property
    def envelope(self) -> Floats:
        """(k,) largest size of the value from there on."""
        return floats(np.maximum.accumulate(np.abs(self.value)[::-1])[::-1])

    def at(self, x_m: Floats) -> Floats:
        """Value at any apparent range."""
        return np.interp(x_m, self.x_m, self.value, left=0.0, right=0.0)

    def reach_m(self, smallest: Floats) -> Floats:
        """From where on it is never larger than this."""
        falling = self.envelope[::-1]
        left = falling.searchsorted(smallest, side="right")
        return self.x_m[np.clip(len(falling) - left, 0, len(falling) - 1)]

    def lead(self, height_over_threshold: Floats) -> Floats:
        """By how much a threshold crossing precedes the centre of the pulse; amplitude over threshold >= 1. [m]"""
        top = int(np.argmax(self.value))
        first = int(np.argmax(self.value > 0.0))
        rise = np.maximum.accumulate(self.value[max(first - 1, 0) : top + 1]) / self.peak
        return -np.interp(1.0 / np.maximum(height_over_threshold, 1.0), rise, self.x_m[max(first - 1, 0) : top + 1])

    def _low_passed(self) -> Floats:
        t = 2.0 * self.x_m / SPEED_OF_LIGHT_M_S
        r, tau = self.response, self.pulse.fwhm_s
        if r.shape == "single_pole":
            if self.pulse.shape == "sin2":
                return pole_on_sin2(t + tau, tau, r.pole_s)
            return pole_on_gauss(t, tau, r.pole_s)
        if self.pulse.shape == "sin2":
            return gauss_on_sin2(t, tau, r.sigma_s)
        return gauss_on_gauss(t, tau, r.sigma_s)

    def filtered(self, signal: Floats, step_m: float) -> Floats:
        """The late charge and the AC coupling applied to samples along the last axis, straight lines between them."""
        r, step_s = self.response, 2.0 * step_m / SPEED_OF_LIGHT_M_S
        y = signal
        if r.tail_share > 0.0:
            y = (1.0 - r.tail_share) * y + r.tail_share * exponential(y, step_s, r.tail_s)
        if math.isfinite(r.coupling_s):
            y = y - exponential(y, step_s, r.coupling_s)
        return y

    def whole(self, signal: Floats, step_m: float) -> Floats:
        """All of the electronics applied to samples of the current along the last axis, in the scale of `value`."""
        r, step_s = self.response, 2.0 * step_m / SPEED_OF_LIGHT_M_S
        if r.shape == "single_pole":
            y = exponential(signal, step_s, r.pole_s)
        else:
            from scipy import ndimage

            y = np.asarray(ndimage.gaussian_filter1d(signal, r.sigma_s / step_s, axis=-1, mode="constant", truncate=6))
        return self.gain * self.filtered(y, step_m)


def exponential(signal: Floats, step_s: float, constant_s: float) -> Floats:
    """A pole of this time constant on samples along the last axis: exact for straight lines between them."""
    from scipy.signal import lfilter  # takes long to import, and few receivers are shaped

    a = math.exp(-step_s / constant_s)
    mean = constant_s / step_s * -math.expm1(-step_s / constant_s)
    return np.asarray(lfilter([1.0 - mean, mean - a], [1.0, -a], signal, axis=-1), np.float64)
