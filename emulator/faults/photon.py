"""Faults where the light is: the window, the laser, other light, the optics, the detector. Their keys and kinds.

What they do to a sweep is in `light`, which is loaded where sweeps are measured.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

from pydantic import Field

from emulator.faults.acts import Act, Gear
from emulator.faults.impairments import impair
from emulator.faults.kinds import Keys, Kind
from emulator.faults.sector import Degrees, Factor, Sector, Share


class DirtyWindow(Sector):
    """Dirt on the front window."""

    transmission: Share = 0.5
    "Share of the light that passes the window once; an echo passes it twice."
    edge_deg: Annotated[float, Field(ge=0.0, le=180.0)] = 1.0
    "Over so many degrees outside the sector the dirt thins out."
    reflectance: Share = 0.2
    "Of the dirt, for the light that it stops."
    window_m: Annotated[float, Field(gt=0.0, le=1.0)] = 0.04
    "Distance of the window from the optical centre."
    stray: Share = 0.0
    "Share of what the dirt scatters back that reaches the receiver where the beam is outside its field of view."
    told: bool = True
    "The device's own supervision of the window sees it, if the device has one."


class WetWindow(Keys):
    """Drops and a film of water on the front window."""

    coverage: Share = 0.3
    "Share of the window under drops."
    drop_deg: Annotated[float, Field(ge=0.02, le=45.0)] = 1.5
    "Width of a drop, as the azimuths that look through it."
    drop_transmission: Share = 0.3
    "Share of the light that goes straight on through a drop; the rest is refracted away."
    film_transmission: Share = 0.96
    "Of the film everywhere."
    renews_s: Annotated[float, Field(gt=0.0, le=1e9)] = 1.0
    "After so long the drops are elsewhere."


class WeakLaser(Keys):
    """A laser that has aged."""

    power: Factor = 0.3
    "Of the nominal pulse power when the fault begins."
    halves_in_s: Annotated[float, Field(gt=0.0, le=1e9)] | None = None
    "The power goes on falling, to a half each so many seconds."


class Blinding(Keys):
    """A strong light that looks into the sensor: low sun, a welder, headlights, another lidar's cw beam."""

    azimuth_deg: Degrees = 0.0
    "Where it is, in the sensor's frame."
    elevation_deg: Annotated[float, Field(ge=-90.0, le=90.0)] = 0.0
    width_deg: Annotated[float, Field(gt=0.0, le=180.0)] = 1.0
    "Its diameter as seen from the sensor."
    irradiance_w_m2: Annotated[float, Field(gt=0.0, le=1e6)] = 100.0
    "At the sensor, within its optical filter."


class Interference(Sector):
    """Pulses of another lidar."""

    echoes_per_beam: Annotated[float, Field(gt=0.0, le=100.0)] = 0.05
    "Mean number within the gate."
    strength: Annotated[float, Field(gt=0.0, le=1e6)] = 3.0
    "Amplitude over the detection threshold; each pulse has its own, of an exponential law with this mean."


class Crosstalk(Keys):
    """Light of one beam on the receiver of its neighbours."""

    share: Share = 0.01
    "Of an echo's light that falls on the next beam's receiver; its square on the one after, and so on."
    reach: Annotated[int, Field(ge=1, le=64)] = 1
    "To how many neighbours on each side."


class Misalignment(Keys):
    """The receiver looks beside the beam."""

    angle_mrad: Annotated[float, Field(ge=0.0, le=1000.0)] = 5.0
    "Between the beam and the middle of the receiver's field of view."


class DetectorGain(Keys):
    """The detector's gain is off; the comparator's threshold is not."""

    factor: Annotated[float, Field(gt=0.0, le=100.0)] = 0.5
    per_s: Annotated[float, Field(ge=-1.0, le=1.0)] = 0.0
    "It goes on drifting by this share a second; never below a hundredth of the nominal gain."


class ReceiverNoise(Keys):
    """The receiver is noisier; the comparator's threshold is where it was."""

    factor: Annotated[float, Field(ge=1.0, le=100.0)] = 1.5
    "On the rms noise in the dark."


class WindowReported(Act):
    """The device's supervision of its window."""

    def __init__(self, keys: Any, gear: Gear) -> None:
        super().__init__(gear)
        self._transmission = keys.transmission if keys.told else 1.0

    def begin(self, now_ns: int) -> None:
        impair(self.gear, now_ns, "window", self._transmission)

    def end(self, now_ns: int) -> None:
        impair(self.gear, now_ns, "window", None)


def _kind(name: str, keys: type[Keys], summary: str, ends: str, act: Callable[[Any, Gear], Act] | None = None) -> Kind:
    return Kind(name, "photon", summary, ends, keys, act=act, measured=True, lasts="state", sees=("beams",))


AS_BEFORE = "Later scans equal those of a run without the fault."

KINDS: tuple[Kind, ...] = (
    _kind("dirty_window", DirtyWindow, "Weaker echoes in a sector; dark and far targets lost; the device reports it.",
          AS_BEFORE + " The device's status is normal again.", WindowReported),
    _kind("wet_window", WetWindow, "Echoes fade and vanish in moving patches.", AS_BEFORE),
    _kind("dead_laser", Keys, "No echo in any beam except noise false alarms.", AS_BEFORE),
    _kind("weak_laser", WeakLaser, "The maximum range falls: dark and distant targets are lost.", AS_BEFORE),
    _kind("blinding", Blinding, "Beams towards a light source are dazzled; beams near it are noisy.", AS_BEFORE),
    _kind("interference", Interference, "False echoes at random ranges.", AS_BEFORE),
    _kind("crosstalk", Crosstalk, "Echoes of bright targets appear in neighbouring beams.", AS_BEFORE),
    _kind("misalignment", Misalignment, "All echoes are weaker: the receiver sees the edge of the beam.", AS_BEFORE),
    _kind("detector_gain", DetectorGain, "Echoes and noise change; the threshold does not.", AS_BEFORE),
    _kind("receiver_noise", ReceiverNoise, "Range noise and false alarms increase.", AS_BEFORE),
)  # fmt: skip
