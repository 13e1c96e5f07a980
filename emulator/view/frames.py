"""What the page shows at one instant, wherever it comes from; and the contract of a source."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from emulator.errors import EmulatorError
from emulator.scenario.scenario import Scenario

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class ShownScan:
    """One scan with its truth, in the sensor's frame."""

    start_s: float
    sweep: int
    azimuth_rad: Floats
    "(n,)"
    elevation_rad: Floats
    "(n,)"
    fire_s: Floats
    "(n,) after `start_s`."
    range_m: Floats
    "(n, k) NaN where there is no echo."
    intensity: Floats
    "(n, k) peak over detection threshold."
    actor: Ints
    "(n, k) 0 world, -1 none or weather."
    objects: tuple[Mapping[str, Any], ...] = ()
    every: int = 1
    "Only every n-th beam is here."
    origin_m: Floats | None = None
    "(n, 3) where beams begin; None: in the sensor's origin."
    missed: int = 0
    "Scans that went by unseen before this one."


@dataclass(frozen=True)
class ShownTelegram:
    """Bytes in one piece on a link."""

    number: int
    "Counts a sensor's payloads, both ways, from 1."
    link: int
    peer: int
    sent: bool
    "By the device."
    at_s: float
    "First bit of what the device sent; when what a host sent was taken in."
    data: bytes
    label: str = ""
    sweep: int | None = None
    cut: int = 0
    "Bytes that are not here."


@dataclass(frozen=True)
class ShownLink:
    """One link of a sensor."""

    url: str
    kind: str
    "serial | stream | datagram | can"
    host: bool | None
    "Whether a host is there; None: not known."
    bytes_in: int
    bytes_out: int
    bytes_lost: int = 0


@dataclass(frozen=True)
class ShownSensor:
    """Counts of one sensor."""

    scans_sent: int = 0
    rate_hz: float | None = None
    late_median_us: float | None = None
    "Of the last sends, see emulator.runtime.snapshots."
    late_worst_us: float | None = None
    dropped: Mapping[str, int] = field(default_factory=dict)
    "Scans not sent, by reason."
    input_dropped: Mapping[str, int] = field(default_factory=dict)
    restarts: int = 0
    links: tuple[ShownLink, ...] = ()


@dataclass(frozen=True)
class Frame:
    """Everything at one instant."""

    now_s: float
    virtual: bool
    "Time can be paused."
    paused: bool
    speed: float | None
    "Seconds of the run a real one; None: as fast as hosts read."
    scans: Mapping[str, ShownScan] = field(default_factory=dict)
    sensors: Mapping[str, ShownSensor] = field(default_factory=dict)
    telegrams: Mapping[str, tuple[ShownTelegram, ...]] = field(default_factory=dict)
    "Newest last."
    telegrams_missed: int = 0
    "That went by unseen since the page was opened."
    notes: tuple[str, ...] = ()
    "What happened last, newest last."
    ended: str = ""
    "Why there is no more."
    stands: str = ""
    "Why time stands though nobody has paused it."


class ViewError(EmulatorError):
    """Nothing that can be shown."""


class Source(Protocol):
    """A running daemon or a recording."""

    @property
    def title(self) -> str: ...

    @property
    def scenario(self) -> Scenario: ...

    @property
    def length_s(self) -> float | None:
        """Of a recording; None: it goes on."""

    @property
    def can_restart(self) -> bool:
        """Whether the order `restart` begins again."""

    def frame(self) -> Frame:
        """What there is now. A daemon that has gone: `ended` says so."""

    def order(self, method: str, params: Mapping[str, Any]) -> Any:
        """An order to the daemon; its result. Raises `EmulatorError` with its own words. From any thread."""

    def close(self) -> None: ...
