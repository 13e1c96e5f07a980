"""Generic solid-state sensors, by formula: raster, Risley rosette, MEMS Lissajous. They send Livox's point packets.

Reading order: `patterns` (directions and instants), `codec` (bytes), `settings` (a spec's table), `device`. Only the
stream of points: no discovery, no control, no IMU, so the maker's SDK does not find them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from protocols.livox.device import PatternSession
from protocols.livox.framing import PointFraming
from protocols.livox.patterns import Raster
from protocols.livox.settings import facts_of, read
from protocols.session import CommandRow, DeviceKey, LinkKind, Session
from protocols.skeleton.keys import DeviceKeys
from protocols.wire import Wire


class LivoxFamily:
    """The family as `protocols.family("livox")` gives it."""

    name = "livox"
    tcp_is_line = False
    wire = Wire((LinkKind.STREAM, LinkKind.DATAGRAM), lambda kind: PointFraming(), LinkKind.DATAGRAM)
    "It measures without being asked."

    def new_session(self, device: Mapping[str, Any], facts: Mapping[str, Any]) -> PatternSession:
        """A device that is switched off. Raises `DeviceSettingError`."""
        keys = DeviceKeys(device, {})
        build = read(keys, *facts_of(facts))
        keys.finish()
        return PatternSession(build)

    def check_facts(self, facts: Mapping[str, Any]) -> None:
        """Raise `DeviceSettingError` for a spec's `device` table that is none."""
        facts_of(facts)

    def commands(self) -> tuple[CommandRow, ...]:
        """None of the protocol's is served; the most wanted ones are listed."""
        rows = (("0000", "discovery"), ("0100", "set parameters"), ("0101", "query parameters"), ("0102", "state push"))
        return tuple(CommandRow(code, what, "absent", "Livox-SDK2", "ignored") for code, what in rows)

    def framing(self, session: Session, kind: LinkKind) -> PointFraming:
        """How its packets are changed on their way."""
        return PointFraming()

    def device_keys(self) -> tuple[DeviceKey, ...]:
        """Every key of a scenario's `device:` table."""
        keys = DeviceKeys({}, {})
        read(keys, Raster(*(1, 1, 1), (0.0, 0.0)), 1.0)  # type: ignore[arg-type]
        return tuple(keys.known)


FAMILY = LivoxFamily()
