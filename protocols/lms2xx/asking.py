"""What is asked of measured values: from the parameters of 20 20..50, 30, 36, 37, 3E, 3F, 44, 75, 76 to an `Output`.

Each reader gives the output, or in words what is wrong with the parameters: they are answered with 92.
"""

from __future__ import annotations

from collections.abc import Callable

from protocols.lms2xx import outputs as out
from protocols.lms2xx.answers import Answer, Handler, Result, refused
from protocols.lms2xx.device import Device
from protocols.lms2xx.outputs import Find, Output
from protocols.lms2xx.telegrams import MAX_GROUPS, MAX_REPLY_PAYLOAD, OVERHEAD_BYTES, words
from protocols.session import DropReason

Reader = Callable[[Device, bytes], Output | str]

MEAN_SCANS = range(2, 251)
DIRECT = 0x8000
"Bit of the first beam's word in 20 27 and 37: a telegram straight after each turn."
MOST_FIELD_VALUES, MOST_PLACES, MOST_SEGMENTS = 100, 200, 201


def _range_fault(device: Device, first: int, last: int) -> str | None:
    if 1 <= first <= last <= device.variant.points:
        return None
    return f"beams {first}..{last} of {device.variant.points}"


def mean(device: Device, data: bytes) -> Output | str:
    """36, 20 26."""
    return Output(out.MEAN, data[0]) if data[0] in MEAN_SCANS else f"mean of {data[0]} scans"


def sub_range(device: Device, data: bytes) -> Output | str:
    """37, 20 27."""
    first, last = words(data)
    direct = bool(first & DIRECT)
    first &= ~DIRECT
    return _range_fault(device, first, last) or Output(out.SUB_RANGE, groups=((first, last),), direct=direct)


def mean_sub_range(device: Device, data: bytes) -> Output | str:
    """3F, 20 28; the number of scans as a byte, or as the word that the listing prints."""
    scans = int.from_bytes(data[:-4], "little")
    first, last = words(data[-4:])
    if scans not in MEAN_SCANS:
        return f"mean of {scans} scans"
    return _range_fault(device, first, last) or Output(out.MEAN_SUB_RANGE, scans, ((first, last),))


def reflectivity(device: Device, data: bytes) -> Output | str:
    """44, 20 50."""
    first, last = words(data)
    if not device.model.fast:
        return "only S14 models have C4"
    return _range_fault(device, first, last) or Output(out.REFLECTIVITY, groups=((first, last),))


def intensity(device: Device, data: bytes) -> Output | str:
    """75, 20 2B."""
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
    return output if size <= MAX_REPLY_PAYLOAD + OVERHEAD_BYTES else f"telegram of {size} bytes"


def segments(on_object: bool) -> Reader:
    """20 20, 20 21: the segments of field A, one for a field without."""

    def read(device: Device, data: bytes) -> Output | str:
        field = device.field_sets[device.active_set - 1][0]
        found = Output(out.ALL, find=Find.SEGMENTS, count=field.segments, field=field, on_object=on_object)
        return "S14 models have no fields" if device.model.fast else found

    return read


def verticals(on_object: bool = False) -> Reader:
    """20 22, 20 23, 30 02: a value for each field with an extent."""

    def read(device: Device, data: bytes) -> Output | str:
        fields = device.fields
        if fields is None or not fields.active:
            return "no field"
        return Output(out.ALL, find=Find.VERTICAL, count=fields.active, on_object=on_object)

    return read


def group_minima(device: Device, data: bytes) -> Output | str:
    """20 2C: a byte, then first and last beam of each segment."""
    if not 1 <= data[0] <= MOST_SEGMENTS or len(data) != 1 + 4 * data[0]:
        return f"{data[0]} segments in {len(data)} bytes"
    beams = words(data[1:])
    groups = tuple(zip(beams[0::2], beams[1::2], strict=True))
    for first, last in groups:
        if fault := _range_fault(device, first, last):
            return fault
    return Output(out.SUB_RANGE, groups=groups, find=Find.GROUPS)


def field_values(device: Device, data: bytes) -> Output | str:
    """3E, 20 29."""
    return _limited(device, data, out.FIELD_VALUES, MOST_FIELD_VALUES)


def places(device: Device, data: bytes) -> Output | str:
    """76."""
    return _limited(device, data, out.CARTESIAN, MOST_PLACES)


def _limited(device: Device, data: bytes, command: int, most: int) -> Output | str:
    first, last = words(data)
    if fault := _range_fault(device, first, last):
        return fault
    count = last - first + 1
    return Output(command, groups=((first, last),)) if count <= most else f"{count} beams; at most {most}"


def _taught(device: Device) -> Output | str:
    if device.taught is None:
        return "no field was taught"
    number, place = device.taught
    return Output(out.ALL, find=Find.TAUGHT, count=device.variant.points, field=device.field_sets[number - 1][place])


NO_FIELDS, NO_PARTIAL = "this model has no fields", "this model has no partial scans"


def kind_of_scan(device: Device, data: bytes) -> Output | str:
    """30."""
    kind, fast = data[0], device.model.fast
    # 05 B4: probe of old CARMEN and Orca, which take any B0; reserved in the listing.
    if (kind, len(data)) in ((1, 1), (5, 2)):
        return Output(out.ALL)
    if len(data) != 1 or kind not in (2, 3, 6, 7, 8):
        return f"{data.hex(' ').upper()} is reserved"
    if kind == 2:
        return verticals()(device, b"")
    if kind == 3:
        return NO_FIELDS if fast else _taught(device)
    if kind == 8:
        return NO_PARTIAL if fast else Output(out.ALL, partial=True)
    return Output(out.ALL, every=2 if kind == 6 else 20)


def once(code: str, read: Reader) -> Handler:
    """A handler that answers with one telegram of values."""

    def measure(device: Device, data: bytes) -> Result:
        output = read(device, data)
        if isinstance(output, str):
            return refused(device, DropReason.BAD_ARGUMENT, f"{code}: {output}")
        return device, Answer(once=output)

    return measure
