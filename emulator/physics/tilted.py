"""One plane over the whole footprint: echo energy, mean range and spread without any bundle.

Here: the exact integrals over a Gaussian beam and their second-order expansion. Not here: how the spread changes the
pulse (pulse) and how a scene is found to be one plane (error_budget).
"""

from __future__ import annotations

import numpy as np
from scipy import special

from emulator.physics.arrays import Floats, Values, floats

_ORDER = 24


def tilted_plane_moments(half_angle_rad: Values, tilt_rad: Values) -> tuple[Floats, Floats, Floats]:
    """Energy over the point formula, mean range over R, standard deviation of range over R.

    Beam of half angle theta about an axis that meets the plane at distance R under `tilt_rad`; |tilt| below
    pi/2 - 4 theta. Gauss-Hermite squared; ranges accumulated as r - R, so that the spread does not cancel.
    """
    half, tilt = np.broadcast_arrays(floats(half_angle_rad), floats(tilt_rad))
    x, weight = special.roots_hermite(_ORDER)
    scale = (np.tan(half) / np.sqrt(2.0))[..., None, None]
    u, v = scale * x[:, None], scale * x[None, :]
    slope = np.tan(tilt)[..., None, None] * u
    off2 = u * u + v * v
    w = np.outer(weight, weight) / np.pi * (1.0 - slope) ** 3 / (1.0 + off2) ** 1.5
    delta = (np.expm1(0.5 * np.log1p(off2)) + slope) / (1.0 - slope)
    m0 = np.sum(w, axis=(-2, -1))
    d1 = np.sum(w * delta, axis=(-2, -1)) / m0
    d2 = np.sum(w * (delta - d1[..., None, None]) ** 2, axis=(-2, -1)) / m0
    return m0, 1.0 + d1, np.sqrt(np.maximum(d2, 0.0))


def tilted_plane_energy(half_angle_rad: Values, tilt_rad: Values) -> Floats:
    """Received energy of a tilted plane over the point formula rho cos A/(pi R^2)."""
    return tilted_plane_moments(half_angle_rad, tilt_rad)[0]


def tilted_plane_mean_range(half_angle_rad: Values, tilt_rad: Values) -> Floats:
    """Energy-weighted mean range over R."""
    return tilted_plane_moments(half_angle_rad, tilt_rad)[1]


def tilted_plane_range_std(half_angle_rad: Values, tilt_rad: Values) -> Floats:
    """Energy-weighted standard deviation of range over R."""
    return tilted_plane_moments(half_angle_rad, tilt_rad)[2]


def tilted_plane_expansion(half_angle_rad: Values, tan_tilt: Values) -> tuple[Floats, Floats, Floats]:
    """The same three numbers to second order in the half angle; cheap enough for every beam of a scan.

    ``m0 = 1 + 3 s^2 (T^2 - 1)``, mean ``(1 + s^2 (T^2 - 2))/m0``, spread ``s T``, with s = tan(theta)/2, T = tan(tilt).
    Errors: 2e-11 in energy and mean for theta = 0.61 mrad up to 85 degrees, 3e-7 for 6.5 mrad; spread 5e-5 and 5e-3
    relative.
    """
    s2 = (0.5 * np.tan(half_angle_rad)) ** 2
    t2 = floats(tan_tilt) ** 2
    m0 = 1.0 + 3.0 * s2 * (t2 - 1.0)
    return m0, (1.0 + s2 * (t2 - 2.0)) / m0, np.sqrt(s2 * t2)
