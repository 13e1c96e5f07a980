"""Conversations of real lidars: bytes and times in, bytes and times out. Imports nothing of `emulator`.

Families are imported when asked for, so that a run pays only for the ones it uses.
"""

from __future__ import annotations

from importlib import import_module

from protocols.session import Family

FAMILIES = {
    "lms2xx": "protocols.lms2xx",
    "ld": "protocols.ld",
    "can_objects": "protocols.can_objects",
}
"Family name -> module that offers `FAMILY`."


def family(name: str) -> Family:
    """The family of that name; KeyError with the known names when there is none."""
    if name not in FAMILIES:
        raise KeyError(f"unknown family {name!r}; known: {', '.join(sorted(FAMILIES))}")
    found: Family = import_module(FAMILIES[name]).FAMILY
    return found
