"""The `objects:` table of a sensor that lists objects: how it makes them of echoes.

Belongs here: names and limits of what a scenario may say. Defaults and their reasons are `TrackerOptions`'. Not: the
rules themselves (`emulator.objects`), what the device keeps (its family's `device:` table).
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from emulator.config.tables import DescribedTable

Share = Annotated[float, Field(gt=0.0, lt=1.0)]
Height = Annotated[float, Field(ge=-1e9, le=1e9)]


class ObjectOptions(DescribedTable):
    """Choices of a run; None: the tracker's own, see docs/can_objects.md."""

    segmentation: Literal["cluster", "actor"] | None = None
    "cluster: echoes that lie near each other (default); actor: ideal, echoes of one actor."
    classification: Literal["size", "actor"] | None = None
    "By the size seen so far (default), or by the actor's class."
    gap_m: Annotated[float, Field(gt=0.0, le=100.0)] | None = None
    "Echoes nearer to each other than this belong together (0.6)."
    gap_per_m: Annotated[float, Field(ge=0.0, le=1.0)] | None = None
    "Added for each metre of range (0.015)."
    min_points: Annotated[int, Field(ge=1, le=10_000)] | None = None
    "Fewer echoes are no object (2)."
    max_size_m: Annotated[float, Field(gt=0.0, le=1e6)] | None = None
    "Longer things are no road users (20)."
    height_m: tuple[Height, Height] | None = None
    "Echoes outside of this band, in this sensor's frame, are left out."
    coast_s: Annotated[float, Field(ge=0.0, le=60.0)] | None = None
    "An object that has not been seen for longer than this is gone (0.5)."
    confirm_hits: Annotated[int, Field(ge=1, le=100)] | None = None
    "Lists in which an object must be seen before it is reported (2)."
    acceleration_m_s2: Annotated[float, Field(gt=0.0, le=1000.0)] | None = None
    "White acceleration of the motion model (3)."
    position_noise_m: Annotated[float, Field(gt=0.0, le=100.0)] | None = None
    "Standard deviation of a box's centre, beside half the distance between beams (0.1)."
    white_range_m: Annotated[float, Field(gt=0.0, le=1e5)] | None = None
    "Range at which a white surface just reaches the threshold: turns intensities into reflectances (100)."

    @model_validator(mode="after")
    def _band(self) -> ObjectOptions:
        if self.height_m is not None and self.height_m[0] >= self.height_m[1]:
            raise ValueError(f"height_m {self.height_m[0]} to {self.height_m[1]}; want the lower end first")
        return self
