"""Kalman filter of a constant velocity in the plane, for many tracks at once.

Belongs here: prediction, update, distances. Not: which measurement belongs to which track.

State (n, 4): x, y, vx, vy. Measurement: x, y. Process noise: white acceleration of standard deviation `a` in each axis,
constant over a step: Q = a^2 G G^T with G = (dt^2 / 2, dt) for each axis.

References
----------
.. [1] Y. Bar-Shalom, X. R. Li, T. Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, ch. 6.3.2
   (discrete white noise acceleration model), ch. 5.2 (the filter).
"""

from __future__ import annotations

import numpy as np

from emulator.objects.points import Floats


def predict(state: Floats, covariance: Floats, dt_s: float, acceleration_m_s2: float) -> tuple[Floats, Floats]:
    """State and covariance `dt_s` later, (n, 4) and (n, 4, 4)."""
    move = np.eye(4)
    move[0, 2] = move[1, 3] = dt_s
    half = 0.5 * dt_s * dt_s
    noise = np.zeros((4, 4))
    for place, speed in ((0, 2), (1, 3)):
        noise[place, place] = half * half
        noise[place, speed] = noise[speed, place] = half * dt_s
        noise[speed, speed] = dt_s * dt_s
    return state @ move.T, move @ covariance @ move.T + acceleration_m_s2**2 * noise


def distances(state: Floats, covariance: Floats, place_m: Floats, variance_m2: Floats, since_s: Floats) -> Floats:
    """(n, m) squared Mahalanobis distances of n tracks from (n, m, 2) places, seen `since_s` (m,) ago."""
    apart = place_m - (state[:, None, :2] - state[:, None, 2:] * since_s[:, None])
    dx, dy = apart[..., 0], apart[..., 1]

    def spread(i: int, j: int) -> Floats:
        c = covariance[:, :, :, None]
        return np.asarray(c[:, i, j] - since_s * (c[:, i, j + 2] + c[:, i + 2, j]) + since_s**2 * c[:, i + 2, j + 2])

    xx, yy, xy = spread(0, 0) + variance_m2, spread(1, 1) + variance_m2, spread(0, 1)
    return np.asarray((yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / (xx * yy - xy * xy))


def update(
    state: Floats, covariance: Floats, place_m: Floats, variance_m2: Floats, since_s: Floats
) -> tuple[Floats, Floats]:
    """Each track with its own measurement: (n, 2) places of variance (n,), seen `since_s` (n,) before the state's time.

    What is measured is x - v since: the model's rows are (1, 0, -since, 0). Covariance in Joseph's form.
    """
    model = np.zeros((len(state), 2, 4))
    model[:, 0, 0] = model[:, 1, 1] = 1.0
    model[:, 0, 2] = model[:, 1, 3] = -since_s
    back = model.transpose(0, 2, 1)
    noise = variance_m2[:, None, None] * np.eye(2)
    gain = covariance @ back @ np.linalg.inv(model @ covariance @ back + noise)
    better = state + (gain @ (place_m - (model @ state[:, :, None])[:, :, 0])[:, :, None])[:, :, 0]
    rest = np.eye(4) - gain @ model
    return better, rest @ covariance @ rest.transpose(0, 2, 1) + gain @ noise @ gain.transpose(0, 2, 1)
