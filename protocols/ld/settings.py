"""The `device` table of a scenario: what a real device keeps over power-off, and how this one is to be found.

`KEYS` is the only list of them: it validates, it gives the defaults, and it is what users are shown.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any

from protocols.errors import DeviceSettingError
from protocols.ld import config as cfg
from protocols.ld.models import IDENTITIES, Model
from protocols.ld.profiles import ALL_FIELDS
from protocols.ld.sectors import (
    MAX_MEASURING,
    MAX_MOTOR_HZ,
    MIN_MOTOR_HZ,
    TABLE_SIZE,
    TICKS,
    Function,
    MeasureError,
    Sector,
    Table,
    check,
    is_step,
    table_of,
    table_of_arcs,
)

TICKS_PER_DEG = TICKS // 360


@dataclass(frozen=True)
class Key:
    """One key of the table."""

    name: str
    allowed: str
    default: Any
    meaning: str
    takes: Callable[[Any], bool]


def _whole(low: int, high: int) -> Callable[[Any], bool]:
    return lambda value: type(value) is int and low <= value <= high


def _number(low: float, high: float) -> Callable[[Any], bool]:
    return lambda value: isinstance(value, int | float) and not isinstance(value, bool) and low <= value <= high


def _or_null(takes: Callable[[Any], bool]) -> Callable[[Any], bool]:
    return lambda value: value is None or takes(value)


def _listed(codes: Mapping[int, Any]) -> str:
    return ", ".join(map(str, codes.values()))


def _one_of(*values: Any) -> Callable[[Any], bool]:
    return lambda value: type(value) in {type(known) for known in values} and value in values


def _flag(value: Any) -> bool:
    return isinstance(value, bool)


def _ip(value: Any) -> bool:
    parts = value.split(".") if isinstance(value, str) else []
    return len(parts) == 4 and all(
        len(part) <= 3 and part.isascii() and part.isdigit() and int(part) <= 255 for part in parts
    )


def _ticks(degrees: Any) -> int | None:
    """Whole encoder ticks of an angle in degrees; None when it is none, or falls between two."""
    if isinstance(degrees, bool) or not isinstance(degrees, int | float):
        return None
    ticks = degrees * TICKS_PER_DEG
    return int(ticks) if ticks == ticks and abs(ticks) < 1e9 and ticks == int(ticks) else None


def _step(value: Any) -> bool:
    ticks = _ticks(value)
    return ticks is not None and is_step(ticks)


MODE_MEANING = "entered by itself at every power-on; null: idle, but measure when one of its links is udp"
IDENTITY_ALLOWED = f"texts of up to 12 ASCII characters by name: {', '.join(IDENTITIES.values())}"
FUNCTIONS = {"none": Function.NO_MEASUREMENT, "normal": Function.NORMAL, "reference": Function.REFERENCE}
SECTORS_ALLOWED = (
    "`full`, up to 4 measured arcs {from_deg:, to_deg:} in ascending order, or the device's own table of up to 8"
    " {stop_deg:, function: none | normal | reference}; clockwise, multiples of 0.0625 in 0..360"
)


def _identity(value: Any) -> bool:
    def fits(text: Any) -> bool:
        return isinstance(text, str) and text.isascii() and text.isprintable() and len(text) <= 12

    names = IDENTITIES.values()
    return isinstance(value, Mapping) and all(name in names and fits(text) for name, text in value.items())


KEYS = (
    Key(
        "motor_hz",
        "5..20, LD-LRS1000, 2100 and 3100: 5..10",
        10,
        "configured speed of the head, whole Hz",
        _whole(MIN_MOTOR_HZ, MAX_MOTOR_HZ),
    ),
    Key("step_deg", "multiple of 0.0625, from 0.125, that divides 360", 0.5, "configured angle step", _step),
    Key("sectors", SECTORS_ALLOWED, None, "sector table kept in flash; null: the model's arc", lambda value: True),
    Key("sensor_id", "1..254", 16, "address on RS-422 and CAN", _whole(1, 254)),
    Key("baud", _listed(cfg.BAUD_CODES), 115200, "speed of the serial line", _one_of(*cfg.BAUD_CODES.values())),
    Key("parity", _listed(cfg.PARITY_CODES), "none", "of the serial line", _one_of(*cfg.PARITY_CODES.values())),
    Key("stop_bits", "1, 2", 1, "of the serial line", _one_of(1, 2)),
    Key("can_kbit_s", _listed(cfg.CAN_RATE_CODES), 1000, "speed of the bus", _one_of(*cfg.CAN_RATE_CODES.values())),
    Key("can_host_id", "0..2047", 0x2A8, "base of the identifiers on which hosts send", _whole(0, 2047)),
    Key("can_host_mask", "0..2047", 0x003, "bits of the identifier that distinguish hosts", _whole(0, 2047)),
    Key("can_sensor_id", "0..1793", 0x700, "base of the device's own identifiers; sensor_id is added", _whole(0, 1793)),
    Key("ip", "IPv4 address", "192.168.1.10", "reported by GET_CONFIG; the real address is that of the link", _ip),
    Key("netmask", "IPv4 mask", "255.255.255.0", "reported by GET_CONFIG", _ip),
    Key("gateway", "IPv4 address", "0.0.0.0", "reported by GET_CONFIG", _ip),
    Key("near_field_suppression", "true, false", False, "filter 0001, until a host changes it", _flag),
    Key("identity", IDENTITY_ALLOWED, {}, "answers to GET_IDENTIFICATION", _identity),
    Key("delays", "real, fast", "real", "response, spin-up and boot times", _one_of("real", "fast")),
    Key("spin_up_s", "0..60, or null", None, "spin-up to any speed; null: that of `delays`", _or_null(_number(0, 60))),
    Key("start", "running, cold", "running", "running: booted when the run begins", _one_of("running", "cold")),
    Key(
        "services",
        "strict, liberal",
        "strict",
        "strict: by state, as the listing has them; liberal: whatever makes sense in any state",
        _one_of("strict", "liberal"),
    ),
    Key("mode", "idle, rotate, measure, or null", None, MODE_MEANING, _one_of("idle", "rotate", "measure", None)),
    Key("udp_format", f"0..{ALL_FIELDS}", 0x3DFF, "format of the profiles on udp links", _whole(0, ALL_FIELDS)),
    Key("zero_deg", "-360..360", 0, "azimuth of direction 0 in the sensor's own frame", _number(-360, 360)),
    Key("clock_ms", "0..4294967295", 0, "the device's clock at power-on", _whole(0, 2**32 - 1)),
    Key("clock_ppm", "-100000..100000", 0, "how much too fast that clock runs", _whole(-100_000, 100_000)),
)
"Every key of `device:`."


@dataclass(frozen=True)
class Settings:
    """A valid `device` table."""

    config: cfg.Config
    sectors: Table
    near_field: bool
    identity: Mapping[str, str]
    delays: str
    spin_up_ns: int | None
    starts_running: bool
    is_strict: bool
    "Services outside the states that the listing gives them are refused."
    mode: str | None
    udp_format: int
    zero_ticks: float
    clock_ms: int
    clock_ppm: int


def settings_of(device: Mapping[str, Any], model: Model) -> Settings:
    """Check a `device` table and fill it in; `DeviceSettingError` names the key at fault."""
    known = {key.name: key for key in KEYS}
    for name, found in device.items():
        if name not in known:
            near = get_close_matches(str(name), known, 1)
            hint = f"`{near[0]}`, or one of: " if near else "one of: "
            raise DeviceSettingError(str(name), found, hint + ", ".join(known))
        if not known[name].takes(found):
            raise DeviceSettingError(name, found, known[name].allowed)
    values = {key.name: device.get(key.name, key.default) for key in KEYS}
    step = int(values["step_deg"] * TICKS_PER_DEG)
    if values["motor_hz"] > model.fastest_hz:
        raise DeviceSettingError("motor_hz", values["motor_hz"], known["motor_hz"].allowed)
    sectors = _table(_arc_of(model) if values["sectors"] is None else values["sectors"], step)
    if values["mode"] == "measure":
        verdict = check(sectors, values["motor_hz"], step)
        if verdict is not MeasureError.OK:
            allowed = f"a speed, step and sectors that can be measured (TRANS_MEASURE error {verdict}, {verdict.name})"
            raise DeviceSettingError("mode", values["mode"], allowed)
    return Settings(
        config=_config(values, step),
        sectors=sectors,
        near_field=values["near_field_suppression"],
        identity=model.identities() | dict(values["identity"]),
        delays=values["delays"],
        spin_up_ns=None if values["spin_up_s"] is None else round(values["spin_up_s"] * 1e9),
        starts_running=values["start"] == "running",
        is_strict=values["services"] == "strict",
        mode=values["mode"],
        udp_format=values["udp_format"],
        zero_ticks=float(values["zero_deg"]) * TICKS_PER_DEG,
        clock_ms=values["clock_ms"],
        clock_ppm=values["clock_ppm"],
    )


def _arc_of(model: Model) -> Any:
    """What a model measures as delivered."""
    return "full" if model.useful_deg == 360 else [{"from_deg": 0, "to_deg": model.useful_deg}]


def _code(codes: Mapping[int, Any], value: Any) -> int:
    return next(code for code, meaning in codes.items() if meaning == value)


def _config(values: Mapping[str, Any], step: int) -> cfg.Config:
    octets = [int(part) for name in ("ip", "netmask", "gateway") for part in values[name].split(".")]
    serial = (_code(cfg.BAUD_CODES, values["baud"]), _code(cfg.PARITY_CODES, values["parity"]), values["stop_bits"], 8)
    rate = _code(cfg.CAN_RATE_CODES, values["can_kbit_s"])
    can = (rate, values["can_host_id"], values["can_host_mask"], values["can_sensor_id"], cfg.NO_BROADCAST)
    return {
        **cfg.FACTORY,
        cfg.SERIAL: serial,
        cfg.CAN: can,
        cfg.ETHERNET: (*octets, *cfg.FACTORY[cfg.ETHERNET][12:]),
        cfg.GLOBAL: (values["sensor_id"], values["motor_hz"], step),
    }


def _table(value: Any, step: int) -> Table:
    """The sector table that `sectors` stands for."""
    if value == "full":
        return table_of([Sector(Function.NORMAL, TICKS - step)])
    listed = value if isinstance(value, list | tuple) else []
    entries = [entry if isinstance(entry, Mapping) else {} for entry in listed]
    keys = {frozenset(entry) for entry in entries}
    found = None
    if keys == {frozenset({"from_deg", "to_deg"})}:
        found = _arcs([(_ticks(entry["from_deg"]), _ticks(entry["to_deg"])) for entry in entries], step)
    elif keys == {frozenset({"stop_deg", "function"})}:
        found = _entries([(_ticks(entry["stop_deg"]), entry["function"]) for entry in entries])
    if found is None:
        raise DeviceSettingError("sectors", value, SECTORS_ALLOWED)
    return found


def _arcs(arcs: list[tuple[int | None, int | None]], step: int) -> Table | None:
    known = [(start, stop) for start, stop in arcs if start is not None and stop is not None]
    borders = [border for arc in known for border in arc]
    if len(known) < len(arcs) or len(arcs) > MAX_MEASURING or min(borders) < 0 or max(borders) > TICKS:
        return None
    if borders[-1] < borders[-2] and borders[-1] < borders[0]:  # the last arc may run through direction 0
        borders[-1] += TICKS
    if borders != sorted(borders):
        return None
    pairs = zip(borders[::2], borders[1::2], strict=True)
    return table_of_arcs([(start, stop - step if stop - start == TICKS else stop) for start, stop in pairs], step)


def _entries(entries: list[tuple[int | None, Any]]) -> Table | None:
    known = [
        Sector(FUNCTIONS[name], stop)
        for stop, name in entries
        if stop is not None and 0 <= stop < TICKS and isinstance(name, str) and name in FUNCTIONS
    ]
    return table_of(known) if len(known) == len(entries) <= TABLE_SIZE else None
