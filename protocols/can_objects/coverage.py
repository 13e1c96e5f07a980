"""Coverage table of the family, derived from the tables that dispatch messages and commands.

Belongs here: how a row is made of them. Not: the facts themselves.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module

from protocols.can_objects.layout import Layout, load
from protocols.can_objects.ldmrs import COMMANDS
from protocols.can_objects.leddar_vu8 import FUNCTIONS
from protocols.session import CommandRow


def rows(formats: Mapping[str, str]) -> tuple[CommandRow, ...]:
    """One row a message, host messages first; LD-MRS commands and refused Vu8 requests each on their own."""
    found: list[CommandRow] = []
    for name, module_name in formats.items():
        module = import_module(module_name)
        layout = load(module.SESSION.LAYOUT_FILE)
        received = [(m.name, m.source, m.note) for m in module.SESSION.HOST_MESSAGES]
        found += _rows(name, layout, received, "from hosts")
        if name == "ldmrs":
            found += [
                CommandRow(f"ldmrs command 0x{code:04X}", command.name, "done", "SICK 8014493", command.note)
                for code, command in COMMANDS.items()
            ]
        if name == "leddar_vu8":
            found += [
                CommandRow(
                    f"leddar_vu8 request {code}", what, "refused", "LeddarTech Vu8 user guide", "fields not public"
                )
                for code, what in FUNCTIONS.items()
            ]
        found += _rows(name, layout, module.SENT, "to hosts")
    return tuple(found)


def _rows(name: str, layout: Layout, messages: Sequence[tuple[str, str, str]], direction: str) -> list[CommandRow]:
    return [
        CommandRow(f"{name} 0x{layout.identifier(message):03X}", f"{message} ({direction})", "done", source, note)
        for message, source, note in messages
    ]
