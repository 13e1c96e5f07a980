"""The `emitters:` list of a scenario: lidars whose pulses other sensors receive.

Belongs here: keys and bounds. Not: what their light does (sensing.others), references to sensors and actors (checks).
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from emulator.config.tables import DescribedTable
from emulator.scenario.tables import Angle, Id, Mount

MOST_EMITTERS = 64


class Emitter(DescribedTable):
    """A lidar whose pulses come into the gates of the sensors: one of the file's sensors, or one that has no wire."""

    id: Id
    sensor: str | None = None
    "A sensor of this file: its optics and its place. Every other sensor receives it."
    model: str | None = None
    "Instead of it: a model, for its optics; see `lidaremu list sensors`. Every sensor receives it."
    mount: Mount | None = None
    "Where a `model` is; None: the world's origin."
    turn_hz: Annotated[float, Field(ge=0.0, le=1000.0)] | None = None
    "Turns of its beam about its z axis; 0: the beam stands. None: the model's fastest."
    start_deg: Angle = 0.0
    "Where the beam points at time 0, from its x axis towards y."
    field_deg: Annotated[float, Field(gt=0.0, le=360.0)] | None = None
    "It fires only in this field, centred on its x axis. None: the model's."
    pulse_hz: Annotated[float, Field(ge=0.001, le=2e6)] | None = None
    "Pulses per second within the field. None: one for each of the model's steps of a turn."
    phase_us: Annotated[float, Field(ge=-1e9, le=1e9)] = 0.0
    "When one of its pulses leaves."
    clock_ppm: Annotated[float, Field(ge=-1e5, le=1e5)] = 20.0
    "How much faster its clock runs than the sensors': turns and pulses drift against theirs."

    @model_validator(mode="after")
    def _one_of_both(self) -> Emitter:
        if (self.sensor is None) == (self.model is None):
            raise ValueError("want either sensor or model")
        if self.sensor is not None and self.mount is not None:
            raise ValueError("mount beside sensor; want the mount of that sensor alone")
        return self
