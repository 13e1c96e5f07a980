"""What one scan costs, part by part, beside the raw cast of the same rays. Prints; never fails.

python -m tests.benchmarks.bench_scan [REPEATS]
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from emulator import raycast, scenario, scene, sensing
from emulator.scene import Scene
from emulator.sensing.daylight import daylight
from emulator.sensing.measure import Measure
from protocols.lms2xx.outputs import ALL, Format, Measured, Output, encode
from protocols.lms2xx.telegrams import reply
from protocols.lms2xx.values import MEASURING_MODES
from protocols.scan import Scan, ScanPlan
from tests.sensing.rig import build, plate

RAIN_AND_FOG: dict[str, Any] = {
    "fog": {"visibility_m": 400.0},
    "rain": {"rate_mm_h": 20.0, "echoes": "drops"},
    "sun": {"azimuth_deg": 40.0, "elevation_deg": 30.0},
}


def best_ms(work: Callable[[], object], repeats: int) -> float:
    """Least of several times, which is the least disturbed by others on the machine. [ms]"""
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        work()
        times.append(time.perf_counter() - begin)
    return 1e3 * min(times)


def sweep(step_deg: float, sweep_number: int = 0) -> ScanPlan:
    """180 degrees of an LMS291, interlaced turns of the mirror."""
    n = round(180.0 / step_deg) + 1
    index = np.arange(n)
    turns = round(1.0 / step_deg)
    fire = (index % turns) / 75.0 + index * step_deg / 360.0 / 75.0
    return ScanPlan(
        0, sweep_number, 0, np.radians(index * step_deg - 90.0), np.zeros(n), fire, turns / 75.0,
        max_range_m=82.0, wants_intensity=True,
    )  # fmt: skip


def raw_cast(world: Scene, origin: Any, direction: Any) -> Callable[[], object]:
    """embreex alone: all bodies where they are at time 0 in one structure, rays as it wants them."""
    vertices, faces, count = [], [], 0
    for body in world.bodies:
        pose = body.motion.pose(np.zeros(1))
        vertices.append(body.vertices @ pose.rotation[0].T + pose.position_m[0])
        faces.append(body.faces + count)
        count += len(body.vertices)
    structure = EmbreeScene()
    TriangleMesh(structure, np.concatenate(vertices).astype(np.float32), np.concatenate(faces).astype(np.int32))
    start, along = origin.astype(np.float32), direction.astype(np.float32)
    return lambda: structure.run(start, along, output=True)


def parts(name: str, measure: Measure, caster: raycast.Caster, plan: ScanPlan, repeats: int) -> None:
    """Print one line of costs."""
    view = measure.view(plan)
    rays = measure._rays(plan, measure._pose(1e-9 * plan.start_ns + plan.fire_offset_s), plan.fire_offset_s)
    cast = best_ms(lambda: caster.first_hits(rays.origin_m, rays.direction, rays.t_s), repeats)
    raw = best_ms(raw_cast(measure._scene, rays.origin_m, rays.direction), repeats)
    seen = best_ms(lambda: measure.view(plan), repeats)
    light = daylight(view.air.sun, rays, view.seen, view.surfaces, caster, measure.model)
    soft = measure._soft.everywhere(view.air)
    receive = best_ms(lambda: measure._receiver.receive(plan, view.echoes, soft, light), repeats)
    coded = best_ms(encoding(measure(plan)), 5 * repeats)
    whole = best_ms(lambda: measure(plan), repeats) + coded
    allowed = 3.0 * raw + 0.3
    columns = (raw, cast, seen - cast, receive, coded, whole, whole / raw, allowed, 1e3 * whole / len(plan))
    sys.stdout.write(f"{name:42s} {len(rays.beam):7d}" + "".join(f"{value:9.2f}" for value in columns) + "\n")


def of(loaded: scenario.Scenario, **changes: Any) -> tuple[Measure, raycast.Caster]:
    """Measuring function of the first sensor that sees beams, with other physics."""
    config = loaded.sensors[0]
    physics = config.physics.model_copy(update=changes)
    loaded = loaded.model_copy(update={"sensors": (config.model_copy(update={"physics": physics}),)})
    world = scene.build(loaded)
    caster = raycast.Caster(world)
    return sensing.build(loaded, world, caster, config.id), caster


def encoding(scan: Scan) -> Callable[[], object]:
    """The scan as a telegram of an LMS291: 732 bytes in cm, checksum and all."""
    plain = Format(MEASURING_MODES[0], 0, False, 9000.0)
    range_m, intensity = scan.range_m[:, 0], scan.intensity[:, 0]
    return lambda: reply(encode(Output(ALL), Measured(range_m, intensity, scan.flags), plain, None), 0x10)


def main(repeats: int) -> None:
    sys.stdout.write("times in ms, the best of several; us/beam of the whole\n")
    names = ("raw", "cast", "paths", "receive", "encode", "whole", "/raw", "3raw+.3", "us/beam")
    head = f"{'scene, 361 beams':42s} {'rays':>7s}"
    sys.stdout.write(head + "".join(f"{name:>9s}" for name in names) + "\n")
    plan = sweep(0.5)
    for name in ("flat_wall", "street"):
        loaded = scenario.load(name)
        for rule, count in (("axis", 1), ("spiral", 16), ("spiral", 61)):
            parts(f"{name}, {rule} {count}", *of(loaded, rule=rule, sub_beams=count), plan, repeats)
    with tempfile.TemporaryDirectory() as folder:
        mesh = Path(folder) / "hills.obj"
        hills(mesh, 224)
        world = [plate(60.0, "white"), {"mesh": "hills.obj", "material": "asphalt", "at_m": [0.0, 0.0, -1.0]}]
        for name, weather in (("clear", {}), ("fog, rain, sun", RAIN_AND_FOG)):
            for count in (1, 61):
                physics = {"rule": "axis" if count == 1 else "spiral", "sub_beams": count}
                measure = build(Path(folder), world, weather=weather, model="sick-lms291-s05", physics=physics)
                caster = measure._caster
                assert isinstance(caster, raycast.Caster)
                parts(f"1e5 triangles, {name}, {count} sub-beams", measure, caster, plan, repeats)
    turn = sweep(1.0)
    measure, _ = of(scenario.load("flat_wall"))
    one = best_ms(lambda: measure(turn), repeats)
    sys.stdout.write(f"LMS291, 181 beams at 75 Hz: {one:.2f} ms a scan, {1e3 / 75.0 / one:.1f} sensors a core\n")
    measure, _ = of(scenario.load("flat_wall"), rule="axis")
    one = best_ms(lambda: measure(turn), repeats)
    sys.stdout.write(f"the same, one ray a beam:   {one:.2f} ms a scan, {1e3 / 75.0 / one:.1f} sensors a core\n")


def hills(path: Path, side: int) -> None:
    """A rolling ground of 2 side^2 triangles, 100 m square, from 1 m below to 3 m above the sensor's plane."""
    axis = np.linspace(-50.0, 50.0, side + 1)
    x, y = np.meshgrid(axis, axis, indexing="ij")
    z = 2.0 * np.sin(0.31 * x) * np.cos(0.23 * y) - 2.0 * np.exp(-(x**2 + y**2) / 20.0)
    number = np.arange((side + 1) ** 2).reshape(side + 1, side + 1) + 1
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    lines = [f"v {p:.6f} {q:.6f} {r:.6f}" for p, q, r in zip(x.ravel(), z.ravel(), -y.ravel(), strict=True)]
    lines += [f"f {i} {j} {k}" for i, j, k in faces]
    path.write_text("\n".join(lines), encoding="utf-8")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 10)
