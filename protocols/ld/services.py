"""What each service does. `COMMANDS` is the only list of them: dispatcher, start-up check, coverage table.

A handler gets the device and the request's data words and gives an `Answer`; it knows neither link nor framing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from protocols.errors import ProtocolError
from protocols.ld import config as cfg
from protocols.ld.device import HOST_SIGNALS, Device
from protocols.ld.models import IDENTITIES
from protocols.ld.profiles import ALL_FIELDS
from protocols.ld.sectors import MAX_MOTOR_HZ, MIN_MOTOR_HZ, TABLE_SIZE, TICKS, Function, MeasureError, Sector
from protocols.ld.telegrams import REFUSED, Mode, Motor, text_words
from protocols.session import CommandRow, DropReason


@dataclass(frozen=True)
class StartProfiles:
    """A host wants profiles."""

    number: int
    "0: until cancelled."
    form: int


@dataclass(frozen=True)
class Answer:
    """What becomes of a request."""

    words: tuple[int, ...] | None = ()
    "Data of the reply; None: no reply of its own, profiles follow."
    refused: DropReason | None = None
    failure: bool = False
    "Answered by SERVICE_FAILURE instead of its own reply."
    detail: str = ""
    when_at_speed: Handler | None = None
    "Answered by this instead, once the head is at speed or has been told otherwise."
    start: StartProfiles | None = None
    stops_profiles: bool = False
    "The caller's own profiles end. Those of all hosts end whenever MEASURE is left."
    boots_ns: int | None = None
    "The device starts anew once the reply has been sent, and takes this long."
    line_speed: int | None = None


Words = tuple[int, ...]
Handler = Callable[[Device, Words, int], Answer]


def fails(reason: DropReason, detail: str) -> Answer:
    """Answered by SERVICE_FAILURE."""
    return Answer(refused=reason, failure=True, detail=detail)


def refuses(words: Words, detail: str) -> Answer:
    """Answered by the service's own code of refusal."""
    return Answer(words, refused=DropReason.BAD_ARGUMENT, detail=detail)


# status services


def _get_identification(device: Device, words: Words, now_ns: int) -> Answer:
    name = IDENTITIES.get(words[0])
    if name is None:
        return fails(DropReason.BAD_ARGUMENT, f"item {words[0]:04X}")
    return Answer((*text_words(device.settings.identity[name]), *device.status))


def _get_status(device: Device, words: Words, now_ns: int) -> Answer:
    return Answer(device.status)


def _get_signal(device: Device, words: Words, now_ns: int) -> Answer:
    return Answer((device.port,))


def _set_signal(device: Device, words: Words, now_ns: int) -> Answer:
    if words[0] > 0xFF:
        return refuses((REFUSED,), f"port value {words[0]:04X}")
    device.signals = words[0] & HOST_SIGNALS
    return Answer((device.port,))


def _accept(device: Device, words: Words, now_ns: int) -> Answer:
    return Answer((0,))


# configuration services


def _set_config(device: Device, words: Words, now_ns: int) -> Answer:
    item, before = words[0], device.config
    if not device.set_config(item, words[1:]):
        return refuses((REFUSED,), f"item {item:04X}: {' '.join(f'{word:04X}' for word in words[1:])}")
    baud = device.config[cfg.SERIAL][0]
    return Answer((0,), line_speed=cfg.BAUD_CODES[baud] if baud != before[cfg.SERIAL][0] else None)


def _get_config(device: Device, words: Words, now_ns: int) -> Answer:
    item = words[0]
    if item not in cfg.ITEMS or (item == cfg.INTERLACE and not device.model.has_interlace):
        return fails(DropReason.BAD_ARGUMENT, f"item {item:04X}")
    return Answer((item, *device.config[item]))


def _set_time_absolute(device: Device, words: Words, now_ns: int) -> Answer:
    device.shift_clock(now_ns, words[0] - device.clock_ms(now_ns))
    return _get_clock(device, words, now_ns)


def _set_time_relative(device: Device, words: Words, now_ns: int) -> Answer:
    device.shift_clock(now_ns, words[0] - (words[0] >> 15 << 16))
    return _get_clock(device, words, now_ns)


def _get_clock(device: Device, words: Words, now_ns: int) -> Answer:
    return Answer((device.clock_ms(now_ns) & 0xFFFF,))


def _set_filter(device: Device, words: Words, now_ns: int) -> Answer:
    if words[0] != 1 or words[1] > 1:
        return refuses((REFUSED,), f"filter {words[0]:04X} {words[1]:04X}")
    device.near_field = bool(words[1])
    return Answer((1,))


def _set_function(device: Device, words: Words, now_ns: int) -> Answer:
    number, function, stop, flash = words[:4]
    known = function in (0, 1, 3, 4)
    if number >= TABLE_SIZE or not known or flash > 1 or (function and stop >= TICKS):
        # sicktoolbox and COMTEST look for FFFF in the sector's place
        return refuses((REFUSED, REFUSED, stop), f"sector {number}, function {function}, stop {stop}, flash {flash}")
    # a stop beyond the circle is taken where it means nothing (Miro clears its sectors with FFF0)
    device.set_sector(number, Sector(Function(function), stop if function else 0), bool(flash))
    return Answer((number, function, stop))


def _get_function(device: Device, words: Words, now_ns: int) -> Answer:
    if words[0] >= TABLE_SIZE:
        return refuses((REFUSED, REFUSED, 0), f"sector {words[0]}")
    sector = device.sectors[words[0]]
    return Answer((words[0], sector.function, sector.stop))


# measuring services


def _get_profile(device: Device, words: Words, now_ns: int) -> Answer:
    number, form = words[:2]
    if form > ALL_FIELDS:
        return fails(DropReason.BAD_ARGUMENT, f"format {form:04X}")
    if device.mode is not Mode.MEASURE:
        return fails(DropReason.WRONG_MODE, f"not measuring but in {device.mode.name}")
    return Answer(None, start=StartProfiles(number, form), stops_profiles=True)


def _cancel_profile(device: Device, words: Words, now_ns: int) -> Answer:
    return Answer(device.status, stops_profiles=True)


# working services

RELOAD_VOLTAGE = 0x10
"DO_RESET level that Fawkes names; without effect here."


def _do_reset(device: Device, words: Words, now_ns: int) -> Answer:
    level = words[0]
    if level in (0, 1):
        boots_ns = device.delays.boot_ns if level == 0 else device.delays.restart_ns
        return Answer((level,), boots_ns=boots_ns)
    if level == 2:
        device.idle(now_ns)
        return Answer((level,))
    if level == RELOAD_VOLTAGE:
        return Answer((level,))
    return fails(DropReason.BAD_ARGUMENT, f"level {level:04X}")


def _trans_idle(device: Device, words: Words, now_ns: int) -> Answer:
    device.idle(now_ns)
    return Answer(device.status)


def _trans_rotate(device: Device, words: Words, now_ns: int) -> Answer:
    hz = words[0] or device.configured_hz
    if not MIN_MOTOR_HZ <= hz <= MAX_MOTOR_HZ:
        return fails(DropReason.BAD_ARGUMENT, f"{hz} Hz")
    if device.motor is Motor.STOPPED:
        return Answer(device.status, refused=DropReason.WRONG_MODE, detail="motor stopped")
    device.rotate(now_ns, hz)
    return Answer(when_at_speed=_get_status)


def _trans_measure(device: Device, words: Words, now_ns: int) -> Answer:
    if device.motor is Motor.STOPPED:
        return fails(DropReason.WRONG_MODE, "motor stopped")
    if device.rotation is None and device.spin_up is None:
        device.rotate(now_ns, device.configured_hz)
    return Answer(when_at_speed=_measure_now)


def _measure_now(device: Device, words: Words, now_ns: int) -> Answer:
    if device.rotation is None or device.spin_up is not None:
        return fails(DropReason.WRONG_MODE, "told otherwise before the head was at speed")
    verdict = device.measure()
    if verdict is MeasureError.OK:
        return Answer((*device.status, verdict))
    return Answer((*device.status, verdict), refused=DropReason.BAD_ARGUMENT, detail=f"error {verdict}, {verdict.name}")


# monitor services


def _monitor(device: Device, words: Words, now_ns: int) -> Answer:
    return Answer((0,)) if words[0] <= 1 else refuses((REFUSED,), f"{words[0]:04X}")


@dataclass(frozen=True)
class Command:
    """One row: a service, how many data words it needs, and who carries it out (None: nobody, refused by name)."""

    name: str
    words: int
    handler: Handler | None
    source: str
    note: str = ""


SOURCES = {
    "TBX": "sicktoolbox",
    "DGC": "Stanford ldlrs",
    "FWK": "Fawkes",
    "MIR": "Miro laser360",
    "CMT": "COMTEST",
    "HDE": "sickld.c",
}
"Tags of the table: host software that uses or names a service; `sickld.c` is a port of sicktoolbox to C."

_ITEMS = "items 0001 0002 0004 0005 0010 0011"
_UNKNOWN = "request layout not in any source: SERVICE_FAILURE"

COMMANDS: dict[int, Command] = {
    0x0101: Command("GET_IDENTIFICATION", 1, _get_identification, "TBX, DGC, MIR, HDE, CMT"),
    0x0102: Command("GET_STATUS", 0, _get_status, "TBX, CMT, HDE"),
    0x0103: Command("GET_ERROR", 0, None, "FWK (name only)", _UNKNOWN),
    0x0104: Command("GET_SIGNAL", 0, _get_signal, "TBX"),
    0x0105: Command("SET_SIGNAL", 1, _set_signal, "TBX, MIR, CMT", "green and red LED stay the device's"),
    0x0106: Command("LD_REGISTER_APPLICATION", 0, _accept, "TBX, CMT (reply)", "accepted, no effect"),
    0x0201: Command("SET_CONFIG", 1, _set_config, "TBX, DGC, FWK, MIR, CMT, HDE", _ITEMS),
    0x0202: Command("GET_CONFIG", 1, _get_config, "TBX, DGC, CMT, HDE", _ITEMS),
    0x0203: Command("SET_TIME_ABSOLUTE", 1, _set_time_absolute, "TBX"),
    0x0204: Command("SET_TIME_RELATIVE", 1, _set_time_relative, "TBX"),
    0x0205: Command("GET_SYNC_CLOCK", 0, _get_clock, "TBX"),
    0x0206: Command("SET_ZONE", 0, None, "FWK (name only)", _UNKNOWN),
    0x0207: Command("GET_ZONE", 0, None, "FWK (name only)", _UNKNOWN),
    0x0208: Command("RELEASE_ZONE", 0, None, "FWK (name only)", _UNKNOWN),
    0x0209: Command("SET_FILTER", 2, _set_filter, "TBX", "filter 0001; its range is ours"),
    0x020A: Command("SET_FUNCTION", 4, _set_function, "TBX, DGC, FWK, MIR, HDE", "function 2 (reserved) refused"),
    0x020B: Command("GET_FUNCTION", 1, _get_function, "TBX, HDE, CMT"),
    0x0301: Command("GET_PROFILE", 2, _get_profile, "all", "formats 0000..3FFF; fails outside MEASURE (ours)"),
    0x0302: Command("CANCEL_PROFILE", 0, _cancel_profile, "TBX, FWK, MIR, CMT, HDE"),
    0x0401: Command("DO_RESET", 1, _do_reset, "TBX, DGC, FWK, MIR", "levels 0 1 2 10"),
    0x0402: Command("TRANS_IDLE", 0, _trans_idle, "TBX, FWK, MIR"),
    0x0403: Command("TRANS_ROTATE", 1, _trans_rotate, "all", "answered when the head is at speed"),
    0x0404: Command("TRANS_MEASURE", 0, _trans_measure, "all", "errors 0..4"),
    0x0501: Command("DO_ADJUST", 0, None, "FWK (name only)", _UNKNOWN),
    0x0502: Command("DO_TEST", 0, None, "FWK (name only)", _UNKNOWN),
    0x0601: Command("COM_ATTACH", 0, None, "TBX, FWK (names only)", _UNKNOWN),
    0x0602: Command("COM_DETACH", 0, None, "TBX, FWK (names only)", _UNKNOWN),
    0x0603: Command("COM_INIT", 0, None, "TBX, FWK (names only)", _UNKNOWN),
    0x0604: Command("COM_OUTPUT", 0, None, "TBX, FWK (names only)", _UNKNOWN),
    0x0605: Command("COM_DATA", 0, None, "TBX, FWK (names only)", _UNKNOWN),
    0x0701: Command("DIR", 0, None, "TBX, FWK (names only)", _UNKNOWN),
    0x0702: Command("SAVE", 0, None, "TBX, FWK (names only)", _UNKNOWN),
    0x0703: Command("LOAD", 0, None, "TBX, FWK (names only)", _UNKNOWN),
    0x0704: Command("DELETE", 0, None, "TBX, FWK (names only)", _UNKNOWN),
    0x0801: Command("MONITOR_RUN", 1, _monitor, "TBX, CMT (reply)", "0 off, 1 on accepted; no effect"),
    0x0802: Command("MONITOR_PROFILE_LOG", 1, _monitor, "TBX, CMT (reply)", "0 off, 1 on accepted; no effect"),
    0x7F00: Command("SPECIAL", 0, None, "FWK, CMT (reply)", "its reply is SERVICE_FAILURE itself"),
}

ABSENT = (
    CommandRow("1000..3F00", "application services", "absent", "Fawkes", "no application firmware: SERVICE_FAILURE"),
    CommandRow("7E00..7EFF", "adjust services", "absent", "Fawkes", "factory only, unknown: SERVICE_FAILURE"),
)


def title(service: int) -> str:
    """A service for traces: its code, and its name when it has one."""
    command = COMMANDS.get(service)
    return f"{service:04X} {command.name}" if command else f"{service:04X}"


def serve(device: Device, service: int, words: Words, now_ns: int) -> Answer:
    """Carry out one request."""
    command = COMMANDS.get(service)
    if command is None:
        return fails(DropReason.UNKNOWN_COMMAND, f"service {service:04X}")
    if command.handler is None:
        return fails(DropReason.REFUSED, command.note)
    if len(words) < command.words:
        return fails(DropReason.BAD_LENGTH, f"{len(words)} data words, want {command.words}")
    return command.handler(device, words, now_ns)


def rows() -> tuple[CommandRow, ...]:
    """The coverage table."""
    listed = [
        CommandRow(f"{code:04X}", row.name, "done" if row.handler else "refused", _sources(row.source), row.note)
        for code, row in sorted(COMMANDS.items())
    ]
    return (*listed, *ABSENT)


def _sources(tags: str) -> str:
    for tag, name in {**SOURCES, "all": ", ".join(SOURCES.values())}.items():
        tags = tags.replace(tag, name)
    return tags


def check_table() -> None:
    """Start-up check: every row can be dispatched and its name is its own; `ProtocolError` when one cannot."""
    names = [row.name for row in COMMANDS.values()]
    for code, row in COMMANDS.items():
        named = row.handler is not None or bool(row.note)
        if not 0 < code < 0x8000 or names.count(row.name) > 1 or not row.source or not named:
            raise ProtocolError(f"row {code:04X} {row.name} of the ld command table")
