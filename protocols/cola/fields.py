"""Field evaluation: fields as hosts write them, whether something stands in them, and what is reported of it.

Belongs here: geometry of fields and the records on the wire. Not: who has subscribed (session).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from protocols.cola.scandata import TIME
from protocols.scan import Floats

PART = "i32 u16 i32 u32 u32"
RECORD = f"f32 f32 u32 i32 u8 u8 [[u16 u16 u16]] [{PART}] [] [{PART} i16 u32] u16 str u16"
"""Scale, offset, step, start, type, number, segmented, rectangular, radial, dynamic part, version, name, end."""
RESULTS = f"[u16 u8 u32 f32 f32 u32 i32 u8 u16 u16 u16 [{TIME}]]"
"LFErec."
INPUTS = f"u16 u32 u8 u8 u8 u8 [{TIME}]"
"LIDinputstate."

INVALID, FREE, INFRINGED = 0, 1, 2
SET = 3
"Fields that are evaluated at a time: those of the active set."
SAMPLES = 2
"Scans in a row that must agree before a result changes; the tool's own default, from memory."
WHOLE = 0xFFFF
"Start distance of a segment that begins at the device, as recorded."
NUMBER, VERSION, NAME = 5, 10, 11


def empty(scale: float, step: int, start: int) -> list[Any]:
    """The record of a field that is not configured, as devices send it."""
    return [scale, 0.0, step, start, 2, 0, [], [], [], [], 1, "", 0]


def outputs_layout(count: int) -> str:
    """LIDoutputstate of a device with so many outputs."""
    return "u16 u32 " + "u8 u32 " * count + f"[{TIME}]"


def is_set(record: Sequence[Any]) -> bool:
    """Whether there is a field at all."""
    return record[NUMBER] > 0 and any(record[6:10])


def contains(record: Sequence[Any], azimuth_deg: Floats, range_m: Floats) -> np.ndarray:
    """Which points, (n,) and (n,) or (n, k), lie in a field; directions in the device's own frame, 0 to the right."""
    scale, offset, step, start = record[:4]
    azimuth_deg = azimuth_deg.reshape(-1, *(1,) * (range_m.ndim - 1))
    range_mm = 1000.0 * range_m
    inside = np.zeros(range_m.shape, bool)
    for (points,) in record[6]:
        if points:
            index, near, far = np.array(points, np.float64).T
            near = np.where(near == WHOLE, 0.0, near * scale + offset)
            corners = (start + index * step) / 1e4
            within = (azimuth_deg >= corners[0]) & (azimuth_deg <= corners[-1])
            low, high = np.interp(azimuth_deg, corners, near), np.interp(azimuth_deg, corners, far * scale + offset)
            inside |= within & (range_mm >= low) & (range_mm <= high)
    for at, distance, rotation, width, length, *_ in [*record[7], *record[9]]:
        # the reference point is taken as the middle of the rectangle; no source says which point it is
        turned, away = np.radians(azimuth_deg), distance * scale + offset
        x = range_mm * np.cos(turned) - away * np.cos(np.radians(at / 1e4))
        y = range_mm * np.sin(turned) - away * np.sin(np.radians(at / 1e4))
        cos, sin = np.cos(np.radians(rotation / 1e4)), np.sin(np.radians(rotation / 1e4))
        inside |= (np.abs(x * cos + y * sin) <= width / 2) & (np.abs(y * cos - x * sin) <= length / 2)
    return inside


@dataclass
class Watch:
    """One evaluated field: its result, and for how many scans another one has been seen."""

    result: int = INVALID
    against: int = 0
    changes: int = 0

    def see(self, result: int) -> bool:
        """Take the result of one scan; whether the result has changed."""
        self.against = 0 if result == self.result else self.against + 1
        if self.against < (1 if self.result == INVALID else SAMPLES):
            return False
        self.result, self.against = result, 0
        self.changes += 1
        return True
