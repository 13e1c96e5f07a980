"""Keys of a scenario's `device:` table: what a real scanner has by its wiring, its flash memory or its condition.

Belongs here: keys, defaults, limits. Not: facts of a model (models).
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

from protocols.errors import DeviceSettingError
from protocols.rplidar.models import Model, with_extra, with_firmware
from protocols.skeleton.keys import DeviceKeys

HEALTH = ("good", "warning", "error")
FIRMWARE = "that of the model"


@dataclass(frozen=True)
class Settings:
    """One device."""

    serial: bytes
    health: int
    error_code: int
    turn_hz: float
    wobble: float
    "Share of the speed by which it goes up and down."
    spin_up_ns: int
    boot_ns: int
    reply_ns: int


def read(keys: DeviceKeys, model: Model) -> tuple[Model, Settings]:
    """All keys, each read once, and the model as they have it. Raises `DeviceSettingError`."""
    firmware = keys.text("firmware", "Of GET_INFO; an A1M8 may have 1.24 or 1.20.", FIRMWARE, 20)
    if firmware != FIRMWARE:
        model = with_firmware(model, firmware)
    if keys.flag("extra_modes", "Two more scan modes: UltraDense (86) and HQ (83).", False):
        model = with_extra(model)
    made = hashlib.sha256(model.model.encode()).hexdigest()[:32].upper()
    serial = keys.text("serial_number", "32 hexadecimal digits.", made, 32)
    try:
        number = bytes.fromhex(serial)
    except ValueError:
        number = b""
    if len(number) != 16:
        raise DeviceSettingError("serial_number", serial, "32 hexadecimal digits")
    return model, Settings(
        number,
        HEALTH.index(keys.choice("health", "error: protection stop, only RESET ends it.", "good", HEALTH)),
        keys.integer("error_code", "Of GET_HEALTH when it is not good.", 0, 0, 0xFFFF),
        keys.number("turn_hz", "Of the motor as it is usually set; PWM 660 is this speed.", model.turn_hz, 1.0, 20.0),
        keys.number("wobble", "Share by which its speed goes up and down.", 0.005, 0.0, 0.2),
        _ns(keys.number("spin_up_s", "From standstill until the motor is stable.", 1.5, 0.0, 60.0)),
        _ns(keys.number("boot_s", "From power-on or RESET until it answers.", 0.8, 0.0, 60.0)),
        _ns(keys.number("reply_s", "From a request to its reply.", 0.0005, 0.0, 0.1)),
    )


def _ns(seconds: float) -> int:
    return round(1e9 * seconds)
