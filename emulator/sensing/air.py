"""What the air between does: extinction along rays.

Belongs here: weather over time -> optical depths. Not: the laws (physics.atmosphere).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from emulator.physics.arrays import Floats
from emulator.sensing.model import SensorModel


@dataclass(frozen=True)
class AirNow:
    """The air at one time."""

    extinction_per_m: float

    def depth(self, origin_m: Floats, direction: Floats, length_m: Floats, t_s: Floats) -> Floats:
        """One-way optical depth of paths."""
        return np.asarray(self.extinction_per_m * length_m)


class Air:
    """Weather of a run, as one sensor's wavelength sees it."""

    def __init__(self, weather: Any, model: SensorModel) -> None:
        self.warnings: tuple[str, ...] = ()
        self._clear = AirNow(8.90229347919e-5)

    def at(self, t_s: float) -> AirNow:
        """The air at this time."""
        return self._clear
