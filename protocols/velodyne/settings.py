"""Settings of a Velodyne: a scenario's `device:` table, and what the web interface changes.

Belongs here: keys, defaults, limits. Not: facts of a model (models), and what a setting does (device).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime

from protocols.errors import DeviceSettingError
from protocols.skeleton.keys import DeviceKeys
from protocols.velodyne.models import MODES, Mode

RPM = (300, 1200)
SLICE_NS = 5_000_000
"How long a slice is at least, if the scenario does not say."


@dataclass(frozen=True)
class Settings:
    """What the device keeps when it is ordered to save."""

    mode: Mode = "strongest"
    rpm: int = 600
    laser: bool = True
    fov: tuple[int, int] = (0, 359)
    "First and last azimuth of the head, in degrees clockwise; first > last: through 0."
    phase_lock: bool = False
    phase_cdeg: int = 0
    host: tuple[tuple[str, str], ...] = (("addr", "255.255.255.255"), ("dport", "2368"), ("tport", "8308"))
    "Reported, not used: links are the scenario's."
    net: tuple[tuple[str, str], ...] = (
        ("addr", "192.168.1.201"),
        ("mask", "255.255.255.0"),
        ("gateway", "192.168.1.1"),
        ("dhcp", "off"),
    )

    @property
    def sees_all(self) -> bool:
        """Whether the field of view is the whole turn."""
        return (self.fov[1] - self.fov[0]) % 360 == 359


@dataclass(frozen=True)
class Build:
    """What cannot be changed over the wire."""

    serial: str
    boot_ns: int
    spin_up_ns: int
    slice_packets: int
    "0: as many as take `SLICE_NS`."
    utc_ns: int
    pps: bool
    nmea: bool
    place_deg: tuple[float, float]


def read(keys: DeviceKeys) -> tuple[Settings, Build]:
    """All keys, each read once. Raises `DeviceSettingError`."""
    fov = keys.integers("fov_deg", "First and last azimuth measured, clockwise from ahead.", (0, 359), 0, 359)
    settings = Settings(
        _mode(keys.choice("returns", "Which returns it sends.", "strongest", tuple(MODES))),
        keys.integer("rpm", "Revolutions a minute.", 600, *RPM),
        keys.flag("laser", "Whether it fires.", True),
        (fov[0], fov[1]),
        keys.flag("phase_lock", "The head is at `phase_deg` at each pulse of the GPS.", False),
        round(100 * keys.number("phase_deg", "Of the phase lock, clockwise from ahead.", 0.0, 0.0, 359.99)),
    )
    utc = keys.text("utc", "UTC at the beginning of the run, as YYYY-MM-DDTHH:MM:SS.", "2026-01-01T12:00:00", 26)
    build = Build(
        keys.text("serial_number", "Reported by the web interface.", "AE00000001", 16),
        round(1e9 * keys.number("boot_s", "From power-on until it sends.", 1.0, 0.0, 60.0)),
        round(1e9 * keys.number("spin_up_s", "From power-on until the motor is at its speed.", 3.0, 0.0, 60.0)),
        keys.integer("slice_packets", "Packets measured together, at least 2; 0: those of 5 ms.", 0, 0, 1000),
        _utc_ns(utc),
        keys.flag("pps", "A GPS receiver sends a pulse each second.", False),
        keys.flag("nmea", "It sends $GPRMC sentences.", False),
        (
            keys.number("latitude_deg", "In the sentences.", 37.2358, -90.0, 90.0),
            keys.number("longitude_deg", "In the sentences.", -121.7744, -180.0, 180.0),
        ),
    )
    if build.slice_packets == 1:
        raise DeviceSettingError("slice_packets", 1, "0, or an integer from 2 to 1000")
    return settings, build


def _mode(text: str) -> Mode:
    return next(one for one in MODES if one == text)


def _utc_ns(text: str) -> int:
    try:
        when = datetime.fromisoformat(text)
    except ValueError:
        raise DeviceSettingError("utc", text, "a time as 2026-01-01T12:00:00") from None
    when = when if when.tzinfo is not None else when.replace(tzinfo=UTC)
    since = when - datetime(1970, 1, 1, tzinfo=UTC)
    return (since.days * 86_400 + since.seconds) * 1_000_000_000 + since.microseconds * 1000


def changed(settings: Settings, path: str, fields: Mapping[str, str]) -> Settings | str:
    """Settings after a form of the web interface; else what is wrong with it. All of a form, or nothing."""
    for key, text in fields.items():
        if (found := _set(settings, path, key, text)) is None:
            return f"{path}: {key}={text}"[:80]
        settings = found
    return settings


def _set(old: Settings, path: str, key: str, text: str) -> Settings | None:
    number = int(text) if text.isascii() and text.isdecimal() and len(text) < 6 else -1
    switch = {"on": True, "off": False}.get(text.lower())
    if path == "setting":
        if key == "rpm" and RPM[0] <= number <= RPM[1]:
            return replace(old, rpm=number)
        if key == "returns" and text.lower() in MODES:
            return replace(old, mode=_mode(text.lower()))
        if key == "laser" and switch is not None:
            return replace(old, laser=switch)
    if (path, key) in (("fov", "start"), ("setting", "fov_start")) and 0 <= number < 360:
        return replace(old, fov=(number, old.fov[1]))
    if (path, key) in (("fov", "end"), ("setting", "fov_end")) and 0 <= number < 360:
        return replace(old, fov=(old.fov[0], number))
    if path == "phaselock" and key == "enabled" and switch is not None:
        return replace(old, phase_lock=switch)
    if path == "phaselock" and key == "offset" and 0 <= number < 36_000:
        return replace(old, phase_cdeg=number)
    if path in ("host", "net"):
        table = dict(getattr(old, path))
        if key in table and text.isascii() and text.isprintable() and len(text) <= 40:
            reported = tuple((table | {key: text}).items())
            return replace(old, host=reported) if path == "host" else replace(old, net=reported)
    return None
