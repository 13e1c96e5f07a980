"""Background light on the detector: sunlit surfaces, sky, the sun itself, stray light; the optical filter; dazzle.

Here: optical powers in W and when they blind the receiver. Not here: the noise that they make (noise).
Angles between directions are taken by `geometry.angle_between`, which keeps its digits near 0 and pi.
"""

from __future__ import annotations

import numpy as np
from scipy import special

from emulator.physics.arrays import Bools, Floats, Values, exp_or_zero, floats
from emulator.physics.constants import (
    BOLTZMANN_J_K,
    FWHM_PER_SIGMA,
    PLANCK_J_S,
    SPEED_OF_LIGHT_M_S,
    SUN_GROUND_DIRECT_W_M2_NM,
    SUN_GROUND_GLOBAL_W_M2_NM,
    SUN_HALF_ANGLE_RAD,
    SUN_TABLE_TOTAL_W_M2,
    SUN_TEMPERATURE_K,
    SUN_TOTAL_W_M2,
)

SATURATION_CURRENT_A = 0.2e-3
"Default photocurrent of background light that blinds the reference receiver. Choice of this project."


def solar_blackbody(wavelength_m: Values, total_w_m2: Values, temperature_k: Values = SUN_TEMPERATURE_K) -> Floats:
    """Spectral irradiance of the sun as a black body scaled to a total. [W/m^2 per m of wavelength]"""
    lam, t = floats(wavelength_m), floats(temperature_k)
    h, c, k = PLANCK_J_S, SPEED_OF_LIGHT_M_S, BOLTZMANN_J_K
    # total = 2 pi^5 k^4 T^4/(15 h^3 c^2), so pi B/total = 15 x^5/(pi^4 (e^x - 1)) k T/(h c) with x = h c/(lam k T)
    x = h * c / (lam * k * t)
    return floats(total_w_m2) * 15.0 / np.pi**4 * x**5 * exp_or_zero(-x) / -np.expm1(-x) * k * t / (h * c)


def solar_ground(wavelength_m: float, total_w_m2: float = SUN_TOTAL_W_M2, direct: bool = False) -> float:
    """Spectral irradiance at the ground, 40 nm mean of ASTM G173-03 scaled to the total. [W/m^2 per m]

    905 and 1550 nm from the table (nearest within 60 nm); other wavelengths take the black body's course between them.
    """
    table = SUN_GROUND_DIRECT_W_M2_NM if direct else SUN_GROUND_GLOBAL_W_M2_NM
    nm = wavelength_m * 1e9
    nearest = min(table, key=lambda known: abs(known - nm))
    value = table[nearest] * 1e9
    if abs(nearest - nm) > 60.0:
        value *= float(solar_blackbody(wavelength_m, 1.0) / solar_blackbody(nearest * 1e-9, 1.0))
    return value * total_w_m2 / SUN_TABLE_TOTAL_W_M2


def solid_angle(half_rad: Values) -> Floats:
    """Solid angle of a cone: 4 pi sin^2(h/2), all digits at any h. [sr]"""
    return 4.0 * np.pi * np.sin(0.5 * floats(half_rad)) ** 2


def background_surface(
    irradiance_w_m2_m: Values,
    bandwidth_m: Values,
    rho: Values,
    sun_incidence_rad: Values,
    aperture_radius_m: Values,
    fov_half_rad: Values,
    efficiency: Values,
) -> Floats:
    """Background from a sunlit Lambert surface that fills the field of view; none when lit from behind. [W]"""
    radiance = floats(irradiance_w_m2_m) * bandwidth_m * rho * np.maximum(np.cos(sun_incidence_rad), 0.0) / np.pi
    return background_sky(radiance, aperture_radius_m, fov_half_rad, efficiency)


def background_sky(
    radiance_w_m2_sr: Values, aperture_radius_m: Values, fov_half_rad: Values, efficiency: Values
) -> Floats:
    """Background from a radiance (within the filter) that fills the field of view. [W]"""
    area = np.pi * floats(aperture_radius_m) ** 2
    return radiance_w_m2_sr * area * solid_angle(fov_half_rad) * efficiency


def sun_share(fov_half_rad: Values, sun_half_rad: Values, separation_rad: Values) -> Floats:
    """Share of the sun's disc inside a circular field of view: two flat circles, centres apart by `separation_rad`."""
    f, s, d = np.broadcast_arrays(floats(fov_half_rad), floats(sun_half_rad), floats(separation_rad))
    inside = d <= np.abs(f - s)
    lens = ~inside & (d < f + s)
    d_safe = np.where(lens, d, np.maximum(f, s))
    f_safe, s_safe = np.maximum(f, 1e-300), np.maximum(s, 1e-300)
    a = np.arccos(np.clip((d_safe**2 + f**2 - s**2) / (2.0 * d_safe * f_safe), -1.0, 1.0))
    b = np.arccos(np.clip((d_safe**2 + s**2 - f**2) / (2.0 * d_safe * s_safe), -1.0, 1.0))
    product = (-d_safe + f + s) * (d_safe + f - s) * (d_safe - f + s) * (d_safe + f + s)
    area = f**2 * a + s**2 * b - 0.5 * np.sqrt(np.maximum(product, 0.0))
    whole = np.minimum(f / s_safe, 1.0) ** 2
    return np.where(inside, whole, np.where(lens, area / (np.pi * s_safe**2), 0.0))


def stray_light(sun_angle_rad: Values, fov_half_rad: Values) -> Floats:
    """Share of direct sunlight that reaches the detector from outside the field: 1e-4 (angle/1 deg)^-2.

    A choice of this project without a source; 0 inside the field of view, where `sun_share` counts.
    """
    g = floats(sun_angle_rad)
    return np.where(g > fov_half_rad, 1e-4 * (np.radians(1.0) / np.maximum(g, 1e-6)) ** 2, 0.0)


def background_sun(
    irradiance_w_m2_m: Values,
    bandwidth_m: Values,
    aperture_radius_m: Values,
    fov_half_rad: Values,
    efficiency: Values,
    sun_angle_rad: Values,
    sun_half_rad: Values = SUN_HALF_ANGLE_RAD,
) -> Floats:
    """Background from the sun in or near the field of view, direct irradiance given; `sun_angle_rad` from the axis. [W]

    Multiply by 0 where something stands before the sun.
    """
    direct = floats(irradiance_w_m2_m) * bandwidth_m * np.pi * floats(aperture_radius_m) ** 2 * efficiency
    seen = sun_share(fov_half_rad, sun_half_rad, sun_angle_rad)
    return direct * np.maximum(seen, np.minimum(stray_light(sun_angle_rad, fov_half_rad), 1.0))


def dazzled(
    background_w: Values, responsivity: Values, gain: Values, saturation_current_a: Values = SATURATION_CURRENT_A
) -> Bools:
    """True where the photocurrent of the background exceeds what the receiver stands."""
    return np.asarray(floats(responsivity) * gain * background_w > saturation_current_a)


# ------------------------------------------------------------------------------- optical filter
def filter_line_share(line_fwhm_m: Values, band_m: Values, offset_m: Values) -> Floats:
    """Share of a Gaussian laser line inside an ideal band whose centre is `offset_m` away."""
    sigma = np.maximum(floats(line_fwhm_m) / FWHM_PER_SIGMA, 1e-15)
    half, off = 0.5 * floats(band_m), np.abs(floats(offset_m))
    # both tails from above: the nearer edge decides, and nothing cancels
    return floats(special.ndtr((half - off) / sigma) - special.ndtr((-half - off) / sigma))


def filter_angle_shift(centre_m: Values, effective_index: Values, incidence_rad: Values) -> Floats:
    """Centre wavelength of an interference filter at an angle: lambda sqrt(1 - (sin/n)^2). [m]"""
    return floats(centre_m) * np.sqrt(1.0 - (np.sin(incidence_rad) / floats(effective_index)) ** 2)


LASER_DRIFT_M_K = 0.3e-9
"Drift of a laser diode's wavelength with temperature, from memory."
