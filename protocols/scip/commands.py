"""The commands of SCIP 2.0, 2.2 and 1.1: each row dispatches, and is a line of the coverage page.

Belongs here: what a command does and its status. Not: sweeps and blocks (device), echo and sums of the reply (session).

Sources: `spec` the project's specification from urg_c, urg_node, MRPT and Player; `hokuyolx` its statuses.py.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

from protocols.scip.codec import STAMP_CHARS, Form, encode_number, key_line, summed
from protocols.scip.device import MOST_ECHOES, SCIP1_LAST, STAMP_BITS, TICK_NS, UNSTABLE, Job, ScipDevice
from protocols.session import DropReason
from protocols.skeleton.instants import SECOND_NS
from protocols.skeleton.requests import Answer, Command, Refused, Request

REBOOT_WITHIN_NS = SECOND_NS
SWITCH = b"SCIP2.0"
OLD = b"1.1 "
"Before the letter of a command of SCIP 1.1 in the table."
MOST_TAG = 16
"Characters behind `;`."
SLOWEST = 10
"Steps of CR, one per cent of the nominal speed each."
STATUS_LABELS = {"000": "no error.", "900": "abnormal condition."}

Reply = bytes | Answer | Refused
Act = Callable[[ScipDevice, Request], Reply]


def ok(*lines: bytes) -> bytes:
    """Status 00 and what follows."""
    return summed(b"00") + b"".join(lines)


def status(code: str) -> bytes:
    """A status that is no refusal, such as 02: on already."""
    return summed(code.encode())


def refused(code: str, detail: str, reason: DropReason = DropReason.BAD_ARGUMENT) -> Refused:
    """The status of a refusal; its first two characters are sent."""
    return Refused(reason, f"{code} {detail}")


def parameters(request: Request) -> tuple[bytes, bytes]:
    """What stands between the code and `;`, and the host's text from there on."""
    text, mark, tag = request.data.partition(b";")
    return text, mark + tag


def _of_length(device: ScipDevice, request: Request, length: int) -> Refused | None:
    found = len(parameters(request)[0])
    if found == length:
        return None
    kind = "short" if found < length else "long"
    return refused(device.model.errors[kind], f"{found} characters; want {length}", DropReason.BAD_LENGTH)


def without(act: Act, length: int = 0) -> Act:
    """The same, with a refusal of parameters of another length."""

    def checked(device: ScipDevice, request: Request) -> Reply:
        return _of_length(device, request, length) or act(device, request)

    return checked


# information


def _version(device: ScipDevice, request: Request) -> Reply:
    model = device.model
    values = {
        "VEND": "Hokuyo Automatic Co.,Ltd.",
        "PROD": f"SOKUIKI Sensor {model.title.partition('(')[0]}",
        "FIRM": model.firmware,
        "PROT": "SCIP 1.1" if device.scip1 else model.protocol,
        "SERI": device.settings.serial,
    }
    if device.scip1 and request.data:
        return refused("E", f"{request.data!r} behind V")
    if device.scip1:
        return b"0\n" + b"".join(f"{key}:{value}\n".encode() for key, value in values.items())
    return ok(*(key_line(key, value) for key, value in values.items()))


def _parameters(device: ScipDevice, request: Request) -> Reply:
    model = device.model
    numbers = (model.least_mm, model.most_mm, model.steps, model.first, model.last, model.front, model.rpm)
    keys = ("DMIN", "DMAX", "ARES", "AMIN", "AMAX", "AFRT", "SCAN")
    return ok(
        key_line("MODL", model.title), *(key_line(key, str(number)) for key, number in zip(keys, numbers, strict=True))
    )


def _state(device: ScipDevice, request: Request) -> Reply:
    now_ns = request.now_ns
    code, name = device.state(now_ns)
    rpm = round(device.model.rpm * (100 - device.slower) / 100)
    speed = f"Initial({rpm}[rpm])<-Default setting by user" if not device.slower else f"{rpm}[rpm]<-CR command"
    rates = {"usb": "USB Full Speed", "ethernet": "Ethernet 100[Mbps]"}
    health = "Abnormal" if code == "900" else "Stable" if device.is_stable(now_ns) else "Unstable"
    ticks = device.clock.ticks(now_ns, TICK_NS, STAMP_BITS)
    values = {
        "MODL": device.model.title,
        "LASR": "ON" if device.laser else "OFF",
        "SCSP": speed,
        "MESM": f"{code} {name}",
        "SBPS": rates.get(device.settings.port, f"{device.baud}[bps]"),
        "TIME": f"{ticks:06X}",
        "STAT": f"{health} {'900' if code == '900' else '000'} {STATUS_LABELS['900' if code == '900' else '000']}",
    }
    return ok(*(key_line(key, value) for key, value in values.items()))


def _short_state(device: ScipDevice, request: Request) -> Reply:
    return ok(summed(device.state(request.now_ns)[0].encode()))


# laser, motor, time


def _laser_on(device: ScipDevice, request: Request) -> Reply:
    if device.faulty or not device.is_stable(request.now_ns):
        return refused("01", "motor or laser not ready", DropReason.WRONG_MODE)
    if device.laser:
        return status("02")
    device.light(request.now_ns)
    return ok()


def _quit(device: ScipDevice, request: Request) -> Reply:
    device.stop(request.now_ns)
    device.wake(request.now_ns)
    return ok()


def _sleep(device: ScipDevice, request: Request) -> Reply:
    if device.model.protocol == "SCIP 2.0":
        return _absent(device)
    device.sleep(request.now_ns)
    return ok()


def _reset(keeps: bool, device: ScipDevice, request: Request) -> Reply:
    """RS, or RT that `keeps` motor speed and bit rate, in SCIP 2.0 the time too (spec 4; hokuyolx: 2.2 does not)."""
    now_ns = request.now_ns
    device.stop(now_ns)
    device.wake(now_ns)
    device.in_time_mode, device.gain = False, 1.0
    device.faulty = device.settings.faulty
    if not keeps or device.model.protocol != "SCIP 2.0":
        device.clock = device.clock.set_to(now_ns, 0)
    if keeps:
        return ok()
    if device.slower:
        device.turn_at(now_ns, 0)
    changed, device.baud = device.baud != device.settings.baud, device.settings.baud
    return Answer(ok(), device.baud if changed else None)


def _reboot(device: ScipDevice, request: Request) -> Reply:
    first_ns, now_ns = device.reboot_ns, request.now_ns
    if first_ns is None or now_ns - first_ns > REBOOT_WITHIN_NS:
        device.reboot_ns = now_ns
        return status("01")
    device.stop(now_ns)
    return Answer(ok(), restarts=True)


def _time(device: ScipDevice, request: Request) -> Reply:
    what, now_ns = parameters(request)[0], request.now_ns
    if what not in (b"0", b"1", b"2"):
        return refused("01", f"{what!r}; want 0..2")
    if what == b"0" and device.in_time_mode:
        return refused("02", "in time mode already", DropReason.WRONG_MODE)
    if what != b"0" and not device.in_time_mode:
        return refused("03" if what == b"2" else "04", "not in time mode", DropReason.WRONG_MODE)
    if what == b"1":
        ticks = device.clock.ticks(now_ns + device.REPLY_NS, TICK_NS, STAMP_BITS)
        return ok(summed(encode_number(ticks, STAMP_CHARS)))
    if what == b"0":
        device.stop(now_ns)
    device.in_time_mode = what == b"0"
    return ok()


def _bit_rate(device: ScipDevice, request: Request) -> Reply:
    text = parameters(request)[0]
    if not text.isdigit():
        return refused("01", f"{text!r}; want 6 digits")
    if device.settings.port != "rs232":
        return refused("04", f"it is wired by {device.settings.port}", DropReason.WRONG_MODE)
    rate = int(text)
    if rate not in device.model.rates:
        return refused("02", f"{rate} bit/s")
    if rate == device.baud:
        return status("03")
    device.baud = rate
    return Answer(ok(), rate)


def _motor_speed(device: ScipDevice, request: Request) -> Reply:
    if not device.model.has_motor_speed:
        return refused("03", "its speed is fixed", DropReason.WRONG_MODE)
    text = parameters(request)[0]
    if not text.isdigit() or (int(text) > SLOWEST and text != b"99"):
        return refused("01", f"{text!r}; want 00..{SLOWEST} or 99")
    slower = 0 if text == b"99" else int(text)
    if slower == device.slower:
        return status("02")
    device.turn_at(request.now_ns, slower)
    return ok()


def _sensitivity(device: ScipDevice, request: Request) -> Reply:
    if not device.model.has_sensitivity:
        return refused("03", "it has one sensitivity", DropReason.WRONG_MODE)
    text = parameters(request)[0]
    if text not in (b"0", b"1"):
        return refused("01", f"{text!r}; want 0 or 1")
    gain = device.settings.gain if text == b"1" else 1.0
    if gain == device.gain:
        return status("02")
    device.gain = gain
    device.turn_at(request.now_ns, device.slower)
    return ok()


def _simulate(device: ScipDevice, request: Request) -> Reply:
    if device.model.protocol != "SCIP 2.0":
        return _absent(device)
    text = parameters(request)[0]
    if not text.isdigit() or not 1 <= int(text) <= SLOWEST:
        return refused("01", f"{text!r}; want 01..10")
    device.fail(request.now_ns)
    return ok()


def _absent(device: ScipDevice) -> Refused:
    return refused(device.model.errors["absent"], "this product lacks it", DropReason.UNKNOWN_COMMAND)


# measurements


def _measure(form: Form, continuous: bool, device: ScipDevice, request: Request) -> Reply:
    """GD, MD and the others: `ssss eeee cc`, and `i nn` of those that repeat."""
    model, now_ns = device.model, request.now_ns
    if (form.intensity and not model.has_intensity) or (form.echoes > 1 and not model.has_echoes):
        return _absent(device)
    if (wrong := _of_length(device, request, 13 if continuous else 10)) is not None:
        return wrong
    text, tag = parameters(request)
    parts = {"01": text[:4], "02": text[4:8], "03": text[8:10], "06": text[10:11], "07": text[11:13]}
    for code, part in parts.items():
        if part and not part.isdigit():
            return refused(code, f"{part!r}; want digits")
    first, last, cluster, skip, count = (int(part or b"0") for part in parts.values())
    if not (model.first <= first <= model.last and last <= model.last):
        return refused("04", f"steps {first} to {last}; want {model.first} to {model.last}")
    if last < first:
        return refused("05", f"steps {first} to {last}")
    if (why := _hindered(device, now_ns, continuous)) is not None:
        return why
    head = request.code + (text[:-2] if continuous else text)
    left = 1 if not continuous else count or None
    device.begin(Job(request.address, head, tag, form, first, last, cluster, skip, left, now_ns, continuous))
    return ok() if continuous else Answer(None)


def _hindered(device: ScipDevice, now_ns: int, continuous: bool) -> Refused | None:
    """Why nothing can be measured."""
    if device.faulty:
        return refused(device.model.errors["abnormal"], "abnormal condition", DropReason.WRONG_MODE)
    if device.sleeps or not (continuous or device.laser):
        return refused("10", "the laser is off", DropReason.WRONG_MODE)
    if not continuous and not device.is_stable(now_ns):
        return refused(UNSTABLE[device.model.protocol], "motor not at speed", DropReason.WRONG_MODE)
    return None


# SCIP 1.1


def _switch(device: ScipDevice, request: Request) -> Reply:
    if not device.scip1:
        return refused("0E", "in SCIP 2.0 already", DropReason.WRONG_MODE)
    device.stop(request.now_ns)
    device.scip1 = False
    return b"0\n"


def _old_laser(device: ScipDevice, request: Request) -> Reply:
    if request.data not in (b"0", b"1") or (request.data == b"1" and device.faulty):
        return refused("1", f"{request.data!r}; want 0 or 1")
    if request.data == b"1":
        device.light(request.now_ns)
    else:
        device.stop(request.now_ns)
    return b"0\n"


def _old_rate(device: ScipDevice, request: Request) -> Reply:
    text = request.data
    rate = int(text[:6]) if len(text) == 13 and text.isdigit() else 0
    if rate not in device.model.rates or device.settings.port != "rs232":
        return refused("2", f"{text!r}; want a bit rate of 6 digits and 7 digits")
    device.baud = rate
    return Answer(b"0\n", rate)


def _old_scan(device: ScipDevice, request: Request) -> Reply:
    text = request.data
    if len(text) != 8 or not text.isdigit():
        return refused("3", f"{text!r}; want ssseeecc")
    first, last, cluster = int(text[:3]), int(text[3:6]), int(text[6:])
    if not first <= last <= SCIP1_LAST:
        return refused("4", f"steps {first} to {last}; want 0 to {SCIP1_LAST}")
    if not device.laser or _hindered(device, request.now_ns, False) is not None:
        return refused("6", "the laser is off", DropReason.WRONG_MODE)
    head = b"G" + text
    job = Job(request.address, head, b"", Form(2), first, last, cluster, 0, 1, request.now_ns, False, True)
    device.begin(job)
    return Answer(None)


MEASURES: Mapping[bytes, Form] = {
    start + kind: form
    for starts, several in (((b"G", b"M"), 1), ((b"H", b"N"), MOST_ECHOES))
    for start in starts
    for kind, form in ((b"D", Form(3, echoes=several)), (b"S", Form(2)), (b"E", Form(3, True, several)))
    if several == 1 or kind != b"S"
}
"Measuring commands, and what their values are; M and N repeat."


def _row_of(code: bytes, form: Form) -> Command:
    continuous = code[:1] in (b"M", b"N")
    what = f"{'scans' if continuous else 'one scan'}: distances of {form.width} characters"
    what += " and intensities" if form.intensity else ""
    what += f", up to {form.echoes} echoes" if form.echoes > 1 else ""
    return Command(what, partial(_measure, form, continuous), "spec 4")


COMMANDS: Mapping[bytes, Command] = {
    b"VV": Command("version", without(_version), "spec 4, 5"),
    b"PP": Command("parameters", without(_parameters), "spec 4, 5"),
    b"II": Command("state", without(_state), "spec 4, 5"),
    b"BM": Command("laser on", without(_laser_on), "spec 4"),
    b"QT": Command("stop, laser off", without(_quit), "spec 4"),
    b"RS": Command("reset: laser, motor, bit rate, time", without(partial(_reset, False)), "spec 4"),
    b"RT": Command("reset of laser and sensitivity", without(partial(_reset, True)), "spec 4"),
    b"RB": Command("restart, sent twice within 1 s", without(_reboot), "spec 4"),
    b"TM": Command("time mode", without(_time, 1), "spec 4"),
    b"SS": Command("bit rate", without(_bit_rate, 6), "spec 4"),
    b"CR": Command("motor speed", without(_motor_speed, 2), "spec 4", "one per cent per step: ours"),
    b"HS": Command("sensitivity", without(_sensitivity, 1), "spec 4", "factor 2: ours"),
    b"DB": Command("simulated malfunction", without(_simulate, 2), "spec 4", "until RS or RB"),
    **{code: _row_of(code, form) for code, form in MEASURES.items()},
    b"%ST": Command("state code", without(_short_state), "spec 4; hokuyolx"),
    b"%SL": Command("sleep", without(_sleep), "spec 4; hokuyolx", "until QT, RS or RT"),
    b"$IP": Command("address", None, "spec 11", "no printed layout"),
    SWITCH: Command("leave SCIP 1.1", _switch, "spec 4, 7"),
    OLD + b"V": Command("version", _version, "general knowledge"),
    OLD + b"L": Command("laser on or off", _old_laser, "general knowledge"),
    OLD + b"S": Command("bit rate", _old_rate, "general knowledge"),
    OLD + b"G": Command("one scan", _old_scan, "general knowledge"),
}
ANY_TIME = frozenset((b"VV", b"PP", b"II", b"TM", b"RS", b"RT", b"RB", b"%ST"))
"In time mode; others are refused as unknown, which urg_c takes for the sign to send TM2."
EVEN_FAULTY = frozenset((b"VV", b"PP", b"II", b"%ST", b"RB", b"QT", b"BM"))
"In an abnormal condition; SCIP 2.0 also accepts RS and RT (hokuyolx: SCIP 2.2 does not)."
