"""What sets Hesai's models apart on the wire: lasers, firing instants, places in a packet, return modes.

A spec's `device` table is `{model: hesai-xt32}`. Belongs here: one row per model. Not: tables of angles and instants
(tables), optics (the sensor specs), limits of settings that all have (settings).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from protocols.hesai import tables
from protocols.scan import Floats

FIELDS = np.dtype([("distance", "<u2"), ("reflectivity", "u1")])
WITH_FOURTH = np.dtype([*FIELDS.descr, ("fourth", "u1")])
LAST, STRONGEST, DUAL, FIRST, LAST_FIRST, FIRST_STRONGEST, TRIPLE = range(7)
"Return modes as command 1E and the configuration have them."
MODES: Mapping[int, tuple[str, int, tuple[str, ...]]] = {
    LAST: ("last", 0x38, ("last",)),
    STRONGEST: ("strongest", 0x37, ("strongest",)),
    DUAL: ("dual", 0x39, ("last", "strongest")),
    FIRST: ("first", 0x33, ("first",)),
    LAST_FIRST: ("last_first", 0x3B, ("last", "first")),
    FIRST_STRONGEST: ("first_strongest", 0x3C, ("first", "strongest")),
    TRIPLE: ("triple", 0x3D, ("first", "last", "strongest")),
}
"Its name, its byte in a packet, the returns of a firing's blocks."


KINDS = {
    "shutdown": "u1", "mode": "u1", "rpm": "<i2", "utc": "6u1", "us": "<u4", "factory": "u1", "sequence": "<u4",
    "safety": "17u1", "states": "<u2", "operation": "u1", "imu": "22u1",
}  # fmt: skip
"Types of what packets have besides their blocks."


@dataclass(frozen=True, eq=False)
class Layout:
    """Where a model's packets have what; in bytes, little-endian."""

    size: int
    blocks: int
    places: Mapping[str, int]
    "Of what is in `KINDS`, as far as the model has it."
    head: bytes = b""
    "Before the blocks, but for the bytes that change."
    channel: np.dtype[np.void] = WITH_FOURTH
    mark: bytes = b""
    "Before each block."
    fine: bool = False
    "A third byte of the azimuth, 1/256 of 0.01 deg."
    year: int = 1900
    "From which the byte of the year counts; 0: Unix seconds, 5 bytes big-endian."
    first_block: int = 0
    "Byte 8 of the header where a firing has one block; where it has more: 1."
    checks: tuple[tuple[int, int], ...] = ()
    "First and last byte, exclusive, under a CRC that follows."


def _places(
    shutdown: int | None, mode: int, rpm: int, utc: int, us: int, factory: int, sequence: int
) -> dict[str, int]:
    found = {"mode": mode, "rpm": rpm, "utc": utc, "us": us, "factory": factory, "sequence": sequence}
    return found if shutdown is None else found | {"shutdown": shutdown}


def _head(major: int, minor: int, version: int, lasers: int, blocks: int, unit_mm: int, flags: int) -> bytes:
    return bytes((0xEE, 0xFF, major, minor, version, 0, lasers, blocks, 0, unit_mm, 0, flags))


@dataclass(frozen=True, eq=False)
class Model:
    """Facts of one model."""

    model: str
    "Identifier, as the sensor spec is called."
    title: str
    number: int
    "In the inventory."
    layout: Layout
    elevation_deg: tuple[float, ...]
    offset_deg: tuple[float, ...]
    "Azimuth offset of each laser, clockwise."
    period_ns: Fraction
    "From firing to firing."
    laser_ns: tuple[tuple[float, ...], ...]
    "Instant of each laser after the block's, by azimuth state; NaN: it does not fire."
    stamp_ns: float
    "From the packet's time stamp to the instant of its last block, or its first (`stamps_first`)."
    modes: tuple[int, ...]
    unit_mm: int
    white_m2: float
    "Signal of a white plate at 1 m over the detection threshold: system constant over threshold of the model's spec."
    rpm: tuple[int, ...] = (600, 300, 1200)
    "The default first."
    high_ns: tuple[tuple[float, ...], ...] = ()
    "Instants of the lasers in high resolution, whose firings come twice as often; empty: it has none."
    calibrated: str = "csv"
    centre_m: tuple[float, float] = (0.0, 0.0)
    "Where its beams begin, right of the axis and along the head; ranges on the wire are from the axis."
    other_order: str = ""
    "Return mode whose two blocks come in the other order."
    stamps_first: bool = False
    dual_is_first: bool = False
    "Its mode of code 2 is last and first."
    trigger: int = 0
    "Of firings, as delivered: 0 by angle, 1 by time."
    encoder: float = 1.0
    "Degrees of beam for a degree of the encoder."
    temperatures: int = 8
    inventory: int = 120

    @property
    def lasers(self) -> int:
        """How many."""
        return len(self.elevation_deg)

    def returns(self, mode: int) -> tuple[str, int, int]:
        """Of a mode: its name, its byte in a packet, blocks of a firing."""
        name, byte, picks = MODES[LAST_FIRST if self.dual_is_first and mode == DUAL else mode]
        return name, byte, len(picks)

    def picks(self, mode: int) -> tuple[str, ...]:
        """Which returns its blocks are, in their order."""
        name, _, picks = MODES[LAST_FIRST if self.dual_is_first and mode == DUAL else mode]
        return picks[::-1] if name == self.other_order else picks

    def firings(self, mode: int) -> int:
        """Firings of a packet."""
        return self.layout.blocks // self.returns(mode)[2]

    def firing_ns(self, high: bool) -> Fraction:
        """From firing to firing."""
        return self.period_ns / 2 if high else self.period_ns

    @cached_property
    def lead_ns(self) -> int:
        """How long before a block's instant its first laser may fire."""
        return round(max(0.0, -min(map(min, self.laser_ns))))

    @cached_property
    def dtype(self) -> np.dtype[np.void]:
        """A packet as a structure."""
        one = self.layout
        block: list[Any] = [("mark", f"V{len(one.mark)}")] if one.mark else []
        block += [("azimuth", "<u2"), *([("fine", "u1")] if one.fine else ()), ("channels", one.channel, self.lasers)]
        fields: dict[str, tuple[Any, int]] = {"head": (f"V{len(one.head)}", 0)} if one.head else {}
        fields["blocks"] = (np.dtype(block), one.blocks), len(one.head)
        fields |= {name: (KINDS[name], at) for name, at in one.places.items()}
        kinds, offsets = zip(*fields.values(), strict=True)
        return np.dtype({"names": list(fields), "formats": list(kinds), "offsets": list(offsets), "itemsize": one.size})

    def states(self, number: NDArray[np.int64], high: bool) -> NDArray[np.int64]:
        """Azimuth state of firings by their numbers: it alternates."""
        return number % len(self.high_ns if high else self.laser_ns)

    def instants(self, high: bool) -> Floats:
        """(states, lasers) after the block's, NaN: does not fire. [ns]"""
        return np.array(self.high_ns if high else self.laser_ns)


def _states(*rows: tuple[int, ...]) -> tuple[tuple[float, ...], ...]:
    """0: does not fire."""
    return tuple(tuple(one or float("nan") for one in row) for row in rows)


def _later(row: tuple[int, ...]) -> tuple[float, ...]:
    late = (18867, 12578, 20520, 16549, 14231, 22838)
    return tuple(one + 2144.0 * (one in late) for one in row)


def _dithered(fires: tuple[int, ...]) -> tuple[float, ...]:
    """OT128 in high resolution: of eight outer lasers four fire, at the instants of the 3rd, 4th, 7th and 8th."""
    row = [float(one) for one in tables.OT_STANDARD_0]
    for at in (*range(24), *range(88, 128)):
        row[at] = (18867.0, 6289.0, 12578.0, 0.0)[fires.index(at % 8)] if at % 8 in fires else float("nan")
    return tuple(row)


_N = np.arange(64)
_XT32 = Layout(1080, 8, _places(1061, 1062, 1063, 1065, 1071, 1075, 1076), _head(6, 1, 0, 32, 8, 4, 1), first_block=1)
_M2X = Layout(820, 6, _places(801, 802, 803, 805, 811, 815, 816), _head(6, 1, 0, 32, 6, 5, 1), first_block=1)
_128 = _places(None, 817, 818, 820, 826, 830, 831) | {"safety": 788, "states": 814, "operation": 816, "imu": 835}
_E3X, _OT = (
    Layout(861, 2, _128, _head(1, 4, version, 128, 2, 4, 7), FIELDS, checks=((12, 784), (789, 801), (805, 857)))
    for version in (0x01, 0x81)
)
_AT = Layout(
    1118, 2, _places(1052, 1070, 1064, 1072, 1066, 1071, 1078), _head(4, 3, 0, 128, 2, 4, 9), fine=True, year=0,
    checks=((12, 1042), (1046, 1082)),
)  # fmt: skip
_P40 = Layout(1266, 10, _places(1245, 1254, 1248, 1256, 1250, 1255, 1262), b"", FIELDS, b"\xff\xee", year=2000)
_QT = Layout(1072, 4, _places(1050, 1060, 1054, 1062, 1056, 1061, 1068), _head(3, 1, 0, 64, 4, 4, 1))
_ALL = (LAST, STRONGEST, DUAL, FIRST, LAST_FIRST, FIRST_STRONGEST)
_MOST = (LAST, STRONGEST, DUAL)
_AT_AZIMUTH = tuple((-2.40, 0.65)[c % 2] if c // 16 % 2 == 0 else (2.40, -0.65)[c % 2] for c in range(128))

MODELS: Mapping[str, Model] = {
    one.model: one
    for one in (
        Model(
            "hesai-xt32", "PandarXT-32", 25, _XT32, tuple(16.0 - n for n in range(1, 33)), (0.0,) * 32,
            Fraction(50_000), (tuple((368.0 + 1512.0 * _N[:32]).tolist()),), 5632.0, _ALL, 4, 64_000.0,
            centre_m=(-0.013, 0.0315), other_order="dual",
        ),
        Model(
            "hesai-xt32m2x", "PandarXT-32M2X", 38, _M2X, tables.M2X_ELEVATION, (0.155,) * 32,
            Fraction(50_000), (tuple((368.0 + 2888.0 * (_N[:32] % 16)).tolist()),), 5632.0, (*_ALL, TRIPLE), 5,
            64_000.0, centre_m=(-0.013, 0.0305), other_order="dual",
        ),
        Model(
            "hesai-pandar128e3x", "Pandar128E3X", 40, _E3X, tables.E3X_ELEVATION, tables.E3X_OFFSET,
            Fraction(500_000, 9), _states(tables.E3X_STANDARD_0, tables.E3X_STANDARD_1), 3148.0, _ALL, 4, 400_000.0,
            high_ns=_states(tables.E3X_HIGH_0, tables.E3X_HIGH_1), centre_m=(-0.012, 0.04356),
        ),
        Model(
            "hesai-ot128", "OT128", 42, _OT, tables.OT_ELEVATION, tables.OT_OFFSET, Fraction(500_000, 9),
            (tuple(map(float, tables.OT_STANDARD_0)), _later(tables.OT_STANDARD_0)), 0.0, _ALL, 4, 400_000.0,
            high_ns=(_dithered((2, 3, 6, 7)), _dithered((0, 1, 4, 5))), centre_m=(-0.01, 0.045), inventory=162,
        ),
        Model(
            "hesai-at128", "AT128", 48, _AT, tuple(12.88 - 0.1992 * c for c in range(128)), _AT_AZIMUTH,
            Fraction(125_000, 3), (tuple(map(float, tables.AT_NS)),), -50_915.0, _MOST, 4, 400_000.0, (200,),
            calibrated="at128", encoder=2.0, temperatures=9, inventory=184,
        ),
        Model(
            "hesai-pandar40p", "Pandar40P", 0, _P40, tables.P40_ELEVATION,
            (-1.042,) * 6 + (3.125, -5.208, -1.042) * 7 + (3.125, -5.208) + (-1.042,) * 11, Fraction(500_000, 9),
            (tuple(1000.0 * one for one in tables.P40_US),), -28_580.0, _MOST, 4, 400_000.0,
            centre_m=(-0.012, 0.03873), trigger=1,
        ),
        Model(
            "hesai-qt64", "PandarQT", 15, _QT, tables.QT_ELEVATION, tables.QT_OFFSET, Fraction(500_000, 3),
            (tuple(1000.0 * one for one in tables.QT_US),), 25_710.0, (LAST, FIRST, DUAL), 4, 4_000.0,
            centre_m=(-0.0072, 0.0298), other_order="last_first", stamps_first=True, dual_is_first=True,
        ),
    )
}  # fmt: skip
