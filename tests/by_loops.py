"""Which tests ask for a compiled loop: the second pass runs those alone, the others would say the same once more.

`LIDAREMU_TESTS_BY_LOOPS=FOLDER`: with `LIDAREMU_COMPILED=0` the names of such tests are written into it, by each
process into a file of its own; with 1 all others are left out. A test that shares a fixture with such a test counts.

Whole scenarios that are judged for what the world shows, and not for how it is computed, have loops in the first pass:
they take two thirds of the time, and `WHOLE` says why nothing is lost.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from types import ModuleType

import pytest

from emulator.compiled import pair, switch

ALIKE = (
    "tests/sensing/error_budget/test_plain.py::test_random_scenes_in_random_weather_are_the_same_full_and_pruned",
    "tests/sensing/error_budget/test_plain.py::test_shipped_scenarios_are_the_same_full_and_pruned",
)
"Not by loops: they are the same by arrays, and tests/compiled/test_same.py holds that loops measure all of it alike."

WHOLE = ("tests/judging", "tests/run_report", "tests/studies", "tests/objects/test_fog_objects.py")
"""By loops in the first pass too. Every step of theirs is judged by arrays in tests/{world,casting,sensing,physics,
extreme}, whole scenarios of each family in tests/{hosts,recording,runtime,injection,faults,scenario}, lists of objects
in the rest of tests/objects; and what these start as a process of its own is by arrays."""

FOLDER = os.environ.get("LIDAREMU_TESTS_BY_LOOPS", "")
BY_ARRAYS = os.environ.get(switch.SWITCH) == "0"
_asked = 0


def pytest_configure() -> None:
    """Count who asks for loops."""
    if not (FOLDER and BY_ARRAYS):
        return
    found = pair.kernels

    def counted() -> ModuleType | None:
        global _asked
        _asked += 1
        return found()

    pair.kernels = counted


@pytest.fixture(scope="module", autouse=True)
def _whole_scenarios_have_loops(request: pytest.FixtureRequest) -> Iterator[None]:
    """Before any fixture of the module runs one."""
    whole = bool(FOLDER) and BY_ARRAYS and request.node.nodeid.startswith(WHOLE)
    with switch.switched(True) if whole else nullcontext():
        yield


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Set-up of shared fixtures included."""
    before = _asked
    made = yield
    if FOLDER and BY_ARRAYS and _asked > before:
        with (Path(FOLDER) / f"{os.getpid()}.txt").open("a", encoding="utf-8") as file:
            file.write("\n".join([item.nodeid, *_shared(item)]) + "\n")
    return made


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Keep those that asked."""
    if not FOLDER or BY_ARRAYS:
        return
    kept = {line for path in Path(FOLDER).glob("*.txt") for line in path.read_text(encoding="utf-8").splitlines()}
    asked = (item for item in items if item.nodeid in kept or kept & _shared(item))
    chosen = [item for item in asked if not item.nodeid.startswith(ALIKE)]
    config.hook.pytest_deselected(items=[item for item in items if item not in chosen])
    items[:] = chosen


def _shared(item: pytest.Item) -> set[str]:
    """Names of the fixtures that it shares with others, with where they are."""
    info = getattr(item, "_fixtureinfo", None)
    defined = [] if info is None else [one for many in info.name2fixturedefs.values() for one in many]
    return {f"{one.baseid}::{one.argname}" for one in defined if one.scope != "function" and one.baseid}
