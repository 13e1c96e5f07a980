"""Keys that several faults of what is measured share: quantities with their bounds, and a sector of beams.

Loaded by whoever judges a scenario: no physics in here.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from emulator.faults.kinds import Keys

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

Degrees = Annotated[float, Field(ge=-360.0, le=360.0)]
Factor = Annotated[float, Field(ge=0.0, le=1e6)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]
Metres = Annotated[float, Field(ge=-1e5, le=1e5)]


class Layers(Keys):
    """Beams by their layer, that is elevation; of a sensor with one layer all of them."""

    elevation_deg: Annotated[float, Field(ge=-90.0, le=90.0)] = 0.0
    "The layer nearest to it."
    layers: Annotated[int, Field(ge=1, le=4096)] = 1
    "So many, those nearest to it."

    def holds(self, elevation_rad: Floats) -> Bools:
        """(n,) beams of these layers."""
        found, which = np.unique(np.round(elevation_rad, 6), return_inverse=True)
        away = np.argsort(np.abs(found - np.radians(self.elevation_deg)), kind="stable")
        return np.isin(which.reshape(-1), away[: self.layers])


class Sector(Keys):
    """Beams by their azimuth."""

    from_deg: Degrees = -180.0
    "First azimuth, in the sensor's frame, positive to the left."
    to_deg: Degrees = 180.0
    "Last azimuth, further to the left; less than from_deg: through the back."

    def holds(self, azimuth_rad: Floats) -> Bools:
        """(n,) beams inside."""
        width = self.to_deg - self.from_deg
        if width >= 360.0:
            return np.ones(len(azimuth_rad), bool)
        turned = np.mod(np.degrees(azimuth_rad) - self.from_deg + 1e-6, 360.0)
        return np.asarray(turned <= np.mod(width, 360.0) + 2e-6, bool)

    def depth(self, azimuth_rad: Floats, edge_deg: float) -> Floats:
        """(n,) 1 inside, falling to 0 over an edge outside of it."""
        width = self.to_deg - self.from_deg
        if width >= 360.0:
            return np.ones(len(azimuth_rad))
        half = 0.5 * np.mod(width, 360.0)
        off = np.mod(np.degrees(azimuth_rad) - self.from_deg - half + 180.0, 360.0) - 180.0
        beyond = np.abs(off) - half
        return np.asarray(np.clip(1.0 - np.maximum(beyond, 0.0) / max(edge_deg, 1e-6), 0.0, 1.0))
