"""A scenario's `device:` table of an Ouster: what cannot be changed over the wire, and the configuration it is given.

Belongs here: keys, defaults, limits. Not: parameters of the configuration (config), facts of a model (models).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from protocols.errors import DeviceSettingError
from protocols.ouster.config import Firmware, changed, defaults
from protocols.ouster.imu import Errors
from protocols.ouster.models import Model, Unit, unit_of
from protocols.skeleton.keys import DeviceKeys

VERSIONS = ("2.0.0", "2.1.2", "2.2.1", "2.3.1", "2.4.0", "2.5.3", "3.0.1", "3.1.0", "3.2.0")
SERIAL = 122_322_000_614


@dataclass(frozen=True, eq=False)
class Build:
    """What a device is, and its times."""

    version: str
    config: Mapping[str, Any]
    "Persisted when it is delivered."
    given: frozenset[str]
    "Parameters that the scenario sets; a destination that is none of them is that of the link."
    boot_ns: int
    init_ns: int
    spin_up_ns: int
    warm_up_ns: int
    latency_ns: int
    utc_ns: int
    ptp: bool
    ptp_lock_ns: int
    pulses: bool
    sentences: bool
    place_deg: tuple[float, float]
    errors: Errors
    mdns: bool

    @property
    def firmware(self) -> Firmware:
        """Major and minor number."""
        major, minor, _ = self.version.split(".")
        return int(major), int(minor)


def read(keys: DeviceKeys, model: Model) -> tuple[Unit, Build]:
    """All keys, each read once. Raises `DeviceSettingError`."""
    version = keys.choice("firmware", "Which dialect it speaks.", "3.1.0", VERSIONS)
    serial = keys.integer("serial_number", "Of the unit; its calibration follows from it.", SERIAL, 1, (1 << 40) - 1)
    beams = keys.choice("beams", "Beam configuration.", "U", model.choices)
    scatter = keys.flag("own_calibration", "Beam angles scatter from unit to unit; false: those of the table.", True)
    table = keys.table("config", "Configuration parameters as the HTTP interface names them.") or {}
    seconds = {
        name: round(1e9 * keys.number(name, meaning, default, 0.0, 3600.0))
        for name, meaning, default in (
            ("boot_s", "From power-on until it answers.", 1.0),
            ("init_s", "INITIALIZING after the boot, and after a change of the configuration.", 1.0),
            ("spin_up_s", "More of it where the motor starts or changes its speed.", 1.0),
            ("warm_up_s", "WARMUP after the boot, as at -40 degrees.", 0.0),
            ("ptp_lock_s", "From power-on until the clock follows the PTP master.", 5.0),
        )
    }
    build = Build(
        version,
        _config(table, version),
        frozenset(map(str, table)),
        seconds["boot_s"],
        seconds["init_s"],
        seconds["spin_up_s"],
        seconds["warm_up_s"],
        round(1e6 * keys.number("latency_ms", "From the last column of a packet until it is sent.", 2.5, 0.0, 50.0)),
        _utc_ns(keys.text("utc", "UTC at the run's beginning: YYYY-MM-DDTHH:MM:SS.", "2026-01-01T12:00:00", 26)),
        keys.flag("ptp", "There is a PTP master.", False),
        seconds["ptp_lock_s"],
        keys.flag("pps", "A receiver sends a pulse each second.", False),
        keys.flag("nmea", "It sends $GPRMC sentences.", False),
        (
            keys.number("latitude_deg", "In the sentences.", 37.2358, -90.0, 90.0),
            keys.number("longitude_deg", "In the sentences.", -121.7744, -180.0, 180.0),
        ),
        Errors.of(
            serial,
            keys.number("accel_noise_mg_rthz", "Noise density of the accelerometer.", 1.5, 0.0, 100.0),
            keys.number("gyro_noise_deg_s_rthz", "Noise density of the gyro.", 0.05, 0.0, 100.0),
            keys.number("accel_bias_mg", "Bias of the accelerometer, one sigma over units.", 10.0, 0.0, 1000.0),
            keys.number("gyro_bias_deg_s", "Bias of the gyro, one sigma over units.", 0.3, 0.0, 100.0),
            keys.number("imu_scale_share", "Error of both scales, one sigma over units.", 0.005, 0.0, 0.2),
        ),
        keys.flag("mdns", "It announces its HTTP interface by mDNS, in real time; needs the extra `mdns`.", False),
    )
    return unit_of(model, beams, serial, scatter), build


def _config(table: Mapping[str, Any], version: str) -> dict[str, Any]:
    major, minor, _ = version.split(".")
    firmware = int(major), int(minor)
    base = defaults(firmware)
    for name, value in table.items():
        if name not in base:
            raise DeviceSettingError(f"config.{name}", value, f"one of {', '.join(base)} (firmware {version})")
    found = changed(base, {name: list(one) if isinstance(one, tuple) else one for name, one in table.items()}, firmware)
    if isinstance(found, tuple):
        raise DeviceSettingError(f"config.{found[0]}", table.get(found[0]), found[1])
    return found


def _utc_ns(text: str) -> int:
    try:
        when = datetime.fromisoformat(text)
    except ValueError:
        raise DeviceSettingError("utc", text, "a time as 2026-01-01T12:00:00") from None
    when = when if when.tzinfo is not None else when.replace(tzinfo=UTC)
    since = when - datetime(1970, 1, 1, tzinfo=UTC)
    return (since.days * 86_400 + since.seconds) * 1_000_000_000 + since.microseconds * 1000
