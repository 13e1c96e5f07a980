"""Slamtec's RPLIDAR A1, A2, A3, S1, S2, S3 and C1.

Reading order: `codec` (bytes), `models` (facts of each), `rotor` (the motor), `device` (states, samples,
groups), `commands`, `session`.
`settings.read` has the keys of a scenario's `device:` table.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from protocols.rplidar.codec import request
from protocols.rplidar.commands import COMMANDS
from protocols.rplidar.framing import RplidarFraming
from protocols.rplidar.models import model_of
from protocols.rplidar.session import RplidarSession
from protocols.rplidar.settings import read
from protocols.session import CommandRow, DeviceKey, LinkKind, Session
from protocols.skeleton.keys import DeviceKeys
from protocols.skeleton.requests import coverage
from protocols.wire import Wire

START = (request(0xF0, b"\x94\x02"), request(0xA8, b"\x58\x02"), request(0x20))
"Motor by PWM, motor by speed, SCAN: whichever model it is."


class RplidarFamily:
    """The family as `protocols.family("rplidar")` gives it."""

    name = "rplidar"
    tcp_is_line = False
    wire = Wire(
        (LinkKind.SERIAL, LinkKind.STREAM, LinkKind.DATAGRAM), lambda kind: RplidarFraming(), LinkKind.SERIAL, START
    )

    def new_session(self, device: Mapping[str, Any], facts: Mapping[str, Any]) -> RplidarSession:
        """A device that is switched off. Raises `DeviceSettingError`."""
        keys = DeviceKeys(device, {})
        model, settings = read(keys, model_of(facts))
        keys.finish()
        return RplidarSession(model, settings)

    def commands(self) -> tuple[CommandRow, ...]:
        """The coverage table."""
        return coverage(COMMANDS)

    def framing(self, session: Session, kind: LinkKind) -> RplidarFraming:
        """How its replies are changed on their way."""
        return RplidarFraming()

    def device_keys(self) -> tuple[DeviceKey, ...]:
        """Every key of a scenario's `device:` table."""
        keys = DeviceKeys({}, {})
        read(keys, model_of({}))
        return tuple(keys.known)


FAMILY = RplidarFamily()
