"""Which telegram of measured values a mode or request sends, how long it is, and how a measured scan fills it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from protocols.lms2xx import telegrams as wire
from protocols.lms2xx.evaluation import Fields, Grid, group_minima, places_m, segment_minima
from protocols.lms2xx.fields import Field, border_m
from protocols.lms2xx.values import (
    COUNTS_PER_METRE,
    DAZZLE,
    TOO_FAR,
    MeasuringMode,
    intensity_words,
    max_range_m,
    reflectance,
    reflectivity_bytes,
    value_words,
)
from protocols.scan import DAZZLED, SATURATED, Floats, Scan

ALL, MEAN, SUB_RANGE, MEAN_SUB_RANGE, REFLECTIVITY, INTENSITY = 0xB0, 0xB6, 0xB7, 0xBF, 0xC4, 0xF5
FIELD_VALUES, CARTESIAN, LEVELS, TAUGHT_END = 0xBE, 0xF6, 0xCA, 0xC6
FIXED_BYTES = {
    ALL: 10,
    MEAN: 11,
    SUB_RANGE: 14,
    MEAN_SUB_RANGE: 15,
    REFLECTIVITY: 16,
    INTENSITY: 10,
    FIELD_VALUES: 14,
    CARTESIAN: 14,
    LEVELS: 11,
    TAUGHT_END: 0,
}
"Telegram without values, groups and indices, by command."
GROUP_BYTES = 6


class Find(Enum):
    """The part of a scan that is sent, as far as the command does not define it."""

    VALUES = "values"
    SEGMENTS = "smallest value of each segment of field A"
    VERTICAL = "smallest distance ahead in each field"
    GROUPS = "smallest value of each sub-range"
    TAUGHT = "taught-in radii"


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
    direct: bool = False
    "A telegram for each turn of the scan: bit 15 of the first beam's word."
    every: int = 1
    "Every n-th value, beginning with the first."
    find: Find = Find.VALUES
    count: int = 0
    "Values of `SEGMENTS` and `VERTICAL`."
    field: Field | None = None
    "Of `SEGMENTS` and `TAUGHT`."
    on_object: bool = False
    "Only scans with an object in a field are sent."

    @property
    def is_kept(self) -> bool:
        """Measured for the device itself: nothing leaves."""
        return self.command == TAUGHT_END

    @property
    def wants_intensity(self) -> bool:
        return self.command in (REFLECTIVITY, INTENSITY)

    def telegram_bytes(self, points: int, indices: bool, part: int | None = None, turns: int = 1) -> int:
        """Length of the whole telegram for a scan of that many points; of a direct one, for that part of so many."""
        if self.command in (LEVELS, TAUGHT_END):
            return FIXED_BYTES[self.command]
        size = FIXED_BYTES[self.command] + 2 * indices
        if self.direct:
            first, last = self.groups[0]
            return size + 2 * len(range(points)[_of_turn(first, last, part or 0, turns)])
        if self.find is Find.GROUPS:
            return size + 2 * len(self.groups)
        if self.count:
            return size + 2 * self.count
        if self.every > 1:
            return size + 2 * -(-points // self.every)
        chosen = sum(last - first + 1 for first, last in self.groups) or points
        if self.command == INTENSITY:
            return size + GROUP_BYTES * len(self.groups) + 4 * chosen
        if self.command == REFLECTIVITY:
            return size + 2 * points + chosen
        if self.command == FIELD_VALUES:
            return size + 8 * chosen
        return size + (4 if self.command == CARTESIAN else 2) * chosen


@dataclass(frozen=True, eq=False)
class Measured:
    """The nearest echoes of one scan, or of the mean of several; arrays (n,)."""

    range_m: Floats
    intensity: Floats
    flags: NDArray[np.uint8]


MOST_INVALID = 0.2
"Share of single values that may be missing from a mean."


class Mean:
    """Sums of the scans of one telegram.

    A beam's mean is that of the scans in which it had an echo within the format. With more than `MOST_INVALID` of the
    scans without one it has none (listing, p. 61); it is dazzled when it never had one and was dazzled once. Ranges are
    averaged unrounded and rounded once.
    """

    def __init__(self, points: int, farthest_m: float) -> None:
        self._farthest_m = farthest_m
        self._range_m = np.zeros(points)
        self._intensity = np.zeros(points)
        self._count = np.zeros(points)
        self._scans = 0
        self._dazzled = np.zeros(points, dtype=np.bool_)
        self._saturated = np.zeros(points, dtype=np.bool_)

    def add(self, scan: Measured) -> None:
        """Take one more scan."""
        dazzled = (scan.flags & DAZZLED) != 0
        valid = (scan.range_m <= self._farthest_m) & ~dazzled
        self._range_m += np.where(valid, scan.range_m, 0.0)
        self._intensity += np.where(valid, scan.intensity, 0.0)
        self._count += valid
        self._scans += 1
        self._dazzled |= dazzled
        self._saturated |= (scan.flags & SATURATED) != 0

    def result(self) -> Measured:
        """The mean of what was added."""
        none = self._count < (1.0 - MOST_INVALID) * self._scans - 1e-9
        count = np.where(none, np.nan, self._count)
        blind = (self._count == 0) & self._dazzled
        flags = np.where(blind, DAZZLED, 0) | np.where(self._saturated, SATURATED, 0)
        return Measured(self._range_m / count, self._intensity / count, flags.astype(np.uint8))


def nearest(scan: Scan) -> Measured:
    """The first echo of each beam, which is all this family reports."""
    if scan.range_m.ndim == 2 and scan.range_m.shape[1]:
        return Measured(scan.range_m[:, 0], scan.intensity[:, 0], scan.flags)
    nothing = np.full(len(scan.plan), np.nan)
    return Measured(nothing, nothing, scan.flags)


@dataclass(frozen=True)
class Format:
    """Format of values: configuration bytes D and E, and the scale from signal to reflectance."""

    mode: MeasuringMode
    unit: int
    indices: bool
    k_m2: float
    "Range constant at the present sensitivity."
    fields: Fields | None = None
    "None: this model has none."
    turns: int = 1
    "Of the mirror, for a complete scan."

    @property
    def farthest_m(self) -> float:
        return max_range_m(self.mode, self.unit)

    def wants_intensity(self, output: Output) -> bool:
        """Whether this telegram has the strength of echoes."""
        return output.wants_intensity or self.mode.reflectivity_bits > 0 or self.mode.only_reflectivity


def encode(output: Output, measured: Measured, form: Format, part: int | None, grid: Grid | None = None) -> bytes:
    """Payload of the telegram up to the values' end: indices and status byte are still to follow.

    `grid`: where the beams lie; None: 180 deg, evenly.
    """
    n = len(measured.range_m)
    grid = grid or (0, 18000 // max(n - 1, 1), n)
    if output.find is not Find.VALUES:
        return _found(output, measured, form, grid)
    if output.command == CARTESIAN:
        return _cartesian(output, measured, form, grid)
    rho = None
    if form.wants_intensity(output):
        rho = reflectance(measured.range_m, measured.intensity, form.k_m2)
    values = value_words(measured.range_m, measured.flags, form.mode, form.unit, rho)
    if output.command in (MEAN, MEAN_SUB_RANGE):
        values &= np.uint16(form.mode.mask)  # flags are 0 (listing, p. 61)
    else:
        _set_fields(values, measured, form, grid)
    if output.command == ALL:
        values = values[:: output.every]
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
    if output.command == FIELD_VALUES:
        assert form.fields is not None
        borders = [border_m(field, *grid) for field in form.fields.of]
        sizes = [np.minimum(np.floor(b * COUNTS_PER_METRE[form.unit] + 0.5), 0xFFFF).astype(np.uint16) for b in borders]
        table = np.column_stack((values, *sizes))[first - 1 : last]
        return wire.field_values(first, last, table.ravel(), form.unit)
    if output.direct:  # of this turn's beams those in the range; the request's own numbers before them
        chosen = values[_of_turn(first, last, part or 0, form.turns)]
        return wire.sub_range(first, last, chosen, wire.Header(len(chosen), form.unit, part))
    header = wire.Header(last - first + 1, form.unit)
    if output.command == SUB_RANGE:
        return wire.sub_range(first, last, values[first - 1 : last], header)
    return wire.mean_sub_range(output.scans, first, last, values[first - 1 : last], header)


def _found(output: Output, measured: Measured, form: Format, grid: Grid) -> bytes:
    """Telegrams of a few distances that were found in the scan, or taught."""
    if output.find is Find.TAUGHT:
        assert output.field is not None
        found = border_m(output.field, *grid)
    elif output.find is Find.SEGMENTS:
        assert output.field is not None
        found = segment_minima(output.field, measured.range_m, grid)
    elif output.find is Find.GROUPS:
        found = group_minima(output.groups, measured.range_m)
    else:
        assert form.fields is not None
        found = form.fields.verticals(measured.range_m, grid)
    values = value_words(found, np.zeros(len(found), np.uint8), form.mode, form.unit)
    header = wire.Header(len(found), form.unit)
    if output.find is Find.GROUPS:
        return wire.sub_range(output.groups[0][0], output.groups[-1][1], values, header)
    return wire.all_values(values, header)


def levels(infringed: tuple[bool, bool, bool] | None) -> bytes:
    """CA: outputs A, B, C, high while the field is free."""
    return bytes((LEVELS, *(int(not found) for found in infringed or (False,) * 3)))


AXIS_BITS, NEGATIVE, Y_DAZZLED, Y_FIELD_B, Y_FIELD_A = 13, 0x8000, 0x2000, 0x4000, 0x8000
"Of the words of F6 (listing 7.45); its flags are in another order than those of measuring mode 00."


def _cartesian(output: Output, measured: Measured, form: Format, grid: Grid) -> bytes:
    first, last = output.groups[0]
    chosen = slice(first - 1, last)
    across, ahead = places_m(measured.range_m, grid, first, last)
    per_metre = COUNTS_PER_METRE[form.unit]
    far = (1 << AXIS_BITS) - 1 - TOO_FAR
    within = measured.range_m[chosen] * per_metre < far - 0.5  # NaN compares false
    x = np.where(within, np.floor(np.abs(across) * per_metre + 0.5), far).astype(np.uint16)
    y = np.where(within, np.floor(np.abs(ahead) * per_metre + 0.5), far).astype(np.uint16)
    x[within & (across < 0) & (x > 0)] |= np.uint16(NEGATIVE)
    dazzled = (measured.flags[chosen] & DAZZLED) != 0
    x[dazzled] = y[dazzled] = (1 << AXIS_BITS) - 1 - DAZZLE
    y[dazzled] |= np.uint16(Y_DAZZLED)
    if form.fields is not None:
        a, b, _ = form.fields.inside(measured.range_m, grid)
        y[a[chosen] & ~dazzled] |= np.uint16(Y_FIELD_A)
        y[b[chosen] & ~dazzled] |= np.uint16(Y_FIELD_B)
    return wire.cartesian(first, last, np.column_stack((x, y)).ravel())


def _set_fields(values: NDArray[np.uint16], measured: Measured, form: Format, grid: Grid) -> None:
    """Mark the values that lie in a field, where the measuring mode has bits for it."""
    if form.fields is None or not form.mode.field_flags:
        return
    for flag, inside in zip(form.mode.field_flags, form.fields.inside(measured.range_m, grid), strict=False):
        if inside.any():
            values[inside & ((measured.flags & DAZZLED) == 0)] |= np.uint16(flag)


def _of_turn(first: int, last: int, part: int, turns: int) -> slice:
    """Places, among the beams of one of a scan's turns, of the scan's beams first..last."""
    turn = part * turns // 4
    return slice(max(0, -(-(first - 1 - turn) // turns)), max(0, (last - 1 - turn) // turns + 1))
