"""Object lists on CAN: one session a format, each with its DBC file as the only layout.

Belongs here: which formats there are. A format's module is imported when a device of it is made, so that cantools is
loaded only by runs that use it.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Any

from protocols.errors import DeviceSettingError
from protocols.framing import Framing
from protocols.session import CommandRow, DeviceKey, LinkKind, Session
from protocols.skeleton.keys import DeviceKeys
from protocols.timebase import inside
from protocols.wire import Wire

FORMATS = {
    "ars408": "protocols.can_objects.ars408",
    "ldmrs": "protocols.can_objects.ldmrs",
    "esr": "protocols.can_objects.esr",
    "leddar_vu8": "protocols.can_objects.leddar_vu8",
    "leddar_m16": "protocols.can_objects.leddar_m16",
}
"Format name -> module, which has `Settings`, `SESSION` and `SENT`."


def _framing(kind: LinkKind) -> Framing:
    """That of one format: all have the same fields that can be changed."""
    from protocols.can_objects.framing import CanFraming
    from protocols.can_objects.layout import load

    return CanFraming(load("ars408.dbc"), None)


class CanObjects:
    """The family of sensors that list objects on CAN."""

    name = "can_objects"
    tcp_is_line = False
    wire = Wire((LinkKind.CAN,), _framing)

    def new_session(self, device: Mapping[str, Any], facts: Mapping[str, Any]) -> Session:
        """A session in the format that the model, or the scenario, names."""
        wanted = _format({**facts, **device})
        own, known = ({key: value for key, value in part.items() if key != "format"} for part in (device, facts))
        chosen = import_module(FORMATS[wanted])
        session: Session = chosen.SESSION(chosen.Settings.read(DeviceKeys(own, known)))
        return session

    def commands(self) -> tuple[CommandRow, ...]:
        """Every message of every format, hosts' first, from the tables that dispatch them."""
        from protocols.can_objects.coverage import rows

        return rows(FORMATS)

    def framing(self, session: Session, kind: LinkKind) -> Framing | None:
        """How its frames are changed on their way."""
        from protocols.can_objects.session import CanObjectSession

        own, _ = inside(session, 0)
        return own.framing() if isinstance(own, CanObjectSession) else None

    def keys_of_model(self, facts: Mapping[str, Any]) -> tuple[DeviceKey, ...]:
        """Every key of the `device` table in the format of a model, from the code that checks them."""
        keys = DeviceKeys({}, {})
        import_module(FORMATS[_format(facts)]).Settings.read(keys)
        return tuple(keys.known)


def _format(table: Mapping[str, Any]) -> str:
    wanted = table.get("format")
    if not isinstance(wanted, str) or wanted not in FORMATS:
        raise DeviceSettingError("format", wanted, " | ".join(FORMATS))
    return wanted


FAMILY = CanObjects()
