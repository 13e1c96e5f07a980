"""Velodyne's rotating lidars: VLP-16, Puck Hi-Res, HDL-32E, VLP-32C, VLS-128.

Reading order: `codec` (bytes), `tables`, `models` (facts of each), `motor` (angles over time), `device` (slices and
packets), `session` (web interface). `settings.read` has the keys of a scenario's `device:` table.
"""

from __future__ import annotations

from protocols.session import LinkKind
from protocols.skeleton.family import ModelFamily
from protocols.skeleton.requests import coverage
from protocols.velodyne.framing import VelodyneFraming
from protocols.velodyne.models import MODELS
from protocols.velodyne.own import with_lasers
from protocols.velodyne.session import COMMANDS, VelodyneSession
from protocols.velodyne.settings import read
from protocols.wire import Wire

FAMILY = ModelFamily(
    name="velodyne",
    models=MODELS,
    usual="velodyne-vlp-16",
    build=lambda keys, model: VelodyneSession(model, *read(keys)),
    rows=coverage(COMMANDS),
    wire=Wire(
        (LinkKind.STREAM, LinkKind.DATAGRAM),
        lambda kind: VelodyneFraming(),
        LinkKind.STREAM,
        (b"GET /packets HTTP/1.1\r\n\r\n",),
        impaired=("no pps",),
    ),
    further={"lasers": with_lasers},
)
