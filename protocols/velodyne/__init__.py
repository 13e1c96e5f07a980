"""Velodyne's rotating lidars: VLP-16, Puck Hi-Res, HDL-32E, VLP-32C, VLS-128.

Reading order: `codec` (bytes), `tables`, `models` (facts of each), `motor` (angles over time), `device` (slices and
packets), `session` (web interface). `settings.read` has the keys of a scenario's `device:` table.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from protocols.session import CommandRow, DeviceKey, LinkKind, Session
from protocols.skeleton.keys import DeviceKeys
from protocols.skeleton.requests import coverage
from protocols.velodyne.framing import VelodyneFraming
from protocols.velodyne.own import model_of
from protocols.velodyne.session import COMMANDS, VelodyneSession
from protocols.velodyne.settings import read
from protocols.wire import Wire


class VelodyneFamily:
    """The family as `protocols.family("velodyne")` gives it."""

    name = "velodyne"
    tcp_is_line = False
    wire = Wire(
        (LinkKind.STREAM, LinkKind.DATAGRAM),
        lambda kind: VelodyneFraming(),
        LinkKind.STREAM,
        (b"GET /packets HTTP/1.1\r\n\r\n",),
        impaired=("no pps",),
    )

    def new_session(self, device: Mapping[str, Any], facts: Mapping[str, Any]) -> VelodyneSession:
        """A device that is switched off. Raises `DeviceSettingError`."""
        keys = DeviceKeys(device, {})
        settings, build = read(keys)
        keys.finish()
        return VelodyneSession(model_of(facts), settings, build)

    def check_facts(self, facts: Mapping[str, Any]) -> None:
        """Raise `DeviceSettingError` for a spec's `device` table that is none."""
        model_of(facts)

    def commands(self) -> tuple[CommandRow, ...]:
        """The coverage table."""
        return coverage(COMMANDS)

    def framing(self, session: Session, kind: LinkKind) -> VelodyneFraming:
        """How its packets are changed on their way."""
        return VelodyneFraming()

    def device_keys(self) -> tuple[DeviceKey, ...]:
        """Every key of a scenario's `device:` table."""
        keys = DeviceKeys({}, {})
        read(keys)
        return tuple(keys.known)


FAMILY = VelodyneFamily()
