"""Light of a clear sky at the ground, sun at any height: air mass, haze, the disc on the horizon, aureole, twilight.

Here: irradiances and radiances in the sensor's band. Not here: what a receiver makes of them (background). Elevations
are apparent ones, in degrees; the horizon is flat.
"""

from __future__ import annotations

import math

import numpy as np

from emulator.physics import background
from emulator.physics.arrays import Floats, Values, clamped, floats
from emulator.physics.constants import SKY_RADIANCE_W_M2_SR_NM, SUN_HALF_ANGLE_RAD, SUN_TABLE_TOTAL_W_M2

TABLE_AIR_MASS = 1.5
"Of the sunlight at the ground in ASTM G173-03."
TABLE_BETA = 0.084 * 0.5**1.3
"Haze in that table: aerosol optical depth 0.084 at 500 nm."
ANGSTROM_EXPONENT = 1.3
CLEAR_BETA = 0.035
"Default haze, that of the table to two digits."
SKY_ELEVATION_DEG = 30.0
"Of the sun for which the radiance of the clear sky is given."
NIGHT_DEG = -18.0
"End of astronomical twilight."
AUREOLE_RAD = 43.6e-3
"Where the aureole ends, Buie et al. 2003."
FORWARD_SHARE = 0.2
"""Share of the light scattered by haze that stays within `AUREOLE_RAD` of the sun. Choice of this project: with it the
aureole of ordinary haze (beta 0.1, air mass 2) holds 5 % of the light, the usual mean of measured sunshapes."""
LINKE_AIR_MASS, LINKE_WATER_CM = 2.0, 1.4
"Where Linke's turbidity is given; water vapour of the U.S. Standard Atmosphere, that of G173-03 too."

_TWILIGHT = (
    (-18.0, (13.84, 262.72, 1447.42, 2797.93)),
    (-12.0, (2.70, 12.17, -431.69, -1899.83)),
    (-5.0, (2.88, 21.81, -258.11, -858.36)),
    (-0.8, (2.88, 22.26, -207.64, 1034.30)),
    (5.0, (3.05, 13.28, -45.98, 64.33)),
    (20.0, (3.74, 3.97, -4.07, 1.47)),
)
"From which elevation on, and the polynomial of log10(lux) in elevation/90 deg."


def air_mass(elevation_deg: Values) -> Floats:
    """Relative optical air mass; below the horizon that of the horizon, 38.

    References
    ----------
    .. [1] Kasten and Young 1989, Revised optical air mass tables and approximation formula, Applied Optics 28(22).
    """
    h = np.maximum(floats(elevation_deg), 0.0)
    return 1.0 / (np.sin(np.radians(h)) + 0.50572 * (h + 6.07995) ** -1.6364)


def rayleigh_depth(wavelength_m: float) -> float:
    """Optical depth of clean air at the zenith: 0.008735 lambda^-4.08, lambda in um (Leckner 1978)."""
    return float(0.008735 * (1e6 * wavelength_m) ** -4.08)


def aerosol_depth(wavelength_m: float, beta: float) -> float:
    """Optical depth of haze at the zenith, beta lambda^-1.3, lambda in um (Angstrom 1929)."""
    return float(beta * (1e6 * wavelength_m) ** -ANGSTROM_EXPONENT)


def beta_of_linke(turbidity: float) -> float:
    """Angstrom's beta of a Linke turbidity at air mass 2 with 1.4 cm of water vapour; `ValueError` below clean air.

    References
    ----------
    .. [1] Ineichen 2008, Conversion function between the Linke turbidity and the atmospheric water vapor and aerosol
       content, Solar Energy 82: Kasten's pyrheliometric formula with the optical depths of Molineaux et al. 1998.
    .. [2] Bird and Hulstrom 1980: broadband depth of aerosol 0.27583 tau(380 nm) + 0.35 tau(500 nm).
    """
    broadband = turbidity / (9.4 + 0.9 * LINKE_AIR_MASS) - _clean_depth()
    if broadband < -1e-12:
        raise ValueError(f"{turbidity}; want at least {clean_turbidity():.2f}, that of air without haze")
    return max(broadband, 0.0) / _broadband_per_beta()


def linke_of_beta(beta: float) -> float:
    """The other way round."""
    return (9.4 + 0.9 * LINKE_AIR_MASS) * (_clean_depth() + beta * _broadband_per_beta())


def clean_turbidity() -> float:
    """Linke turbidity of air without haze: more than 1 for its water vapour."""
    return linke_of_beta(0.0)


def _clean_depth() -> float:
    dry = -0.101 + 0.235 * LINKE_AIR_MASS**-0.16
    return float(dry + 0.112 * LINKE_AIR_MASS**-0.55 * LINKE_WATER_CM**0.34)


def _broadband_per_beta() -> float:
    return float(0.27583 * 0.38**-ANGSTROM_EXPONENT + 0.35 * 0.5**-ANGSTROM_EXPONENT)


def direct_normal(elevation_deg: Values, beta: float, wavelength_m: float, total_w_m2: float) -> Floats:
    """Direct sunlight on a plane that faces the whole disc. [W/m^2 per m of wavelength]

    Notes
    -----
    The table's value at air mass 1.5 with its water vapour and its haze, taken along another path:
    ``table exp(-(m - 1.5) tau_R - m tau_a + 1.5 tau_table)``. Water lines grow with m and are not followed: an upper
    bound at low sun. At the default haze and m = 1.5 the table's own value.

    References
    ----------
    .. [1] Bird and Riordan 1986, Simple solar spectral model, J. Climate Appl. Meteor. 25: the factors.
    .. [2] ASTM G173-03: the anchor, 40 nm mean.
    """
    m = air_mass(elevation_deg)
    anchor = background.solar_ground(wavelength_m, total_w_m2, direct=True)
    depth = (m - TABLE_AIR_MASS) * rayleigh_depth(wavelength_m) + m * aerosol_depth(wavelength_m, beta)
    return anchor * np.exp(TABLE_AIR_MASS * aerosol_depth(wavelength_m, TABLE_BETA) - depth)


def disc_share(elevation_deg: Values, half_rad: float = SUN_HALF_ANGLE_RAD) -> Floats:
    """Share of the sun's disc above the flat horizon, its centre at an elevation: 0.5 at 0."""
    u = clamped(np.radians(floats(elevation_deg)) / half_rad, -1.0, 1.0)
    return 1.0 - (np.arccos(u) - u * np.sqrt(1.0 - u * u)) / np.pi


def twilight(elevation_deg: float) -> float:
    """Illuminance of the ground over that at elevation 0, for a sun at or below it; 0 from -18 degrees on.

    References
    ----------
    .. [1] Janiczek and DeYoung 1987, U.S. Naval Observatory Circular 171; Seidelmann 1992, Explanatory Supplement to
       the Astronomical Almanac, sec. 8.3: 759 lx at 0, 3.4 lx at -6, 0.008 lx at -12, 0.00065 lx at -18 degrees.
    """
    if elevation_deg <= NIGHT_DEG:
        return 0.0
    return min(illuminance_lx(elevation_deg) / illuminance_lx(0.0), 1.0)


def illuminance_lx(elevation_deg: float) -> float:
    """Illuminance of level ground under a clear sky, sun from -18 to 90 degrees, see `twilight`. [lx]"""
    a, b, c, d = next(row for from_deg, row in reversed(_TWILIGHT) if elevation_deg >= from_deg)
    x = elevation_deg / 90.0
    return float(10.0 ** (a + x * (b + x * (c + x * d))))


def sky_radiance(elevation_deg: float, beta: float, wavelength_m: float, total_w_m2: float) -> float:
    """Radiance of the clear sky away from the sun. [W/m^2/sr per m of wavelength]

    That for a sun at 30 degrees, times the direct light over that at 30 degrees; below the horizon it falls as the
    illuminance of twilight does.
    """
    at_30 = 1e9 * SKY_RADIANCE_W_M2_SR_NM * total_w_m2 / SUN_TABLE_TOTAL_W_M2
    now, then = direct_normal(np.array([elevation_deg, SKY_ELEVATION_DEG]), beta, wavelength_m, total_w_m2)
    if then == 0.0:
        return 0.0
    return float(at_30 * now / then) * (twilight(elevation_deg) if elevation_deg < 0.0 else 1.0)


def lit_radiance(direct: Values, sky: Values, rho: Values, sun_cosine: Values, up: Values) -> Floats:
    """Radiance of a Lambert surface under the sun and an even sky.

    Parameters
    ----------
    direct : irradiance of the sun on a plane that faces it
    sky : radiance of the sky
    rho : reflectance
    sun_cosine : cosine of the sun's incidence; below 0 the surface is in its own shade
    up : upward part of the surface's normal: a surface sees (1 + up)/2 of the sky
    """
    return rho * (direct * np.maximum(sun_cosine, 0.0) / np.pi + sky * 0.5 * (1.0 + floats(up)))


# ------------------------------------------------------------------------------- aureole
def circumsolar_ratio(elevation_deg: float, beta: float, wavelength_m: float) -> float:
    """Light of the aureole over that of disc and aureole, from single scattering: f m tau_a/(1 + f m tau_a)."""
    scattered = FORWARD_SHARE * float(air_mass(elevation_deg)) * aerosol_depth(wavelength_m, beta)
    return float(scattered / (1.0 + scattered))


def aureole_exponent(ratio: float) -> float:
    """Power of the angle with which the aureole falls, from its circumsolar ratio.

    References
    ----------
    .. [1] Buie, Monger and Dey 2003, Sunshape distributions for terrestrial solar simulations, Solar Energy 74:
       2.2 ln(0.52 chi) chi^0.43 - 0.1.
    """
    return float(2.2 * math.log(0.52 * ratio) * ratio**0.43 - 0.1)


def aureole_radiance(angle_rad: Values, ratio: float, direct: Values) -> Floats:
    """Radiance of the aureole at an angle from the sun's centre; 0 on the disc and beyond 43.6 mrad. [direct per sr]

    The power law of Buie et al. 2003, scaled so that it holds `ratio`/(1 - ratio) times the light of the disc: their
    own scale is that of another sunshape in the disc and departs from its ratio by up to a half.
    """
    theta, g = floats(angle_rad), aureole_exponent(ratio)
    start, end = SUN_HALF_ANGLE_RAD, AUREOLE_RAD
    power = g + 2.0
    norm = math.log(end / start) if abs(power) < 1e-9 else ((end / start) ** power - 1.0) / power
    total = floats(direct) * ratio / (1.0 - ratio)
    inside = (theta > start) & (theta <= end)
    scaled = (np.where(inside, theta, start) / start) ** g
    return np.where(inside, total * scaled / (2.0 * np.pi * start**2 * norm), 0.0)


_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(48)


def aureole_seen(fov_half_rad: float, separation_rad: Values, ratio: float) -> Floats:
    """Irradiance from the aureole inside a circular field of view, over that of the disc; centres (n,) apart.

    Rings around the sun: each has the arc of it that lies in the field. Angles are flat, below 0.1 rad.
    """
    d, f = floats(separation_rad)[..., None], fov_half_rad
    low = np.maximum(np.maximum(d - f, f - d), SUN_HALF_ANGLE_RAD)  # between |d - f| and d + f rings are cut
    high = np.minimum(d + f, AUREOLE_RAD)
    # whole rings, where the field holds the sun's centre
    whole = np.minimum(np.where(f > d, f - d, 0.0), AUREOLE_RAD)
    found = _rings_to(whole[..., 0], ratio)
    cut = (high > low)[..., 0]
    if not bool(cut.any()):
        return found
    low, high, d = low[cut], high[cut], d[cut]
    # sin^2 places nodes where the arc's ends have their square root
    t = 0.25 * np.pi * (_NODES + 1.0)
    theta = low + (high - low) * np.sin(t) ** 2
    slope = (high - low) * np.sin(2.0 * t) * 0.25 * np.pi
    arc = 2.0 * np.arccos(clamped((theta**2 + d**2 - f**2) / (2.0 * theta * np.maximum(d, 1e-12)), -1.0, 1.0))
    inner = aureole_radiance(np.maximum(theta, SUN_HALF_ANGLE_RAD * (1.0 + 1e-12)), ratio, 1.0)
    found[cut] += np.sum(_WEIGHTS * slope * arc * theta * inner, axis=-1)
    return found


def _rings_to(radius_rad: Floats, ratio: float) -> Floats:
    """Light of the aureole within an angle of the sun, over that of the disc."""
    power = aureole_exponent(ratio) + 2.0
    start, end = SUN_HALF_ANGLE_RAD, AUREOLE_RAD
    reach = np.clip(radius_rad, start, end) / start
    if abs(power) < 1e-9:
        share = np.log(reach) / math.log(end / start)
    else:
        share = (reach**power - 1.0) / ((end / start) ** power - 1.0)
    return floats(share * ratio / (1.0 - ratio))


def above_horizon(half_rad: float, elevation_rad: Values) -> Floats:
    """Share of a circular field of view above the flat horizon."""
    return disc_share(np.degrees(floats(elevation_rad)), max(half_rad, 1e-12))


def disc_seen(
    fov_half_rad: float, axis_elevation_rad: Values, sun_elevation_rad: float, separation_rad: Values
) -> Floats:
    """Share of the sun's whole disc inside circular fields of view and above the flat horizon; centres (n,) apart.

    Level strips: in each both circles are intervals; the horizon ends the strips.
    """
    e, s, f = floats(axis_elevation_rad)[..., None], SUN_HALF_ANGLE_RAD, fov_half_rad
    apart = floats(separation_rad)[..., None]
    side = np.sqrt(np.maximum(apart**2 - (e - sun_elevation_rad) ** 2, 0.0))  # sideways distance of the centres
    low = np.maximum(np.maximum(e - f, sun_elevation_rad - s), 0.0)
    high = np.minimum(e + f, sun_elevation_rad + s)
    t = 0.25 * np.pi * (_NODES + 1.0)
    wide = np.maximum(high - low, 0.0)
    y = low + wide * np.sin(t) ** 2
    half_f = np.sqrt(np.maximum(f**2 - (y - e) ** 2, 0.0))
    half_s = np.sqrt(np.maximum(s**2 - (y - sun_elevation_rad) ** 2, 0.0))
    across = np.maximum(np.minimum(half_f, side + half_s) - np.maximum(-half_f, side - half_s), 0.0)
    slope = wide * np.sin(2.0 * t) * 0.25 * np.pi
    return np.asarray(np.sum(_WEIGHTS * slope * across, axis=-1) / (np.pi * s**2))
