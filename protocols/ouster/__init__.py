"""Ouster's digital lidars: OS0, OS1 and OS2 with 32, 64 or 128 rows, firmware 2.0 to 3.2.

Reading order: `codec` (bytes), `models` (rows and calibration), `config` (parameters), `metadata`, `clocks`, `imu`,
`device` (states, slices and packets), `api` (HTTP and lines). `settings.read` has the keys of a scenario's `device:`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from protocols.ouster.api import COMMANDS, OusterSession
from protocols.ouster.framing import OusterFraming
from protocols.ouster.models import MODELS, model_of
from protocols.ouster.settings import read
from protocols.session import CommandRow, DeviceKey, LinkKind, Session
from protocols.skeleton.keys import DeviceKeys
from protocols.skeleton.requests import coverage
from protocols.wire import Wire


class OusterFamily:
    """The family as `protocols.family("ouster")` gives it."""

    name = "ouster"
    tcp_is_line = False
    wire = Wire(
        (LinkKind.STREAM, LinkKind.DATAGRAM),
        lambda kind: OusterFraming(),
        LinkKind.STREAM,
        (b"GET /packets HTTP/1.1\r\n\r\n",),
        impaired=(
            "no ptp", "unavailable", "shot limiting", "thermal shutdown", "lost columns", "wrong calibration served",
        ),
    )  # fmt: skip

    def new_session(self, device: Mapping[str, Any], facts: Mapping[str, Any]) -> OusterSession:
        """A device that is switched off. Raises `DeviceSettingError`."""
        keys = DeviceKeys(device, {})
        session = OusterSession(*read(keys, model_of(facts)))
        keys.finish()
        return session

    def check_facts(self, facts: Mapping[str, Any]) -> None:
        """Raise `DeviceSettingError` for a spec's `device` table that is none."""
        model_of(facts)

    def commands(self) -> tuple[CommandRow, ...]:
        """The coverage table."""
        return coverage(COMMANDS)

    def framing(self, session: Session, kind: LinkKind) -> OusterFraming:
        """How its packets are changed on their way."""
        return OusterFraming()

    def device_keys(self) -> tuple[DeviceKey, ...]:
        """Every key of a scenario's `device:` table."""
        return self.keys_of_model({})

    def keys_of_model(self, facts: Mapping[str, Any]) -> tuple[DeviceKey, ...]:
        """Those of a model, for `lidaremu list device`."""
        keys = DeviceKeys({}, {})
        read(keys, MODELS[str(facts.get("model", "ouster-os1-128"))])
        return tuple(keys.known)


FAMILY = OusterFamily()
