"""Faults of what moves and holds: motor, mirror, encoder, mount. The beams go elsewhere than the device says.

Here: their keys and kinds, and the motor's speed, which the device itself follows. Where beams really go is in `aims`,
which is loaded where sweeps are measured; the device reads back the directions that it believes in.
"""

from __future__ import annotations

import math
from typing import Annotated, Any

from pydantic import Field

from emulator.faults.acts import Act, Gear
from emulator.faults.config import Common
from emulator.faults.impairments import impair
from emulator.faults.kinds import Keys, Kind, Target
from emulator.faults.photon import AS_BEFORE
from emulator.faults.sector import Degrees, Layers

Hertz = Annotated[float, Field(gt=0.0, le=1e4)]
Tilt = Annotated[float, Field(ge=-180.0, le=180.0)]
Shift = Annotated[float, Field(ge=-100.0, le=100.0)]


class MotorSpeed(Keys):
    """The motor turns at another speed than it should."""

    percent: Annotated[float, Field(ge=-50.0, le=50.0)] = -5.0
    "Too fast; negative: too slow."
    told_from_percent: Annotated[float, Field(ge=0.0, le=100.0)] = 3.0
    "The device's own supervision sees it when it is off by more; the bound is a guess, no source gives it."


class MirrorWobble(Keys):
    """The mirror nods: a bearing is worn."""

    elevation_deg: Annotated[float, Field(ge=0.0, le=45.0)] = 0.5
    "Amplitude up and down."
    azimuth_deg: Annotated[float, Field(ge=0.0, le=45.0)] = 0.0
    "Amplitude along the scan."
    hz: Hertz = 7.0


class MirrorStuck(Keys):
    """The mirror stands: every beam goes the same way."""

    at_deg: Degrees | None = None
    "Azimuth at which it stands; none: somewhere within the plan, by the seed."
    told: bool = True
    "A device that watches its motor reports: an LD stops measuring (mode error), an LMS2xx sets its status."


class EncoderOffset(Keys):
    """The encoder's zero has moved."""

    azimuth_deg: Degrees = 2.0
    "By so much beams go further left than reported."


class LayerOffset(Layers):
    """Lasers that look elsewhere than the table of angles says."""

    azimuth_deg: Degrees = 1.0
    "By so much they look further left."
    up_deg: Annotated[float, Field(ge=-45.0, le=45.0)] = 0.0
    "By so much they look higher."


class EncoderSlip(Keys):
    """The encoder's disc slips on its shaft, again and again."""

    jump_deg: Degrees = 1.0
    every_s: Annotated[float, Field(gt=0.0, le=1e9)] = 0.5
    "Mean time between two slips; each is drawn."


class MountTilt(Keys):
    """A blow has turned the sensor on its mount."""

    yaw_deg: Tilt = 0.0
    pitch_deg: Tilt = 2.0
    roll_deg: Tilt = 0.0
    settles_s: Annotated[float, Field(gt=0.0, le=1e6)] | None = None
    "It swings around the new pose and comes to rest with this time constant; none: at rest at once."
    swings_hz: Hertz = 12.0


class MountShift(Keys):
    """The sensor has moved on its mount."""

    x_m: Shift = 0.0
    y_m: Shift = 0.0
    z_m: Shift = 0.0
    "In the sensor's frame."


class Vibration(Keys):
    """The mount shakes."""

    yaw_deg: Annotated[float, Field(ge=0.0, le=45.0)] = 0.0
    pitch_deg: Annotated[float, Field(ge=0.0, le=45.0)] = 0.3
    roll_deg: Annotated[float, Field(ge=0.0, le=45.0)] = 0.0
    "Amplitudes; each axis has a phase of its own, by the seed."
    hz: Hertz = 30.0


class Motor(Act):
    """The motor's speed, which the device's own schedule follows."""

    def __init__(self, keys: Any, gear: Gear) -> None:
        super().__init__(gear)
        self._factor = 1.0 + 0.01 * keys.percent
        told = abs(keys.percent) > keys.told_from_percent
        self._reported = 0.0 if not told else math.copysign(1.0, keys.percent)

    def begin(self, now_ns: int) -> None:
        impair(self.gear, now_ns, "motor status", self._reported)
        impair(self.gear, now_ns, "motor speed", self._factor)
        self.gear.hit(now_ns)

    def end(self, now_ns: int) -> None:
        impair(self.gear, now_ns, "motor status", None)
        impair(self.gear, now_ns, "motor speed", None)


class Stuck(Act):
    """What the device reports of a motor that stands."""

    def __init__(self, keys: Any, gear: Gear) -> None:
        super().__init__(gear)
        self._reported = keys.told

    def begin(self, now_ns: int) -> None:
        if self._reported:
            impair(self.gear, now_ns, "motor stopped", 1.0)
            if self.gear.session.next_plan() is None:  # a device that stops measures nothing that could be hit
                self.gear.hit(now_ns)

    def end(self, now_ns: int) -> None:
        if self._reported:
            impair(self.gear, now_ns, "motor stopped", None)


def _some(keys: Any, common: Common, target: Target) -> str | None:
    values = [value for name, value in keys.model_dump().items() if name.endswith(("_deg", "_m"))]
    return None if any(values) else "nothing moves; want one of its angles or lengths other than 0"


def _turned(keys: Any, common: Common, target: Target) -> str | None:
    return None if keys.azimuth_deg or keys.up_deg else "nothing moves; want azimuth_deg or up_deg other than 0"


def _kind(name: str, keys: type[Keys], summary: str, ends: str = AS_BEFORE, **more: Any) -> Kind:
    return Kind(name, "mechanics", summary, ends, keys, measured=True, lasts="state", sees=("beams",), **more)


KINDS: tuple[Kind, ...] = (
    Kind(
        "motor_speed",
        "mechanics",
        "The scan rate is too high or too low, and the timing of beams with it; the device may report it.",
        "The rate is nominal again; scans are those of a sensor that starts to turn at that time.",
        MotorSpeed,
        act=Motor,
        lasts="state",
        sees=("beams",),
        needs_session=True,
    ),
    _kind("mirror_wobble", MirrorWobble, "Walls move along the beam; distant ground comes and goes.", check=_some),
    _kind(
        "mirror_stuck",
        MirrorStuck,
        "Every beam has the range of one direction; a device that monitors its motor stops or reports it.",
        AS_BEFORE + " An LD is in IDLE and waits for a command to measure.",
        act=Stuck,
    ),
    _kind("encoder_offset", EncoderOffset, "The scan is rotated.", check=_some),
    _kind("layer_offset", LayerOffset, "Some layers look elsewhere than the table of angles says.", check=_turned),
    _kind("encoder_slip", EncoderSlip, "The scan rotates by a step, repeatedly.", check=_some),
    _kind("mount_tilt", MountTilt, "The scan plane is tilted, as after an impact.", check=_some),
    _kind("mount_shift", MountShift, "The scan is taken from a displaced position.", check=_some),
    _kind("vibration", Vibration, "Ranges on inclined surfaces oscillate.", check=_some),
)  # fmt: skip
