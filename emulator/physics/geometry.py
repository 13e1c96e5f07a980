"""Directions: angles that keep their digits, mirror directions, what a flat mirror seen face-on sends back.

Here: vector algebra on arrays (..., 3) of unit vectors, float64. Not here: ray casting.
"""

from __future__ import annotations

import numpy as np

from emulator.physics.arrays import Floats, Values, floats
from emulator.physics.radiometry import fill_disc_offset


def angle_between(a: Floats, b: Floats) -> Floats:
    """Angle between vectors along the last axis by atan2 of cross and dot product; 1e-9 rad is resolved. [rad]"""
    cross = np.cross(a, b)
    return floats(np.arctan2(np.sqrt(np.sum(cross * cross, axis=-1)), np.sum(floats(a) * b, axis=-1)))


def incidence_cosine(direction: Floats, normal: Floats) -> Floats:
    """Cosine of incidence of rays on surfaces, 0..1, either side; clamped against rounding."""
    return floats(np.clip(np.abs(np.sum(floats(direction) * normal, axis=-1)), 0.0, 1.0))


def mirrored(direction: Floats, normal: Floats) -> Floats:
    """Direction of the ray behind a mirror: d - 2 (d . n) n."""
    along = np.sum(floats(direction) * normal, axis=-1, keepdims=True)
    turned = direction - 2.0 * along * normal
    return floats(turned / np.sqrt(np.sum(turned * turned, axis=-1, keepdims=True)))


def mirror_direct_share(
    aperture_radius_m: Values, half_angle_rad: Values, range_m: Values, tilt_rad: Values, exit_radius_m: Values = 0.0
) -> Floats:
    """Share of a Gaussian beam that a flat mirror at this range and tilt throws straight back into the aperture.

    The beam has radius w(2R) when it is back, its centre 2 R tan(tilt) off the axis; multiply by the mirror's own
    share, without the range equation.
    """
    r = floats(range_m)
    width = 2.0 * r * np.tan(half_angle_rad) + exit_radius_m
    return fill_disc_offset(aperture_radius_m, width, 2.0 * r * np.tan(np.minimum(np.abs(floats(tilt_rad)), 1.5)))
