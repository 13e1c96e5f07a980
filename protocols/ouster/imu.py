"""The inertial unit in an Ouster: from true motion to what it measures, with noise, bias and steps of its converter.

Belongs here: errors of the unit. Not: packets (codec), when they are sent (device).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from protocols.ouster.models import IMU_MM, LIDAR_Z_MM
from protocols.scan import Floats

G = 9.80665
FULL_SCALE = {"NORMAL": (2.0, 250.0), "EXTENDED": (16.0, 2000.0)}
"Accelerometer [g] and gyro [deg/s] by `accel_fsr` and `gyro_fsr`."
STEPS = 32_768
GYRO_STEP_EXTENDED = 1.0 / 16.4
ARM_M = [1e-3 * IMU_MM[0], 1e-3 * IMU_MM[1], 1e-3 * (IMU_MM[2] - LIDAR_Z_MM)]
"From the mount, which is the lidar's origin, to the unit."
CHANGE_NS = 5_000_000
"Over which a change of the rate is felt; as long as motion is felt over."
Felt = Callable[[int], tuple[Floats, Floats]]
"Specific force and rate (3,) in the sensor's frame at an instant. [m/s^2, rad/s]"


def at_rest(at_ns: int) -> tuple[Floats, Floats]:
    """A level sensor that does not move."""
    return np.array([0.0, 0.0, G]), np.zeros(3)


@dataclass(frozen=True, eq=False)
class Errors:
    """Of one unit. [g, deg/s]"""

    serial: int
    density: Floats
    "(6,) noise per root hertz."
    bias: Floats
    "(6,)"
    scale: Floats
    "(6,) near 1."

    @classmethod
    def of(
        cls, serial: int, accel_mg: float, gyro: float, accel_bias_mg: float, gyro_bias: float, scale: float
    ) -> Errors:
        """Those of a serial number."""
        draws = np.random.default_rng((serial, 1)).standard_normal((2, 6))
        bias = np.repeat((1e-3 * accel_bias_mg, gyro_bias), 3) * draws[0]
        return cls(serial, np.repeat((1e-3 * accel_mg, gyro), 3), bias, 1.0 + scale * draws[1])


def measured(felt: Felt, at_ns: int, errors: Errors, number: int, rate_hz: float, ranges: tuple[str, str]) -> Floats:
    """(6,) acceleration in g and rate in deg/s, of measurement `number`; `ranges`: accelerometer, gyro."""
    force, rate = felt(at_ns)
    before_ns = max(0, at_ns - CHANGE_NS)
    speeding = (rate - felt(before_ns)[1]) * (1e9 / max(1, at_ns - before_ns))
    turning = rate.tolist()
    force = force + np.array(_cross(turning, _cross(turning, ARM_M))) + np.array(_cross(speeding.tolist(), ARM_M))
    noise = np.random.default_rng((errors.serial, 2, number)).standard_normal(6)
    true = np.concatenate((force / G, np.degrees(rate)))
    seen = errors.scale * true + errors.bias + errors.density * np.sqrt(0.5 * rate_hz) * noise
    full = np.repeat((FULL_SCALE[ranges[0]][0], FULL_SCALE[ranges[1]][1]), 3)
    step = full / STEPS
    if ranges[1] == "EXTENDED":
        step[3:] = GYRO_STEP_EXTENDED
    return np.asarray(np.clip(np.rint(seen / step), -STEPS, STEPS - 1) * step)


def _cross(a: Sequence[float], b: Sequence[float]) -> list[float]:
    """As `numpy.cross`, which takes ten times as long for one vector."""
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
