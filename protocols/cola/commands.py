"""Variables, methods and events of the CoLa devices: one table that dispatches, checks and is the coverage page.

Belongs here: rows: each name with its layout, who may, on which model. Not: what a row does (answers).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from protocols.cola import answers, layouts
from protocols.cola.answers import Sfa, Values
from protocols.cola.models import Model
from protocols.cola.settings import AUTHORISED, LEVELS, RUN, SERVICE, Settings
from protocols.cola.state import ColaState
from protocols.session import CommandRow
from protocols.skeleton.cola_values import ASCII, BINARY, Code
from protocols.skeleton.requests import Request


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
    live: Callable[[ColaState, int], Values] | None = None
    "(device, now_ns)"
    level: int | None = AUTHORISED
    "Needed for writing; None: read only."
    check: Callable[[ColaState, Values], Code | None] | None = None
    "Why values that fit the layout are refused."
    rearranges: bool = False
    "Scans are others after a write."
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
    act: Callable[[ColaState, Values, Request], Values | Sfa]
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
    says: Variable | None = None
    "What it reports; None: nothing here, or scans."
    dialects: tuple[bytes, ...] = (ASCII, BINARY)


def _empty_field(number: int) -> Callable[[Settings], Values]:
    def factory(settings: Settings) -> Values:
        model = settings.model
        if number >= model.fields:
            return [0]
        return list(layouts.Field(2.0 if model.series == "lms5" else 1.0, 0.0, settings.pair[1], model.start))

    return factory


def _field(number: int) -> Callable[[Model], str]:
    """Behind those that an LMS has it answers a single 0, up to 29 [REC]."""
    return lambda model: layouts.RECORD if number < model.fields else "u8"


def _has_field(number: int) -> Callable[[Model], bool]:
    return lambda model: number < model.fields or (model.fields == 10 and number < 30)


ZONES = range(-12, 15)
PI = 3.1415927410125732
"As a float of 32 bit: 40490FDB."
LISTED = "drivers' sources and recorded start-ups"
MANUAL = "telegram examples of the manuals"
WRITTEN = "drivers write it; the layout is theirs"
MEMORY = "name from memory of the telegram listing"

VARIABLES: Mapping[str, Variable] = {
    "DeviceIdent": Variable(
        "str str", None, "recorded TiM561, MRS1000", answers.ident, None, note="also sRI 0"),
    "FirmwareVersion": Variable("str", lambda settings: [settings.firmware], "recorded", None, None),
    "SerialNumber": Variable("str", lambda settings: [f"{settings.serial:08d}"], "recorded", None, None),
    "SCdevicestate": Variable("u8", None, "recorded", answers.device_state, None),
    "STlms": Variable("u16 u8 str str u32 u32 u32", None, MANUAL, answers.status, None),
    "ODoprh": Variable("u32", None, "recorded", answers.hours, None),
    "ODpwrc": Variable("u32", None, "recorded", lambda device, now: [device.power_ups], None),
    "LCMstate": Variable("u8", None, MANUAL, answers.optics, None, on=_series("lms1", "lms5")),
    "ContaminationResult": Variable(
        "u8 u8", None, "vendor's driver", answers.contamination, None, on=_series("mrs")),
    "OPcurtmpdev": Variable("f32", None, MEMORY, answers.celsius, None, note="law of warm-up: an assumption"),
    "LocationName": Variable("str", answers.location, "recorded"),
    "EIHstCola": Variable("u8", lambda settings: [1 if settings.model.series == "mrs" else 0], LISTED,
                          check=answers.among(0, 1)),
    "LMPscancfg": Variable("u32 [u32 i32 i32]", None, "recorded LMS111", answers.scan_config, None),
    "LMPoutputRange": Variable("[u32 i32 i32]", answers.output_range, "recorded LMS111", check=answers.range_fits,
                               rearranges=True, note="stored as written; scans keep the grid"),
    "LMDscandatacfg": Variable("u8 u8 u8 u8 u8 u8 u8 u8 u8 u8 u8 u16", answers.data_config, "recorded LMS511",
                               check=answers.content_fits, rearranges=True, note="position block is a guess"),
    "LMDscandatascalefactor": Variable("f32", lambda settings: [1.0], WRITTEN, check=answers.among(1, 2),
                                       rearranges=True, on=_series("lms5")),
    "FREchoFilter": Variable("u8", lambda settings: [2], MANUAL, check=answers.among(0, 1, 2), rearranges=True,
                             on=_series("lms5", "mrs")),
    "LFPparticle": Variable("u8 u16", lambda settings: [0, 500], "vendor's driver, template",
                            check=answers.among(0, 1), rearranges=True),
    "LFPmeanfilter": Variable("u8 u16 u8", lambda settings: [0, 2, 0], MANUAL, check=answers.mean_fits,
                              rearranges=True, on=_series("lms1", "lms5", "mrs")),
    "LFPmedianfilter": Variable("u8 u16", lambda settings: [0, 3], MANUAL, check=answers.among(0, 1),
                                rearranges=True, on=_series("lms5", "mrs")),
    "LFPangleRangeFilter": Variable("u8 f32 f32 f32 f32 u8", lambda settings: [0, -PI, PI, -PI / 2, PI / 2, 1],
                                    "vendor's driver, for its newer devices", check=answers.angles_fit, rearranges=True,
                                    on=_series("mrs"), note="angles in rad, 0 ahead; outside: distance 0"),
    "ScanLayerFilter": Variable("[u8]", lambda settings: [[[1]] * settings.model.layers], "vendor's driver",
                                check=answers.layers_fit, rearranges=True, on=_series("mrs")),
    "SetActiveApplications": Variable("[s4 u8]", lambda settings: [[["RANG", 1]]], "recorded MRS1000",
                                      on=_series("mrs")),
    "MMAlignmentMode": Variable("u8", lambda settings: [0], "vendor's driver, not sent", check=answers.one_layer_fits,
                                rearranges=True, on=_series("mrs"), note="0: all layers; 1 to 4: one, from below"),
    "LICsrc": Variable("u8", lambda settings: [1], WRITTEN, on=_series("lms1", "lms5")),
    "LICencset": Variable("u8", lambda settings: [0], WRITTEN, check=answers.among(0, 1, 2, 3), rearranges=True,
                          on=_series("lms1", "lms5")),
    "LICencres": Variable("f32", lambda settings: [1.0], WRITTEN, check=answers.positive, rearranges=True,
                         on=_series("lms1", "lms5"), note="as mm per tick"),
    "DO3And4Fnc": Variable("u8", lambda settings: [0], WRITTEN, check=answers.among(0, 1), on=_series("lms5")),
    "TSCRole": Variable("u8", lambda settings: [0], WRITTEN, check=answers.among(0, 1, 2)),
    "TSCTCInterface": Variable("u8", lambda settings: [0], WRITTEN),
    "TSCTCSrvAddr": Variable("u8 u8 u8 u8", lambda settings: [192, 168, 0, 2], WRITTEN),
    "TSCTCupdatetime": Variable("u32", lambda settings: [5], WRITTEN),
    "TSCTCtimezone": Variable("i8", lambda settings: [0], WRITTEN, check=answers.among(*ZONES),
                              note="in hours, of the server's time; the unit is an assumption"),
    "EIIpAddr": Variable("u8 u8 u8 u8", lambda settings: [192, 168, 0, 1], WRITTEN, note="stored; links stay"),
    "EIgate": Variable("u8 u8 u8 u8", lambda settings: [0, 0, 0, 0], WRITTEN, note="stored"),
    "ActiveFieldSet": Variable("u16", lambda settings: [1], WRITTEN, on=_has_fields, rearranges=True,
                               check=lambda device, values: None if 1 <= values[0] <= 16 else Code.OUT_OF_BOUNDS),
    "LIDinputstate": Variable(layouts.INPUTS, None, "recorded LMS511", answers.inputs, None,
                              on=_has_fields),
    "LIDoutputstate": Variable(lambda model: layouts.outputs_layout(model.outputs), None, "recorded LMS511, TiM781S",
                               answers.outputs, None, on=_has_fields),
    "LFErec": Variable(layouts.RESULTS, None, "recorded TiM781S", answers.results, None,
                       on=_has_fields),
    **{
        f"field{number:03d}": Variable(
            _field(number), _empty_field(number), "recorded LMS111, LMS511", check=answers.field_fits, rearranges=True,
            on=_has_field(number), note="written as it is read: no source shows a write")
        for number in range(48)
    },
}  # fmt: skip


METHODS: Mapping[str, Method] = {
    "SetAccessMode": Method("u8 u32", "u8", answers.log_in, "drivers' sources; hash of the password recomputed"),
    "CheckPassword": Method("u8 u32", "u8", answers.check_password, MANUAL),
    "SetPassword": Method("u8 u32", "u8", answers.set_password, MANUAL, SERVICE, note="kept by mEEwriteall"),
    "GetChallenge": Method("*", "u8 *", answers.challenge,
                           "SICK visionary base classes", note="with login: challenge 1 or challenge 2 alone"),
    "SetUserLevel": Method("*", "u8", answers.answer_challenge,
                           "SICK visionary base classes", note="the same"),
    "Run": Method("", "u8", answers.log_out, "drivers' sources", note="1, as drivers need; a manual prints 0"),
    "LMCstartmeas": Method("", "u8", answers.start, "drivers' sources", AUTHORISED),
    "LMCstopmeas": Method("", "u8", answers.stop, "drivers' sources",
                          note="without a login too: a driver's last words"),
    "LMCstandby": Method("", "u8", answers.stop, "drivers' sources", AUTHORISED, on=_series("lms1", "lms5")),
    "mLMPsetscancfg": Method("u32 [u32 i32 i32]", "u8 u32 [u32 i32 i32]", answers.set_scan_config,
                             "recorded LMS111, MRS1000", AUTHORISED),
    "mEEwriteall": Method("", "u8", answers.store, "drivers' sources", AUTHORISED),
    "mSCreboot": Method("", "", answers.nothing, "drivers' sources", AUTHORISED, restarts=True),
    "mSCloadfacdef": Method("", "", answers.factory, MEMORY, AUTHORISED, note="kept only by mEEwriteall"),
    "LSPsetdatetime": Method("u16 u8 u8 u8 u8 u8 u32", "u8", answers.set_date, "an LMS5xx driver", AUTHORISED),
}  # fmt: skip

INERTIA = Variable("f32 " * 13 + "*", None, "", answers.inertia)

EVENTS: Mapping[str, Event] = {
    "LMDscandata": Event("all drivers"),
    "LIDoutputstate": Event("recorded LMS511, TiM781S", _has_fields, says=VARIABLES["LIDoutputstate"]),
    "LFErec": Event("recorded TiM781S", _has_fields, "CoLa-B alone: the driver that asks in CoLa-A cannot read it",
                    VARIABLES["LFErec"], (BINARY,)),
    "LIDinputstate": Event("recorded LMS511", _has_fields, "inputs never change"),
    "InertialMeasurementUnit": Event("recorded MRS1000", _series("mrs"), "CoLa-B; at rest, whatever the mount",
                                     INERTIA, (BINARY,)),
}  # fmt: skip

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
