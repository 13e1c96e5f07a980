"""The steps of a sweep that have two forms, and what the loops of each save: the table of docs/compiled.md.

    python -m tests.benchmarks.pairs [REPEATS]

Without REPEATS the table without figures. With them: CPU time that a sweep of 361 beams of 61 sub-beams takes longer
with the loops of that step alone left out, in per cent of what it takes then; medians over pairs of sweeps, each the
least of two, one with and one without in turn.

Lines: of the function by arrays, and of the loops with the function that calls them; without what either calls.
"""

# ruff: noqa: E402
from __future__ import annotations

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import ast
import importlib
import inspect
import statistics
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from emulator.compiled.pair import Pair
from emulator.scenario import scenario
from protocols.scan import ScanPlan
from tests.benchmarks import bench_layers, bench_scan

ROOT = Path(__file__).resolve().parents[2]
BUILT = "casting.embree.structure"
"Left out of what is built, not of a sweep."
LEAST_SAVED = 3.0
"[%] What saves less in every scene has one form only."
SNOW: dict[str, Any] = {"snow": {"rate_mm_h": 5.0, "kind": "dry"}}
HEDGES: dict[str, Any] = {
    "materials": {"privet": {"foliage": {"leaf_area_density_m2_m3": 2.5, "leaf_reflectance": 0.45}}},
    "world": [{"box": {"size_m": [60.0, 0.8, 1.6]}, "at_m": [30.0, y, 0.0], "material": "privet"} for y in (6.5, -6.5)],
}
ONE_RAY = "VLS-128, one ray"
HEAD = ("step", "numpy arrays: module, lines", "loops: module, lines")


def pairs() -> dict[str, Pair]:
    """All of them by name, as `physics.timing.edges`, in the order of modules and lines."""
    found: dict[str, Pair] = {}
    for path in sorted(ROOT.glob("emulator/**/*.py")):
        if "@by_loops(" not in path.read_text(encoding="utf-8"):
            continue
        module = importlib.import_module(".".join(path.relative_to(ROOT).with_suffix("").parts))
        for one in _pairs_of(module, module.__name__):
            found.setdefault(one.step.removeprefix("emulator."), one)
    return found


def _pairs_of(holder: Any, module: str) -> Iterator[Pair]:
    for value in vars(holder).values():
        if inspect.isclass(value) and value.__module__ == module:
            yield from _pairs_of(value, module)
        elif isinstance(pair := getattr(value, "pair", None), Pair) and pair.array.__module__ == module:
            yield pair


def loops_at() -> dict[str, tuple[str, int]]:
    """Name in `compiled.loops` -> the module that it is from, and its lines; 0 for what is no function or class."""
    compiled = ROOT / "emulator" / "compiled"
    found = {}
    for node in ast.parse((compiled / "loops.py").read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ImportFrom) and node.module is not None:
            name = node.module.rpartition(".")[2]
            tree = ast.parse((compiled / f"{name}.py").read_text(encoding="utf-8"))
            lines = {one.name: _lines(one) for one in tree.body if isinstance(one, ast.FunctionDef | ast.ClassDef)}
            found |= {alias.name: (name, lines.get(alias.name, 0)) for alias in node.names}
    return found


def _lines(node: ast.FunctionDef | ast.ClassDef) -> int:
    assert node.end_lineno is not None
    return node.end_lineno - node.lineno + 1


def _lines_of(function: Any) -> int:
    """As `_lines`: decorators do not count."""
    source, first = inspect.getsourcelines(function)
    head = next(number for number, line in enumerate(source) if line.lstrip().startswith("def "))
    assert first > 0
    return len(source) - head


def row(name: str, pair: Pair, at: Mapping[str, tuple[str, int]]) -> tuple[str, str, str]:
    """The columns of `HEAD`."""
    module, _, step = name.rpartition(f".{pair.array.__qualname__}")
    where = " ".join(dict.fromkeys(at[one][0] for one in pair.names))
    lines = sum(at[one][1] for one in pair.names) + _lines_of(pair.loop)
    return f"`{step or pair.array.__qualname__}`", f"{module}, {_lines_of(pair.array)}", f"{where}, {lines}"


def saved(pair: Pair, measures: Sequence[Any], repeats: int, plan: ScanPlan) -> float:
    """By the loops of a step. `measures`: with all loops, and with those of the step left out. [%]"""
    took: tuple[list[float], list[float]] = [], []
    for number in range(repeats + 2):
        times: tuple[list[float], list[float]] = ([], [])
        for _ in range(2):
            for which, on in enumerate((True, False)):
                pair.on = on
                begin = time.process_time()
                measures[which](bench_scan.at(plan, 2 * number))
                times[which].append(time.process_time() - begin)
        pair.on = True
        if number > 1:
            took[0].append(min(times[0]))
            took[1].append(min(times[1]))
    more = statistics.median(off - on for on, off in zip(*took, strict=True))
    return 100.0 * more / statistics.median(took[1])


def scenes(folder: Path) -> dict[str, Any]:
    """Column -> scenario."""
    bench_scan.hills(folder / "hills.obj", 171)
    found = {
        f"{name}, {'at rest' if resting else 'driving'}": bench_scan.street(folder, weather, resting)
        for name, weather in (("clear", {}), ("fog, rain, sun", bench_scan.RAIN_AND_FOG))
        for resting in (True, False)
    }
    found["snow, at rest"] = bench_scan.street(folder, SNOW, True)
    hedges = bench_scan.street(folder, {}, False, HEDGES)
    found |= {"town, driving": scenario.load("street"), "hedges, driving": hedges}
    found["VLP-16, driving"] = scenario.load("velodyne_street")
    found["VLP-16, fog, rain, sun"] = bench_layers.street("velodyne-vlp-16", bench_layers.WETTEST)
    return {**found, ONE_RAY: bench_layers.street("velodyne-vls-128", bench_layers.ONE_RAY)}


def layers() -> ScanPlan:
    """5 ms of sixteen layers, 1536 beams."""
    azimuth, elevation = np.radians(np.arange(96) * 0.2 - 10.0), np.radians(np.arange(-15.0, 17.0, 2.0))
    fired = np.arange(1536, dtype=np.float64) * 3.4e-6
    return ScanPlan(
        0, 0, 0, azimuth.repeat(16), np.tile(elevation, 96), fired, 0.0053, max_range_m=131.0, wants_intensity=True
    )


def swept(column: str) -> ScanPlan:
    """The sweep that a scene is measured with; with 128 layers a slice that has few edges in it."""
    if column == ONE_RAY:
        return bench_layers.plans_of("velodyne-vls-128", 4)[-1]
    return layers() if column.startswith("VLP") else bench_scan.sweep(0.5)


def main(repeats: int) -> None:
    """Print the table."""
    known, at = pairs(), loops_at()
    with tempfile.TemporaryDirectory() as name:
        found = scenes(Path(name)) if repeats else {}
        sys.stdout.write(f"| {' | '.join((*HEAD, *found))} |\n|{'---|' * (len(HEAD) + len(found))}\n")
        whole = [bench_scan.of(one)[0] for one in found.values()]
        for step, pair in known.items():
            without = whole
            if step == BUILT:
                pair.on = False
                without = [bench_scan.of(one)[0] for one in found.values()]
                pair.on = True
            figures = [
                f"{saved(pair, each, repeats, swept(column)):.1f}"
                for column, *each in zip(found, whole, without, strict=True)
            ]
            sys.stdout.write(f"| {' | '.join((*row(step, pair, at), *figures))} |\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 0)
