"""A sensor of one's own that speaks as a Velodyne: layers and firing pattern of a spec's `device.lasers`.

Belongs here: what such a table may have, and the header in which `GET /packets` has it. Not: the models of the maker
(models).
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from protocols.errors import DeviceSettingError
from protocols.velodyne.models import MODELS, Model

LASERS = (16, 32, 64, 128)
"Numbers that fill the packets of 12 blocks of 32."
CYCLE_US = (5.0, 10_000.0)
UNITS_MM = (1, 2, 4, 5, 8, 10)
KEYS = ("source", "evidence", "elevation_deg", "azimuth_offset_deg", "fire_us", "cycle_us", "unit_mm")
HEADER = b"X-Lasers"


def with_lasers(base: Model, table: Any) -> Model:
    """A model with these lasers that otherwise is `base`; raises `DeviceSettingError` with the key in `device`."""
    if not isinstance(table, Mapping):
        raise _wrong("", table, f"a table of {', '.join(KEYS)}")
    for key in table:
        if key not in KEYS:
            raise _wrong(str(key), table[key], f"one of {', '.join(KEYS)}")
    for key in ("source", "evidence"):
        if not isinstance(table.get(key), str) or not table[key]:
            raise _wrong(key, table.get(key), "a text: where the table is from, and its grade")
    elevation = _numbers(table, "elevation_deg", -90.0, 90.0, None)
    count = len(elevation)
    if count not in LASERS:
        raise _wrong("elevation_deg", f"{count} values", f"{', '.join(map(str, LASERS))}: those that fill its packets")
    offset = _numbers(table, "azimuth_offset_deg", -180.0, 180.0, count) if "azimuth_offset_deg" in table else None
    cycle_us = _number(table, "cycle_us", base.cycle_ns / 1000.0, *CYCLE_US)
    if "fire_us" in table:
        fires = _numbers(table, "fire_us", 0.0, cycle_us, count)
        if max(fires) >= cycle_us:
            raise _wrong("fire_us", max(fires), f"instants before the next firing, {cycle_us:g}")
    else:
        fires = tuple(cycle_us * at / count for at in range(count))
    unit = table.get("unit_mm", base.unit_mm)
    if isinstance(unit, bool) or unit not in UNITS_MM:
        raise _wrong("unit_mm", unit, ", ".join(map(str, UNITS_MM)))
    return replace(
        base,
        elevation_deg=elevation,
        offset_deg=(0.0,) * count if offset is None else offset,
        cycle_ns=round(1000.0 * cycle_us),
        laser_ns=tuple(round(1000.0 * at) for at in fires),
        unit_mm=int(unit),
        stamp_ns=0,
    )


def _wrong(key: str, found: object, allowed: str) -> DeviceSettingError:
    return DeviceSettingError(f"lasers.{key}".rstrip("."), found, allowed)


def _number(table: Mapping[str, Any], key: str, default: float, low: float, high: float) -> float:
    value = table.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise _wrong(key, value, f"{low:g}..{high:g}")
    return float(value)


def _numbers(table: Mapping[str, Any], key: str, low: float, high: float, count: int | None) -> tuple[float, ...]:
    values = table.get(key)
    if not isinstance(values, list | tuple):
        raise _wrong(key, values, "a list of numbers, one for each laser in the order of the channels")
    for value in values:
        good = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
        if not good or not low <= value <= high:
            raise _wrong(key, value, f"numbers of {low:g}..{high:g}")
    if count is not None and len(values) != count:
        raise _wrong(key, f"{len(values)} values", f"{count}, one for each laser")
    return tuple(float(value) for value in values)


def reported(model: Model) -> bytes:
    """A header line of HTTP with the lasers, of a model that is none of the maker's; else nothing."""
    if MODELS.get(model.model) is model:
        return b""
    table = {
        "source": "the device",
        "evidence": "read",
        "elevation_deg": model.elevation_deg,
        "azimuth_offset_deg": model.offset_deg,
        "fire_us": [one / 1000.0 for one in model.laser_ns],
        "cycle_us": model.cycle_ns / 1000.0,
        "unit_mm": model.unit_mm,
    }
    return HEADER + b": " + json.dumps({"model": model.model, "lasers": table}).encode() + b"\r\n"


def read(head: bytes) -> Model | None:
    """The model in a head of HTTP; None: there is none, or nonsense."""
    for line in head.split(b"\r\n"):
        name, _, value = line.partition(b":")
        if name != HEADER:
            continue
        try:
            row = json.loads(value)
            return with_lasers(MODELS[row["model"]], row["lasers"])
        except (ValueError, LookupError, TypeError, DeviceSettingError):
            return None
    return None
