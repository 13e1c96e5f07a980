"""Leddar modules: what hosts set and read back (holding data) and what they only read (input data), as tables of facts.

Belongs here: where each number stands in the six data bytes of a frame, its limits, its default. Not: what a number
does (the sessions), and the module's memory (leddar_memory).
Source: LeddarTech user guide 54A0028 (tables 54 to 64) for the Vu8; `LtComVuCanbus.h`, `LtComM16Canbus.h`,
`LdSensorVu8Can.cpp` and `LdSensorM16Can.cpp` of leddartech/LeddarSDK for both. Defaults: no source prints them; ours.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

DATA_BYTES = 6
"Of a frame: byte 0 is the request, byte 1 what is asked for."
KBIT = (1000, 500, 250, 125, 100, 50, 20, 10)
"Bit rate by its code in CAN port configuration 1."
UNITS_PER_M = (1, 10, 100, 1000)
VU8_POWERS = (6, 28, 53, 81, 100)
M16_POWERS = (10, 20, 35, 50, 65, 80, 90, 100)
THRESHOLD_SCALE = {"vu8": 64, "m16": 1 << 19}
"Detection threshold: raw value of one count."


@dataclass(frozen=True)
class Item:
    """One number of a group: little-endian, `offset` counted from byte 2 of the frame."""

    name: str
    offset: int
    size: int
    default: int = 0
    low: int = 0
    high: int | None = None
    signed: bool = False
    choices: tuple[int, ...] = ()
    nearest: bool = False
    "A value up to the largest choice becomes the closest choice (user guide, light source power)."

    @property
    def top(self) -> int:
        """Largest value that is taken."""
        return self.high if self.high is not None else (1 << 8 * self.size - self.signed) - 1

    def taken(self, number: int) -> int | None:
        """What the module makes of a number; None: it is refused."""
        if self.nearest:
            if not 0 <= number <= max(self.choices):
                return None
            return min(self.choices, key=lambda choice: (abs(choice - number), choice))
        if self.choices:
            return number if number in self.choices else None
        return number if self.low <= number <= self.top else None

    def read(self, data: bytes) -> int:
        """The number in six data bytes."""
        return int.from_bytes(data[self.offset : self.offset + self.size], "little", signed=self.signed)


@dataclass(frozen=True)
class Group:
    """What one code of get and set holding data stands for."""

    name: str
    items: tuple[Item, ...]
    note: str = ""


TX_ID, RX_ID = 0x750, 0x740
PORT_NOTE = "holds from the next start on, as the SDK goes on to talk on the old identifiers"


def _port(first: int, options: bool) -> dict[int, Group]:
    """CAN port configurations 1 to 3; the M16 has its operation mode in the third."""
    mode = (Item("port_options", 0, 1, 0, high=0x0F),) if options else ()
    return {
        first: Group(
            "CAN port configuration 1",
            (
                Item("baud_code", 0, 1, 0, high=len(KBIT) - 1),
                Item("extended", 1, 1, 0, high=1),
                Item("tx_id", 2, 4, TX_ID, high=0x1FFFFFFF),
            ),
            PORT_NOTE + "; the bus has the link's bit rate",
        ),
        first + 1: Group("CAN port configuration 2", (Item("rx_id", 2, 4, RX_ID, high=0x1FFFFFFF),), PORT_NOTE),
        first + 2: Group(
            "CAN port configuration 3",
            (
                *mode,
                Item("max_detections", 1, 1, 96, low=1, high=96),
                Item("message_delay_ms", 2, 2),
                Item("cycle_delay_ms", 4, 2),
            ),
            "detections of a list, pause between its messages, least pause between lists",
        ),
    }


VU8_SEGMENTS, M16_SEGMENTS = 8, 16

VU8_HOLDING: dict[int, Group] = {
    0: Group(
        "acquisition configuration",
        (
            Item("accumulation_exp", 0, 1, 5, high=10),
            Item("oversampling_exp", 1, 1, 1, high=5),
            Item("base_points", 2, 1, 32, low=2, high=128),
        ),
        "the first two change the rate of measurement; base points are kept",
    ),
    1: Group(
        "smoothing and detection threshold",
        (
            Item("smoothing", 0, 1, 0, low=-16, high=16, signed=True),
            Item("threshold", 2, 4, 0, low=-5 * 64, high=100 * 64, signed=True),
        ),
        "weaker detections are left out; smoothing is kept",
    ),
    2: Group(
        "light source power management",
        (
            Item("light_power", 0, 1, 100, choices=VU8_POWERS, nearest=True),
            Item("auto_echoes", 1, 1, 1, high=8),
            Item("auto_frames", 2, 2, 1, low=1, high=8192),
        ),
        "the closest of 6, 28, 53, 81, 100 %; ignored while the power is automatic",
    ),
    3: Group(
        "distance resolution and acquisition options",
        (Item("units_per_m", 0, 2, 100, choices=UNITS_PER_M), Item("acquisition_options", 2, 2, 0x09, high=0x1FF)),
        "of the options automatic power acts",
    ),
    **_port(4, False),
    # "enable on 0" (LdSensorVu8Can.cpp); the guide says "bit-field of the enabled segments".
    # One bit more than segments: the reference segment.
    8: Group(
        "segments enabled",
        (Item("segments_off", 2, 4, 0, high=(1 << VU8_SEGMENTS + 1) - 1),),
        "a set bit switches off, as the SDK has it",
    ),
}

M16_HOLDING: dict[int, Group] = {
    0: Group(
        "acquisition configuration",
        (
            Item("accumulation_exp", 0, 1, 7, high=12),
            Item("oversampling_exp", 1, 1, 3, high=3),
            Item("base_points", 2, 1, 32, low=2, high=128),
        ),
        "M16 only; 12800 / 2^n measurements a second, n from 7 to 13",
    ),
    1: Group("refresh rate", (Item("refresh_code", 0, 1, 10, low=8, high=13),), "IS16 only; 12800 / 2^n a second"),
    2: Group(
        "detection threshold",
        (Item("threshold", 2, 4, 0, low=-5 * (1 << 19), high=100 * (1 << 19), signed=True),),
        "weaker detections are left out",
    ),
    3: Group(
        "light source power",
        (Item("light_power", 0, 1, 100, choices=M16_POWERS, nearest=True),),
        "the closest of eight; ignored while the power is automatic",
    ),
    4: Group("acquisition options", (Item("acquisition_options", 0, 2, 1),), "of the options automatic power acts"),
    5: Group("automatic power delay", (Item("auto_frames", 0, 2, 1, low=1, high=8192),), "kept"),
    6: Group("smoothing", (Item("smoothing", 0, 1, 0, low=-17, high=16, signed=True),), "-17 is off; kept"),
    7: Group("distance units", (Item("units_per_m", 0, 2, 100, choices=UNITS_PER_M),)),
    8: Group("segments enabled", (Item("segments_on", 0, 2, 0xFFFF),), "a set bit enables the segment"),
    **_port(9, True),
    14: Group("segment pairs enabled", (Item("segments_off", 0, 2, 0),), "a set bit switches its pair off"),
}


class Holding:
    """Values of a module, kept over power-off: no request saves them."""

    def __init__(self, groups: Mapping[int, Group], factory: Mapping[str, int]) -> None:
        self.groups = dict(groups)
        self.items = {item.name: item for group in groups.values() for item in group.items}
        self._factory = {name: item.default for name, item in self.items.items()}
        self._factory |= {name: number for name, number in factory.items() if name in self.items}
        self.values = dict(self._factory)

    def __getitem__(self, name: str) -> int:
        return self.values[name]

    def reset(self) -> None:
        """Default configuration."""
        self.values = dict(self._factory)

    def get(self, code: int) -> bytes | None:
        """Six data bytes of an answer; None: the code stands for nothing."""
        group = self.groups.get(code)
        if group is None:
            return None
        data = bytearray(DATA_BYTES)
        for item in group.items:
            data[item.offset : item.offset + item.size] = self.values[item.name].to_bytes(
                item.size, "little", signed=item.signed
            )
        return bytes(data)

    def asked(self, code: int, data: bytes) -> dict[str, int] | str:
        """Values that six data bytes ask for, all or none; a text says why they are refused."""
        group = self.groups.get(code)
        if group is None:
            return f"no holding data {code}"
        return self.checked({item.name: item.read(data) for item in group.items})

    def checked(self, numbers: Mapping[str, int]) -> dict[str, int] | str:
        """The values that a module makes of numbers; a text names the first that it refuses."""
        found = {}
        for name, number in numbers.items():
            item = self.items[name]
            taken = item.taken(number)
            if taken is None:
                allowed = ", ".join(map(str, item.choices)) if item.choices and not item.nearest else ""
                want = allowed or f"{0 if item.nearest else item.low} to {max(item.choices, default=item.top)}"
                return f"{name} {number}; want {want}"
            found[name] = taken
        return found


VU8_INPUT: dict[int, tuple[int, str]] = {
    0: (1, "number of segments"),
    1: (1, "device identification and options"),
    2: (2, "firmware version"),
    4: (2, "bootloader version"),
    6: (1, "FPGA version and run status"),
    7: (6, "serial number"),
    13: (6, "device name"),
    19: (6, "hardware part number"),
    25: (6, "software part number"),
}
"First code -> how many codes of six bytes, what they hold (user guide, tables 56 and 64)."

M16_INPUT: dict[int, tuple[int, str]] = {
    0: (1, "temperature"),
    1: (1, "device identification and options"),
    2: (1, "firmware version"),
    3: (1, "FPGA version and run status"),
    4: (6, "serial number"),
    10: (11, "device name"),
    21: (3, "software part number"),
    24: (3, "hardware part number"),
}
"The same of the M16 (`LtComM16Canbus.h`)."


def input_frames(table: Mapping[int, tuple[int, str]], contents: Mapping[str, bytes]) -> dict[int, bytes]:
    """Six data bytes by code; what is shorter is filled with zeros."""
    found = {}
    for first, (codes, name) in table.items():
        whole = contents[name].ljust(DATA_BYTES * codes, b"\0")
        for k in range(codes):
            found[first + k] = whole[DATA_BYTES * k : DATA_BYTES * (k + 1)]
    return found
