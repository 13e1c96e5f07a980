"""The `clock` table of a sensor: how wrong its time is, and where its counters begin.

Belongs here: the model of the table. Not: what it does to a session (device_clock).
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from emulator.config.tables import DescribedTable

MOST_STEPS = 256


class ClockStep(DescribedTable):
    """The clock is put forward, or back, while the run goes on."""

    t_s: Annotated[float, Field(ge=0.0, le=1e9)]
    "Time of the run."
    by_s: Annotated[float, Field(ge=-1e9, le=1e9)]


class ClockOptions(DescribedTable):
    """The time that a device reports, against the run's."""

    drift_ppm: Annotated[float, Field(ge=-100_000.0, le=100_000.0)] = 0.0
    "How much too fast its quartz is; to a thousandth."
    drives: Literal["schedule", "stamps"] = "schedule"
    """schedule: one quartz paces motor, cycles and delays as well as the time it reports; stamps: the time alone."""
    offset_s: Annotated[float, Field(ge=-1e9, le=1e10)] = 0.0
    "Shown at power-on beyond what the device begins with."
    start_ticks: Annotated[int, Field(ge=0, lt=2**64)] | None = None
    "Shown at power-on in ticks of the wire, to reach its wrap soon; None: as the device begins."
    start_count: Annotated[int, Field(ge=0, lt=2**16)] | None = None
    "Where its counter of scans or telegrams begins at power-on; None: as the device begins."
    steps: Annotated[tuple[ClockStep, ...], Field(max_length=MOST_STEPS)] = ()
    power_cycle: Literal["begins_again", "runs_on"] = "begins_again"
    "What becomes of it while the device is off or resets: lost, or kept by a battery."
