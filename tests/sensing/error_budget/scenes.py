"""Random scenes for comparing a full computation with a spared one, made without files: a few milliseconds each."""

from __future__ import annotations

from dataclasses import astuple, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from emulator.casting.raycast import Caster
from emulator.physics.materials import Material, SurfaceTable, material
from emulator.physics.random_streams import RandomStreams
from emulator.scenario.tables import Mount
from emulator.scenario.weather import WeatherConfig
from emulator.sensing.air import Air
from emulator.sensing.measure import Measure
from emulator.sensing.model import sensor_model
from emulator.sensing.paths import Surfaces
from emulator.sensing.receiver import Receiver
from emulator.sensors.physics_options import LeaveOut, PhysicsOptions
from emulator.sensors.spec import load_spec
from emulator.world import triangles
from emulator.world.motion import Steady
from emulator.world.scene import Body, Scene
from protocols.scan import ScanPlan

MODELS = LD, LMS, PAPER = "sick-ld-lrs1000", "sick-lms291-s05", "paper-905nm"
PUCK = "velodyne-vlp-16"
MATERIALS = ("asphalt", "concrete", "car_paint_silver", "window_glass", "retro_sheeting", "brick")


def random_scene(seed: int) -> Scene:
    """Road, walls, boxes, posts and balls at random, half of them moving, some through each other."""
    rng = np.random.default_rng(seed)
    motions: list[Any] = [Steady()]
    bodies = [body(0, triangles.plane(200.0, 200.0), 0, Steady(at_m=(0.0, 0.0, float(-rng.uniform(0.3, 2.0)))))]
    for _ in range(int(rng.integers(2, 9))):
        distance, azimuth = rng.uniform(2.0, 50.0), rng.uniform(-1.0, 1.0)
        size = rng.uniform(0.1, 6.0, 3)
        kind = rng.integers(5)
        made = (
            triangles.box(*size) if kind < 2
            else triangles.cylinder(0.2 * size[0], 3.0, int(rng.integers(3, 24))) if kind == 2
            else triangles.sphere(0.5 * size[0], int(rng.integers(6, 16))) if kind == 3
            else triangles.plane(4.0 * size[0], 4.0 * size[1])
        )  # fmt: skip
        speed = tuple(rng.uniform(-20.0, 20.0, 3) * (1.0, 1.0, 0.0)) if rng.random() < 0.5 else (0.0, 0.0, 0.0)
        turning = float(rng.uniform(-90.0, 90.0)) if rng.random() < 0.2 else 0.0
        motion = Steady(
            (float(distance * np.cos(azimuth)), float(distance * np.sin(azimuth)), float(rng.uniform(-2.5, 0.0))),
            float(rng.uniform(0.0, 360.0)), float(rng.uniform(-90.0, 90.0)) if kind == 4 else 0.0, 0.0,
            (float(speed[0]), float(speed[1]), 0.0), turning,
        )  # fmt: skip
        motions.append(motion)
        bodies.append(body(len(motions) - 1, made, int(rng.integers(len(MATERIALS))), motion))
    names = ("world", *(f"a{k}" for k in range(1, len(motions))))
    return Scene(names, ("unknown",) * len(names), tuple(motions), MATERIALS, tuple(bodies))


def body(actor: int, geometry: triangles.Geometry, kind: int, motion: Steady) -> Body:
    """One body of one material."""
    return Body(actor, geometry, np.full(len(geometry.parts), kind, np.int32), motion)


def random_weather(seed: int) -> WeatherConfig | None:
    """Every second time some: sun, haze or fog, rain or snow, each with its chance."""
    rng = np.random.default_rng([seed, 7])
    if rng.random() < 0.5:
        return None
    found: dict[str, Any] = {}
    if rng.random() < 0.6:
        found["sun"] = {
            "azimuth_deg": float(rng.uniform(-180.0, 180.0)),
            "elevation_deg": float(rng.uniform(1.0, 80.0)),
        }
    kind = rng.integers(5)
    if kind == 1:
        found["fog"] = {"visibility_m": float(10.0 ** rng.uniform(1.3, 4.0))}
    elif kind == 2:
        found["rain"] = {"rate_mm_h": float(10.0 ** rng.uniform(-1.0, 1.7))}
    elif kind == 3:
        found["snow"] = {"rate_mm_h": float(10.0 ** rng.uniform(-1.0, 0.7)), "kind": "wet"}
    return WeatherConfig.model_validate(found)


def measure_of(scene: Scene, model: str, weather: WeatherConfig | None = None, **options: Any) -> Measure:
    """A sensor at the origin of such a scene."""
    made = sensor_model(load_spec(model), PhysicsOptions(**options), "operational")
    found: list[Material] = [material(name, {}) for name in scene.materials]
    dry, wet = (Surfaces.of(SurfaceTable.of(found, 1e9 * made.wavelength_m, one)) for one in (False, True))
    return Measure(
        made, scene, Mount(), Caster(scene), (dry, wet), Air(weather, made, scene),
        Receiver(made, RandomStreams(1, "front")),
    )  # fmt: skip


def plan(beams: int = 61, degrees: float = 55.0, seconds: float = 0.02, sweep: int = 0) -> ScanPlan:
    """A sweep across what lies ahead."""
    azimuth = np.radians(np.linspace(-degrees, degrees, beams))
    return ScanPlan(0, sweep, 0, azimuth, np.zeros(beams), np.linspace(0.0, seconds, beams), seconds, max_range_m=100.0)


def compared(scene: Scene, model: str, plan: ScanPlan, **options: Any) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Beams whose ranges are the same within a step, and beams that were plain."""
    rays_saved = measure_of(scene, model, leave_out=LeaveOut(closed_form="always"), **options)
    whole = measure_of(scene, model, leave_out=LeaveOut(closed_form="never"), **options)
    return same(rays_saved, whole, plan)


def same(one: Measure, other: Measure, plan: ScanPlan) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """The same of two measuring functions; without the rule of plain beams none is one."""
    a, b = one(plan).range_m, other(replace(plan)).range_m
    plain = one.view(plan).plain
    with np.errstate(invalid="ignore"):
        equal = (np.isnan(a) & np.isnan(b)) | (np.abs(a - b) <= one.model.lsb_m)
    return equal.all(axis=1), np.zeros(len(a), bool) if plain is None else plain


@dataclass(frozen=True)
class Tally:
    """Of many comparisons of a spared scan with the full one."""

    beams: int = 0
    differ: int = 0
    "By more than a step of the range, or in being there at all."
    plain: int = 0
    plain_differ: int = 0

    def __add__(self, other: Tally) -> Tally:
        return Tally(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))

    @property
    def share(self) -> float:
        """Of the beams that differ."""
        return self.differ / max(self.beams, 1)


def tally(equal: NDArray[np.bool_], plain: NDArray[np.bool_]) -> Tally:
    """Of one comparison."""
    return Tally(
        len(equal), int(np.count_nonzero(~equal)), int(np.count_nonzero(plain)), int(np.count_nonzero(plain & ~equal))
    )


def full_against_pruned(seed: int, **options: Any) -> Tally:
    """One random scene in random weather: every term computed, and every rule on; two sweeps."""
    scene, weather, model = random_scene(seed), random_weather(seed), MODELS[seed % 3]
    rules = LeaveOut(closed_form="auto" if seed % 4 == 0 else "always")
    rays_saved = measure_of(scene, model, weather, leave_out=rules, **options)
    whole = measure_of(scene, model, weather, full=True, **options)
    total = Tally()
    for sweep in range(2):
        total += tally(*same(rays_saved, whole, plan(sweep=sweep)))
    return total
