"""The stack under test, as plain as can be: a time-to-collision brake, and the car that it brakes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

GRAVITY = 9.81
FRICTION = {"dry": 0.75, "wet": 0.40, "snow": 0.30}
"Of tyre and road; as in `lidaremu study published`, braking distance."


@dataclass
class Car:
    """A point mass on a line: x of its rear axle, speed, acceleration."""

    speed: float
    "[m/s]"
    friction: float
    x: float = 0.0
    "[m]"
    acceleration: float = 0.0
    delay: float = 0.15
    "From the demand to the first pressure. [s]"
    jerk: float = 40.0
    "At most. [m/s3]"
    demands: list[tuple[float, float]] = field(default_factory=lambda: [(0.0, 0.0)])
    "Instant and deceleration of each demand. [s, m/s2]"

    def demand(self, t: float, deceleration: float) -> None:
        """Brake so much from `t` + `delay` on."""
        if deceleration != self.demands[-1][1]:
            self.demands.append((t, deceleration))

    def move(self, t: float, dt: float) -> None:
        """From `t` to `t` + `dt`."""
        acting = max(one for one in self.demands if one[0] <= t - self.delay or one is self.demands[0])[1]
        wanted = -min(acting, self.friction * GRAVITY)
        change = min(max(wanted - self.acceleration, -self.jerk * dt), self.jerk * dt)
        before, self.acceleration = self.speed, self.acceleration + change
        self.speed = max(0.0, before + self.acceleration * dt)
        if self.speed == 0.0:
            self.acceleration = 0.0
        self.x += 0.5 * (before + self.speed) * dt


@dataclass
class Brake:
    """Full brake once `confirm` scans in a row agree on something in the lane that is less than `limit` away."""

    limit: float = 2.5
    "Time to collision: distance by own speed. [s]"
    confirm: int = 3
    half_lane: float = 1.1
    "[m]"
    echoes: int = 2
    "That something must have in a scan, within a metre."
    last: float | None = None
    run: int = 0
    "Scans in a row that agreed."
    at: float | None = None
    "Distance at which it has braked. [m]"

    def nearest(self, points: Sequence[tuple[float, float]]) -> float | None:
        """Distance of the nearest group of echoes in the lane."""
        ahead = sorted(x for x, y in points if abs(y) < self.half_lane and x > 0.3)
        groups = zip(ahead, ahead[self.echoes - 1 :], strict=False)
        return next((near for near, far in groups if far - near < 1.0), None)

    def see(self, points: Sequence[tuple[float, float]], speed: float) -> bool:
        """Whether to brake, after one more scan."""
        found = self.nearest(points)
        near = found is not None and found < self.limit * speed
        agrees = found is not None and self.last is not None and abs(found - self.last) < 1.5
        self.run = 0 if not near else self.run + 1 if agrees else 1
        self.last = found
        if self.at is None and self.run >= self.confirm:
            self.at = found
        return self.at is not None
