"""Scenes in a few lines for tests: from a scenario's data to scans, through the product's own checks and caster."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from emulator.casting import raycast
from emulator.config.yaml_lines import Source
from emulator.scenario import scenario
from emulator.scenario.scenario import Scenario
from emulator.sensing.measure import Measure
from emulator.sensing.measure import build as build_measure
from emulator.world import scene
from protocols.scan import ScanPlan

Floats = NDArray[np.float64]
NOT_YAML = re.compile(r"NaN|Infinity|\d{30}")
"What is another value in YAML than in JSON, or too long for it."
AXIS_ON_Y = {"pitch_deg": -90.0}
"Turns a plane, whose normal is z, to face along x."


def plate(
    x_m: float, material: str, width_m: float = 200.0, y_m: float = 0.0, height_m: float = 200.0
) -> dict[str, Any]:
    """A vertical plate across the x axis."""
    return {"plane": {"size_m": [height_m, width_m]}, "at_m": [x_m, y_m, 0.0], "material": material, **AXIS_ON_Y}


def grey(rho: float) -> dict[str, Any]:
    """A Lambert material."""
    return {"rho": rho, "model": "lambert"}


def scenario_of(path: Path, text: dict[str, Any]) -> Scenario:
    """What `scenario.load` gives of a file of one line, which is written, without parsing it as YAML: half the time."""
    line = json.dumps(text)
    path.write_text(line, encoding="utf-8")  # JSON is YAML
    if NOT_YAML.search(line):
        return scenario.load(str(path))
    return scenario.from_source(Source(path, json.loads(line)))


def build(
    folder: Path,
    world: Sequence[dict[str, Any]] = (),
    *,
    actors: Sequence[dict[str, Any]] = (),
    weather: dict[str, Any] | None = None,
    materials: dict[str, Any] | None = None,
    model: str = "paper-905nm",
    mode: str = "operational",
    physics: dict[str, Any] | None = None,
    mount: dict[str, Any] | None = None,
    seed: int = 1,
    emitters: Sequence[dict[str, Any]] = (),
    others: Sequence[dict[str, Any]] = (),
) -> Measure:
    """The measuring function of a sensor `front` in such a scenario; `others`: its further sensors."""
    text = {
        "schema": 1,
        "seed": seed,
        "world": list(world),
        "actors": list(actors),
        "weather": weather or {},
        "materials": {"white": grey(1.0), "half": grey(0.5), "dark": grey(0.1), **(materials or {})},
        "sensors": [
            {"id": "front", "model": model, "mode": mode, "mount": mount or {}, "physics": physics or {}},
            *others,
        ],
        "emitters": list(emitters),
    }
    loaded = scenario_of(folder / "scene.yaml", text)
    world_now = scene.build(loaded)
    return build_measure(loaded, world_now, raycast.Caster(world_now), "front")


def plan(
    azimuth_deg: Sequence[float] | Floats = (0.0,),
    *,
    sweep: int = 0,
    start_s: float = 0.0,
    fire_s: Floats | float = 0.0,
    max_echoes: int = 8,
    elevation_deg: float = 0.0,
) -> ScanPlan:
    """A sweep in these directions."""
    azimuth = np.radians(np.asarray(azimuth_deg, dtype=np.float64))
    n = len(azimuth)
    return ScanPlan(
        epoch=0,
        sweep=sweep,
        start_ns=round(1e9 * start_s),
        azimuth_rad=azimuth,
        elevation_rad=np.full(n, np.radians(elevation_deg)),
        fire_offset_s=np.broadcast_to(np.asarray(fire_s, dtype=np.float64), (n,)).copy(),
        max_echoes=max_echoes,
    )


QUIET = {"noise": False, "floor_reflectance": "off", "range_noise_mm": 0.0}
"No random numbers, no fog correction."
