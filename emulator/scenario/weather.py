"""The `weather:` table of a scenario: what is in the air, where, and how it changes over time.

Belongs here: keys, bounds, and which table holds at a given time. Not here: the laws that turn a visibility or a rate
into extinction (physics.atmosphere and its neighbours) and what a beam makes of them (sensing).
"""

from __future__ import annotations

import bisect
import itertools
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from emulator.config.tables import MOST_M, Coordinate, NotNegative, Positive, Table

Rate = Annotated[float, Field(ge=0.0, le=2000.0)]
"mm/h of water; 300 mm/h is the wettest minute of most places."
MOST_VOLUMES = 1000
"Layers, and plumes, of one state: each is crossed by every beam of every sweep."
MOST_CHANGES = 10_000
Length = Annotated[float, Field(gt=0.0, le=MOST_M)]
Speed = Annotated[float, Field(ge=-1e5, le=1e5)]
Extinction = Annotated[float, Field(ge=0.0, le=1e6)]
"1e6: light goes a micrometre; no natural medium comes near."
Ratio = Annotated[float, Field(gt=0.0, le=1e9)]
Point = tuple[Coordinate, Coordinate, Coordinate]
Velocity = tuple[Speed, Speed, Speed]
Extent = tuple[Length, Length, Length]


class _Seen(Table):
    """A medium given by how far one sees in it."""

    visibility_m: Positive | None = None
    "Two per cent contrast."
    mor_m: Positive | None = None
    "Meteorological optical range, five per cent; instead of `visibility_m`."
    lidar_ratio_sr: Ratio | None = None
    "Extinction over backscatter; None: the medium's usual one."

    @model_validator(mode="after")
    def _one_of_both(self) -> _Seen:
        if (self.visibility_m is None) == (self.mor_m is None):
            raise ValueError("want either visibility_m or mor_m, a number > 0")
        return self


class Fog(_Seen):
    """Fog, mist or haze; the clear air is inside its visibility."""

    law: Literal["kim", "kruse", "naboulsi_advection", "naboulsi_radiation", "ijaz"] = "kim"


class Dust(_Seen):
    """Mineral dust and sand."""

    law: Literal["koschmieder", "esmail"] = "koschmieder"


class Smoke(_Seen):
    """Smoke of a fire."""

    law: Literal["ijaz"] = "ijaz"


class _Falling(Table):
    rate_mm_h: Rate
    echoes: Literal["auto", "drops", "continuum", "off"] = "auto"
    """drops: single particles, drawn where one alone can be seen. continuum: a soft target. auto: whichever the number
    of particles in a pulse cell asks for."""
    lidar_ratio_sr: Ratio | None = None


class Rain(_Falling):
    """Rain by its rate."""

    law: Literal["carbonneau", "japan", "itu", "marshall_palmer", "one_size"] | None = None
    "None: `one_size` when a radius is given, else `carbonneau`."
    drop_radius_mm: Annotated[float, Field(ge=0.25, le=3.0)] | None = None
    "Radius of every drop, 0.5 to 6 mm of diameter. None: the sizes of Marshall and Palmer."
    forward_scatter: bool | None = None
    "Light diffracted into the beam is not lost; None: on for `marshall_palmer`. Laws fitted to measurements hold it."
    backscatter_per_d2_sr: Positive = 0.005845
    "kappa: backscatter of a drop over its squared diameter; uncertain by a factor 10."
    wets: bool = False
    "Surfaces under the open sky are wet: darker where they are rough."

    @model_validator(mode="after")
    def _law_has_its_radius(self) -> Rain:
        if self.law == "one_size" and self.drop_radius_mm is None:
            raise ValueError("law one_size without drop_radius_mm; want a radius of 0.25 to 3 mm")
        return self

    @property
    def law_used(self) -> str:
        """The law of extinction that holds."""
        return self.law or ("carbonneau" if self.drop_radius_mm is None else "one_size")


class Snow(_Falling):
    """Snow by the rate of its water."""

    kind: Literal["wet", "dry"] = "dry"
    flake_reflectance: Annotated[float, Field(gt=0.0, le=1.0)] = 0.8


class Spray(Table):
    """Water whirled up behind moving vehicles on a wet road."""

    behind: tuple[str, ...] | None = None
    "Actors that whirl it up; None: all of the classes car, truck, wide."
    extinction_per_m: Annotated[float, Field(gt=0.0, le=1e6)] = 0.0045
    "At 100 km/h; 0.0045 moderate to 0.017 strong."
    length_m: Length = 10.0
    width_m: Length = 2.5
    height_m: Length = 1.5
    lidar_ratio_sr: Ratio = 18.8


class Sun(Table):
    """The sun; without this table it is night."""

    total_w_m2: Annotated[float, Field(ge=0.0, le=1e5)] = 1370.0
    "Outside the atmosphere; 0: night."
    azimuth_deg: Annotated[float, Field(ge=-1e6, le=1e6)] = 180.0
    "Where it stands, from the world's x axis towards y."
    elevation_deg: Annotated[float, Field(ge=-90.0, le=90.0)] = 45.0
    "Of the disc's middle, as it is seen. Below 0 twilight, from -18 on night."
    cloud_factor: Annotated[float, Field(ge=0.0, le=1.0)] = 1.0
    "Share of sun and sky that clouds leave."
    turbidity_beta: Annotated[float, Field(ge=0.0, le=2.0)] | None = None
    "Angstrom's coefficient: optical depth of haze at 1 um. None: 0.035, very clear; 0.1 clear, 0.2 hazy, 0.4 turbid."
    turbidity: Annotated[float, Field(ge=1.0, le=30.0)] | None = None
    "The same as Linke turbidity at air mass 2, instead of `turbidity_beta`: 2.19 without haze, 3 clear, 5 hazy."
    circumsolar_ratio: Annotated[float, Field(ge=0.0, le=0.8)] | None = None
    "Light of the aureole over that of disc and aureole. None: from the haze and the elevation."

    @model_validator(mode="after")
    def _one_turbidity(self) -> Sun:
        if self.turbidity is not None:
            if self.turbidity_beta is not None:
                raise ValueError("turbidity and turbidity_beta; want one of them")
            from emulator.physics import sunlight

            try:
                sunlight.beta_of_linke(self.turbidity)
            except ValueError as error:
                raise ValueError(f"turbidity {error}") from None
        return self

    @property
    def beta(self) -> float:
        """Angstrom's coefficient of the haze."""
        from emulator.physics import sunlight

        if self.turbidity is not None:
            return sunlight.beta_of_linke(self.turbidity)
        return sunlight.CLEAR_BETA if self.turbidity_beta is None else self.turbidity_beta


class _Media(Table):
    """What can be in a part of the air."""

    fog: Fog | None = None
    dust: Dust | None = None
    smoke: Smoke | None = None
    extinction_per_m: Extinction | None = None
    "Any other medium, with `lidar_ratio_sr`."
    lidar_ratio_sr: Ratio = 18.8

    def filled(self) -> bool:
        return any(x is not None for x in (self.fog, self.dust, self.smoke, self.extinction_per_m))


class Layer(_Media):
    """A flat layer of the air, everywhere between two heights above the world's origin."""

    bottom_m: Coordinate = -1e6
    top_m: Coordinate

    @model_validator(mode="after")
    def _upright(self) -> Layer:
        if self.top_m <= self.bottom_m:
            raise ValueError(f"top_m {self.top_m} not above bottom_m {self.bottom_m}; want it larger")
        if not self.filled():
            raise ValueError("empty; want fog, dust, smoke or extinction_per_m")
        return self


class Plume(_Media):
    """A cloud: an upright box, centre of its base at `at_m`, drifting with `velocity_m_s`."""

    at_m: Point
    size_m: Extent
    yaw_deg: Annotated[float, Field(ge=-1e6, le=1e6)] = 0.0
    velocity_m_s: Velocity = (0.0, 0.0, 0.0)

    @model_validator(mode="after")
    def _not_empty(self) -> Plume:
        if not self.filled():
            raise ValueError("empty; want fog, dust, smoke or extinction_per_m")
        return self


class _State(Table):
    """Everything that can change."""

    visibility_m: Positive | None = None
    "Of the air without precipitation, fog or dust; None: 23 km."
    fog: Fog | None = None
    rain: Rain | None = None
    snow: Snow | None = None
    dust: Dust | None = None
    smoke: Smoke | None = None
    spray: Spray | None = None
    sun: Sun | None = None
    wind_m_s: Velocity = (0.0, 0.0, 0.0)
    "Of the air in the world's axes: drops and flakes drift with it."
    layers: Annotated[tuple[Layer, ...], Field(max_length=MOST_VOLUMES)] = ()
    plumes: Annotated[tuple[Plume, ...], Field(max_length=MOST_VOLUMES)] = ()


class Change(_State):
    """From `t_s` on the tables given here hold; one that is null is over; what is not named goes on."""

    t_s: NotNegative


class WeatherConfig(_State):
    """Weather of a scenario over time."""

    changes: Annotated[tuple[Change, ...], Field(max_length=MOST_CHANGES)] = ()

    @model_validator(mode="after")
    def _in_order(self) -> WeatherConfig:
        times = [change.t_s for change in self.changes]
        if any(late <= early for early, late in itertools.pairwise(times)):
            raise ValueError(f"changes at {times}; want rising t_s")
        return self

    def switch_times_s(self) -> tuple[float, ...]:
        """Instants at which another state begins."""
        return tuple(change.t_s for change in self.changes)

    def later(self, by_s: float) -> WeatherConfig:
        """The same with every change so much later: that of a later round of a scenario that begins again."""
        if not self.changes or not by_s:
            return self
        moved = [
            Change.model_construct(
                _fields_set=set(change.model_fields_set),
                **{key: getattr(change, key) for key in change.model_fields_set} | {"t_s": change.t_s + by_s},
            )
            for change in self.changes
        ]
        return self.model_copy(update={"changes": tuple(moved)})

    def at(self, t_s: float) -> WeatherConfig:
        """The state that holds at `t_s`, without further changes."""
        count = bisect.bisect_right([change.t_s for change in self.changes], t_s)
        if not self.changes:
            return self
        values: dict[str, Any] = {name: getattr(self, name) for name in _State.model_fields}
        for change in self.changes[:count]:
            values |= {name: getattr(change, name) for name in change.model_fields_set if name != "t_s"}
        return WeatherConfig.model_construct(_fields_set=set(values), **values, changes=())
