"""Single drops and flakes: how many the beam meets, what one sends back, how many alone are seen.

Here: size spectra of rain (Marshall-Palmer) and snow (Marshall-Gunn), the backscatter of a drop, mean numbers. Not
here: which are drawn and how bright they are (particle_light), extinction by rate (atmosphere), the continuum
(softtarget).
Diameters in mm where a name says so; everything else SI.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import special

from emulator.physics.arrays import Floats, Values, exp_or_zero, floats, require_positive
from emulator.physics.constants import SPEED_OF_LIGHT_M_S, WATER_INDEX_905

RAIN_N0 = 8000.0
"Marshall-Palmer: drops per m^3 and mm of diameter at size 0."
LARGEST_DROP_MM = 6.0
"Larger ones break up (Hadj-Bachir and de Souza 2019)."
FLAKE_KAPPA_SR = 0.2
"Backscatter of a flake over its squared diameter: a Lambert disc of reflectance 0.8, rho/4."
CONTINUUM_PER_CELL = 30.0
"Particles in a pulse cell above which a medium is smooth enough for the soft target."


@dataclass(frozen=True)
class Spectrum:
    """Exponential size spectrum: density exp(-slope D) per m^3 and mm; kappa the backscatter of one over D^2."""

    density_m3_mm: float
    slope_mm: float
    kappa_sr: float

    def number_above(self, diameter_mm: Values) -> Floats:
        """Particles per m^3 larger than a diameter in mm."""
        return self.density_m3_mm / self.slope_mm * exp_or_zero(-self.slope_mm * floats(diameter_mm))

    @property
    def backscatter(self) -> float:
        """Backscatter of the medium as a continuum: kappa times the mean of D^2. [1/(m sr)]"""
        return self.kappa_sr * self.density_m3_mm * 2.0 / self.slope_mm**3 * 1e-6


def rain_spectrum(rain_mm_h: float, kappa_sr: float | None = None) -> Spectrum:
    """Marshall-Palmer rain; kappa by default that of a water sphere."""
    require_positive("rain_mm_h", rain_mm_h)
    kappa = float(drop_backscatter(WATER_INDEX_905)) if kappa_sr is None else kappa_sr
    return Spectrum(RAIN_N0, 4.1 * rain_mm_h**-0.21, kappa)


def snow_spectrum(snow_mm_h: float, kappa_sr: float = FLAKE_KAPPA_SR) -> Spectrum:
    """Marshall-Gunn snow by its rate of water; flakes as Lambert discs of their melted size."""
    require_positive("snow_mm_h", snow_mm_h)
    return Spectrum(7600.0 * snow_mm_h**-0.87, 2.55 * snow_mm_h**-0.48, kappa_sr)


def drop_backscatter(index: Values) -> Floats:
    """Backscatter of a sphere of this index over D^2, rays along the axis: front and back face. [1/sr]"""
    n = floats(index)
    r = ((n - 1.0) / (n + 1.0)) ** 2
    return (r + r * (1.0 - r) ** 2 * n**2 / (2.0 - n) ** 2) / 16.0


def rain_drops_in_beam(
    rain_mm_h: Values, min_diameter_mm: Values, half_angle_rad: Values, near_m: Values, far_m: Values
) -> Floats:
    """Mean number of Marshall-Palmer drops above a size in a beam cone."""
    slope = 4.1 * floats(rain_mm_h) ** -0.21
    density = RAIN_N0 / slope * exp_or_zero(-slope * min_diameter_mm)
    return density * np.pi * floats(half_angle_rad) ** 2 * (floats(far_m) ** 3 - floats(near_m) ** 3) / 3.0


def particles_per_cell(spectrum: Spectrum, min_diameter_mm: float, beam_radius_m: Values, fwhm_s: float) -> Floats:
    """Particles above a size in one pulse cell: n pi w^2 c tau/2."""
    cell = np.pi * floats(beam_radius_m) ** 2 * SPEED_OF_LIGHT_M_S * fwhm_s / 2.0
    return spectrum.number_above(min_diameter_mm) * cell


# ------------------------------------------------------------------------------- particles that alone are seen
def detectable_scale(
    half_angle_rad: Values, kappa_sr: Values, peak_w: Values, area_m2: Values, efficiency: Values, threshold_w: Values
) -> Floats:
    """s of the least diameter seen alone at range r: D_min = s r^2, in mm with r in m; top-hat beam, clear path."""
    power = floats(peak_w) * kappa_sr * area_m2 * efficiency
    return 1000.0 * np.sqrt(floats(threshold_w) * np.pi / power) * half_angle_rad


def rain_false_echo_mean(
    rain_mm_h: Values,
    half_angle_rad: Values,
    near_m: Values,
    far_m: Values,
    kappa_sr: Values,
    peak_w: Values,
    area_m2: Values,
    efficiency: Values,
    threshold_w: Values,
) -> Floats:
    """Mean number of drops a shot that alone exceed the threshold between two ranges, without extinction."""
    slope = 4.1 * floats(rain_mm_h) ** -0.21
    b = slope * detectable_scale(half_angle_rad, kappa_sr, peak_w, area_m2, efficiency, threshold_w)
    front = np.pi * floats(half_angle_rad) ** 2 * RAIN_N0 / slope
    return front * (_cone(b, far_m) - _cone(b, near_m))


def detectable_mean(
    spectrum: Spectrum, scale_mm_m2: Values, half_angle_rad: Values, near_m: Values, far_m: Values
) -> Floats:
    """The same for any spectrum; `scale_mm_m2` from `detectable_scale`, arrays of beams broadcast."""
    front = np.pi * floats(half_angle_rad) ** 2 * spectrum.density_m3_mm / spectrum.slope_mm
    b = spectrum.slope_mm * floats(scale_mm_m2)
    return np.maximum(front * (_cone(b, np.maximum(far_m, near_m)) - _cone(b, near_m)), 0.0)


def _cone(b: Floats, r: Values) -> Floats:
    """int_0^r t^2 exp(-b t^2) dt = r^3 gamma(3/2, b r^2) / (2 (b r^2)^(3/2)), the lower incomplete gamma function."""
    r = floats(r)
    y = b * r * r
    small = y < 1e-8
    y_safe = np.where(small, 1.0, y)
    closed = 0.5 * math.gamma(1.5) * special.gammainc(1.5, y_safe) / (y_safe * np.sqrt(y_safe))
    return r**3 * np.where(small, 1.0 / 3.0 - y / 5.0, closed)
