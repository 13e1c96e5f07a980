"""What the device does to echoes before it sends them: echo choice, fog, particle, median, mean, in that order.

Belongs here: arithmetic over beams, and what a filter remembers of earlier scans. Not: the variables that set them.
"""

from __future__ import annotations

import warnings
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from protocols.cola.layouts import Angles
from protocols.scan import Floats, Scan, ScanPlan

Place = tuple[int, int]
"Turn of an interlaced sequence, and layer: what scans of the same directions have in common."
FIRST, ALL, LAST = 0, 1, 2
"FREchoFilter."
FOG_M, FOG_PEAK = 4.0, 8.0
"""The fog filter takes away weak echoes of the near field: what is nearer than `FOG_M` and weaker than `FOG_PEAK`
times the threshold. The maker describes the effect and no figure; these are ours."""


EDGE_FAR_M = 16.0
"The edge filter acts up to here (MRS1000 manual)."


@dataclass(frozen=True)
class Filters:
    """How the filters are set."""

    echo: int = FIRST
    fog: bool = False
    particle_m: float | None = None
    "An echo needs another one within this distance beside it or before it; None: off."
    median: bool = False
    angles: Angles | None = None
    edge_m: float = 0.0
    "Neighbours that differ by more are both gone; 0: off."
    mean: int = 1
    "Scans a telegram; its rate falls by as much."


@dataclass(frozen=True, eq=False)
class Filtered:
    """What is left of one scan, or of several."""

    range_m: Floats
    intensity: Floats
    flags: np.ndarray


class Chain:
    """The filters of one device. Settings and directions may change only with `clear`."""

    def __init__(self) -> None:
        self._before: dict[Place, Floats] = {}
        "Ranges of the scan before, of the same directions."
        self._window: dict[Place, deque[Floats]] = {}
        self._gathered: dict[Place, list[Filtered]] = {}

    def clear(self) -> None:
        """Forget earlier scans."""
        self._before.clear()
        self._window.clear()
        self._gathered.clear()

    def add(self, scan: Scan, sent: slice, filters: Filters, place: Place) -> Filtered | None:
        """What the beams of a scan that are sent become; None: a mean needs more of them."""
        ranges, peaks = scan.range_m[sent].copy(), scan.intensity[sent].copy()
        if filters.fog:
            ranges, peaks = _pushed(ranges, peaks, (ranges < FOG_M) & (peaks < FOG_PEAK))
        if filters.echo != ALL:
            ranges, peaks = _one(ranges, peaks, filters.echo)
        if filters.angles is not None:
            ranges[_outside(filters.angles, scan.plan)[sent]] = np.nan
        if filters.edge_m:
            ranges[_edges(ranges, filters.edge_m)] = np.nan
        if filters.particle_m is not None:
            before = self._before.get(place)
            self._before[place] = ranges.copy()
            gone = _lonely(ranges, before, filters.particle_m)
            ranges, peaks = np.where(gone, np.nan, ranges), np.where(gone, np.nan, peaks)
        if filters.median:
            window = self._window.setdefault(place, deque(maxlen=3))
            window.append(ranges)
            middle = _median(list(window))
            ranges = np.where(np.isfinite(ranges), middle, np.nan)
        found = Filtered(ranges, peaks, scan.flags[sent])
        if filters.mean < 2:
            return found
        parts = self._gathered.setdefault(place, [])
        parts.append(found)
        if len(parts) < filters.mean:
            return None
        del self._gathered[place]
        return Filtered(
            _mean([part.range_m for part in parts]),
            _mean([part.intensity for part in parts]),
            np.bitwise_and.reduce([part.flags for part in parts]),
        )


def _outside(angles: Angles, plan: ScanPlan) -> NDArray[np.bool_]:
    """Beams without values, (n,)."""
    azimuth, elevation = plan.azimuth_rad, plan.elevation_rad
    inside = (azimuth >= angles.azimuth_from) & (azimuth <= angles.azimuth_to)
    inside &= (elevation >= angles.elevation_from) & (elevation <= angles.elevation_to)
    return np.asarray(~inside | (np.arange(len(azimuth)) % angles.every != 0))


def _pushed(ranges: Floats, peaks: Floats, gone: np.ndarray) -> tuple[Floats, Floats]:
    """Without what is gone; the echoes behind move up."""
    order = np.argsort(gone | ~np.isfinite(ranges), axis=1, kind="stable")
    left = np.where(gone, np.nan, ranges), np.where(gone, np.nan, peaks)
    return np.take_along_axis(left[0], order, 1), np.take_along_axis(left[1], order, 1)


def _one(ranges: Floats, peaks: Floats, which: int) -> tuple[Floats, Floats]:
    """The first, or the last echo of each beam alone."""
    if which == FIRST:
        return ranges[:, :1], peaks[:, :1]
    last = np.maximum(np.isfinite(ranges).sum(axis=1) - 1, 0)[:, None]
    return np.take_along_axis(ranges, last, 1), np.take_along_axis(peaks, last, 1)


def _lonely(ranges: Floats, before: Floats | None, near_m: float) -> np.ndarray:
    """Echoes without another one near: beside them in this scan, or in their direction in the scan before."""
    found = _both_sides(np.abs(np.diff(ranges, axis=0)) <= near_m)
    if before is not None and before.shape == ranges.shape:
        found |= np.abs(ranges - before) <= near_m
    return np.isfinite(ranges) & ~found


def _edges(ranges: Floats, most_m: float) -> np.ndarray:
    """Echoes of both sides of a step; a direction without an echo is no step."""
    near = np.minimum(ranges[1:], ranges[:-1]) <= EDGE_FAR_M
    return _both_sides(near & (np.abs(np.diff(ranges, axis=0)) > most_m))


def _both_sides(between: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Echoes beside what holds between one direction and the next."""
    found = np.zeros((len(between) + 1, *between.shape[1:]), bool)
    found[1:] |= between
    found[:-1] |= between
    return found


def _median(window: list[Floats]) -> Floats:
    """Of three scans and three neighbouring directions."""
    padded = [np.pad(one, ((1, 1), (0, 0)), mode="edge") for one in window]
    stack = np.stack([one[k : k + len(one) - 2] for one in padded for k in range(3)])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a direction without any echo stays without
        return np.asarray(np.nanmedian(stack, axis=0))


def _mean(parts: list[Floats]) -> Floats:
    """Of the scans that have an echo there, when at least half of them do."""
    stack = np.stack(parts)
    count = np.isfinite(stack).sum(axis=0)
    total = np.where(np.isfinite(stack), stack, 0.0).sum(axis=0)
    return np.where(2 * count >= len(parts), total / np.maximum(count, 1), np.nan)
