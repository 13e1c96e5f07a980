"""Errors of models reported as `file:line: dotted.key: found; want allowed`.

Belongs here: turning pydantic errors into such lines. Not: reading files (yaml_lines), what keys mean (the models).
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from emulator.config.yaml_lines import Loc as Loc
from emulator.config.yaml_lines import Source as Source
from emulator.config.yaml_lines import parse as parse
from emulator.config.yaml_lines import read as read


def fault_lines(source: Source, model: type[BaseModel], exc: ValidationError) -> list[str]:
    """One line a fault: `file:line: dotted.key: found; want allowed`, in the order of the file."""
    found: list[tuple[str, int, str]] = []
    for item in exc.errors(include_url=False):
        loc = _known(source.data, item["loc"])
        file, line = source.spot(loc)
        text = f"{source.place(loc)}: {source.dotted(loc)}: {_say(item, model, loc)}"
        found.append((str(file), line, text))
    return list(dict.fromkeys(text for _, _, text in sorted(found, key=lambda one: one[:2])))


def reported(model: type[BaseModel], data: Any, exc: ValidationError) -> list[tuple[Loc, str, str]]:
    """The same without a file: key below `data`, what was found, what is wanted."""
    found = []
    for item in exc.errors(include_url=False):
        loc = _known(data, item["loc"])
        text, _, want = _say(item, model, loc).partition("; want ")
        found.append((loc, text, want or "another value"))
    return found


def _known(data: Any, loc: Sequence[str | int]) -> Loc:
    """`loc` without the names that pydantic adds for the branches of a union."""
    path: list[str | int] = []
    last = len(loc) - 1
    for index, part in enumerate(loc):
        if isinstance(data, Mapping) and part in data:
            data = data[part]
        elif isinstance(data, list) and isinstance(part, int) and part < len(data):
            data = data[part]
        elif index != last or not isinstance(data, Mapping):
            continue
        path.append(part)
    return tuple(path)


def _say(item: Any, model: type[BaseModel], loc: Loc) -> str:
    kind, context, found = item["type"], item.get("ctx", {}), item.get("input")
    if kind == "missing":
        return "missing; want this key"
    if kind == "extra_forbidden":
        allowed = sorted(_keys_at(model, loc[:-1]))
        near = difflib.get_close_matches(str(loc[-1]), allowed, n=1)
        hint = f"did you mean {near[0]}? " if near else ""
        return f"unknown key; {hint}want one of {', '.join(allowed)}"
    if kind == "value_error":
        return str(context.get("error", item["msg"]))
    wants = {
        "greater_than": "a number > {gt:g}",
        "greater_than_equal": "a number >= {ge:g}",
        "less_than": "a number < {lt:g}",
        "less_than_equal": "a number <= {le:g}",
        "finite_number": "a finite number",
        "literal_error": "{expected}",
        "bool_type": "true or false",
        "bool_parsing": "true or false",
        "too_short": "at least {min_length} of them",
        "too_long": "at most {max_length} of them",
    }
    if kind in wants:
        want = wants[kind].format(**context)
    elif kind.startswith(("float", "decimal")):
        want = "a number"
    elif kind.startswith("int"):
        want = "a whole number"
    elif kind.startswith("string"):
        want = "a text" + (f" of the form {context['pattern']}" if "pattern" in context else "")
    elif kind in ("model_type", "dict_type", "model_attributes_type"):
        want = "keys with values"
    elif kind in ("list_type", "tuple_type"):
        want = "a list"
    else:
        want = item["msg"][:1].lower() + item["msg"][1:]
    return f"{_short(found)}; want {want}"


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _keys_at(model: type[BaseModel], loc: Sequence[str | int]) -> set[str]:
    """Keys that the models below `model` allow at `loc`."""
    level: list[type[BaseModel]] = [model]
    for part in loc:
        below = [
            found
            for one in level
            for name, info in one.model_fields.items()
            if part in (name, info.alias)
            for found in _models_in(info.annotation)
        ]
        level = below or level
    return {info.alias or name for one in level for name, info in one.model_fields.items()}


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [one for part in get_args(annotation) for one in _models_in(part)]
