"""What sets Ouster's models apart on the wire: rows, beam angles of a unit, offsets. Optics are in the sensor specs.

A spec's `device` table is `{model: ouster-os1-128}`. Belongs here: one row per model, and the calibration of a unit.
Not: tables of angles (tables), packets (codec).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from protocols.ouster import tables
from protocols.scan import Floats

SCATTER_DEG = 0.05
"Of the angles of a unit about those of the recorded one; recorded units differ by as much."
LIDAR_Z_MM = 38.195
"From the sensor's frame up to the lidar's, Rev 7."
IMU_MM = (-2.441, -9.725, 7.533)
"IMU in the sensor's frame, Rev 7."


@dataclass(frozen=True, eq=False)
class Model:
    """Facts of one model."""

    model: str
    "Identifier, as the sensor spec is called."
    kind: int
    "0, 1, 2: OS0, OS1, OS2."
    rows: int
    elevation_deg: tuple[float, ...]
    "Of 128 rows, top first."
    azimuth_deg: tuple[float, ...]
    offset_mm: float
    "From the axis to where beams begin."
    part: str
    white_m2: float
    """Signal of a white plate at 1 m over the detection threshold: what a range and a signal are a reflectivity by.
    System constant over threshold of the model's spec."""

    @property
    def title(self) -> str:
        """As the maker calls it."""
        return f"OS{self.kind}-{self.rows}"

    @property
    def choices(self) -> tuple[str, ...]:
        """Beam configurations, the usual one first."""
        if self.rows == 128:
            return ("U",)
        if self.rows == 64:
            return ("U", "AH", "BH")
        return ("U", "U0", "U1", "U2", "U3", *(("G",) if self.kind == 1 else ()))

    def product(self, beams: str) -> str:
        """As in `prod_line`."""
        return f"OS-{self.kind}-{self.rows}" + ("" if beams == "U" else f"-{beams}")

    def angles(self, beams: str) -> tuple[Floats, Floats]:
        """Elevation and azimuth offset (rows,) of the recorded unit. [deg]"""
        if beams == "G":
            return np.asarray(tables.OS1_32_G), np.asarray(tables.OS1_32_G_AZIMUTH)
        step = 128 // self.rows
        first = int(beams[1]) if beams[1:].isdecimal() else 0
        rows = {"AH": slice(64), "BH": slice(64, 128)}.get(beams, slice(first, None, step))
        return np.asarray(self.elevation_deg)[rows], np.asarray(self.azimuth_deg)[rows]


@dataclass(frozen=True, eq=False)
class Unit:
    """One device: its calibration, as it reports it and as it measures."""

    model: Model
    beams: str
    serial: int
    elevation_deg: Floats
    "(H,) two decimals."
    azimuth_deg: Floats
    "(H,) against the encoder, counter-clockwise."

    @property
    def rows(self) -> int:
        """How many."""
        return self.model.rows

    @property
    def origin_m(self) -> float:
        """From the axis to where beams begin; part of every range."""
        return self.model.offset_mm / 1000.0

    def directions(self, encoder_rad: Floats) -> tuple[Floats, Floats, Floats]:
        """Azimuth and elevation (C H,) of columns' beams, and where they begin (C H, 3), ISO 8855. [rad, m]

        encoder_rad (C,): the head's azimuth, counter-clockwise from straight ahead.
        """
        azimuth = encoder_rad[:, None] - np.radians(self.azimuth_deg)
        elevation = np.broadcast_to(np.radians(self.elevation_deg), azimuth.shape)
        head = np.stack((np.cos(encoder_rad), np.sin(encoder_rad), np.zeros(len(encoder_rad))), axis=1)
        return azimuth.ravel(), elevation.ravel(), np.repeat(self.origin_m * head, self.rows, axis=0)


def unit_of(model: Model, beams: str, serial: int, scatter: bool) -> Unit:
    """A unit with that serial number; the same number has the same calibration."""
    elevation, azimuth = model.angles(beams)
    if scatter:
        draws = np.random.default_rng(serial).uniform(-SCATTER_DEG, SCATTER_DEG, (2, model.rows))
        order = np.argsort(-elevation, kind="stable")  # rows stay in their order
        elevation = elevation + draws[0] * min(1.0, float(np.diff(-elevation[order]).min()) / (2.0 * SCATTER_DEG))
        azimuth = azimuth + draws[1]
    return Unit(model, beams, serial, np.round(elevation, 2), np.round(azimuth, 2))


_KINDS = (
    (tables.OS0, tables.OS0_AZIMUTH, 27.116, 7_031.25),
    (tables.OS1, tables.OS1_AZIMUTH, 16.721, 36_125.0),
    (tables.OS2, tables.OS2_AZIMUTH, 13.762, 153_125.0),
)
MODELS: Mapping[str, Model] = {
    f"ouster-os{kind}-{rows}": Model(
        f"ouster-os{kind}-{rows}", kind, rows, elevation, azimuth, offset, f"86{kind}-10{rows:03d}-07", white
    )
    for kind, (elevation, azimuth, offset, white) in enumerate(_KINDS)
    for rows in (32, 64, 128)
}
