"""Keys of a generic solid-state sensor: its pattern in a spec's `device` table, and what a scenario may set.

Belongs here: names, limits, refusals. Not: what a pattern does (patterns).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, TypeAlias

import numpy as np

from protocols.errors import DeviceSettingError
from protocols.livox.patterns import Exact, Lissajous, Pattern, Raster, Rosette, repetition_s, through_wedges
from protocols.skeleton.keys import DeviceKeys

Facts: TypeAlias = tuple[Pattern, float]
"Of a spec: its pattern, and `Build.white_m2`."
FACTS = ("model", "white_m2", "pattern")
_PIXEL = {"points_per_s": 1000.0, "rows": 1, "columns": 1, "field_deg": [0.0, 0.0]}
SOME = {"pattern": {"value": {"raster": _PIXEL}, "source": "none", "evidence": "none"}}
"A `device` table that is one, of a single point."
RATE_HZ = (1000.0, 5e6)
FRAME_S = (Fraction(1, 1000), Fraction(10))
MOST_POINTS = 5_000_000
"Of a frame."
MOST_HZ = 1e6
MOST_FLYBACK_US = 1e6


@dataclass(frozen=True)
class Build:
    """One device."""

    pattern: Pattern
    white_m2: float
    "Signal of a white plate at 1 m over the detection threshold: system constant over threshold of the model's spec."
    boot_ns: int = 2_000_000_000
    slice_packets: int = 0
    "0: those of 5 ms."


def read(keys: DeviceKeys, pattern: Pattern, white_m2: float) -> Build:
    """Of a scenario's `device:` table."""
    boot_s = keys.number("boot_s", "From power-on until points are sent.", 2.0, 0.0, 60.0)
    packets = keys.integer("slice_packets", "Packets that are measured together; 0: those of 5 ms.", 0, 0, 10_000)
    return Build(pattern, white_m2, round(1e9 * boot_s), packets)


def facts_of(facts: Mapping[str, Any]) -> Facts:
    """The pattern of a spec's `device` table, and how bright white is; raises `DeviceSettingError`."""
    for key in facts:
        if key not in FACTS:
            raise DeviceSettingError(str(key), facts[key], f"one of {', '.join(FACTS)}")
    white = {key: value for key, value in facts.items() if key == "white_m2"}
    white_m2 = DeviceKeys({}, white).number("white_m2", "", 2500.0, 1e-3, 1e9)
    fact, kinds = facts.get("pattern"), " | ".join(KINDS)
    if not isinstance(fact, Mapping):
        raise DeviceSettingError("pattern", fact, "a table with value, source and evidence")
    for key in fact:
        if key not in ("value", "source", "evidence"):
            raise DeviceSettingError(f"pattern.{key}", fact[key], "value, source and evidence")
    for key in ("source", "evidence"):
        if not isinstance(fact.get(key), str) or not fact[key]:
            raise DeviceSettingError(f"pattern.{key}", fact.get(key), "a text: where it is from, and its grade")
    value = fact.get("value")
    if not isinstance(value, Mapping) or len(value) != 1 or next(iter(value)) not in KINDS:
        raise DeviceSettingError("pattern.value", value, f"one table, of {kinds}")
    ((kind, table),) = value.items()
    if not isinstance(table, Mapping):
        raise DeviceSettingError(f"pattern.value.{kind}", table, "a table")
    keys = DeviceKeys(table, {}, f"pattern.value.{kind}.")
    rate_hz = exact(keys.number("points_per_s", "", 100_000.0, *RATE_HZ))
    pattern = KINDS[kind](keys, rate_hz)
    keys.finish()
    if not FRAME_S[0] <= pattern.frame_s <= FRAME_S[1]:
        found = f"a frame of {1000 * float(pattern.frame_s):g} ms"
        raise DeviceSettingError(
            f"pattern.value.{kind}", found, "1..10000 ms: frame_ms, or other frequencies or counts"
        )
    if pattern.points > MOST_POINTS:
        raise DeviceSettingError(f"pattern.value.{kind}", f"{pattern.points} points a frame", f"at most {MOST_POINTS}")
    return pattern, white_m2


def exact(number: float) -> Fraction:
    """As it is written in decimals."""
    return Fraction(repr(float(number)))


FIELDS = ((0.0, 360.0), (0.0, 180.0))


def _raster(keys: DeviceKeys, rate_hz: Fraction) -> Raster:
    rows, columns = keys.integer("rows", "", None, 1, 10_000), keys.integer("columns", "", None, 1, 10_000)
    field = keys.numbers("field_deg", "", None, FIELDS)
    flyback, last = (
        exact(keys.number(name, "", 0.0, 0.0, MOST_FLYBACK_US)) / 1_000_000
        for name in ("flyback_us", "frame_flyback_us")
    )
    return Raster(rate_hz, rows, columns, (field[0], field[1]), flyback, last, keys.flag("both_ways", "", False))


def _motions(keys: DeviceKeys) -> tuple[Fraction, Exact, Exact]:
    one, other = (exact(hz) for hz in keys.numbers("hz", "", None, ((-MOST_HZ, MOST_HZ),) * 2))
    if not one or not other:
        raise keys.wrong("hz", [float(one), float(other)], "two frequencies that are not 0")
    start = keys.numbers("phase_deg", "", (0.0, 0.0), ((-360.0, 360.0),) * 2)
    frame_ms = keys.number("frame_ms", "", 0.0, 1.0, 10_000.0)
    frame_s = exact(frame_ms) / 1000 if frame_ms else repetition_s((one, other))
    return frame_s, (one, other), (exact(start[0]), exact(start[1]))


def _lissajous(keys: DeviceKeys, rate_hz: Fraction) -> Lissajous:
    field = keys.numbers("field_deg", "", None, FIELDS)
    return Lissajous(rate_hz, *_motions(keys), (field[0], field[1]))


def _rosette(keys: DeviceKeys, rate_hz: Fraction) -> Rosette:
    index = keys.numbers("index", "", None, ((1.0, 5.0),) * 2)
    wedge = keys.numbers("wedge_deg", "", None, ((0.0, 60.0),) * 2)
    turned = np.radians(np.arange(361.0))  # what light meets depends on the angle between the wedges alone
    made = Rosette(rate_hz, *_motions(keys), (index[0], index[1]), (wedge[0], wedge[1]))
    if np.isnan(through_wedges(made.index, np.radians(wedge), 0.0 * turned, turned)).any():
        raise keys.wrong("wedge_deg", list(wedge), "wedges without total reflection: thinner ones")
    return made


KINDS: Mapping[str, Callable[[DeviceKeys, Fraction], Pattern]] = {
    "raster": _raster,
    "rosette": _rosette,
    "lissajous": _lissajous,
}
