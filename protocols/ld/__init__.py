"""SICK LD-LRS, LD-OEM and relatives: the user protocol on TCP 49152, RS-232/422 and CAN.

telegrams   service words, sensor status, words and bytes
usp         frame on TCP (and in the datagrams of a `udp:` link, which the real device does not have)
packages    ASCII-hex packages on serial lines
segments    frames on CAN
sectors     the sector table, its geometry, what the device measures
profiles    formats of measured profiles
head        rotation, directions, delays
models, config, settings   facts, configuration blocks, the scenario's `device` table
device      state of the device
services    what each service does: the command table
com_services, routing, files   services that route interfaces, keep files and watch
cola        CoLa binary beside the user protocol
channels, revolutions, session   hosts, measuring, and what happens when
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from protocols.framing import Framing
from protocols.ld.framing import PackageFraming, SegmentFraming, UspFraming
from protocols.ld.models import model_of
from protocols.ld.services import check_table, rows
from protocols.ld.session import LdSession
from protocols.ld.settings import KEYS, Key, settings_of
from protocols.session import CommandRow, LinkKind, Session
from protocols.wire import Wire


def _framing(kind: LinkKind) -> Framing:
    if kind is LinkKind.SERIAL:
        return PackageFraming()
    return SegmentFraming() if kind is LinkKind.CAN else UspFraming()


WIRE = Wire((LinkKind.STREAM, LinkKind.SERIAL, LinkKind.CAN, LinkKind.DATAGRAM), _framing, LinkKind.DATAGRAM)
"With a listener on datagrams an LD measures by itself."


@dataclass(frozen=True)
class LdFamily:
    """The family as `protocols.family("ld")` gives it."""

    name: str = "ld"
    tcp_is_line: bool = False
    wire: Wire = WIRE

    def new_session(self, device: Mapping[str, Any], facts: Mapping[str, Any]) -> LdSession:
        """A session of one device, switched off; `DeviceSettingError` for what the model does not have."""
        check_table()
        model = model_of(facts)
        return LdSession(model, settings_of(device, model))

    def commands(self) -> tuple[CommandRow, ...]:
        """The coverage table."""
        return rows()

    def framing(self, session: Session, kind: LinkKind) -> Framing:
        """How its messages are changed on their way."""
        return _framing(kind)

    def device_keys(self) -> tuple[Key, ...]:
        """Every key of a scenario's `device` table, with what is allowed, its default and its meaning."""
        return KEYS


FAMILY = LdFamily()
