"""Rays a beam and time of the standard scene with one ray for plain beams on and off, and what far actors cost.

python -m tests.benchmarks.bench_needs. Prints; never fails.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

import scenarios
from emulator import needs, raycast, scenario, scene, sensing
from emulator.sensing import Measure
from emulator.spec import load_spec

HOME = Path(scenarios.__file__).parent / "standard.yaml"
"Where its meshes are looked for from; the file itself is not needed."
CAR = {"body": "car_paint_silver", "glass": "windscreen", "bumper": "bumper_plastic", "tyre": "tyre_rubber",
       "plate": "number_plate"}  # fmt: skip
PERSON = {"skin": "skin", "top": "nylon_blue", "trousers": "dark_clothing", "shoes": "tyre_rubber"}


def standard(model: str, physics: dict[str, Any], far: int = 0) -> Measure:
    """Road, 10 cars, 5 pedestrians, a clear day; `far` more moving boxes beyond 2 km."""
    rng = np.random.default_rng(1)
    actors: list[dict[str, Any]] = []
    for k in range(15):
        kind = "car" if k < 10 else "pedestrian"
        at = [float(rng.uniform(8.0, 60.0)), float(rng.uniform(-15.0, 15.0)), 0.0]
        motion = {"at_m": at, "yaw_deg": float(rng.uniform(0.0, 360.0)), "velocity_m_s": [5.0 * (k % 2), 0.0, 0.0]}
        shape = {"mesh": f"meshes/{kind}.glb"}
        actors.append({"id": f"{kind}{k}", "class": kind, "shape": shape, "materials": CAR if k < 10 else PERSON,
                       "motion": motion})  # fmt: skip
    for k in range(far):
        at = [2000.0 + k % 100 * 10.0, float(k // 100 * 10.0), 0.0]
        motion = {"at_m": at, "velocity_m_s": [0.0, 5.0, 0.0]}
        actors.append({"id": f"far{k}", "shape": {"box": {"size_m": [4.0, 2.0, 1.5]}}, "material": "asphalt",
                       "motion": motion})  # fmt: skip
    sensor = {"id": "front", "model": model, "mount": {"at_m": [0.0, 0.0, 0.6]}, "physics": physics}
    text = {"schema": 1, "world": [{"plane": {"size_m": [300, 300]}, "material": "asphalt"}], "actors": actors,
            "weather": {"sun": {"azimuth_deg": 120.0, "elevation_deg": 45.0}}, "sensors": [sensor]}  # fmt: skip
    loaded = scenario.loads(json.dumps(text), HOME)
    world = scene.build(loaded)
    return sensing.build(loaded, world, raycast.Caster(world), "front")


def main() -> None:
    for model in ("sick-ld-lrs1000", "sick-lms291-s05"):
        plan = needs.usual_plan(load_spec(model))
        for choice in ("never", "auto", "always"):
            for radii in (2.63, 1.5) if choice == "always" else (2.63,):
                measure = standard(model, {"leave_out": {"closed_form": choice}, "plain_radii": radii})
                rays, took_ms = needs.cost(measure, plan)
                sys.stdout.write(
                    f"{model:16s} {choice:7s} k {radii:4.2f}: {rays:6.2f} rays a beam, {took_ms:7.2f} ms\n"
                )
    plan = needs.usual_plan(load_spec("sick-lms291-s05"))
    for far in (0, 10, 100, 1000, 9_900):
        rays, took_ms = needs.cost(standard("sick-lms291-s05", {}, far), plan)
        sys.stdout.write(f"{far:6d} far actors: {took_ms:7.2f} ms a sweep\n")


if __name__ == "__main__":
    main()
