"""Livox-SDK2 by py-livox2 0.1 (MIT) reads packets of all patterns, without discovery, off a real port."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from protocols.livox.codec import decode
from tests.protocols.livox.test_device import NAMES, Rig, facts_for

pytest.importorskip("livox_sdk", reason="py-livox2 has no wheel for this Python")
pytestmark = pytest.mark.timeout(60)
LIDAR = "127.0.0.12"
POINTS_PORT = 56_300
"From which the SDK takes points."
PACKETS = 20
"Of each pattern: one each time, after the last has been read."

POINT = np.dtype([("xyz", "<i4", 3), ("reflectivity", "u1"), ("tag", "u1")])
"LivoxLidarCartesianHighRawPoint of livox_lidar_def.h, packed."


def test_the_makers_sdk_reads_what_was_measured() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asked:
        asked.bind(("127.0.0.1", 0))
        port = int(asked.getsockname()[1])
    with subprocess.Popen(
        [sys.executable, str(Path(__file__).with_name("livox_judge.py")), str(port), LIDAR],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    ) as judge:  # fmt: skip
        assert judge.stdin is not None
        assert judge.stdout is not None
        try:
            assert judge.stdout.readline() == "ready\n"
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as lidar:
                lidar.bind((LIDAR, POINTS_PORT))
                for name in NAMES:
                    for one in Rig(facts_for(name)).run(100_000_000)[:PACKETS]:
                        lidar.sendto(one.payload, ("127.0.0.1", port))
                        row, ours = json.loads(judge.stdout.readline()), decode(one.payload)
                        assert ours is not None
                        points = np.frombuffer(bytes.fromhex(row["data"]), POINT)
                        assert (row["points"], row["stamp_ns"]) == (len(ours.xyz_m), ours.stamp_ns)
                        assert row["interval"] * 100 == ours.interval_ns
                        seen = points["xyz"].any(axis=1)
                        assert points["xyz"][seen][:, 0] == pytest.approx(8000.0, abs=0.51)  # the wall of the rig [mm]
                        np.testing.assert_array_equal(points["xyz"] / 1000.0, ours.xyz_m)
                        np.testing.assert_array_equal(points["reflectivity"], ours.reflectivity)
            judge.stdin.close()
            assert judge.wait(10.0) == 0
        finally:
            judge.kill()
