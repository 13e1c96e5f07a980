"""Settings of a Hesai: a scenario's `device:` table, and what PTC and HTTP change; all survive power-off.

Belongs here: keys, defaults, limits. Not: facts of a model (models), and what a setting does (device).
"""

from __future__ import annotations

import ipaddress
from dataclasses import dataclass
from datetime import UTC, datetime

from protocols.errors import DeviceSettingError
from protocols.hesai.models import DUAL, MODES, Model
from protocols.skeleton.keys import DeviceKeys

SLICE_NS = 5_000_000
"How long a slice is at least, if the scenario does not say."
WHOLE = (0, 3600)
"Range of azimuths that leaves nothing out, in 0.1 deg."
PORTS = (2368, 10110)
"Of the point cloud and of GPS packets."
PTP_1588 = bytes((0, 0, 0, 1, 1, 0))
"Profile, domain, network, and three logarithms of intervals."
PTP_AUTOSAR = bytes((3, 0, 1, 1))
"Profile, domain, network, whether the switch knows time-sensitive networking."


_TRIGGERS = "angle", "time"


@dataclass(frozen=True)
class Settings:
    """What hosts can change."""

    mode: int
    rpm: int
    high: bool = False
    standby: bool = False
    sync: bool = False
    sync_deg: int = 0
    trigger: int = 0
    "0 by angle, 1 by time."
    by_ptp: bool = False
    backwards: bool = False
    range_ddeg: tuple[tuple[int, int], ...] = (WHOLE,)
    "First and last azimuth of sections, 0.1 deg; first > last: through 0."
    range_said: bytes = b"\0\0\0\x0e\x10"
    "As command 22 had it."
    ptp: bytes = PTP_1588
    ptp_offset_us: int = 0
    blockage: bool = False
    destination: tuple[str, int, int] | None = None
    "Address and ports of the point cloud and of GPS packets; None: those of the links."
    network: bytes = bytes((192, 168, 1, 201, 255, 255, 255, 0, 192, 168, 1, 1, 0, 0, 0))
    "Reported, not used: address, mask, gateway, VLAN."

    @property
    def sees_all(self) -> bool:
        """Whether the range leaves nothing out."""
        return WHOLE in self.range_ddeg


@dataclass(frozen=True)
class Build:
    """What cannot be changed over the wire."""

    serial: str
    boot_ns: int
    spin_up_ns: int
    slice_packets: int
    "0: as many as take `SLICE_NS`."
    utc_ns: int
    ptp: bool
    pps: bool
    nmea: bool
    gpgga: bool
    "They are $GPGGA, not $GPRMC."
    place_deg: tuple[float, float]
    said_to: tuple[str, int, int]
    "Destination that the configuration has until a host sets another."
    signed: bool


def read(keys: DeviceKeys, model: Model) -> tuple[Settings, Build]:
    """All keys, each read once. Raises `DeviceSettingError`."""
    names = {_name(model, mode): mode for mode in model.modes}
    mode = keys.choice("returns", "Which returns it sends.", next(iter(names)), tuple(names))
    rpm = keys.number_of("rpm", "Revolutions a minute.", model.rpm[0], model.rpm)
    high = keys.flag("high_resolution", "Twice as many firings; half of the outer lasers in each.", False)
    if high and not model.high_ns:
        raise DeviceSettingError("high_resolution", high, f"false, for a {model.title}")
    spans = keys.integers("range_deg", "First and last azimuth measured, clockwise.", (0, 360), 0, 360)
    if spans != (0, 360) and model.calibrated == "at128":
        raise DeviceSettingError("range_deg", list(spans), f"[0, 360], for a {model.title}")
    tenths = 10 * spans[0], 10 * spans[1]
    settings = Settings(
        names.get(mode, model.modes[0]),
        round(rpm),
        high,
        keys.flag("standby", "It is in standby when it is switched on.", False),
        keys.flag("sync", "The rotor is at `sync_deg` at each full second of PTP or GPS.", False),
        keys.integer("sync_deg", "Angle of it, clockwise.", 0, 0, 359),
        _TRIGGERS.index(keys.choice("trigger", "What fires the lasers.", _TRIGGERS[model.trigger], _TRIGGERS)),
        keys.choice("clock_source", "What its clock follows.", "gps", ("gps", "ptp")) == "ptp",
        range_ddeg=(tenths,),
        range_said=b"\0" + tenths[0].to_bytes(2, "big") + tenths[1].to_bytes(2, "big"),
        ptp=ptp_default(model),
        blockage=keys.flag("blockage_detection", "An OT128 says why a channel has no return.", False),
    )
    build = Build(
        keys.text("serial_number", "Reported in the inventory.", "XT32A1B2C3D4E5F6G7", 18),
        round(1e9 * keys.number("boot_s", "From power-on until it answers.", 3.0, 0.0, 60.0)),
        round(1e9 * keys.number("spin_up_s", "From then until the motor is at speed and it fires.", 8.0, 0.0, 60.0)),
        keys.integer("slice_packets", "Packets measured together, at least 2; 0: those of 5 ms.", 0, 0, 1000),
        _utc_ns(
            keys.text("utc", "UTC at the beginning of the run, as YYYY-MM-DDTHH:MM:SS.", "2026-01-01T12:00:00", 26)
        ),
        keys.flag("ptp", "There is a PTP grandmaster.", True),
        keys.flag("pps", "A GPS receiver sends a pulse each second.", False),
        keys.flag("nmea", "It sends sentences of NMEA.", False),
        keys.choice("nmea_sentence", "Which ones the device takes.", "gprmc", ("gprmc", "gpgga")) == "gpgga",
        (
            keys.number("latitude_deg", "In the sentences.", 31.15, -90.0, 90.0),
            keys.number("longitude_deg", "In the sentences.", 121.3, -180.0, 180.0),
        ),
        (
            _address(keys.text("destination", "Reported until a host sets another.", "255.255.255.255", 15)),
            keys.integer("data_port", "Reported so too.", PORTS[0], 1, 65_535),
            keys.integer("gps_port", "Reported so too.", PORTS[1], 1, 65_535),
        ),
        keys.flag("signature", "Packets of 128 lasers end with a signature, of zeros.", False),
    )
    if build.slice_packets == 1:
        raise DeviceSettingError("slice_packets", 1, "0, or an integer from 2 to 1000")
    if build.signed and "safety" not in model.layout.places:
        raise DeviceSettingError("signature", True, f"false, for a {model.title}")
    return settings, build


def _name(model: Model, mode: int) -> str:
    return "last_first" if mode == DUAL and model.dual_is_first else MODES[mode][0]


def ptp_default(model: Model) -> bytes:
    """Configuration of PTP of a new unit."""
    return PTP_AUTOSAR if model.number == 42 else PTP_1588 + bytes(model.number == 48)


def ptp_length(model: Model, profile: int) -> int | None:
    """Bytes of a PTP configuration; None: no such profile."""
    return {0: 6 + (model.number in (42, 48)), 1: 3, 2: 4, 3: 4}.get(profile)


def _address(text: str) -> str:
    try:
        return str(ipaddress.IPv4Address(text))
    except ValueError:
        raise DeviceSettingError("destination", text, "an IPv4 address") from None


def _utc_ns(text: str) -> int:
    try:
        when = datetime.fromisoformat(text)
    except ValueError:
        raise DeviceSettingError("utc", text, "a time as 2026-01-01T12:00:00") from None
    since = (when if when.tzinfo is not None else when.replace(tzinfo=UTC)) - datetime(1970, 1, 1, tzinfo=UTC)
    return (since.days * 86_400 + since.seconds) * 1_000_000_000 + since.microseconds * 1000
