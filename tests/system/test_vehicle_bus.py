"""A stock python-can client and cantools read the ego's speed from a run, in real and in virtual time."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

SCENE = """
schema: 1
actors: [{id: ego, motion: {velocity_m_s: [10, 0, 0]}}]
vehicle_bus:
  link: "socketcand:127.0.0.1:0/can0"
  dbc: "builtin:vehicle.dbc"
  actor: ego
  messages: {VehicleMotion: {signals: {Speed: speed_km_h, YawRate: yaw_rate_deg_s, Counter: counter}}}
"""
READER = """
import os, sys, can, cantools
host, port = os.environ["LIDAREMU_VEHICLE_BUS"].rpartition("socketcand:")[2].partition("/")[0].split(":")
bus = can.Bus(interface="socketcand", host=host, port=int(port), channel="can0")
dbc = cantools.database.load_file(sys.argv[1])
seen = []
while len(seen) < 50:
    message = bus.recv(20.0)
    seen.append(dbc.decode_message(message.arbitration_id, message.data))
bus.shutdown()
first = int(seen[0]["Counter"])
assert [one["Counter"] for one in seen] == [(first + n) % 16 for n in range(50)], seen
assert all(abs(one["Speed"] - 36.0) <= 0.005 and one["YawRate"] == 0.0 for one in seen), seen
print("read", len(seen))
"""


@pytest.mark.parametrize("clock", ["real", "virtual"])
def test_a_stock_client_reads_the_speed(clock: str, tmp_path: Path) -> None:
    (tmp_path / "scene.yaml").write_text(SCENE)
    dbc = Path(__file__).parents[2] / "scenarios" / "vehicle.dbc"
    words = [sys.executable, "-m", "emulator", "run", str(tmp_path / "scene.yaml"), "--clock", clock, "--json"]
    ran = subprocess.run(
        [*words, "--duration", "60", "--", sys.executable, "-c", READER, str(dbc)],
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )
    assert ran.returncode == 0, ran.stderr
    assert "read 50" in ran.stderr
    rows = [json.loads(line) for line in ran.stdout.splitlines()]
    end = next(row for row in rows if row["event"] == "stopped")
    assert end["sensors"][0]["vehicle_bus"]["frames"]["VehicleMotion"] >= 50
