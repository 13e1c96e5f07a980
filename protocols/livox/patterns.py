"""Scan patterns by formula: raster, Risley rosette, MEMS Lissajous. Where each point of a frame is aimed, and when.

Belongs here: directions and instants. Not: reading of a spec's table (settings), packets (codec).

Angles are ISO 8855 in the sensor's frame, the axis of the pattern is x. Points fire at a fixed rate, except while a
raster flies back. Phases are computed from the number of a frame as fractions, so they are as exact after a year.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from protocols.scan import Floats

Index = NDArray[np.int64]
Pair = tuple[float, float]
Exact = tuple[Fraction, Fraction]


class Pattern(Protocol):
    """One scanner. Points are numbered within a frame."""

    @property
    def rate_hz(self) -> Fraction:
        """Of points."""

    @property
    def frame_s(self) -> Fraction:
        """From frame to frame."""

    @property
    def points(self) -> int:
        """Of a frame."""

    @property
    def run(self) -> int:
        """Points that follow each other without a gap; `points` is a multiple of it."""

    def fire_s(self, index: Index) -> Floats:
        """(n,) after the beginning of the frame."""

    def aim(self, frame: int, index: Index) -> tuple[Floats, Floats]:
        """(n,) azimuth and elevation. [rad]"""


def place(field_deg: float, index: Index, count: int) -> Floats:
    """(n,) of `count` places evenly over a field, from its positive edge to the negative one. [rad]"""
    share = index / (count - 1) if count > 1 else np.full(len(index), 0.5)
    return np.asarray(math.radians(field_deg) * (0.5 - share))


@dataclass(frozen=True)
class Raster:
    """Rows from the top, points of a row from the left, or to and fro; the slow axis moves between rows."""

    rate_hz: Fraction
    rows: int
    columns: int
    field_deg: Pair
    "Between the outermost points, in azimuth and elevation."
    flyback_s: Fraction = Fraction(0)
    "After each row, without a point."
    frame_flyback_s: Fraction = Fraction(0)
    "And after the last one."
    both_ways: bool = False
    "Every second row begins at the right."

    @property
    def row_s(self) -> Fraction:
        """From row to row."""
        return self.columns / self.rate_hz + self.flyback_s

    @property
    def frame_s(self) -> Fraction:
        """From frame to frame."""
        return self.rows * self.row_s + self.frame_flyback_s

    @property
    def points(self) -> int:
        """Of a frame."""
        return self.rows * self.columns

    @property
    def run(self) -> int:
        """A row."""
        return self.columns

    def fire_s(self, index: Index) -> Floats:
        """(n,) after the beginning of the frame."""
        row, column = np.divmod(index, self.columns)
        return np.asarray(row * float(self.row_s) + column / float(self.rate_hz))

    def aim(self, frame: int, index: Index) -> tuple[Floats, Floats]:
        """(n,) azimuth and elevation, the same in each frame. [rad]"""
        row, column = np.divmod(index, self.columns)
        if self.both_ways:
            column = np.where(row % 2, self.columns - 1 - column, column)
        return place(self.field_deg[0], column, self.columns), place(self.field_deg[1], row, self.rows)


@dataclass(frozen=True)
class Turning:
    """What rosette and Lissajous have in common: two periodic motions, and points that never pause."""

    rate_hz: Fraction
    frame_s: Fraction
    hz: Exact
    "Of both motions; negative: the other way round."
    phase_deg: Exact
    "Of both, at the beginning of frame 0."

    @property
    def points(self) -> int:
        """Of a frame."""
        return math.ceil(self.frame_s * self.rate_hz)

    @property
    def run(self) -> int:
        """The whole frame."""
        return self.points

    def fire_s(self, index: Index) -> Floats:
        """(n,) after the beginning of the frame."""
        return index / float(self.rate_hz)

    def phases(self, frame: int, index: Index) -> tuple[Floats, Floats]:
        """(n,) of both motions. [rad]"""
        first = int(index[0]) if len(index) else 0
        begin_s, after_s = frame * self.frame_s + first / self.rate_hz, (index - first) / float(self.rate_hz)
        one, other = (
            2.0 * np.pi * (float((hz * begin_s + phase / 360) % 1) + float(hz) * after_s)
            for hz, phase in zip(self.hz, self.phase_deg, strict=True)
        )
        return one, other


@dataclass(frozen=True)
class Lissajous(Turning):
    """A mirror that swings about two axes: ``azimuth = X/2 sin(2 pi fx t + px)``, elevation alike."""

    field_deg: Pair = (30.0, 20.0)
    "X and Y, from edge to edge."

    def aim(self, frame: int, index: Index) -> tuple[Floats, Floats]:
        """(n,) azimuth and elevation. [rad]"""
        one, other = self.phases(frame, index)
        x, y = (math.radians(0.5 * field) for field in self.field_deg)
        return x * np.sin(one), y * np.sin(other)


@dataclass(frozen=True)
class Rosette(Turning):
    """Two wedge prisms of glass that turn about the same axis, one behind the other (Risley prisms)."""

    index: Pair = (1.5, 1.5)
    "Of refraction."
    wedge_deg: Pair = (10.0, 10.0)

    def aim(self, frame: int, index: Index) -> tuple[Floats, Floats]:
        """(n,) azimuth and elevation. [rad]"""
        one, other = self.phases(frame, index)
        x, y, z = through_wedges(self.index, np.radians(self.wedge_deg), one, other)
        return np.arctan2(y, x), np.arcsin(np.clip(z, -1.0, 1.0))


def repetition_s(hz: Exact) -> Fraction:
    """After which time two motions are in phase again: ``1 / gcd(f1, f2)``. [s]"""
    one, other = hz
    shared = math.gcd(one.numerator * other.denominator, other.numerator * one.denominator)
    return Fraction(one.denominator * other.denominator, shared)


def through_wedges(index: Pair, wedge_rad: Any, one_rad: Floats, other_rad: Floats) -> Floats:
    """(3, n) direction of light that came along x; NaN where it does not leave the glass (total reflection).

    Parameters
    ----------
    index : of refraction, both wedges
    wedge_rad : (2,) angles between their faces
    one_rad, other_rad : (n,)
        Where each is thickest, from y (left) towards z (up); light is bent towards there.

    Notes
    -----
    Snell's law in vectors at each face, exact for any angle: flat face and oblique face of the first, oblique face and
    flat face of the second. For thin wedges the deviation is ``(n - 1) A`` each, and both add as vectors.

    References
    ----------
    .. [1] G. F. Marshall, Risley prism scan patterns, Proc. SPIE 3787 (1999); from memory.
    .. [2] Y. Li, Closed form analytical inverse solutions for Risley-prism-based beam steering systems in different
       configurations, Appl. Opt. 50 (2011); from memory.
    """
    n1, n2 = index
    a1, a2 = wedge_rad
    along = np.stack([np.ones_like(one_rad), np.zeros_like(one_rad), np.zeros_like(one_rad)])
    out = _refracted(along, _normal(-a1, one_rad), n1)  # along x the flat face changes nothing
    inside = _refracted(out, _normal(a2, other_rad), 1.0 / n2)
    return _refracted(inside, along, n2)


def _normal(tilt_rad: float, about_rad: Floats) -> Floats:
    """(3, n) along x, tilted by an angle towards a direction of the y-z plane."""
    side = math.sin(tilt_rad)
    return np.stack([np.full_like(about_rad, math.cos(tilt_rad)), side * np.cos(about_rad), side * np.sin(about_rad)])


def _refracted(ray: Floats, normal: Floats, ratio: float) -> Floats:
    """(3, n) after a face; `ratio`: index before it over that behind. Normals point forward."""
    cosine = np.sum(ray * normal, axis=0)
    left = 1.0 - ratio**2 * (1.0 - cosine**2)
    with np.errstate(invalid="ignore"):
        behind = np.where(left >= 0.0, np.sqrt(np.maximum(left, 0.0)), np.nan)
    return np.asarray(ratio * ray + (behind - ratio * cosine) * normal)
