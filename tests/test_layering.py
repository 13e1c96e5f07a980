"""Who may import whom. The rooms stand in `layering`, the rules in docs/architecture.md; this reads the imports."""

from __future__ import annotations

import ast
import sys
from pathlib import Path

import pytest

from tests import layering
from tests.layering import FLOORS, OUTSIDE, ROOT

KNOWN = layering.modules()
FLOOR_OF = {room: number for number, floor in enumerate(FLOORS) for room in floor}

ONLY_IN = {
    "embreex": {"emulator/casting/embree.py", "emulator/casting/deforming.py"},
    "trimesh": {"emulator/world/", "emulator/recording/cloud_files.py"},
    "laspy": {"emulator/recording/cloud_files.py"},
    "pypcd4": {"emulator/recording/cloud_files.py"},
    "pydantic": {
        "emulator/config/",
        "emulator/sensors/",
        "emulator/scenario/",
        "emulator/faults/",
        "emulator/campaigns/file.py",
    },
    "pebble": {"emulator/campaigns/engines.py"},
    "distributed": {"emulator/campaigns/cluster.py"},
    "pyarrow": {"emulator/campaigns/table.py"},
    "SALib": {"emulator/campaigns/sensitivity.py"},
    "adaptive": {"emulator/campaigns/searching.py"},
    "time": {"emulator/process/clock.py"},
    "can": {"emulator/transports/can_bus.py", "emulator/recording/can_logs.py", "emulator/hosts/can_lines.py"},
    "mcap": {"emulator/recording/", "emulator/live/files.py"},
    "cantools": {"protocols/can_objects/"},
    "zeroconf": {"emulator/transports/announcing.py"},
    "fastcrc": {"protocols/checksums.py"},
    "h11": {"protocols/skeleton/http.py"},
    "viser": {"emulator/view/"},
    "websockets": {"emulator/view/"},
    "numba": {"emulator/compiled/"},
    "llvmlite": {"emulator/compiled/"},
}
"Library -> the only files (or folders, ending in /) that import it."

STANDARD_OR = {
    "protocols/": {"numpy", "protocols", "cantools", "e2e", "fastcrc", "h11"},
    "emulator/physics/": {"numpy", "scipy", "emulator", "ruamel"},
    "emulator/compiled/": {"numpy", "numba", "llvmlite", "emulator", "embreex"},
}
"Folder -> what it imports beside the standard library."


NO_ROOMS = {"benchmarks", "docs", "extreme", "hostile", "protocols", "scoreboard", "system"}
"Folders of tests that belong to no single room of emulator/."
BESIDE = {
    "approx.py",
    "by_loops.py",
    "conftest.py",
    "draws.py",
    "layering.py",
    "test_approx.py",
    "test_layering.py",
    "test_warnings.py",
}


def place_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def tops(path: Path) -> set[str]:
    return {module.partition(".")[0] for module, *_ in layering.statements(path)}


def test_a_module_imports_from_its_own_room_and_from_lower_floors_alone() -> None:
    assert not list(layering.imported(KNOWN["emulator"], KNOWN))
    faults = []
    for name in KNOWN:
        room = layering.room_of(name, KNOWN)
        for other, line, _ in layering.imported(KNOWN[name], KNOWN):
            theirs = layering.room_of(other, KNOWN)
            if not (other == "emulator" or theirs == room or FLOOR_OF[theirs] < FLOOR_OF[room]):
                faults.append(f"{place_of(KNOWN[name])}:{line}: imports {other}; want a room below that of {room}")
    assert faults == [], "see tests/layering.py"


def test_a_module_imports_only_the_libraries_that_its_place_allows() -> None:
    faults = []
    for path in KNOWN.values():
        place, found = place_of(path), tops(path)
        for library, homes in ONLY_IN.items():
            if library in found and not any(
                place == home or (home[-1] == "/" and place.startswith(home)) for home in homes
            ):
                faults.append(f"{place} imports {library}; allowed in {sorted(homes)}")
        for folder, allowed in STANDARD_OR.items():
            if place.startswith(folder) and (strange := found - allowed - sys.stdlib_module_names):
                faults.append(f"{place} imports {sorted(strange)}; want {sorted(allowed)}")
    assert faults == []


def test_no_file_imports_itself_by_way_of_others() -> None:
    assert layering.circles(layering.graph()) == []


def test_every_module_lies_in_a_room_and_every_room_is_there() -> None:
    found = {layering.room_of(name, KNOWN) for name in KNOWN} - {"emulator/__init__.py"}
    assert found == set(FLOOR_OF)
    assert len(FLOOR_OF) == sum(map(len, FLOORS))
    beside = {path.name for path in (ROOT / "emulator").iterdir() if path.is_file()}
    assert beside <= set(OUTSIDE), "a module lies in a room, see the table in docs/architecture.md"


def test_tests_lie_in_folders_named_as_rooms() -> None:
    folders = {path.name for path in (ROOT / "tests").iterdir() if path.is_dir() and list(path.glob("**/*.py"))}
    assert folders - NO_ROOMS <= {room.removeprefix("emulator/") for room in FLOOR_OF}
    assert {path.name for path in (ROOT / "tests").glob("*.py")} == BESIDE


@pytest.mark.parametrize("room", [room for room in FLOOR_OF if not room.endswith(".py") and room != "protocols"])
def test_a_room_opens_with_what_belongs_in_it_and_what_it_may_import_and_loads_nothing(room: str) -> None:
    tree = ast.parse((ROOT / room / "__init__.py").read_text(encoding="utf-8"))
    text = ast.get_docstring(tree) or ""
    assert "May import" in text
    assert len(tree.body) == 1, "a docstring and nothing else"


def test_the_reader_of_imports_sees_those_in_functions_and_for_types(tmp_path: Path) -> None:
    text = """
from typing import TYPE_CHECKING
import emulator.errors
if TYPE_CHECKING:
    from emulator.process import clock
def late():
    from emulator.process.waiting import Waiter
"""
    (tmp_path / "some.py").write_text(text)
    found = {name: head for name, _, head in layering.imported(tmp_path / "some.py", KNOWN)}
    assert found == {"emulator.errors": True, "emulator.process.clock": False, "emulator.process.waiting": False}


def test_circles_and_chains_are_found() -> None:
    edges = {"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": {"a"}, "e": set()}
    assert layering.circles(edges) == [["b", "c"]]
    assert layering.chain(edges) == ["d", "a", "b"]


def test_figures_tell_of_a_tidy_house() -> None:
    found = layering.figures()
    assert found["loose files"] == 0
    assert found["files in circles"] == 0
    assert found["circles of rooms"] == []
    floors = found["floors (longest chain of rooms)"]
    assert isinstance(floors, int)
    assert floors <= len(FLOORS)
