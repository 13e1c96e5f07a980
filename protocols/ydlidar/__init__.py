"""YDLIDAR's scanners: X2, X4, G4, TG15, T-mini.

Reading order: `codec` (packets, replies, the slanted line), `models` (facts, keys of `device:`), `session`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from protocols.framing import Framing
from protocols.session import CommandRow, DeviceKey, Emission, LinkKind, Session
from protocols.skeleton.keys import DeviceKeys
from protocols.skeleton.requests import coverage
from protocols.wire import Wire
from protocols.ydlidar.codec import HEAD, REPLY
from protocols.ydlidar.models import model_of, read
from protocols.ydlidar.session import COMMANDS, YdlidarSession


class YdlidarFraming(Framing):
    """One packet, or one reply, per emission."""

    def bad_check(self, one: Emission) -> bytes | None:
        """A packet with a wrong checksum; replies have none."""
        data = one.payload
        return data[:8] + bytes((data[8] ^ 0x55,)) + data[9:] if data[:2] == HEAD else None

    def with_type(self, one: Emission, code: int) -> bytes | None:
        """A reply of another type."""
        data = one.payload
        return data[:6] + bytes((code & 0xFF,)) + data[7:] if data[:2] == REPLY else None

    def to_be_refused(self, data: bytes) -> bytes | None:
        """A command that no device has."""
        return data[:1] + b"\x7f" + data[2:]

    def is_whole(self, data: bytes) -> bool:
        return len(data) >= 2


class YdlidarFamily:
    """The family as `protocols.family("ydlidar")` gives it."""

    name = "ydlidar"
    tcp_is_line = True
    wire = Wire((LinkKind.SERIAL,), lambda kind: YdlidarFraming(), LinkKind.SERIAL, (b"\xa5\x60",))
    "Asked to scan; an X2 needs nothing."

    def new_session(self, device: Mapping[str, Any], facts: Mapping[str, Any]) -> YdlidarSession:
        """A device that is switched off. Raises `DeviceSettingError`."""
        model = model_of(facts)
        keys = DeviceKeys(device, {})
        settings = read(keys, model)
        keys.finish()
        return YdlidarSession(model, settings)

    def commands(self) -> tuple[CommandRow, ...]:
        """The coverage table."""
        return coverage(COMMANDS)

    def framing(self, session: Session, kind: LinkKind) -> YdlidarFraming:
        """How its packets and replies are changed on their way."""
        return YdlidarFraming()

    def device_keys(self) -> tuple[DeviceKey, ...]:
        """Every key of a scenario's `device:` table."""
        return self.keys_of_model({})

    def keys_of_model(self, facts: Mapping[str, Any]) -> tuple[DeviceKey, ...]:
        """Those of a model, with its defaults and limits."""
        keys = DeviceKeys({}, {})
        read(keys, model_of(facts))
        return tuple(keys.known)


FAMILY = YdlidarFamily()
