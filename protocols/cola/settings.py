"""The scenario's `device:` table of a CoLa device: what it is as delivered, and how it behaves.

Belongs here: keys with their defaults. Not: variables that hosts write (commands).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction

from protocols.cola.models import MODELS, Model
from protocols.skeleton.keys import DeviceKeys

CLASSIC, SALTED = "classic", "challenge 2"

LEVELS = ("Run", "Operator", "Maintenance", "AuthorizedClient", "Service")
"By number; the names are those that the login by challenge hashes."
RUN, OPERATOR, MAINTENANCE, AUTHORISED, SERVICE = range(5)

PASSWORDS: Mapping[int, str] = {MAINTENANCE: "main", AUTHORISED: "client", SERVICE: "servicelevel"}
"As delivered (drivers' sources, hashes recomputed)."


@dataclass(frozen=True)
class Settings:
    """One device."""

    model: Model
    serial: int
    firmware: str
    location: str
    pair: tuple[int, int]
    ready_s: float
    change_s: float
    strict: bool
    "Writes and methods need their user level."
    dialect: str
    "both | host: only that of EIHstCola."
    login: str
    "classic | challenge 1 | challenge 2: what GetChallenge does."
    quiet_login: bool
    "No scans while a host is logged in."
    fog: bool
    edge_m: float
    "Neighbours that differ by more are both taken away; 0: off."
    encoder_mm_s: float
    "Speed of the belt whose encoder is wired to the device."
    passwords: dict[int, str]
    hours: int
    "0.1 h."
    power_ups: int
    ntp_epoch_s: float
    "Time of the NTP server at the beginning of the run, from 1970."
    serial_baud: int
    wide_imu: bool

    @property
    def old(self) -> bool:
        """An LMS1xx before V1.60: it refuses to write LMPoutputRange, and is busy after a login [REC]."""
        version = [int(part) for part in self.firmware.strip().lstrip("V").split(".")[:2] if part.isdigit()]
        return self.model.series == "lms1" and version < [1, 60]


def settings_of(keys: DeviceKeys) -> Settings:
    """Read the table. Raises `DeviceSettingError`."""
    name = keys.choice("model", "which device it is; the spec says", "sick-lms111", tuple(MODELS))
    model = MODELS[name]
    serial = keys.integer("serial_number", "serial number", 12_345_678, 0, 0xFFFFFFFF)
    frequencies = sorted({frequency / 100 for frequency, _ in model.pairs})
    hertz = keys.number_of("frequency_hz", "scan frequency as delivered", model.default[0] / 100, frequencies)
    steps = sorted({step / 10_000 for frequency, step in model.pairs if frequency == round(hertz * 100)})
    usual = model.default[1] / 10_000
    step = keys.number_of("step_deg", "angular step as delivered, as the wire has it (0.1667)",
                          usual if usual in steps else steps[0], steps)  # fmt: skip
    return Settings(
        model=model,
        serial=serial,
        firmware=keys.text("firmware", "FirmwareVersion", model.firmware, 16),
        location=keys.text("location", "LocationName; of an MRS1000 with its serial number behind", model.location, 16),
        pair=(round(hertz * 100), round(step * 10_000)),
        ready_s=keys.number("ready_s", "from power-on until it measures", model.ready_s, 0.5, 300.0),
        change_s=keys.number("change_s", "without scans after another scan configuration", model.change_s, 0.0, 60.0),
        strict=keys.choice("access", "strict: writes need a login", "strict", ("strict", "open")) == "strict",
        dialect=keys.choice("dialect", "both, or that of EIHstCola alone", "both", ("both", "host")),
        login=keys.choice("login", "what GetChallenge does", CLASSIC, (CLASSIC, "challenge 1", SALTED)),
        quiet_login=keys.flag("quiet_login", "no scans while a host is logged in", False),
        fog=keys.flag("fog_filter", "weak echoes of the near field are taken away", False),
        edge_m=keys.number("edge_filter_m", "MRS1000: neighbours that differ by more than this are taken away; 0: off",
                           0.0, 0.0, 100.0),
        encoder_mm_s=keys.number("encoder_mm_s", "LMS: speed of the belt at the encoder", 0.0, -60_000.0, 60_000.0),
        passwords={
            MAINTENANCE: keys.text("password_maintenance", "user level 2", PASSWORDS[MAINTENANCE], 32),
            AUTHORISED: keys.text("password_client", "user level 3", PASSWORDS[AUTHORISED], 32),
            SERVICE: keys.text("password_service", "user level 4", PASSWORDS[SERVICE], 32),
        },
        hours=keys.integer("operating_hours", "ODoprh at the beginning, in 0.1 h", 1_000, 0, 0xFFFFFF),
        power_ups=keys.integer("power_ups", "ODpwrc before the run", 41, 0, 0xFFFFFF),
        ntp_epoch_s=keys.number(
            "ntp_epoch_s", "time of its NTP server at the beginning of the run, from 1970", 0.0, 0, 4e9
        ),
        serial_baud=keys.integer("serial_baud", "speed of its serial line", 57_600, 9_600, 500_000),
        wide_imu=keys.flag("imu_64_bit", "MRS1000: the IMU's time has 64 bits", True),
    )  # fmt: skip


def period_of(settings: Settings) -> Fraction:
    """From telegram to telegram as delivered. [ns]"""
    return settings.model.telegram_ns(settings.pair)
