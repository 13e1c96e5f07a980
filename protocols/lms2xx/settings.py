"""The `device:` table of a scenario: settings that a real LMS2xx retains over power cycles, and emulator options.

`KEYS` is the list of it; `read` checks a table and makes `Settings` of it. Nothing here changes during a run.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from protocols.errors import DeviceSettingError
from protocols.lms2xx import configuration as block
from protocols.lms2xx.models import Model
from protocols.lms2xx.timing import DELAYS, Delays
from protocols.lms2xx.values import MEASURING_MODES
from protocols.lms2xx.variants import FAST, STANDARD, VARIANTS, Variant
from protocols.session import DeviceKey

RATES = (9600, 19200, 38400, 500000)
LENIENT_GAP_S = 0.2
"""Longest pause inside a telegram unless the device's own rule is asked for: far above what a pseudo-terminal, an
adapter or a network puts between bytes, below the 250 ms after which the quickest driver repeats."""
STRICT_GAP_S = 0.006
"Listing 4.3, p. 24 (via Gepruft_Lidar)."


@dataclass(frozen=True)
class Settings:
    """A checked `device:` table."""

    variant: Variant
    configuration: bytes
    address: int
    password: bytes
    startup_baud: int
    permanent_baud: bool
    errors: tuple[tuple[int, int], ...]
    "Type and code of each stored error, oldest first."
    operating_hours: float
    switch_ons: int
    serial_number: bytes
    status_bits: int
    "Severity, restart input, implausible, pollution: joined to the model's status byte."
    delays: Delays
    starts_running: bool
    gap_ns: int
    strict_gap: bool
    aborts: bool
    "A request cuts off the telegram of measured values on the line."


KEYS = (
    DeviceKey(
        "resolution_deg", "1, 0.5, 0.25 (S14: 0.5)", "0.5", "angular step at power-on; the host changes it with 3B"
    ),
    DeviceKey("field_deg", "180, 100 (S14: 90); 0.25 deg has 100 only", "180", "field of view at power-on"),
    DeviceKey("unit", "cm, mm, dm", "cm (LMS200/220: mm)", "configuration byte E"),
    DeviceKey(
        "measuring_mode", "a name or number of the table of modes", "8m-fields-a-b-dazzle", "configuration byte D"
    ),
    DeviceKey("sensitivity", "standard, medium, low, high", "standard", "configuration byte B high; not LMS200/220"),
    DeviceKey("availability", "0..7", "0", "configuration byte C"),
    DeviceKey("real_time_indices", "true, false", "false", "bit 1 of configuration byte C"),
    DeviceKey(
        "configuration", "1 to 34 bytes in hex", "factory block", "front of the block; the keys above come after it"
    ),
    DeviceKey(
        "firmware", "V, X or S and a version: V02.10", "the model's", "before V02.10, X01.10: 32-byte configuration"
    ),
    DeviceKey("address", "0..127", "0", "own address; requests to 0 are always answered"),
    DeviceKey("password", "8 ASCII characters", "SICK_LMS", "of installation mode"),
    DeviceKey(
        "baud",
        "9600, 19200, 38400, 500000",
        "9600",
        "line speed after power-on; other than 9600 it is a permanent rate",
    ),
    DeviceKey("serial_number", "up to 8 ASCII characters", "00000001", "status telegram, bytes 9-16"),
    DeviceKey("errors", "list of {code, severity, present}", "empty", "stored errors, oldest first (32)"),
    DeviceKey("operating_hours", "number >= 0", "0", "operating data counter (35)"),
    DeviceKey("switch_ons", "0..65535", "0", "operating data counter (35), before this run"),
    DeviceKey("severity", "0..4: ok, info, warning, error, fatal", "0", "bits 0-2 of the status byte"),
    DeviceKey("restart_input", "true, false", "false", "bit 5 of the status byte"),
    DeviceKey("implausible", "true, false", "false", "bit 6 of the status byte"),
    DeviceKey("pollution", "true, false", "false", "bit 7 of the status byte"),
    DeviceKey("delays", "fast, real, or a table of seconds over fast", "fast", "how long replies take"),
    DeviceKey("boot_s", "number >= 0", "2 fast, 25 real", "from power-on or reset to the power-on telegram"),
    DeviceKey("start", "running, cold", "running", "running: has booted and is silent when the run begins"),
    DeviceKey(
        "strict_gap",
        "true, false",
        "true with delays: real",
        "6 ms between bytes of a request end it, as on a real line",
    ),
    DeviceKey(
        "interrupt",
        "abort, finish",
        "abort",
        "a request cuts off the telegram of values that is being sent, or waits until it has left",
    ),
    DeviceKey("gap_s", "number > 0", "0.2 (strict 0.006)", "longest pause between bytes of a request"),
)
"Every key of `device:`. A real LMS returns to 180 deg at 0.5 deg at power-on; the emulated one to the table."


def read(table: Mapping[str, Any], model: Model) -> Settings:
    """Check a `device:` table. Raises `DeviceSettingError` naming key, value and what is allowed."""
    allowed = {key.name: key for key in KEYS}
    for name, value in table.items():
        if name not in allowed:
            raise DeviceSettingError(str(name), value, f"one of the keys {', '.join(allowed)}")
    take = _Taker(table, allowed)
    strict = take.flag("strict_gap") if "strict_gap" in table else table.get("delays") == "real"
    gap_s = take.number("gap_s", STRICT_GAP_S if strict else LENIENT_GAP_S, positive=True)
    baud = take.choice("baud", RATES, RATES[0])
    severity = take.integer("severity", 0, 0, 4)
    return Settings(
        variant=_variant(take, model),
        configuration=_configuration(take, model),
        address=take.integer("address", 0, 0, 127),
        password=_password(take),
        startup_baud=baud,
        permanent_baud=baud != RATES[0],
        errors=_errors(take),
        operating_hours=take.number("operating_hours", 0.0),
        switch_ons=take.integer("switch_ons", 0, 0, 0xFFFF),
        serial_number=take.text("serial_number", "00000001", range(9)).ljust(8).encode("ascii"),
        status_bits=severity
        | take.flag("restart_input") << 5
        | take.flag("implausible") << 6
        | take.flag("pollution") << 7,
        delays=_delays(take),
        starts_running=take.choice("start", ("running", "cold"), "running") == "running",
        gap_ns=round(gap_s * 1e9),
        strict_gap=strict,
        aborts=take.choice("interrupt", ("abort", "finish"), "abort") == "abort",
    )


class _Taker:
    """Values of the table, each checked; an error has what `KEYS` allows."""

    def __init__(self, table: Mapping[str, Any], keys: Mapping[str, DeviceKey]) -> None:
        self.table = table
        self._keys = keys

    def wrong(self, name: str, found: object, allowed: str | None = None) -> DeviceSettingError:
        return DeviceSettingError(name, found, allowed or self._keys[name.partition(".")[0]].allowed)

    def flag(self, name: str) -> bool:
        found = self.table.get(name, False)
        if not isinstance(found, bool):
            raise self.wrong(name, found)
        return bool(found)

    def integer(self, name: str, default: int, low: int, high: int) -> int:
        found = self.table.get(name, default)
        if isinstance(found, bool) or not isinstance(found, int) or not low <= found <= high:
            raise self.wrong(name, found)
        return int(found)

    def number(self, name: str, default: float, positive: bool = False) -> float:
        return self.seconds(name, self.table.get(name, default), positive)

    def seconds(self, name: str, found: object, positive: bool = False) -> float:
        if isinstance(found, bool) or not isinstance(found, int | float):
            raise self.wrong(name, found)
        if not 0 <= found < 1e9 or (positive and found == 0):
            raise self.wrong(name, found)
        return float(found)

    def choice(self, name: str, among: Any, default: Any) -> Any:
        found = self.table.get(name, default)
        if isinstance(found, bool) or not isinstance(found, str | int | float) or found not in among:
            raise self.wrong(name, found)
        return type(default)(found)

    def text(self, name: str, default: str, lengths: range) -> str:
        found = self.table.get(name, default)
        if not isinstance(found, str) or not found.isascii() or len(found) not in lengths:
            raise self.wrong(name, found)
        return str(found)


def _variant(take: _Taker, model: Model) -> Variant:
    standard = FAST if model.fast else STANDARD
    field = take.table.get("field_deg", None)
    step = take.choice("resolution_deg", (1, 0.5, 0.25), standard.step_cdeg / 100)
    if field is None:
        field = 100 if step == 0.25 and not model.fast else standard.field_deg
    step_cdeg = round(step * 100)
    for variant in (FAST,) if model.fast else VARIANTS:
        if (variant.field_deg, variant.step_cdeg) == (field, step_cdeg) and not isinstance(field, bool):
            return variant
    name = "field_deg" if "field_deg" in take.table else "resolution_deg"
    raise take.wrong(name, take.table[name])


def _configuration(take: _Taker, model: Model) -> bytes:
    start = block.default_block(model.indoor)[: model.config_bytes]
    text = take.table.get("configuration", "")
    try:
        front = bytes.fromhex(text) if isinstance(text, str) else None
    except ValueError:
        front = None
    if front is None or len(front) > 34 or ("configuration" in take.table and not front):
        raise take.wrong("configuration", text)
    given = block.write(start, front, model.has_sensitivity)
    if given is None:
        raise take.wrong("configuration", text, "a block with allowed bytes B high, D and E")
    made = bytearray(given)
    if "unit" in take.table:
        made[block.UNIT] = block.UNITS[take.choice("unit", block.UNITS, "cm")]
    if "measuring_mode" in take.table:
        made[block.MEASURING_MODE] = _measuring_mode(take)
    if "sensitivity" in take.table:
        if not model.has_sensitivity:
            raise take.wrong("sensitivity", take.table["sensitivity"], "no such key: this model has no such setting")
        made[block.SENSITIVITY] = block.SENSITIVITIES[take.choice("sensitivity", block.SENSITIVITIES, "standard")]
    if "availability" in take.table:
        made[block.AVAILABILITY] = take.integer("availability", 0, 0, 7)
    if "real_time_indices" in take.table:
        made[block.AVAILABILITY] &= ~block.INDICES
        made[block.AVAILABILITY] |= block.INDICES if take.flag("real_time_indices") else 0
    return bytes(made)


def _measuring_mode(take: _Taker) -> int:
    found = take.table["measuring_mode"]
    for code, mode in MEASURING_MODES.items():
        if not isinstance(found, bool) and found in (code, mode.name):
            return code
    names = ", ".join(f"{mode.name} ({code})" for code, mode in MEASURING_MODES.items())
    raise take.wrong("measuring_mode", found, f"one of {names}")


def _password(take: _Taker) -> bytes:
    return take.text("password", "SICK_LMS", range(8, 9)).encode("ascii")


def _errors(take: _Taker) -> tuple[tuple[int, int], ...]:
    found = take.table.get("errors", [])
    if not isinstance(found, list | tuple):
        raise take.wrong("errors", found)
    stored = []
    allowed_errors = next(key for key in KEYS if key.name == "errors")
    for place, entry in enumerate(found):
        key = f"errors.{place}"
        if not isinstance(entry, Mapping) or not set(entry) <= {"code", "severity", "present"} or "code" not in entry:
            raise take.wrong(key, entry, "{code: 0..255, severity: 0..4, present: true or false}")
        inner = _Taker({f"{key}.{name}": value for name, value in entry.items()}, {"errors": allowed_errors})
        severity = inner.integer(f"{key}.severity", 3, 0, 4)
        gone = 0 if inner.table.get(f"{key}.present", True) is True else 0x80
        if not isinstance(inner.table.get(f"{key}.present", True), bool):
            raise take.wrong(f"{key}.present", entry["present"], "true, false")
        stored.append((severity | gone, inner.integer(f"{key}.code", 0, 0, 255)))
    if len(stored) > 200:
        raise take.wrong("errors", len(stored), "at most 200 entries")
    return tuple(stored)


def _delays(take: _Taker) -> Delays:
    found = take.table.get("delays", "fast")
    if isinstance(found, str) and found in DELAYS:
        delays = DELAYS[found]
    elif isinstance(found, Mapping):
        names = Delays.names()
        for name in found:
            if name not in names:
                raise take.wrong(f"delays.{name}", found[name], f"one of {', '.join(names)}")
        delays = replace(DELAYS["fast"], **{str(n): take.seconds(f"delays.{n}", s) for n, s in found.items()})
    else:
        raise take.wrong("delays", found)
    if "boot_s" in take.table:
        delays = replace(delays, boot_s=take.number("boot_s", 0.0))
    return delays
