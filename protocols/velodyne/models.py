"""What sets Velodyne's models apart on the wire: lasers, firing instants, units. Optics are in the sensor specs.

A spec's `device` table is `{model: velodyne-vlp-16}`. Belongs here: one row per model. Not: tables of angles (tables).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from protocols.scan import Floats
from protocols.velodyne import tables

Mode = Literal["strongest", "last", "dual"]
MODES: Mapping[Mode, int] = {"strongest": 0x37, "last": 0x38, "dual": 0x39}
"Return mode -> its byte in a packet."
BLOCKS, CHANNELS = 12, 32
"Of a packet, and of a block."


@dataclass(frozen=True, eq=False)
class Model:
    """Facts of one model."""

    model: str
    "Identifier, as the sensor spec is called."
    title: str
    "As the web interface reports it."
    product: int
    "Last byte of a packet."
    elevation_deg: tuple[float, ...]
    offset_deg: tuple[float, ...]
    "Azimuth offset of each laser, to the left."
    unit_mm: int
    cycle_ns: int
    "From firing to firing of the same laser."
    laser_ns: tuple[int, ...]
    "Instant of each laser within a firing."
    white_m2: float
    """Signal of a white plate at 1 m over the detection threshold: what a range and a signal are a reflectivity by.
    System constant over threshold of the model's spec."""
    stamp_ns: int = 0
    "From a packet's first firing to its time stamp."

    @property
    def lasers(self) -> int:
        """How many."""
        return len(self.elevation_deg)

    def firings(self, mode: Mode) -> int:
        """Firings of a packet: two blocks share one (VLP-16: two) in dual mode."""
        return BLOCKS * CHANNELS // self.lasers // (2 if mode == "dual" else 1)

    def packet_ns(self, mode: Mode) -> int:
        """From packet to packet."""
        return self.firings(mode) * self.cycle_ns

    def directions(self, head_turns: Floats) -> tuple[Floats, Floats]:
        """Azimuth and elevation (n, lasers) of beams, ISO 8855. [rad]

        head_turns (n, lasers): where the head is when each laser fires, in turns clockwise from straight ahead.
        """
        offset, elevation = self._angles
        azimuth = offset - 2.0 * np.pi * head_turns
        return azimuth, np.broadcast_to(elevation, azimuth.shape)

    @cached_property
    def _angles(self) -> tuple[Floats, Floats]:
        """(lasers,) azimuth offset and elevation. [rad]"""
        return np.radians(np.asarray(self.offset_deg)), np.radians(np.asarray(self.elevation_deg))

    def fired_ns(self, length_ns: int) -> NDArray[np.int64]:
        """(F, lasers) instants of all firings that begin within such a time; not to be written to."""
        return _fired_ns(length_ns, self.cycle_ns, self.laser_ns)


@lru_cache(maxsize=8)
def _fired_ns(length_ns: int, cycle_ns: int, laser_ns: tuple[int, ...]) -> NDArray[np.int64]:
    found: NDArray[np.int64] = np.arange(0, length_ns, cycle_ns)[:, None] + np.asarray(laser_ns)
    found.flags.writeable = False
    return found


_N = np.arange(128)
_VLP_16 = Model(
    "velodyne-vlp-16", "VLP-16", 0x22, tables.VLP_16, (0.0,) * 16, 2, 55_296, tuple((_N[:16] * 2304).tolist()), 12_500.0
)
MODELS: Mapping[str, Model] = {
    one.model: one
    for one in (
        _VLP_16,
        replace(
            _VLP_16, model="velodyne-puck-hi-res", title="Puck Hi-Res", product=0x24, elevation_deg=tables.PUCK_HI_RES
        ),
        Model(
            "velodyne-hdl-32e", "HDL-32E", 0x21, tables.HDL_32E, (0.0,) * 32, 2, 46_080,
            tuple((_N[:32] * 1152).tolist()), 12_500.0,
        ),
        Model(
            "velodyne-vlp-32c", "VLP-32C", 0x28, tables.VLP_32C, tables.VLP_32C_OFFSET, 4, 55_296,
            tuple((_N[:32] // 2 * 2304).tolist()), 50_000.0,
        ),
        Model(
            "velodyne-vls-128", "VLS-128", 0xA1, tables.VLS_128, tables.VLS_128_OFFSET, 4, 53_300,
            tuple(((_N // 8 + _N // 64) * 2665).tolist()), 75_000.0, stamp_ns=8_700,  # ROS: after the first group
        ),
    )
}  # fmt: skip
