"""Every step with two forms stands in the table of docs/compiled.md, and one function chooses between them."""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from emulator.compiled import pair, switch
from emulator.scenario import scenario
from tests.benchmarks import bench_scan, pairs

ROOT = Path(__file__).resolve().parents[2]
BEGIN, END = "<!-- pairs: python -m tests.benchmarks.pairs -->", "<!-- end of pairs -->"
CHOOSERS = {
    "emulator/campaigns/preloaded.py": "loads them before processes are forked",
    "emulator/compiled/build.py": "compiles them",
    "emulator/compiled/pair.py": "chooses",
    "emulator/compiled/switch.py": "loads",
    "emulator/measuring/worker.py": "loads them before a process is ready",
    "emulator/sensing/rays.py": "orders rays, for packets alone",
    "emulator/studies/accuracy_targets.py": "compares the two forms where both can run",
}
"Who asks for loops, and why."


def reported() -> list[tuple[str, ...]]:
    """Cells of the page's table."""
    text = (ROOT / "docs" / "compiled.md").read_text(encoding="utf-8")
    lines = text.partition(BEGIN)[2].partition(END)[0].strip().splitlines()
    return [tuple(cell.strip() for cell in line.strip("|").split("|")) for line in lines]


def test_the_page_has_the_steps_that_the_code_has_with_their_lines() -> None:
    at = pairs.loops_at()
    code = [pairs.row(name, one, at) for name, one in pairs.pairs().items()]
    assert reported()[0][:3] == pairs.HEAD
    assert [cells[:3] for cells in reported()[2:]] == code, "python -m tests.benchmarks.pairs prints them"


def test_what_saves_less_than_3_percent_in_every_scene_has_one_form_only() -> None:
    for step, _, _, *saved in reported()[2:]:
        assert len(saved) == 10
        assert max(float(one) for one in saved if one != "-") >= pairs.LEAST_SAVED, step


def test_every_loop_belongs_to_one_step() -> None:
    named = [name for one in pairs.pairs().values() for name in one.names]
    assert sorted(named) == sorted(pairs.loops_at())


def test_nobody_else_asks_for_loops() -> None:
    asking = set()
    for path in ROOT.glob("emulator/**/*.py"):
        source = path.read_text(encoding="utf-8")
        for node in ast.walk(ast.parse(source)) if "kernels" in source else ():
            if "kernels" in (getattr(node, "id", ""), getattr(node, "attr", "")):
                asking.add(path.relative_to(ROOT).as_posix())
    assert asking == set(CHOOSERS) - {"emulator/compiled/switch.py"}


def test_a_step_chooses_and_can_be_left_out_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    @pair.by_loops(lambda loops, value: pair.OTHERWISE if value < 0 else f"{loops} {value}", "none")
    def step(value: int) -> str:
        return f"arrays {value}"

    monkeypatch.setattr(pair, "kernels", lambda: "loops")
    assert (step(1), step(-1)) == ("loops 1", "arrays -1")
    assert pair.array_form(step)(1) == "arrays 1"
    step.pair.on = False  # type: ignore[attr-defined]
    assert step(1) == "arrays 1"
    step.pair.on = True  # type: ignore[attr-defined]
    monkeypatch.setattr(pair, "kernels", lambda: None)
    assert step(1) == "arrays 1"


def test_sweeps_of_a_street_take_the_loops_of_every_step(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("numba")
    taken: Counter[str] = Counter()

    def counted(name: str, loop: Callable[..., Any]) -> Callable[..., Any]:
        def called(*given: Any, **words: Any) -> Any:
            made = loop(*given, **words)
            taken[name] += made is not pair.OTHERWISE
            return made

        return called

    known = pairs.pairs()
    for name, one in known.items():
        monkeypatch.setattr(one, "loop", counted(name, one.loop))
    bench_scan.hills(tmp_path / "hills.obj", 20)
    plan = bench_scan.sweep(0.5)
    with switch.switched(True):
        fog = {"fog": bench_scan.RAIN_AND_FOG["fog"]}
        for weather, resting in ((bench_scan.RAIN_AND_FOG, False), ({}, True), (fog, True)):
            measure = bench_scan.of(bench_scan.street(tmp_path, weather, resting))[0]
            for number in range(3):
                measure(bench_scan.at(plan, number))
        of_hedges = bench_scan.of(bench_scan.street(tmp_path, {}, False, pairs.HEDGES))[0]
        of_hedges(bench_scan.at(plan, 0))
        bench_scan.of(scenario.load("street"))[0](bench_scan.at(plan, 0))
        bench_scan.of(scenario.load("velodyne_street"))[0](pairs.layers())
    assert taken.keys() == known.keys()
