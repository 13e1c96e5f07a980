"""What compiled loops cost at the start, and how alike they measure: the figures of docs/compiled.md. Prints only.

python -m tests.benchmarks.bench_compiled [SCENES]

First the start of a process that measures: without them, where they are compiled for the first time, with them. Then
readings of random scenes, at rest and driving, and of 400 sweeps of `street`, against those by arrays.
"""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
import tempfile

import numpy as np

from emulator import plans, raycast, scenario, scene, sensing
from emulator.compiled import SWITCH
from emulator.physics_options import LeaveOut
from protocols.scan import Scan
from tests.compiled.both import both
from tests.compiled.test_same import random_sweeps

START = """
import pathlib, re, time
begin = time.perf_counter()
from emulator import raycast, scenario, scene, sensing
loaded = scenario.load("flat_wall")
world = scene.build(loaded)
sensing.build(loaded, world, raycast.Caster(world), "front")
kilobytes = re.search(r"VmHWM:\\s+(\\d+)", pathlib.Path("/proc/self/status").read_text()).group(1)
print(time.perf_counter() - begin, int(kilobytes) / 1024)
"""


def start(name: str, **environment: str) -> None:
    env = {**os.environ, **environment}
    told = subprocess.run([sys.executable, "-c", START], env=env, capture_output=True, text=True, check=True).stdout
    seconds, megabytes = map(float, told.split())
    sys.stdout.write(f"start, {name:28s} {seconds:6.2f} s {megabytes:6.0f} MB\n")


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
    measure = sensing.build(loaded, world, raycast.Caster(world), "front")
    times = (plan.start_ns + k * 26_666_667 for k in range(sweeps))
    return [measure(dataclasses.replace(plan, sweep=k, start_ns=time)) for k, time in enumerate(times)]


def main(scenes: int) -> None:
    start("by arrays", **{SWITCH: "0"})
    with tempfile.TemporaryDirectory() as folder:
        start("loops, the first time", **{SWITCH: "1", "NUMBA_CACHE_DIR": folder})
    start("loops", **{SWITCH: "1"})
    pairs: list[tuple[Scan, Scan]] = []
    for seed in range(scenes):
        for drives in (False, True):
            for options in ({"leave_out": LeaveOut(closed_form="auto")}, {"full": True}):
                pairs += zip(*both(lambda: random_sweeps(seed, drives, **options)), strict=True)  # noqa: B023
    alike("random scenes", pairs)
    alike("street, 400 sweeps", list(zip(*both(lambda: street(400)), strict=True)))


if __name__ == "__main__":
    main(max(1, int(sys.argv[1])) if len(sys.argv) > 1 else 500)
