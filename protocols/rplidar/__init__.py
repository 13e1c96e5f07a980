"""Slamtec's RPLIDAR A1, A2, A3, S1, S2, S3 and C1.

Reading order: `codec` (bytes), `models` (facts of each), `device` (states, samples, groups), `commands`,
`session`; the motor is `skeleton.rotor`.
`settings.read` has the keys of a scenario's `device:` table.
"""

from __future__ import annotations

from protocols.rplidar.codec import request
from protocols.rplidar.commands import COMMANDS
from protocols.rplidar.framing import RplidarFraming
from protocols.rplidar.models import MODELS
from protocols.rplidar.session import RplidarSession
from protocols.rplidar.settings import read
from protocols.session import LinkKind
from protocols.skeleton.family import ModelFamily
from protocols.skeleton.requests import coverage
from protocols.wire import Wire

LINKS = (LinkKind.SERIAL, LinkKind.STREAM, LinkKind.DATAGRAM)
START = (request(0xF0, b"\x94\x02"), request(0xA8, b"\x58\x02"), request(0x20))
"Motor by PWM, motor by speed, SCAN: whichever model it is."
FAMILY = ModelFamily(
    name="rplidar",
    models=MODELS,
    usual="rplidar-a1m8",
    build=lambda keys, model: RplidarSession(*read(keys, model)),
    rows=coverage(COMMANDS),
    wire=Wire(LINKS, lambda kind: RplidarFraming(), LinkKind.SERIAL, START),
)
