"""Coverage table of the family, derived from the tables that dispatch messages and commands.

Belongs here: how a row is made of them. Not: the facts themselves.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import Any

from protocols.can_objects.layout import Layout, load
from protocols.can_objects.ldmrs import COMMANDS
from protocols.can_objects.leddar_holding import M16_HOLDING, M16_INPUT, VU8_HOLDING, VU8_INPUT
from protocols.session import CommandRow

LEDDAR = {
    "leddar_vu8": ("LeddarTech user guide 54A0028, LeddarSDK", VU8_INPUT, VU8_HOLDING),
    "leddar_m16": ("leddartech/LeddarSDK", M16_INPUT, M16_HOLDING),
}
"Format -> source, input data, holding data."


def rows(formats: Mapping[str, str]) -> tuple[CommandRow, ...]:
    """One row a message, host messages first; LD-MRS commands, Leddar requests and data each on their own."""
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
        if name in LEDDAR:
            found += _leddar(name, module.SESSION.COMMANDS)
        found += _rows(name, layout, module.SENT, "to hosts")
    return tuple(found)


def _leddar(name: str, commands: Mapping[int, Any]) -> list[CommandRow]:
    source, inputs, holding = LEDDAR[name]
    found = [
        CommandRow(f"{name} request {code}", command.name, "done", source, command.note)
        for code, command in commands.items()
    ]
    for first, (codes, what) in inputs.items():
        span = f"{first}" if codes == 1 else f"{first} to {first + codes - 1}"
        found.append(CommandRow(f"{name} input data {span}", what, "done", source, ""))
    found += [
        CommandRow(f"{name} holding data {code}", group.name, "done", source, group.note)
        for code, group in holding.items()
    ]
    return found


def _rows(name: str, layout: Layout, messages: Sequence[tuple[str, str, str]], direction: str) -> list[CommandRow]:
    return [
        CommandRow(f"{name} 0x{layout.identifier(message):03X}", f"{message} ({direction})", "done", source, note)
        for message, source, note in messages
    ]
