"""Monitoring fields: their shapes, how commands 40 and C5 write them, and where their border lies on each beam.

Belongs here: geometry and layout of one field. Not: who reads and writes it (`field_commands`), what is measured
against it (`evaluation`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from protocols.lms2xx.telegrams import word, words
from protocols.lms2xx.values import COUNTS_PER_METRE
from protocols.scan import Floats

RECTANGLE, RADIAL, SEGMENTED, TAUGHT = 0, 1, 2, 3
NAMES = "ABC"
TYPES_A_FIELD = 6
"Types of C5: 00.. for field A, 06.. for B, 0C.. for C (listing 7.25)."
MILLIMETRES = 0x40
"Bit of the byte that names a field."
SEGMENTS = {180: (9, 10, 15, 18, 30, 45, 90, 180, 0xFE), 100: (5, 10, 50, 100, 0xFF)}
"Numbers of segments by angle; FE stands for 360, FF for 400 (listing 7.21)."
MANY = {0xFE: 360, 0xFF: 400}
GRIDS = ((180, 50), (180, 100), (100, 25), (100, 50), (100, 100))
"Angle in degrees, step in hundredths."


@dataclass(frozen=True)
class Field:
    """One field of one set."""

    shape: int
    unit: int
    "0 cm, 1 mm."
    angle_deg: int
    step_cdeg: int
    sizes: tuple[int, ...]
    "Left, right, depth; or the radius; or the radii of corners or beams, from the right. In `unit`."

    @property
    def metres(self) -> tuple[float, ...]:
        return tuple(size / COUNTS_PER_METRE[self.unit] for size in self.sizes)

    @property
    def is_active(self) -> bool:
        """A field without extent watches nothing."""
        return any(self.sizes)

    @property
    def segments(self) -> int:
        """Segments with a separate smallest value: those of a segmented field, otherwise the whole field."""
        return len(self.sizes) - 1 if self.shape == SEGMENTED else 1

    def edges_deg(self) -> tuple[float, ...]:
        """Wire angles between which the segments lie."""
        first = 90.0 - self.angle_deg / 2
        return tuple(first + self.angle_deg * place / self.segments for place in range(self.segments + 1))

    def encode(self, number: int, place: int) -> bytes:
        """Data of C5 from the set's number to the last size; `place`: 0 A, 1 B, 2 C."""
        kind = TYPES_A_FIELD * place + self.shape | (MILLIMETRES if self.unit else 0)
        head = bytes((number,)) + word(kind) + word(self.angle_deg) + word(self.step_cdeg) + b"\0"
        count = b"" if self.shape != SEGMENTED else bytes((_count_byte(self.segments),))
        return head + count + b"".join(word(size) for size in self.sizes)


FACTORY = Field(SEGMENTED, 1, 180, 50, (50,) * 11)
"Listing, p. 124: both sets, A, B and C."

FieldSet = tuple[Field, Field, Field]


def _count_byte(segments: int) -> int:
    return next((code for code, count in MANY.items() if count == segments), segments)


class FieldFault(ValueError):
    """Data of command 40 that are not a field; the message has the reason."""


class SegmentFault(FieldFault):
    """A number of segments that the listing does not have: answered with 92 (p. 23)."""


def grid_of(data: bytes) -> tuple[int, int]:
    """Angle and step of four bytes; `FieldFault` for those that no field has."""
    angle_deg, step_cdeg = words(data)
    if (angle_deg, step_cdeg) not in GRIDS:
        raise FieldFault(f"field of {angle_deg} deg at {step_cdeg}/100 deg")
    return angle_deg, step_cdeg


def place_of(data: bytes) -> tuple[int, int, int]:
    """Set (1, 2), field (0..2) and unit of the first two bytes; `FieldFault` for others."""
    number, name = data[0], data[1] & ~MILLIMETRES
    if number not in (1, 2) or name > 2:
        raise FieldFault(f"field {data[1]:02X} of set {number}")
    return number, name, int(bool(data[1] & MILLIMETRES))


def decode(data: bytes) -> tuple[int, int, Field]:
    """Set, field and shape of the data of command 40. Raises `FieldFault`.

    Six reserved bytes, as the listing's table has them, are taken besides the one of its example.
    """
    if len(data) < 9:
        raise FieldFault(f"{len(data)} bytes")
    number, place, unit = place_of(data)
    angle_deg, step_cdeg = grid_of(data[2:6])
    shape = data[6]
    if shape not in (RECTANGLE, RADIAL, SEGMENTED):
        raise FieldFault(f"shape {shape:02X}")
    for reserved in (1, 6):
        rest = data[7 + reserved :]
        if shape == SEGMENTED and rest:
            allowed = SEGMENTS[angle_deg]
            count, rest = MANY.get(rest[0], rest[0]), rest[1:]
            if len(rest) == 2 * (count + 1) and data[8 if reserved == 1 else 13] in allowed:
                return number, place, Field(shape, unit, angle_deg, step_cdeg, words(rest))
        elif shape != SEGMENTED and len(rest) == (6 if shape == RECTANGLE else 2):
            return number, place, Field(shape, unit, angle_deg, step_cdeg, words(rest))
    if shape == SEGMENTED and data[8] not in SEGMENTS[angle_deg]:
        raise SegmentFault(f"{data[8]} segments over {angle_deg} deg")
    raise FieldFault(f"shape {shape} in {len(data)} bytes")


@lru_cache(maxsize=64)
def border_m(field: Field, first_cdeg: int, step_cdeg: int, count: int) -> Floats:
    """Where a field ends on each of `count` beams from wire angle `first_cdeg` on, (count,), in metres; 0 outside."""
    angle = np.radians((first_cdeg + step_cdeg * np.arange(count)) / 100.0)
    border = np.zeros(count)
    if field.shape == RADIAL:
        border[:] = field.metres[0]
    elif field.shape == RECTANGLE:
        left, right, depth = field.metres
        across, ahead = np.cos(angle), np.sin(angle)
        with np.errstate(divide="ignore", invalid="ignore"):
            side = np.where(across > 1e-12, right / across, np.where(across < -1e-12, -left / across, math.inf))
            border = np.minimum(side, np.where(ahead > 1e-12, depth / ahead, math.inf))
    else:
        border = _between_corners(field, angle)
    half = math.radians(field.angle_deg / 2) + 1e-9
    border = np.where(np.abs(angle - math.pi / 2) <= half, border, 0.0)
    border.setflags(write=False)
    return border


def _between_corners(field: Field, angle: Floats) -> Floats:
    """Straight lines between corners that lie evenly over the field's angle, the first on the right."""
    radii = np.array(field.metres)
    width = math.radians(field.angle_deg) / (len(radii) - 1)
    along = np.clip((angle - math.radians(90.0 - field.angle_deg / 2)) / width, 0.0, len(radii) - 1)
    corner = np.minimum(np.floor(along + 1e-9).astype(np.int64), len(radii) - 2)
    before, behind = radii[corner], radii[corner + 1]
    part = (along - corner) * width
    # a ray at `part` of the triangle with sides `before` and `behind` and the angle `width` between them
    weight = before * np.sin(part) + behind * np.sin(width - part)
    border: Floats = np.where(
        weight > 0.0, before * behind * math.sin(width) / np.where(weight > 0.0, weight, 1.0), 0.0
    )
    return border


def with_field(sets: tuple[FieldSet, FieldSet], number: int, place: int, field: Field) -> tuple[FieldSet, FieldSet]:
    """Both sets with one field replaced."""
    fields = list(sets[number - 1])
    fields[place] = field
    changed: FieldSet = (fields[0], fields[1], fields[2])
    return (changed, sets[1]) if number == 1 else (sets[0], changed)


@dataclass(frozen=True, eq=False)
class Teaching:
    """A field that is being taught: the nearest that each of its beams has seen."""

    number: int
    place: int
    blank: Field
    "Unit, angle and step of the field to come; no radii yet."
    difference_m: float
    nearest_m: Floats | None = None
    "(angle / step + 1,); None before the first scan."

    def with_scan(self, angle_cdeg: Floats, range_m: Floats, farthest_m: float) -> Teaching:
        """After one more scan; each of the field's beams takes the measured beam that is nearest to it."""
        count = 100 * self.blank.angle_deg // self.blank.step_cdeg + 1
        own = 9000 - 50 * self.blank.angle_deg + self.blank.step_cdeg * np.arange(count)
        place = np.clip(np.searchsorted(angle_cdeg, own), 1, len(angle_cdeg) - 1) if len(angle_cdeg) > 1 else own * 0
        if len(angle_cdeg) > 1:
            place = place - (own - angle_cdeg[place - 1] < angle_cdeg[place] - own)
        seen = np.nan_to_num(np.minimum(range_m[place], farthest_m), nan=farthest_m)
        near = seen if self.nearest_m is None else np.minimum(self.nearest_m, seen)
        return replace(self, nearest_m=near)

    def result(self) -> Field | None:
        """The taught field: what was seen less the difference; None before the first scan."""
        if self.nearest_m is None:
            return None
        per_metre = COUNTS_PER_METRE[self.blank.unit]
        radii = np.clip(np.floor((self.nearest_m - self.difference_m) * per_metre + 0.5), 0, 0xFFFF)
        return replace(self.blank, shape=TAUGHT, sizes=tuple(radii.astype(int).tolist()))
