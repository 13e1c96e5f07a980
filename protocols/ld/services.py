"""What each service does. `COMMANDS` is the only list of them: dispatcher, start-up check, coverage table.

A handler gets the device and the request's data words and gives an `Answer`; it knows neither link nor framing.
"""

from __future__ import annotations

from dataclasses import dataclass

from protocols.errors import ProtocolError
from protocols.ld import com_services as com
from protocols.ld import config as cfg
from protocols.ld.answers import Answer, Handler, StartProfiles, Words, fails, refuses
from protocols.ld.device import HOST_SIGNALS, Device
from protocols.ld.models import IDENTITIES
from protocols.ld.profiles import ALL_FIELDS
from protocols.ld.sectors import MIN_MOTOR_HZ, TABLE_SIZE, TICKS, Function, MeasureError, Sector
from protocols.ld.telegrams import REFUSED, Mode, Motor, text_words
from protocols.session import CommandRow, DropReason

# status services


def _get_identification(device: Device, words: Words, now_ns: int) -> Answer:
    name = IDENTITIES.get(words[0] if words else 0, IDENTITIES[0])  # an unknown item is told as 0000 (UPS p. 16)
    return Answer((*text_words(device.identity[name]), *device.status))


def _get_status(device: Device, words: Words, now_ns: int) -> Answer:
    return Answer(device.status)


def _get_signal(device: Device, words: Words, now_ns: int) -> Answer:
    return Answer((device.port,))


def _set_signal(device: Device, words: Words, now_ns: int) -> Answer:
    if words[0] > 0xFF:
        return refuses((REFUSED,), f"port value {words[0]:04X}")
    device.signals = words[0] & HOST_SIGNALS
    return Answer((device.port,))


# configuration services

IN_FLASH = 1
"Flag of SET_FUNCTION; with any other value the sector is as it was after a reset (UPS p. 23)."


def _set_config(device: Device, words: Words, now_ns: int) -> Answer:
    item, before = words[0], device.config
    if not device.set_config(item, words[1:]):
        return refuses((REFUSED,), f"item {item:04X}: {' '.join(f'{word:04X}' for word in words[1:])}")
    baud = device.config[cfg.SERIAL][0]
    return Answer((0,), line_speed=cfg.BAUD_CODES[baud] if baud != before[cfg.SERIAL][0] else None)


def _get_config(device: Device, words: Words, now_ns: int) -> Answer:
    item = words[0]
    if item not in cfg.ITEMS or (item == cfg.INTERLACE and not device.model.has_interlace):
        return refuses((REFUSED,), f"item {item:04X}")
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
    return Answer((words[0], words[1]))


def _set_function(device: Device, words: Words, now_ns: int) -> Answer:
    number, function, stop, flash = words[:4]
    number = min(number, TABLE_SIZE - 1)
    function = function if function in (0, 1, 3, 4) else 0
    stop %= TICKS
    device.set_sector(number, Sector(Function(function), stop), flash == IN_FLASH)
    return Answer((number, function, stop))


def _get_function(device: Device, words: Words, now_ns: int) -> Answer:
    if words[0] >= TABLE_SIZE:
        return refuses((REFUSED,) * 3, f"sector {words[0]}")
    sector = device.sectors[words[0]]
    return Answer((words[0], sector.function, sector.stop))


# measuring services


def _get_profile(device: Device, words: Words, now_ns: int) -> Answer:
    if len(words) < 2 or not 0 < words[1] <= ALL_FIELDS:
        return refuses((), f"format {' '.join(f'{word:04X}' for word in words[1:2]) or 'missing'}")
    number, form = words[:2]
    if device.mode is not Mode.MEASURE:
        return fails(DropReason.WRONG_MODE, f"not measuring but in {device.mode.name}")
    return Answer(None, start=StartProfiles(number, form), stops_profiles=True)


def _cancel_profile(device: Device, words: Words, now_ns: int) -> Answer:
    return Answer(device.status, stops_profiles=True)


# working services


def _no_request(device: Device, words: Words, now_ns: int) -> Answer:
    return fails(DropReason.UNKNOWN_COMMAND, "COM_DATA is the device's own")


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
    hz = (words[0] or device.configured_hz) if words else 1
    if device.motor is Motor.STOPPED:
        return Answer(device.status, refused=DropReason.WRONG_MODE, detail="motor stopped")
    if not MIN_MOTOR_HZ <= hz <= device.model.fastest_hz:
        device.idle(now_ns)  # UPS p. 34
        return refuses(device.status, f"{hz} Hz")
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
        return fails(DropReason.WRONG_MODE, "another command before the head was at speed")
    verdict = device.measure()
    if verdict is MeasureError.OK:
        return Answer((*device.status, verdict))
    return Answer((*device.status, verdict), refused=DropReason.BAD_ARGUMENT, detail=f"error {verdict}, {verdict.name}")


ANY = frozenset((Mode.IDLE, Mode.ROTATE, Mode.MEASURE))
STILL, STOPPED = frozenset((Mode.IDLE,)), frozenset((Mode.IDLE, Mode.ROTATE))
TURNING, MEASURING = frozenset((Mode.ROTATE, Mode.MEASURE)), frozenset((Mode.MEASURE,))


@dataclass(frozen=True)
class Command:
    """One row: a service, its number of data words, and its handler (None: refused by name)."""

    name: str
    words: int
    handler: Handler | None
    source: str
    note: str = ""
    states: frozenset[Mode] = ANY
    "States in which it is executed. ERROR, which the listing does not mention, allows all."
    too_short: Words | None = None
    "Data of its reply to a request with too few words; None: SERVICE_FAILURE."


SOURCES = {
    "TBX": "sicktoolbox",
    "DGC": "Stanford ldlrs",
    "FWK": "Fawkes",
    "MIR": "Miro laser360",
    "CMT": "COMTEST",
    "HDE": "sickld.c",
    "UPS": "SICK 8011576",
}
"Tags of the table: host software that uses or names a service; `sickld.c` is a port of sicktoolbox to C."

_ITEMS = "items 0001 0002 0004 0005 0010 0011"
_RESERVED = "reserved in the listing (p. 14): SERVICE_FAILURE"
_NAMED = "not in the listing: SERVICE_FAILURE"
_BAD, _BAD_3 = (REFUSED,), (REFUSED,) * 3

COMMANDS: dict[int, Command] = {
    0x0101: Command("GET_IDENTIFICATION", 0, _get_identification, "UPS p. 16, TBX, DGC, MIR, HDE, CMT"),
    0x0102: Command("GET_STATUS", 0, _get_status, "UPS p. 16, TBX, CMT, HDE"),
    0x0103: Command("GET_ERROR", 0, None, "FWK (name only)", _RESERVED),
    0x0104: Command("GET_SIGNAL", 0, _get_signal, "UPS p. 17, TBX"),
    0x0105: Command(
        "SET_SIGNAL", 1, _set_signal, "UPS p. 17, TBX, MIR, CMT", "green and red LED stay the device's", too_short=_BAD
    ),
    0x0106: Command(
        "REGISTER_APPLICATION",
        0,
        com.register,
        "UPS p. 18, TBX, CMT",
        "items 0020 to 0022 until the next start; a real device takes it from its application board only",
        STILL,
    ),
    0x0201: Command(
        "SET_CONFIG", 1, _set_config, "UPS p. 19, TBX, DGC, FWK, MIR, CMT, HDE", _ITEMS, STILL, too_short=_BAD
    ),
    0x0202: Command("GET_CONFIG", 1, _get_config, "UPS p. 21, TBX, DGC, CMT, HDE", _ITEMS, STILL, too_short=_BAD),
    0x0203: Command("SET_TIME_ABSOLUTE", 1, _set_time_absolute, "UPS p. 22, TBX", states=STOPPED),
    0x0204: Command("SET_TIME_RELATIVE", 1, _set_time_relative, "UPS p. 22, TBX", states=STOPPED),
    0x0205: Command("GET_SYNC_CLOCK", 0, _get_clock, "UPS p. 22, TBX"),
    0x0206: Command("SET_ZONE", 0, None, "FWK (name only)", _RESERVED),
    0x0207: Command("GET_ZONE", 0, None, "FWK (name only)", _RESERVED),
    0x0208: Command("RELEASE_ZONE", 0, None, "FWK (name only)", _RESERVED),
    0x0209: Command("SET_FILTER", 2, _set_filter, "UPS p. 23, TBX", "filter 0001", too_short=_BAD),
    0x020A: Command(
        "SET_FUNCTION",
        4,
        _set_function,
        "UPS p. 23, TBX, DGC, FWK, MIR, HDE",
        "sector, function and stop are limited to their ranges and reported",
        STOPPED,
        too_short=_BAD_3,
    ),
    0x020B: Command("GET_FUNCTION", 1, _get_function, "UPS p. 28, TBX, HDE, CMT", "", STOPPED, too_short=_BAD_3),
    0x0301: Command(
        "GET_PROFILE", 0, _get_profile, "UPS p. 31, all", "formats 0001..3FFF; others: one empty 8301", MEASURING
    ),
    0x0302: Command("CANCEL_PROFILE", 0, _cancel_profile, "UPS p. 32, TBX, FWK, MIR, CMT, HDE", "", MEASURING),
    0x0401: Command("DO_RESET", 1, _do_reset, "UPS p. 33, TBX, DGC, FWK, MIR", "levels 0 1 2 10"),
    0x0402: Command("TRANS_IDLE", 0, _trans_idle, "UPS p. 33, TBX, FWK, MIR", "", STOPPED),
    0x0403: Command(
        "TRANS_ROTATE", 0, _trans_rotate, "UPS p. 34, all", "answered when the head is at speed; a wrong one: IDLE"
    ),
    0x0404: Command("TRANS_MEASURE", 0, _trans_measure, "UPS p. 34, all", "errors 0..4", TURNING),
    0x0501: Command("DO_ADJUST", 0, None, "FWK (name only)", _NAMED),
    0x0502: Command("DO_TEST", 0, None, "FWK (name only)", _NAMED),
    0x0601: Command("COM_ATTACH", 1, com.attach, "UPS p. 35", "", STILL, too_short=(REFUSED, REFUSED)),
    0x0602: Command("COM_DETACH", 1, com.detach, "UPS p. 35", "", STILL, too_short=(REFUSED, REFUSED)),
    0x0603: Command("COM_INIT", 1, com.initialise, "UPS p. 36", "", STILL, too_short=(REFUSED, REFUSED)),
    0x0604: Command("COM_OUTPUT", 1, com.output, "UPS p. 38", too_short=(REFUSED, REFUSED)),
    0x0605: Command(
        "COM_DATA", 0, _no_request, "UPS p. 40", "sent by the device unasked; as a request: SERVICE_FAILURE"
    ),
    0x0701: Command("DIR", 0, com.directory, "UPS p. 41", "two words of each file are its header (ours)", STILL),
    0x0702: Command("SAVE", 0, com.save, "UPS p. 41", "", STILL),
    0x0703: Command("LOAD", 0, com.load, "UPS p. 42", "", STILL),
    0x0704: Command("DELETE", 0, com.delete, "UPS p. 42", "", STILL),
    0x0801: Command("MONITOR_RUN", 1, com.monitor, "UPS p. 43, TBX, CMT", "one interface at a time", too_short=_BAD),
    0x0802: Command(
        "MONITOR_PROFILE_LOG", 1, com.monitor_profiles, "UPS p. 43, TBX, CMT", "a copy of every 8301", too_short=_BAD
    ),
    0x7F00: Command("SPECIAL", 0, None, "UPS p. 44, FWK, CMT", "its reply is SERVICE_FAILURE itself"),
}

ABSENT = (
    CommandRow(
        "CoLa",
        "CoLa binary: sMN SetAccessMode, sMN Run, sRN DeviceIdent",
        "done",
        "SICK 9106698, p. 18-21 (names the protocol, prints no port and no variable)",
        "LD-LRS1000, 2100, 3100; on serial and TCP links; any other telegram: sFA",
    ),
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
    served = device.mode is Mode.ERROR or device.mode in command.states or not device.settings.is_strict
    if not served:
        return fails(DropReason.WRONG_MODE, f"not served in {device.mode.name}")
    if len(words) < command.words:
        detail = f"{len(words)} data words, want {command.words}"
        if command.too_short is None:
            return fails(DropReason.BAD_LENGTH, detail)
        return Answer(command.too_short, refused=DropReason.BAD_LENGTH, detail=detail)
    return command.handler(device, words, now_ns)


def rows() -> tuple[CommandRow, ...]:
    """The coverage table."""
    listed = [
        CommandRow(f"{code:04X}", row.name, "done" if row.handler else "refused", _sources(row.source), row.note)
        for code, row in sorted(COMMANDS.items())
    ]
    return (*listed, *ABSENT)


def _sources(tags: str) -> str:
    for tag, name in {**SOURCES, "all": ", ".join(name for name in SOURCES.values() if name != SOURCES["UPS"])}.items():
        tags = tags.replace(tag, name)
    return tags


def check_table() -> None:
    """Start-up check: every row can be dispatched and its name is its own; `ProtocolError` when one cannot."""
    names = [row.name for row in COMMANDS.values()]
    for code, row in COMMANDS.items():
        named = row.handler is not None or bool(row.note)
        if not 0 < code < 0x8000 or names.count(row.name) > 1 or not row.source or not named:
            raise ProtocolError(f"row {code:04X} {row.name} of the ld command table")
