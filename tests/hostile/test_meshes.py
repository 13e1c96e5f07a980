"""Mesh files made to hurt: every length, count and reference of a stranger is judged before it is used."""

from __future__ import annotations

import base64
import json
import os
import struct
import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from emulator.config.budgets import MESH, MESH_LIMITS, MeshBudget, PlainFile, TooMuch, loads_json, mesh_budget
from emulator.errors import SceneError
from emulator.world import mesh_files
from emulator.world.obj_file import load_obj
from tests.hostile.test_files import gltf

CORNERS = struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0)
LITTLE = 30_000_000
"Bytes that a refusal may take at the most, of Python and numpy: the largest of the files below has 20 MB."


def refused(path: Path, budget: MeshBudget = MESH, most: int = LITTLE) -> str:
    """The line that refuses a file, which was told without much memory."""
    tracemalloc.start()
    try:
        with pytest.raises(SceneError) as caught:
            mesh_files.load(path, None, 1.0, "case.yaml:3", budget)
        assert tracemalloc.get_traced_memory()[1] < most
    finally:
        tracemalloc.stop()
    reported = str(caught.value)
    assert reported.startswith(f"case.yaml:3: {path.name}: ")
    assert "\n" not in reported
    return reported


def written(path: Path, changes: dict[str, Any]) -> Path:
    path.write_text(json.dumps(gltf(**changes)), encoding="utf-8")
    return path


def sparse(path: Path, head: bytes, size: int) -> Path:
    """A file of that size that takes no room on the disk."""
    with path.open("wb") as file:
        file.write(head)
        file.truncate(size)
    return path


EMPTY = {
    "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}] * 100}],
    "accessors": [{"componentType": 5126, "count": 9_999_999, "type": "VEC3"}],
}
FOREST = {
    "scenes": [{"nodes": list(range(1000))}],
    "nodes": [{"mesh": 0}] * 1000,
    "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}] * 100}],
}
DRACO = {
    "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "extensions": {"KHR_draco_mesh_compression": {}}}]}]
}
VIEW = {"buffer": 0, "byteLength": 36}
ACCESSOR = {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}


def changed(at: list[int], **indices: Any) -> dict[str, Any]:
    """A sparse accessor whose one index stands behind the corners."""
    accessor = ACCESSOR | {
        "sparse": {
            "count": 1,
            "indices": {"bufferView": 1, "componentType": 5121} | indices,
            "values": {"bufferView": 0},
        }
    }
    data = CORNERS + bytes(at)
    uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    views = [VIEW, {"buffer": 0, "byteOffset": 36, "byteLength": len(at)}]
    return {"accessors": [accessor], "bufferViews": views, "buffers": [{"uri": uri, "byteLength": len(data)}]}


@pytest.mark.parametrize(
    ("changes", "reported"),
    [
        (EMPTY, "accessor 0 of 9999999 elements without data"),
        (FOREST, "100000 triangles; want at most 99999"),
        (DRACO, "packed by KHR_draco_mesh_compression"),
        (
            {"bufferViews": [VIEW | {"extensions": {"EXT_meshopt_compression": {}}}]},
            "packed by EXT_meshopt_compression",
        ),
        ({"bufferViews": [VIEW | {"byteStride": 252}]}, "accessor 0: 3 elements of 12 bytes; its bufferView has 36"),
        ({"bufferViews": [VIEW | {"byteStride": 10**9}]}, "byteStride 1000000000; want at most 252"),
        ({"accessors": [ACCESSOR | {"count": 2**53}]}, "9007199254740992 elements of 12 bytes"),
        ({"accessors": [ACCESSOR | {"count": 2}]}, "2 corners; want three for each triangle"),
        ({"accessors": [ACCESSOR | {"type": ["VEC3"]}]}, "neither componentType nor type"),
        (changed([7]), "sparse element 7; want one of 3"),
        (changed([0], componentType=5126), "sparse indices; want whole numbers"),
        (changed([0], byteOffset=1), "accessor 0, sparse indices: 1 elements of 1 bytes; its bufferView has 1 bytes"),
        ({"nodes": [{"mesh": 0, "children": [1]}, {"children": [2]}, {"children": [0]}]}, "own parent's parent"),
        ({"nodes": [{"mesh": 0, "matrix": [0] * 15}]}, "node 0: matrix; want 16 numbers"),
        ({"nodes": [{"mesh": 0, "translation": [10**39, 0, True]}]}, "node 0: translation; want 3 numbers"),
        ({"nodes": [{"mesh": 0, "translation": [10**39, 0, 0]}]}, "want coordinates within"),
        ({"nodes": [{"mesh": 0, "scale": [float("nan"), 1, 1]}]}, "want finite numbers"),
        ({"nodes": [{"mesh": 7}]}, "node 0: mesh 7; want one of 1"),
        ({"scene": 2**40}, "scene 1099511627776; want one of 1"),
        ({"asset": {"version": "2.0", "x": list(range(3000))}}, "commas and brackets of JSON; want at most 2000"),
    ],
)
def test_what_a_gltf_asks_for_is_counted_before_it_is_made(
    tmp_path: Path, changes: dict[str, Any], reported: str
) -> None:
    budget = replace(MESH, triangles=99_999, json_values=20_000 if len(str(changes)) > 20_000 else 2000)
    assert reported in refused(written(tmp_path / "a.gltf", changes), budget)


def test_sparse_values_are_put_in_their_places(tmp_path: Path) -> None:
    """What trimesh, which read these files before, passes over."""
    changes = changed([1])
    changes["accessors"][0]["sparse"]["values"]["byteOffset"] = 24  # the third corner in place of the second
    assert "no area" in refused(written(tmp_path / "a.gltf", changes))
    changes = changed([0])
    assert mesh_files.load(written(tmp_path / "a.gltf", changes), "z", 1.0, "x").vertices[0].tolist() == [0, 0, 0]


@pytest.mark.parametrize("depth", [50_000])
def test_a_chain_of_nodes_is_walked_once(tmp_path: Path, depth: int) -> None:
    nodes: list[dict[str, Any]] = [{"children": [n + 1], "translation": [0, 0, 0.001]} for n in range(depth - 1)]
    path = written(tmp_path / "a.gltf", {"nodes": [*nodes, {"mesh": 0}]})
    mesh = mesh_files.load(path, "z", 1.0, "x")
    np.testing.assert_allclose(mesh.vertices[:, 2], 0.001 * (depth - 1), rtol=1e-9)


def test_a_forest_within_the_budget_is_read(tmp_path: Path) -> None:
    assert len(mesh_files.load(written(tmp_path / "a.gltf", FOREST), None, 1.0, "x").faces) == 100_000


@pytest.mark.parametrize(
    ("text", "reported"),
    [
        (b"[" * 1_000_000, "1000000 commas and brackets of JSON; want at most 100000"),
        (b'{"a":' * 5000 + b"1" + b"}" * 5000, "nested too deep"),
        (b'{"a":' + b"9" * 100_000 + b"}", "a number of 100000 digits; want at most 40"),
        (b'{"a":0.' + b"9" * 100_000 + b"}", "a number of 100002 characters; want at most 400"),
        (b'{"a":1', "cannot be read"),
        (b"\xff\xfe[]", "cannot be read"),
    ],
)
def test_json_is_counted_before_it_is_read(tmp_path: Path, text: bytes, reported: str) -> None:
    (tmp_path / "a.gltf").write_bytes(text)
    assert reported in refused(tmp_path / "a.gltf", replace(MESH, json_values=100_000))


PLY = "ply\nformat {}\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n{}end_header\n"
LITTLE_ENDIAN = "binary_little_endian 1.0"
FACES = "element face {}\nproperty list {} int vertex_indices\n"


@pytest.mark.parametrize(
    ("text", "reported"),
    [
        (PLY.format(LITTLE_ENDIAN, 2**31, ""), "2147483648 vertices; want at most 30000000"),
        (PLY.format(LITTLE_ENDIAN, "9" * 1000, ""), "want a name and a number"),
        (PLY.format(LITTLE_ENDIAN, 20_000_000, ""), "elements of at least 240000000 bytes; behind its header are 3"),
        (PLY.format("ascii 1.0", 3, FACES.format(2**31, "uchar")), "2147483648 faces; want at most 10000000"),
        (PLY.format("ascii 1.0", 3, FACES.format(9_000_000, "uchar")), "elements of at least 18000018 bytes"),
        (PLY.format("ascii 1.0", 3, "element x 99999999999\n"), "99999999999 times x; want at most 30000000"),
        (PLY.format(LITTLE_ENDIAN, 3, "property list x y z\n"), "want a type and a name"),
        ("ply\n" + "comment\n" * 10_000 + "end_header\n", "no header of a PLY within 65536 bytes"),
    ],
)
def test_a_ply_has_room_for_what_its_header_promises(tmp_path: Path, text: str, reported: str) -> None:
    (tmp_path / "a.ply").write_bytes(text.encode() + CORNERS)
    assert reported in refused(tmp_path / "a.ply")


def test_a_list_of_a_ply_that_is_longer_than_the_file_is_refused(tmp_path: Path) -> None:
    head = PLY.format(LITTLE_ENDIAN, 3, FACES.format(1, "uint")).encode()
    (tmp_path / "a.ply").write_bytes(head + CORNERS + struct.pack("<I", 2**31) + bytes(12))
    assert "cannot be read" in refused(tmp_path / "a.ply")


@pytest.mark.parametrize(
    ("name", "head", "size", "reported"),
    [
        ("a.stl", bytes(80) + struct.pack("<I", 19_000_000), 84 + 50 * 19_000_000, "19000000 triangles; want at most"),
        ("a.stl", b"", 10**12, "1000000000000 bytes; want at most 1000000000"),
        ("a.stl", b"solid", 900_000_000, "900000000 bytes; want at most 200000000"),
        ("a.obj", b"", 200_000_001, "200000001 bytes; want at most 200000000"),
        ("a.ply", PLY.format("ascii 1.0", 3, "").encode(), 900_000_000, "900000000 bytes; want at most 200000000"),
        ("a.gltf", b"{}", 900_000_000, "900000000 bytes of JSON; want at most 64000000"),
        ("a.glb", b"glTF" + struct.pack("<III", 2, 0, 900_000_000) + b"JSON", 10**9, "bytes of JSON; want at most"),
        ("a.glb", b"glTF" + bytes(8), 10**9, "no chunk of JSON"),
    ],
)
def test_a_file_of_holes_is_refused_by_its_size_alone(
    tmp_path: Path, name: str, head: bytes, size: int, reported: str
) -> None:
    line = refused(sparse(tmp_path / name, head, size), most=1_000_000)
    assert reported in line
    assert ("allows more)" in line) == ("want at most" in line)


def test_bytes_that_nothing_draws_are_not_read(tmp_path: Path) -> None:
    """A GLB of 1 GB, most of it pictures, costs what its triangle costs."""
    text = json.dumps(gltf(buffers=[{"byteLength": 36}])).encode()
    text += b" " * (-len(text) % 4)
    rest = 900_000_000
    head = b"glTF" + struct.pack("<IIII", 2, 0, len(text), 0x4E4F534A) + text + struct.pack("<I", rest) + b"BIN\0"
    path = sparse(tmp_path / "a.glb", head + CORNERS, len(head) + rest)
    tracemalloc.start()
    try:
        assert len(mesh_files.load(path, None, 1.0, "x").faces) == 1
        assert tracemalloc.get_traced_memory()[1] < 1_000_000
    finally:
        tracemalloc.stop()


# ---------------------------------------------------------------- OBJ


SQUARE = b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


@pytest.mark.parametrize(
    ("text", "reported"),
    [
        (SQUARE + b"f 1 2 " + b"9" * 100_000, "line 5: a number of 100000 characters; want at most 400"),
        (SQUARE + b"f 1 2 " + b"9" * 300, "line 5: 'f 1 2 999999"),
        (SQUARE + b"v 0 0 1." + b"0" * 100_000 + b"\nf 1 2 3", "line 5: a number of 100002 characters"),
        (SQUARE + b"f 1 2 1000000000000000000", "names vertex [0, 1, 999999999999999999]; want 0..3"),
        (SQUARE + b"f 1 2 -1000000000000000000", "line 5: 'f 1 2 -1000000000000000000': no vertex -1000"),
        (SQUARE + b"f 1 2 0", "line 5: 'f 1 2 0': no vertex 0"),
        (SQUARE + b"# x\n\nf 1 2 3\nf 1 2 x\n", "line 8: 'f 1 2 x': invalid literal"),
        (SQUARE + b"f " + b"1 2 3 " * 200_000, "line 5: of 1200002 bytes; want at most 1000000"),
        (SQUARE + b"f " + b"1 2 3 " * 10_000, "line 5: more than 1000 triangles"),
        (SQUARE + b"f 1 2 3\n" * 1001, "line 1005: more than 1000 triangles"),
        (b"v 1 2 3\n" * 4001, "line 4001: more than 4000 vertices"),
        (SQUARE + b"".join(b"g %d\nf 1 2 3\n" % n for n in range(200)), "more than 100 names of parts"),
        (b"v 0 0\n", "line 1: 'v 0 0': a vertex of fewer than three numbers"),
        (b"\0" * 10_000, "no triangles"),
    ],
)
@pytest.mark.parametrize("piece", [64, 4_000_000])
def test_an_obj_is_refused_by_its_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: bytes, reported: str, piece: int
) -> None:
    monkeypatch.setattr("emulator.world.obj_file.PIECE", piece)
    (tmp_path / "a.obj").write_bytes(text)
    assert reported in refused(tmp_path / "a.obj", replace(MESH, triangles=1000, vertices=4000, items=100))


@pytest.mark.parametrize("piece", [1, 50, 4_000_000])
@pytest.mark.parametrize("end", [b"\n", b"\r\n", b"\r"])
def test_an_obj_is_read_the_same_in_pieces_of_any_size(monkeypatch: pytest.MonkeyPatch, piece: int, end: bytes) -> None:
    monkeypatch.setattr("emulator.world.obj_file.PIECE", piece)
    text = (
        b"# f 9 9 9\no door#x\nv 0 0 0 1 0 0\nv\t1 0 0 not looked at\n  v 1 1 0\nvn 0 0 1\nf 1 2//1 3/4/5\nusemtl a b\n"
        b"v 0 1 0\nf -4 \\\n-3 -2 -1 # a square\nusemtl\nf 1 2 3\ng\nfo 1 2 3\nusemtl a b\nf 4/1 3 2\n"
    )
    vertices, faces, part, names = load_obj(text.replace(b"\n", end), "file")
    assert vertices.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    assert faces.tolist() == [[0, 1, 2], [0, 1, 2], [0, 2, 3], [0, 1, 2], [3, 2, 1]]
    assert (part.tolist(), names) == ([0, 1, 1, 0, 1], ("file", "a b"))


def test_numbers_of_an_obj_are_those_that_python_reads() -> None:
    words = ["1e-3", "-.5", "+7.25", "0.1", "1.7976931348623157e308", "2.2250738585072014e-308", "123456789.123456789"]
    text = "".join(f"v {word} 0 0\n" for word in words).encode()
    assert load_obj(text + b"f 1 2 3", "x")[0][:, 0].tolist() == [float(word) for word in words]


# ---------------------------------------------------------------- STL


FACET = b"facet normal 0 0 1\nouter loop\nvertex 0 0 0\nVERTEX 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"


def test_solids_of_an_stl_are_its_parts(tmp_path: Path) -> None:
    text = (
        b"solid one\n"
        + FACET
        + b"endsolid one\nSOLID\n"
        + FACET
        + FACET
        + b"ENDSOLID\nsolid\nendsolid\nsolid x\n"
        + FACET
    )
    (tmp_path / "a.stl").write_bytes(text)
    mesh = mesh_files.load(tmp_path / "a.stl", None, 1.0, "x")
    assert (mesh.parts, mesh.face_part.tolist()) == (("one", "geometry_1"), [0, 1, 1])


@pytest.mark.parametrize(
    ("text", "reported"),
    [
        (b"solid\n" + b"endsolid\n" * 2, "an `endsolid` without its `solid`"),
        (b"solid a\nvertex 0 0 0\nendsolid a\n", "1 vertices of 3 numbers"),
        (b"solid a\nvertex 0 0\nvertex 0 0 0 0\nvertex 0 0\nendsolid a\n", "3 vertices of 8 numbers"),
        (
            b"solid a\n" + b"vertex 0 0 " + b"9" * 100_000 + b"\nvertex 1 1 1\nvertex 2 2 2\nendsolid a",
            "100000 characters",
        ),
        (b"solid a\nendsolid a\n" * 200, "200 solids; want at most 100"),
        (b"solid a\n" + FACET * 2000 + b"endsolid a\n", "vertices; want at most 4000"),
        (b"solid" * 100_000, "no triangles"),
    ],
)
def test_an_stl_of_text_is_counted_too(tmp_path: Path, text: bytes, reported: str) -> None:
    (tmp_path / "a.stl").write_bytes(text)
    assert reported in refused(tmp_path / "a.stl", replace(MESH, items=100, vertices=4000))


# ---------------------------------------------------------------- what is no file


@pytest.mark.parametrize("suffix", [".obj", ".stl", ".ply", ".gltf", ".glb"])
def test_what_is_no_plain_file_keeps_nobody_waiting(tmp_path: Path, suffix: str) -> None:
    os.mkfifo(tmp_path / f"fifo{suffix}")
    (tmp_path / f"folder{suffix}").mkdir()
    (tmp_path / f"zero{suffix}").symlink_to("/dev/zero")
    for name, reported in (
        ("fifo", "not a regular file; want one"),
        ("folder", "(Is a directory)"),
        ("zero", "not a regular"),
    ):
        assert reported in refused(tmp_path / f"{name}{suffix}")


def test_a_buffer_that_is_a_pipe_keeps_nobody_waiting(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "b.bin")
    path = written(tmp_path / "a.gltf", {"buffers": [{"uri": "b.bin", "byteLength": 36}]})
    assert "buffer 'b.bin': not a regular file" in refused(path)


def test_a_file_that_grows_or_shrinks_is_read_as_it_was_opened(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(b"abc")
    with PlainFile(path) as file:
        with path.open("ab") as more:
            more.write(b"def")
        assert file.read() == b"abc"
        os.truncate(path, 1)
        with pytest.raises(OSError, match="became shorter"):
            file.read()


# ---------------------------------------------------------------- the limits themselves


def test_the_environment_raises_and_lowers_the_limits_of_meshes() -> None:
    assert mesh_budget({}) == MESH
    assert mesh_budget({MESH_LIMITS: " triangles = 5e7, cpu_s=900 "}) == replace(MESH, triangles=50_000_000, cpu_s=900)


@pytest.mark.parametrize(
    "text", ["triangle=1", "triangles", "triangles=x", "cpu_s=0", "cpu_s=nan", "cpu_s=1e99", "a=" + "9" * 10**5]
)
def test_a_limit_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(SceneError, match=f"^{MESH_LIMITS}: .*; want NAME=NUMBER") as caught:
        mesh_budget({MESH_LIMITS: text})
    assert len(str(caught.value)) < 400


def test_json_of_ours_has_numbers_that_are_numbers() -> None:
    assert loads_json('{"a": [1, -2.5, 1e3, 12345678901234567890]}') == {"a": [1, -2.5, 1000.0, 12345678901234567890]}
    for text in ("9" * 41, "[" * 10_000, "1" * 5000 + ".0"):
        with pytest.raises(ValueError, match=r"digits|deep|characters"):
            loads_json(text)
    assert issubclass(TooMuch, ValueError)
