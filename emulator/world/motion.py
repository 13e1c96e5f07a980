"""Rigid motion: where something is and how it is turned, at any times at once.

Belongs here: rotations from yaw, pitch and roll (ISO 8855), motions with constant velocity and along waypoints.
Not: whose motion it is (scene), and the shape that moves.

Everything is float64 and vectorised over times. Before its first and after its last waypoint a body stands still.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Vector = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Pose:
    """Position and orientation at n times."""

    position_m: Floats
    "(n, 3) of the body's origin, in the world."
    rotation: Floats
    "(n, 3, 3) body to world: columns are the body's axes."

    def to_world(self, point_m: Floats) -> Floats:
        """Points of the body, (n, 3) or (3,), in the world: (n, 3)."""
        with np.errstate(under="ignore"):
            point = np.asarray(point_m)
            if len(self.rotation) and point.ndim == 2 and not self.rotation.strides[0]:  # turned the same at all times
                n = np.broadcast_shapes(point[:, 0].shape, self.position_m[:, 0].shape)
                turn, made = self.rotation[0], np.broadcast_to(self.position_m.T, (3, *n)).copy()
                for row, into in zip(turn, made, strict=True):
                    into += row[0] * point[:, 0] + row[1] * point[:, 1] + row[2] * point[:, 2]
                return np.asarray(made.T)
            return np.asarray((self.rotation @ point[..., None])[..., 0] + self.position_m)

    def after(self, outer: Pose) -> Pose:
        """This pose, given in a frame whose own pose in the world is `outer`."""
        with np.errstate(under="ignore"):
            fixed = len(self.rotation) and not (self.rotation.strides[0] or self.position_m.strides[0])
            if fixed and not outer.rotation.strides[0]:  # the same at all times
                turned = outer.rotation[0]
                rotation = np.broadcast_to(turned @ self.rotation[0], self.rotation.shape)
                return Pose(outer.position_m + turned @ self.position_m[0], rotation)
            return Pose(outer.to_world(self.position_m), outer.rotation @ self.rotation)


def rotation_matrix(yaw_deg: float, pitch_deg: float = 0.0, roll_deg: float = 0.0) -> Floats:
    """Rotation of a body turned by yaw, then pitch, then roll, each about its own turned axis.

    Parameters
    ----------
    yaw_deg, pitch_deg, roll_deg : float
        About z (x towards y), about y (z towards x: the nose goes down), about x (y towards z). [deg]

    Returns
    -------
    rotation : (3, 3), body to world. Multiples of 90 degrees give exact zeros and ones.

    References
    ----------
    .. [1] ISO 8855:2011, Road vehicles - Vehicle dynamics and road-holding ability - Vocabulary.
    """
    (cy, sy), (cp, sp), (cr, sr) = (_cos_sin_deg(angle) for angle in (yaw_deg, pitch_deg, roll_deg))
    about_z = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
    about_y = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    with np.errstate(under="ignore"):  # products of sines of tiny angles
        return np.asarray(about_z @ about_y @ about_x)


def _cos_sin_deg(angle_deg: float) -> tuple[float, float]:
    quarter, rest = divmod(math.remainder(angle_deg, 360.0), 90.0)
    cos, sin = math.cos(math.radians(rest)), math.sin(math.radians(rest))
    for _ in range(int(quarter) % 4):
        cos, sin = -sin, cos
    return cos, sin


class Motion(ABC):
    """How a rigid body moves."""

    @property
    @abstractmethod
    def still(self) -> bool:
        """Never moves and never turns."""

    @property
    @abstractmethod
    def turns(self) -> bool:
        """Its orientation changes at some time."""

    @property
    def may_come(self) -> bool:
        """It is of an actor that a feed may bring, in whatever size."""
        return False

    @property
    @abstractmethod
    def speed_bound_m_s(self) -> float:
        """Its origin is never faster; infinite where it jumps."""

    @abstractmethod
    def position(self, t_s: Floats) -> Floats:
        """Origin in the world, (n, 3), at times (n,)."""

    @abstractmethod
    def rotation(self, t_s: Floats) -> Floats:
        """Body to world, (n, 3, 3); (1, 3, 3) where it does not turn."""

    @abstractmethod
    def velocity(self, t_s: Floats) -> Floats:
        """Of the origin, in the world, (n, 3). At a waypoint: of the stretch that begins there."""

    def pose(self, t_s: Floats) -> Pose:
        """Position and rotation at times (n,)."""
        times = np.atleast_1d(np.asarray(t_s, dtype=np.float64))
        rotation = self.rotation(times)
        if len(rotation) != len(times):
            rotation = np.broadcast_to(rotation, (len(times), 3, 3))
        return Pose(self.position(times), rotation)


@dataclass(frozen=True)
class Steady(Motion):
    """Constant velocity in the world's frame and constant yaw rate; the velocity does not turn with the body."""

    at_m: Vector = (0.0, 0.0, 0.0)
    yaw_deg: float = 0.0
    pitch_deg: float = 0.0
    roll_deg: float = 0.0
    velocity_m_s: Vector = (0.0, 0.0, 0.0)
    yaw_rate_deg_s: float = 0.0

    @property
    def still(self) -> bool:
        return not self.turns and not any(self.velocity_m_s)

    @property
    def turns(self) -> bool:
        return self.yaw_rate_deg_s != 0.0

    @property
    def speed_bound_m_s(self) -> float:
        return math.hypot(*self.velocity_m_s)

    def position(self, t_s: Floats) -> Floats:
        if not any(self.velocity_m_s):
            return np.broadcast_to(np.asarray(self.at_m, dtype=np.float64), (len(t_s), 3))
        # each coordinate is one long row: a tenth of the time of rows of three
        at_m, velocity = np.asarray(self.at_m, np.float64), np.asarray(self.velocity_m_s, np.float64)
        return np.asarray((at_m[:, None] + t_s * velocity[:, None]).T)

    @cached_property
    def _start(self) -> Floats:
        start = rotation_matrix(self.yaw_deg, self.pitch_deg, self.roll_deg)[None]
        start.flags.writeable = False
        return start

    def rotation(self, t_s: Floats) -> Floats:
        start = self._start
        if not self.turns:
            return start
        angle = np.radians(np.remainder(self.yaw_rate_deg_s * t_s, 360.0))
        spin = np.zeros((len(t_s), 3, 3))
        spin[:, 0, 0] = spin[:, 1, 1] = np.cos(angle)
        spin[:, 1, 0] = np.sin(angle)
        spin[:, 0, 1] = -spin[:, 1, 0]
        spin[:, 2, 2] = 1.0
        return np.asarray(spin @ start)

    def velocity(self, t_s: Floats) -> Floats:
        return np.broadcast_to(np.asarray(self.velocity_m_s, dtype=np.float64), (len(t_s), 3))


@dataclass(frozen=True, eq=False)
class Waypoints(Motion):
    """Straight lines between waypoints, turning the shortest way at a constant rate (quaternion slerp)."""

    t_s: Floats
    "(k,) ascending."
    at_m: Floats
    "(k, 3)"
    quaternion: Floats
    "(k, 4) w x y z; signs such that neighbours are the short way apart."
    loop: bool = False
    "Begin again at the first waypoint when the last is reached; also backwards before the first."
    _velocity: Floats = field(init=False, repr=False)
    _angle: Floats = field(init=False, repr=False)

    def __post_init__(self) -> None:
        step = np.diff(self.t_s)
        velocity = np.zeros((len(self.t_s) + 1, 3))
        with np.errstate(under="ignore"):
            velocity[1:-1] = np.diff(self.at_m, axis=0) / step[:, None]
        object.__setattr__(self, "_velocity", velocity)
        # angle between neighbours from the chord: acos(dot) loses half the digits for small turns
        with np.errstate(under="ignore"):
            chord = np.linalg.norm(np.diff(self.quaternion, axis=0), axis=1)
        object.__setattr__(self, "_angle", 2.0 * np.arcsin(np.minimum(chord / 2.0, 1.0)))

    @classmethod
    def through(
        cls, t_s: Sequence[float], at_m: Sequence[Vector], angles_deg: Sequence[Vector], loop: bool = False
    ) -> Waypoints:
        """Waypoints from times, positions and (yaw, pitch, roll)."""
        quaternion = np.array([quaternion_of(rotation_matrix(*angles)) for angles in angles_deg])
        for k in range(1, len(quaternion)):
            if quaternion[k] @ quaternion[k - 1] < 0.0:
                quaternion[k] = -quaternion[k]
        return cls(np.asarray(t_s, dtype=np.float64), np.asarray(at_m, dtype=np.float64), quaternion, loop)

    @property
    def turning(self) -> Floats:
        """(k - 1,) angle between the quaternions of neighbouring waypoints, half the angle turned. [rad]"""
        return self._angle

    @property
    def still(self) -> bool:
        return not self.turns and not self._velocity.any()

    @property
    def turns(self) -> bool:
        return bool(self._angle.any())

    @property
    def speed_bound_m_s(self) -> float:
        if self.loop and not np.array_equal(self.at_m[0], self.at_m[-1]):
            return math.inf
        with np.errstate(under="ignore"):
            return float(np.linalg.norm(self._velocity, axis=1).max())

    def _local(self, t_s: Floats) -> Floats:
        if not self.loop or len(self.t_s) == 1:
            return t_s
        return t_s - whole_turns(t_s, self.t_s[0], self.t_s[-1] - self.t_s[0])

    def position(self, t_s: Floats) -> Floats:
        local = self._local(t_s)
        last = len(self.t_s) - 1
        index = np.clip(np.searchsorted(self.t_s, local, side="right") - 1, 0, last)
        elapsed = np.clip(local, self.t_s[0], self.t_s[-1]) - self.t_s[index]
        return np.asarray(self.at_m[index] + elapsed[:, None] * self._velocity[index + 1])

    def rotation(self, t_s: Floats) -> Floats:
        if not self.turns:
            return matrix_of(self.quaternion[:1])
        local = np.clip(self._local(t_s), self.t_s[0], self.t_s[-1])
        index = np.clip(np.searchsorted(self.t_s, local, side="right") - 1, 0, len(self.t_s) - 2)
        share = (local - self.t_s[index]) / (self.t_s[index + 1] - self.t_s[index])
        angle = self._angle[index]
        small = angle < 1e-8
        sine = np.where(small, 1.0, np.sin(angle))
        before = np.where(small, 1.0 - share, np.sin((1.0 - share) * angle) / sine)
        after = np.where(small, share, np.sin(share * angle) / sine)
        return matrix_of(before[:, None] * self.quaternion[index] + after[:, None] * self.quaternion[index + 1])

    def velocity(self, t_s: Floats) -> Floats:
        return np.asarray(self._velocity[np.searchsorted(self.t_s, self._local(t_s), side="right")])


def whole_turns(t_s: Floats | float, first_s: Floats | float, span_s: Floats | float) -> Floats:
    """Time that a loop's finished turns took, to be taken off `t_s`."""
    elapsed = np.asarray(t_s) - first_s
    with np.errstate(under="ignore"):
        turns = np.floor(elapsed / span_s)
    turns = turns + (elapsed - turns * span_s >= span_s)  # a hair before the end rounds to the end
    return np.asarray(turns * span_s)


def quaternion_of(rotation: Floats) -> Floats:
    """Unit quaternion (w, x, y, z) of a rotation matrix (3, 3); by the largest of its four squares."""
    m = rotation
    squares = np.array([1 + m[0, 0] + m[1, 1] + m[2, 2], 1 + m[0, 0] - m[1, 1] - m[2, 2],
                        1 - m[0, 0] + m[1, 1] - m[2, 2], 1 - m[0, 0] - m[1, 1] + m[2, 2]])  # fmt: skip
    products = np.array(
        [
            [squares[0], m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]],
            [m[2, 1] - m[1, 2], squares[1], m[1, 0] + m[0, 1], m[0, 2] + m[2, 0]],
            [m[0, 2] - m[2, 0], m[1, 0] + m[0, 1], squares[2], m[2, 1] + m[1, 2]],
            [m[1, 0] - m[0, 1], m[0, 2] + m[2, 0], m[2, 1] + m[1, 2], squares[3]],
        ]
    )
    row = products[int(np.argmax(squares))]
    return np.asarray(row / np.linalg.norm(row))


def matrix_of(quaternion: Floats) -> Floats:
    """Rotation matrices (n, 3, 3) of quaternions (n, 4), which need not be of unit length."""
    w, x, y, z = (quaternion / np.linalg.norm(quaternion, axis=1)[:, None]).T
    out = np.zeros((len(quaternion), 3, 3))
    out[:, 0, 0], out[:, 0, 1], out[:, 0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    out[:, 1, 0], out[:, 1, 1], out[:, 1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    out[:, 2, 0], out[:, 2, 1], out[:, 2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    return out
