"""A stranger's mesh is read in a process of its own: what ends that process costs the file, and one line tells it."""

from __future__ import annotations

import json
import os
import resource
import signal
import struct
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from emulator.config.budgets import MESH, MESH_LIMITS
from emulator.errors import SceneError
from emulator.scenario import scenario
from emulator.world import mesh_files, reading_apart, scene
from emulator.world.reading_apart import Reader
from emulator.world.triangles import Geometry
from tests.hostile.test_files import gltf

MB = 1_000_000
SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nusemtl a\nf 1 2 3\nusemtl b\nf 1 3 4\n"


@pytest.fixture
def reader() -> Iterator[Reader]:
    with Reader(MESH) as made:
        yield made


@pytest.fixture
def square(tmp_path: Path) -> Path:
    path = tmp_path / "square.obj"
    path.write_text(SQUARE, encoding="utf-8")
    return path


def reported_of(reader: Reader, path: Path) -> str:
    with pytest.raises(SceneError) as caught:
        reader.read(path, None, 1.0, "case.yaml:3")
    reported = str(caught.value)
    assert reported.startswith(f"case.yaml:3: {path.name}: ")
    assert "\n" not in reported
    return reported


def instead(monkeypatch: pytest.MonkeyPatch, act: Callable[[], Any]) -> None:
    """What a process that reads does in place of reading `bad.obj`."""
    load = mesh_files.load

    def reads(path: Path, *rest: Any) -> Geometry:
        if path.name == "bad.obj":
            act()
        return load(path, *rest)

    monkeypatch.setattr(mesh_files, "load", reads)


def test_what_is_read_apart_is_what_is_read_here(tmp_path: Path, reader: Reader, square: Path) -> None:
    (tmp_path / "a.gltf").write_text(json.dumps(gltf()), encoding="utf-8")
    shipped = Path(scenario.__file__).parents[2] / "scenarios" / "meshes" / "car.glb"
    for path in (square, tmp_path / "a.gltf", shipped):
        ours, theirs = mesh_files.load(path, "y", 0.5, "x"), reader.read(path, "y", 0.5, "x")
        for name in ("vertices", "faces", "face_part", "normals", "closed", "centre"):
            here, there = getattr(ours, name), getattr(theirs, name)
            assert here.dtype == there.dtype
            np.testing.assert_array_equal(here, there)
        for name in ("parts", "radius", "dropped", "coplanar"):
            assert getattr(ours, name) == getattr(theirs, name)


def test_one_process_reads_all_files_and_is_gone_afterwards(reader: Reader, square: Path) -> None:
    reader.read(square, None, 1.0, "x")
    first = reader._pid
    with pytest.raises(SceneError, match=r"x: .*none.obj: no such file; want a mesh file"):
        reader.read(square.with_name("none.obj"), None, 1.0, "x")
    reader.read(square, None, 1.0, "x")
    assert reader._pid == first
    reader.close()
    with pytest.raises(ProcessLookupError):
        os.kill(first, 0)
    assert len(reader.spent) == 1


@pytest.mark.parametrize(
    ("act", "reported"),
    [
        (lambda: os.kill(os.getpid(), signal.SIGSEGV), "process was terminated by SIGSEGV; want a sound file"),
        (lambda: os.kill(os.getpid(), signal.SIGKILL), "was terminated by SIGKILL (out of memory?); want a sound file"),
        (lambda: os.abort(), "was terminated by SIGABRT"),
        (lambda: os._exit(3), "the reading process ended with code 3"),
        (lambda: exit(3), "the reading process ended with code 1"),
        (lambda: 1 / 0, "the reading process ended with code 1"),
        (lambda: bytearray(20 * MESH.memory_bytes), "the reading process ended with code 1"),
    ],
)
def test_whatever_ends_the_process_is_told_and_the_next_file_is_read(
    monkeypatch: pytest.MonkeyPatch, reader: Reader, square: Path, act: Callable[[], Any], reported: str
) -> None:
    instead(monkeypatch, act)
    assert reported in reported_of(reader, square.with_name("bad.obj"))
    assert len(reader.read(square, None, 1.0, "x").faces) == 2


def test_a_process_has_its_memory_and_no_more(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "bad.stl"
    count = 6_000_000  # 300 MB, and twice as much when it is read: more than what the parent has free
    with path.open("wb") as file:
        file.write(bytes(80) + struct.pack("<I", count))
        file.truncate(84 + 50 * count)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    with Reader(replace(MESH, memory_bytes=150 * MB)) as reader:
        reported = reported_of(reader, path)
    assert "does not fit in memory; want a mesh that needs at most 150000000 bytes" in reported
    assert f"{MESH_LIMITS}=memory_bytes=N allows more" in reported
    assert reader.spent[0].peak_bytes < before + 200 * MB


def test_a_process_has_its_time_and_no_more(monkeypatch: pytest.MonkeyPatch, square: Path) -> None:
    def turns() -> None:
        while True:
            pass

    instead(monkeypatch, turns)
    with Reader(replace(MESH, cpu_s=1)) as reader:
        reported = reported_of(reader, square.with_name("bad.obj"))
        assert "more than 1 s of processor time; want at most 1 s" in reported
        assert f"{MESH_LIMITS}=cpu_s=N allows more" in reported
        assert reader.spent[0].cpu_s < 4.0
        assert len(reader.read(square, None, 1.0, "x").faces) == 2


def test_a_process_that_waits_is_not_waited_for(monkeypatch: pytest.MonkeyPatch, square: Path) -> None:
    monkeypatch.setattr(reading_apart, "TIME_LIMIT", 0)
    monkeypatch.setattr(reading_apart, "TIME_LIMIT_S", 0.2)
    instead(monkeypatch, signal.pause)
    with Reader(replace(MESH, cpu_s=1)) as reader:
        assert "not read within 0.2 s" in reported_of(reader, square.with_name("bad.obj"))


def test_the_time_of_one_file_is_not_that_of_the_next(monkeypatch: pytest.MonkeyPatch, square: Path) -> None:
    asked: list[int] = []
    monkeypatch.setattr(reading_apart, "_lower", lambda what, soft: asked.append(soft))
    reading_apart._limit_time(7)
    used = resource.getrusage(resource.RUSAGE_SELF)
    assert asked[0] >= int(used.ru_utime + used.ru_stime) + 7


def test_the_process_prints_nothing_and_holds_nothing_of_its_parent(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], square: Path
) -> None:
    def looks() -> None:
        os.write(1, b"noise")
        os.write(2, b"noise")
        held = [name for name in os.listdir("/proc/self/fd") if int(name) > 2]
        raise SceneError(f"x: bad.obj: {len(held)} held, core {resource.getrlimit(resource.RLIMIT_CORE)[0]}")

    instead(monkeypatch, looks)
    with square.open("rb"), Reader(MESH) as reader, pytest.raises(SceneError, match="2 held, core 0"):
        reader.read(square.with_name("bad.obj"), None, 1.0, "x")  # its line, and the folder that it lists
    assert capfd.readouterr() == ("", "")


HEAD = {
    "ok": True,
    "vertices": 3,
    "faces": 1,
    "parts": ["a"],
    "radius": 1.0,
    "centre": [0, 0, 0],
    "dropped": 0,
    "coplanar": 0,
}
ARRAYS = (np.zeros((3, 3)), np.array([[0, 1, 2]], np.int32), np.zeros(1, np.int32), np.zeros((1, 3)), np.ones(1, bool))


@pytest.mark.parametrize(
    ("head", "arrays"),
    [
        (HEAD | {"vertices": 10**12}, ARRAYS),
        (HEAD | {"faces": -1}, ARRAYS),
        (HEAD | {"faces": "x"}, ARRAYS),
        (HEAD | {"centre": [0]}, ARRAYS),
        (HEAD | {"parts": 7}, ARRAYS),
        (HEAD | {"parts": []}, ARRAYS),
        ({"ok": True}, ARRAYS),
        ([], ARRAYS),
        (HEAD, (ARRAYS[0], np.array([[0, 1, 3]], np.int32), *ARRAYS[2:])),
        (HEAD, (*ARRAYS[:2], np.array([-1], np.int32), *ARRAYS[3:])),
    ],
)
def test_an_answer_that_is_none_is_not_taken(
    monkeypatch: pytest.MonkeyPatch, square: Path, head: Any, arrays: tuple[np.ndarray, ...]
) -> None:
    def answers(line: Any, asked: Any, budget: Any) -> None:
        reading_apart._send(line, head)
        for array in arrays:
            line.sendall(array.tobytes())

    monkeypatch.setattr(reading_apart, "_answer", answers)
    with Reader(MESH) as reader:
        assert "invalid answer" in reported_of(reader, square)


def test_a_process_ends_with_its_parent(monkeypatch: pytest.MonkeyPatch, square: Path) -> None:
    """The kernel ends it in the midst of a file: `kill -9` of the parent leaves nothing."""
    pipe = square.with_name("pipe")
    os.mkfifo(pipe)

    def turns() -> None:
        pipe.write_text(str(os.getpid()))
        while True:
            pass

    instead(monkeypatch, turns)
    middle = os.fork()
    if not middle:
        try:
            with Reader(MESH) as reader:
                reader.read(square.with_name("bad.obj"), None, 1.0, "x")
        finally:
            os._exit(1)
    pid = int(pipe.read_text())
    os.kill(middle, signal.SIGKILL)
    os.waitpid(middle, 0)
    for _ in range(10_000_000):  # it is no child of ours: look until it has gone
        try:
            if Path(f"/proc/{pid}/stat").read_text().rpartition(") ")[2][0] == "Z":
                break
        except (FileNotFoundError, ProcessLookupError):
            break
    else:
        pytest.fail("still there")


# ---------------------------------------------------------------- scenes


def built(folder: Path, *meshes: str) -> scene.Scene:
    world = [{"mesh": name, "material": "brick"} for name in meshes]
    return scene.build(scenario.loads(json.dumps({"schema": 1, "world": world}), folder / "a.yaml"))


def test_files_of_a_scenario_are_read_apart_and_those_of_the_package_are_not(
    monkeypatch: pytest.MonkeyPatch, square: Path
) -> None:
    here: list[str] = []
    load = mesh_files.load

    def noted(path: Path, *rest: Any, **more: Any) -> Any:
        here.append(path.name)
        return load(path, *rest, **more)

    monkeypatch.setattr(mesh_files, "load", noted)
    world = built(square.parent, "square.obj", "builtin:car.glb")
    assert here == ["car.glb"]  # the other one's name is appended in another process
    assert len(world.bodies[0].faces) == 2


def test_a_mesh_that_vanishes_between_two_looks_is_told(square: Path) -> None:
    config = scenario.loads(
        '{"schema": 1, "world": [{"mesh": "square.obj", "material": "brick"}]}', square.parent / "a.yaml"
    )
    square.unlink()
    with pytest.raises(SceneError, match=r"a.yaml:1: world\[0\].mesh: .*square.obj: no such file"):
        scene.build(config)


def test_the_environment_holds_for_a_scene(monkeypatch: pytest.MonkeyPatch, square: Path) -> None:
    monkeypatch.setenv(MESH_LIMITS, "triangles=1")
    with pytest.raises(
        SceneError, match=r"square.obj: line 8: more than 1 triangles \(LIDAREMU_MESH_LIMITS=triangles=N"
    ):
        built(square.parent, "square.obj")
    monkeypatch.setenv(MESH_LIMITS, "triangels=1")
    with pytest.raises(SceneError, match="'triangels=1'; want NAME=NUMBER"):
        built(square.parent, "square.obj")


def test_files_after_the_limit_of_a_scene_are_not_read(monkeypatch: pytest.MonkeyPatch, square: Path) -> None:
    monkeypatch.setattr(scene, "MOST_TRIANGLES", 3)
    monkeypatch.setenv(MESH_LIMITS, "triangles=2")
    names = []
    for number in range(20):
        names.append(f"s{number}.obj")
        (square.parent / names[-1]).write_text(SQUARE, encoding="utf-8")
    asked: list[str] = []
    read = Reader.read
    monkeypatch.setattr(Reader, "read", lambda self, path, *rest: (asked.append(path.name), read(self, path, *rest))[1])
    with pytest.raises(SceneError, match="4 triangles in all; want at most 3"):
        built(square.parent, *names)
    assert asked == ["s0.obj", "s1.obj"]
