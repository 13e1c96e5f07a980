"""Errors of the protocol packages. A host's bytes never raise: they are answered, or recorded as `Dropped`.

ProtocolError                 misuse of this package
  EncodeError(ValueError)     a value that the format cannot hold
  ScanRefused(ValueError)     a scan whose settings are no longer those of the device
  DeviceSettingError(ValueError)   a `device:` key of a scenario that the family does not accept
"""

from __future__ import annotations


class ProtocolError(Exception):
    """Misuse of this package by its caller; never caused by a host's bytes."""


class EncodeError(ProtocolError, ValueError):
    """A value that the wire format cannot hold."""


class ScanRefused(ProtocolError, ValueError):
    """The device's settings changed after the plan of this scan was made; measure the new plan."""


class DeviceSettingError(ProtocolError, ValueError):
    """A key of a scenario's `device:` table that the family does not accept. The scenario loader adds file and line."""

    def __init__(self, key: str, found: object, allowed: str) -> None:
        super().__init__(f"{key}: {found!r}; want {allowed}")
        self.key = key
        self.found = found
        self.allowed = allowed
