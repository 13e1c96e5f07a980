"""Extinction of air: fog, haze, rain, snow, dust, smoke, spray; how terms add, and where each law holds.

Here: laws from visibility or rate to extinction in 1/m, their ranges of validity as warnings, sums along a ray. Not
here: light scattered back (softtarget) and single drops (precipitation).
A visibility is the distance of two per cent contrast; `visibility_from_mor` converts the five per cent one. No law
clamps its input: outside its range it is computed all the same and `out_of_validity` says so.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np
from scipy import special

from emulator.physics.arrays import Floats, Values, exp_or_zero, floats, require_not_negative, require_positive
from emulator.physics.constants import CLEAR_AIR_VISIBILITY_M, DB_PER_NEPER, LN_50, MOR_PER_VISIBILITY

SPEED_OF_FLAKES_M_S = 1.0
LIDAR_RATIO_SR: Mapping[str, float] = MappingProxyType(
    {
        "fog": 18.8,  # O'Connor et al. 2004 for 905 nm; own Mie runs 17 to 19
        "haze": 70.0,  # Mie rows 69 to 106; clear air and V > 5 km
        "smoke": 60.0,  # not checked
        "dust": 45.0,  # mineral dust, not checked
        "snow": 20.0,  # not checked
        "spray": 18.8,
    }
)
"Extinction over backscatter by medium, in sr. Rain: `rain_lidar_ratio`."
HAZE_FROM_M = 5000.0
"Visibility from which fog counts as haze in the choice of the lidar ratio."


# ------------------------------------------------------------------------------- units
def db_per_km(alpha: Values) -> Floats:
    """Extinction in dB/km from 1/m."""
    return floats(alpha) * DB_PER_NEPER * 1000.0


def extinction_from_db_per_km(db: Values) -> Floats:
    """Extinction in 1/m from dB/km."""
    return floats(db) / (DB_PER_NEPER * 1000.0)


def visibility_from_mor(mor_m: Values) -> Floats:
    """Visibility of two per cent contrast from the meteorological optical range of five per cent. [m]"""
    return floats(mor_m) / MOR_PER_VISIBILITY


# ------------------------------------------------------------------------------- transmission
def transmission_two_way(alpha: Values, range_m: Values) -> Floats:
    """Share of the light left after the way out and back: exp(-2 alpha R); exactly 0 below 1e-250."""
    return exp_or_zero(-2.0 * floats(alpha) * range_m)


def log10_transmission_two_way(alpha: Values, range_m: Values) -> Floats:
    """Decades of the two-way transmission, also where it underflows itself."""
    return floats(-2.0 * floats(alpha) * range_m / np.log(10.0))


def optical_depth(range_m: Values, alpha: Values, enter_m: Values, leave_m: Values) -> Floats:
    """One-way optical depth at a range through a cloud between two distances along the ray. [-]

    Broadcasts; sum the clouds and layers that a ray crosses: T^2 = exp(-2 sum).
    """
    return floats(alpha) * np.maximum(np.minimum(range_m, leave_m) - floats(enter_m), 0.0)


# ------------------------------------------------------------------------------- fog and haze from visibility
def _koschmieder(visibility_m: Values, wavelength_m: Values, q: Values) -> Floats:
    return LN_50 / floats(visibility_m) * (floats(wavelength_m) / 550e-9) ** (-floats(q))


def fog_koschmieder(visibility_m: Values) -> Floats:
    """ln 50 / V, the same at every wavelength: for a measured V of anything, dust and rain included. [1/m]"""
    require_positive("visibility_m", visibility_m)
    return LN_50 / floats(visibility_m)


def fog_kruse(visibility_m: Values, wavelength_m: Values) -> Floats:
    """Kruse 1962, ITU-R P.1817-1: for haze, not for fog. Jumps at V = 6 km and 50 km. [1/m]"""
    require_positive("visibility_m", visibility_m)
    v = floats(visibility_m) / 1000.0
    q = np.where(v > 50.0, 1.6, np.where(v > 6.0, 1.3, 0.585 * np.cbrt(v)))
    return _koschmieder(visibility_m, wavelength_m, q)


def fog_kim(visibility_m: Values, wavelength_m: Values) -> Floats:
    """Kim, McArthur, Korevaar 2001, the default: no wavelength dependence in fog. Jumps at V = 50 km. [1/m]"""
    require_positive("visibility_m", visibility_m)
    v = floats(visibility_m) / 1000.0
    q = np.where(v > 50.0, 1.6, np.where(v > 6.0, 1.3, np.where(v > 1.0, 0.16 * v + 0.34, np.maximum(v - 0.5, 0.0))))
    return _koschmieder(visibility_m, wavelength_m, q)


def fog_naboulsi_advection(visibility_m: Values, wavelength_m: Values) -> Floats:
    """Al Naboulsi, Sizun, de Fornel 2004, advection fog. [1/m]"""
    require_positive("visibility_m", visibility_m)
    return (0.11478 * floats(wavelength_m) * 1e6 + 3.8367) / floats(visibility_m)


def fog_naboulsi_radiation(visibility_m: Values, wavelength_m: Values) -> Floats:
    """Al Naboulsi, Sizun, de Fornel 2004, radiation fog (also printed "convection"). [1/m]"""
    require_positive("visibility_m", visibility_m)
    um = floats(wavelength_m) * 1e6
    return (0.18126 * um * um + 0.13709 * um + 3.7502) / floats(visibility_m)


def _ijaz(visibility_m: Values, wavelength_m: Values, a: float, b: float) -> Floats:
    require_positive("visibility_m", visibility_m)
    um = floats(wavelength_m) * 1e6
    return 17.0 / floats(visibility_m) * (um / 0.55) ** (b - a * um) / DB_PER_NEPER


def fog_ijaz(visibility_m: Values, wavelength_m: Values) -> Floats:
    """Ijaz et al. 2013, fog; its 17/V is dB/km. [1/m]"""
    return _ijaz(visibility_m, wavelength_m, 0.1428, 0.0947)


def smoke_ijaz(visibility_m: Values, wavelength_m: Values) -> Floats:
    """Ijaz et al. 2013, smoke; its 17/V is dB/km. [1/m]"""
    return _ijaz(visibility_m, wavelength_m, 0.8467, 0.5212)


def dust_esmail(visibility_m: Values) -> Floats:
    """Esmail, Fathallah, Alouini 2017, dust and sand at 1550 nm: 52 V^-1.05 dB/km, not verified. [1/m]"""
    require_positive("visibility_m", visibility_m)
    return 52.0 * (floats(visibility_m) / 1000.0) ** -1.05 / DB_PER_NEPER / 1000.0


def clear_air(wavelength_m: Values, visibility_m: Values = CLEAR_AIR_VISIBILITY_M) -> Floats:
    """Clear air of the given visibility by the law of Kim. [1/m]"""
    return fog_kim(visibility_m, wavelength_m)


# ------------------------------------------------------------------------------- rain and snow from their rate
def _power_law(rate_mm_h: Values, k: Values, a: float, name: str) -> Floats:
    require_not_negative(name, rate_mm_h)
    with np.errstate(under="ignore"):  # a rate of 1e-300 is none
        return floats(k * floats(rate_mm_h) ** a / DB_PER_NEPER / 1000.0)


def rain_carbonneau(rain_mm_h: Values) -> Floats:
    """Carbonneau and Wisely 1998, the default: 1.076 R^0.67 dB/km. [1/m]"""
    return _power_law(rain_mm_h, 1.076, 0.67, "rain_mm_h")


def rain_japan(rain_mm_h: Values) -> Floats:
    """Japan law: 1.58 R^0.63 dB/km. [1/m]"""
    return _power_law(rain_mm_h, 1.58, 0.63, "rain_mm_h")


def rain_itu_mu0(rain_mm_h: Values) -> Floats:
    """ITU-R P.1814-1 (2025), gamma shape 0: 1.2924 R^0.6436 dB/km. [1/m]"""
    return _power_law(rain_mm_h, 1.2924, 0.6436, "rain_mm_h")


def rain_marshall_palmer(rain_mm_h: Values, q_ext: Values = 2.0) -> Floats:
    """Drops after Marshall and Palmer 1948 with a constant efficiency: pi Q N0/(2 L^3). [1/m]"""
    require_not_negative("rain_mm_h", rain_mm_h)
    # L = 4.1 R^-0.21 per mm; L^-3 written with R on top, so that no rain is 0
    return np.pi * floats(q_ext) * 8000.0 / 2.0 * floats(rain_mm_h) ** 0.63 / 4.1**3 * 1e-6


def fall_speed_atlas(diameter_mm: Values) -> Floats:
    """Fall speed of a drop, Atlas, Srivastava, Sekhon 1973, 0.5 to 6 mm: 9.65 - 10.3 exp(-0.6 D). [m/s]"""
    return 9.65 - 10.3 * np.exp(-0.6 * floats(diameter_mm))


def rain_one_size(rain_mm_h: Values, radius_m: Values, q_ext: Values = 2.0) -> Floats:
    """Rain of one drop size, radius 0.25 to 3 mm: 3 Q R/(4 b v). [1/m]"""
    require_not_negative("rain_mm_h", rain_mm_h)
    speed = fall_speed_atlas(2000.0 * floats(radius_m))
    if not bool(np.all(speed > 0.0)):
        raise ValueError(f"radius_m: {radius_m}; want 0.00025 to 0.003 m, smaller drops have no fall speed in this law")
    return 3.0 * floats(q_ext) * (floats(rain_mm_h) / 3.6e6) / (4.0 * floats(radius_m) * speed)


def rain_stokes(rain_mm_h: Values, radius_m: Values, q_ext: Values = 2.0) -> Floats:
    """One drop size with Stokes' fall speed, the form of Ali 2013 as it circulates: not usable above 0.04 mm. [1/m]

    Kept to show what it does: 1089 m/s at a radius of 3 mm. No scenario offers it.
    """
    b = floats(radius_m)
    speed = 2.0 * b * b * 1000.0 * 9.8 / (9.0 * 1.8e-5)
    return 3.0 * floats(q_ext) * (floats(rain_mm_h) / 3.6e6) / (4.0 * b * speed)


def snow_wet(snow_mm_h: Values, wavelength_m: Values) -> Floats:
    """Wet snow by its rate in mm/h of water, ITU-R P.1817-1 table 2. [1/m]"""
    return _power_law(snow_mm_h, 0.0001023 * floats(wavelength_m) * 1e9 + 3.7855466, 0.72, "snow_mm_h")


def snow_dry(snow_mm_h: Values, wavelength_m: Values) -> Floats:
    """Dry snow by its rate in mm/h of water, ITU-R P.1817-1 table 2. [1/m]"""
    return _power_law(snow_mm_h, 0.0000542 * floats(wavelength_m) * 1e9 + 5.4958776, 1.38, "snow_mm_h")


def q_forward(diameter_m: Values, wavelength_m: Values, half_angle_rad: Values) -> Floats:
    """Extinction efficiency of a large drop when light diffracted within the half angle is not lost.

    1 + J0^2(u) + J1^2(u), u = pi D sin(theta)/lambda: 2 for a narrow beam or a small droplet, 1 for a wide one.
    """
    with np.errstate(under="ignore"):  # an angle of 1e-200 is none
        u = np.pi * floats(diameter_m) / wavelength_m * np.sin(half_angle_rad)
        return floats(1.0 + special.j0(u) ** 2 + special.j1(u) ** 2)


def forward_scatter_factor(rain_mm_h: float, wavelength_m: float, half_angle_rad: float) -> float:
    """Extinction of Marshall-Palmer rain with light kept in the cone, over that with Q = 2; 1 without rain."""
    if rain_mm_h == 0.0:
        return 1.0
    slope = 4.1 * rain_mm_h**-0.21
    x, weight = special.roots_genlaguerre(48, 2.0)  # weights D^2 exp(-L D)
    q = q_forward(x / slope * 1e-3, wavelength_m, half_angle_rad)
    return float(np.sum(weight * q) / np.sum(weight) / 2.0)


def spray(speed_m_s: Values, dense: bool = False) -> Floats:
    """Extinction behind a vehicle on a wet road: 0.0045 (0.017 dense) at 100 km/h, with the speed squared. [1/m]

    A choice of this project from the spray rows of a Mie table; the box is 10 m by 2.5 m by 1.5 m behind the rear axle.
    """
    return (0.017 if dense else 0.0045) * (floats(speed_m_s) / (100.0 / 3.6)) ** 2


SPRAY_BOX_M = (10.0, 2.5, 1.5)
"Length behind the rear axle, width, height."

# ------------------------------------------------------------------------------- laws by name, and where they hold
FOG_LAWS: Mapping[str, Callable[[Values, Values], Floats]] = MappingProxyType(
    {
        "kim": fog_kim,
        "kruse": fog_kruse,
        "naboulsi_advection": fog_naboulsi_advection,
        "naboulsi_radiation": fog_naboulsi_radiation,
        "ijaz": fog_ijaz,
    }
)
RAIN_LAWS: Mapping[str, Callable[[Values], Floats]] = MappingProxyType(
    {"carbonneau": rain_carbonneau, "japan": rain_japan, "itu": rain_itu_mu0, "marshall_palmer": rain_marshall_palmer}
)
"Laws of the rate alone; `one_size` wants a drop radius too: `rain_one_size`."
SNOW_LAWS: Mapping[str, Callable[[Values, Values], Floats]] = MappingProxyType({"wet": snow_wet, "dry": snow_dry})

_VALIDITY: Mapping[str, tuple[float, float, float, float]] = MappingProxyType(
    {  # least and largest visibility in m, least and largest wavelength in m
        "kim": (0.0, np.inf, 785e-9, 1550e-9),
        "kruse": (1000.0, np.inf, 400e-9, 1550e-9),
        "naboulsi_advection": (50.0, 1000.0, 690e-9, 1550e-9),
        "naboulsi_radiation": (50.0, 1000.0, 690e-9, 1550e-9),
        "ijaz": (15.0, 1000.0, 550e-9, 1600e-9),
        "smoke_ijaz": (15.0, 1000.0, 550e-9, 1600e-9),
        "esmail": (50.0, 5000.0, 1530e-9, 1570e-9),
        "koschmieder": (0.0, np.inf, 0.0, np.inf),
    }
)


def out_of_validity(law: str, visibility_m: float, wavelength_m: float) -> tuple[str, ...]:
    """Warnings for a visibility law used outside its range; empty inside. The value is computed all the same."""
    v_low, v_high, w_low, w_high = _VALIDITY[law]
    found = []
    if not v_low <= visibility_m <= v_high:
        found.append(f"law {law}: visibility {visibility_m:g} m outside {v_low:g} to {v_high:g} m")
    if not w_low * (1 - 1e-9) <= wavelength_m <= w_high * (1 + 1e-9):
        found.append(f"law {law}: wavelength {wavelength_m * 1e9:g} nm outside {w_low * 1e9:g} to {w_high * 1e9:g} nm")
    if visibility_m < 1.0:
        found.append(f"visibility {visibility_m:g} m: no law is physical below about 1 m")
    return tuple(found)


def deep_path_warning(depth: float) -> tuple[str, ...]:
    """Warning for results at an optical depth where multiple scattering is no longer small."""
    if depth <= 5.0:
        return ()
    return ("echoes from beyond an optical depth of 5: single-scattering estimates",)


def fog_lidar_ratio(visibility_m: float) -> float:
    """Lidar ratio of fog, or of haze from 5 km of visibility on. [sr]"""
    return LIDAR_RATIO_SR["haze" if visibility_m > HAZE_FROM_M else "fog"]


def rain_lidar_ratio(kappa_sr: Values) -> Floats:
    """Lidar ratio of rain whose drops send back kappa D^2: pi/(2 kappa), 269 sr by default. [sr]"""
    return np.pi / (2.0 * floats(kappa_sr))
