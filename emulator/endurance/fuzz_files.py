"""Fuzzing of the file readers: scenarios, YAML, expressions, meshes, recordings."""

from __future__ import annotations

import atexit
import base64
import json
import shutil
import tempfile
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from emulator.config.expressions import ExpressionError, evaluate, parse
from emulator.config.expressions import names as names_of
from emulator.config.yaml_lines import parse as parse_yaml
from emulator.endurance.scene import soak_text
from emulator.errors import EmulatorError, ScenarioError
from emulator.recording.can_logs import LoggedFrame, candump_line, write_with_library
from emulator.recording.examples import example_mcaps
from emulator.recording.pcapng import PcapngWriter
from emulator.recording.reader import read_wire
from emulator.scenario import scenario

TRIANGLE = ([0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
EXPRESSIONS = (
    b"max(front.points_on(car)) > 20 and median(front.range_at(0)) - 8 < 0.05",
    b'not (p(front."odd name", 99) <= -1e3) or front.x.y("a") == 2',
    b"count(front.range_at(-1)) / 2 * 3 + 1 >= all(front.a < 3)",
)
YAMLS = (
    b"a: &x [1, 2, *y]\nb: {c: 'd', e: 0x1F}\n",
    b"a: &a [x, x]\nb: &b [*a, *a]\nc: [*b, *b]\n",
    b"- |\n  text\n- >-\n  more\n- {a: 1, a: 2}\n- !!python/object:os.system x\n",
    b"%YAML 1.2\n---\nkey: .inf\nother: 1e400\n...\n",
)


def scenarios() -> Callable[[bytes], None]:
    """A whole scenario file."""

    def run(data: bytes) -> None:
        try:
            scenario.loads(data.decode("utf-8", "replace"), Path("/nowhere/fuzz.yaml"))
        except EmulatorError:
            return

    return run


def yaml() -> Callable[[bytes], None]:
    """Any YAML text."""

    def run(data: bytes) -> None:
        try:
            parse_yaml(data.decode("utf-8", "replace"), Path("fuzz.yaml"), ScenarioError)
        except EmulatorError:
            return

    return run


def expressions() -> Callable[[bytes], None]:
    """An expectation, judged on a series."""
    series = np.array([1.0, np.nan, 3.0])

    def run(data: bytes) -> None:
        try:
            tree = parse(data.decode("utf-8", "replace"))
            list(names_of(tree))
            evaluate(tree, lambda name: series)
        except ExpressionError:
            return

    return run


def file_reader(suffix: str, read: Callable[[Path], object]) -> Callable[[bytes], None]:
    """A target that reads a file with that ending; only a refusal by name may be raised."""
    folder = Path(tempfile.mkdtemp(prefix="lidaremu-fuzz-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    path = folder / f"fuzz{suffix}"

    def run(data: bytes) -> None:
        path.write_bytes(data)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                read(path)
            except EmulatorError:
                return

    return run


def meshes(suffix: str) -> Callable[[bytes], None]:
    """A mesh file with that ending."""
    from emulator.world import mesh_files

    return file_reader(suffix, lambda path: mesh_files.load(path, None, 1.0, "fuzz.yaml:1"))


def recordings(suffix: str) -> Callable[[bytes], None]:
    """A recording with that ending."""
    return file_reader(suffix, read_wire)


def scenario_seeds() -> Sequence[bytes]:
    """Scenarios that hold."""
    more = "weather: {fog: {visibility_m: 100}}\nexpect:\n  - {that: front.scans_per_s, within: [37.4, 37.6]}\n"
    return (soak_text(1, objects="loop:objects").encode(), (soak_text(2, objects="loop:objects") + more).encode())


def mesh_seeds(suffix: str) -> Sequence[bytes]:
    """Small meshes that hold, in that format."""
    corners = np.array(TRIANGLE, dtype="<f4").tobytes()
    if suffix == ".obj":
        return (b"o a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nusemtl b\nf 1 2 3\nf 2//1 3/1/1 -1 1\n",)
    if suffix == ".ply":
        head = "ply\nformat {} 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
        head += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
        faces = b"\x03" + np.arange(3, dtype="<i4").tobytes()
        plain = b"0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
        return (head.format("ascii").encode() + plain, head.format("binary_little_endian").encode() + corners + faces)
    if suffix == ".stl":
        text = "solid a\nfacet normal 0 0 1\nouter loop\n"
        text += "".join(f"vertex {x} {y} {z}\n" for x, y, z in TRIANGLE) + "endloop\nendfacet\nendsolid a\n"
        return (bytes(80) + b"\x01\0\0\0" + bytes(12) + corners + b"\0\0", text.encode())
    tree: dict[str, Any] = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "a", "children": [1]}, {"mesh": 0, "translation": [1, 0, 0]}],
        "materials": [{"name": "body"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0, "mode": 4}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]},
            {"bufferView": 1, "componentType": 5123, "count": 3, "type": "SCALAR"},
        ],
        "bufferViews": [{"buffer": 0, "byteLength": 36}, {"buffer": 0, "byteOffset": 36, "byteLength": 6}],
        "buffers": [{"byteLength": 42}],
    }
    data = corners + np.arange(3, dtype="<u2").tobytes()
    if suffix == ".gltf":
        tree["buffers"][0]["uri"] = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
        return (json.dumps(tree).encode(),)
    text_chunk = json.dumps(tree).encode()
    text_chunk += b" " * (-len(text_chunk) % 4)
    data += bytes(-len(data) % 4)
    sizes = [12 + 8 + len(text_chunk) + 8 + len(data), len(text_chunk), len(data)]
    whole, first, second = (size.to_bytes(4, "little") for size in sizes)
    return (b"glTF\2\0\0\0" + whole + first + b"JSON" + text_chunk + second + b"BIN\0" + data,)


def recording_seeds(suffix: str) -> Sequence[bytes]:
    """Small recordings that hold, in that format."""
    folder = Path(tempfile.mkdtemp(prefix="lidaremu-fuzz-"))
    path = folder / f"seed{suffix}"
    frames = [LoggedFrame(10**9 + n * 10**6, 0x60A + n, bytes(range(n)), "can0") for n in range(5)]
    try:
        if suffix in (".blf", ".asc"):
            write_with_library([path], frames)
        elif suffix == ".log":
            path.write_text("".join(candump_line(frame) for frame in frames))
        elif suffix == ".pcapng":
            writer = PcapngWriter(path, "front tcp:127.0.0.1:49152")
            for number in range(4):
                writer.add(number * 10**6, bytes(range(40)), True, 49_152, 1, number % 2 > 0)
            writer.close()
        elif suffix == ".pcap":
            path.write_bytes(_pcap())
        elif suffix == ".mcap":
            return example_mcaps()
        else:
            path.write_bytes(b"\x02\x80\x03\x00\xa0\x00\x10\x16\x0a")
        return (path.read_bytes(),)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _pcap() -> bytes:
    from emulator.recording.pcapng import TCP, _ipv4

    segment = (49_152).to_bytes(2, "big") + b"\x04\x00" + bytes(8) + b"\x50\x18" + bytes(6) + b"hello"
    packet = _ipv4(TCP, segment)
    head = bytes.fromhex("d4c3b2a1 02000400 00000000 00000000 ffff0000 65000000")
    return head + bytes(8) + len(packet).to_bytes(4, "little") * 2 + packet
