"""What the variables, scans and events of CoLa devices consist of, in the notation of `skeleton.cola_values`.

Belongs here: layouts, the names of arguments and what they may be. Not: which variables there are (commands).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

TIME = "u16 u8 u8 u8 u8 u8 u32"
"Year to second, microseconds."

# ---------------------------------------------------------------- scans

CHANNEL = "s5 f32 f32 p32 u16"
LAYOUT = (
    "u16 u16 u32 u8 u8 u16 u16 u32 u32 u8 u8 u8 u8 i16 u32 u32 [u32 u16] "
    f"[{CHANNEL} u16*] [{CHANNEL} u8*] [f32 f32 f32 f32 f32 f32 u8] [str] [str] [{TIME}] u16"
)
"""Version, device, serial, status, counters of telegrams and scans, times of scan and transmission, inputs, outputs,
layer, frequencies, encoders, channels of 16 and of 8 bit, position [G], name, comment, time, event."""
WIDEST_STEP = 0xFFFF
"A channel has it in 16 bits."


class Header(NamedTuple):
    """The values of `LAYOUT` before the encoders."""

    version: int
    device: int
    serial: int
    status_high: int = 0
    status: int = 0
    telegrams: int = 0
    scans: int = 0
    scan_us: int = 0
    "Times since power-on."
    sent_us: int = 0
    inputs_high: int = 0
    inputs: int = 0
    outputs_high: int = 0
    outputs: int = 0
    layer_cdeg: int = 0
    frequency: int = 0
    "Of scans; 1/100 Hz."
    shots: int = 0
    "Of measurements; 100 Hz."


class Content(NamedTuple):
    """LMDscandatacfg, its twelve arguments."""

    channels: int
    "Bits of the echoes."
    high: int
    remission: int
    "Bit 0: RSSI; bit 1: ANGL1, a table of angle corrections (MRS1000)."
    fine: int
    "RSSI of 16 bit."
    unit: int
    encoder: int
    encoder_high: int
    position: int
    name: int
    comment: int
    time: int
    interval: int

    @property
    def fits(self) -> bool:
        """Whether a device takes these arguments."""
        good = 0 < self.channels < 32 and self.channels & 1 and self.remission < 4 and 1 <= self.interval <= 50_000
        return bool(good) and max(self[1], *self[3:11]) < 2


class Angles(NamedTuple):
    """LFPangleRangeFilter: directions that it leaves, straight ahead being 0. [rad]"""

    on: int
    azimuth_from: float
    azimuth_to: float
    elevation_from: float
    elevation_to: float
    every: int

    @property
    def fits(self) -> bool:
        """Whether a device takes these arguments."""
        rising = self.azimuth_from <= self.azimuth_to and self.elevation_from <= self.elevation_to
        return self.on < 2 and rising and self.every > 0


# ---------------------------------------------------------------- fields

PART = "i32 u16 i32 u32 u32"
"Rectangle: angle and distance of its reference point, rotation, width, length."


class Field(NamedTuple):
    """The record of a field, as devices send it and hosts write it."""

    scale: float
    offset: float
    step: int
    start: int
    kind: int = 2
    number: int = 0
    "0: there is none."
    segmented: Sequence[Any] = ()
    rectangular: Sequence[Any] = ()
    radial: Sequence[Any] = ()
    dynamic: Sequence[Any] = ()
    version: int = 1
    name: str = ""
    end: int = 0

    @property
    def is_set(self) -> bool:
        """Whether there is a field at all."""
        return self.number > 0 and any((self.segmented, self.rectangular, self.radial, self.dynamic))

    @property
    def fits(self) -> bool:
        """Whether a device takes it: at most one part of each kind, corners by rising angles."""
        kinds = self.segmented, self.rectangular, self.radial, self.dynamic
        good = self.scale > 0.0 and self.kind < 4 and not self.radial and max(map(len, kinds)) < 2
        return good and all(one[0] < two[0] for (part,) in self.segmented for one, two in pairwise(part))


RECORD = f"f32 f32 u32 i32 u8 u8 [[u16 u16 u16]] [{PART}] [] [{PART} i16 u32] u16 str u16"
"`Field`."
RESULTS = f"[u16 u8 u32 f32 f32 u32 i32 u8 u16 u16 u16 [{TIME}]]"
"LFErec."
INPUTS = f"u16 u32 u8 u8 u8 u8 [{TIME}]"
"LIDinputstate."


def outputs_layout(count: int) -> str:
    """LIDoutputstate of a device with so many outputs."""
    return "u16 u32 " + "u8 u32 " * count + f"[{TIME}]"
