"""Sweeps of a sensor that no protocol family plans: its own table of directions and instants.

Belongs here: a spec's `beams` -> plans. Not: families' sweeps (protocols).
"""

from __future__ import annotations

import numpy as np

from emulator.errors import SpecError
from emulator.sensors.spec import SensorSpec
from protocols.scan import ScanPlan


def table_plan(spec: SensorSpec, sweep: int, start_ns: int = 0) -> ScanPlan:
    """Sweep number `sweep` of a table of beams, the first one at `start_ns`."""
    table = spec.beams
    if table is None:
        raise SpecError(f"{spec.model}: beams: none; want a model with a table of beams")
    azimuth, elevation = np.radians(table.azimuth_deg.value), np.radians(table.elevation_deg.value)
    n = len(azimuth) * len(elevation)
    fire_s = 1e-6 * np.asarray(table.fire_us.value, dtype=np.float64)
    if len(fire_s) == 1:
        fire_s = fire_s[0] * np.arange(n)
    period_s = 1e-3 * table.period_ms.value
    return ScanPlan(
        epoch=0,
        sweep=sweep,
        start_ns=start_ns + round(1e9 * period_s * sweep),
        azimuth_rad=np.tile(azimuth, len(elevation)),
        elevation_rad=np.repeat(elevation, len(azimuth)),
        fire_offset_s=fire_s,
        duration_s=period_s,
        max_echoes=1 if spec.detection is None else spec.detection.max_echoes.value,
        wants_intensity=True,
    )
