"""Time and memory of scenes from 98 to 1e7 triangles, by scenario file, mesh reader and caster; prints, never fails.

    python -m tests.benchmarks.bench_triangles [--most 1e7]

Each size runs in a process of its own, so that its memory is its own. Section 6.2 of the physics specification measured
embreex alone on two cores at 2.5 GHz: 1e6 triangles 2.9 s and 287 MB, 1e7 55 s and 1878 MB, 1.9 and 0.81 million random
rays a second. A smaller size runs in `tests/extreme/test_coordinates.py`.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from emulator.casting import raycast
from emulator.scenario import scenario
from emulator.world import scene
from tests.extreme.test_coordinates import uneven_wall, write_ply

SIZES = (98, 10_000, 100_000, 1_000_000, 10_000_000)


def one(count: int) -> None:
    """Build and cast one size; a line of JSON."""
    points, faces = uneven_wall(round(np.sqrt(count / 2)))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_ply(folder / "wall.ply", points, faces)
        text = {"schema": 1, "world": [{"mesh": "wall.ply", "material": "asphalt"}]}
        (folder / "scene.yaml").write_text(json.dumps(text), encoding="utf-8")
        del points, faces
        begin = time.perf_counter()
        world = scene.build(scenario.load(str(folder / "scene.yaml")))
        read = time.perf_counter()
        caster = raycast.Caster(world)
        built = time.perf_counter()
    rng = np.random.default_rng(1)
    direction = np.column_stack([np.ones(200_000), rng.uniform(-0.6, 0.6, (200_000, 2))])
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    caster.first_hits(np.zeros(3), direction[:1000], 0.0)
    start = time.perf_counter()
    hits = caster.first_hits(np.zeros(3), direction, 0.0)
    cast = time.perf_counter() - start
    memory_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    figures = [len(world.bodies[0].faces), read - begin, built - read, memory_mb, 0.2 / cast]
    print(json.dumps([*figures, float(np.isnan(hits.range_m).mean())]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--most", type=float, default=1e7, help="largest number of triangles")
    parser.add_argument("--one", type=int, help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.one:
        one(chosen.one)
        return
    print(
        f"{'triangles':>10s} {'read s':>8s} {'build s':>8s} {'memory MB':>10s} {'million rays/s':>15s} {'missed':>7s}"
    )
    for size in SIZES:
        if size <= chosen.most:
            command = [sys.executable, "-m", "tests.benchmarks.bench_triangles", "--one", str(size)]
            answer = subprocess.run(command, capture_output=True, text=True, check=False)
            if answer.returncode:
                print(f"{size:10d} failed: {answer.stderr.strip().splitlines()[-1:]}")
                continue
            count, read, build, memory, rate, missed = json.loads(answer.stdout)
            print(f"{count:10d} {read:8.2f} {build:8.2f} {memory:10.0f} {rate:15.2f} {missed:7.1%}")


if __name__ == "__main__":
    main()
