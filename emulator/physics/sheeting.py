"""Retroreflective sheeting by the angles of entrance and observation: classes of standards as data.

Here: the tables (`sheeting.yaml`) and the share of the named coefficient that is left at other angles. Not here: what
becomes of it at a surface (materials).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from types import MappingProxyType

import numpy as np

from emulator.physics.arrays import Floats, Values, exp_or_zero, floats


@dataclass(frozen=True, eq=False)
class Sheeting:
    """One class of sheeting. Between its angles, and beyond the largest, the logarithm of R_A is linear."""

    name: str
    observation_deg: Floats
    entrance_deg: Floats
    cd_lx_m2: Floats
    "(observation, entrance)"
    reference: tuple[float, float]
    "Angles of observation and entrance at which the class is named."
    source: str
    evidence: str

    @property
    def reference_cd_lx_m2(self) -> float:
        """R_A there."""
        return round(float(self.coefficient(*self.reference)), 9)

    def coefficient(self, observation_deg: Values, entrance_deg: Values) -> Floats:
        """R_A at these angles, below the smallest that of the smallest; 0 from 90 degrees on. [cd/lx/m2]"""
        low, part = _place(self.observation_deg, observation_deg)
        left, share = _place(self.entrance_deg, entrance_deg)
        table = np.log(self.cd_lx_m2)
        near = (1.0 - share) * table[low, left] + share * table[low, left + 1]
        far = (1.0 - share) * table[low + 1, left] + share * table[low + 1, left + 1]
        return np.where(floats(entrance_deg) < 90.0, exp_or_zero((1.0 - part) * near + part * far), 0.0)

    def share(self, observation_rad: Values, cosine: Values) -> Floats:
        """Light sent back per solid angle and power received, over R_A of the reference: R_A over cos of entrance.

        R_A is intensity over illuminance across the beam and over area of the sheet. A beam of power P covers P/(E cos)
        of the sheet, so I = R_A E area = R_A P / cos. Beyond the table's largest angle cos stays that of it.
        """
        c = np.clip(floats(cosine), 0.0, 1.0)
        entrance = np.degrees(np.arccos(c))
        slant = np.maximum(c, math.cos(math.radians(float(self.entrance_deg[-1]))))
        return self.coefficient(np.degrees(floats(observation_rad)), entrance) / (self.reference_cd_lx_m2 * slant)


def _place(knots: Floats, at: Values) -> tuple[np.ndarray[tuple[int, ...], np.dtype[np.int64]], Floats]:
    """Number of the interval, and the part of it; above 1 beyond the last knot."""
    x = np.maximum(floats(at), knots[0])
    low = np.clip(knots.searchsorted(x, side="right") - 1, 0, len(knots) - 2).astype(np.int64)
    return low, (x - knots[low]) / (knots[low + 1] - knots[low])


@cache
def classes() -> Mapping[str, Sheeting]:
    """All classes by name."""
    from ruamel.yaml import YAML

    text = resources.files("emulator.physics").joinpath("sheeting.yaml").read_text(encoding="utf-8")
    found = {}
    for name, one in YAML(typ="safe", pure=True).load(text).items():
        found[name] = Sheeting(
            name, floats(one["observation_deg"]), floats(one["entrance_deg"]), floats(one["cd_lx_m2"]),
            (float(one["reference"][0]), float(one["reference"][1])), one["source"], one["evidence"],
        )  # fmt: skip
    return MappingProxyType(found)
