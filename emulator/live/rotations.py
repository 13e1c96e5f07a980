"""Rotations as unit quaternions (w, x, y, z), vectorised: products, turning by a rate, the shortest way between two.

Not: rotation matrices (world/motion).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

SMALL = 1e-8
"Angle below which a sine is its angle. [rad]"


def from_angles(yaw_rad: float, pitch_rad: float = 0.0, roll_rad: float = 0.0) -> Quaternion:
    """Of yaw, then pitch, then roll, each about its own turned axis (ISO 8855). [rad]"""
    cy, sy = math.cos(yaw_rad / 2.0), math.sin(yaw_rad / 2.0)
    cp, sp = math.cos(pitch_rad / 2.0), math.sin(pitch_rad / 2.0)
    cr, sr = math.cos(roll_rad / 2.0), math.sin(roll_rad / 2.0)
    return (
        cy * cp * cr + sy * sp * sr,
        cy * cp * sr - sy * sp * cr,
        cy * sp * cr + sy * cp * sr,
        sy * cp * cr - cy * sp * sr,
    )


def product(one: Floats, other: Floats) -> Floats:
    """`one` after `other`, (n, 4) each or one of them (4,)."""
    a, b = np.moveaxis(np.asarray(one), -1, 0), np.moveaxis(np.asarray(other), -1, 0)
    return np.stack(
        [
            a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
            a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
            a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
            a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
        ],
        axis=-1,
    )


def conjugate(one: Floats) -> Floats:
    """The way back, (n, 4)."""
    return np.asarray(one * np.array([1.0, -1.0, -1.0, -1.0]))


def of_vector(turn_rad: Floats) -> Floats:
    """Turned by |`turn_rad`| about its direction: (n, 3) -> (n, 4). [rad]"""
    angle = np.sqrt(np.einsum("ij,ij->i", turn_rad, turn_rad))
    small = angle < SMALL
    share = np.where(small, 0.5, np.sin(angle / 2.0) / np.where(small, 1.0, angle))
    return np.concatenate([np.cos(angle / 2.0)[:, None], share[:, None] * turn_rad], axis=1)


def to_vector(one: Floats) -> Floats:
    """The shortest turn that a quaternion is: (n, 4) -> (n, 3), at most half a turn. [rad]"""
    one = np.where(one[:, :1] < 0.0, -one, one)
    sine = np.sqrt(np.einsum("ij,ij->i", one[:, 1:], one[:, 1:]))
    small = sine < SMALL
    share = np.where(small, 2.0, 2.0 * np.arctan2(sine, one[:, 0]) / np.where(small, 1.0, sine))
    return np.asarray(share[:, None] * one[:, 1:])


def slerp(before: Floats, after: Floats, share: Floats) -> Floats:
    """Between two orientations (n, 4) at `share` (n,) of the shortest way, turning evenly."""
    turn = to_vector(product(after, conjugate(before)))
    return product(of_vector(share[:, None] * turn), before)


def turned(quaternion: Floats, vectors: Floats) -> Floats:
    """Vectors (n, 3) of a body in the world, by its orientations (n, 4)."""
    axis = quaternion[:, 1:]
    twice = 2.0 * np.cross(axis, vectors)
    return np.asarray(vectors + quaternion[:, :1] * twice + np.cross(axis, twice))


def travelled(velocity: Floats, spin: Floats, span_s: Floats) -> Floats:
    """How far a body comes in `span_s` (n,) at constant twist: `velocity` (n, 3), which turns with `spin` (n, 3). [m]

    Notes
    -----
    ``(T + (1 - cos a) / w^2 [w] + (a - sin a) / w^3 [w]^2) v`` with ``a = w T``: the integral of Rodrigues' formula.
    """
    rate = np.sqrt(np.einsum("ij,ij->i", spin, spin))
    angle = rate * span_s
    small = np.abs(angle) < 1e-4
    safe = np.where(small, 1.0, rate)
    square = np.where(small, span_s**2 / 2.0, (1.0 - np.cos(angle)) / safe**2)
    cube = np.where(small, span_s**3 / 6.0, (angle - np.sin(angle)) / safe**3)
    across = np.cross(spin, velocity)
    return np.asarray(span_s[:, None] * velocity + square[:, None] * across + cube[:, None] * np.cross(spin, across))
