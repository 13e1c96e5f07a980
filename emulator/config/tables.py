"""What every table of a scenario's or a sensor's file keeps to: types as written, no key that nobody knows, frozen.

Belongs here: these rules and the numbers that many tables share. Not: any key.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]

MOST_M = 1e9
"Of a coordinate or length: float64 resolves 1e-7 m there, beyond it ever less."
Coordinate = Annotated[float, Field(ge=-MOST_M, le=MOST_M)]


class Table(BaseModel):
    """Frozen, strict, without keys of its own making."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class DescribedTable(Table):
    """The texts under its keys stand in the schema too."""

    model_config = ConfigDict(use_attribute_docstrings=True)
