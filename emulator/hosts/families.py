"""The host's side of each built-in family: one row for `look`, `probe`, `test`, `describe` and `demo`.

Belongs here: the table, and reading it. Not: what a family states of its wire (`FAMILY.wire`), hosts of other packages
(`HasHost`, `HasScript` of their families).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from protocols.session import LinkKind
from protocols.wire import wire_of


@dataclass(frozen=True)
class Hosts:
    """One family; each place is `module:name`, imported when it is wanted."""

    host: str
    "Made with a line and a line speed; with speed None it leaves the device as it is. On CAN: with a bus and a model."
    fields: str
    "(speaker, payload, kind of link, peer, whether the device sent it) -> fields."
    shown_by: str
    "Built-in scenario that shows it."
    script: str | None = None
    "(line, on_scan, the scenario's `device` table): a host in virtual time."


BUILT_IN: Mapping[str, Hosts] = {
    "lms2xx": Hosts(
        "emulator.hosts.lms2xx:Lms2xxHost", "emulator.hosts.describe:lms2xx", "crossing_car",
        "emulator.hosts.scripted:lms2xx_script"),
    "ld": Hosts(
        "emulator.hosts.ld:LdHost", "emulator.hosts.describe:ld", "bumper", "emulator.hosts.scripted:ld_script"),
    "cola": Hosts(
        "emulator.hosts.cola:ColaHost", "emulator.hosts.describe:cola", "cola_yard", "emulator.hosts.cola:cola_script"),
    "scip": Hosts(
        "emulator.hosts.scip:ScipHost", "emulator.hosts.describe:scip_reply", "hokuyo_room",
        "emulator.hosts.scip:scip_script"),
    "velodyne": Hosts(
        "emulator.hosts.velodyne:VelodyneHost", "emulator.hosts.velodyne:described", "velodyne_street",
        "emulator.hosts.velodyne:velodyne_script"),
    "hesai": Hosts(
        "emulator.hosts.hesai:HesaiHost", "emulator.hosts.hesai:described", "hesai_street",
        "emulator.hosts.hesai:hesai_script"),
    "ouster": Hosts(
        "emulator.hosts.ouster:OusterHost", "emulator.hosts.ouster:described", "ouster_street",
        "emulator.hosts.ouster:ouster_script"),
    "livox": Hosts(
        "emulator.hosts.livox:LivoxHost", "emulator.hosts.livox:described", "solid_state",
        "emulator.hosts.livox:livox_script"),
    "rplidar": Hosts(
        "emulator.hosts.rplidar:RplidarHost", "emulator.hosts.describe:rplidar_reply", "rplidar_room",
        "emulator.hosts.rplidar:rplidar_script"),
    "ldrobot": Hosts(
        "emulator.hosts.ldrobot:LdrobotHost", "emulator.hosts.ldrobot:fields", "desk_scanners",
        "emulator.hosts.ldrobot:ldrobot_script"),
    "ydlidar": Hosts(
        "emulator.hosts.ydlidar:YdlidarHost", "emulator.hosts.ydlidar:fields", "desk_scanners",
        "emulator.hosts.ydlidar:ydlidar_script"),
    "can_objects": Hosts(
        "emulator.hosts.can_objects:CanObjectHost", "emulator.hosts.describe:can_objects", "fog_objects"),
}  # fmt: skip
"By family. A new family adds a row."


def names() -> str:
    """All of them, for messages."""
    *first, last = BUILT_IN
    return f"{', '.join(first)} or {last}"


def found_at(place: str) -> Any:
    """What `module:name` names."""
    module, _, name = place.partition(":")
    return getattr(import_module(module), name)


def on_lines() -> tuple[str, ...]:
    """Built-in families whose hosts are made with a line."""
    return tuple(name for name in BUILT_IN if (wire := wire_of(name)) is not None and not wire.on_can_only)


def is_on_can(family: str | None) -> bool:
    """Whether it is a family of CAN frames alone."""
    wire = wire_of(family)
    return wire is not None and wire.on_can_only


def free_link(family: str | None, sensor: str, folder: Path) -> str | None:
    """A link that no other run uses, of the kind that a family usually has; None: there is no such family."""
    wire = wire_of(family)
    if wire is None:
        return None
    if wire.usual is LinkKind.CAN:
        return f"socketcand:127.0.0.1:0/{sensor[:15] if sensor.isascii() else 'can0'}"
    return f"pty:{folder / sensor}" if wire.usual is LinkKind.SERIAL else "tcp:127.0.0.1:0"
