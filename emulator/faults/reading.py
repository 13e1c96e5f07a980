"""An entry of `faults:`, or of a live order, judged: what is wrong with it, or the fault that it is.

Belongs here: which keys fit together, on which sensor. Not: what the keys mean (config, the layers).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from pydantic import ValidationError

from emulator.config.names import nearest
from emulator.errors import EmulatorError
from emulator.faults.catalogue import kinds, taken_keys
from emulator.faults.config import MOMENTS, OF_TELEGRAMS, TRIGGERS, Common
from emulator.faults.kinds import Keys, Kind, Target
from protocols.session import LinkKind

Problem = tuple[tuple[str | int, ...], str, str]
"Key, what was found, what is wanted."

SERIAL_SCHEMES = ("pty", "serial")
CAN_SCHEMES = ("socketcand", "slcan", "can")


class FaultError(EmulatorError, ValueError):
    """A fault that cannot be; `key: found; want allowed`."""


@dataclass(frozen=True)
class Fault:
    """One fault, judged."""

    kind: Kind
    common: Common
    keys: Keys

    @property
    def sensor(self) -> str:
        """The sensor it is on."""
        return self.common.on

    @cached_property
    def moment(self) -> str | None:
        """Its trigger beside `at_s`."""
        return next((name for name in MOMENTS if getattr(self.common, name) is not None), None)


def frozen(data: Any) -> Any:
    """Lists as tuples, which the strict models take."""
    if isinstance(data, Mapping):
        return {key: frozen(value) for key, value in data.items()}
    return tuple(frozen(value) for value in data) if isinstance(data, list | tuple) else data


def link_kind(url: str, tcp_is_line: bool) -> LinkKind:
    """The kind of link that a text will open."""
    scheme = url.partition(":")[0]
    if scheme in SERIAL_SCHEMES:
        return LinkKind.SERIAL
    if scheme in CAN_SCHEMES:
        return LinkKind.CAN
    if scheme == "udp":
        return LinkKind.SERIAL if tcp_is_line else LinkKind.DATAGRAM
    return LinkKind.SERIAL if tcp_is_line else LinkKind.STREAM


def target_of(
    sensor: str, model: str, links: Sequence[str], device: Mapping[str, Any], actors: Sequence[str] | None = None
) -> Target:
    """What is known of a sensor before a run; `actors` of its scene."""
    from emulator.sensors.spec import load_spec
    from protocols import families, family
    from protocols.wire import wire_of

    spec = load_spec(model)
    found: tuple[LinkKind, ...] = ()
    if spec.family in families():
        is_line = family(str(spec.family)).tcp_is_line
        wire = wire_of(spec.family)
        default = "can:x" if wire is not None and wire.on_can_only else "tcp:x"
        found = tuple(link_kind(url, is_line) for url in links or (default,))
    known = None if actors is None else tuple(actors)
    return Target(sensor, model, spec.family, found, spec.sees, spec.device, device, tuple(links), known)


def problems(
    entry: Mapping[str, Any], target: Target | None, known: Callable[[str], None], live: bool = False
) -> Iterator[Problem]:
    """Everything that is wrong with an entry; `known` raises `ExpressionError` for an expression that means nothing.

    `target` is None where the sensor is not known: then only what does not depend on it is judged.
    """
    from emulator.faults.can import unknown_message

    name = entry.get("do")
    if not isinstance(name, str):
        return  # the models tell it
    kind = kinds().get(name)
    if kind is None:
        yield ("do",), repr(name), f"a fault: {nearest(name, kinds())}"
        return
    taken = taken_keys(kind)
    given = {key for key, value in entry.items() if value is not None}
    allowed = [*taken, *kind.keys.model_fields]
    for key in entry:
        if key not in ("on", "do", *allowed):
            why = f"{name} does not have it" if key in Common.model_fields else "unknown key"
            yield (key,), why, nearest(key, allowed)
    own = {key: value for key, value in entry.items() if key in kind.keys.model_fields}
    keys, wrong = judged(kind.keys, own)
    yield from wrong
    yield from _triggers(entry, given, kind, live, known)
    if target is None:
        return
    unfit = kind.unfit(target)
    if unfit is not None:
        found, _, want = unfit.partition("; want ")
        yield ("do",), f"{name}: {found}", want
        return
    link = entry.get("link")
    link = link if type(link) is int and 0 <= link <= 63 else None  # what is no number at all the models tell
    if isinstance(link, int) and link >= max(1, len(target.links)):
        yield ("link",), str(link), f"a number below {max(1, len(target.links))}: {target.sensor} has no more links"
    elif isinstance(link, int) and kind.links and target.links and target.links[link] not in kind.links:
        wanted = " or ".join(one.value for one in kind.links)
        yield ("link",), f"link {link} is of the kind {target.links[link].value}", f"a {wanted} link for {name}"
    label = entry.get("label")
    reported = unknown_message(label, target) if isinstance(label, str) else None
    if reported is not None:
        found, _, want = reported.partition("; want ")
        yield ("label",), found, want
    common, _ = judged(Common, {key: value for key, value in entry.items() if key in Common.model_fields})
    if kind.check is not None and keys is not None and isinstance(common, Common):
        reported = kind.check(keys, common, target)
        if reported is not None:
            found, _, want = reported.partition("; want ")
            yield ("do",), f"{name}: {found}", want


def _triggers(
    entry: Mapping[str, Any], given: set[str], kind: Kind, live: bool, known: Callable[[str], None]
) -> Iterator[Problem]:
    from emulator.config.expressions import ExpressionError

    moments = [name for name in MOMENTS if name in given]
    if not live and not given & set(TRIGGERS):
        yield ("do",), f"{kind.name} without a trigger", f"one of {', '.join(TRIGGERS)}"
    if len(moments) > 1:
        yield (moments[1],), f"beside {moments[0]}", "one trigger beside at_s"
    lasting = [name for name in ("for_s", "for_telegrams") if name in given]
    if len(lasting) > 1:
        yield ("for_telegrams",), "beside for_s", "one of both"
    direction = entry.get("direction")
    if kind.directions and isinstance(direction, str) and direction not in kind.directions:
        yield ("direction",), repr(direction), " or ".join(kind.directions)
    if direction == "from_host" or kind.directions == ("from_host",):
        for key in ("of", "label"):
            if key in given:
                yield (key,), "beside direction from_host", "this key omitted: data of hosts has no such names"
    text = entry.get("when")
    if isinstance(text, str):
        try:
            known(text)
        except ExpressionError as error:
            found, _, want = str(error).partition("; want ")
            yield ("when",), f"{text!r}: {found}", want or "an expression that is true or false"


def judged(model: type[Any], values: Mapping[str, Any]) -> tuple[Any | None, list[Problem]]:
    """A model of these values, or what is wrong with them."""
    from emulator.config.yaml_source import reported

    try:
        return model.model_validate(frozen(values)), []
    except ValidationError as exc:
        return None, reported(model, values, exc)


def read(entry: Mapping[str, Any], target: Target, known: Callable[[str], None], live: bool = False) -> Fault:
    """The fault of an entry; `FaultError` has a line for everything that is wrong with it."""
    common, wrong = judged(Common, {key: value for key, value in entry.items() if key in Common.model_fields})
    wrong += problems(entry, target, known, live)
    if wrong or common is None:
        lines = dict.fromkeys(f"{'.'.join(map(str, key))}: {found}; want {want}" for key, found, want in wrong)
        raise FaultError.of(lines)
    kind = kinds()[common.do]
    own = {key: value for key, value in entry.items() if key in kind.keys.model_fields}
    return Fault(kind, common, kind.keys.model_validate(frozen(own)))


__all__ = ["OF_TELEGRAMS", "Fault", "FaultError", "Problem", "problems", "read", "target_of"]
