"""Keys of a scenario's `device:` table: what a real scanner has by its wiring, its flash memory or its condition.

Belongs here: keys, defaults, limits. Not: facts of a model (models).
"""

from __future__ import annotations

from dataclasses import dataclass

from protocols.errors import DeviceSettingError
from protocols.scip.models import Model
from protocols.skeleton.keys import DeviceKeys

PORTS = ("usb", "rs232", "ethernet")


@dataclass(frozen=True)
class Settings:
    """One device."""

    port: str
    baud: int
    scip1: bool
    "It starts in SCIP 1.1."
    serial: str
    boot_ns: int
    spin_up_ns: int
    laser_on_ns: int
    reply_ns: int
    gain: float
    faulty: bool


def read(keys: DeviceKeys, model: Model) -> Settings:
    """All keys, each read once. Raises `DeviceSettingError`."""
    port = keys.choice("port", "How it is wired; bit rates matter on rs232 only.", model.ports[0], PORTS)
    if port not in model.ports:
        raise DeviceSettingError("port", port, " | ".join(model.ports))
    baud = keys.integer("baud", "Bit rate of rs232 at power-on.", model.baud, 1, 1_000_000)
    if baud not in model.rates:
        raise DeviceSettingError("baud", baud, " | ".join(map(str, model.rates)))
    protocol = keys.choice("protocol", "At power-on; SCIP1.1 on a URG-04LX only.", "SCIP2.0", ("SCIP2.0", "SCIP1.1"))
    if protocol == "SCIP1.1" and not model.has_scip1:
        raise DeviceSettingError("protocol", protocol, "SCIP2.0")
    return Settings(
        port,
        baud,
        protocol == "SCIP1.1",
        keys.text("serial_number", "SERI of VV.", model.serial, 16),
        _ns(keys.number("boot_s", "From power-on until it answers.", 0.5, 0.0, 60.0)),
        _ns(keys.number("spin_up_s", "From power-on or sleep until the motor is at speed.", 1.0, 0.0, 60.0)),
        _ns(keys.number("laser_on_s", "From BM or a measuring command until the laser measures.", 0.0, 0.0, 10.0)),
        _ns(keys.number("reply_s", "From a command to its reply.", 0.001, 0.0, 0.1)),
        keys.number("high_sensitivity", "Factor of HS1 on the received power.", 2.0, 1.0, 100.0),
        keys.choice("condition", "abnormal: it reports a fault, only a restart ends it.", "normal", CONDITIONS)
        == "abnormal",
    )


CONDITIONS = ("normal", "abnormal")


def _ns(seconds: float) -> int:
    return round(1e9 * seconds)
