"""Who may import whom. The rules stand in docs/architecture.md; this reads the imports and holds them."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent

ONLY_IN = {
    "embreex": {"emulator/embree.py", "emulator/deforming.py"},
    "trimesh": {"emulator/scene.py", "emulator/raycast.py", "emulator/mesh_files.py", "emulator/meshes.py"},
    "pydantic": {
        "emulator/scenario.py",
        "emulator/scenario_tables.py",
        "emulator/spec.py",
        "emulator/tables.py",
        "emulator/weather.py",
        "emulator/live_weather.py",
        "emulator/physics_options.py",
        "emulator/object_options.py",
        "emulator/clock_options.py",
        "emulator/yaml_source.py",
        "emulator/faults/",
    },
    "time": {"emulator/clock.py"},
    "can": {"emulator/transports/can_bus.py", "emulator/recording/can_logs.py", "emulator/hosts/can_lines.py"},
    "mcap": {"emulator/recording/"},
    "cantools": {"protocols/can_objects/"},
    "viser": {"emulator/view/"},
    "websockets": {"emulator/view/"},
    "numba": {"emulator/compiled/"},
    "llvmlite": {"emulator/compiled/"},
}
"Library -> the only files (or folders, ending in /) that import it."

STANDARD_OR = {
    "protocols/": {"numpy", "protocols", "cantools", "e2e"},
    "emulator/physics/": {"numpy", "scipy", "emulator", "ruamel"},
}
"Folder -> what it imports beside the standard library."


def modules() -> list[Path]:
    return sorted(path for folder in ("emulator", "protocols") for path in (ROOT / folder).rglob("*.py"))


def imported(path: Path) -> set[str]:
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            names.add(node.module)
    return names


def tops(path: Path) -> set[str]:
    return {name.partition(".")[0] for name in imported(path)}


@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(ROOT)))
def test_a_module_imports_only_what_its_place_allows(path: Path) -> None:
    import sys

    place = path.relative_to(ROOT).as_posix()
    found = tops(path)
    for library, homes in ONLY_IN.items():
        if not any(place == home or (home.endswith("/") and place.startswith(home)) for home in homes):
            assert library not in found, f"{place} imports {library}; allowed in {sorted(homes)}"
    for folder, allowed in STANDARD_OR.items():
        if place.startswith(folder):
            strange = found - allowed - sys.stdlib_module_names
            assert not strange, f"{place} imports {sorted(strange)}"
    if place.startswith("protocols/"):
        assert "emulator" not in found
    if place.startswith("emulator/compiled/"):
        assert all(name.startswith("emulator.compiled") for name in imported(path) if name.startswith("emulator"))
    if place.startswith("emulator/physics/"):
        outside = {name for name in imported(path) if name.startswith("emulator") and ".physics" not in name}
        assert outside <= {"emulator.errors", "emulator.compiled"}, outside


def test_the_reader_of_imports_sees_them() -> None:
    assert "ast" in tops(Path(__file__))
    assert "embreex" not in tops(ROOT / "emulator" / "clock.py")
    assert "time" in tops(ROOT / "emulator" / "clock.py")
