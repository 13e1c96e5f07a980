"""What compiled loops cost at the start, and how alike they measure: the figures of docs/compiled.md. Prints only.

python -m tests.benchmarks.bench_compiled [SCENES]

First the start of a process that measures: without them, where they are compiled for the first time, with them. Then
the search for the rays of a sweep alone, one by one and in packets; then readings of random scenes, at rest and
driving, and of 400 sweeps of `street`, against those by arrays.
"""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from emulator.casting import raycast
from emulator.compiled.switch import SWITCH
from emulator.judging import plans
from emulator.scenario import scenario
from emulator.sensing.measure import build as build_measure
from emulator.sensors.physics_options import LeaveOut
from emulator.world import scene
from protocols.scan import Scan
from tests.benchmarks import bench_scan
from tests.compiled.both import both
from tests.compiled.test_same import random_sweeps

START = """
import pathlib, re, time
begin = time.perf_counter()
from emulator.casting import raycast; from emulator.scenario import scenario; from emulator.world import scene
from emulator.sensing.measure import build as build_measure
loaded = scenario.load("flat_wall")
world = scene.build(loaded)
build_measure(loaded, world, raycast.Caster(world), "front")
kilobytes = re.search(r"VmHWM:\\s+(\\d+)", pathlib.Path("/proc/self/status").read_text()).group(1)
print(time.perf_counter() - begin, int(kilobytes) / 1024)
"""


def start(name: str, **environment: str) -> None:
    env = {**os.environ, **environment}
    reported = subprocess.run([sys.executable, "-c", START], env=env, capture_output=True, text=True, check=True).stdout
    seconds, megabytes = map(float, reported.split())
    sys.stdout.write(f"start, {name:28s} {seconds:6.2f} s {megabytes:6.0f} MB\n")


def search(repeats: int) -> None:
    """Least CPU time of a driving sweep's rays on what rests of `street` on rolling ground."""
    with tempfile.TemporaryDirectory() as folder:
        bench_scan.hills(Path(folder) / "hills.obj", 171)
        measure, caster = bench_scan.of(bench_scan.street(Path(folder), {}, False))
    plan = bench_scan.sweep(0.5)
    rays = [measure.view(bench_scan.at(plan, number)).rays for number in range(2)][-1]
    raw = bench_scan.raw_cast(measure._scene, rays.origin_m, rays.direction)
    found = {"one by one": min(bench_scan.times_ms(raw, repeats))}
    assert rays.order is not None
    for name, order in (("in packets as they come", np.arange(len(rays.order))), ("in packets by rows", rays.order)):
        origin = (rays.origin_m[order] - caster._groups[0].centre[:, 0]).astype(np.float32, order="C")
        direction, long = rays.direction[order].astype(np.float32, order="C"), np.full(len(order), 1e30, np.float32)
        run = caster._built[0].run
        found[name] = min(bench_scan.times_ms(lambda: run(origin, direction, long.copy()), repeats))  # noqa: B023
    reported = ", ".join(f"{name} {ms:.2f} ms" for name, ms in found.items())
    sys.stdout.write(f"{len(rays.order)} rays: {reported}\n")


def alike(name: str, pairs: list[tuple[Scan, Scan]]) -> None:
    away = [np.abs(np.nan_to_num(one.range_m) - np.nan_to_num(other.range_m)).max(axis=1) for one, other in pairs]
    off = np.concatenate(away)
    near = off <= 1e-7
    most, rest = off.max(initial=0.0), off[near].max(initial=0.0)
    sys.stdout.write(
        f"{name:20s} {len(off):7d} beams: {np.count_nonzero(~near)} off by more than 1e-7 m, {most:.2g} m at the most;"
        f" the others by {rest:.1e} m\n"
    )


def street(sweeps: int) -> list[Scan]:
    loaded = scenario.load("street")
    world, plan = scene.build(loaded), plans.plans_of(loaded)["front"]
    measure = build_measure(loaded, world, raycast.Caster(world), "front")
    times = (plan.start_ns + k * 26_666_667 for k in range(sweeps))
    return [measure(dataclasses.replace(plan, sweep=k, start_ns=time)) for k, time in enumerate(times)]


def main(scenes: int) -> None:
    start("by arrays", **{SWITCH: "0"})
    with tempfile.TemporaryDirectory() as folder:
        start("loops, the first time", **{SWITCH: "1", "NUMBA_CACHE_DIR": folder})
    start("loops", **{SWITCH: "1"})
    search(80)
    pairs: list[tuple[Scan, Scan]] = []
    for seed in range(scenes):
        for drives in (False, True):
            for options in ({"leave_out": LeaveOut(closed_form="auto")}, {"full": True}):
                pairs += zip(*both(lambda: random_sweeps(seed, drives, **options)), strict=True)  # noqa: B023
    alike("random scenes", pairs)
    alike("street, 400 sweeps", list(zip(*both(lambda: street(400)), strict=True)))


if __name__ == "__main__":
    main(max(1, int(sys.argv[1])) if len(sys.argv) > 1 else 500)
