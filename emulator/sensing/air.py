"""What the air between does to light: extinction along rays, and what it sends back, over place and time.

Belongs here: the scenario's weather -> media and where they are at the time of a sweep. Not: the laws
(physics.atmosphere) and the signal of a soft target (soft).
"""

from __future__ import annotations

import bisect
import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np

from emulator.physics import atmosphere
from emulator.physics.arrays import Floats, Ints
from emulator.physics.constants import CLEAR_AIR_VISIBILITY_M
from emulator.scenario.weather import Dust, Fog, Layer, Plume, Rain, Smoke, Snow, Spray, Sun, WeatherConfig
from emulator.sensing.model import SensorModel
from emulator.sensing.particles import Particles, rain_particles, snow_particles
from emulator.sensing.rays import rotated
from emulator.world.broad_phase import BroadPhase
from emulator.world.motion import Motion

if TYPE_CHECKING:
    from emulator.world.scene import Scene

WHIRLING = frozenset({"car", "truck", "wide"})
"Classes of actors that whirl up spray unless the scenario names them."
AXLE_SHARE = 0.2
"The rear axle stands this share of a vehicle's length before its rear end."


@dataclass(frozen=True)
class Medium:
    """What fills a part of the air."""

    extinction_per_m: float
    backscatter_per_m_sr: float


class Place(Protocol):
    """Where a medium is that does not fill all the air."""

    def crossed(self, origin_m: Floats, direction: Floats, t_s: Floats) -> tuple[Floats, Floats]:
        """Distances (k,) along the rays at which they enter and leave; leave <= enter: not crossed."""


@dataclass(frozen=True)
class Volume:
    """A part of the air with a medium of its own."""

    place: Place
    medium: Medium

    def strength(self, t_s: Floats) -> Floats | float:
        """Factor on the medium at these times."""
        return self.place.strength(t_s) if isinstance(self.place, Wake) else 1.0


@dataclass(frozen=True)
class AirNow:
    """The air while one state of the weather lasts."""

    everywhere: Medium
    volumes: tuple[Volume, ...]
    particles: tuple[Particles, ...]
    "What falls and is seen piece by piece; its extinction is in `everywhere`."
    sun: Sun | None
    wet: bool

    @property
    def uneven(self) -> bool:
        """There are volumes with media of their own."""
        return bool(self.volumes)

    @property
    def extinction_per_m(self) -> float:
        """Of what fills all the air."""
        return self.everywhere.extinction_per_m

    def depth(self, origin_m: Floats, direction: Floats, length_m: Floats, t_s: Floats) -> Floats:
        """One-way optical depth of paths: (k,) from origins (k, 3) along unit vectors (k, 3)."""
        total = np.asarray(self.everywhere.extinction_per_m * length_m)
        for volume in self.volumes:
            enter, leave = volume.place.crossed(origin_m, direction, t_s)
            inside = np.maximum(np.minimum(length_m, leave) - enter, 0.0)
            if bool(np.any(inside)):
                total = total + volume.medium.extinction_per_m * volume.strength(t_s) * inside
        return total


@dataclass(eq=False)
class _NearWakes:
    """One state, and it with the wakes alone that were in reach last."""

    some: AirNow
    broad_phase: BroadPhase
    which: Ints | None = None


class Air:
    """Weather of a run, as one sensor's wavelength sees it."""

    def __init__(self, weather: WeatherConfig | None, model: SensorModel, scene: Scene) -> None:
        config = weather or WeatherConfig()
        times = (-math.inf, *config.switch_times_s())
        self._begins_s = times
        warnings: dict[str, None] = {}
        self._states = tuple(_air(config.at(t_s), model, scene, warnings) for t_s in times)
        self.warnings = tuple(warnings)
        self._near: dict[int, _NearWakes] = {}

    def near(self, air: AirNow, low_m: Floats, high_m: Floats, reach_m: float, begin_s: float, end_s: float) -> AirNow:
        """The same state without the wakes that no light from the box `low_m`, `high_m` (3,) can reach."""
        wakes = [volume.place for volume in air.volumes if isinstance(volume.place, Wake)]
        if not wakes:
            return air
        known = self._near.get(id(air))
        if known is None:
            known = _NearWakes(air, BroadPhase([w.motion for w in wakes], np.array([w.radius_m for w in wakes])))
            self._near[id(air)] = known
        which = known.broad_phase.within(low_m, high_m, reach_m, begin_s, end_s)
        if len(which) == len(wakes):
            return air
        if known.which is not which:
            kept = {id(wakes[k]) for k in which}
            volumes = tuple(v for v in air.volumes if not isinstance(v.place, Wake) or id(v.place) in kept)
            known.which, known.some = which, replace(air, volumes=volumes)
        return known.some

    def at(self, t_s: float) -> AirNow:
        """The state that holds at this time."""
        return self._states[bisect.bisect_right(self._begins_s, t_s) - 1]

    @property
    def states(self) -> tuple[AirNow, ...]:
        """All states of the run, in order."""
        return self._states


# ------------------------------------------------------------------------------- media
def _air(config: WeatherConfig, model: SensorModel, scene: Scene, warnings: dict[str, None]) -> AirNow:
    parts = _seen_media(config.fog, config.dust, config.smoke, model, warnings)
    clear = _clear(config, model, warnings)
    if not parts:  # a visibility given with fog, dust or smoke contains the clear air
        parts.append(clear)
    base = clear if len(parts) == 1 and parts[0] is clear else Medium(0.0, 0.0)
    falling: list[tuple[Medium, Particles | None, str]] = []
    rain, snow, wind = config.rain, config.snow, config.wind_m_s
    if rain is not None:
        falling.append((rain_medium(rain, model), rain_particles(rain, model, wind), rain.echoes))
    if snow is not None:
        falling.append((snow_medium(snow, model), snow_particles(snow, model, wind), snow.echoes))
    particles = tuple(single for _, single, _ in falling if single is not None)
    for medium, single, echoes in falling:
        sends = single is None and echoes != "off"
        parts.append(medium if sends else Medium(medium.extinction_per_m, 0.0))
    volumes = [_filled(layer, Slab(layer.bottom_m, layer.top_m), base, model, warnings) for layer in config.layers]
    volumes += [_filled(plume, Box.of(plume), base, model, warnings) for plume in config.plumes]
    if config.spray is not None:
        volumes += _wakes(config.spray, scene)
    return AirNow(
        everywhere=_sum(parts),
        volumes=tuple(volumes),
        particles=particles,
        sun=config.sun,
        wet=config.rain is not None and config.rain.wets and config.rain.rate_mm_h > 0.0,
    )


def _sum(parts: list[Medium]) -> Medium:
    return Medium(sum(p.extinction_per_m for p in parts), sum(p.backscatter_per_m_sr for p in parts))


def _clear(config: WeatherConfig, model: SensorModel, warnings: dict[str, None]) -> Medium:
    visibility = config.visibility_m or CLEAR_AIR_VISIBILITY_M
    _warn(warnings, "air", "kim", visibility, model)
    alpha = float(atmosphere.clear_air(model.wavelength_m, visibility))
    return Medium(alpha, alpha / atmosphere.fog_lidar_ratio(visibility))


def _seen_media(
    fog: Fog | None, dust: Dust | None, smoke: Smoke | None, model: SensorModel, warnings: dict[str, None]
) -> list[Medium]:
    """Media that are given by how far one sees in them."""
    found = []
    wavelength_m = model.wavelength_m
    if fog is not None:
        visibility = _visibility(fog)
        _warn(warnings, "fog", fog.law, visibility, model)
        alpha = float(atmosphere.FOG_LAWS[fog.law](visibility, wavelength_m))
        found.append(Medium(alpha, alpha / (fog.lidar_ratio_sr or atmosphere.fog_lidar_ratio(visibility))))
    if dust is not None:
        visibility = _visibility(dust)
        _warn(warnings, "dust", dust.law, visibility, model)
        law = atmosphere.dust_esmail if dust.law == "esmail" else atmosphere.fog_koschmieder
        alpha = float(law(visibility))
        found.append(Medium(alpha, alpha / (dust.lidar_ratio_sr or atmosphere.LIDAR_RATIO_SR["dust"])))
    if smoke is not None:
        visibility = _visibility(smoke)
        _warn(warnings, "smoke", "smoke_ijaz", visibility, model)
        alpha = float(atmosphere.smoke_ijaz(visibility, wavelength_m))
        found.append(Medium(alpha, alpha / (smoke.lidar_ratio_sr or atmosphere.LIDAR_RATIO_SR["smoke"])))
    return found


def _visibility(seen: Fog | Dust | Smoke) -> float:
    if seen.visibility_m is not None:
        return seen.visibility_m
    return float(atmosphere.visibility_from_mor(seen.mor_m or 0.0))


def _warn(warnings: dict[str, None], what: str, law: str, visibility_m: float, model: SensorModel) -> None:
    for text in atmosphere.out_of_validity(law, visibility_m, model.wavelength_m):
        warnings[f"{what}: {text}"] = None


def rain_medium(rain: Rain, model: SensorModel) -> Medium:
    """Rain as a continuum."""
    rate, law = rain.rate_mm_h, rain.law_used
    half_angle = 0.5 * model.divergence_rad
    forward = rain.forward_scatter if rain.forward_scatter is not None else law == "marshall_palmer"
    if law == "one_size":
        radius_m = 1e-3 * (rain.drop_radius_mm or 0.0)
        alpha = float(atmosphere.rain_one_size(rate, radius_m))
        factor = float(atmosphere.q_forward(2.0 * radius_m, model.wavelength_m, half_angle)) / 2.0
    else:
        alpha = float(atmosphere.RAIN_LAWS[law](rate))
        factor = atmosphere.forward_scatter_factor(rate, model.wavelength_m, half_angle)
    alpha *= factor if forward else 1.0
    ratio = rain.lidar_ratio_sr or float(atmosphere.rain_lidar_ratio(rain.backscatter_per_d2_sr))
    return Medium(alpha, alpha / ratio)


def snow_medium(snow: Snow, model: SensorModel) -> Medium:
    """Snow as a continuum."""
    alpha = float(atmosphere.SNOW_LAWS[snow.kind](snow.rate_mm_h, model.wavelength_m))
    return Medium(alpha, alpha / (snow.lidar_ratio_sr or atmosphere.LIDAR_RATIO_SR["snow"]))


def _filled(part: Layer | Plume, place: Place, base: Medium, model: SensorModel, warnings: dict[str, None]) -> Volume:
    """A layer or plume. What is given by a visibility takes the place of the clear air there; the rest adds to it.

    It never thins the air around it: two such volumes that overlap would take the same air away twice, and light
    would grow on its way. One that is clearer than its surroundings adds nothing, and that is reported.
    """
    seen = _seen_media(part.fog, part.dust, part.smoke, model, warnings)
    if seen:
        more = _sum([*seen, Medium(-base.extinction_per_m, -base.backscatter_per_m_sr)])
        if more.extinction_per_m < 0.0:
            warnings["layer or plume: clearer than the surrounding air; has no effect"] = None
        seen = [Medium(max(more.extinction_per_m, 0.0), max(more.backscatter_per_m_sr, 0.0))]
    if part.extinction_per_m is not None:
        seen.append(Medium(part.extinction_per_m, part.extinction_per_m / part.lidar_ratio_sr))
    return Volume(place, _sum(seen))


def _wakes(spray: Spray, scene: Scene) -> list[Volume]:
    """Spray behind every vehicle that whirls it up."""
    medium = Medium(spray.extinction_per_m, spray.extinction_per_m / spray.lidar_ratio_sr)
    found = []
    for index, name in enumerate(scene.actors):
        wanted = name in spray.behind if spray.behind is not None else scene.classes[index] in WHIRLING
        if not wanted or scene.motions[index].still:
            continue
        rear, front = _length_of(scene, index)
        axles = (rear + AXLE_SHARE * (front - rear), front - AXLE_SHARE * (front - rear))
        found.append(Volume(Wake(scene, index, axles, (spray.length_m, spray.width_m, spray.height_m)), medium))
    return found


def _length_of(scene: Scene, actor: int) -> tuple[float, float]:
    """Least and largest x of an actor's bodies, in its own frame."""
    x = [body.vertices[:, 0] for body in scene.bodies if body.actor == actor and len(body.vertices)]
    return (0.0, 0.0) if not x else (min(float(v.min()) for v in x), max(float(v.max()) for v in x))


# ------------------------------------------------------------------------------- places
def _through(low: Floats, high: Floats, origin: Floats, direction: Floats) -> tuple[Floats, Floats]:
    """Where rays (k, d) enter and leave boxes [low, high], by slabs; enter >= 0."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        one, two = (low - origin) / direction, (high - origin) / direction
    outside = (direction == 0.0) & ((origin < low) | (origin > high))
    parallel = direction == 0.0
    near = np.where(outside, np.inf, np.where(parallel, -np.inf, np.minimum(one, two)))
    far = np.where(outside, -np.inf, np.where(parallel, np.inf, np.maximum(one, two)))
    return np.maximum(near.max(axis=1), 0.0), far.min(axis=1)


@dataclass(frozen=True)
class Slab:
    """Everything between two heights."""

    bottom_m: float
    top_m: float

    def crossed(self, origin_m: Floats, direction: Floats, t_s: Floats) -> tuple[Floats, Floats]:
        low, high = np.array([self.bottom_m]), np.array([self.top_m])
        return _through(low, high, origin_m[:, 2:], direction[:, 2:])


@dataclass(frozen=True, eq=False)
class Box:
    """An upright box that drifts."""

    at_m: Floats
    size_m: Floats
    yaw_rad: float
    velocity_m_s: Floats

    @classmethod
    def of(cls, plume: Plume) -> Box:
        """The box of a plume."""
        return cls(
            np.array(plume.at_m), np.array(plume.size_m), math.radians(plume.yaw_deg), np.array(plume.velocity_m_s)
        )

    def crossed(self, origin_m: Floats, direction: Floats, t_s: Floats) -> tuple[Floats, Floats]:
        cos, sin = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        turn = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
        local = rotated(turn, origin_m - (self.at_m + np.asarray(t_s)[:, None] * self.velocity_m_s))
        half = 0.5 * self.size_m[:2]
        low, high = np.array([-half[0], -half[1], 0.0]), np.array([half[0], half[1], self.size_m[2]])
        return _through(low, high, local, rotated(turn, direction))


@dataclass(frozen=True, eq=False)
class Wake:
    """The box behind a moving vehicle: from its rear axle against the direction in which it drives."""

    scene: Scene
    actor: int
    axles_m: tuple[float, float]
    "x of the rear and of the front axle in the actor's frame; reversing, the front one is the rear."
    size_m: tuple[float, float, float]

    @property
    def motion(self) -> Motion:
        """Of its vehicle."""
        return self.scene.motions[self.actor]

    @property
    def radius_m(self) -> float:
        """Of a sphere about the vehicle's origin that holds it."""
        length, width, height = self.size_m
        return math.hypot(max(abs(axle) for axle in self.axles_m) + length, 0.5 * width, height)

    def crossed(self, origin_m: Floats, direction: Floats, t_s: Floats) -> tuple[Floats, Floats]:
        # a sweep lasts milliseconds, a wake is metres long: one pose serves all rays
        when = np.asarray(t_s)[:1]
        if not len(when):
            return np.zeros(0), np.zeros(0)
        pose = self.scene.pose(self.actor, when)
        rotation, velocity = pose.rotation[0], self.scene.velocity(self.actor, when)[0]
        local, along = rotated(rotation.T, origin_m - pose.position_m[0]), rotated(rotation.T, direction)
        length, width, height = self.size_m
        if float(rotation[:, 0] @ velocity) >= 0.0:
            low_x, high_x = self.axles_m[0] - length, self.axles_m[0]
        else:
            low_x, high_x = self.axles_m[1], self.axles_m[1] + length
        low, high = np.array([low_x, -0.5 * width, 0.0]), np.array([high_x, 0.5 * width, height])
        return _through(low, high, local, along)

    def strength(self, t_s: Floats) -> Floats:
        """Square of the speed over 100 km/h."""
        speed = np.linalg.norm(self.scene.velocity(self.actor, np.asarray(t_s)[:1]), axis=1)
        return np.asarray((speed / (100.0 / 3.6)) ** 2)
