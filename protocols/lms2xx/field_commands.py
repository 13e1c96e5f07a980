"""Commands 40, 41, 42, 45, 46, 4A, 66, 69, 7B, 7C and 20 02: what the device stores besides the block of 77.

Each handler follows the table of the listing (8007954) that its row in `commands` names.
"""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np

from protocols.lms2xx import configuration as block
from protocols.lms2xx import outputs as out
from protocols.lms2xx.answers import Answer, Result, declined, refused
from protocols.lms2xx.asking import segments, verticals
from protocols.lms2xx.device import ERROR, FACTORY_BAUD, FACTORY_PASSWORD, INSTALLATION, Device
from protocols.lms2xx.fields import (
    RADIAL,
    Field,
    FieldFault,
    SegmentFault,
    Teaching,
    decode,
    grid_of,
    place_of,
    with_field,
)
from protocols.lms2xx.outputs import Find, Output
from protocols.lms2xx.telegrams import word, words
from protocols.scan import Floats
from protocols.session import DropReason

REFUSED, TAKEN = 0, 1

# --- fields (40, 41, 45, 46) ---


def write_field(device: Device, data: bytes) -> Result:
    """40: C0, 01 or 00, and what was sent."""
    try:
        number, place, field = decode(data)
    except SegmentFault as fault:
        return refused(device, DropReason.BAD_ARGUMENT, f"40: {fault}")
    except FieldFault as fault:
        return declined(device, bytes((0xC0, REFUSED)) + data, f"40: {fault}", "same_write_s")
    written = replace(device, field_sets=with_field(device.field_sets, number, place, field))
    written = replace(written, taught=None if device.taught == (number, place) else device.taught)
    return written, Answer(bytes((0xC0, TAKEN)) + data, "write_s")


def switch_set(device: Device, data: bytes) -> Result:
    """41: ask for the active set, or switch to it; a stream that depends on it goes on with the new one."""
    if data[0] > 2:
        return refused(device, DropReason.BAD_ARGUMENT, f"41: set {data[0]}")
    changed = with_set(device, data[0]) if data[0] else device
    return changed, Answer(bytes((0xC1, changed.active_set)))


def with_set(device: Device, number: int) -> Device:
    """With another active set."""
    if number == device.active_set:
        return device
    changed = replace(device, active_set=number)
    stream = device.stream
    if stream is None:
        return changed
    if stream.find in (Find.SEGMENTS, Find.VERTICAL):
        read = (segments if stream.find is Find.SEGMENTS else verticals)(stream.on_object)
        again = read(changed, b"")
        stream = again if isinstance(again, Output) else None
    return replace(changed, stream=stream, stream_number=device.stream_number + 1)


def read_field(device: Device, data: bytes) -> Result:
    """45: C5 with the field; a single byte, as in the listing's example, names a field of set 1."""
    number, place = (1, data[0]) if len(data) == 1 else (data[0], data[1])
    if number not in (1, 2) or place > 2:
        return refused(device, DropReason.BAD_ARGUMENT, f"45: field {place} of set {number}")
    return device, Answer(b"\xc5" + device.field_sets[number - 1][place].encode(number, place))


NOT_ENDED, ENDED, ACTIVE = 0, 1, 3
"Results of C6 (listing, p. 83; its list of values has 02 for the last one)."
START, END, ABORT = 0, 1, 2
USUAL_DIFFERENCE_M = 0.07


def teach(device: Device, data: bytes) -> Result:
    """46: start, end or abort; while it lasts every scan is kept, none is sent."""
    action, difference, _, usual = data[6], *words(data[7:13])
    try:
        number, place, unit = place_of(data)
        angle_deg, step_cdeg = grid_of(data[2:6])
    except FieldFault as fault:
        return refused(device, DropReason.BAD_ARGUMENT, f"46: {fault}")
    if action == START:
        blank = Field(RADIAL, unit, angle_deg, step_cdeg, (0,))
        difference_m = USUAL_DIFFERENCE_M if usual else difference / 1000.0
        begun = Teaching(number, place, blank, difference_m)
        return _teaching(device, begun), Answer(bytes((0xC6, ACTIVE)))
    running = device.teaching
    if action not in (END, ABORT) or running is None or (running.number, running.place) != (number, place):
        return refused(device, DropReason.WRONG_MODE, f"46: action {action:02X} of a field that is not being taught")
    field = running.result() if action == END else None
    stopped = _teaching(device, None)
    if field is None:
        return stopped, Answer(bytes((0xC6, NOT_ENDED)))
    sets = with_field(device.field_sets, number, place, field)
    return replace(stopped, field_sets=sets, taught=(number, place)), Answer(bytes((0xC6, ENDED)), "write_s")


def _teaching(device: Device, teaching: Teaching | None) -> Device:
    stream = None if teaching is None else Output(out.TAUGHT_END)
    return replace(device, teaching=teaching, stream=stream, stream_number=device.stream_number + 1)


def taught_by(device: Device, grid: tuple[int, int, int], range_m: Floats, farthest_m: float) -> Device:
    """The device after one more scan of its teaching."""
    if device.teaching is None:
        return device
    angles = (grid[0] + grid[1] * np.arange(grid[2])).astype(np.float64)
    return replace(device, teaching=device.teaching.with_scan(angles, range_m, farthest_m))


def levels(device: Device, data: bytes) -> Result:
    """4A: outputs A, B, C; all low in installation mode and with an error, else as the fields are found."""
    if device.mode == INSTALLATION or device.status & 7 >= ERROR:
        return device, Answer(b"\xca\x00\x00\x00")
    if device.fields is None or not device.fields.active:
        return device, Answer(b"\xca\x01\x01\x01")
    return device, Answer(once=Output(out.LEVELS, device.evaluations))


# --- passwords (42, 20 02) ---

PASSWORD = re.compile(rb"[0-9A-Za-z_]{8}\Z")
ASK_AGAIN = 2


def change_password(device: Device, data: bytes) -> Result:
    """42: the password, then the same again as confirmation."""
    step, code, password = data[0], data[1], data[2:]
    if step not in (0, 1) or code not in (0, 1) or PASSWORD.match(password) is None:
        forgotten = replace(device, new_password=None)
        answer = Answer(bytes((0xC2, REFUSED, code)), "data_s", DropReason.BAD_ARGUMENT, f"42: step {step}")
        return forgotten, answer
    if step == 0:
        return replace(device, new_password=data[1:]), Answer(bytes((0xC2, ASK_AGAIN, code)))
    waiting, done = device.new_password, replace(device, new_password=None)
    if waiting != data[1:]:
        return done, Answer(bytes((0xC2, REFUSED, code)), "data_s", DropReason.BAD_ARGUMENT, "42: not the same twice")
    changed = replace(done, maintenance_password=password) if code else replace(done, password=password)
    return changed, Answer(bytes((0xC2, TAKEN, code)), "write_s")


def factory_password(device: Device) -> Device:
    """20 02: the password as it was delivered."""
    return replace(device, password=FACTORY_PASSWORD)


# --- permanent rate, positioning aid, block 2 (66, 69, 7B, 7C) ---


def make_permanent(device: Device, data: bytes) -> Result:
    """66: 00 starts at 9600 again, 01 at the present rate, 02 with the present variant."""
    setting = data[0]
    if setting > 2:
        return declined(device, bytes((0xE6, REFUSED, setting)), f"66 {setting:02X}", "same_write_s")
    if setting == 2:
        changed = replace(device, startup_variant=device.variant)
    else:
        baud = device.baud if setting else FACTORY_BAUD
        changed = replace(device, permanent_baud=bool(setting), startup_baud=baud)
    return changed, Answer(bytes((0xE6, TAKEN, setting)), "same_write_s" if changed == device else "write_s")


def aim(device: Device, data: bytes) -> Result:
    """69: shots in up to three ranges of angles; E9 reports the first one. No other effect is known."""
    step, count = data[0], data[1]
    angles = words(data[2:])
    pairs = list(zip(angles[0::2], angles[1::2], strict=True))[:count]
    reported = bytes((step,)) + data[2:6]
    allowed = step in (25, 50, 100) and 1 <= count <= 3 and len(pairs) == count
    if not allowed or any(not first <= last <= 180 for first, last in pairs):
        return declined(device, bytes((0xE9, REFUSED)) + reported, f"69: {count} ranges at {step}/100 deg")
    return device, Answer(bytes((0xE9, TAKEN)) + reported)


def read_second(device: Device, data: bytes) -> Result:
    """7B."""
    return device, Answer(b"\xfb" + device.second_block)


def write_second(device: Device, data: bytes) -> Result:
    """7C: any number of bytes from the front, as with 77; older hosts send four."""
    new = block.write_second(device.second_block, data, device.configuration, device.model.indoor)
    if new is None:
        return declined(device, b"\xfc\x00" + device.second_block, "7C: pitch, offset or output", "same_write_s")
    delay = "same_write_s" if new == device.second_block else "write_s"
    return replace(device, second_block=new), Answer(b"\xfc\x01" + new, delay)


def hours(device: Device, data: bytes) -> Result:
    """35."""
    double_hours = min(int(device.settings.operating_hours / 2), 0xFFFF)
    return device, Answer(b"\xb5" + word(double_hours) + word(device.switch_ons))
