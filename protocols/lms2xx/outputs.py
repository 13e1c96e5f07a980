"""Which telegram of measured values a mode or request sends, how long it is, and how a measured scan fills it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from protocols.lms2xx import telegrams as wire
from protocols.lms2xx.values import (
    MeasuringMode,
    intensity_words,
    max_range_m,
    reflectance,
    reflectivity_bytes,
    value_words,
)
from protocols.scan import DAZZLED, SATURATED, Floats, Scan

ALL, MEAN, SUB_RANGE, MEAN_SUB_RANGE, REFLECTIVITY, INTENSITY = 0xB0, 0xB6, 0xB7, 0xBF, 0xC4, 0xF5
FIXED_BYTES = {ALL: 10, MEAN: 11, SUB_RANGE: 14, MEAN_SUB_RANGE: 15, REFLECTIVITY: 16, INTENSITY: 10}
"Telegram without values, groups and indices, by command."
GROUP_BYTES = 6


@dataclass(frozen=True)
class Output:
    """One kind of telegram of measured values."""

    command: int
    scans: int = 1
    "Averaged into one telegram."
    groups: tuple[tuple[int, int], ...] = ()
    "First and last beam of each sub-range, counted from 1; none: all beams."
    partial: bool = False
    "Partial scans of one turn each instead of complete ones."

    @property
    def wants_intensity(self) -> bool:
        return self.command in (REFLECTIVITY, INTENSITY)

    def telegram_bytes(self, points: int, indices: bool) -> int:
        """Length of the whole telegram for a scan of that many points."""
        size = FIXED_BYTES[self.command] + 2 * indices
        chosen = sum(last - first + 1 for first, last in self.groups) or points
        if self.command == INTENSITY:
            return size + GROUP_BYTES * len(self.groups) + 4 * chosen
        if self.command == REFLECTIVITY:
            return size + 2 * points + chosen
        return size + 2 * chosen


@dataclass(frozen=True, eq=False)
class Measured:
    """The nearest echoes of one scan, or of the mean of several; arrays (n,)."""

    range_m: Floats
    intensity: Floats
    flags: NDArray[np.uint8]


class Mean:
    """Sums of the scans of one telegram.

    A beam's mean is that of the scans in which it had an echo within the format. It is dazzled when it has no such scan
    and was dazzled in one; else, without such a scan, it has no echo. Ranges are averaged unrounded and rounded once.
    """

    def __init__(self, points: int, farthest_m: float) -> None:
        self._farthest_m = farthest_m
        self._range_m = np.zeros(points)
        self._intensity = np.zeros(points)
        self._count = np.zeros(points)
        self._dazzled = np.zeros(points, dtype=np.bool_)
        self._saturated = np.zeros(points, dtype=np.bool_)

    def add(self, scan: Measured) -> None:
        """Take one more scan."""
        dazzled = (scan.flags & DAZZLED) != 0
        valid = (scan.range_m <= self._farthest_m) & ~dazzled
        self._range_m += np.where(valid, scan.range_m, 0.0)
        self._intensity += np.where(valid, scan.intensity, 0.0)
        self._count += valid
        self._dazzled |= dazzled
        self._saturated |= (scan.flags & SATURATED) != 0

    def result(self) -> Measured:
        """The mean of what was added."""
        none = self._count == 0
        count = np.where(none, np.nan, self._count)
        flags = np.where(none & self._dazzled, DAZZLED, 0) | np.where(self._saturated, SATURATED, 0)
        return Measured(self._range_m / count, self._intensity / count, flags.astype(np.uint8))


def nearest(scan: Scan) -> Measured:
    """The first echo of each beam, which is all this family reports."""
    if scan.range_m.ndim == 2 and scan.range_m.shape[1]:
        return Measured(scan.range_m[:, 0], scan.intensity[:, 0], scan.flags)
    nothing = np.full(len(scan.plan), np.nan)
    return Measured(nothing, nothing, scan.flags)


@dataclass(frozen=True)
class Format:
    """How values are written: configuration bytes D and E, and what tells reflectance from signal."""

    mode: MeasuringMode
    unit: int
    indices: bool
    k_m2: float
    "Range constant at the present sensitivity."

    @property
    def farthest_m(self) -> float:
        return max_range_m(self.mode, self.unit)

    def wants_intensity(self, output: Output) -> bool:
        """Whether this telegram says anything about the strength of echoes."""
        return output.wants_intensity or self.mode.reflectivity_bits > 0 or self.mode.only_reflectivity


def encode(output: Output, measured: Measured, form: Format, part: int | None) -> bytes:
    """Payload of the telegram up to the values' end: indices and status byte are still to follow."""
    rho = None
    if form.wants_intensity(output):
        rho = reflectance(measured.range_m, measured.intensity, form.k_m2)
    values = value_words(measured.range_m, measured.flags, form.mode, form.unit, rho)
    if output.command == ALL:
        return wire.all_values(values, wire.Header(len(values), form.unit, part))
    if output.command == MEAN:
        return wire.mean_values(output.scans, values, wire.Header(len(values), form.unit))
    if output.command == REFLECTIVITY:
        first, last = output.groups[0]
        assert rho is not None
        strength = reflectivity_bytes(rho, measured.flags)[first - 1 : last]
        return wire.range_and_reflectivity(values, wire.Header(len(values), form.unit), first, last, strength)
    if output.command == INTENSITY:
        assert rho is not None
        strengths = intensity_words(measured.intensity, rho, form.mode)
        return wire.range_and_intensity(
            [
                (a, b, wire.Header(b - a + 1, form.unit), values[a - 1 : b], strengths[a - 1 : b])
                for a, b in output.groups
            ]
        )
    first, last = output.groups[0]
    header = wire.Header(last - first + 1, form.unit)
    if output.command == SUB_RANGE:
        return wire.sub_range(first, last, values[first - 1 : last], header)
    return wire.mean_sub_range(output.scans, first, last, values[first - 1 : last], header)
