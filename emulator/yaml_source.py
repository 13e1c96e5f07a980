"""YAML files read with the place of every key, and faults told as `file:line: dotted.key: found; want allowed`.

Belongs here: reading, line numbers, turning pydantic errors into such lines. What the keys mean stays with the models.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel, ValidationError
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq, TaggedScalar
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.scalarbool import ScalarBoolean
from ruamel.yaml.scalarfloat import ScalarFloat
from ruamel.yaml.scalarint import ScalarInt

from emulator.errors import EmulatorError

Loc = tuple[str | int, ...]
MAX_NODES = 200_000
"More values than any file of ours needs; stops aliases that multiply."


@dataclass(frozen=True)
class Source:
    """A file's plain data, and file and line of every key in it."""

    path: Path
    data: Any
    places: Mapping[Loc, tuple[Path, int]] = field(default_factory=dict)

    def place(self, loc: Sequence[str | int]) -> str:
        """`file:line` of the deepest part of `loc` that stands in the file."""
        path = tuple(loc)
        while path and path not in self.places:
            path = path[:-1]
        file, line = self.places.get(path, (self.path, 1))
        return f"{file}:{line}"


def read(path: Path, error: type[EmulatorError]) -> Source:
    """Read a YAML 1.2 file; what cannot be read is an `error` with file and line."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as exc:
        raise error(f"{path}:1: cannot be read: {exc}; want a YAML file in UTF-8") from exc
    return parse(text, path, error)


def parse(text: str, path: Path, error: type[EmulatorError]) -> Source:
    """Read YAML 1.2 from a string that is said to come from `path`."""
    yaml = YAML(typ="rt", pure=True)
    try:
        root = yaml.load(text)
    except MarkedYAMLError as exc:
        mark = exc.problem_mark or exc.context_mark
        line = mark.line + 1 if mark is not None else 1
        raise error(f"{path}:{line}: not YAML: {exc.problem or exc}; want YAML 1.2") from exc
    except (YAMLError, ValueError, RecursionError) as exc:
        raise error(f"{path}:1: not YAML: {exc}; want YAML 1.2") from exc
    places: dict[Loc, tuple[Path, int]] = {(): (path, 1)}
    reader = _Plain(path, error, places)
    try:
        data = reader.convert(root, (), 1)
    except RecursionError as exc:
        raise error(f"{path}:1: nested too deeply; want a plain file") from exc
    return Source(path, data, places)


class _Plain:
    """Turns ruamel's tree into dicts, lists and scalars, noting where each stood."""

    def __init__(self, path: Path, error: type[EmulatorError], places: dict[Loc, tuple[Path, int]]) -> None:
        self._path, self._error, self._places = path, error, places
        self._nodes = 0

    def convert(self, node: Any, loc: Loc, line: int) -> Any:
        self._nodes += 1
        if self._nodes > MAX_NODES:
            raise self._error(f"{self._path}:{line}: more than {MAX_NODES} values; want a smaller file")
        if isinstance(node, CommentedMap):
            out: dict[str, Any] = {}
            for key, value in node.items():
                if not isinstance(key, str):
                    key = str(key)
                at = _line(node, key, line)
                self._places[(*loc, key)] = (self._path, at)
                out[key] = self.convert(value, (*loc, key), at)
            return out
        if isinstance(node, CommentedSeq):
            items = []
            for index, value in enumerate(node):
                at = _line(node, index, line)
                self._places[(*loc, index)] = (self._path, at)
                items.append(self.convert(value, (*loc, index), at))
            return items
        if isinstance(node, TaggedScalar):
            raise self._error(f"{self._path}:{line}: {_dotted(loc)}: tag {node.tag.value}; want plain data")
        if isinstance(node, ScalarBoolean):
            return bool(node)
        if isinstance(node, ScalarFloat):
            return float(node)
        if isinstance(node, ScalarInt):
            return int(node)
        if isinstance(node, str):
            return str(node)
        return node


def _line(node: Any, key: str | int, default: int) -> int:
    try:
        return int(node.lc.key(key)[0] if isinstance(node, CommentedMap) else node.lc.item(key)[0]) + 1
    except (AttributeError, KeyError, IndexError, TypeError):
        return default


def _dotted(loc: Iterable[str | int]) -> str:
    text = ""
    for part in loc:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return text or "file"


def fault_lines(source: Source, model: type[BaseModel], exc: ValidationError) -> list[str]:
    """One line a fault: `file:line: dotted.key: found; want allowed`, in the order of the file."""
    found: list[tuple[str, int, str]] = []
    for item in exc.errors(include_url=False):
        loc = _known(source.data, item["loc"])
        place = source.place(loc)
        file, _, line = place.rpartition(":")
        text = f"{place}: {_dotted(loc)}: {_say(item, model, loc)}"
        found.append((file, int(line), text))
    return list(dict.fromkeys(text for _, _, text in sorted(found, key=lambda one: one[:2])))


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
        "greater_than": "a number > {gt}",
        "greater_than_equal": "a number >= {ge}",
        "less_than": "a number < {lt}",
        "less_than_equal": "a number <= {le}",
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
