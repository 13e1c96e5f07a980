"""Files made to hurt: small texts that grow, lengths that lie, ways out of a folder, containers without end."""

from __future__ import annotations

import base64
import json
import struct
import zlib
from pathlib import Path
from typing import Any

import lz4.frame
import pytest
import zstandard

from emulator.commands.cli import main
from emulator.config import yaml_lines
from emulator.errors import ScenarioError, SceneError
from emulator.recording import bounds
from emulator.recording.reader import read_wire
from emulator.recording.writer import RecordingError
from emulator.scenario import scenario
from emulator.world import mesh_files

HEAD = b"\x89MCAP0\r\n"


def refused_scenario(text: str) -> str:
    with pytest.raises(ScenarioError) as caught:
        scenario.loads(text, Path("bad.yaml"))
    assert str(caught.value).startswith("bad.yaml:")
    assert "want" in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(
    ("begin", "each", "count", "end", "line"),
    [
        ("x: [", "1,1,1,1,1,", 300_000, "1]", 1),
        ("x:\n", "- 1\n", 900_000, "", 250_001),
        ("", "a{n}: 1\r", 501_000, "", 1),
        ("seed: 1\nx:\n", "- " * 31 + "1\n", 60_000, "", 15_627),
        ("x: [", "[[[[[]]]]]", 300_000, "]", 1),
    ],
)
def test_a_scenario_of_nothing_but_values_is_refused_before_it_is_parsed(
    begin: str, each: str, count: int, end: str, line: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    middle = "".join(each.format(n=n) for n in range(count)) if "{n}" in each else each * count
    text = begin + middle + end  # made here: texts of megabytes among the parameters are looked at by every worker
    monkeypatch.delattr(yaml_lines, "YAML")
    reported = f"bad.yaml:{line}: more than 500000 commas, brackets, dashes and line ends; want a smaller file"
    assert refused_scenario(text).startswith(reported)


def test_values_are_counted_while_they_are_parsed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(yaml_lines, "MAX_VALUES", 10)
    assert refused_scenario("x:\n- 1\n- 2\n- {a: 3,\n b: 4}\n- [5, 6,\n 7, 8, 9\n...") == (
        "bad.yaml:7: more than 10 values; want a smaller file"
    )


def test_a_thousand_faults_of_a_list_look_at_its_items_once(monkeypatch: pytest.MonkeyPatch) -> None:
    looks: list[object] = []
    reported_id = yaml_lines._id
    monkeypatch.setattr(yaml_lines, "_id", lambda item: (looks.append(item), reported_id(item))[1])
    reported = refused_scenario("actors:\n" + "".join(f"- {{id: car{n}, mass: !a 1}}\n" for n in range(1000)))
    assert reported.count("\n") == 1000
    assert "bad.yaml:1001: actors.car999.mass: tag !a; want plain data" in reported
    assert len(looks) < 10_000  # a few for each fault; a million where every fault looks at all


def test_aliases_of_aliases_do_not_grow(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(yaml_lines, "MAX_VALUES", 20_000)  # 400 000 take seconds
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]" for n in range(1, 10)]
    assert "more than 20000 values" in refused_scenario("\n".join(lines))


@pytest.mark.parametrize(
    ("text", "reported"),
    [
        ("[" * 500, "nested more than 32 deep"),
        ("seed: 1\nseed: 2", "given twice"),
        ("seed: " + "9" * 5000, "a number of 5000 digits"),
        ("seed: -" + "9" * 100_000, "a number of 100001 digits"),
        ("seed: 0x" + "f" * 100_000, "a number of 100002 digits"),
        ("seed: 0o" + "7" * 100_000, "a number of 100002 digits"),
        ("duration_s: 0." + "9" * 100_000, "a number of 100002 characters"),
        ("duration_s: 1e" + "9" * 100_000, "a number of 100002 characters"),
        ("duration_s: 1e999999999", "duration_s: inf; want a finite number"),
        ("seed: '" + "9" * 100_000 + "'", "want a whole number"),
        ("seed: " + "1_0" * 40_000, "want a whole number"),
        ("a: !!python/object/apply:os.system [echo]", "tag"),
        ("a: &a [*a]", "inside its own anchor"),
        ("%YAML 1.6", "not YAML"),
        ("a: 1\n---\nb: 2", "a second document"),
    ],
)
def test_what_is_no_plain_data_is_refused_by_line(text: str, reported: str) -> None:
    assert reported in refused_scenario(text)


def test_a_scenario_beyond_its_size_is_refused_before_it_is_read(tmp_path: Path) -> None:
    path = tmp_path / "big.yaml"
    with path.open("wb") as file:
        file.truncate(5_000_000_000)
    with pytest.raises(ScenarioError, match="5000000000 bytes; want at most 4000000"):
        scenario.load(str(path))


# ------------------------------------------------------------------------------------------------ meshes


def gltf(**changes: Any) -> dict[str, Any]:
    """One triangle, its buffer in the file."""
    data = struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0)
    uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    whole = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "mode": 4}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "buffers": [{"uri": uri, "byteLength": 36}],
    }
    return whole | changes


def loaded(path: Path) -> int:
    return len(mesh_files.load(path, None, 1.0, "case.yaml:3").faces)


def test_a_plain_triangle_is_read(tmp_path: Path) -> None:
    path = tmp_path / "a.gltf"
    path.write_text(json.dumps(gltf()))
    assert loaded(path) == 1


OUTSIDE = (
    "../secret.bin",
    "/etc/passwd",
    "%2e%2e/secret.bin",
    "http://127.0.0.1:9/x",
    "file:///etc/passwd",
    "link.bin",
)


@pytest.mark.parametrize("uri", OUTSIDE)
def test_a_buffer_outside_the_meshs_folder_is_refused(tmp_path: Path, uri: str) -> None:
    (tmp_path / "secret.bin").write_bytes(bytes(36))
    folder = tmp_path / "meshes"
    folder.mkdir()
    (folder / "link.bin").symlink_to(tmp_path / "secret.bin")
    path = folder / "a.gltf"
    path.write_text(json.dumps(gltf(buffers=[{"uri": uri, "byteLength": 36}])))
    with pytest.raises(SceneError, match="want a file in the folder of the mesh"):
        loaded(path)


def test_a_buffer_beside_the_mesh_is_read(tmp_path: Path) -> None:
    (tmp_path / "a b.bin").write_bytes(struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0))
    path = tmp_path / "a.gltf"
    path.write_text(json.dumps(gltf(buffers=[{"uri": "a%20b.bin", "byteLength": 36}])))
    assert loaded(path) == 1


@pytest.mark.parametrize(
    ("changes", "reported"),
    [
        (
            {"accessors": [{"bufferView": 0, "componentType": 5126, "count": 10**9, "type": "VEC3"}]},
            "1000000000 elements",
        ),
        ({"accessors": [{"componentType": 5126, "count": 10**10, "type": "VEC3"}]}, "without data"),
        ({"accessors": [{"bufferView": 7, "componentType": 5126, "count": 3, "type": "VEC3"}]}, "accessor 0"),
        ({"bufferViews": [{"buffer": 0, "byteOffset": 10, "byteLength": 36}]}, "behind its buffer"),
        ({"bufferViews": [{"buffer": 3, "byteLength": 36}]}, "behind its buffer"),
        ({"nodes": [{"children": [1, 1]}, {"mesh": 0}]}, "several parents"),
        ({"nodes": [{"children": [0]}]}, "several parents"),
        ({"nodes": [{"children": [9]}]}, "child 9"),
        ({"meshes": "x"}, "want a list of tables"),
    ],
)
def test_what_a_gltf_asks_for_must_be_there(tmp_path: Path, changes: dict[str, Any], reported: str) -> None:
    path = tmp_path / "a.gltf"
    path.write_text(json.dumps(gltf(**changes)))
    with pytest.raises(SceneError, match=reported):
        loaded(path)


@pytest.mark.parametrize("length", [2**32 - 1, 10**6])
def test_a_chunk_that_is_longer_than_the_file_is_refused(tmp_path: Path, length: int) -> None:
    path = tmp_path / "a.glb"
    path.write_bytes(b"glTF" + struct.pack("<III", 2, length, length) + b"JSON{}")
    with pytest.raises(SceneError, match=f"a chunk of {length} bytes"):
        loaded(path)


def test_pictures_are_not_looked_at(tmp_path: Path) -> None:
    pictures = [{"uri": "http://127.0.0.1:9/a.png"}, {"uri": "../../etc/passwd"}]
    painted = {"name": "body", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}
    text = gltf(images=pictures, textures=[{"source": 0}], materials=[painted])
    path = tmp_path / "a.gltf"
    path.write_text(json.dumps(text))
    assert loaded(path) == 1


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("a.stl", bytes(80) + struct.pack("<I", 2**32 - 1)),
        ("a.ply", b"ply\nformat binary_little_endian 1.0\nelement vertex 4294967295\nproperty float x\nend_header\n"),
        (
            "a.ply",
            b"ply\nformat ascii 1.0\nelement face 4000000000\nproperty list uchar int vertex_indices\nend_header\n",
        ),
        ("a.obj", b"v 0 0 0\nf 1 2 99999999999999999999\n"),
        ("a.glb", b"\x1f\x8b" + bytes(100)),
    ],
)
def test_a_mesh_whose_lengths_lie_is_refused(
    tmp_path: Path, name: str, data: bytes, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / name).write_bytes(data)
    with pytest.raises(SceneError, match=f"case.yaml:3: {name}"):
        loaded(tmp_path / name)
    assert "Traceback" not in capsys.readouterr().err


# ------------------------------------------------------------------------------------------------ recordings


def chunk(compression: str, data: bytes, size: int) -> bytes:
    """A record of opcode 6 with that content."""
    name = compression.encode()
    body = (
        struct.pack("<QQQI", 0, 0, size, 0) + struct.pack("<I", len(name)) + name + struct.pack("<Q", len(data)) + data
    )
    return b"\x06" + struct.pack("<Q", len(body)) + body


@pytest.mark.parametrize("size", [10, 1 << 27])
@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_a_chunk_that_grows_is_refused_whatever_it_says_of_its_size(
    tmp_path: Path, compression: str, size: int
) -> None:
    zeros = bytes((1 << 26) + 1)
    packed = zstandard.compress(zeros) if compression == "zstd" else lz4.frame.compress(zeros)
    assert len(packed) < 400_000
    path = tmp_path / "a.mcap"
    path.write_bytes(HEAD + chunk(compression, packed, size))
    with pytest.raises(RecordingError, match="a chunk of more than 67108864 bytes"):
        read_wire(path)


def test_chunks_that_are_small_one_by_one_and_too_much_together_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("emulator.recording.reader.MOST_BYTES", 1 << 20)
    packed = lz4.frame.compress(struct.pack("<BQ", 0x80, (1 << 18) - 9) + bytes((1 << 18) - 9))
    path = tmp_path / "a.mcap"
    path.write_bytes(HEAD + 5 * chunk("lz4", packed, 1 << 18))
    assert path.stat().st_size < 10_000
    with pytest.raises(RecordingError, match="more than 1048576 bytes when unpacked"):
        read_wire(path)


LIES = (
    b"\x01" + struct.pack("<Q", 2**60),
    b"\x01" + struct.pack("<QI", 12, 2**32 - 1),
    chunk("zstd", b"junk", 9),
    chunk("rar", b"", 1),
)


@pytest.mark.parametrize("record", LIES)
def test_an_mcap_whose_lengths_lie_is_refused(tmp_path: Path, record: bytes) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(HEAD + record + bytes(8))
    with pytest.raises(RecordingError, match="no recording of lidaremu"):
        read_wire(path)


def test_a_blf_object_without_length_does_not_keep_us_for_ever(tmp_path: Path) -> None:
    inner = b"LOBJ" + struct.pack("<HHII", 16, 9, 0, 1) + bytes(64)
    path = tmp_path / "a.blf"
    path.write_bytes(blf(inner))
    with pytest.raises(RecordingError, match="an object of 0 bytes within a container"):
        read_wire(path)


def blf(inner: bytes) -> bytes:
    packed = zlib.compress(inner)
    head = b"LOGG" + struct.pack("<I", 144) + bytes(136)
    return head + b"LOBJ" + struct.pack("<HHII", 16, 1, 32 + len(packed), 10) + struct.pack("<H6xI4x", 2, 1) + packed


def test_a_blf_container_that_grows_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.blf"
    path.write_bytes(blf(bytes(bounds.MOST_UNPACKED + 1)))
    with pytest.raises(RecordingError, match="a container of more than 67108864 bytes"):
        read_wire(path)


def test_what_is_no_file_or_too_large_is_not_read(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="not a regular file"):
        read_wire(Path("/dev/zero"))
    for name in ("a.mcap", "a.pcapng", "a.blf", "a.raw"):
        with (tmp_path / name).open("wb") as file:
            file.truncate(bounds.MOST_BYTES + 1)
        with pytest.raises(RecordingError, match=f"want at most {bounds.MOST_BYTES}"):
            read_wire(tmp_path / name)


def test_commands_answer_hostile_files_with_a_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.mcap").write_bytes(HEAD + b"\xff" * 100)
    (tmp_path / "a.yaml").write_text("sensors: [" * 100)
    assert main(["replay", str(tmp_path / "a.mcap")]) == 2
    assert main(["check", str(tmp_path / "a.yaml")]) == 2
    reported = capsys.readouterr().err
    assert "Traceback" not in reported
    assert "want" in reported
