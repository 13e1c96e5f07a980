"""What the base paper looks at: its objects with their printed ranges, its weathers, and closed forms for both.

The paper: Hadj-Bachir and de Souza 2019, "LIDAR sensor simulation in adverse weather condition for driving assistance
development", hal-01998668. Belongs here: its numbers and our readings of them. Not: measuring (ranges).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from emulator.physics import radiometry
from emulator.sensing.model import SensorModel
from emulator.studies import stage

PAPER = "paper-905nm"
DARK_RHO, CAR_RHO, BUMPER_RHO, WINDSCREEN_RHO = 0.05, 0.75, 0.20, 0.03
CAR_PLATE_M, TORSO_FRONT_M, TORSO_SIDE_M = (1.7, 0.7), (0.45, 0.6), (0.25, 0.6)
"Width and height of the plates that stand for a car's rear and a torso; all larger than the beam at its range."

Form = Literal["plate", "tube", "ball"]


@dataclass(frozen=True)
class Thing:
    """One object: what stands for it, and where its numbers come from."""

    name: str
    printed_m: float | None
    "Table 2 of the paper."
    form: Form
    rho: float
    size_m: tuple[float, float]
    "Width or diameter; height or length."
    origin: str
    "How its numbers were found."

    @property
    def target(self) -> stage.Target:
        """As a target on the stage."""
        if self.form == "plate":
            return stage.plate(*self.size_m, self.rho)
        return stage.tube(*self.size_m, self.rho) if self.form == "tube" else stage.ball(self.size_m[0], self.rho)

    def farthest_m(self, model: SensorModel, extinction_per_m: float, snr: float | None = None) -> float:
        """Closed form of the largest range at which its echo reaches `snr` (the threshold)."""
        wanted = model.threshold if snr is None else snr
        k, rho, half = model.k_m2, self.rho, model.beam.half_angle_x_rad
        if self.form == "tube":
            return float(radiometry.max_range_cylinder(k, rho, extinction_per_m, wanted, half, self.size_m[0]))
        if self.form == "ball":
            return float(radiometry.max_range_sphere(k, rho, extinction_per_m, wanted, half, self.size_m[0]))
        return float(radiometry.max_range_extended(k, rho, extinction_per_m, wanted))


TABLE_2 = (
    Thing("Container truck", 237.0, "plate", 0.80, (2.4, 2.4), "reflectance 0.80 chosen after seeing the row"),
    Thing("Car body", 232.0, "plate", CAR_RHO, CAR_PLATE_M, "K times reflectance 0.75 fitted to this row"),
    Thing("Reflective road sign", 142.0, "plate", 0.30, (0.6, 0.6), "reflectance 0.30 chosen after seeing the row"),
    Thing("Bicycle, front or back", 22.0, "tube", DARK_RHO, (0.003, 0.6), "diameter 3.0 mm fitted to this row"),
    Thing("Bicycle, side", 45.0, "tube", DARK_RHO, (0.0286, 0.6), "a standard tube; 0.05 from the pedestrian"),
    Thing("Pedestrian, front or back", 58.0, "plate", DARK_RHO, TORSO_FRONT_M, "0.05 chosen after seeing the row"),
    Thing("Pedestrian, side", 59.0, "plate", DARK_RHO, TORSO_SIDE_M, "same surface: follows from the row above"),
)  # fmt: skip

CAR, PEDESTRIAN = TABLE_2[1], TABLE_2[5]

FIGURE_3 = (
    CAR,
    Thing("Bumper", None, "plate", BUMPER_RHO, CAR_PLATE_M, "reflectance 0.20: our choice"),
    Thing("Windscreen", None, "plate", WINDSCREEN_RHO, CAR_PLATE_M, "diffuse 0.03, dirt: our choice"),
)


@dataclass(frozen=True)
class Air:
    """One weather."""

    name: str
    weather: Mapping[str, Any] = field(default_factory=dict)
    "The scenario's table."
    road: Literal["dry", "wet", "snow"] = "dry"
    printed: str = ""
    "What the paper says of it."


CLEAR = Air("clear, V 23 km", {"visibility_m": 23000.0})


def fog(name: str, visibility_m: float, printed: str, **more: Any) -> Air:
    """Fog by its visibility."""
    return Air(name, {"fog": {"visibility_m": visibility_m, **more}}, printed=printed)


def rain(rate_mm_h: float, law: str = "carbonneau", **more: Any) -> Air:
    """Rain in otherwise clear air."""
    if rate_mm_h == 0.0:
        return CLEAR
    return Air(f"rain {rate_mm_h:g} mm/h", {"rain": {"rate_mm_h": rate_mm_h, "law": law, **more}}, "wet")


def snow(kind: str, rate_mm_h: float) -> Air:
    """Snow in otherwise clear air, by the rate of its water."""
    return Air(f"{kind} snow {rate_mm_h:g} mm/h", {"snow": {"kind": kind, "rate_mm_h": rate_mm_h}}, "snow")


TABLE_3 = (
    fog("clear, V 5 km", 5000.0, "\"up to 5 km\""),
    fog("mist, V 4 km", 4000.0, "practically on the clear curve"),
    fog("medium fog, V 400 m", 400.0, "range falls"),
    fog("dense fog, V 40 m", 40.0, "range falls rapidly"),
)  # fmt: skip
TABLE_4_MM_H = (0.0, 10.0, 35.0, 70.0)
DROP_RADIUS_MM = 3.0
"Table 4 of the paper."

RAIN_LAWS: tuple[tuple[str, str, Mapping[str, Any]], ...] = (
    ("Carbonneau (default)", "carbonneau", {}),
    ("Japan", "japan", {}),
    ("ITU-R P.1814-1", "itu", {}),
    ("Marshall-Palmer, Q = 2", "marshall_palmer", {"forward_scatter": False}),
    ("Marshall-Palmer, forward light kept", "marshall_palmer", {"forward_scatter": True}),
    ("one size, radius 3 mm", "one_size", {"drop_radius_mm": DROP_RADIUS_MM, "forward_scatter": False}),
)
"Title, law of the scenario, its further keys."
