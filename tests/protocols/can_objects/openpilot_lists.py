"""Object lists as two cars' radars send them, for openpilot's parsers: Ford (Delphi MRR) and Toyota.

Only for tests: an ADAS stack that others wrote judges whether objects come through. The layouts are opendbc's own DBC
files, read by cantools. Order, counters and conditions: `opendbc/car/ford/radar_interface.py` and
`opendbc/car/toyota/radar_interface.py` of the installed package.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from importlib.resources import files
from typing import Any

import cantools

from protocols.scan import DetectedObject

RawFrame = tuple[int, bytes]

FORD_SLOTS = 64
FORD_COVERAGE_M = {0: 42, 1: 164, 2: 45, 3: 175}
TOYOTA_SLOTS = 16
TOYOTA_NOTHING_M = 300.0


@cache
def _database(name: str) -> Any:
    text = files("opendbc").joinpath("dbc", name).read_text(encoding="utf-8")
    return cantools.database.load_string(text, database_format="dbc", strict=False)


def _pack(name: str, message: Any, values: dict[str, float]) -> RawFrame:
    found = _database(name).get_message_by_name(message) if isinstance(message, str) else message
    every = {signal.name: 0 for signal in found.signals} | values
    return found.frame_id, bytes(found.encode(every, strict=False))


def ford_cycle(objects: Sequence[DetectedObject], scan_index: int) -> list[RawFrame]:
    """One measurement mode: 64 detections, information, and last the coverage that triggers the parser."""
    frames: list[RawFrame] = []
    mode = scan_index & 3
    for slot in range(1, FORD_SLOTS + 1):
        suffix = f"_{slot:02d}"
        values: dict[str, float] = {f"CAN_SCAN_INDEX_2LSB{suffix}": mode}
        if slot <= len(objects):
            item = objects[slot - 1]
            x, y, _ = item.position_m
            distance, azimuth = math.hypot(x, y), -math.atan2(y, x)
            values |= {
                f"CAN_DET_VALID_LEVEL{suffix}": 1,
                f"CAN_DET_RANGE{suffix}": distance,
                f"CAN_DET_AZIMUTH{suffix}": azimuth,
                f"CAN_DET_RANGE_RATE{suffix}": (x * item.velocity_m_s[0] + y * item.velocity_m_s[1]) / distance,
            }
        frames.append(_pack("FORD_CADS.dbc", f"MRR_Detection_{slot:03d}", values))
    frames.append(_pack("FORD_CADS.dbc", "MRR_Header_InformationDetections", {"CAN_SCAN_INDEX": scan_index & 0xFFFF}))
    frames.append(_pack("FORD_CADS.dbc", "MRR_Header_SensorCoverage", {"CAN_RANGE_COVERAGE": FORD_COVERAGE_M[mode]}))
    return frames


def toyota_cycle(objects: Sequence[DetectedObject], counter: int, new: bool) -> list[RawFrame]:
    """Sixteen tracks A and sixteen tracks B, with their checksums."""
    database = _database("toyota_adas.dbc")
    frames: list[RawFrame] = []
    for first, kind in ((0x210, "a"), (0x220, "b")):
        for slot in range(TOYOTA_SLOTS):
            item = objects[slot] if slot < len(objects) else None
            values: dict[str, float] = {"COUNTER": counter & 0xFF}
            if kind == "a":
                values["LONG_DIST"] = TOYOTA_NOTHING_M if item is None else item.position_m[0]
                if item is not None:
                    values |= {
                        "LAT_DIST": -item.position_m[1],  # right positive
                        "REL_SPEED": item.velocity_m_s[0],
                        "VALID": 1,
                        "NEW_TRACK": int(new),
                    }
            elif item is not None:
                values["SCORE"] = 100
            identifier, data = _pack("toyota_adas.dbc", database.get_message_by_frame_id(first + slot), values)
            # the last eight tracks B have six bytes in opendbc's DBC; the checksum is the last byte of either
            checksum = ((identifier >> 8) + (identifier & 0xFF) + len(data) + sum(data[:-1])) & 0xFF
            frames.append((identifier, data[:-1] + bytes([checksum])))
    return frames
