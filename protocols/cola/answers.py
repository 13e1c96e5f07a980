"""What the rows of the command table do: values that are computed, checks of what hosts write, methods.

Belongs here: functions of `(device, now_ns)`, `(device, values)` or `(device, values, request)`. Not: the rows.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

import numpy as np

from protocols.cola.layouts import WIDEST_STEP, Angles, Content, Field
from protocols.cola.settings import CLASSIC, LEVELS, RUN, SALTED, Settings
from protocols.cola.state import EPOCH, ColaState
from protocols.session import DropReason
from protocols.skeleton.cola_values import Code
from protocols.skeleton.instants import SECOND_NS
from protocols.skeleton.requests import Refused, Request

Values = Sequence[Any]
SPIN_UP_SHARES = (0.2, 0.5, 0.8)
"Of the time until it measures: STlms says motor start, then rotating, in preparation, ready."


@dataclass(frozen=True)
class Sfa(Refused):
    """Refused with that code."""

    code: Code = Code.UNKNOWN_ERROR


def refusal(code: Code, reason: DropReason = DropReason.BAD_ARGUMENT, detail: str = "") -> Sfa:
    """`sFA` with a code."""
    return Sfa(reason, detail or code.name.lower().replace("_", " "), code)


# ---------------------------------------------------------------- values that are computed


def ident(device: ColaState, now_ns: int) -> Values:
    """Name and version."""
    return [device.settings.model.ident, device.settings.firmware]


def device_state(device: ColaState, now_ns: int) -> Values:
    """SCdevicestate: 0 busy, 1 ready, 2 error."""
    if device.stands or device.contamination()[1]:
        return [2]
    if now_ns < device.up_ns or (device.settings.old and device.levels):
        return [0]
    return [device.settings.model.usable_state]


def status(device: ColaState, now_ns: int) -> Values:
    """STlms."""
    phase = 7
    if not device.measures or device.stands:
        phase = 3
    elif now_ns < device.up_ns:
        share = (now_ns - device.began_ns) / max(1, device.up_ns - device.began_ns)
        phase = (1 if device.cold else 4, 4, 5, 6)[sum(share >= one for one in SPIN_UP_SHARES)]
    year, month, day, hour, minute, second, _ = device.date(now_ns)
    return [phase, 0, f"{hour:02}:{minute:02}:{second:02}", f"{day:02}.{month:02}.{year % 100:02}", 0, 0, 0]


def hours(device: ColaState, now_ns: int) -> Values:
    """Operating hours, in 0.1 h."""
    return [device.settings.hours + (now_ns - (device.first_power_ns or 0)) // (360 * SECOND_NS)]


def celsius(device: ColaState, now_ns: int) -> Values:
    """Inside the housing: from 25 deg towards 35 in half an hour."""
    return [35.0 - 10.0 * float(np.exp((device.began_ns - now_ns) / (600.0 * SECOND_NS)))]


def optics(device: ColaState, now_ns: int) -> Values:
    """LCMstate: 0 none, 1 warning, 2 error, 3 serious error."""
    return [sum(device.window < share for share in (0.7, 0.4, 0.2))]


def contamination(device: ColaState, now_ns: int) -> Values:
    """ContaminationResult."""
    return device.contamination()


def scan_config(device: ColaState, now_ns: int) -> Values:
    """LMPscancfg."""
    model, (frequency, step) = device.settings.model, device.pair
    return [frequency, [[step, model.start, model.stop]]]


def inputs(device: ColaState, now_ns: int) -> Values:
    """LIDinputstate: nothing is wired to them."""
    return [0, device.ticks(now_ns), 0, 0, 0, 0, [list(device.date(now_ns))]]


def outputs(device: ColaState, now_ns: int) -> Values:
    """LIDoutputstate."""
    pairs = device.watching.outputs(device.settings.model.outputs)
    return [0, device.ticks(now_ns), *(word for pair in pairs for word in pair), [list(device.date(now_ns))]]


def results(device: ColaState, now_ns: int) -> Values:
    """LFErec."""
    return device.watching.results(device.ticks(now_ns), list(device.date(now_ns)))


def inertia(device: ColaState, now_ns: int) -> Values:
    """InertialMeasurementUnit: acceleration, rates, magnetic field, quaternion and time of a device at rest."""
    size = 8 if device.settings.wide_imu else 4
    micro = device.clock.shown_ns(now_ns) // 1000 & (1 << 8 * size) - 1
    return [0.0, 0.0, 9.81, *[0.0] * 6, 1.0, 0.0, 0.0, 0.0, micro.to_bytes(size, "big")]


# ---------------------------------------------------------------- values as delivered


def location(settings: Settings) -> Values:
    """LocationName: of an MRS1000 with its serial number."""
    whole = settings.location == "SN " and settings.model.series == "mrs"
    return [f"SN {settings.serial:08d}" if whole else settings.location]


def output_range(settings: Settings) -> Values:
    """LMPoutputRange: the whole field."""
    model, step = settings.model, settings.pair[1]
    coarse = 10_000 if model.name == "sick-tim781" else 2500 if model.series == "mrs" else step
    return [[[coarse, model.start, model.stop]]]


def data_config(settings: Settings) -> Values:
    """LMDscandatacfg."""
    remission, fine = settings.model.remission
    return [1, 0, remission, fine, 0, 0, 0, 0, 0, 0, 1 if settings.model.sends_time else 0, 1]


# ---------------------------------------------------------------- checks of writes


def among(*allowed: int) -> Callable[[ColaState, Values], Code | None]:
    """A check: the first value is one of these."""
    return lambda device, values: None if values[0] in allowed else Code.CONDITION_FAILED


def range_fits(device: ColaState, values: Values) -> Code | None:
    """LMPoutputRange: one sector that overlaps the field."""
    if device.settings.old:
        return Code.WRITE_DENIED
    sectors = values[0]
    if len(sectors) != 1:
        return Code.INVALID_DATA
    ((step, first, last),) = sectors
    model = device.settings.model
    good = 0 < step <= WIDEST_STEP and first <= last and first < model.stop + 10_000 and last > model.start - 10_000
    return None if good else Code.CONDITION_FAILED


def content_fits(device: ColaState, values: Values) -> Code | None:
    """LMDscandatacfg."""
    content = Content(*values)
    angles = content.remission & 2 and device.settings.model.series != "mrs"
    return None if content.fits and not angles else Code.CONDITION_FAILED


def mean_fits(device: ColaState, values: Values) -> Code | None:
    """LFPmeanfilter: 2 to 100 scans."""
    return None if values[0] < 2 and 2 <= values[1] <= 100 else Code.CONDITION_FAILED


def positive(device: ColaState, values: Values) -> Code | None:
    """A number above zero."""
    return None if values[0] > 0.0 else Code.CONDITION_FAILED


def layers_fit(device: ColaState, values: Values) -> Code | None:
    """ScanLayerFilter: a switch for each layer; a layer must be left."""
    model = device.settings.model
    good = len(values[0]) == model.layers and all(one < 2 for (one,) in values[0])
    return None if good and model.layers_on({**device.values, "ScanLayerFilter": values}) else Code.INVALID_DATA


def one_layer_fits(device: ColaState, values: Values) -> Code | None:
    """MMAlignmentMode: all layers, or one that is on."""
    model = device.settings.model
    good = values[0] <= model.layers and model.layers_on({**device.values, "MMAlignmentMode": values})
    return None if good else Code.CONDITION_FAILED


def angles_fit(device: ColaState, values: Values) -> Code | None:
    """LFPangleRangeFilter: rising limits."""
    return None if Angles(*values).fits else Code.CONDITION_FAILED


def field_fits(device: ColaState, values: Values) -> Code | None:
    """A field; not where the device has none."""
    if len(values) == 1:
        return Code.WRITE_DENIED
    return None if Field(*values).fits else Code.INVALID_DATA


# ---------------------------------------------------------------- methods


def log_in(device: ColaState, values: Values, request: Request) -> Values:
    """SetAccessMode: 1 granted, 0 refused."""
    level, word = values
    good = level in device.passwords and device.passwords[level] == word and "login" not in device.faults
    if good:
        device.set_level(request.address, level, request.now_ns)
    return [int(good)]


def challenge(device: ColaState, values: Values, request: Request) -> Values | Sfa:
    """GetChallenge: version 1 without a level, version 2 with one and a salt."""
    settings = device.settings
    if settings.login == CLASSIC:
        return refusal(Code.METHOD_UNKNOWN, DropReason.UNKNOWN_COMMAND)
    salted = settings.login == SALTED
    if len(values[0]) != int(salted):
        return refusal(Code.TOO_LITTLE if salted else Code.TOO_MUCH)
    device.challenges += 1
    drawn = challenge_of(str(settings.serial), device.challenges, request.now_ns)
    device.asked[request.address] = drawn
    return [0, drawn + _salt(settings)]


def answer_challenge(device: ColaState, values: Values, request: Request) -> Values | Sfa:
    """SetUserLevel: 0 granted, 1 no such level, 2 wrong, 3 no challenge; a challenge serves once."""
    settings, (answer,) = device.settings, values
    if settings.login == CLASSIC:
        return refusal(Code.METHOD_UNKNOWN, DropReason.UNKNOWN_COMMAND)
    if len(answer) != 33:
        return refusal(Code.TOO_LITTLE if len(answer) < 33 else Code.TOO_MUCH)
    drawn, level = device.asked.pop(request.address, None), answer[32]
    if drawn is None:
        return [3]
    password = settings.passwords.get(level)
    if password is None:
        return [1]
    wanted = response(long_hash(level, password, _salt(settings)), drawn)
    if answer[:32] != wanted or "login" in device.faults:
        return [2]
    device.set_level(request.address, level, request.now_ns)
    return [0]


def _salt(settings: Settings) -> bytes:
    return challenge_of(str(settings.serial), 0, 0) if settings.login == SALTED else b""


def check_password(device: ColaState, values: Values, request: Request) -> Values:
    """CheckPassword."""
    return [int(device.passwords.get(values[0]) == values[1])]


def set_password(device: ColaState, values: Values, request: Request) -> Values:
    """SetPassword: 1 taken, 0 no such level."""
    if values[0] not in device.passwords:
        return [0]
    device.passwords[values[0]] = values[1]
    return [1]


def log_out(device: ColaState, values: Values, request: Request) -> Values:
    """Run."""
    device.set_level(request.address, RUN, request.now_ns)
    return [1]


def set_scan_config(device: ColaState, values: Values, request: Request) -> Values:
    """mLMPsetscancfg: status and configuration; a refused one comes back as it was asked."""
    frequency, sectors = values
    if len(sectors) != 1:
        return [5, frequency, sectors]
    step = sectors[0][0]
    pairs = device.settings.model.pairs
    if (frequency, step) not in pairs:
        speed, fine = frequency in {one for one, _ in pairs}, step in {two for _, two in pairs}
        return [2 if speed else 1 if fine else 3, frequency, sectors]
    device.reconfigure((frequency, step), request.now_ns)
    return [0, *scan_config(device, request.now_ns)]


def start(device: ColaState, values: Values, request: Request) -> Values:
    """LMCstartmeas."""
    device.start_measuring(request.now_ns)
    return [0]


def stop(device: ColaState, values: Values, request: Request) -> Values:
    """LMCstopmeas, LMCstandby."""
    device.stop_measuring(request.now_ns)
    return [0]


def set_date(device: ColaState, values: Values, request: Request) -> Values:
    """LSPsetdatetime: 1 taken, 0 no such date."""
    try:
        date = datetime(*values)
    except (ValueError, OverflowError):  # 32 bits of microseconds are more than Python takes
        return [0]
    if not EPOCH.year <= date.year < 2100:
        return [0]
    device.set_date((date - EPOCH) // timedelta(microseconds=1), request.now_ns)
    return [1]


def store(device: ColaState, values: Values, request: Request) -> Values:
    """mEEwriteall."""
    device.store()
    return [1]


def factory(device: ColaState, values: Values, request: Request) -> Values:
    """mSCloadfacdef."""
    device.forget(request.now_ns)
    return []


def nothing(device: ColaState, values: Values, request: Request) -> Values:
    """mSCreboot: what it does is in its row."""
    return []


# ---------------------------------------------------------------- the login by challenge


def long_hash(level: int, password: str, salt: bytes = b"") -> bytes:
    """SHA-256 that a device with the login by challenge keeps; `salt` of version 2, empty in version 1."""
    text = f"{LEVELS[level]}:SICK Sensor:{password}".encode("latin-1")
    return hashlib.sha256(text + (b":" + salt if salt else b"")).digest()


def response(kept: bytes, challenge: bytes) -> bytes:
    """What a host must answer a challenge with."""
    return hashlib.sha256(kept + challenge).digest()


def challenge_of(serial: str, number: int, now_ns: int) -> bytes:
    """Sixteen bytes that come once: devices draw them, this one derives them so that runs are repeatable."""
    return hashlib.sha256(f"{serial}:{number}:{now_ns}".encode()).digest()[:16]
