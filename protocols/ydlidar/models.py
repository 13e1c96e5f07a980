"""What sets YDLIDAR's scanners apart on the wire, and the keys of a scenario's `device:` table.

Belongs here: one row per model (spec 3.1), keys, defaults, limits. Not: optics (the sensor specs).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from protocols.errors import DeviceSettingError
from protocols.skeleton.keys import DeviceKeys
from protocols.skeleton.turning import Motor

HEALTH = ("good", "warning", "error")


@dataclass(frozen=True)
class Model:
    """Facts of one model."""

    model: str
    code: int
    "First byte of the device info."
    baud: int
    rates_hz: tuple[int, ...]
    "Samples a second, by the code of D0 and D1."
    rate: int
    "Code at power-on."
    least_m: tuple[float, ...]
    "Least range, for each rate or for all."
    most_m: float
    hz: tuple[float, float, float]
    "Least, at power-on, most."
    triangulates: bool
    bits: tuple[int, ...] = (0,)
    "Of intensity; the first is the default."
    unit_mm: float = 0.25
    answers: bool = True
    sets: bool = True
    "It has the commands for speed, rate and others, and stops its motor with the stream."
    speed_offset: float = 0.0
    "Subtracted from the speed of a zero packet. [Hz]"
    aim_offset: int = 0
    "Added to the aimed speed of 0D. [0.01 Hz]"
    restart: int = 0x40

    def least(self, rate: int) -> float:
        """Least range at a rate."""
        return self.least_m[min(rate, len(self.least_m) - 1)]


MODELS: Mapping[str, Model] = {
    one.model: one
    for one in (
        Model("ydlidar-x2", 6, 115_200, (3000,), 0, (0.10,), 8.0, (4.0, 7.0, 8.0), True, answers=False, sets=False),
        Model("ydlidar-x4", 6, 128_000, (5000,), 0, (0.12,), 10.0, (5.0, 7.0, 12.0), True, sets=False, restart=0x80),
        Model("ydlidar-g4", 5, 230_400, (4000, 8000, 9000), 2, (0.10, 0.26, 0.28), 16.0, (5.0, 7.0, 12.0), True),
        Model(
            "ydlidar-tg15", 100, 512_000, (10_000, 16_000, 18_000, 20_000), 0, (0.05,), 15.0, (3.0, 10.0, 16.0), False,
            bits=(0, 16), unit_mm=1.0, speed_offset=3.0, aim_offset=40,
        ),
        Model("ydlidar-t-mini", 140, 230_400, (4000,), 0, (0.05,), 12.0, (5.0, 10.0, 12.0), False, bits=(8,)),
    )
}  # fmt: skip


@dataclass(frozen=True)
class Settings:
    """One device."""

    motor: Motor
    boot_ns: int
    bits: int
    firmware: tuple[int, int]
    hardware: int
    serial: str
    health: int
    has_module_info: bool
    has_stamps: bool
    dtr_drives_motor: bool


def read(keys: DeviceKeys, model: Model) -> Settings:
    """All keys, each read once. Raises `DeviceSettingError`."""
    least, usual, most = model.hz
    hz = keys.number("speed_hz", "Turns per second at power-on (by PWM where no command sets it).", usual, least, most)
    spin_up = keys.number("spin_up_s", "From standstill until the motor is at speed.", 0.5, 0.0, 60.0)
    wobble = keys.number("speed_wobble", "Most that the speed of the motor differs, as a share.", 0.01, 0.0, 0.2)
    bits = int(keys.number_of("intensity_bits", "Of a sample; 16 is the TG15 I.", model.bits[0], model.bits))
    dtr = "DTR drives the motor, as with the USB board; it is seen with the shim only."
    serial = keys.text("serial_number", "16 digits of the device info.", "2024011500000123", 16)
    if len(serial) != 16 or not serial.isdigit():
        raise DeviceSettingError("serial_number", serial, "16 digits")
    return Settings(
        Motor(hz, round(1e9 * spin_up), wobble),
        round(1e9 * keys.number("boot_s", "From power-on or restart until it answers.", 0.5, 0.0, 60.0)),
        bits,
        (keys.integer("firmware_major", "Of the device info.", 1, 0, 255),
         keys.integer("firmware_minor", "Of the device info.", 5, 0, 255)),
        keys.integer("hardware", "Version of the device info.", 3, 0, 255),
        serial,
        HEALTH.index(keys.choice("health", "Answer to 91 and 92; error: it sends no samples.", "good", HEALTH)),
        keys.flag("module_info", "The device info is sent once, 0.2 s after the stream has begun.", model.answers),
        keys.flag("stamp_packets", "A packet with the time in ms goes before each zero packet.", False),
        keys.flag("dtr_motor", dtr, not model.sets),
    )  # fmt: skip
