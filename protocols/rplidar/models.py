"""What sets the RPLIDARs apart on the wire. One row per model; optics are in the sensor specs.

A spec's `device` table is `{model: rplidar-a1m8}`. Sources: `docs/rplidar.md`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

from protocols.errors import DeviceSettingError
from protocols.rplidar.codec import DENSE, EXPRESS, HQ, STANDARD, ULTRA, ULTRA_DENSE


@dataclass(frozen=True)
class Mode:
    """One scan mode, as the configuration entries tell it."""

    name: str
    us: float
    "Per sample."
    most_m: int
    kind: int
    "Form of its data."

    @property
    def period_ns(self) -> Fraction:
        """Per sample, as reported: in 1/256 us."""
        return Fraction(round(256 * self.us) * 1000, 256)


def _modes(us: tuple[float, ...], most_m: int, names: str = "Standard Express Boost Sensitivity Stability") -> Any:
    kinds = {"Standard": STANDARD, "Express": EXPRESS, "DenseBoost": DENSE}
    return tuple(
        Mode(name, each, most_m, kinds.get(name, ULTRA)) for name, each in zip(names.split(), us, strict=False)
    )


EXTRA = (("UltraDense", ULTRA_DENSE), ("HQ", HQ))
"Real forms of newer firmware; of no model a table was found."


@dataclass(frozen=True)
class Model:
    """Facts of one model."""

    model: str
    byte: int
    "Of GET_INFO: major and minor number of the model."
    firmware: tuple[int, int]
    hardware: int
    baud: int
    motor: str
    "dtr: turns unless DTR is set. pwm: by F0. rpm: by A8, and while scanning."
    modes: tuple[Mode, ...]
    typical: int
    boots_with_text: bool
    turn_hz: float
    "At the usual setting of its motor."
    least_hz: float
    most_hz: float
    least_mm: int
    best_quality: int
    "Of a good echo; 0..63."
    triangulates: bool = True

    @property
    def has_conf(self) -> bool:
        """Whether GET_LIDAR_CONF and HQ_SCAN are known."""
        return self.byte >= 0x40 or self.firmware >= (1, 24)

    @property
    def detects_baud(self) -> bool:
        """Whether a run of 41 is measured."""
        return self.byte >= 0x40 or self.firmware >= (1, 30)


_A1 = Model(
    "rplidar-a1m8", 0x18, (1, 29), 7, 115_200, "dtr", _modes((508, 254, 127, 127), 12), 3, True, 7.0, 1.0, 10.0, 150, 15
)
_A2 = replace(
    _A1, model="rplidar-a2m8", byte=0x28, hardware=5, motor="pwm", modes=_modes((500, 250, 125, 125), 12),
    turn_hz=10.0, least_hz=5.0, most_hz=15.0, least_mm=200,
)  # fmt: skip
_S2 = Model(
    "rplidar-s2m1", 0x71, (1, 2), 18, 1_000_000, "rpm", _modes((62.5, 31.25), 30, "Standard DenseBoost"), 1, False,
    10.0, 8.0, 15.0, 50, 47, triangulates=False,
)  # fmt: skip
MODELS: Mapping[str, Model] = {
    one.model: one
    for one in (
        _A1,
        _A2,
        replace(_A2, model="rplidar-a2m12", byte=0x2C, firmware=(1, 32), hardware=6, baud=256_000,
                modes=_modes((252, 126, 63, 63), 16)),
        replace(_A2, model="rplidar-a3m1", byte=0x31, hardware=6, baud=256_000,
                modes=_modes((250, 126, 63, 63, 100), 25)),
        replace(_S2, model="rplidar-s1m1", byte=0x61, firmware=(1, 1), baud=256_000, least_mm=100, typical=2,
                modes=_modes((108.7, 108.7, 108.7), 40, "Standard Express DenseBoost")),
        _S2,
        replace(_S2, model="rplidar-s3m1", byte=0x81, modes=_modes((62.5, 31.25), 40, "Standard DenseBoost"),
                most_hz=20.0),
        replace(_S2, model="rplidar-c1m1", byte=0x41, firmware=(1, 2), baud=460_800, typical=0, most_hz=12.0,
                modes=(Mode("Standard", 200, 16, STANDARD), Mode("DenseBoost", 200, 40, DENSE))),
    )
}  # fmt: skip

OLD: Mapping[tuple[str, str], tuple[Mode, ...]] = {
    ("rplidar-a1m8", "1.24"): _modes((500, 250, 125), 12),
    ("rplidar-a1m8", "1.20"): _modes((500, 250), 12),
}
"Earlier firmware, with its modes."


def with_firmware(model: Model, firmware: str) -> Model:
    """The same with an earlier firmware; `DeviceSettingError` for one that is not known."""
    known = ["{}.{:02d}".format(*model.firmware), *(text for name, text in OLD if name == model.model)]
    if firmware not in known:
        raise DeviceSettingError("firmware", firmware, " | ".join(known))
    if firmware == known[0]:
        return model
    major, minor = firmware.split(".")
    modes = OLD[model.model, firmware]
    return replace(model, firmware=(int(major), int(minor)), modes=modes, typical=len(modes) - 1)


def with_extra(model: Model) -> Model:
    """With modes of the forms that no known table has, at the rate of the standard one."""
    standard = model.modes[0]
    return replace(model, modes=(*model.modes, *(replace(standard, name=name, kind=kind) for name, kind in EXTRA)))
