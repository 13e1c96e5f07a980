"""Variables, methods and events of the CoLa devices: one table that dispatches, checks and is the coverage page.

Belongs here: what each name holds or does, in which layout, who may. Not: scans (session), layouts of scans (scandata).
"""

from __future__ import annotations

import calendar
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Protocol

from protocols.cola import fields, scandata
from protocols.cola.login import AUTHORISED, LEVELS, RUN, SERVICE
from protocols.cola.models import Model, Pair
from protocols.cola.settings import Settings
from protocols.session import CommandRow, DropReason
from protocols.skeleton.cola_values import Code, short_hash
from protocols.skeleton.requests import Refused, Request

Values = Sequence[Any]


class Device(Protocol):
    """What the rows need of a session; instants are `now_ns`."""

    settings: Settings
    values: dict[str, Any]
    "Of each variable that is stored."
    passwords: dict[int, int]
    pair: Pair
    window: float
    power_ups: int

    def rearrange(self, now_ns: int) -> None: ...

    def reconfigure(self, pair: Pair, now_ns: int) -> None: ...

    def start_measuring(self, now_ns: int) -> None: ...

    def stop_measuring(self, now_ns: int) -> None: ...

    def set_date(self, micro: int, now_ns: int) -> None: ...

    def store(self) -> None: ...

    def forget(self, now_ns: int) -> None: ...

    def log_in(self, level: int, request: Request) -> bool: ...

    def challenge(self, asked: bytes, request: Request) -> Any: ...

    def answer(self, response: bytes, request: Request) -> Any: ...

    def ident(self) -> Values: ...

    def contamination(self) -> Values: ...

    def state(self, now_ns: int) -> int: ...

    def status(self, now_ns: int) -> Values: ...

    def hours(self, now_ns: int) -> int: ...

    def celsius(self, now_ns: int) -> float: ...

    def inputs(self, now_ns: int) -> Values: ...

    def outputs(self, now_ns: int) -> Values: ...

    def results(self, now_ns: int) -> Values: ...


@dataclass(frozen=True)
class Sfa(Refused):
    """Refused with that code."""

    code: Code = Code.UNKNOWN_ERROR


def refusal(code: Code, reason: DropReason = DropReason.BAD_ARGUMENT, detail: str = "") -> Sfa:
    """`sFA` with a code."""
    return Sfa(reason, detail or code.name.lower().replace("_", " "), code)


def anywhere(model: Model) -> bool:
    """Every model has it."""
    return True


def _series(*names: str) -> Callable[[Model], bool]:
    return lambda model: model.series in names


def _has_fields(model: Model) -> bool:
    return model.fields > 0


@dataclass(frozen=True)
class Variable:
    """Something that is read, and perhaps written."""

    layout: str | Callable[[Model], str]
    factory: Callable[[Settings], Values] | None
    "As delivered; None: computed by `live`."
    source: str
    live: Callable[[Device, int], Values] | None = None
    "(device, now_ns)"
    level: int | None = AUTHORISED
    "Needed for writing; None: read only."
    check: Callable[[Device, Values], Code | None] | None = None
    "Why values that fit the layout are refused."
    changed: Callable[[Device, int], None] | None = None
    "(device, now_ns), after a write."
    on: Callable[[Model], bool] = anywhere
    note: str = ""

    def layout_of(self, model: Model) -> str:
        """Its layout in that model."""
        return self.layout if isinstance(self.layout, str) else self.layout(model)


@dataclass(frozen=True)
class Method:
    """Something that is called."""

    arguments: str
    result: str
    act: Callable[[Device, Values, Request], Values | Sfa | None]
    "None: answered later, by the session."
    source: str
    level: int = RUN
    on: Callable[[Model], bool] = anywhere
    note: str = ""
    restarts: bool = False


@dataclass(frozen=True)
class Event:
    """Something that a host subscribes to."""

    source: str
    on: Callable[[Model], bool] = anywhere
    note: str = ""


# ---------------------------------------------------------------- checks and effects of variables


def _among(*allowed: int) -> Callable[[Device, Values], Code | None]:
    return lambda device, values: None if values[0] in allowed else Code.CONDITION_FAILED


def _range_fits(device: Device, values: Values) -> Code | None:
    if device.settings.old:
        return Code.WRITE_DENIED
    sectors = values[0]
    if len(sectors) != 1:
        return Code.INVALID_DATA
    ((step, first, last),) = sectors
    model = device.settings.model
    good = (
        0 < step <= scandata.WIDEST_STEP
        and first <= last
        and first < model.stop + 10_000
        and last > model.start - 10_000
    )
    return None if good else Code.CONDITION_FAILED


def _content_fits(device: Device, values: Values) -> Code | None:
    return None if scandata.fits(values, device.settings.model.echoes) else Code.CONDITION_FAILED


def _mean_fits(device: Device, values: Values) -> Code | None:
    return None if values[0] < 2 and 2 <= values[1] <= 100 else Code.CONDITION_FAILED


def _positive(device: Device, values: Values) -> Code | None:
    return None if values[0] > 0.0 else Code.CONDITION_FAILED


def _layers_fit(device: Device, values: Values) -> Code | None:
    switches = [one for (one,) in values[0]]
    good = len(switches) == device.settings.model.layers and max(switches) == 1
    return None if good else Code.INVALID_DATA


def _angles_fit(device: Device, values: Values) -> Code | None:
    on, left, right, low, high, every = values
    return None if on < 2 and left <= right and low <= high and every > 0 else Code.CONDITION_FAILED


def _field_fits(device: Device, values: Values) -> Code | None:
    if len(values) == 1:
        return Code.WRITE_DENIED
    points = [angles for (angles,) in values[6]]
    good = values[0] > 0.0 and values[4] < 4 and not values[8] and max(map(len, values[6:10])) < 2
    rising = all(one[0] < two[0] for part in points for one, two in pairwise(part))
    return None if good and rising else Code.INVALID_DATA


def _scans_change(device: Device, now_ns: int) -> None:
    device.rearrange(now_ns)


def _location(settings: Settings) -> Values:
    whole = settings.location == "SN " and settings.model.series == "mrs"
    return [f"SN {settings.serial:08d}" if whole else settings.location]


def _output_range(settings: Settings) -> Values:
    model, step = settings.model, settings.pair[1]
    coarse = 10_000 if model.name == "sick-tim781" else 2500 if model.series == "mrs" else step
    return [[[coarse, model.start, model.stop]]]


def _scan_config(device: Device, now_ns: int) -> Values:
    model, (frequency, step) = device.settings.model, device.pair
    return [frequency, [[step, model.start, model.stop]]]


def _data_config(settings: Settings) -> Values:
    remission, fine = settings.model.remission
    return [1, 0, remission, fine, 0, 0, 0, 0, 0, 0, 1 if settings.model.sends_time else 0, 1]


def _empty_field(number: int) -> Callable[[Settings], Values]:
    def factory(settings: Settings) -> Values:
        model = settings.model
        if number >= model.fields:
            return [0]
        return fields.empty(2.0 if model.series == "lms5" else 1.0, settings.pair[1], model.start)

    return factory


def _field(number: int) -> Callable[[Model], str]:
    """Behind those that an LMS has it answers a single 0, up to 29 [REC]."""
    return lambda model: fields.RECORD if number < model.fields else "u8"


def _has_field(number: int) -> Callable[[Model], bool]:
    return lambda model: number < model.fields or (model.fields == 10 and number < 30)


def _optics(device: Device, now_ns: int) -> Values:
    return [0 if (share := device.window) >= 0.7 else 1 if share >= 0.4 else 2 if share >= 0.2 else 3]


ZONES = range(-12, 15)
PI = 3.1415927410125732
"As a float of 32 bit: 40490FDB."
LISTED = "drivers' sources and recorded start-ups"
MANUAL = "telegram examples of the manuals"
WRITTEN = "drivers write it; the layout is theirs"
MEMORY = "name from memory of the telegram listing"

VARIABLES: Mapping[str, Variable] = {
    "DeviceIdent": Variable(
        "str str", None, "recorded TiM561, MRS1000", lambda device, now: device.ident(), None, note="also sRI 0"),
    "FirmwareVersion": Variable("str", lambda settings: [settings.firmware], "recorded", None, None),
    "SerialNumber": Variable("str", lambda settings: [f"{settings.serial:08d}"], "recorded", None, None),
    "SCdevicestate": Variable("u8", None, "recorded", lambda device, now: [device.state(now)], None),
    "STlms": Variable("u16 u8 str str u32 u32 u32", None, MANUAL, lambda device, now: device.status(now), None),
    "ODoprh": Variable("u32", None, "recorded", lambda device, now: [device.hours(now)], None),
    "ODpwrc": Variable("u32", None, "recorded", lambda device, now: [device.power_ups], None),
    "LCMstate": Variable("u8", None, MANUAL, lambda device, now: _optics(device, now), None,
                         on=_series("lms1", "lms5")),
    "ContaminationResult": Variable(
        "u8 u8", None, "vendor's driver", lambda device, now: device.contamination(), None, on=_series("mrs")),
    "OPcurtmpdev": Variable("f32", None, MEMORY, lambda device, now: [device.celsius(now)], None,
                            note="law of warm-up: an assumption"),
    "LocationName": Variable("str", _location, "recorded"),
    "EIHstCola": Variable("u8", lambda settings: [1 if settings.model.series == "mrs" else 0], LISTED,
                          check=_among(0, 1)),
    "LMPscancfg": Variable("u32 [u32 i32 i32]", None, "recorded LMS111", _scan_config, None),
    "LMPoutputRange": Variable("[u32 i32 i32]", _output_range, "recorded LMS111", check=_range_fits,
                               changed=_scans_change, note="stored as written; scans keep the grid"),
    "LMDscandatacfg": Variable("u8 u8 u8 u8 u8 u8 u8 u8 u8 u8 u8 u16", _data_config, "recorded LMS511",
                               check=_content_fits, changed=_scans_change, note="position block is a guess"),
    "LMDscandatascalefactor": Variable("f32", lambda settings: [1.0], WRITTEN, check=_among(1, 2),
                                       changed=_scans_change, on=_series("lms5")),
    "FREchoFilter": Variable("u8", lambda settings: [2], MANUAL, check=_among(0, 1, 2), changed=_scans_change,
                             on=_series("lms5", "mrs")),
    "LFPparticle": Variable("u8 u16", lambda settings: [0, 500], "vendor's driver, template",
                            check=_among(0, 1), changed=_scans_change),
    "LFPmeanfilter": Variable("u8 u16 u8", lambda settings: [0, 2, 0], MANUAL, check=_mean_fits,
                              changed=_scans_change, on=_series("lms1", "lms5", "mrs")),
    "LFPmedianfilter": Variable("u8 u16", lambda settings: [0, 3], MANUAL, check=_among(0, 1),
                                changed=_scans_change, on=_series("lms5", "mrs")),
    "LFPangleRangeFilter": Variable("u8 f32 f32 f32 f32 u8", lambda settings: [0, -PI, PI, -PI / 2, PI / 2, 1],
                                    "vendor's driver, for its newer devices", check=_angles_fit, changed=_scans_change,
                                    on=_series("mrs"), note="angles in rad, 0 ahead; outside: distance 0"),
    "ScanLayerFilter": Variable("[u8]", lambda settings: [[[1]] * settings.model.layers], "vendor's driver",
                                check=_layers_fit, changed=_scans_change, on=_series("mrs")),
    "SetActiveApplications": Variable("[s4 u8]", lambda settings: [[["RANG", 1]]], "recorded MRS1000",
                                      on=_series("mrs")),
    "MMAlignmentMode": Variable("u8", lambda settings: [0], "vendor's driver, not sent", on=_series("mrs"),
                                note="stored; without effect"),
    "LICsrc": Variable("u8", lambda settings: [1], WRITTEN, on=_series("lms1", "lms5")),
    "LICencset": Variable("u8", lambda settings: [0], WRITTEN, check=_among(0, 1, 2, 3), changed=_scans_change,
                          on=_series("lms1", "lms5")),
    "LICencres": Variable("f32", lambda settings: [1.0], WRITTEN, check=_positive, changed=_scans_change,
                         on=_series("lms1", "lms5"), note="as mm per tick"),
    "DO3And4Fnc": Variable("u8", lambda settings: [0], WRITTEN, check=_among(0, 1), on=_series("lms5")),
    "TSCRole": Variable("u8", lambda settings: [0], WRITTEN, check=_among(0, 1, 2)),
    "TSCTCInterface": Variable("u8", lambda settings: [0], WRITTEN),
    "TSCTCSrvAddr": Variable("u8 u8 u8 u8", lambda settings: [192, 168, 0, 2], WRITTEN),
    "TSCTCupdatetime": Variable("u32", lambda settings: [5], WRITTEN),
    "TSCTCtimezone": Variable("i8", lambda settings: [0], WRITTEN, check=_among(*ZONES),
                              note="in hours, of the server's time; the unit is an assumption"),
    "EIIpAddr": Variable("u8 u8 u8 u8", lambda settings: [192, 168, 0, 1], WRITTEN, note="stored; links stay"),
    "EIgate": Variable("u8 u8 u8 u8", lambda settings: [0, 0, 0, 0], WRITTEN, note="stored"),
    "ActiveFieldSet": Variable("u16", lambda settings: [1], WRITTEN, on=_has_fields, changed=_scans_change,
                               check=lambda device, values: None if 1 <= values[0] <= 16 else Code.OUT_OF_BOUNDS),
    "LIDinputstate": Variable(fields.INPUTS, None, "recorded LMS511", lambda device, now: device.inputs(now), None,
                              on=_has_fields),
    "LIDoutputstate": Variable(lambda model: fields.outputs_layout(model.outputs), None, "recorded LMS511, TiM781S",
                               lambda device, now: device.outputs(now), None, on=_has_fields),
    "LFErec": Variable(fields.RESULTS, None, "recorded TiM781S", lambda device, now: device.results(now), None,
                       on=_has_fields),
    **{
        f"field{number:03d}": Variable(
            _field(number), _empty_field(number), "recorded LMS111, LMS511", check=_field_fits, changed=_scans_change,
            on=_has_field(number), note="written as it is read: no source shows a write")
        for number in range(48)
    },
}  # fmt: skip


# ---------------------------------------------------------------- methods


def _log_in(device: Device, values: Values, request: Request) -> Values:
    level, word = values
    known = level in device.passwords and device.passwords[level] == word
    return [int(known and device.log_in(level, request))]


def _check_password(device: Device, values: Values, request: Request) -> Values:
    return [int(device.passwords.get(values[0]) == values[1])]


def _set_password(device: Device, values: Values, request: Request) -> Values:
    if values[0] not in device.passwords:
        return [0]
    device.passwords[values[0]] = values[1]
    return [1]


def _log_out(device: Device, values: Values, request: Request) -> Values:
    device.log_in(RUN, request)
    return [1]


def _set_scan_config(device: Device, values: Values, request: Request) -> Values:
    frequency, sectors = values
    if len(sectors) != 1:
        return [5, frequency, sectors]
    step = sectors[0][0]
    pairs = device.settings.model.pairs
    if (frequency, step) not in pairs:
        speed, fine = frequency in {one for one, _ in pairs}, step in {two for _, two in pairs}
        return [2 if speed else 1 if fine else 3, frequency, sectors]
    device.reconfigure((frequency, step), request.now_ns)
    return [0, *_scan_config(device, request.now_ns)]


def _start(device: Device, values: Values, request: Request) -> Values:
    device.start_measuring(request.now_ns)
    return [0]


def _stop(device: Device, values: Values, request: Request) -> Values:
    device.stop_measuring(request.now_ns)
    return [0]


def _set_date(device: Device, values: Values, request: Request) -> Values:
    year, month, day, hour, minute, second, micro = values
    good = 1970 <= year < 2100 and 1 <= month <= 12 and 1 <= day <= 31 and hour < 24 and minute < 60
    if not good or day > calendar.monthrange(year, month)[1] or second > 59 or micro > 999_999:
        return [0]
    seconds = calendar.timegm((year, month, day, hour, minute, second))
    device.set_date(seconds * 1_000_000 + micro, request.now_ns)
    return [1]


def _store(device: Device, values: Values, request: Request) -> Values:
    device.store()
    return [1]


def _factory(device: Device, values: Values, request: Request) -> Values:
    device.forget(request.now_ns)
    return []


def _nothing(device: Device, values: Values, request: Request) -> Values:
    return []


METHODS: Mapping[str, Method] = {
    "SetAccessMode": Method("u8 u32", "u8", _log_in, "drivers' sources; hash of the password recomputed"),
    "CheckPassword": Method("u8 u32", "u8", _check_password, MANUAL),
    "SetPassword": Method("u8 u32", "u8", _set_password, MANUAL, SERVICE, note="kept by mEEwriteall"),
    "GetChallenge": Method("*", "u8 *", lambda device, values, request: device.challenge(values[0], request),
                           "SICK visionary base classes", note="with login: challenge 1 or challenge 2 alone"),
    "SetUserLevel": Method("*", "u8", lambda device, values, request: device.answer(values[0], request),
                           "SICK visionary base classes", note="the same"),
    "Run": Method("", "u8", _log_out, "drivers' sources", note="1, as drivers need; a manual prints 0"),
    "LMCstartmeas": Method("", "u8", _start, "drivers' sources", AUTHORISED),
    "LMCstopmeas": Method("", "u8", _stop, "drivers' sources", note="without a login too: a driver's last words"),
    "LMCstandby": Method("", "u8", _stop, "drivers' sources", AUTHORISED, on=_series("lms1", "lms5")),
    "mLMPsetscancfg": Method("u32 [u32 i32 i32]", "u8 u32 [u32 i32 i32]", _set_scan_config, "recorded LMS111, MRS1000",
                             AUTHORISED),
    "mEEwriteall": Method("", "u8", _store, "drivers' sources", AUTHORISED),
    "mSCreboot": Method("", "", _nothing, "drivers' sources", AUTHORISED, restarts=True),
    "mSCloadfacdef": Method("", "", _factory, MEMORY, AUTHORISED, note="kept only by mEEwriteall"),
    "LSPsetdatetime": Method("u16 u8 u8 u8 u8 u8 u32", "u8", _set_date, "an LMS5xx driver", AUTHORISED),
}  # fmt: skip

EVENTS: Mapping[str, Event] = {
    "LMDscandata": Event("all drivers"),
    "LIDoutputstate": Event("recorded LMS511, TiM781S", _has_fields),
    "LFErec": Event("recorded TiM781S", _has_fields, "CoLa-B alone: the driver that asks in CoLa-A cannot read it"),
    "LIDinputstate": Event("recorded LMS511", _has_fields, "inputs never change"),
    "InertialMeasurementUnit": Event("recorded MRS1000", _series("mrs"), "CoLa-B; at rest, whatever the mount"),
}

ABSENT = (
    ("MMTechoes", "named in an issue, in no source"),
    ("LFPfog", "the fog filter's name is not known; key fog_filter"),
    ("EnableLegacyUserLevel", "picoScan"),
    ("mCLsetscancfglist", "LRS4000, LD-LRS36xx, LD-OEM15xx"),
)


def codes() -> tuple[str, ...]:
    """Whatever a host may say: command type and name."""
    reads, calls = [f"sRN {name}" for name in VARIABLES], [f"sMN {name}" for name in METHODS]
    writes, events = [f"sWN {name}" for name in VARIABLES], [f"sEN {name}" for name in EVENTS]
    return ("sRI", "sRN LMDscandata", *reads, *writes, *calls, *events)


def rows() -> tuple[CommandRow, ...]:
    """The coverage table; fields are one row."""
    found = [CommandRow("sRI 0", "read DeviceIdent by index", "done", "recorded TiM561"),
             CommandRow("sRN LMDscandata", "poll the last scan", "done", "drivers' sources")]  # fmt: skip
    for name, one in VARIABLES.items():
        if name.startswith("field0") and name != "field000":
            continue
        shown = "field000..047" if name == "field000" else name
        found.append(CommandRow(f"sRN {shown}", "read", "done", one.source, one.note))
        if one.level is not None:
            found.append(CommandRow(f"sWN {shown}", f"write, as {LEVELS[one.level]}", "done", one.source, one.note))
    for name, call in METHODS.items():
        found.append(CommandRow(f"sMN {name}", f"call, as {LEVELS[call.level]}", "done", call.source, call.note))
    found += [CommandRow(f"sEN {name}", "subscribe", "done", one.source, one.note) for name, one in EVENTS.items()]
    found += [CommandRow(name, "", "absent", why, "sFA 2 or 3") for name, why in ABSENT]
    return tuple(found)


def default_passwords(settings: Settings) -> dict[int, int]:
    """Level -> hash, as delivered."""
    return {level: short_hash(text) for level, text in settings.passwords.items()}
