"""All kinds of faults by name, and the table that users see.

Belongs here: which layers there are. A layer's module is imported when somebody asks for a fault.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib import import_module
from types import MappingProxyType
from typing import Any, get_args

from emulator.config.names import nearest
from emulator.faults.config import Common
from emulator.faults.kinds import Kind

LAYERS: Mapping[str, str] = MappingProxyType(
    {
        "photon": "photon",
        "mechanics": "mechanics",
        "measurement": "measurement",
        "clock": "clocks",
        "telegram": "telegram",
        "byte": "octets",
        "link": "plug",
        "can": "can",
    }
)
"Layer -> its module in this package, which has `KINDS`."


@cache
def kinds() -> Mapping[str, Kind]:
    """Every kind by its name, layer by layer."""
    found: dict[str, Kind] = {}
    for layer, module in LAYERS.items():
        for kind in import_module(f"emulator.faults.{module}").KINDS:
            if kind.name in found or kind.layer != layer:
                raise ValueError(f"fault {kind.name!r}: named twice, or in the module of another layer")
            found[kind.name] = kind
    return MappingProxyType(found)


def rows(name: str | None = None) -> list[dict[str, object]]:
    """The table of `lidaremu list faults`: all of them, or the keys of one. `KeyError` says what there is."""
    if name is None:
        return [
            {
                "fault": kind.name,
                "layer": kind.layer,
                "keys": ", ".join(key["key"] for key in keys_of(kind)),
                "for": fits(kind),
                "summary": kind.summary,
                "ends": kind.ends,
            }
            for kind in kinds().values()
        ]
    if name not in kinds():
        raise KeyError(f"fault {name!r}; want {nearest(name, kinds())}")
    return [{**row} for row in (*keys_of(kinds()[name]), *common_keys(kinds()[name]))]


def fits(kind: Kind) -> str:
    """For which sensors and links a kind exists, in a few words."""
    parts = [*kind.known_families(), *(one.value for one in kind.links)]
    if kind.sees != ("beams", "objects"):
        parts += [f"sees {one}" for one in kind.sees]
    return ", ".join(parts) or "all"


def keys_of(kind: Kind) -> list[dict[str, str]]:
    """A kind's own keys: name, what is allowed, default, meaning."""
    return [_row(name, info) for name, info in kind.keys.model_fields.items()]


def taken_keys(kind: Kind) -> tuple[str, ...]:
    """Keys of `config.Common` that a fault of that kind takes."""
    keys = ["at_s", "at_telegram", "probability", "on_command", "when"]
    if not kind.measured:
        keys += ["every", "count"]
    if kind.lasts != "own":
        keys += ["for_s", "for_telegrams"]
    if not kind.measured or kind.act is not None:
        keys.append("link")
    if kind.directions:
        keys += ["direction", "of", "label"]
    return tuple(name for name in Common.model_fields if name in keys)


def common_keys(kind: Kind) -> list[dict[str, str]]:
    """The keys of all faults that this kind takes."""
    return [_row(name, Common.model_fields[name]) for name in taken_keys(kind)]


def _row(name: str, info: Any) -> dict[str, str]:
    default = "" if info.is_required() else "none" if info.default is None else f"{info.default}"
    if isinstance(info.default, bool):
        default = default.lower()
    return {
        "key": info.alias or name,
        "allowed": allowed(info.annotation, info.metadata),
        "default": "required" if info.is_required() else default,
        "meaning": " ".join((info.description or "").split()),
    }


def allowed(annotation: Any, metadata: Any = ()) -> str:
    """What a field takes, in words."""
    arguments = [part for part in get_args(annotation) if part is not type(None)]
    bounds = [*metadata]
    if hasattr(annotation, "__metadata__"):  # Annotated
        return allowed(annotation.__origin__, [*annotation.__metadata__, *bounds])
    if annotation is bool:
        return "true or false"
    if annotation in (int, float, str):
        return _bounded({int: "a whole number", float: "a number", str: "a text"}[annotation], bounds)
    if arguments and all(isinstance(part, str | int) for part in arguments):  # Literal
        return " | ".join(map(str, arguments))
    if getattr(annotation, "__origin__", None) is tuple:
        inner = [part for part in arguments if part is not Ellipsis]
        return f"a list of {allowed(inner[0]).removeprefix('a ')}" if inner else "a list"
    words = list(dict.fromkeys(allowed(part, bounds) for part in arguments))
    return " or ".join(words) or str(getattr(annotation, "__name__", annotation))


def _bounded(word: str, metadata: list[Any]) -> str:
    signs = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}
    reported: dict[str, Any] = {}
    for item in metadata:
        for part in getattr(item, "metadata", [item]):
            reported |= {key: getattr(part, key) for key in signs if getattr(part, key, None) is not None}
    return " ".join([word, *(f"{signs[key]} {value:g}" for key, value in reported.items())])
