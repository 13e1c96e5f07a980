"""SICK LMS200, LMS211, LMS220, LMS221, LMS291: the device side of their serial protocol.

Reading order: `telegrams` (bytes), `commands` (what each request does), `schedule` (when scans are sent), `session`.
`settings.KEYS` lists the keys of a scenario's `device:` table, `models.MODELS` the differences of the models.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from protocols.lms2xx.commands import coverage_rows
from protocols.lms2xx.framing import Lms2xxFraming
from protocols.lms2xx.models import model_of, with_firmware
from protocols.lms2xx.session import Lms2xxSession
from protocols.lms2xx.settings import KEYS, read
from protocols.lms2xx.telegrams import request
from protocols.session import CommandRow, DeviceKey, LinkKind, Session
from protocols.wire import Wire


class Lms2xxFamily:
    """The family as `protocols.family("lms2xx")` gives it."""

    name = "lms2xx"
    tcp_is_line = True
    "TCP reaches an LMS2xx through a serial device server (ARIA connects so)."
    wire = Wire(
        (LinkKind.SERIAL, LinkKind.STREAM, LinkKind.DATAGRAM),
        lambda kind: Lms2xxFraming(),
        LinkKind.SERIAL,
        (request(b"\x20\x48"), request(b"\x20\x24")),
    )
    "Asked for 500 kbaud, so that the line holds no sweep up; then all values, continuously."

    def new_session(self, device: Mapping[str, Any], facts: Mapping[str, Any]) -> Lms2xxSession:
        """A device that is switched off. Raises `DeviceSettingError`."""
        model = model_of(facts)
        if "firmware" in device:
            model = with_firmware(model, device["firmware"])
        return Lms2xxSession(model, read(device, model))

    def commands(self) -> tuple[CommandRow, ...]:
        """The coverage table."""
        return coverage_rows()

    def framing(self, session: Session, kind: LinkKind) -> Lms2xxFraming:
        """How its telegrams are changed on their way."""
        return Lms2xxFraming()

    def device_keys(self) -> tuple[DeviceKey, ...]:
        """Every key of a scenario's `device:` table, with what is allowed, the default and the meaning."""
        return KEYS


FAMILY = Lms2xxFamily()
