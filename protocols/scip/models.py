"""What sets Hokuyo's scanners apart on the wire. One row per model; optics are in the sensor specs.

A spec's `device` table is `{model: hokuyo-utm-30lx}`. Sources: the table of `docs/scip.md`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

from protocols.scip.codec import Limits

RATES = (19_200, 38_400, 57_600, 115_200, 250_000, 500_000, 750_000)
"Bit rates of `SS`."
ERRORS_20 = {"short": "0C", "long": "0C", "tag": "0H", "unknown": "0E", "absent": "0E", "abnormal": "50"}
"Of SCIP 2.0; urg_c takes 0E for a command that the product lacks."
ERRORS_22 = {"short": "0H", "long": "0D", "tag": "0G", "unknown": "0E", "absent": "0E", "abnormal": "0L"}
"Of SCIP 2.2 (hokuyolx, statuses.py, from the maker's description of UST and UTM-30LX-EW)."


@dataclass(frozen=True)
class Model:
    """Facts of one model."""

    model: str
    "Identifier, as the sensor spec is called."
    title: str
    "Behind MODL; PROD has the part before the bracket."
    firmware: str
    serial: str
    least_mm: int
    most_mm: int
    steps: int
    "Of a whole turn (ARES)."
    first: int
    last: int
    front: int
    rpm: int
    "SCAN"
    period_ms: Fraction
    protocol: str = "SCIP 2.0"
    ports: tuple[str, ...] = ("usb",)
    "usb | rs232 | ethernet; the first is the default."
    rates: tuple[int, ...] = RATES
    baud: int = 19_200
    "Of RS-232 at power-on."
    has_scip1: bool = False
    has_intensity: bool = True
    has_echoes: bool = False
    has_motor_speed: bool = False
    has_sensitivity: bool = False
    no_echo: int = 1
    intensity_scale: float = 50.0
    "Counts at the detection threshold; ours."

    @property
    def errors(self) -> Mapping[str, str]:
        """Status of each kind of refused command."""
        return ERRORS_22 if self.protocol == "SCIP 2.2" else ERRORS_20

    @property
    def limits(self) -> Limits:
        """What a distance may be."""
        return Limits(self.least_mm, self.most_mm, self.no_echo, 0, 0x3FFFF, self.intensity_scale)


_PHASE: dict[str, Any] = {"steps": 1024, "has_intensity": False, "has_motor_speed": True, "ports": ("usb", "rs232")}
_WIDE: dict[str, Any] = {"steps": 1440, "first": 0, "last": 1080, "front": 540, "rpm": 2400, "period_ms": Fraction(25)}
_UTM = Model(
    "hokuyo-utm-30lx", "UTM-30LX(Hokuyo Automatic Co.,Ltd.)", "1.18.01(16/Apr./2013)", "H0800235", 23, 60_000, **_WIDE
)
_UST = Model(
    "hokuyo-ust-10lx", "UST-10LX", "3.0.00(01/Jan./2015)", "H1500001", 20, 30_000, **_WIDE,
    protocol="SCIP 2.2", ports=("ethernet",), no_echo=65_533,
)  # fmt: skip
_URG = Model(
    "hokuyo-urg-04lx", "URG-04LX(Hokuyo Automatic Co.,Ltd.)", "3.3.00,16/Apr./2008(20-4000[mm],240[deg])",
    "H0508486", 20, 5_600, first=44, last=725, front=384, rpm=600, period_ms=Fraction(100), has_scip1=True,
    has_sensitivity=True, **_PHASE,
)  # fmt: skip
MODELS: Mapping[str, Model] = {
    one.model: one
    for one in (
        _URG,
        replace(
            _URG, model="hokuyo-ubg-04lx-f01", title="UBG-04LX-F01(Hokuyo Automatic Co.,Ltd.)", rpm=2142,
            firmware="1.1.00(20/Dec./2007)", serial="H0700001", period_ms=Fraction(28), baud=115_200, has_scip1=False,
        ),
        replace(
            _URG, model="hokuyo-uhg-08lx", title="UHG-08LX(Hokuyo Automatic Co.,Ltd.)", rpm=900, least_mm=30,
            firmware="1.0.01(07/Apr./2009)", serial="H0900001", most_mm=11_000, first=0, last=768,
            period_ms=Fraction(67), has_scip1=False, ports=("usb",),
        ),
        _UTM,
        replace(
            _UTM, model="hokuyo-utm-30lx-ew", title="UTM-30LX-EW(Hokuyo Automatic Co.,Ltd.)", ports=("ethernet",),
            protocol="SCIP 2.2", has_echoes=True, firmware="1.1.0(2011-09-30)", serial="H1000484",
        ),
        _UST,
        replace(_UST, model="hokuyo-ust-20lx", title="UST-20LX", most_mm=60_000, serial="H1500002"),
    )
}  # fmt: skip
