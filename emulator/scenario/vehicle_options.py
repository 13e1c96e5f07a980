"""The table `vehicle_bus:` of a scenario: the ego's own motion on CAN, by a DBC file.

Belongs here: its keys, the DBC file that they name, and what of it can be sent. Not: the values (world), when frames
leave (instrument).
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator, Mapping
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from emulator.config.names import nearest
from emulator.config.tables import DescribedTable, Positive
from emulator.config.yaml_lines import Loc
from emulator.faults.kinds import VEHICLE, Target
from emulator.scenario.tables import Id
from protocols.can_frame import LONGEST_FRAME_BITS, MAX_DATA_BYTES
from protocols.can_objects.layout import database_of, layout_of
from protocols.session import LinkKind

NAME = VEHICLE
"Of the sender, where sensors have their ids."
BUILTIN = "builtin:"
CAN_LINKS = ("socketcand", "slcan", "can")

SOURCES = (
    "speed_m_s", "speed_km_h", "speed_mph", "speed_abs_m_s", "speed_abs_km_h", "speed_abs_mph", "direction",
    "yaw_rate_deg_s", "yaw_rate_rad_s", "steering_deg", "steering_rad", "steering_wheel_deg", "steering_wheel_rad",
    "counter",
)  # fmt: skip
"What a signal can be."
CHECKED = re.compile(r"e2e|data_?id\b|checksum|crc", re.IGNORECASE)
"Names of DBC attributes that say a message is protected end to end."
COUNTER_TYPES, CHECKSUM_TYPES = ("messagecounter",), ("messagechecksum",)
"Values of the attribute SigType."


class VehicleMessage(DescribedTable):
    """One message, and what its signals are."""

    cycle_ms: Annotated[float, Field(ge=1.0, le=60_000.0)] | None = None
    "None: as the DBC file has it."
    offset_ms: Annotated[float, Field(ge=0.0, le=60_000.0)] = 0.0
    "Of its first frame, after the start of the run."
    signals: Annotated[dict[str, str | float | int], Field(min_length=1)]
    "Signal -> a quantity of the ego, or a constant; others have their initial value of the DBC file, or 0."


class VehicleBus(DescribedTable):
    """The ego's speed, yaw rate and steering angle on CAN."""

    link: str
    "A CAN link, see `lidaremu list links`; sensors that name the same one share the bus."
    dbc: str
    "A DBC file, relative to this file, or `builtin:NAME`."
    actor: Id
    "The ego."
    messages: Annotated[dict[str, VehicleMessage], Field(min_length=1, max_length=64)]
    "By their names in the DBC file."
    wheelbase_m: Positive | None = None
    "For the steering angle."
    steering_ratio: Positive | None = None
    "Angle of the steering wheel over that of the wheels."


def dbc_path(name: str, folder: Path) -> Path:
    """Where a DBC file lies: `builtin:vehicle.dbc` in the package, everything else relative to `folder`."""
    if not name.startswith(BUILTIN):
        return folder / name
    plain = name[len(BUILTIN) :]
    for package in ("scenarios", "protocols.can_objects"):
        if plain in _dbc_names(package):
            return Path(str(files(package) / plain))
    return Path(str(files("scenarios") / "none"))


def _dbc_names(package: str) -> list[str]:
    return sorted(entry.name for entry in files(package).iterdir() if entry.name.endswith(".dbc"))


def builtin_dbcs() -> list[str]:
    """Names of the DBC files that come with the package."""
    return [BUILTIN + name for package in ("scenarios", "protocols.can_objects") for name in _dbc_names(package)]


def vehicle_target(table: Mapping[str, Any], folder: Path) -> Target:
    """This sender as faults know it; without messages that its DBC file lacks, or all where it cannot be read."""
    name, entries = table.get("dbc"), table.get("messages")
    messages: dict[str, tuple[str, ...]] = {}
    counted = []
    with contextlib.suppress(ValueError, OSError):
        known = {one.name: one for one in database_of(dbc_path(str(name), folder)).messages}
        for key, entry in entries.items() if isinstance(entries, dict) else ():
            signals = entry.get("signals") if isinstance(entry, dict) else None
            if key in known:
                messages[key] = tuple(signal.name for signal in known[key].signals)
                counted += [key] if isinstance(signals, dict) and "counter" in signals.values() else []
    url = table.get("link")
    urls = (url,) if isinstance(url, str) else ()
    return Target(NAME, NAME, VEHICLE, (LinkKind.CAN,), "motion", urls=urls, messages=messages, counted=tuple(counted))


def faults(data: Mapping[str, Any], folder: Path) -> Iterator[tuple[Loc, str, str]]:
    """What a file's `vehicle_bus:` cannot have; types are left to the model."""
    table = data.get(NAME)
    if not isinstance(table, dict):
        return
    actors, sensors = _ids(data, "actors"), _ids(data, "sensors")
    actor = table.get("actor")
    if isinstance(actor, str) and actor not in actors:
        yield (NAME, "actor"), repr(actor), nearest(actor, actors)
    if NAME in sensors:
        yield ("sensors", sensors.index(NAME), "id"), repr(NAME), "another id"
    yield from _link(table.get("link"))
    yield from _of_dbc(table, folder)


def _ids(data: Mapping[str, Any], key: str) -> list[str]:
    entries = data.get(key)
    return [str(one.get("id")) for one in entries if isinstance(one, dict)] if isinstance(entries, list) else []


def _link(url: object) -> Iterator[tuple[Loc, str, str]]:
    from emulator.transports.schemes import check_url

    if not isinstance(url, str):
        return
    if url.partition(":")[0] not in CAN_LINKS:
        yield (NAME, "link"), repr(url), f"a link of {', '.join(CAN_LINKS)}"
        return
    try:
        check_url(url)
    except (ValueError, ModuleNotFoundError) as error:
        found, _, want = str(error).partition("; want ")
        yield (NAME, "link"), found, want or "a link, see lidaremu list links"


def _of_dbc(table: Mapping[str, Any], folder: Path) -> Iterator[tuple[Loc, str, str]]:
    name, messages = table.get("dbc"), table.get("messages")
    if not isinstance(name, str):
        return
    path = dbc_path(name, folder)
    try:
        is_there = path.is_file()
    except (OSError, ValueError):
        is_there = False
    if not is_there:
        want = nearest(name, builtin_dbcs()) if name.startswith(BUILTIN) else "a DBC file, relative to this one"
        yield (NAME, "dbc"), f"{name!r}: no such file", want
        return
    try:
        database = database_of(path)
    except (ValueError, OSError) as error:
        yield (NAME, "dbc"), f"{name!r}: {error}", "a DBC file that cantools reads"
        return
    known = {message.name: message for message in database.messages}
    load_bits_s = 0.0
    for key, entry in messages.items() if isinstance(messages, dict) else ():
        place: Loc = (NAME, "messages", key)
        if key not in known:
            yield place, f"{key!r}: not in {name}", nearest(str(key), list(known))
        elif isinstance(entry, dict):
            yield from _message(place, known[key], entry, table)
            cycle_ms = entry.get("cycle_ms") or known[key].cycle_time
            if isinstance(cycle_ms, int | float) and cycle_ms >= 1:
                load_bits_s += 1000.0 * (LONGEST_FRAME_BITS - 64 + 8 * min(8, known[key].length)) / cycle_ms
    bitrate = _bitrate(table.get("link"))
    if load_bits_s > bitrate:
        yield (NAME, "messages"), f"{load_bits_s:.0f} bit/s at most", f"no more than the bus carries: {bitrate} bit/s"


def _bitrate(url: object) -> int:
    found = re.search(r"[?&]bitrate=(\d{1,9})\b", url) if isinstance(url, str) else None
    return int(found[1]) if found else 500_000


def _message(
    place: Loc, message: Any, entry: Mapping[str, Any], table: Mapping[str, Any]
) -> Iterator[tuple[Loc, str, str]]:
    if message.is_multiplexed() or message.is_container:
        yield place, f"{message.name} is multiplexed", "a message without a multiplexer"
        return
    if message.is_fd or message.length > MAX_DATA_BYTES:
        yield place, f"{message.name} has {message.length} bytes", "a classic CAN frame of at most 8 bytes"
        return
    protected = sorted(name for name in _attributes(message) if CHECKED.search(name))
    if protected:
        yield place, f"{message.name} is protected end to end: {', '.join(protected)}", "a message without checksum"
        return
    if entry.get("cycle_ms") is None and not message.cycle_time:
        yield (*place, "cycle_ms"), f"missing, and {message.name} has no GenMsgCycleTime", "a cycle time in ms"
    known = {signal.name: signal for signal in message.signals}
    signals = entry.get("signals")
    given = signals if isinstance(signals, dict) else {}
    for signal in message.signals:
        kind = _signal_type(signal)
        if kind in CHECKSUM_TYPES:
            yield place, f"{message.name}.{signal.name} is a checksum (SigType)", "a message without checksum"
        elif kind in COUNTER_TYPES and given.get(signal.name) != "counter":
            yield (*place, "signals"), f"{signal.name} is a message counter (SigType)", f"{signal.name}: counter"
    for key, value in given.items():
        where: Loc = (*place, "signals", key)
        if key not in known:
            yield where, f"{key!r}: not in {message.name}", nearest(str(key), list(known))
        elif known[key].is_float:
            yield where, f"{key} is a floating-point signal", "an integer signal with scale and offset"
        elif isinstance(value, str):
            yield from _source(where, value, known[key], table)
        elif isinstance(value, int | float) and not isinstance(value, bool):
            low, high = limits(known[key], message)
            if not low <= value <= high:
                yield where, str(value), f"{low:g} to {high:g}, the limits of {key}"


def _source(where: Loc, value: str, signal: Any, table: Mapping[str, Any]) -> Iterator[tuple[Loc, str, str]]:
    if value not in SOURCES:
        yield where, repr(value), f"a number, or {nearest(value, SOURCES)}"
    if value.startswith("steering") and table.get("wheelbase_m") is None:
        yield where, f"{value} without {NAME}.wheelbase_m", "the wheelbase"
    if value.startswith("steering_wheel") and table.get("steering_ratio") is None:
        yield where, f"{value} without {NAME}.steering_ratio", "the ratio of the steering"
    if value == "counter" and (signal.scale != 1 or signal.is_signed):
        yield where, f"counter in {signal.name}, which is scaled or signed", "an unsigned signal with scale 1"


def limits(signal: Any, message: Any) -> tuple[float, float]:
    """Of a signal's value, by its bits and the DBC file's range."""
    layout = layout_of(message).signals[signal.name]
    ends = [layout.raw_min * layout.scale + layout.offset, layout.raw_max * layout.scale + layout.offset]
    slack = 1e-6 * abs(layout.scale)
    return min(ends) - slack, max(ends) + slack


def _attributes(of: Any) -> Mapping[str, Any]:
    found = None if of.dbc is None else of.dbc.attributes
    return found or {}


def _signal_type(signal: Any) -> str:
    """The attribute SigType as text: its value is an index into the choices of its definition."""
    found = _attributes(signal).get("SigType")
    if found is None:
        return ""
    choices = found.definition.choices or []
    value = found.value
    named = choices[value] if isinstance(value, int) and 0 <= value < len(choices) else value
    return re.sub(r"[^a-z]", "", str(named).lower())
