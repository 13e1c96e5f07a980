"""Hesai's lidars: PandarXT-32, XT32M2X, QT64, Pandar40P, Pandar128E3X, OT128, AT128.

Reading order: `tables`, `models` (facts of each), `codec` (bytes), `calibration`, `motor` (angles and time), `slices`
(what is measured), `device` (power, packets), `commands` and `session` (PTC and HTTP). `settings.read` has the keys of
a scenario's `device:`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from protocols.hesai.commands import COMMANDS
from protocols.hesai.framing import HesaiFraming
from protocols.hesai.models import model_of
from protocols.hesai.session import HesaiSession
from protocols.hesai.settings import read
from protocols.session import CommandRow, DeviceKey, LinkKind, Session
from protocols.skeleton.keys import DeviceKeys
from protocols.skeleton.requests import coverage
from protocols.wire import Wire


class HesaiFamily:
    """The family as `protocols.family("hesai")` gives it."""

    name = "hesai"
    tcp_is_line = False
    wire = Wire(
        (LinkKind.STREAM, LinkKind.DATAGRAM),
        lambda kind: HesaiFraming(),
        LinkKind.STREAM,
        (b"GET /point_cloud HTTP/1.1\r\n\r\n",),
        impaired=("no pps", "no ptp", "heat", "calibration", "wrong calibration served", "ptc error"),
    )

    def new_session(self, device: Mapping[str, Any], facts: Mapping[str, Any]) -> HesaiSession:
        """A device that is switched off. Raises `DeviceSettingError`."""
        model, keys = model_of(facts), DeviceKeys(device, {})
        settings, build = read(keys, model)
        keys.finish()
        return HesaiSession(model, settings, build)

    def check_facts(self, facts: Mapping[str, Any]) -> None:
        """Raise `DeviceSettingError` for a spec's `device` table that is none."""
        model_of(facts)

    def commands(self) -> tuple[CommandRow, ...]:
        """The coverage table."""
        return coverage(COMMANDS)

    def framing(self, session: Session, kind: LinkKind) -> HesaiFraming:
        """How its packets are changed on their way."""
        return HesaiFraming()

    def device_keys(self) -> tuple[DeviceKey, ...]:
        """Every key of a scenario's `device:` table."""
        return self.keys_of_model({})

    def keys_of_model(self, facts: Mapping[str, Any]) -> tuple[DeviceKey, ...]:
        """Those of a model, with its defaults and choices."""
        keys = DeviceKeys({}, {})
        read(keys, model_of(facts))
        return tuple(keys.known)


FAMILY = HesaiFamily()
