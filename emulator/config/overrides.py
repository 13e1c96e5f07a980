"""Changes to a scenario's data before it is judged: `--set a.b=c`, `--seed`, `--link`.

Belongs here: finding the place that a dotted key names, and putting a value there. Not: whether the value is allowed.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from emulator.config.yaml_lines import Loc, Source, parse_value
from emulator.errors import ScenarioError

SHOWN = 200
"Characters of a change that are reported of it."
_KEY = re.compile(r"[^.\[\]=\s]+(?:\[\d+\])*(?:\.[^.\[\]=\s]+(?:\[\d+\])*)*\Z")

ENDED_BY_NULL = ("weather", "changes")
"Within it null is a value: it ends what holds."


def changed(
    source: Source,
    overrides: Sequence[str] = (),
    seed: int | None = None,
    links: Mapping[str, Sequence[str]] | None = None,
) -> Source:
    """The source with `a.b=c` texts applied in their order, then seed and links; every fault is reported at once.

    A key leads through tables by name and through lists by number or by the `id` of an item: `sensors.front.mode` and
    `sensors.0.mode` are the same. The value is YAML; null takes a key away. Tables that are missing are made.
    """
    places = dict(source.places)
    data = source.data
    if not overrides and seed is None and not links:
        return source
    data = _copied(data)
    faults: list[str] = []
    for text in overrides:
        label = f"--set {text if len(text) <= SHOWN else text[: SHOWN - 3] + '...'}"
        key, separator, value = text.partition("=")
        try:
            if not separator or not _KEY.match(key.strip()):
                raise ScenarioError(
                    f"{label}: not an override; want KEY=VALUE, for example weather.fog.visibility_m=50"
                )
            parts = key.strip().replace("[", ".").replace("]", "").split(".")
            _put(data, parts, parse_value(value, label, ScenarioError), label, places)
        except ScenarioError as error:
            faults.extend(error.lines)
    if seed is not None:
        _put(data, ["seed"], seed, f"--seed {seed}", places)
    for sensor, urls in (links or {}).items():
        label = f"--link {sensor}={', '.join(urls)}"
        try:
            _put(data, ["sensors", sensor, "links"], list(urls), label, places)
        except ScenarioError as error:
            faults.extend(error.lines)
    if faults:
        raise ScenarioError.of(faults)
    return Source(source.path, data, places, source.faults)


def placed(source: Source, values: Sequence[tuple[str, Any, str]]) -> Source:
    """The source with values put at dotted keys, in their order: (key, value, label); all faults at once."""
    places = dict(source.places)
    data = _copied(source.data)
    faults: list[str] = []
    for key, value, label in values:
        try:
            if not _KEY.match(key):
                raise ScenarioError(f"{label}: {key!r} is not a key; want one like weather.fog.visibility_m")
            _put(data, key.replace("[", ".").replace("]", "").split("."), _copied(value), label, places)
        except ScenarioError as error:
            faults.extend(error.lines)
    if faults:
        raise ScenarioError.of(faults)
    return Source(source.path, data, places, source.faults)


def location(data: Any, key: str) -> Loc:
    """The place that a dotted key names, whichever way it leads through lists."""
    found: list[str | int] = []
    here = data
    for part in key.replace("[", ".").replace("]", "").split("."):
        if isinstance(here, list):
            names = [item.get("id") if isinstance(item, dict) else None for item in here]
            at = names.index(part) if part in names else int(part) if part.isdecimal() else -1
            found.append(part if at < 0 else at)
            here = here[at] if 0 <= at < len(here) else None
        else:
            found.append(part)
            here = here.get(part) if isinstance(here, dict) else None
    return tuple(found)


def _copied(data: Any) -> Any:
    if isinstance(data, dict):
        return {key: _copied(value) for key, value in data.items()}
    return [_copied(value) for value in data] if isinstance(data, list) else data


def _put(data: Any, parts: Sequence[str], value: Any, label: str, places: dict[Loc, tuple[Path, int]]) -> None:
    if not isinstance(data, dict):
        raise ScenarioError(f"{label}: the file is not a table; want one with keys")
    loc: list[str | int] = []
    here: Any = data
    for depth, part in enumerate(parts):
        last = depth == len(parts) - 1
        if isinstance(here, list):
            index = _index(here, part, label, ".".join(parts[:depth]))
            loc.append(index)
            if last:
                here[index] = value
            elif not isinstance(here[index], dict | list):
                raise ScenarioError(f"{label}: {'.'.join(parts[: depth + 1])} is a single value; want a table or list")
            here = here[index]
            continue
        loc.append(part)
        within = depth > len(ENDED_BY_NULL) - 1 and tuple(parts[: len(ENDED_BY_NULL)]) == ENDED_BY_NULL
        if last and value is None and part in here and not within:
            del here[part]  # of one that is not there the judge knows whether there could be
            continue
        if last:
            here[part] = value
            continue
        if here.get(part) is None:
            here[part] = {}
            places[tuple(loc)] = (Path(label), 0)
        here = here[part]
        if not isinstance(here, dict | list):
            raise ScenarioError(f"{label}: {'.'.join(parts[: depth + 1])} is a single value; want a table or list")
    _move(places, tuple(loc), label)


def _move(places: dict[Loc, tuple[Path, int]], loc: Loc, label: str) -> None:
    for old in [one for one in places if one[: len(loc)] == loc]:
        del places[old]
    places[loc] = (Path(label), 0)


def _index(items: list[Any], part: str, label: str, where: str) -> int:
    names = [item.get("id") if isinstance(item, dict) else None for item in items]
    if part in names:
        return names.index(part)
    if part.isdecimal() and len(part) < 10 and int(part) < len(items):
        return int(part)
    known = [name for name in names if isinstance(name, str)]
    near = difflib.get_close_matches(part, known, n=1)
    hint = f"did you mean {near[0]}? " if near else ""
    numbers = f"a number below {len(items)}" if items else "an entry in the file: the list is empty"
    wanted = " or ".join([*([", ".join(known)] if known else []), numbers])
    raise ScenarioError(f"{label}: {where} has no {part}; {hint}want {wanted}")
