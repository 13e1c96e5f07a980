"""Hesai's lidars: PandarXT-32, XT32M2X, QT64, Pandar40P, Pandar128E3X, OT128, AT128.

Reading order: `tables`, `models` (facts of each), `codec` (bytes), `calibration`, `motor` (angles and time), `slices`
(what is measured), `device` (power, packets), `commands` and `session` (PTC and HTTP). `settings.read` has the keys of
a scenario's `device:`.
"""

from __future__ import annotations

from protocols.hesai.commands import COMMANDS, NOT_BUILT
from protocols.hesai.framing import HesaiFraming
from protocols.hesai.models import MODELS
from protocols.hesai.session import HesaiSession
from protocols.hesai.settings import read
from protocols.session import LinkKind
from protocols.skeleton.family import ModelFamily
from protocols.skeleton.requests import coverage
from protocols.wire import Wire

FAMILY = ModelFamily(
    name="hesai",
    models=MODELS,
    usual="hesai-xt32",
    build=lambda keys, model: HesaiSession(model, *read(keys, model)),
    rows=coverage(COMMANDS) + NOT_BUILT,
    wire=Wire(
        (LinkKind.STREAM, LinkKind.DATAGRAM),
        lambda kind: HesaiFraming(),
        LinkKind.STREAM,
        (b"GET /point_cloud HTTP/1.1\r\n\r\n",),
        impaired=("no pps", "no ptp", "heat", "calibration", "wrong calibration served", "ptc error"),
    ),
)
