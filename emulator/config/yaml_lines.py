"""YAML 1.2 as plain data, with file and line of every value; everything in a file that is not plain data is refused.

Belongs here: reading text, limits, what a scalar means, paths into the data. Not: what keys mean (the models), and the
wording of a model's faults (yaml_source).

The parser's events are turned into data here instead of by a loader, so that a file can neither construct anything
(tags), nor grow (aliases), nor hide anything (a key given twice).
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.events import (
    AliasEvent,
    DocumentEndEvent,
    DocumentStartEvent,
    MappingEndEvent,
    MappingStartEvent,
    ScalarEvent,
    SequenceEndEvent,
    SequenceStartEvent,
)

from emulator.config.budgets import MOST_DIGITS, MOST_FLOAT_CHARACTERS, TEXT, PlainFile, TooMuch
from emulator.errors import EmulatorError

Loc = tuple[str | int, ...]

MAX_BYTES, MAX_VALUES, MAX_SEPARATORS, MAX_DEPTH = TEXT.bytes, TEXT.values, TEXT.separators, TEXT.depth

KEPT_CHARACTERS, KEPT_TEXTS = 1 << 15, 32
"Texts of up to this length are known again, the latest of them: a rig of pytest loads its file twice for each test."

_TAB = re.compile(r" *\t")
_NULL = re.compile(r"(?:|~|null|Null|NULL)\Z")
_BOOL = re.compile(r"(?:true|True|TRUE|false|False|FALSE)\Z")
_INT = re.compile(r"[-+]?[0-9]+\Z")
_OCT = re.compile(r"0o[0-7]+\Z")
_HEX = re.compile(r"0x[0-9a-fA-F]+\Z")
_FLOAT = re.compile(r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?\Z")
_ODD = re.compile(r"(?:[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))\Z")
"The scalars of YAML 1.2's core schema, section 10.3.2 of its specification."
_SEPARATORS = (",", "[", "{", "- ", "\n", "\r", "\x85", "\u2028", "\u2029")
_SEPARATOR = re.compile("\r\n|- |[,[{\n\r\x85\u2028\u2029]")


@dataclass(frozen=True)
class Source:
    """A file's plain data, and file and line of every value in it."""

    path: Path
    data: Any
    places: Mapping[Loc, tuple[Path, int]] = field(default_factory=dict)
    faults: tuple[str, ...] = ()
    "What was wrong already with the text, one line each; the data are complete as far as they could be read."
    _ids: dict[int, frozenset[str]] = field(default_factory=dict, init=False, repr=False, compare=False)
    "Names of the items of each list that has been asked for."

    def spot(self, loc: Sequence[str | int]) -> tuple[Path, int]:
        """File and line of the deepest part of `loc` that stands in the file; line 0: not from a file."""
        path = tuple(loc)
        while path and path not in self.places:
            path = path[:-1]
        return self.places.get(path, (self.path, 1))

    def place(self, loc: Sequence[str | int]) -> str:
        """`file:line` of the deepest part of `loc` that stands in the file."""
        file, line = self.spot(loc)
        return f"{file}:{line}" if line else str(file)

    def dotted(self, loc: Sequence[str | int]) -> str:
        """A path as users write it: `sensors.front.mount`, with ids where a list's items have them."""
        return dotted(loc, self.data, self._ids)

    def fault(self, loc: Sequence[str | int], found: str, want: str) -> str:
        """The line that reports a fault: `file:line: dotted.key: found; want allowed`."""
        return f"{self.place(loc)}: {self.dotted(loc)}: {found}; want {want}"


def read_text(path: Path, error: type[EmulatorError]) -> str:
    """Text of a file; what cannot be read is an `error`."""
    try:
        with PlainFile(path) as file:
            if file.size > MAX_BYTES:
                raise error(f"{path}:1: {file.size} bytes; want at most {MAX_BYTES}")
            return file.read().decode("utf-8-sig")
    except (FileNotFoundError, IsADirectoryError):
        raise error(f"{path}:1: no such file; want a YAML file") from None
    except TooMuch as exc:
        raise error(f"{path}:1: {exc}") from None
    except UnicodeDecodeError as exc:
        line = exc.object[: exc.start].count(b"\n") + 1
        raise error(f"{path}:{line}: byte {exc.object[exc.start]:#04x} is not UTF-8; want UTF-8") from None
    except OSError as exc:
        raise error(f"{path}:1: cannot be read: {exc.strerror or exc}; want a YAML file in UTF-8") from None


def read(path: Path, error: type[EmulatorError]) -> Source:
    """Read a YAML 1.2 file; whatever is wrong with its text is an `error` with file and line."""
    source = parse(read_text(path, error), path, error)
    if source.faults:
        raise error.of(source.faults)
    return source


def parse(text: str, path: Path, error: type[EmulatorError]) -> Source:
    """Read YAML 1.2 from a string that is said to come from `path`.

    What makes the whole text unreadable is raised as `error`; what can be reported together with other faults (a
    key given
    twice, a tag) stands in `Source.faults`.
    """
    _judge_length(text, path, error)
    try:
        root = _known_tree(text) if len(text) <= KEPT_CHARACTERS else _Tree().build(text)
    except _Refused as exc:
        raise error(f"{path}:{exc}") from None
    except MarkedYAMLError as exc:
        mark = exc.problem_mark or exc.context_mark
        line = mark.line + 1 if mark is not None else 1
        found, want = exc.problem or exc.context, "YAML 1.2"
        lines = text.splitlines()
        if "'\\t'" in str(found) or (line <= len(lines) and _TAB.match(lines[line - 1])):
            found, want = "a tab where a line is indented", "spaces: use spaces to indent"
        raise error(f"{path}:{line}: not YAML: {found}; want {want}") from None
    except (YAMLError, ValueError, LookupError, TypeError, AttributeError, AssertionError, RecursionError) as exc:
        # the parser has no single error for a broken text: `%YAML 1.6` ends it with an assertion
        reason = " ".join(str(exc).split()) or type(exc).__name__
        raise error(f"{path}:1: not YAML: {reason[:200]}; want YAML 1.2") from None
    plain = _Plain(path, error)
    data = plain.convert(root, ())
    source = Source(path, data, plain.places)
    faults = [source.fault(loc, found, want) for loc, found, want in plain.faults]
    return Source(path, data, plain.places, tuple(faults))


def _judge_length(text: str, path: Path, error: type[EmulatorError]) -> None:
    if sum(text.count(mark) for mark in _SEPARATORS) - text.count("\r\n") <= MAX_SEPARATORS:
        return
    beyond = next(islice(_SEPARATOR.finditer(text), MAX_SEPARATORS, None))
    line = text.count("\n", 0, beyond.start()) + 1
    raise error(
        f"{path}:{line}: more than {MAX_SEPARATORS} commas, brackets, dashes and line ends; "
        f"want a smaller file, at most {MAX_VALUES} values"
    )


def parse_value(text: str, label: str, error: type[EmulatorError]) -> Any:
    """A value written on one line, as in `--set a.b=VALUE`; messages begin with `label`."""
    source = parse(text, Path(label), error)
    if source.faults:
        raise error.of(source.faults)
    return source.data


def dotted(loc: Sequence[str | int], data: Any = None, known: dict[int, frozenset[str]] | None = None) -> str:
    """`loc` as text; an item of a list by its `id` when `data` has one there, else by its number in brackets.

    `known` keeps the names of lists from one call to the next, as long as `data` lives and stays as it is.
    """
    known = {} if known is None else known
    text = ""
    for part in loc:
        below = None
        if isinstance(data, dict):
            below = data.get(str(part))
        elif isinstance(data, list) and isinstance(part, int) and 0 <= part < len(data):
            below = data[part]
        name = _id(below) if isinstance(part, int) else None
        if isinstance(name, str) and name and name in _own_ids(data, known):
            text += f".{name}"
        else:
            text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
        data = below
    return text or "file"


def _own_ids(items: list[Any], known: dict[int, frozenset[str]]) -> frozenset[str]:
    """The ids that one item of the list alone has."""
    if id(items) not in known:
        counts = Counter(name for name in map(_id, items) if isinstance(name, str))
        known[id(items)] = frozenset(name for name, count in counts.items() if count == 1)
    return known[id(items)]


def _id(item: Any) -> Any:
    return item.get("id") if isinstance(item, dict) else None


# ---------------------------------------------------------------- text to a tree


@dataclass(eq=False)
class _Node:
    line: int
    value: Any = None
    "Of a scalar."
    items: list[_Node] | None = None
    pairs: list[tuple[_Node, _Node]] | None = None
    fault: tuple[str, str] | None = None
    open: bool = False
    "Still being read: an alias to it would contain itself."


class _Refused(Exception):
    """Not plain data: line, what was found, what is wanted."""

    def __str__(self) -> str:
        line, found, want = self.args
        return f"{line}: {found}; want {want}"


@lru_cache(maxsize=KEPT_TEXTS)
def _known_tree(text: str) -> _Node:
    """Nodes are read alone once they are built; what is made of them is new each time."""
    return _Tree().build(text)


class _Tree:
    """Parser events to nodes, without recursion."""

    def __init__(self) -> None:
        self._anchors: dict[str, _Node] = {}
        self._count = 0

    def build(self, text: str) -> _Node:
        root: _Node | None = None
        open_nodes: list[_Node] = []
        keys: list[_Node | None] = []
        documents = 0
        for event in YAML(typ="safe", pure=True).parse(text):
            line = event.start_mark.line + 1
            if isinstance(event, DocumentStartEvent):
                documents += 1
                if documents > 1:
                    raise _Refused(line, "a second document", "one document per file")
                continue
            if isinstance(event, MappingEndEvent | SequenceEndEvent):
                keys.pop()
                open_nodes.pop().open = False
                continue
            if isinstance(event, ScalarEvent):
                node = _scalar(event, line)
            elif isinstance(event, AliasEvent):
                found = self._anchors.get(event.anchor)
                if found is None:
                    raise _Refused(line, f"alias *{event.anchor} without its anchor", "an anchor before it")
                if found.open:
                    raise _Refused(line, f"alias *{event.anchor} inside its own anchor", "data without a cycle")
                node = found
            elif isinstance(event, MappingStartEvent | SequenceStartEvent):
                node = _Node(line, open=True)
                if event.tag is not None:
                    node.fault = (f"tag {event.tag}", "plain data")
                if isinstance(event, MappingStartEvent):
                    node.pairs = []
                else:
                    node.items = []
            else:
                if isinstance(event, DocumentEndEvent):
                    self._anchors.clear()
                continue
            if not isinstance(event, AliasEvent) and event.anchor:
                self._anchors[event.anchor] = node
            if not open_nodes or open_nodes[-1].items is not None or keys[-1] is not None:  # no key
                self._count += 1
                if self._count > MAX_VALUES:
                    raise _Refused(line, f"more than {MAX_VALUES} values", "a smaller file")
            if not open_nodes:
                root = node
            elif (parent := open_nodes[-1]).items is not None:
                parent.items.append(node)
            elif keys[-1] is None:
                keys[-1] = node
            else:
                assert parent.pairs is not None
                parent.pairs.append((keys[-1], node))
                keys[-1] = None
            if node.open:
                if len(open_nodes) >= MAX_DEPTH:
                    raise _Refused(line, f"nested more than {MAX_DEPTH} deep", "a flatter file")
                open_nodes.append(node)
                keys.append(None)
        return root or _Node(1)


def _scalar(event: Any, line: int) -> _Node:
    node = _Node(line, event.value)
    if event.tag is not None:
        node.fault = (f"tag {event.tag}", "plain data")
    elif event.implicit[0]:  # plain style: a number, a truth value, nothing, or text
        node.value, node.fault = _plain_scalar(event.value)
    return node


def _plain_scalar(text: str) -> tuple[Any, tuple[str, str] | None]:
    if _INT.match(text) or _OCT.match(text) or _HEX.match(text):
        if len(text) > MOST_DIGITS:
            return None, (f"a number of {len(text)} digits", f"at most {MOST_DIGITS}")
        return int(text, 0 if text[:2] in ("0o", "0x") else 10), None
    if _FLOAT.match(text):
        if len(text) > MOST_FLOAT_CHARACTERS:
            return None, (f"a number of {len(text)} characters", f"at most {MOST_FLOAT_CHARACTERS}")
        return float(text), None
    if _ODD.match(text):
        return float(text.replace(".", "")), None
    if _NULL.match(text):
        return None, None
    if _BOOL.match(text):
        return text.lower() == "true", None
    return text, None


class _Plain:
    """A tree of nodes to dicts, lists and scalars, noting where each stood."""

    def __init__(self, path: Path, error: type[EmulatorError]) -> None:
        self._path, self._error = path, error
        self._count = 0
        self.places: dict[Loc, tuple[Path, int]] = {}
        self.faults: list[tuple[Loc, str, str]] = []

    def convert(self, node: _Node, loc: Loc, line: int = 1) -> Any:
        self._count += 1
        if self._count > MAX_VALUES:
            raise self._error(f"{self._path}:{line}: more than {MAX_VALUES} values; want a smaller file")
        if len(loc) > 2 * MAX_DEPTH:
            raise self._error(
                f"{self._path}:{line}: aliases nested more than {2 * MAX_DEPTH} deep; want a flatter file"
            )
        self.places[loc] = (self._path, line)
        if node.fault is not None:
            self.faults.append((loc, *node.fault))
        if node.items is not None:
            return [self.convert(item, (*loc, number), item.line) for number, item in enumerate(node.items)]
        if node.pairs is None:
            return node.value
        out: dict[str, Any] = {}
        for key, value in node.pairs:
            if key.items is not None or key.pairs is not None:
                self.faults.append((loc, f"a key on line {key.line} that is a list or table", "text as a key"))
                continue
            name = _key_text(key.value)
            if name in out:
                first = self.places[(*loc, name)][1]
                self.places[(*loc, name)] = (self._path, key.line)
                self.faults.append(((*loc, name), f"given twice, first in line {first}", "each key only once"))
                continue
            out[name] = None  # keeps its place in the order
            out[name] = self.convert(value, (*loc, name), key.line)
        return out


def _key_text(value: Any) -> str:
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "true" if value else "false"
    return str(value)
