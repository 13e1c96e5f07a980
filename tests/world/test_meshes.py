"""The meshes that come with the package."""

from __future__ import annotations

import json
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from emulator.world import mesh_files, meshes
from emulator.world.triangles import Geometry

FOLDER = Path(str(files("scenarios") / "meshes"))
NAMES = [*meshes.MODELS, "yard"]


def shipped(name: str) -> Geometry:
    return mesh_files.load(FOLDER / f"{name}.glb", None, 1.0, name)


@pytest.mark.parametrize("name", NAMES)
def test_the_committed_file_is_what_the_code_makes(name: str) -> None:
    """`meshes.write_all` makes them anew; a last digit may differ between processors' sine tables."""

    def split(stored: bytes) -> tuple[dict, np.ndarray]:
        length = int.from_bytes(stored[12:16], "little")
        return json.loads(stored[20 : 20 + length]), np.frombuffer(stored[28 + length :], np.uint8)

    (document, binary), (want, wanted) = split((FOLDER / f"{name}.glb").read_bytes()), split(meshes.file_bytes(name))
    for one in (*document["accessors"], *want["accessors"]):
        low, high = one.pop("min", None), one.pop("max", None)
        assert low is None or np.isfinite([low, high]).all()
    assert document == want
    for view, accessor in zip(want["bufferViews"], want["accessors"], strict=True):
        kind = {5126: "<f4", 5123: "<u2", 5125: "<u4"}[accessor["componentType"]]
        here = slice(view["byteOffset"], view["byteOffset"] + view["byteLength"])
        got, made = (np.frombuffer(data[here].tobytes(), kind) for data in (binary, wanted))
        np.testing.assert_allclose(got, made, rtol=0, atol=1.5e-4 if kind == "<f4" else 0)


def test_the_folder_holds_nothing_else_and_is_small() -> None:
    found = {path.stem for path in FOLDER.iterdir() if path.suffix == ".glb"}
    assert found == set(NAMES)
    assert sum(path.stat().st_size for path in FOLDER.iterdir()) < 2_000_000


@pytest.mark.parametrize("name", NAMES)
def test_every_mesh_is_closed_and_clean(name: str) -> None:
    mesh = shipped(name)
    assert mesh.closed.all()
    assert (mesh.dropped, mesh.coplanar) == (0, 0)


@pytest.mark.parametrize(
    ("name", "size", "parts"),
    [
        ("car", (4.52, 1.81, 1.45), {"body", "glass", "bumper", "tyre", "plate"}),
        ("truck", (8.32, 2.5, 3.6), {"cab", "glass", "box", "chassis", "tyre", "plate"}),
        ("pedestrian", (0.7, 0.6, 1.75), {"skin", "top", "trousers", "shoes"}),
        ("bicycle", (1.73, 0.58, 1.78), {"tyre", "frame", "skin", "top", "trousers", "shoes"}),
        ("tree", (4.4, 4.05, 8.07), {"bark", "leaves"}),
        ("lamp_post", (1.7, 0.24, 6.08), {"pole", "lamp"}),
        ("traffic_sign", (0.09, 0.6, 2.65), {"face", "back", "pole"}),
        ("house", (9.8, 12.4, 8.5), {"wall", "roof", "window", "door"}),
    ],
)
def test_meshes_have_their_size_stand_on_the_ground_and_name_their_parts(
    name: str, size: tuple[float, float, float], parts: set[str]
) -> None:
    mesh = shipped(name)
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    np.testing.assert_allclose(high - low, size, atol=0.02)
    assert low[2] == pytest.approx(0.0, abs=0.005)
    assert set(mesh.parts) == parts


def test_the_car_has_its_glass_above_its_bumpers_and_its_plates_at_its_ends() -> None:
    mesh = shipped("car")
    assert 1500 <= len(mesh.faces) <= 3000
    middle = mesh.vertices[mesh.faces].mean(axis=1)

    def of(part: str) -> np.ndarray:
        return middle[mesh.face_part == mesh.parts.index(part)]

    assert of("glass")[:, 2].min() > 0.9
    assert np.abs(of("bumper")[:, 0]).min() > 1.9
    assert np.abs(of("plate")[:, 0]).min() > 2.2
    assert of("tyre")[:, 2].max() < 0.65


def test_the_yards_parts_bear_names_of_materials() -> None:
    from emulator.physics.materials import known_materials

    assert set(shipped("yard").parts) <= set(known_materials())
