"""`lidaremu check` of strangers' meshes, as its user runs it: a line for each, in little memory and time."""

from __future__ import annotations

import json
import os
import struct
import subprocess
import sys
from pathlib import Path

from tests.hostile.test_files import gltf
from tests.hostile.test_meshes import EMPTY, SQUARE, sparse, written

MOST_BYTES = 500_000_000
"Of the largest process; Python with its libraries takes 80 MB of it, or 210 MB where a scene is built."
MOST_CPU_S = 60.0
"All of them take 7 s on a free machine; the worst alone took 18 s, or 24 GB."


def test_hostile_meshes_cost_little_and_are_told(tmp_path: Path) -> None:
    written(tmp_path / "zeros.gltf", EMPTY)
    nodes = [{"children": [n + 1], "translation": [0, 0, 1e-3]} for n in range(49_999)]
    written(tmp_path / "chain.gltf", {"nodes": [*nodes, {"mesh": 0}]})
    sparse(tmp_path / "holes.stl", bytes(80) + struct.pack("<I", 19_000_000), 84 + 50 * 19_000_000)
    (tmp_path / "digits.obj").write_bytes(SQUARE + b"f 1 2 " + b"9" * 100_000)
    (tmp_path / "deep.gltf").write_bytes(b"[" * 60_000_000)
    os.mkfifo(tmp_path / "pipe.obj")
    (tmp_path / "sound.gltf").write_text(json.dumps(gltf()), encoding="utf-8")
    names = ["zeros.gltf", "holes.stl", "digits.obj", "deep.gltf", "pipe.obj", "chain.gltf", "sound.gltf"]
    for name in names:
        text = {"schema": 1, "world": [{"mesh": name, "material": "brick"}]}
        (tmp_path / f"{name}.yaml").write_text(json.dumps(text), encoding="utf-8")
    command = [sys.executable, "-m", "emulator", "check", *(f"{name}.yaml" for name in names)]
    here = str(Path(__file__).resolve().parents[2])
    environment = os.environ | {"PYTHONPATH": here, "LIDAREMU_COMPILED": "0"}
    with (tmp_path / "out").open("wb") as out:
        process = subprocess.Popen(command, cwd=tmp_path, stdout=out, stderr=out, env=environment)
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    lines = (tmp_path / "out").read_text(encoding="utf-8").splitlines()
    assert process.returncode == 2, lines
    reported = ["without data", "19000000 triangles", "100000 characters", "commas and brackets", "not a regular file"]
    assert len(lines) == len(names)
    for name, line, want in zip(names, lines, [*reported, "ok: 0 sensors", "ok: 0 sensors"], strict=True):
        assert line.startswith(f"{name}.yaml:")
        assert want in line
    assert used.ru_maxrss * 1024 < MOST_BYTES
    assert used.ru_utime + used.ru_stime < MOST_CPU_S
