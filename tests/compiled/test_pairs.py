"""Every step with two forms stands in the table of docs/compiled.md, and one function chooses between them."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pytest

from emulator.compiled import pair, switch
from tests.benchmarks import pairs

ROOT = Path(__file__).resolve().parents[2]
BEGIN, END = "<!-- pairs: python -m tests.benchmarks.pairs -->", "<!-- end of pairs -->"
CHOOSERS = {
    "emulator/compiled/build.py": "compiles them",
    "emulator/compiled/pair.py": "chooses",
    "emulator/compiled/switch.py": "loads",
    "emulator/measuring/worker.py": "loads them before a process is ready",
    "emulator/sensing/rays.py": "orders rays, for packets alone",
}
"Who asks for loops, and why."


def told() -> list[tuple[str, ...]]:
    """Cells of the page's table."""
    text = (ROOT / "docs" / "compiled.md").read_text(encoding="utf-8")
    lines = text.partition(BEGIN)[2].partition(END)[0].strip().splitlines()
    return [tuple(cell.strip() for cell in line.strip("|").split("|")) for line in lines]


def test_the_page_has_the_steps_that_the_code_has_with_their_lines() -> None:
    at = pairs.loops_at()
    code = [pairs.row(name, one, at) for name, one in pairs.pairs().items()]
    assert told()[0][:3] == pairs.HEAD
    assert [cells[:3] for cells in told()[2:]] == code, "python -m tests.benchmarks.pairs prints them"


def test_every_loop_belongs_to_one_step() -> None:
    named = [name for one in pairs.pairs().values() for name in one.names]
    assert sorted(named) == sorted(pairs.loops_at())


def test_nobody_else_asks_for_loops() -> None:
    asking = set()
    for path in ROOT.glob("emulator/**/*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
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


def test_both_forms_of_every_step_are_taken() -> None:
    """A sweep of a hazy street by loops takes the loops of the steps that it has."""
    pytest.importorskip("numba")
    from tests.compiled.both import both

    taken = {name: one for name, one in pairs.pairs().items() if name == "sensing.rays._repeated"}
    assert taken
    one = taken["sensing.rays._repeated"]
    from emulator.sensing.rays import _repeated

    arrays, loops = both(lambda: _repeated(np.arange(6.0).reshape(2, 3), np.arange(2.0), 3))
    assert np.array_equal(arrays[0], loops[0])
    assert one.on
    with switch.switched(False):
        assert np.array_equal(_repeated(np.ones((1, 3)), np.ones(1), 2)[0], np.ones((3, 2)))
