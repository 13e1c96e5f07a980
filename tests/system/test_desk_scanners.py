"""lds2d (PyPI), unmodified, on pseudo-terminals of LDROBOT and YDLIDAR; at a wrong line speed it reads garbage."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from tests.system.conftest import TIME_LIMIT_S, RunningDaemon, daemons

WALL_M = 2.0
SCENE = """\
schema: 1
seed: 1
world:
  - {plane: {size_m: [6, 60]}, at_m: [2, 0, 1], pitch_deg: -90, material: white_plaster}
sensors:
"""
SENSOR = "  - {id: %s, model: %s, mount: {at_m: [0, 0, 1]}, physics: {false_alarms: false}, links: ['pty:./%s']}\n"
MODELS = {"LD19": "ldrobot-ld19", "LD06": "ldrobot-ld06", "YDLIDAR-X2": "ydlidar-x2", "YDLIDAR-X4": "ydlidar-x4"}


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningDaemon]:
    folder = tmp_path_factory.mktemp("desk")
    sensors = [(model.rpartition("-")[2], model, model) for model in MODELS.values()]
    (folder / "wall.yaml").write_text(SCENE + "".join(SENSOR % one for one in sensors), encoding="utf-8")
    with daemons(folder) as start:
        yield start("wall.yaml", "--control", str(folder / "control"))


@pytest.mark.parametrize("theirs", MODELS)
def test_lds2d_sees_the_wall(running: RunningDaemon, theirs: str) -> None:
    from lds2d import Lidar

    path = running.path(MODELS[theirs].rpartition("-")[2])
    lidar: Any = Lidar.open(theirs, path)
    try:
        if "X4" in theirs:
            lidar.start()
        found = []
        for scan in lidar.scans():
            found.append(scan)
            if len(found) == 6:
                break
        for scan in found[3:]:
            angle = np.radians([one.angle_deg for one in scan])
            mm = np.array([one.dist_mm for one in scan])
            ahead = (np.cos(angle) > 0.7) & (mm > 0)
            assert ahead.sum() > 0.2 * len(angle)
            error = np.abs(mm[ahead] / 1000.0 - WALL_M / np.cos(angle[ahead]))
            assert np.percentile(error, 97) < 0.06, "six sigma"
            assert (mm[np.cos(angle) < -0.1] == 0).all()
        if "X4" in theirs:
            lidar.stop()
    finally:
        lidar.close()


def test_at_the_wrong_speed_no_packet_is_read(running: RunningDaemon) -> None:
    import serial

    with serial.Serial(running.path("ld19"), 115_200, timeout=TIME_LIMIT_S) as port:
        data = port.read(4000)
        assert len(data) == 4000
        assert data.count(b"\x54\x2c") < 20, "of 85"
        port.baudrate = 230_400
        until = time.monotonic() + TIME_LIMIT_S
        while port.read(4000).count(b"\x54\x2c") < 80:
            assert time.monotonic() < until
