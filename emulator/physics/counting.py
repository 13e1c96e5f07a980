"""Numbers of beams and poses: how many beams a flat target takes, and what coarse poses cost.

Here: the closed forms for points on a target and motion during a scan. Not here: the scan itself.
"""

from __future__ import annotations

import numpy as np
from scipy import special

from emulator.physics.arrays import Floats, Values, exp_or_zero, floats


def beams_on_target(width_m: Values, edge_m: Values, range_m: Values, step_rad: Values) -> Floats:
    """Mean number of beams on a flat target facing the sensor: 2 atan((W/2 + e)/R)/step; 0 where e <= -W/2."""
    half = np.maximum(0.5 * floats(width_m) + edge_m, 0.0)
    return 2.0 * np.arctan2(half, range_m) / step_rad


def edge_extension(w_m: Values, needed_share: Values) -> Floats:
    """How far outside an edge a Gaussian beam still sends the needed share of its power: w erfcinv(2 f)/sqrt 2. [m]

    Negative for f > 1/2; -inf for f >= 1: then no beam suffices.
    """
    f = np.minimum(floats(needed_share), 1.0)
    return -0.5 * floats(w_m) * floats(special.ndtri(f)) + 0.0


def needed_share(range_m: Values, full_range_m: Values, alpha: Values) -> Floats:
    """Share of the beam that must hit for the threshold, 1 at the range of full coverage: (R/Rf)^2 e^{2 a (R - Rf)}."""
    r, full = floats(range_m), floats(full_range_m)
    return (r / full) ** 2 * exp_or_zero(np.minimum(2.0 * floats(alpha) * (r - full), 50.0))


def pose_step_error(speed_m_s: Values, scan_s: Values, steps: Values) -> Floats:
    """Largest range error of N pose steps a scan at a closing speed: v T/(2 N). [m]"""
    return floats(speed_m_s) * scan_s / (2.0 * floats(steps))
