"""What one scan costs, part by part, beside the raw cast of the same rays. Prints; never fails.

python -m tests.benchmarks.bench_scan [REPEATS] [--far]

Medians of CPU time, one thread, and the least of the whole: what others do on the machine makes the median longer, by
half where they are busy. By compiled loops where numba is installed, by arrays without it and with LIDAREMU_COMPILED=0.
`--far` prints instead what actors cost that are out of reach, 10 to 10 000 of them.
"""

# ruff: noqa: E402
from __future__ import annotations

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import dataclasses
import json
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from ruamel.yaml import YAML

from emulator.casting import raycast
from emulator.compiled import switch
from emulator.scenario import scenario
from emulator.sensing.daylight import daylight
from emulator.sensing.measure import Measure
from emulator.sensing.measure import build as build_measure
from emulator.world import scene
from emulator.world.scene import Scene
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


def median_ms(work: Callable[[], object], repeats: int) -> float:
    """Median CPU time of several runs after one to warm up. [ms]"""
    return statistics.median(times_ms(work, repeats))


def times_ms(work: Callable[[], object], repeats: int) -> list[float]:
    """CPU time of each."""
    work()
    times = []
    for _ in range(repeats):
        begin = time.process_time()
        work()
        times.append(1e3 * (time.process_time() - begin))
    return times


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
    rays = view.rays
    cast = median_ms(lambda: caster.first_hits(rays.origin_m, rays.direction, rays.t_s), repeats)
    raw = median_ms(raw_cast(measure._scene, rays.origin_m, rays.direction), repeats)
    count = iter(range(1_000_000))
    seen = median_ms(lambda: measure.view(at(plan, next(count))), repeats)
    light = daylight(view.air.sun, rays, view.seen, view.surfaces, caster, measure.model)
    soft = measure._soft.everywhere(view.air)
    # each time as sub-echoes that were not seen before
    receive = median_ms(lambda: measure._receiver.receive(plan, dataclasses.replace(view.echoes), soft, light), repeats)
    coded = median_ms(encoding(measure(plan)), 5 * repeats)
    sweeps = times_ms(lambda: measure(at(plan, next(count))), repeats)
    whole = statistics.median(sweeps) + coded
    columns = (raw, cast, seen, receive, coded, whole, min(sweeps) + coded, whole / raw, 1e3 * whole / len(plan))
    sys.stdout.write(f"{name:42s} {len(rays.beam):7d}" + "".join(f"{value:9.2f}" for value in columns) + "\n")


def at(plan: ScanPlan, number: int) -> ScanPlan:
    """The same sweep at its own time, 75 a second."""
    return dataclasses.replace(plan, sweep=number, start_ns=plan.start_ns + round(number * 1e9 / 75.0))


def of(loaded: scenario.Scenario, **changes: Any) -> tuple[Measure, raycast.Caster]:
    """Measuring function of the first sensor that sees beams, with other physics."""
    config = loaded.sensors[0]
    physics = config.physics.model_copy(update=changes)
    loaded = loaded.model_copy(update={"sensors": (config.model_copy(update={"physics": physics}),)})
    world = scene.build(loaded)
    caster = raycast.Caster(world)
    return build_measure(loaded, world, caster, config.id), caster


def encoding(scan: Scan) -> Callable[[], object]:
    """The scan as a telegram of an LMS291: 732 bytes in cm, checksum and all."""
    plain = Format(MEASURING_MODES[0], 0, False, 9000.0)
    range_m, intensity = scan.range_m[:, 0], scan.intensity[:, 0]
    return lambda: reply(encode(Output(ALL), Measured(range_m, intensity, scan.flags), plain, None), 0x10)


def main(repeats: int) -> None:
    used, detail = switch.why()
    sys.stdout.write(f"by {'compiled loops' if used else 'arrays'} ({detail})\n")
    sys.stdout.write("CPU times in ms, medians, one thread; us/beam of the whole; at rest: what rests is kept\n")
    names = ("raw", "cast", "seen", "receive", "encode", "whole", "least", "/raw", "us/beam")
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
        drive = [{"id": "ego", "motion": {"velocity_m_s": [0.5, 0.0, 0.0]}}]
        for name, weather in (("clear", {}), ("fog, rain, sun", RAIN_AND_FOG)):
            for count, actors in ((1, []), (61, []), (61, drive)):
                physics = {"rule": "axis" if count == 1 else "spiral", "sub_beams": count}
                mount = {"actor": "ego"} if actors else {}
                measure = build(Path(folder), world, actors=actors, weather=weather, model="sick-lms291-s05",
                                physics=physics, mount=mount)  # fmt: skip
                caster = measure._caster
                assert isinstance(caster, raycast.Caster)
                reported = f"1e5 triangles, {name}, {count}, {'driving' if actors else 'at rest'}"
                parts(reported, measure, caster, plan, repeats)
        hills(mesh, 171)
        for name, weather in (("clear", {}), ("fog, rain, sun", RAIN_AND_FOG)):
            for resting in (True, False):
                reported = f"street of 1e5, {name}, 61, {'at rest' if resting else 'driving'}"
                parts(reported, *of(street(Path(folder), weather, resting)), plan, repeats)
    turn = sweep(1.0)
    measure, _ = of(scenario.load("flat_wall"))
    one = median_ms(lambda: measure(turn), repeats)
    sys.stdout.write(f"LMS291, 181 beams at 75 Hz: {one:.2f} ms a scan, {1e3 / 75.0 / one:.1f} sensors a core\n")
    measure, _ = of(scenario.load("flat_wall"), rule="axis")
    one = median_ms(lambda: measure(turn), repeats)
    sys.stdout.write(f"the same, one ray a beam:   {one:.2f} ms a scan, {1e3 / 75.0 / one:.1f} sensors a core\n")


def street(
    folder: Path, weather: dict[str, Any], resting: bool, more: dict[str, Any] | None = None
) -> scenario.Scenario:
    """The scenario `street` on rolling ground, 1e5 triangles in all, as it is or from where its car begins.

    `more`: further materials, and things that stand in it.
    """
    loaded = scenario.load("street")
    text = json.loads(json.dumps(YAML(typ="safe").load(scenario.dump(loaded))))
    text["world"].append({"mesh": str(folder / "hills.obj"), "material": "asphalt", "at_m": [20.0, 0.0, -4.2]})
    text["weather"] = weather
    if more is not None:
        text["materials"] = {**(text.get("materials") or {}), **more["materials"]}
        text["world"] += more["world"]
    if resting:
        pose = scene.build(loaded).sensor_pose(loaded.sensors[0].mount, np.zeros(1))
        text["sensors"][0]["mount"] = {"at_m": pose.position_m[0].tolist()}
    return scenario.loads(json.dumps(text), folder / "street.yaml")


def far_actors(repeats: int) -> None:
    """Scans of a wall before which nothing moves, and of actors 2 to 3 km away."""
    sys.stdout.write("LMS291, 361 beams of 61 sub-beams at rest; CPU ms a scan, medians\n")
    sys.stdout.write(f"{'far actors':>10s} {'moving':>7s} {'looping':>8s} {'still':>7s} {'moving, in the sun':>19s}\n")
    for count in (0, 10, 100, 1000, 9_990):
        row = []
        for kind in ("moving", "looping", "still", "sun"):
            with tempfile.TemporaryDirectory() as folder:
                measure = build(Path(folder), [plate(30.0, "half")], actors=[far_one(k, kind) for k in range(count)],
                                weather={"sun": {"elevation_deg": 30.0}} if kind == "sun" else {},
                                model="sick-lms291-s05", physics={"leave_out": {"closed_form": "never"}})  # fmt: skip
            number = iter(range(1_000_000))
            row.append(median_ms(lambda m=measure, n=number: m(at(sweep(0.5), next(n))), 75 + repeats))
        sys.stdout.write(f"{count:10d} {row[0]:7.2f} {row[1]:8.2f} {row[2]:7.2f} {row[3]:19.2f}\n")


def far_one(k: int, kind: str) -> dict[str, Any]:
    """A box somewhere beyond reach."""
    place = [2000.0 + k % 100 * 10.0, k // 100 * 10.0 - 500.0, -1.0]
    motion: dict[str, Any] = {"at_m": place, "velocity_m_s": [0.0, 0.0 if kind == "still" else 5.0, 0.0]}
    if kind == "looping":
        there = [place[0], place[1] + 30.0, -1.0]
        turns = [{"t_s": 0.1 * (k % 7), "at_m": place}, {"t_s": 4.0, "at_m": there}, {"t_s": 8.0, "at_m": place}]
        motion = {"loop": True, "waypoints": turns}
    return {"id": f"far{k}", "shape": {"box": {"size_m": [4.0, 2.0, 1.5]}}, "material": "half", "motion": motion}


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
    numbers = [int(word) for word in sys.argv[1:] if word.isdigit()]
    (far_actors if "--far" in sys.argv else main)(numbers[0] if numbers else 10)
