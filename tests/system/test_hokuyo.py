"""Strangers as judges of SCIP: hokuyolx (PyPI) and MRPT's CHokuyoURG, unmodified; a host of its own on the terminal."""

from __future__ import annotations

import math
import os
import select
import subprocess
import tty
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.system.conftest import TIME_LIMIT_S, RunningDaemon, daemons, prompt

pytestmark = pytest.mark.timeout(900)  # the first who wants the drivers builds them, perhaps on a busy machine
HOST, DAEMON = prompt()
WALL_M = 8.0
UNIT_M = 0.002
"The footprint's nearest part and the rounding to a millimetre. Without noise: which scans a host has is chance here."
SCENE = """\
schema: 1
seed: 1
world:
  - {plane: {size_m: [6, 60]}, at_m: [8, 0, 1], pitch_deg: -90, material: white_plaster}
sensors:
"""
SENSOR = (
    "  - {id: %s, model: %s, mount: {at_m: [0, 0, 1]}, physics: {false_alarms: false, noise: false}, links: ['%s']}\n"
)


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningDaemon]:
    folder = tmp_path_factory.mktemp("scip")
    sensors = [("usb", "hokuyo-utm-30lx", "pty:./usb"), ("ew", "hokuyo-utm-30lx-ew", "tcp:127.0.0.1:0"),
               ("ust", "hokuyo-ust-20lx", "tcp:127.0.0.1:0")]  # fmt: skip
    (folder / "wall.yaml").write_text(SCENE + "".join(SENSOR % one for one in sensors), encoding="utf-8")
    with daemons(folder) as start:
        yield start("wall.yaml", "--control", str(folder / "control"), *DAEMON)


def port(running: RunningDaemon, sensor: str) -> int:
    return int(running.link(sensor).rpartition(":")[2])


def azimuths(count: int = 1081) -> np.ndarray:
    return np.radians((np.arange(count) - 540) * 0.25)


def agrees(range_m: np.ndarray, azimuth_rad: np.ndarray) -> None:
    """Straight at the wall the ranges are the true ones, behind the scanner there is nothing."""
    ahead = np.abs(azimuth_rad) < math.radians(20.0)
    assert np.abs(range_m[ahead] - WALL_M / np.cos(azimuth_rad[ahead])).max() < UNIT_M
    assert not np.any(range_m[np.abs(azimuth_rad) > math.radians(95.0)] > 0.1)


def test_hokuyolx_synchronises_measures_sleeps_and_restarts(running: RunningDaemon) -> None:
    from hokuyolx import HokuyoLX

    laser: Any = HokuyoLX(addr=("127.0.0.1", port(running, "ust")), timeout=TIME_LIMIT_S, time_tolerance=60_000)
    try:
        assert (laser.model, laser.dmin, laser.dmax, laser.amax, laser.scan_freq) == ("UST-20LX", 20, 60_000, 1080, 40)
        assert laser.laser_state()[0] == 3
        _, scan = laser.get_dist()
        agrees(np.where(scan > 60_000, 0, scan) / 1000.0, laser.get_angles())
        _, pairs = laser.get_intens(grouping=3)
        assert pairs.shape == (361, 2)
        assert pairs[180, 1] > 50
        counted = [(len(scan), pending) for scan, _, pending in laser.iter_dist(3, skips=1)]
        assert counted == [(1081, 2), (1081, 1), (1081, 0)]
        laser.standby()
        assert laser.laser_state()[0] == 0
        laser.sleep()
        assert laser.laser_state()[0] == 5
        laser.standby()
        laser.reset()
        laser.partial_reset()
        laser.reboot()
    finally:
        laser.close()


@pytest.mark.parametrize("sensor", ["usb", "ew"])
def test_mrpt_connects_and_sees_the_wall(running: RunningDaemon, mrpt: Path, sensor: str) -> None:
    where = running.path("usb") if sensor == "usb" else f"tcp:{port(running, 'ew')}"
    words = [*HOST, str(mrpt / "hokuyo_host"), where, "3", str(TIME_LIMIT_S)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=2 * TIME_LIMIT_S, check=False)
    scans = [line.split() for line in done.stdout.splitlines() if line.startswith("scan ")]
    assert (done.returncode, len(scans)) == (0, 3), done.stdout[-2000:] + done.stderr[-2000:]
    for _, aperture, count, *ranges in scans:
        assert float(aperture) == pytest.approx(math.radians(270.25), abs=1e-5)
        assert int(count) == 1081
        agrees(np.array([float(one) for one in ranges]), azimuths())


def test_a_host_of_twenty_lines_reads_true_ranges_on_the_terminal(running: RunningDaemon) -> None:
    port = os.open(running.path("usb"), os.O_RDWR | os.O_NOCTTY)
    held = b""

    def reply() -> list[bytes]:
        nonlocal held
        while b"\n\n" not in held:
            assert select.select([port], [], [], TIME_LIMIT_S)[0]
            held += os.read(port, 65536)
        one, _, held = held.partition(b"\n\n")
        return one.split(b"\n")

    try:
        tty.setraw(port)
        os.write(port, b"QT\n")
        while reply()[0] != b"QT":
            pass
        os.write(port, b"MD0000108001003\n")
        assert reply() == [b"MD0000108001003", b"00P"]
        for left in (b"02", b"01", b"00"):
            echo, status, *lines = reply()
            assert (echo, status) == (b"MD00001080010" + left, b"99b")
            assert all(sum(line[:-1]) % 64 + 48 == line[-1] for line in lines)
            text = b"".join(line[:-1] for line in lines[1:])
            words = np.frombuffer(text, np.uint8).reshape(-1, 3).astype(int) - 48
            agrees((words @ [4096, 64, 1]) / 1000.0, azimuths())
    finally:
        os.close(port)
