"""Generic solid-state sensors, by formula: raster, Risley rosette, MEMS Lissajous. They send Livox's point packets.

Reading order: `patterns` (directions and instants), `codec` (bytes), `settings` (a spec's table), `device`. Only the
stream of points: no discovery, no control, no IMU, so the maker's SDK does not find them, but takes the points.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from protocols.livox.device import PatternSession
from protocols.livox.framing import PointFraming
from protocols.livox.settings import SOME, Facts, facts_of, read
from protocols.session import CommandRow, DeviceKey, LinkKind
from protocols.skeleton.family import ModelFamily
from protocols.wire import Wire

ABSENT = (("0000", "discovery"), ("0100", "set parameters"), ("0101", "query parameters"), ("0102", "state push"))
"The most wanted of the protocol's commands, of which none is served."


class PatternFamily(ModelFamily[Facts, PatternSession]):
    """A spec's `device` table has a pattern instead of a model's name."""

    def model_of(self, facts: Mapping[str, Any]) -> Facts:
        """Pattern and brightness of a spec; raises `DeviceSettingError`."""
        return facts_of(facts)

    def device_keys(self) -> tuple[DeviceKey, ...]:
        """Every key of a scenario's `device:` table, whatever the pattern."""
        return self.keys_of_model(SOME)


FAMILY = PatternFamily(
    name="livox",
    models={},
    usual="",
    build=lambda keys, facts: PatternSession(read(keys, *facts)),
    rows=tuple(CommandRow(code, what, "absent", "Livox-SDK2", "ignored") for code, what in ABSENT),
    wire=Wire((LinkKind.STREAM, LinkKind.DATAGRAM), lambda kind: PointFraming(), LinkKind.DATAGRAM),
)
"It measures without being asked."
