"""Ouster's digital lidars: OS0, OS1 and OS2 with 32, 64 or 128 rows, firmware 2.0 to 3.2.

Reading order: `codec` (bytes), `models` (rows and calibration), `config` (parameters), `metadata`, `clocks`, `imu`,
`device` (states, slices and packets), `api` (HTTP and lines). `settings.read` has the keys of a scenario's `device:`.
"""

from __future__ import annotations

from protocols.ouster.api import COMMANDS, OusterSession
from protocols.ouster.framing import OusterFraming
from protocols.ouster.models import MODELS
from protocols.ouster.settings import read
from protocols.session import LinkKind
from protocols.skeleton.family import ModelFamily
from protocols.skeleton.requests import coverage
from protocols.wire import Wire

FAMILY = ModelFamily(
    name="ouster",
    models=MODELS,
    usual="ouster-os1-128",
    build=lambda keys, model: OusterSession(*read(keys, model)),
    rows=coverage(COMMANDS),
    wire=Wire(
        (LinkKind.STREAM, LinkKind.DATAGRAM),
        lambda kind: OusterFraming(),
        LinkKind.STREAM,
        (b"GET /packets HTTP/1.1\r\n\r\n",),
        impaired=(
            "no ptp", "unavailable", "shot limiting", "thermal shutdown", "lost columns", "wrong calibration served",
        ),
    ),
)  # fmt: skip
