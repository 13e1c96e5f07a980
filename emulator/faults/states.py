"""Faults that are states of a device with a web interface and a temperature: what it says of itself, and loses.

Belongs here: their keys and kinds. What the device makes of them is in its session (`Session.impair`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, Literal

from pydantic import Field

from emulator.faults.acts import Act, Gear
from emulator.faults.impairments import impair
from emulator.faults.kinds import Keys, Kind


class LimitingKeys(Keys):
    """The device is hot."""

    percent: Annotated[float, Field(gt=0.0, le=75.0)] = 30.0
    "By so much laser power is reduced, 30 s after the warning."


class LostKeys(Keys):
    """Columns are lost within the device."""

    percent: Annotated[float, Field(gt=0.0, le=100.0)] = 5.0
    "Of the columns."


class ServedKeys(Keys):
    """Metadata, or a calibration file, of another unit."""

    elevation_deg: Annotated[float, Field(ge=-5.0, le=5.0)] = 0.5
    "Added to all elevations that are served; the beams stay where they are."


class CodeKeys(Keys):
    """An error code of Hesai's control channel."""

    code: Annotated[int, Field(ge=1, le=255)] = 6
    "1 invalid parameter, 3 invalid data, 5 unsupported, 6 FPGA, 7 other."


class FileKeys(Keys):
    """A calibration file that is not served whole."""

    served: Literal["refused", "damaged"] = "refused"
    "refused: an error code; damaged: without its end, or with a wrong hash."


class Impairing(Act):
    """The device is so for as long as the fault lasts."""

    def __init__(self, gear: Gear, what: str, degree: float) -> None:
        super().__init__(gear)
        self._what, self._degree = what, degree

    def begin(self, now_ns: int) -> None:
        impair(self.gear, now_ns, self._what, self._degree)
        self.gear.hit(now_ns)

    def end(self, now_ns: int) -> None:
        impair(self.gear, now_ns, self._what, None)


def _kind(
    name: str,
    part: str,
    summary: str,
    ends: str,
    keys: type[Keys] = Keys,
    degree: Callable[[Any], float] = lambda keys: 1.0,
) -> Kind:
    return Kind(
        name, "telegram", summary, ends, keys, act=lambda keys, gear: Impairing(gear, part, degree(keys)),
        lasts="state", needs_part=part,
    )  # fmt: skip


KINDS: tuple[Kind, ...] = (
    _kind(
        "no_ptp",
        "no ptp",
        "The PTP master is gone; the device reports it, its clock continues by its own quartz.",
        "It is back, and the clock follows it.",
    ),
    _kind(
        "http_unavailable",
        "unavailable",
        "Every HTTP request is answered with 503, as while the device starts; packets continue.",
        "Requests are answered.",
    ),
    _kind(
        "shot_limiting",
        "shot limiting",
        "The device is hot: it warns for 30 s, then fires with less power, and ranges decrease.",
        "Power is as before.",
        LimitingKeys,
        lambda keys: 0.01 * keys.percent,
    ),
    _kind(
        "thermal_shutdown",
        "thermal shutdown",
        "The device is too hot: it warns for 30 s, then stops in status ERROR.",
        "It is cool; after 30 s it stays in ERROR until it is initialised again.",
    ),
    _kind(
        "lost_columns",
        "lost columns",
        "Some columns of each frame are marked invalid and have no ranges.",
        "All columns are valid.",
        LostKeys,
        lambda keys: 0.01 * keys.percent,
    ),
    _kind(
        "calibration_served_wrong",
        "wrong calibration served",
        "What it serves has other elevations than its beams: points are at wrong heights.",
        "What it serves is right; drivers that read it before keep the wrong one.",
        ServedKeys,
        lambda keys: keys.elevation_deg,
    ),
    _kind(
        "overheating",
        "heat",
        "The device raises its flag of high temperature, and after a minute stops to measure.",
        "It has cooled, and starts again.",
    ),
    _kind(
        "ptc_error",
        "ptc error",
        "Every command of PTC is answered with an error code and not carried out.",
        "Commands are carried out.",
        CodeKeys,
        lambda keys: float(keys.code),
    ),
    _kind(
        "calibration_file",
        "calibration",
        "The calibration file is refused, or ends too early or with a wrong hash.",
        "The file is served whole.",
        FileKeys,
        lambda keys: 1.0 + (keys.served == "damaged"),
    ),
)
