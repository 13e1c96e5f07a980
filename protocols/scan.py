"""The interface between the protocol of a device and the world: the sweep that it requests, and the result.

Arrays are read-only by convention. Units are SI, angles ISO 8855 in the sensor's own frame: x forward, y left, z up;
azimuth 0 is the x axis, positive to the left, elevation positive upwards. Codecs turn them into the wire's own.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

DAZZLED = 1
"Bit of `Scan.flags`: background light saturates the receiver, the beam gives no echo."
SATURATED = 2
"Bit of `Scan.flags`: the echo's peak was clipped."


@dataclass(frozen=True, eq=False)
class ScanPlan:
    """One sweep that the device wants measured: n beams, each with its own direction and instant."""

    epoch: int
    "Number of the settings it was made under; a scan of another epoch is refused."
    sweep: int
    "Number of the sweep since power-on; with scenario seed and sensor it keys every random draw."
    start_ns: int
    "Instant to which `fire_offset_s` refers, nanoseconds since the run began."
    azimuth_rad: Floats
    "(n,)"
    elevation_rad: Floats
    "(n,)"
    fire_offset_s: Floats
    "(n,) instant of each beam after `start_ns`; not necessarily ascending (interlaced combs)."
    duration_s: float = 0.0
    "From `start_ns` until the device can have evaluated the whole sweep."
    max_echoes: int = 1
    max_range_m: float = float("inf")
    "Farther echoes cannot be reported in the present setting and need not be computed."
    gain: float = 1.0
    "Receiver sensitivity against the model's standard setting: factor on the received power."
    wants_intensity: bool = False
    wants_objects: bool = False
    stream: int | None = None
    """Which stream of scans it belongs to; None: that of its epoch. Every number of a stream is owed to hosts: for a
    skipped one the session reports why it is not measured (`Dropped`)."""
    stride: int = 1
    "By how much the number goes up from scan to scan within the stream: turns of a mirror that one scan takes."
    period_ns: int | None = None
    "From scan to scan of the stream; 0: no other follows by itself; None: not known in advance."
    turn: int | None = None
    "Of a slice: the turn since power-on in which it begins; None: the scan is a whole one."
    origin_m: Floats | None = None
    "(n, 3) where each beam begins, in the sensor's frame; None: all in its origin. Ranges count from there."
    wants_ambient: bool = False
    "`Scan.ambient_w` is reported."

    def __len__(self) -> int:
        return len(self.azimuth_rad)


def points_of(azimuth_rad: Floats, elevation_rad: Floats, range_m: Floats, origin_m: Floats | None = None) -> Floats:
    """(n, 3) where beams of these directions end after so much, in the sensor's frame; `origin_m`: see `ScanPlan`."""
    flat = range_m * np.cos(elevation_rad)
    points = np.stack(
        [flat * np.cos(azimuth_rad), flat * np.sin(azimuth_rad), range_m * np.sin(elevation_rad)], axis=-1
    )
    return points if origin_m is None else points + origin_m


@dataclass(frozen=True)
class DetectedObject:
    """One object of an object list, in the frame of the sensor that lists it."""

    track: int
    "Number that stays with the object over scans."
    position_m: tuple[float, float, float]
    "Centre of the box."
    velocity_m_s: tuple[float, float, float]
    "Relative to the sensor."
    size_m: tuple[float, float, float]
    "Length, width, height of the box."
    yaw_rad: float
    category: str
    "car | truck | motorcycle | bicycle | pedestrian | wide | point | unknown"
    age_s: float = 0.0
    existence: float = 1.0
    "Probability that it is there, 0..1."
    position_std_m: tuple[float, float] = (0.0, 0.0)
    velocity_std_m_s: tuple[float, float] = (0.0, 0.0)
    acceleration_m_s2: tuple[float, float] = (0.0, 0.0)
    reflectance: float = 0.0
    "Lambert-equivalent, mean of its echoes."
    actor: str | None = None
    "Ground truth, for recordings and reports; no encoder reads it."
    coasting_s: float = 0.0
    "Time since its last echo; 0 if it has one in this scan."
    acceleration_std_m_s2: tuple[float, float] | None = None
    "None: not known."
    yaw_std_rad: float | None = None
    "None: not known."
    contour_m: tuple[tuple[float, float], ...] = ()
    "Outline as seen, x and y in the sensor's frame, in the order of azimuth; empty: only the box is known."


@dataclass(frozen=True, eq=False)
class Scan:
    """The result of a sweep: k echoes per beam, nearest first, NaN where there is none."""

    plan: ScanPlan
    range_m: Floats
    "(n, k) unrounded; the codec alone rounds and writes the words for overflow, no echo, dazzled."
    intensity: Floats
    "(n, k) peak of the echo's signal over the receiver's detection threshold, >= 1; NaN where there is no echo."
    flags: NDArray[np.uint8]
    "(n,) DAZZLED | SATURATED"
    actor: Ints
    "(n, k) ground truth: index of the actor hit, -1 none or weather. For recordings and object lists, not for codecs."
    objects: tuple[DetectedObject, ...] = field(default=())
    ambient_w: Floats | None = None
    "(n,) background light on the detector, where the plan wants it; None: dark."

    @classmethod
    def empty(cls, plan: ScanPlan, echoes: int = 1) -> Scan:
        """A sweep without a single echo."""
        n = len(plan)
        nothing = np.full((n, echoes), np.nan)
        return cls(plan, nothing, nothing.copy(), np.zeros(n, np.uint8), np.full((n, echoes), -1, np.int32))
