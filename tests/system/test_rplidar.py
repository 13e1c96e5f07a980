"""Strangers as judges of RPLIDAR, unmodified: pyrplidarsdk (PyPI, with the maker's SDK) on pty and UDP, and
rplidar-roboticia, a client in Python that switches the motor by DTR, under the shim."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from emulator.transports.shim import find_compiler
from tests.system.conftest import TIME_LIMIT_S, RunningDaemon, daemons
from tests.system.nursery import ran

HALF_M = 2.0
SCENE = """\
schema: 1
seed: 1
world:
  - {plane: {size_m: [6, 8]}, at_m: [2, 0, 1], pitch_deg: -90, material: white_plaster}
  - {plane: {size_m: [6, 8]}, at_m: [-2, 0, 1], pitch_deg: -90, material: white_plaster}
  - {plane: {size_m: [8, 6]}, at_m: [0, 2, 1], roll_deg: 90, material: white_plaster}
sensors:
"""
SENSOR = "  - {id: %s, model: %s, mount: {at_m: [0, 0, 1]}, physics: {false_alarms: false}, links: ['%s']}\n"
JUDGE = """\
import json, sys
from pyrplidarsdk import RplidarDriver
words = json.loads(sys.argv[1])
for _ in range(8):  # on a busy machine an answer may come after the SDK's limit of 0.5 s
    driver = RplidarDriver(**words)
    if driver.connect():
        break
info, health = driver.get_device_info(), driver.get_health()
assert driver.start_scan()
turns, tries = [], 0
while len(turns) < 3 and tries < 60:
    tries += 1
    turn = driver.get_scan_data()
    if turn and len(turn[0]) > 50:
        turns.append([list(map(float, column)) for column in turn])
    elif tries % 10 == 0:  # the same limit, for the answer to this command
        driver.stop_scan()
        driver.start_scan()
driver.stop_scan()
driver.disconnect()
told = {name: str(getattr(info, name)) for name in dir(info) if not name.startswith("_")}
print(json.dumps({"info": told, "health": str(getattr(health, "status", health)), "turns": turns}))
"""


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningDaemon]:
    folder = tmp_path_factory.mktemp("rplidar")
    udp = f"udp:127.0.0.1:{free_port()}?listen={free_port()}"
    sensors = [("a1", "rplidar-a1m8", "pty:./a1"), ("s2", "rplidar-s2m1", "pty:./s2"),
               ("c1", "rplidar-c1m1", "pty:./c1"), ("net", "rplidar-s2m1", udp)]  # fmt: skip
    (folder / "room.yaml").write_text(SCENE + "".join(SENSOR % one for one in sensors), encoding="utf-8")
    with daemons(folder) as start:
        yield start("room.yaml", "--control", str(folder / "control"))


def judged(words: dict[str, object]) -> dict[str, Any]:
    done = subprocess.run(
        [sys.executable, "-c", JUDGE, json.dumps(words)],
        capture_output=True, text=True, timeout=4 * TIME_LIMIT_S, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


@pytest.mark.parametrize(("sensor", "baud", "model", "points", "most_m"), [
    ("a1", 115_200, 24, (850, 1100), 0.06),
    ("s2", 1_000_000, 113, (2500, 2950), 0.06),
    ("c1", 460_800, 65, (400, 480), 0.06),
])  # fmt: skip
def test_the_maker_s_sdk_reads_the_room_at_each_speed(
    running: RunningDaemon, sensor: str, baud: int, model: int, points: tuple[int, int], most_m: float
) -> None:
    reads_the_room(judged({"port": str(running.path(sensor)), "baudrate": baud}), model, points, most_m)


def reads_the_room(found: dict[str, Any], model: int, points: tuple[int, int], most_m: float) -> None:
    """Three turns with as many points as the motor's speed leaves, where the walls are; the SDK drops no-returns."""
    assert found["info"]["model"] == str(model)
    assert len(found["turns"]) == 3
    for turn in found["turns"]:
        angle, range_m = np.array(turn[0]), np.array(turn[1])
        assert points[0] < len(angle) < points[1]
        true = HALF_M / np.maximum(np.maximum(np.abs(np.cos(angle)), -np.sin(angle)), 1e-9)
        off = np.abs(range_m - true)
        assert np.percentile(off, 99) < most_m, "but for the edges of walls"
        assert np.median(off) < 0.012


def test_the_maker_s_sdk_reads_the_room_over_udp(running: RunningDaemon) -> None:
    words = {"ip_address": "127.0.0.1", "udp_port": int(running.link("net").rpartition(":")[2])}
    reads_the_room(judged(words), 113, (2500, 2950), 0.06)


CLIENT = """\
import json, sys, time
from rplidar import RPLidar, RPLidarException
lidar = RPLidar(sys.argv[1])
for _ in range(50):  # its boot text comes first
    try:
        info, health = lidar.get_info(), lidar.get_health()
        if isinstance(info, dict) and not isinstance(health, str):
            break
    except RPLidarException:
        pass
    time.sleep(0.2)
    lidar.clean_input()
turns = {}
for kind in ("normal", "express"):
    found = []
    for turn in lidar.iter_scans(kind, max_buf_meas=False, min_len=50):
        found.append([[angle, mm] for _, angle, mm in turn])
        if len(found) == 4:
            break
    turns[kind] = found[2:]
    lidar.stop()
    lidar.clean_input()
lidar.stop_motor()
lidar.disconnect()
print(json.dumps({"info": info, "health": health, "turns": turns}))
"""


@pytest.mark.skipif(find_compiler(os.environ) is None, reason="no C compiler here")
def test_a_client_in_python_that_switches_dtr_reads_the_room_under_the_shim(tmp_path: Path) -> None:
    (tmp_path / "room.yaml").write_text(SCENE + SENSOR % ("a1", "rplidar-a1m8", "pty:./a1"), encoding="utf-8")
    (tmp_path / "client.py").write_text(CLIENT, encoding="utf-8")
    words = ["run", "room.yaml", "--shim", "--", sys.executable, "client.py", "./a1"]
    done = ran(*words, cwd=tmp_path, seconds=120)
    assert done.returncode == 0, done.stdout[-1000:] + done.stderr[-2000:]
    found = json.loads(next(line for line in (done.stdout + done.stderr).splitlines() if line.startswith("{")))
    assert (found["info"]["model"], found["health"]) == (24, ["Good", 0])
    step_deg = 360.0 * 7.0 * 254e-6  # of express capsules it gives each sample the angle of the next one
    for kind, least, late_deg in (("normal", 180, 0.0), ("express", 360, step_deg)):
        for turn in found["turns"][kind]:
            angle, mm = np.array(turn).T
            seen = mm > 0
            assert seen.sum() > least
            ray = np.radians(angle[seen] - late_deg)
            true = HALF_M / np.maximum(np.maximum(np.abs(np.cos(ray)), -np.sin(ray)), 1e-9)
            off = np.abs(mm[seen] / 1000.0 - true)
            assert np.median(off) < 0.012
            assert np.percentile(off, 95) < 0.06
