"""What surfaces send back the way the light came: pi f cos, the Lambert-equivalent reflectance at an incidence.

Here: reflection models as functions of incidence and parameters, in radians and float64. Not here: which material has
which (materials), and where mirrored or transmitted rays go (optics).
Functions named `..._cos` take the cosine of the incidence, which is what a ray caster has; they stay finite up to and
at grazing incidence, where they take the limit.
"""

from __future__ import annotations

import numpy as np

from emulator.physics.arrays import Floats, Values, exp_or_zero, floats

COAT_OUTSIDE = 0.04
"Saunderson's k1: what the clear coat reflects outwards, refractive index 1.5."
COAT_INSIDE = 0.6
"Saunderson's k2: what the clear coat reflects back to the pigment, diffuse light."
MIN_ROUGHNESS = 0.02
"A smoother lobe is a mirror and wants the mirror treatment."


def lambert_back(rho: Values, incidence_rad: Values) -> Floats:
    """Ideal diffuse surface: rho cos."""
    return floats(rho) * np.cos(incidence_rad)


def oren_nayar_back(rho: Values, sigma_rad: Values, incidence_rad: Values) -> Floats:
    """Rough diffuse surface with slopes of standard deviation sigma; flatter than Lambert towards grazing."""
    return oren_nayar_cos(rho, sigma_rad, np.cos(incidence_rad))


def oren_nayar_cos(rho: Values, sigma_rad: Values, cosine: Values) -> Floats:
    """The same from the cosine: rho (A cos + B sin^2), which has no pole at grazing incidence."""
    c = _clean(cosine)
    a, b = oren_nayar_factors(sigma_rad)
    return rho * (a * c + b * (1.0 - c * c))


def oren_nayar_factors(sigma_rad: Values) -> tuple[Floats, Floats]:
    """A and B of these slopes: 1 and 0 of a smooth one."""
    s2 = floats(sigma_rad) ** 2
    return 1.0 - s2 / (2.0 * (s2 + 0.33)), 0.45 * s2 / (s2 + 0.09)


def phong_back(rho_d: Values, rho_s: Values, exponent: Values, incidence_rad: Values) -> Floats:
    """Energy-normalised Phong: diffuse part and a lobe about the mirror direction, 0 beyond 45 degrees."""
    return phong_cos(rho_d, rho_s, exponent, np.cos(incidence_rad))


def phong_cos(rho_d: Values, rho_s: Values, exponent: Values, cosine: Values) -> Floats:
    """The same from the cosine."""
    c, n = _clean(cosine), floats(exponent)
    mirror = 2.0 * c * c - 1.0
    # the logarithm keeps high powers of small cosines from underflowing
    lobe = np.where(mirror > 0.0, exp_or_zero(n * np.log(np.maximum(mirror, 1e-300))), 0.0)
    return (rho_d + floats(rho_s) * (n + 2.0) / 2.0 * lobe) * c


def ggx_back(f0: Values, alpha_g: Values, incidence_rad: Values) -> Floats:
    """GGX microfacets with the height-correlated Smith term; F0 is the mirror reflectance at normal incidence."""
    c, s = np.cos(incidence_rad), np.sin(incidence_rad)
    return _ggx(f0, alpha_g, c * c, s * s)


def ggx_cos(f0: Values, alpha_g: Values, cosine: Values) -> Floats:
    """The same from the cosine."""
    c2 = _clean(cosine) ** 2
    return _ggx(f0, alpha_g, c2, np.maximum(1.0 - c2, 0.0))


def _ggx(f0: Values, alpha_g: Values, c2: Floats, s2: Floats) -> Floats:
    a2 = floats(alpha_g) ** 2
    spread = s2 + a2 * c2  # = c^2 (a^2 - 1) + 1 without the cancellation
    return f0 * a2 / (4.0 * spread * spread * np.sqrt(c2 + a2 * s2))


def _clean(cosine: Values) -> Floats:
    """The cosine, 0 where its square would underflow: that is grazing incidence."""
    c = floats(cosine)
    return np.where(np.abs(c) < 1e-75, 0.0, c)


# ------------------------------------------------------------------------------- paint, water, sheeting
def kubelka_munk(k_over_s: Values) -> Floats:
    """Diffuse reflectance of a thick pigment layer from absorption over scattering K/S >= 0."""
    x = floats(k_over_s)
    return floats(1.0 / (1.0 + x + np.sqrt(x) * np.sqrt(x + 2.0)))


def saunderson(rho_layer: Values, k1: Values = COAT_OUTSIDE, k2: Values = COAT_INSIDE) -> Floats:
    """Reflectance of a pigment layer under a clear coat, the coat's own reflection k1 included."""
    return k1 + saunderson_diffuse(rho_layer, k1, k2)


def saunderson_diffuse(rho_layer: Values, k1: Values = COAT_OUTSIDE, k2: Values = COAT_INSIDE) -> Floats:
    """The diffuse part alone, without the coat's own reflection, which glossy paint sends into its lobe."""
    rho = floats(rho_layer)
    return (1.0 - floats(k1)) * (1.0 - floats(k2)) * rho / (1.0 - k2 * rho)


def wet_reflectance(rho: Values, index: Values) -> Floats:
    """Reflectance of a wet rough surface from its dry one (Angstrom): rho/(n^2 (1 - rho) + rho)."""
    r = floats(rho)
    return r / (floats(index) ** 2 * (1.0 - r) + r)


def retro_equivalent(ra_cd_lx_m2: Values) -> Floats:
    """Equivalent Lambert reflectance of retroreflective sheeting of coefficient R_A: pi R_A."""
    return np.pi * floats(ra_cd_lx_m2)


# ------------------------------------------------------------------------------- clear panes
def fresnel(index: Values, incidence_rad: Values) -> tuple[Floats, Floats]:
    """Fresnel reflectance (s, p) of one surface of relative index n >= 1."""
    return fresnel_cos(index, np.cos(incidence_rad))


def fresnel_cos(index: Values, cosine: Values) -> tuple[Floats, Floats]:
    """The same from the cosine; 1 at grazing incidence."""
    n, c = floats(index), _clean(cosine)
    inside = np.sqrt(1.0 - (1.0 - c * c) / (n * n))
    # an index of 1 has no surface; at grazing incidence the quotient would be 0/0
    s_sum, p_sum = c + n * inside, n * c + inside
    rs = np.where(s_sum > 0.0, (c - n * inside) / np.where(s_sum > 0.0, s_sum, 1.0), 1.0) ** 2
    rp = np.where(p_sum > 0.0, (n * c - inside) / np.where(p_sum > 0.0, p_sum, 1.0), 1.0) ** 2
    return rs, rp


def fresnel_unpolarised(index: Values, incidence_rad: Values) -> Floats:
    """Fresnel reflectance of one surface, unpolarised."""
    rs, rp = fresnel(index, incidence_rad)
    return 0.5 * (rs + rp)


def pane_transmission(index: Values, incidence_rad: Values) -> Floats:
    """One-way transmission of a clear pane, its two surfaces added incoherently, unpolarised."""
    return pane_transmission_cos(index, np.cos(incidence_rad))


def pane_transmission_cos(index: Values, cosine: Values) -> Floats:
    """The same from the cosine."""
    rs, rp = fresnel_cos(index, cosine)
    return 0.5 * ((1.0 - rs) / (1.0 + rs) + (1.0 - rp) / (1.0 + rp))


def slanted(index: Values, cosine: Values, internal: Values) -> Floats:
    """What one pass through a pane leaves whose way in the glass is longer by the slant (Bouguer and Snell)."""
    t, n, c = floats(internal), floats(index), _clean(cosine)
    inside = np.sqrt(np.maximum(1.0 - (1.0 - c * c) / (n * n), 1e-18))
    return np.where(t < 1.0, t ** (1.0 / inside), 1.0)


def refracted(direction: Floats, normal: Floats, cosine: Floats, ratio: Floats) -> Floats:
    """Directions (m, 3) behind a surface; NaN where all is reflected.

    Parameters
    ----------
    direction : (m, 3) unit, towards the surface
    normal : (m, 3) unit, on the side they come from
    cosine : (m,) of incidence
    ratio : (m,) index before the surface over that behind it
    """
    square = 1.0 - ratio**2 * (1.0 - cosine * cosine)
    inside = np.sqrt(np.where(square >= 0.0, square, np.nan))
    out = ratio[:, None] * direction + (ratio * cosine - inside)[:, None] * normal
    return floats(out / np.linalg.norm(out, axis=1, keepdims=True))


def pane_shares_cos(index: Values, cosine: Values, internal: Values) -> tuple[Floats, Floats]:
    """Shares that an absorbing (laminated, tinted) pane mirrors and lets through, one way, unpolarised.

    Both surfaces and all bounces between them; `internal` is what one pass straight through it leaves.
    """
    t = slanted(index, cosine, internal)
    mirrored, through = np.zeros(()), np.zeros(())
    for r in fresnel_cos(index, cosine):
        back, passed = r * t, (1.0 - r) ** 2 * t
        passed = passed / np.maximum(1.0 - back * back, 1e-300)
        mirrored, through = mirrored + r + back * passed, through + passed
    return floats(0.5 * mirrored), floats(0.5 * through)


def pane_reflection_cos(index: Values, cosine: Values, internal: Values = 1.0) -> Floats:
    """The first of `pane_shares_cos`."""
    return pane_shares_cos(index, cosine, internal)[0]


def pane_internal_transmission_cos(index: Values, cosine: Values, internal: Values) -> Floats:
    """The second of `pane_shares_cos`."""
    return pane_shares_cos(index, cosine, internal)[1]
