"""`FAMILY` of a module, made of a session, its keys and its commands.

Belongs here: the family of a separate package. Not: families with several sessions, as those of `protocols`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from protocols.session import CommandRow, DeviceKey, Session
from protocols.skeleton.keys import DeviceKeys
from protocols.wire import ANY, Wire


@dataclass(frozen=True)
class SimpleFamily:
    """A family whose `device:` table is read by one function."""

    name: str
    tcp_is_line: bool
    "Whether TCP reaches the device through a serial device server."
    build: Callable[[DeviceKeys], Session]
    "Reads the keys, with their defaults, and makes the session."
    rows: tuple[CommandRow, ...] = ()
    wire: Wire = ANY

    def new_session(self, device: Mapping[str, Any], facts: Mapping[str, Any]) -> Session:
        """A device that is switched off. Raises `DeviceSettingError`."""
        keys = DeviceKeys(device, facts)
        session = self.build(keys)
        keys.finish(device)  # a model may extend one of another family, whose facts it inherits
        return session

    def commands(self) -> tuple[CommandRow, ...]:
        """The coverage table."""
        return self.rows

    def device_keys(self) -> tuple[DeviceKey, ...]:
        """Every key, from the code that checks them."""
        return self.keys_of_model({})

    def keys_of_model(self, facts: Mapping[str, Any]) -> tuple[DeviceKey, ...]:
        """Those of a model, with its defaults and choices, for `lidaremu list device`."""
        keys = DeviceKeys({}, facts)
        self.build(keys)
        return tuple(keys.known)
