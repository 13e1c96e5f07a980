"""How far the ranges that a host read of a cloud are from those measured: beams matched by layer and azimuth, or,
of a cloud without layers, points by the nearest one.

Belongs here: the matching. Not: series of a run (series).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from emulator.hosts.scans import HostCloud
from protocols.scan import Floats

SAME_LAYER_RAD = 1e-4
LAYER_DEG = 1000.0
"Layers are so far apart on the axis on which beams are matched; azimuths are within 360."
NEIGHBOURS = 2
"On each side: slices overlap, and mirrors differ, so that a few beams have nearly the same azimuth."


class Beams(Protocol):
    """Beams of a slice."""

    @property
    def azimuth_rad(self) -> Floats:
        """(n,)"""

    @property
    def heights(self) -> Floats:
        """(n,) elevations. [rad]"""

    @property
    def echoes(self) -> Floats:
        """(n, k) ranges. [m]"""


def _keys(azimuth_rad: Floats, elevation_rad: Floats, layers: Floats) -> Floats:
    layer = np.searchsorted(layers, elevation_rad + 0.5 * SAME_LAYER_RAD, side="right")
    return np.asarray(LAYER_DEG * layer + np.degrees(azimuth_rad) % 360.0)


def _differences(cloud: HostCloud, slices: Sequence[Beams], within_rad: float) -> Floats:
    """(n,) from the nearest echo of the beam that matches; NaN: none does, or it has none."""
    elevation = np.concatenate([one.heights for one in slices])
    if not len(elevation):
        return np.full(len(cloud.range_m), np.nan)
    layers = np.unique(elevation)
    layers = layers[np.diff(layers, prepend=-np.inf) > SAME_LAYER_RAD]
    keys = _keys(np.concatenate([one.azimuth_rad for one in slices]), elevation, layers)
    order = np.argsort(keys, kind="stable")
    keys, wanted = keys[order], _keys(cloud.azimuth_rad, cloud.elevation_rad, layers)
    right = np.searchsorted(keys, wanted)
    width = max(one.echoes.shape[1] for one in slices)
    echoes = np.full((len(keys), width), np.nan)
    first = 0
    for one in slices:
        echoes[first : first + len(one.echoes), : one.echoes.shape[1]] = one.echoes
        first += len(one.echoes)
    found = np.full(len(wanted), np.nan)
    for step in range(-NEIGHBOURS, NEIGHBOURS):
        beside = np.clip(right + step, 0, len(keys) - 1)
        apart = np.fmin.reduce(np.abs(echoes[order][beside] - cloud.range_m[:, None]), axis=1)
        found = np.fmin(found, np.where(np.abs(keys[beside] - wanted) < np.degrees(within_rad), apart, np.nan))
    return found


def largest(cloud: HostCloud, slices: Sequence[Beams], within_rad: float) -> float:
    """Largest difference of a turn read from the slices that it may have come of, the newest last; NaN: none matches.

    The newest slice is matched apart: it may belong to the next turn, whose beams have nearly the same azimuths.
    """
    parts = [part for part in (slices[:-1], slices[-1:]) if part]
    if not parts or not len(cloud.range_m):
        return float("nan")
    if not cloud.layered:
        return _farthest(cloud, slices)
    found = np.fmin.reduce([_differences(cloud, part, within_rad) for part in parts])
    known = found[~np.isnan(found)]
    return float(known.max()) if len(known) else float("nan")


def _farthest(cloud: HostCloud, slices: Sequence[Beams]) -> float:
    """Largest distance of a point that was read from the nearest one measured."""
    from scipy.spatial import KDTree

    parts = [_points(one.azimuth_rad, one.heights, one.echoes[:, echo]) for one in slices
             for echo in range(one.echoes.shape[1])]  # fmt: skip
    measured = np.concatenate(parts)
    measured = measured[~np.isnan(measured[:, 0])]
    if not len(measured):
        return float("nan")
    apart, _ = KDTree(measured).query(_points(cloud.azimuth_rad, cloud.elevation_rad, cloud.range_m))
    return float(np.max(apart))


def _points(azimuth_rad: Floats, elevation_rad: Floats, range_m: Floats) -> Floats:
    level = range_m * np.cos(elevation_rad)
    return np.stack([level * np.cos(azimuth_rad), level * np.sin(azimuth_rad), range_m * np.sin(elevation_rad)], axis=1)
