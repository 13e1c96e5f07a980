"""The wire protocols of real lidars: bytes and times in, bytes and times out. Imports nothing from `emulator`.

Families are imported on request, so a run loads only those that it uses.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points

from protocols.session import Family

FAMILIES = {
    "lms2xx": "protocols.lms2xx",
    "ld": "protocols.ld",
    "cola": "protocols.cola",
    "can_objects": "protocols.can_objects",
    "scip": "protocols.scip",
    "velodyne": "protocols.velodyne",
    "hesai": "protocols.hesai",
    "ouster": "protocols.ouster",
    "livox": "protocols.livox",
    "rplidar": "protocols.rplidar",
    "ldrobot": "protocols.ldrobot",
    "ydlidar": "protocols.ydlidar",
}
"Family name -> module that offers `FAMILY`; those of this package."

GROUP = "lidaremu.families"
"Entry points of other packages that bring a family: its name = its module."


@cache
def families() -> Mapping[str, str]:
    """Family name -> module: shipped families, and those of installed packages; shipped names are reserved."""
    return {one.name: one.module for one in entry_points(group=GROUP)} | FAMILIES


def family(name: str) -> Family:
    """The family of that name; KeyError with the known names when there is none."""
    if name not in families():
        raise KeyError(f"unknown family {name!r}; known: {', '.join(sorted(families()))}")
    found: Family = import_module(families()[name]).FAMILY
    return found
