"""What an LMS2xx does with each command. The table is the dispatcher and the coverage page.

A handler takes the device and the request's data, and gives the device as it is afterwards and the answer. It knows no
time: how long a reply takes, and what the line and the mirror make of it, is the session's.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace

from protocols.lms2xx import configuration as block
from protocols.lms2xx import outputs as out
from protocols.lms2xx.device import (
    FACTORY_BAUD,
    INSTALLATION,
    ON_REQUEST,
    RATE_CODES,
    Device,
    find_variant,
    status_block,
    variant_words,
)
from protocols.lms2xx.outputs import Output
from protocols.lms2xx.telegrams import MAX_GROUPS, MAX_REQUEST_PAYLOAD, OVERHEAD_BYTES, word, words
from protocols.session import CommandRow, DropReason

INCORRECT = b"\x92"
"Reply to a good telegram that the device cannot follow."


@dataclass(frozen=True)
class Answer:
    """What follows the ACK."""

    payload: bytes = b""
    "Reply without status byte; empty when measured values are the reply."
    delay: str = "data_s"
    "Which of the `Delays` it takes."
    refusal: DropReason | None = None
    "Set when the device does not do as asked; the payload says so in its own way."
    detail: str = ""
    new_baud: int | None = None
    "The line's speed behind the reply."
    resets: bool = False
    once: Output | None = None
    "Measured values that are the reply."


Result = tuple[Device, Answer]
Handler = Callable[[Device, bytes], Result]


@dataclass(frozen=True)
class Command:
    """One row: how it is answered, and who says so."""

    name: str
    source: str
    handler: Handler | None = None
    "None: known by name, layout or effect not settled by any source; answered with 92."
    sizes: Collection[int] = (0,)
    "Lengths of data (behind command and sub-code) that are taken."
    modes: Collection[int] | None = None
    "Operating modes in which it is allowed; None: all."
    absent: bool = False
    "Not a command of this family, though listings of relatives have it."
    note: str = ""

    @property
    def coverage(self) -> str:
        """`done`, `refused` or `absent`."""
        return "absent" if self.absent else "done" if self.handler else "refused"


def refused(device: Device, reason: DropReason, detail: str) -> Result:
    """The device as it was, and 92."""
    return device, Answer(INCORRECT, refusal=reason, detail=detail)


def answer(device: Device, command: int, data: bytes) -> Result:
    """What the device does with a good telegram addressed to it."""
    row = COMMANDS.get(command)
    if row is None or row.absent:
        return refused(device, DropReason.UNKNOWN_COMMAND, f"command {command:02X}")
    return _follow(device, row, data, f"{command:02X}")


def _follow(device: Device, row: Command, data: bytes, code: str) -> Result:
    if row.handler is None:
        return refused(device, DropReason.REFUSED, f"{code} {row.name}: {row.note}")
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
    entered = replace(device, mode=mode, stream=stream, stream_number=device.stream_number + 1)
    return entered, Answer(b"\xa0\x00", delay)


def _password_is(device: Device, data: bytes) -> bool:
    return data == device.settings.password


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


def _streaming(mode: int, read: Callable[[Device, bytes], Output | str]) -> Handler:
    def enter(device: Device, data: bytes) -> Result:
        output = read(device, data)
        if isinstance(output, str):
            return refused(device, DropReason.BAD_ARGUMENT, f"20 {mode:02X}: {output}")
        return _enter(device, mode, output)

    return enter


# --- what is asked of measured values: an Output, or what is wrong with the parameters ---

MEAN_SCANS = range(2, 251)


def _range_fault(device: Device, first: int, last: int) -> str | None:
    if 1 <= first <= last <= device.variant.points:
        return None
    return f"beams {first}..{last} of {device.variant.points}"


def _mean(device: Device, data: bytes) -> Output | str:
    return Output(out.MEAN, data[0]) if data[0] in MEAN_SCANS else f"mean of {data[0]} scans"


def _sub_range(device: Device, data: bytes) -> Output | str:
    first, last = words(data)
    return _range_fault(device, first, last) or Output(out.SUB_RANGE, groups=((first, last),))


def _mean_sub_range(device: Device, data: bytes) -> Output | str:
    first, last = words(data[1:])
    if data[0] not in MEAN_SCANS:
        return f"mean of {data[0]} scans"
    return _range_fault(device, first, last) or Output(out.MEAN_SUB_RANGE, data[0], ((first, last),))


def _reflectivity(device: Device, data: bytes) -> Output | str:
    first, last = words(data)
    if not device.model.fast:
        return "only S14 models have C4"
    return _range_fault(device, first, last) or Output(out.REFLECTIVITY, groups=((first, last),))


def _intensity(device: Device, data: bytes) -> Output | str:
    count, *beams = words(data)
    if not 1 <= count <= MAX_GROUPS or len(beams) != 2 * count:
        return f"{count} groups in {len(data)} bytes"
    groups = tuple(zip(beams[0::2], beams[1::2], strict=True))
    for first, last in groups:
        if fault := _range_fault(device, first, last):
            return fault
    output = Output(out.INTENSITY, groups=groups)
    size = output.telegram_bytes(device.variant.points, indices=False)
    # The header word's ten bits would do; the listing's largest telegram is 812 bytes.
    return output if size <= MAX_REQUEST_PAYLOAD + OVERHEAD_BYTES else f"telegram of {size} bytes"


def _once(code: str, read: Callable[[Device, bytes], Output | str]) -> Handler:
    def measure(device: Device, data: bytes) -> Result:
        output = read(device, data)
        if isinstance(output, str):
            return refused(device, DropReason.BAD_ARGUMENT, f"{code}: {output}")
        return device, Answer(once=output)

    return measure


def _values(device: Device, data: bytes) -> Result:
    # 30 01: one scan (Robotics Library, manorajesh). 30 05 B4: probe of old CARMEN and Orca, which take any B0.
    if (data[0], len(data)) in ((0x01, 1), (0x05, 2)):
        return device, Answer(once=Output(out.ALL))
    return refused(device, DropReason.REFUSED, f"30 {data.hex(' ').upper()}: sub-code of an unknown layout")


# --- the other commands ---


def _reset(device: Device, data: bytes) -> Result:
    return device, Answer(b"\x91", "reset_s", resets=True)


def _status(device: Device, data: bytes) -> Result:
    return device, Answer(b"\xb1" + status_block(device))


def _errors(device: Device, data: bytes) -> Result:
    return device, Answer(b"\xb2" + bytes(byte for entry in device.errors for byte in entry))


def _counter(device: Device, data: bytes) -> Result:
    double_hours = min(int(device.settings.operating_hours / 2), 0xFFFF)
    return device, Answer(b"\xb5" + word(double_hours) + word(device.switch_ons))


def _type(device: Device, data: bytes) -> Result:
    return device, Answer(b"\xba" + device.type_text)


def _variant(device: Device, data: bytes) -> Result:
    wanted = find_variant(device, data)
    if wanted is None:
        detail = "3B {} {}".format(*words(data))
        return device, Answer(b"\xbb\x00" + variant_words(device), "variant_s", DropReason.BAD_ARGUMENT, detail)
    changed = replace(device, variant=wanted, stream_number=device.stream_number + 1)
    if device.stream is not None:  # a comment in sicktoolbox: the device stops streaming
        changed = replace(changed, mode=ON_REQUEST, stream=None)
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


def _permanent_rate(device: Device, data: bytes) -> Result:
    # Request: Olin Robotics Blockset, 02 00 02 00 66 01 9D 4E "set the current baud rate as permanent".
    if data[0] not in (0, 1):
        return refused(
            device, DropReason.REFUSED, f"66 {data[0]:02X}: type of device, or permanence of more: sources differ"
        )
    permanent = data[0] == 1
    baud = device.baud if permanent else FACTORY_BAUD
    same = (permanent, baud) == (device.permanent_baud, device.startup_baud)
    changed = replace(device, permanent_baud=permanent, startup_baud=baud)
    return changed, Answer(b"\xe6\x01", "same_write_s" if same else "write_s")


TL = "SICK listing 8007954 via Gepruft_Lidar"
HOSTS = "sicktoolbox, MRPT, Player, ARIA, CARMEN, Robotics Library"
HEADINGS = "headings of the SICK listing (GearBox's command list)"
NO_LAYOUT = "layout not known from any source"

SWITCHES: Mapping[int, Command] = {
    0x00: Command("installation mode, with password", f"{TL}; {HOSTS}", _installation, range(0, 65)),
    0x10: Command("diagnosis mode", f"{TL}: name only", _plain(0x10), note="A0, no output"),
    0x20: Command("smallest value per segment, continuously", f"{TL}: name only", note=NO_LAYOUT),
    0x21: Command("smallest value per segment, on object", f"{TL}: name only", note=NO_LAYOUT),
    0x22: Command("smallest vertical distance, continuously", f"{TL}: name only", note=NO_LAYOUT),
    0x23: Command("smallest vertical distance, on object", f"{TL}: name only", note=NO_LAYOUT),
    0x24: Command("all values, continuously", HOSTS, _plain(0x24, Output(out.ALL)), note="stream B0"),
    0x25: Command("values on request", HOSTS, _plain(ON_REQUEST), note="stops every stream"),
    0x26: Command("means of n scans, continuously", "sicktoolbox", _streaming(0x26, _mean), (1,), note="stream B6"),
    0x27: Command(
        "sub-range, continuously", "sicktoolbox, Player", _streaming(0x27, _sub_range), (4,), note="stream B7"
    ),
    0x28: Command(
        "means of a sub-range, continuously", "sicktoolbox", _streaming(0x28, _mean_sub_range), (5,), note="stream BF"
    ),
    0x29: Command("values with field values, continuously", f"{TL}: name only", note=NO_LAYOUT),
    0x2A: Command(
        "partial scans, continuously", "sicktoolbox, CARMEN, MIT driver", _partial, note="stream B0; not S14"
    ),
    0x2B: Command(
        "range and intensity of sub-ranges, continuously",
        "CARMEN, MIT driver, libFAIR",
        _streaming(0x2B, _intensity),
        range(2, 2 + 4 * MAX_GROUPS + 1, 2),
        note="stream F5",
    ),
    0x2C: Command("smallest value per segment of a sub-range", f"{TL}: name only", note=NO_LAYOUT),
    0x2E: Command("navigation data, continuously", f"{TL}: name only", note=NO_LAYOUT),
    0x30: Command("test a password", f"{TL}: name and parameter", _test_password, range(0, 65)),
    **{
        code: Command(f"line speed {baud}", f"{TL}; {HOSTS}", _rate(baud), note="mode kept")
        for code, baud in RATE_CODES.items()
    },
    0x50: Command(
        "range and reflectivity of a sub-range, continuously",
        "sicktoolbox, Stanford DGC driver",
        _streaming(0x50, _reflectivity),
        (4,),
        note="stream C4; S14 only",
    ),
}
"Sub-codes of command 20."

COMMANDS: Mapping[int, Command] = {
    0x10: Command("initialise and reset", "sicktoolbox, Robotics Library", _reset, note="91, later 90"),
    0x20: Command("operating mode, line speed", HOSTS, _switch, range(1, MAX_REQUEST_PAYLOAD)),
    0x30: Command(
        "measured values once",
        "Robotics Library, manorajesh/sick-lidar; Orca's probe",
        _values,
        range(1, MAX_REQUEST_PAYLOAD),
        note="30 01 and the probe 30 05 B4 give B0; other sub-codes are refused",
    ),
    0x31: Command("status", HOSTS, _status, note="152 bytes"),
    0x32: Command("stored errors", "sicktoolbox, GearBox", _errors),
    0x35: Command("operating data counter", "GearBox", _counter, (0, 2)),
    0x36: Command("mean values once", f"{TL}; stream form: sicktoolbox", _once("36", _mean), (1,)),
    0x37: Command("sub-range once", f"{TL}; stream form: sicktoolbox, Player", _once("37", _sub_range), (4,)),
    0x3A: Command("type", "sicktoolbox, Player, Robotics Library, manorajesh/sick-lidar", _type),
    0x3B: Command("variant: field and step", HOSTS, _variant, (4,), note="S14: refused with BB 00"),
    0x3E: Command("values with field values once", HEADINGS, note=NO_LAYOUT),
    0x3F: Command("means of a sub-range once", f"{TL}; stream form: sicktoolbox", _once("3F", _mean_sub_range), (5,)),
    0x40: Command("write monitoring fields", HEADINGS, note=NO_LAYOUT),
    0x41: Command("switch the active field set", HEADINGS, note=NO_LAYOUT),
    0x42: Command("change a password", HEADINGS, note=NO_LAYOUT),
    0x44: Command(
        "range and reflectivity once", "stream form: sicktoolbox", _once("44", _reflectivity), (4,), note="S14 only"
    ),
    0x45: Command("read monitoring fields", HEADINGS, note=NO_LAYOUT),
    0x46: Command("teach fields", HEADINGS, note=NO_LAYOUT),
    0x4A: Command("state of the field outputs", HEADINGS, note=NO_LAYOUT),
    0x66: Command(
        "permanent line speed",
        "Olin Robotics Blockset (request 66 01)",
        _permanent_rate,
        (1,),
        (INSTALLATION,),
        note="66 01 present rate, 66 00 back to 9600; result byte 01 as in BB and F7 is ours; other values are refused",
    ),
    0x69: Command("angles of the positioning aid", HEADINGS, note=NO_LAYOUT),
    0x74: Command("read configuration", HOSTS, _read_configuration),
    0x75: Command(
        "range and intensity of sub-ranges once",
        "stream form: CARMEN, MIT driver",
        _once("75", _intensity),
        range(2, 2 + 4 * MAX_GROUPS + 1, 2),
    ),
    0x76: Command("Cartesian values", HEADINGS, note=NO_LAYOUT),
    0x77: Command(
        "write configuration",
        HOSTS,
        _write_configuration,
        range(1, MAX_REQUEST_PAYLOAD),
        (INSTALLATION,),
        note="any number of bytes from the front",
    ),
    0x7C: Command("configuration, continued", HEADINGS, note=NO_LAYOUT),
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
