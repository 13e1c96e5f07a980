"""SICK LD-MRS S01 / Ibeo LUX: parameters that a host reads and writes, with their ranges.

Belongs here: index, type, range, default, what a change touches. Not: what the values do (the session).
Source: SICK document 8014493; indices and ranges as in `ldmrs.dbc`'s sources.
"""

from __future__ import annotations

from dataclasses import dataclass

BASE_ID, BITRATE_KBIT, OUTPUT_DISABLE, MAX_OBJECTS = 0x1010, 0x1011, 0x1012, 0x1013
CONTOUR_DENSITY, PRIORITY, OPTIONS, MIN_AGE, MAX_PREDICTION_AGE = 0x1014, 0x1015, 0x1016, 0x1017, 0x1018
START_ANGLE, END_ANGLE, SCAN_FREQUENCY, SYNC_ANGLE, RESOLUTION = 0x1100, 0x1101, 0x1102, 0x1103, 0x1104
TICKS_PER_TURN, RANGE_REDUCTION = 0x1105, 0x1108
MOUNT_X, MOUNT_Y, MOUNT_Z, MOUNT_YAW, MOUNT_PITCH, MOUNT_ROLL = range(0x1200, 0x1206)
VEHICLE_FIRST, VEHICLE_LAST = 0x1206, 0x1209
BEAM_TILT = 0x3302

DISABLE_ERRORS, DISABLE_OBJECTS = 1 << 5, 1 << 6
"Bits of OUTPUT_DISABLE that concern CAN."

RADIAL, LOOK_AHEAD = 0, 1
RELATIVE_VELOCITIES, AXIS_ALIGNED_BOXES = 1 << 0, 1 << 1
"Bits of OPTIONS."

TICKS_PER_DEG = 32
FREQUENCY_UNITS = 256
"SCAN_FREQUENCY is in 1/256 Hz."


@dataclass(frozen=True)
class Parameter:
    """One parameter: which values a set takes, as the number it stands for."""

    name: str
    default: int
    bits: int
    signed: bool = False
    low: int = 0
    high: int | None = None
    choices: tuple[int, ...] = ()
    forbidden: tuple[int, ...] = ()
    writable: bool = True

    def from_wire(self, value: int) -> int | None:
        """Number that a 32-bit wire value stands for, None when it is out of range.

        Senders fill the upper half of a 16-bit parameter with zeros or with the sign: both are taken.
        """
        low_bits = value & ((1 << self.bits) - 1)
        sign_bit = 1 << self.bits - 1
        upper = value >> self.bits
        extended = (1 << 32 - self.bits) - 1
        negative = self.signed and low_bits & sign_bit
        if upper and not (negative and upper == extended):
            return None
        number = low_bits - (sign_bit << 1) if negative else low_bits
        high = self.high if self.high is not None else (sign_bit - 1 if self.signed else (1 << self.bits) - 1)
        allowed = number in self.choices if self.choices else self.low <= number <= high
        return number if allowed and number not in self.forbidden else None

    def to_wire(self, number: int) -> int:
        """32-bit value of a reply: unsigned, upper bits zero."""
        return number & ((1 << self.bits) - 1)


def _signed(name: str, default: int = 0, low: int = -(1 << 15), high: int = (1 << 15) - 1) -> Parameter:
    return Parameter(name, default, 16, signed=True, low=low, high=high)


PARAMETERS: dict[int, Parameter] = {
    BASE_ID: Parameter("base id", 0x500, 32, high=0x7F0),
    BITRATE_KBIT: Parameter("bit rate", 500, 16, choices=(1000, 500, 250, 125)),
    # printed reply to a get: 0x80, everything on
    OUTPUT_DISABLE: Parameter("output disable bits", 0x80, 16, forbidden=(0xFFFF,)),
    MAX_OBJECTS: Parameter("objects on CAN", 65, 16, high=65),
    CONTOUR_DENSITY: Parameter("contour density", 2, 16, high=2),
    PRIORITY: Parameter("priority", RADIAL, 16, high=1),
    OPTIONS: Parameter("velocities and boxes", 0, 16, high=3),
    MIN_AGE: Parameter("minimum age", 0, 16),
    MAX_PREDICTION_AGE: Parameter("maximum prediction age", 0xFFFF, 16),
    START_ANGLE: _signed("start angle", 1600, -1919, 1600),
    END_ANGLE: _signed("end angle", -1920, -1920, 1599),
    SCAN_FREQUENCY: Parameter("scan frequency", 3200, 16, choices=(3200, 6400, 12800)),
    SYNC_ANGLE: Parameter("sync angle", 0, 14, signed=True, low=-5760, high=5759),
    RESOLUTION: Parameter("resolution", 0, 16, high=1),
    TICKS_PER_TURN: Parameter("ticks per turn", 11520, 16, writable=False),
    RANGE_REDUCTION: Parameter("range reduction", 0, 16),
    MOUNT_X: _signed("mounting x"),
    MOUNT_Y: _signed("mounting y"),
    MOUNT_Z: _signed("mounting z"),
    MOUNT_YAW: _signed("mounting yaw"),
    MOUNT_PITCH: _signed("mounting pitch"),
    MOUNT_ROLL: _signed("mounting roll"),
    **{index: Parameter(f"vehicle geometry {index:#x}", 0, 16) for index in range(VEHICLE_FIRST, VEHICLE_LAST + 1)},
    # 1/10000 rad; the type without tilted layers reports 0
    BEAM_TILT: Parameter("beam tilt", 0, 16, writable=False),
}


class ParameterBank:
    """Values in force, and those saved over power-off."""

    def __init__(self, saved: dict[int, int]) -> None:
        self._factory = {index: parameter.default for index, parameter in PARAMETERS.items()} | saved
        self._saved = dict(self._factory)
        self._values = dict(self._saved)

    def __getitem__(self, index: int) -> int:
        return self._values[index]

    def get(self, index: int) -> int | None:
        """Wire value for a reply, None for an unknown index."""
        parameter = PARAMETERS.get(index)
        return None if parameter is None else parameter.to_wire(self._values[index])

    def set(self, index: int, wire_value: int) -> str | None:
        """Take a value; None if accepted, otherwise the reason."""
        parameter = PARAMETERS.get(index)
        if parameter is None:
            return f"unknown parameter {index:#06x}"
        number = parameter.from_wire(wire_value)
        if not parameter.writable:
            return f"{parameter.name} can only be read"
        if number is None:
            return f"{parameter.name}: {wire_value:#x} is out of range"
        if index == START_ANGLE and number <= self._values[END_ANGLE]:
            return f"start angle {number} is not greater than end angle {self._values[END_ANGLE]}"
        if index == END_ANGLE and number >= self._values[START_ANGLE]:
            return f"end angle {number} is not less than start angle {self._values[START_ANGLE]}"
        self._values[index] = number
        return None

    def save(self) -> None:
        """Keep the present values over power-off."""
        self._saved = dict(self._values)

    def restore(self) -> None:
        """Back to the saved values: power-on and reset."""
        self._values = dict(self._saved)

    def factory(self) -> None:
        """Factory settings; the base id and bit rate of this bus stay."""
        kept = {index: self._values[index] for index in (BASE_ID, BITRATE_KBIT)}
        self._values = self._factory | kept
