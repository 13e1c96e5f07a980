"""What an LMS2xx does with each command. The table is the dispatcher and the coverage page.

A handler takes the device and the request's data, and gives the device as it is afterwards and the answer. It knows no
time: how long a reply takes, and what the line and the mirror make of it, is the session's.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from protocols.lms2xx import asking, field_commands
from protocols.lms2xx import configuration as block
from protocols.lms2xx import outputs as out
from protocols.lms2xx.answers import (
    INCORRECT,
    Answer,
    Command,
    Handler,
    Result,
    fast,
    refused,
    uncounted,
)
from protocols.lms2xx.asking import Reader, once
from protocols.lms2xx.device import (
    INSTALLATION,
    ON_REQUEST,
    RATE_CODES,
    Device,
    find_variant,
    status_block,
    variant_words,
)
from protocols.lms2xx.outputs import Output
from protocols.lms2xx.telegrams import MAX_GROUPS, MAX_REQUEST_PAYLOAD, words
from protocols.session import CommandRow, DropReason

__all__ = ["COMMANDS", "INCORRECT", "KNOWN", "SWITCHES", "Answer", "Command", "answer", "coverage_rows", "describe"]


def answer(device: Device, command: int, data: bytes) -> Result:
    """What the device does with a good telegram addressed to it."""
    row = COMMANDS.get(command)
    if row is None or row.absent:
        return refused(device, DropReason.UNKNOWN_COMMAND, f"command {command:02X}")
    return _follow(device, row, data, f"{command:02X}")


def _follow(device: Device, row: Command, data: bytes, code: str) -> Result:
    if row.handler is None:
        return refused(device, DropReason.REFUSED, f"{code} {row.name}: {row.note}")
    if row.lacked_by is not None and row.lacked_by(device):
        return refused(device, DropReason.REFUSED, f"{code} {row.name}: not in this model")
    if len(data) not in row.sizes:
        return refused(device, DropReason.BAD_LENGTH, f"{code} with {len(data)} bytes of data")
    if row.modes is not None and device.mode not in row.modes:
        return refused(device, DropReason.WRONG_MODE, f"{code} in mode {device.mode:02X}")
    return row.handler(device, data)


def describe(command: int, data: bytes) -> str:
    """Code of a request as the coverage page has it: `20 24`, `3B`."""
    return f"{command:02X} {data[0]:02X}" if command == 0x20 and data else f"{command:02X}"


# --- operating mode (20) ---


def _switch(device: Device, data: bytes) -> Result:
    row = SWITCHES.get(data[0])
    if row is None:
        return refused(device, DropReason.UNKNOWN_COMMAND, f"20 {data[0]:02X}")
    return _follow(device, row, data[1:], f"20 {data[0]:02X}")


def _enter(device: Device, mode: int, stream: Output | None = None) -> Result:
    delay = "same_mode_s" if device.mode == mode else "mode_s"
    entered = replace(
        device, mode=mode, stream=stream, stream_number=device.stream_number + 1, teaching=None, new_password=None
    )
    return entered, Answer(b"\xa0\x00", delay)


def _password_is(device: Device, data: bytes) -> bool:
    return data == device.password


def _wrong_password(device: Device) -> Result:
    return device, Answer(b"\xa0\x01", "same_mode_s", DropReason.BAD_ARGUMENT, "wrong password")


def _installation(device: Device, data: bytes) -> Result:
    return _enter(device, INSTALLATION) if _password_is(device, data) else _wrong_password(device)


def _test_password(device: Device, data: bytes) -> Result:
    if not _password_is(device, data):
        return _wrong_password(device)
    return device, Answer(b"\xa0\x00", "same_mode_s")


def _plain(mode: int, stream: Output | None = None) -> Handler:
    return lambda device, data: _enter(device, mode, stream)


def _rate(baud: int) -> Handler:
    def change(device: Device, data: bytes) -> Result:
        return replace(device, baud=baud), Answer(b"\xa0\x00", "same_mode_s", new_baud=baud)

    return change


def _partial(device: Device, data: bytes) -> Result:
    if device.model.fast:
        return refused(device, DropReason.REFUSED, "20 2A: this model has no partial scans")
    return _enter(device, 0x2A, Output(out.ALL, partial=True))


def _reset_password(device: Device, data: bytes) -> Result:
    return _enter(field_commands.factory_password(device), PASSWORD_RESET)


def _streaming(mode: int, read: Reader) -> Handler:
    def enter(device: Device, data: bytes) -> Result:
        output = read(device, data)
        if isinstance(output, str):
            return refused(device, DropReason.BAD_ARGUMENT, f"20 {mode:02X}: {output}")
        return _enter(device, mode, output)

    return enter


# --- the other commands ---


def _reset(device: Device, data: bytes) -> Result:
    return device, Answer(b"\x91", "reset_s", resets=True)


def _status(device: Device, data: bytes) -> Result:
    return device, Answer(b"\xb1" + status_block(device))


def _errors(device: Device, data: bytes) -> Result:
    return device, Answer(b"\xb2" + bytes(byte for entry in device.errors for byte in entry))


def _type(device: Device, data: bytes) -> Result:
    return device, Answer(b"\xba" + device.type_text)


def _variant(device: Device, data: bytes) -> Result:
    wanted = find_variant(device, data)
    if wanted is None:
        detail = "3B {} {}".format(*words(data))
        return device, Answer(b"\xbb\x00" + variant_words(device), "variant_s", DropReason.BAD_ARGUMENT, detail)
    changed = replace(device, variant=wanted, stream_number=device.stream_number + 1)
    if device.stream is not None:  # a comment in sicktoolbox: the device stops streaming
        changed = replace(changed, mode=ON_REQUEST, stream=None, teaching=None)
    return changed, Answer(b"\xbb\x01" + variant_words(changed), "variant_s")


def _read_configuration(device: Device, data: bytes) -> Result:
    return device, Answer(b"\xf4" + device.configuration)


def _write_configuration(device: Device, data: bytes) -> Result:
    new = block.write(device.configuration, data, device.model.has_sensitivity)
    if new is None:
        detail = "77: byte B high, D or E out of range"
        kept = b"\xf7\x00" + device.configuration
        return device, Answer(kept, "same_write_s", DropReason.BAD_ARGUMENT, detail)
    delay = "same_write_s" if new == device.configuration else "write_s"
    return replace(device, configuration=new), Answer(b"\xf7\x01" + new, delay)


TL = "listing 8007954"
HOSTS = "sicktoolbox, MRPT, Player, ARIA, CARMEN, Robotics Library"

DIAGNOSIS, PASSWORD_RESET = 0x10, 0x02
ANY = range(1, MAX_REQUEST_PAYLOAD)

SWITCHES: Mapping[int, Command] = {
    0x00: Command("installation mode, with password", f"{TL}; {HOSTS}", _installation, range(65)),
    0x01: Command("calibration mode", f"{TL}, p. 40", note="factory only, and reserved among the requests: 92"),
    0x02: Command(
        "password as delivered",
        f"{TL}, p. 53",
        _reset_password,
        modes=(DIAGNOSIS, PASSWORD_RESET),
        note="diagnosis first",
    ),
    0x10: Command("diagnosis mode", f"{TL}, p. 40", _plain(DIAGNOSIS), note="A0, no output"),
    0x20: Command(
        "smallest value per segment, continuously",
        f"{TL}, p. 41",
        _streaming(0x20, asking.segments(False)),
        lacked_by=fast,
        note="stream B0; segments of field A of the active set",
    ),
    0x21: Command(
        "smallest value per segment, on object",
        f"{TL}, p. 41",
        _streaming(0x21, asking.segments(True)),
        lacked_by=fast,
        note="only scans with an object in a field",
    ),
    0x22: Command(
        "smallest vertical distance, continuously",
        f"{TL}, p. 41",
        _streaming(0x22, asking.verticals(False)),
        lacked_by=fast,
        note="stream B0; a value for each field",
    ),
    0x23: Command(
        "smallest vertical distance, on object",
        f"{TL}, p. 41",
        _streaming(0x23, asking.verticals(True)),
        lacked_by=fast,
        note="only scans with an object in a field",
    ),
    0x24: Command("all values, continuously", HOSTS, _plain(0x24, Output(out.ALL)), note="stream B0"),
    0x25: Command("values on request", HOSTS, _plain(ON_REQUEST), note="stops every stream"),
    0x26: Command(
        "means of n scans, continuously", "sicktoolbox", _streaming(0x26, asking.mean), (1,), note="stream B6"
    ),
    0x27: Command(
        "sub-range, continuously",
        f"sicktoolbox, Player; {TL}, p. 42",
        _streaming(0x27, asking.sub_range),
        (4,),
        note="stream B7; bit 15 of the first beam: one a turn",
    ),
    0x28: Command(
        "means of a sub-range, continuously",
        "sicktoolbox",
        _streaming(0x28, asking.mean_sub_range),
        (5, 6),
        note="stream BF",
    ),
    0x29: Command(
        "values with field values, continuously",
        f"{TL}, p. 42",
        _streaming(0x29, asking.field_values),
        (4,),
        lacked_by=fast,
        note="stream BE; at most 100 beams",
    ),
    0x2A: Command(
        "partial scans, continuously", "sicktoolbox, CARMEN, MIT driver", _partial, note="stream B0; not S14"
    ),
    0x2B: Command(
        "range and intensity of sub-ranges, continuously",
        "CARMEN, MIT driver, libFAIR",
        _streaming(0x2B, asking.intensity),
        range(2, 2 + 4 * MAX_GROUPS + 1, 2),
        lacked_by=fast,
        note="stream F5; not S14",
    ),
    0x2C: Command(
        "smallest value per segment of sub-ranges",
        f"{TL}, p. 43",
        _streaming(0x2C, asking.group_minima),
        range(5, 2 + 4 * asking.MOST_SEGMENTS, 4),
        lacked_by=fast,
        note="stream B7",
    ),
    0x2E: Command("navigation data", f"{TL}, p. 43", note="the listing names it and prints no telegram: 92"),
    0x30: Command("test a password", f"{TL}, p. 44", _test_password, range(65)),
    **{
        code: Command(f"line speed {baud}", f"{TL}; {HOSTS}", _rate(baud), note="mode kept")
        for code, baud in RATE_CODES.items()
    },
    0x50: Command(
        "range and reflectivity of a sub-range, continuously",
        "sicktoolbox, Stanford DGC driver",
        _streaming(0x50, asking.reflectivity),
        (4,),
        note="stream C4; S14 only",
    ),
}
"Sub-codes of command 20."

COMMANDS: Mapping[int, Command] = {
    0x10: Command("initialise and reset", "sicktoolbox, Robotics Library", _reset, note="91, later 90"),
    0x20: Command("operating mode, line speed", HOSTS, _switch, ANY),
    0x30: Command(
        "measured values once",
        f"{TL}, p. 46; Robotics Library; Orca's probe",
        once("30", asking.kind_of_scan),
        ANY,
        note="01 scan, 02 vertical, 03 taught, 06 and 07 every 2nd and 20th, 08 partial; 05 B4 is Orca's probe",
    ),
    0x31: Command("status", HOSTS, _status, note="152 bytes"),
    0x32: Command("stored errors", "sicktoolbox, GearBox", _errors),
    0x35: Command(
        "operating data counter",
        f"GearBox; {TL}, p. 60",
        field_commands.hours,
        (0, 2),
        lacked_by=uncounted,
        note="not LMS200, LMS220",
    ),
    0x36: Command("mean values once", f"{TL}, p. 61", once("36", asking.mean), (1,)),
    0x37: Command(
        "sub-range once",
        f"{TL}, p. 63",
        once("37", asking.sub_range),
        (4,),
        note="bit 15 of the first beam: one telegram for each turn",
    ),
    0x3A: Command("type", "sicktoolbox, Player, Robotics Library, manorajesh/sick-lidar", _type),
    0x3B: Command("variant: field and step", HOSTS, _variant, (4,), note="S14: refused with BB 00"),
    0x3E: Command(
        "values with field values once",
        f"{TL}, p. 68",
        once("3E", asking.field_values),
        (4,),
        lacked_by=fast,
        note="at most 100 beams; not S14",
    ),
    0x3F: Command("means of a sub-range once", f"{TL}, p. 70", once("3F", asking.mean_sub_range), (5, 6)),
    0x40: Command(
        "write a monitoring field",
        f"{TL}, p. 72",
        field_commands.write_field,
        ANY,
        (INSTALLATION,),
        lacked_by=fast,
        note="one reserved byte, as in the listing's example, or six, as in its table; not S14",
    ),
    0x41: Command("active field set", f"{TL}, p. 76", field_commands.switch_set, (1,), lacked_by=fast, note="not S14"),
    0x42: Command(
        "change a password", f"{TL}, p. 77", field_commands.change_password, (10,), (INSTALLATION,), note="sent twice"
    ),
    0x44: Command(
        "range and reflectivity once", f"{TL}, p. 78", once("44", asking.reflectivity), (4,), note="S14 only"
    ),
    0x45: Command(
        "read a monitoring field", f"{TL}, p. 80", field_commands.read_field, (1, 2), lacked_by=fast, note="not S14"
    ),
    0x46: Command(
        "teach a monitoring field",
        f"{TL}, p. 83",
        field_commands.teach,
        (13,),
        (INSTALLATION,),
        lacked_by=fast,
        note="03 while it lasts; not S14",
    ),
    0x4A: Command(
        "state of the field outputs", f"{TL}, p. 85", field_commands.levels, note="of the scans that follow the request"
    ),
    0x66: Command(
        "permanent line speed or variant",
        f"{TL}, p. 87; Olin Robotics Blockset",
        field_commands.make_permanent,
        (1,),
        (INSTALLATION,),
        note="00 back to 9600, 01 present rate, 02 present variant",
    ),
    0x69: Command(
        "angles of the positioning aid",
        f"{TL}, p. 88",
        field_commands.aim,
        (6, 10, 14),
        note="E9 reports the first range; no effect on values",
    ),
    0x74: Command("read configuration", HOSTS, _read_configuration),
    0x75: Command(
        "range and intensity of sub-ranges once",
        f"{TL}, p. 91",
        once("75", asking.intensity),
        range(2, 2 + 4 * MAX_GROUPS + 1, 2),
        lacked_by=fast,
        note="not S14",
    ),
    0x76: Command(
        "Cartesian values",
        f"{TL}, p. 94",
        once("76", asking.places),
        (4,),
        lacked_by=fast,
        note="at most 200 beams; not S14",
    ),
    0x77: Command(
        "write configuration",
        HOSTS,
        _write_configuration,
        ANY,
        (INSTALLATION,),
        note="any number of bytes from the front",
    ),
    0x7B: Command("read configuration 2", f"{TL}, p. 103", field_commands.read_second, note="84 bytes"),
    0x7C: Command(
        "write configuration 2",
        f"{TL}, p. 104",
        field_commands.write_second,
        ANY,
        (INSTALLATION,),
        note="any number of bytes from the front",
    ),
    0x33: Command("(quoted by some for the counter)", "no listing or driver has it", absent=True),
    0x34: Command("memory dump", "listing of the LMS/LMI 400 family", absent=True),
    0x3C: Command("reference target", "older listings (LMS/LMI)", absent=True),
    0x3D: Command("correction values", "older listings (LMS/LMI)", absent=True),
}
"Every command; 92 answers what is not here."

KNOWN = frozenset(COMMANDS)


def coverage_rows() -> tuple[CommandRow, ...]:
    """The coverage table: every command and every sub-code of 20."""
    rows = []
    for code, command in COMMANDS.items():
        rows.append(CommandRow(f"{code:02X}", command.name, command.coverage, command.source, command.note))
        if code == 0x20:
            rows += [
                CommandRow(f"20 {sub:02X}", row.name, row.coverage, row.source, row.note)
                for sub, row in SWITCHES.items()
            ]
    return tuple(rows)
