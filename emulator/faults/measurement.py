"""Faults behind the receiver: what the device's electronics and firmware make of ranges, intensities and objects.

Here: their keys and kinds. What they do to scans is in `readings`, to object lists in `lists`, which are loaded where
sweeps are measured. Not: the light (photon), where beams go (mechanics), bytes (telegram, octets).
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from emulator.config.names import nearest
from emulator.faults.config import Common
from emulator.faults.kinds import Keys, Kind, Target
from emulator.faults.photon import AS_BEFORE
from emulator.faults.sector import Factor, Layers, Metres, Sector

Seconds = Annotated[float, Field(gt=0.0, le=1e9)]
Speed = Annotated[float, Field(ge=-1e3, le=1e3)]


class StuckBeams(Sector):
    """Beams whose range counter stands."""

    from_deg: Annotated[float, Field(ge=-360.0, le=360.0)] = -5.0
    to_deg: Annotated[float, Field(ge=-360.0, le=360.0)] = 5.0
    range_m: Annotated[float, Field(ge=0.0, le=1e5)] = 1.0
    "What they tell whatever is there."


class DeadBeams(Sector):
    """Beams that never tell an echo."""

    share: Annotated[float, Field(gt=0.0, le=1.0)] = 1.0
    "Of the sector's beams: which ones, the seed decides, for as long as the fault lasts."


class DeadLayers(Layers):
    """Lasers that fire no more."""


class WrongCalibration(Keys):
    """Each layer has a range correction of its own; that of another unit is used."""

    sigma_m: Annotated[float, Field(gt=0.0, le=100.0)] = 0.05
    "Of a normal law: the error of each layer, by the seed."


class RangeOffset(Sector):
    """A wrong calibration constant."""

    offset_m: Metres = 0.1


class RangeScale(Sector):
    """A wrong time base."""

    factor: Annotated[float, Field(gt=0.0, le=100.0)] = 1.01


class NoiseBurst(Sector):
    """Ranges scatter."""

    sigma_m: Annotated[float, Field(gt=0.0, le=1e4)] = 0.5
    "Of a normal law."
    share: Annotated[float, Field(gt=0.0, le=1.0)] = 1.0
    "Of the beams that are hit, by chance in each sweep."


class StuckBits(Sector):
    """Lines of the range word that are stuck."""

    bit: Annotated[int, Field(ge=0, le=15)] = 4
    "From 0, the least."
    level: Literal[0, 1] = 1
    step_m: Annotated[float, Field(gt=0.0, le=100.0)] = 0.01
    "What bit 0 stands for."


class Quantised(Sector):
    """Lost resolution."""

    step_m: Annotated[float, Field(gt=0.0, le=100.0)] = 0.25


class RangeDrift(Keys):
    """Ranges drift as the device warms up."""

    m_per_k: Annotated[float, Field(ge=-10.0, le=10.0)] = 0.002
    warms_k: Annotated[float, Field(ge=-200.0, le=200.0)] = 20.0
    "Temperature at the end over that at the beginning of the fault."
    time_constant_s: Seconds = 60.0


class WrongIntensity(Sector):
    """Intensities are wrong, ranges are not."""

    factor: Factor = 0.25


class GhostObject(Keys):
    """An object in the list that is not there."""

    x_m: Metres = 10.0
    y_m: Metres = 0.0
    "Where it is when the fault begins."
    vx_m_s: Speed = 0.0
    vy_m_s: Speed = 0.0
    "Against the sensor."
    length_m: Annotated[float, Field(gt=0.0, le=100.0)] = 4.4
    width_m: Annotated[float, Field(gt=0.0, le=100.0)] = 1.8
    category: Literal["car", "truck", "motorcycle", "bicycle", "pedestrian", "wide", "point", "unknown"] = "car"


class LostObject(Keys):
    """An object that is there and not in the list."""

    actor: Annotated[str, Field(min_length=1, max_length=64)] | None = None
    "Which; none: the nearest."


class SwappedIds(Keys):
    """The identifiers of the two nearest objects are swapped."""

    each_s: Seconds | None = None
    "They swap again and again, after so many seconds each; none: once, until the end."


def _drifts(keys: Any, common: Common, target: Target) -> str | None:
    return None if keys.m_per_k * keys.warms_k else "no drift; want m_per_k and warms_k other than 0"


def _there(keys: Any, common: Common, target: Target) -> str | None:
    if keys.actor is None or target.actors is None or keys.actor in target.actors:
        return None
    return f"actor {keys.actor!r}; want {nearest(keys.actor, target.actors)}"


def _scan(name: str, keys: type[Keys], summary: str, ends: str = AS_BEFORE, **more: Any) -> Kind:
    return Kind(name, "measurement", summary, ends, keys, measured=True, lasts="state", sees=("beams",), **more)


def _list(
    name: str, keys: type[Keys], summary: str, ends: str = "Later lists are those of a run without it.", **more: Any
) -> Kind:
    return Kind(name, "measurement", summary, ends, keys, measured=True, lasts="state", sees=("objects",), **more)


KINDS: tuple[Kind, ...] = (
    _scan("stuck_beams", StuckBeams, "Some beams report one constant range."),
    _scan("dead_beams", DeadBeams, "Some beams never report an echo."),
    _scan("dead_layers", DeadLayers, "Some layers never report an echo: their lasers are dead."),
    _scan(
        "wrong_calibration", WrongCalibration, "Each layer has a range offset of its own, that of a wrong calibration."
    ),
    _scan("range_offset", RangeOffset, "Ranges have a constant offset."),
    _scan("range_scale", RangeScale, "Ranges have a scale error."),
    _scan("noise_burst", NoiseBurst, "Ranges scatter."),
    _scan("frozen_scan", Keys, "The same scan is repeated: the last one before the fault."),
    _scan("stuck_bits", StuckBits, "One bit of the range words never changes."),
    _scan("quantised", Quantised, "Ranges have coarse quantization steps."),
    _scan("range_drift", RangeDrift, "Ranges drift while the device warms up.", check=_drifts),
    _scan("wrong_intensity", WrongIntensity, "Intensities have a scale error; ranges are correct."),
    _list("ghost_object", GhostObject, "The list has an object that does not exist."),
    _list("lost_object", LostObject, "The list lacks an object that exists.", check=_there),
    _list("swapped_ids", SwappedIds, "The identifiers of the two nearest objects are swapped."),
    _list("frozen_list", Keys, "The same list is repeated, with counters and time stamps that advance."),
)
