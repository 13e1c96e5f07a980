"""Power that a surface sends back: range equation, shares of a beam on simple targets, largest ranges.

Here: closed forms for one beam and one target. Not here: how a surface reflects (brdf), the air (atmosphere), noise
(noise) and the sum over the sub-beams of a real scene, which the sensing module forms from `received_power`.
No 1/R^3 or 1/R^4 law is programmed: they follow from the shares.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import special

from emulator.physics.arrays import Floats, Values, exp_or_zero, floats

_SQRT2 = float(np.sqrt(2.0))
_NODES_16, _WEIGHTS_16 = np.polynomial.legendre.leggauss(16)
_NODES_64, _WEIGHTS_64 = np.polynomial.legendre.leggauss(64)
_WIDE = 1e8
"A target this many beam radii wide takes the whole beam; also what a beam of no width sees."
_NARROW = 1e-140
"A target this many beam radii wide takes nothing; its square would underflow."
_LOG_LOST_BESIDE_ONE = -40.0
"exp(-40) is lost beside 1 in float64."


def received_power(
    peak_w: Values,
    share: Values,
    equivalent_reflectance: Values,
    range_m: Values,
    optical_depth: Values,
    aperture_radius_m: Values,
    efficiency: Values,
    overlap: Values = 1.0,
) -> Floats:
    """Peak power that one sub-beam brings back to the receiver. [W]

    Parameters
    ----------
    peak_w : peak power of the emitted pulse after all transmit losses. [W]
    share : share of the beam's power in this sub-beam, 0..1
    equivalent_reflectance : pi f cos(incidence), see `brdf`; rho cos(incidence) for a Lambert surface
    range_m : distance along the sub-beam, >= 0. [m]
    optical_depth : one-way integral of the extinction up to there
    aperture_radius_m : radius a of the receive aperture. [m]
    efficiency : product of all receive losses
    overlap : share of the beam inside the field of view, see `overlap`

    Notes
    -----
    ``P0 h G eta ov T^2 A / (R^2 + a^2)`` with ``G = equivalent_reflectance / pi``. R^2 + a^2 is exact for a Lambert
    element on the axis and never returns more than all the light.
    """
    a2 = floats(aperture_radius_m) ** 2
    collected = a2 / (floats(range_m) ** 2 + a2)
    return (
        floats(peak_w)
        * share
        * equivalent_reflectance
        * efficiency
        * overlap
        * collected
        * exp_or_zero(-2.0 * floats(optical_depth))
    )


def echo_extended(
    peak_w: Values,
    rho: Values,
    incidence_rad: Values,
    aperture_radius_m: Values,
    efficiency: Values,
    alpha: Values,
    range_m: Values,
) -> Floats:
    """Peak power from a Lambert target that fills the beam, in air of extinction alpha [1/m]. [W]"""
    r = floats(range_m)
    return received_power(peak_w, 1.0, floats(rho) * np.cos(incidence_rad), r, alpha * r, aperture_radius_m, efficiency)


def echo_retro(
    peak_w: Values, ra_cd_lx_m2: Values, area_m2: Values, efficiency: Values, alpha: Values, range_m: Values
) -> Floats:
    """Peak power from retroreflective sheeting that fills the beam; range > 0. [W]"""
    r = floats(range_m)
    return floats(peak_w) * ra_cd_lx_m2 * area_m2 * efficiency / r**2 * exp_or_zero(-2.0 * floats(alpha) * r)


def overlap(range_m: Values, start_m: float, full_m: float) -> Floats:
    """Share of the beam inside the field of view: 0 below `start_m`, rising linearly to 1 at `full_m`."""
    r = floats(range_m)
    if full_m <= start_m:
        return np.where(r >= start_m, 1.0, 0.0)
    return np.clip((r - start_m) / (full_m - start_m), 0.0, 1.0)


def overlap_start(
    baseline_m: Values, tx_radius_m: Values, rx_radius_m: Values, tx_half_rad: Values, rx_half_rad: Values
) -> Floats:
    """Separate optics: range where the field of view first meets the beam. [m]"""
    return floats((floats(baseline_m) - tx_radius_m - rx_radius_m) / (np.tan(tx_half_rad) + np.tan(rx_half_rad)))


def overlap_full(
    baseline_m: Values, tx_radius_m: Values, rx_radius_m: Values, tx_half_rad: Values, rx_half_rad: Values
) -> Floats:
    """Separate optics: range from which the field of view holds the whole beam. [m]"""
    return floats((floats(baseline_m) + tx_radius_m - rx_radius_m) / (np.tan(rx_half_rad) - np.tan(tx_half_rad)))


# ------------------------------------------------------------------------------- shares of a Gaussian beam
def _radii(a_m: Values, w_m: Values) -> Floats:
    """a/w without a division by zero: a beam of no width sees any target as `_WIDE`."""
    a, w = np.broadcast_arrays(floats(a_m), floats(w_m))
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        ratio = np.where(w > 0.0, a / np.where(w > 0.0, w, 1.0), np.where(a == 0.0, 0.0, np.sign(a) * _WIDE))
    return np.where(np.abs(ratio) < _NARROW, 0.0, np.clip(ratio, -_WIDE, _WIDE))


def fill_edge(x0_m: Values, w_m: Values) -> Floats:
    """Share of a Gaussian beam of 1/e^2 radius w on the half plane x < x0."""
    return floats(special.ndtr(2.0 * _radii(x0_m, w_m)))


def fill_strip(x1_m: Values, x2_m: Values, w_m: Values) -> Floats:
    """Share of a Gaussian beam on the strip x1 < x < x2; a narrow strip keeps all its digits."""
    lo, hi = np.broadcast_arrays(_radii(x1_m, w_m), _radii(x2_m, w_m))
    x = 0.5 * (lo + hi)[..., None] + 0.5 * (hi - lo)[..., None] * _NODES_16
    density = np.sqrt(2.0 / np.pi) * exp_or_zero(-2.0 * x * x)
    thin = 0.5 * (hi - lo) * (density @ _WEIGHTS_16)
    # both ends on one side: differences of the small tails; else of the distribution
    flip = lo > 0.0
    a, b = np.where(flip, -hi, lo), np.where(flip, -lo, hi)
    wide = special.ndtr(2.0 * b) - special.ndtr(2.0 * a)
    return floats(np.where(hi - lo < 0.1, thin, wide))


def fill_disc(a_m: Values, w_m: Values) -> Floats:
    """Share of a Gaussian beam on a centred disc of radius a: 1 - exp(-2 a^2/w^2)."""
    return floats(-np.expm1(-np.minimum(2.0 * _radii(a_m, w_m) ** 2, -_LOG_LOST_BESIDE_ONE)))


def fill_disc_offset(a_m: Values, w_m: Values, d_m: Values) -> Floats:
    """Share of a Gaussian beam on a disc of radius a whose centre is d from the axis.

    Gauss-Legendre over the radius with the scaled Bessel function, cut to where the beam is: |r - d| < 4.5 w.
    """
    a, d = np.broadcast_arrays(_radii(a_m, w_m), np.abs(_radii(d_m, w_m)))
    lo = np.maximum(0.0, np.minimum(d - 4.5, a))
    hi = np.minimum(a, d + 4.5)
    r = 0.5 * (lo + hi)[..., None] + 0.5 * (hi - lo)[..., None] * _NODES_64
    d = d[..., None]
    f = 4.0 * r * exp_or_zero(-2.0 * (r - d) ** 2) * special.i0e(4.0 * r * d)
    return floats(np.clip(0.5 * (hi - lo) * (f @ _WEIGHTS_64), 0.0, 1.0))


def fill_cylinder(a_m: Values, w_m: Values) -> Floats:
    """Share times mean cosine of a Lambert cylinder of radius a across the axis of a Gaussian beam."""
    ratio = _radii(a_m, w_m)
    half_s = ratio * ratio
    return floats(np.sqrt(np.pi / 2.0) * ratio * (special.i0e(half_s) + special.i1e(half_s)))


def fill_sphere(a_m: Values, w_m: Values) -> Floats:
    """Share times mean cosine of a Lambert sphere of radius a on the axis of a Gaussian beam."""
    s = 2.0 * _radii(a_m, w_m) ** 2
    root = np.sqrt(np.maximum(s, 0.02))
    far = 1.0 - special.dawsn(root) / root
    small = np.minimum(s, 0.02)
    term = 2.0 * small / 3.0
    near = np.zeros_like(small)
    with np.errstate(under="ignore"):  # late terms of a speck are nothing beside its first
        for k in range(8):  # sum of (-1)^k (2s)^(k+1) / (2k+3)!!
            near = near + term
            term = -term * 2.0 * small / (2 * k + 5)
    return np.where(s < 0.02, near, far)


def edge_energy_ratio(
    x0_m: Values, w_m: Values, rho1: Values, range1_m: Values, rho2: Values, range2_m: Values
) -> Floats:
    """Energy of the second over the first echo of a Gaussian beam cut by an edge at x0."""
    near, far = fill_edge(x0_m, w_m), fill_edge(-floats(x0_m), w_m)
    return far / near * rho2 / rho1 * (floats(range1_m) / range2_m) ** 2


# ------------------------------------------------------------------------------- shares of a top-hat beam
def tophat_edge(x0_m: Values, w_m: Values) -> Floats:
    """Share of a top-hat beam of radius w on the half plane x < x0."""
    u = np.clip(_radii(x0_m, w_m), -1.0, 1.0)
    return (np.arccos(-u) + u * np.sqrt(1.0 - u * u)) / np.pi


def tophat_sphere(a_m: Values, w_m: Values) -> Floats:
    """Share times mean cosine of a Lambert sphere of radius a on the axis of a top-hat beam of radius w."""
    ratio = np.maximum(_radii(a_m, w_m), 1e-150)
    g = np.minimum(1.0, 1.0 / (ratio * ratio))
    with np.errstate(divide="ignore"):
        lost = np.where(g < 1.0, 1.5 * np.log1p(-g), -np.inf)
    return 2.0 / 3.0 * ratio * ratio * -np.expm1(np.maximum(lost, _LOG_LOST_BESIDE_ONE))


def tophat_cylinder(a_m: Values, w_m: Values) -> Floats:
    """Share times mean cosine of a Lambert cylinder of radius a across the axis of a top-hat beam of radius w.

    ``x = m sin t`` with m the smaller radius takes the square roots out of the ends; Gauss-Legendre in t.
    """
    ratio = _radii(a_m, w_m)
    m = np.minimum(ratio, 1.0)
    t = 0.25 * np.pi * (_NODES_64 + 1.0)
    x = m[..., None] * np.sin(t)
    safe = np.maximum(ratio, 1e-300)[..., None]
    chord = np.sqrt(np.maximum(1.0 - x * x, 0.0))
    cosine = np.sqrt(np.maximum(1.0 - (x / safe) ** 2, 0.0))
    f = chord * cosine * m[..., None] * np.cos(t)
    return floats(4.0 / np.pi * 0.25 * np.pi * (f @ _WEIGHTS_64))


# ------------------------------------------------------------------------------- system constant, largest ranges
def system_constant(peak_w: Values, aperture_radius_m: Values, efficiency: Values, noise_power_w: Values) -> Floats:
    """K = P0 a^2 eta / NEP: SNR of an ideal white plate at 1 m, in m^2; NEP is the rms noise as optical power."""
    return floats(peak_w) * floats(aperture_radius_m) ** 2 * efficiency / noise_power_w


def log_snr(k_m2: Values, rho_eff: Values, alpha: Values, range_m: Values) -> Floats:
    """ln SNR = ln K + ln rho_eff - 2 alpha R - 2 ln R, finite where the SNR itself underflows; range > 0."""
    r = floats(range_m)
    return np.log(k_m2) + np.log(rho_eff) - 2.0 * floats(alpha) * r - 2.0 * np.log(r)


def max_range_extended(k_m2: Values, rho: Values, alpha: Values, snr: Values) -> Floats:
    """Range at which K rho exp(-2 alpha R)/R^2 falls to `snr`: W(alpha R0)/alpha; R0 without extinction. [m]

    Newton in ln R, which is monotone from its start for any alpha R0 up to 1e15; 0 where rho is 0.
    """
    a, r0 = np.broadcast_arrays(floats(alpha), np.sqrt(floats(k_m2) * rho / snr))
    seen = (a > 0.0) & (r0 > 0.0)
    a_safe, r0_safe = np.where(seen, a, 1.0), np.where(seen, r0, 1.0)
    log_r0 = np.log(r0_safe)
    u = np.log(np.log1p(a_safe * r0_safe) / a_safe)
    for _ in range(8):
        depth = a_safe * np.exp(u)
        u = u - (u + depth - log_r0) / (1.0 + depth)
    return np.where(seen, np.exp(u), r0)


def max_range_cylinder(
    k_m2: Values, rho: Values, alpha: Values, snr: Values, half_angle_rad: Values, diameter_m: Values
) -> Floats:
    """The same for a Lambert cylinder across the axis of a Gaussian beam of half angle theta. [m]"""
    return _max_range_of(fill_cylinder, k_m2, rho, alpha, snr, half_angle_rad, diameter_m)


def max_range_sphere(
    k_m2: Values, rho: Values, alpha: Values, snr: Values, half_angle_rad: Values, diameter_m: Values
) -> Floats:
    """The same for a Lambert sphere on the axis of a Gaussian beam of half angle theta. [m]"""
    return _max_range_of(fill_sphere, k_m2, rho, alpha, snr, half_angle_rad, diameter_m)


def _max_range_of(
    fill: Callable[[Values, Values], Floats],
    k_m2: Values,
    rho: Values,
    alpha: Values,
    snr: Values,
    half_angle_rad: Values,
    diameter_m: Values,
) -> Floats:
    full = max_range_extended(k_m2, rho, alpha, snr)
    a, theta, k, al = np.broadcast_arrays(
        0.5 * floats(diameter_m), floats(half_angle_rad), floats(k_m2) * rho / snr, floats(alpha)
    )
    seen = (full > 0.0) & (a > 0.0)
    hi = np.log(np.where(seen, full, 1.0))
    lo = hi - 60.0
    log_k = np.log(np.where(seen, k, 1.0))
    for _ in range(75):  # the whole beam on the target is the upper end; the function falls monotonically
        u = 0.5 * (lo + hi)
        r = np.exp(u)
        share = np.maximum(fill(np.where(seen, a, 1.0), theta * r), 1e-300)
        above = log_k + np.log(share) - 2.0 * al * r - 2.0 * u > 0.0
        lo, hi = np.where(above, u, lo), np.where(above, hi, u)
    return np.where(seen, np.exp(0.5 * (lo + hi)), 0.0)
