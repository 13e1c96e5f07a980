"""What a built-in host passes to its viewer, independent of the protocol."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

from protocols.scan import Floats


@dataclass(frozen=True, eq=False)
class HostCloud:
    """All layers of a turn as a host has decoded them: the first return of each beam that has one."""

    azimuth_rad: Floats
    "(m,) ISO 8855"
    elevation_rad: Floats
    "(m,)"
    range_m: Floats
    "(m,)"
    intensity: Floats
    "(m,)"
    layered: bool = True
    "Beams are in layers, which tell them from each other; False: points anywhere."


@dataclass(frozen=True, eq=False)
class HostScan:
    """One scan as a host has decoded it."""

    number: int
    "Counts the scans received, from 0."
    azimuth_rad: Floats
    "(n,) ISO 8855: 0 ahead, positive to the left."
    range_m: Floats
    "(n,) NaN where the device reports no distance."
    detail: str = ""
    "What the telegram said beside the distances, for a status line."
    intensity: Floats | None = None
    "(n,) in the device's own units, NaN where it reports none; None: this device, or this telegram, reports none."
    cloud: HostCloud | None = None
    "Of a device with several layers, of which the scan is the one nearest to the horizon."


@dataclass(frozen=True)
class HostObject:
    """One object of a list as a host has decoded it; None where the format, or this list, does not tell."""

    number: int
    "The device's own."
    x_m: float
    "Of the point that the format gives: box centre, or nearest point. In the sensor's frame."
    y_m: float
    vx_m_s: float | None = None
    "Relative to the sensor, but for an LD-MRS that says otherwise."
    vy_m_s: float | None = None
    length_m: float | None = None
    width_m: float | None = None
    yaw_rad: float | None = None
    category: str | None = None
    existence: float | None = None
    "Probability that it is there, 0..1."


@dataclass(frozen=True)
class HostObjects:
    """One list of objects as a host has decoded it."""

    number: int
    "Counts the lists received, from 0."
    objects: tuple[HostObject, ...]
    detail: str = ""


Seen = HostScan | HostObjects


class Host(Protocol):
    """A connected host."""

    @property
    def title(self) -> str:
        """The device's own name for itself."""

    @property
    def errors(self) -> int:
        """Telegrams, frames or lists so far that were damaged or not whole."""

    def scans(self, timeout_s: float) -> Iterator[Seen | None]:
        """Scans as they arrive; None when none came for `timeout_s`."""

    def close(self) -> None:
        """Stop the stream and hang up."""
