"""A stranger as judge: MRPT's CLMS100Eth, unmodified, as Debian ships it, polls an LMS111 over TCP."""

from __future__ import annotations

import math
import socket
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.protocols.cola.reader import ask_a, ask_b, frames, read
from tests.system.conftest import TIME_LIMIT_S, prompt

pytestmark = pytest.mark.timeout(900)  # the first who wants the drivers builds them, perhaps on a busy machine
WALL = """\
schema: 1
seed: 1
world:
  - {plane: {size_m: [6, 60]}, at_m: [8, 0, 1], pitch_deg: -90, material: white_plaster}
sensors:
  - id: front
    model: sick-lms111
    mount: {at_m: [0, 0, 1]}
    device: {ready_s: 1}
    physics: {false_alarms: false}
    links: ["tcp:127.0.0.1:0", "tcp:127.0.0.1:0"]
"""
NOISE_M = 0.008
"Of the model."


def seen_right(ranges_m: np.ndarray, step_deg: float) -> None:
    """A wall 8 m ahead, out to 45 degrees on both sides; (scans, points)."""
    azimuth = np.radians(np.arange(ranges_m.shape[1]) * step_deg - 135.0)
    near = np.abs(azimuth) < math.radians(45.0)
    assert np.all(np.abs(ranges_m[:, near] * np.cos(azimuth[near]) - 8.0) < 0.12)
    ahead = np.abs(azimuth) < math.radians(5.0)
    assert np.mean(ranges_m[:, ahead] * np.cos(azimuth[ahead])) == pytest.approx(8.0, abs=0.02)


class Host:
    """Speaks one dialect over a socket; decodes with the tests' own reader."""

    def __init__(self, port: int) -> None:
        self._socket = socket.create_connection(("127.0.0.1", port), TIME_LIMIT_S)
        self._held = b""

    def ask(self, data: bytes) -> bytes:
        self._socket.sendall(data)
        return self.next()[1]

    def next(self) -> tuple[str, bytes]:
        while not (size := self._size()):
            data = self._socket.recv(1 << 16)
            assert data, "the device has hung up"
            self._held += data
        telegram, self._held = self._held[:size], self._held[size:]
        return frames(telegram)[0]

    def _size(self) -> int:
        if self._held.startswith(b"\x02\x02\x02\x02"):
            size = 9 + int.from_bytes(self._held[4:8], "big")
            return size if len(self._held) >= max(8, size) else 0
        return self._held.find(b"\x03") + 1

    def __enter__(self) -> Host:
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()


def test_two_hosts_and_then_mrpt_see_the_wall(daemon: Callable[..., Any], mrpt: Path, tmp_path: Path) -> None:
    (tmp_path / "wall.yaml").write_text(WALL, encoding="utf-8")
    favour, options = prompt()
    running = daemon("wall.yaml", *options)
    ports = [int(running.link("front", index).rpartition(":")[2]) for index in (0, 1)]
    with Host(ports[0]) as text, Host(ports[1]) as binary:
        while True:  # deaf while it starts
            try:
                text._socket.settimeout(1.0)
                assert text.ask(ask_a("sMN SetAccessMode 03 F4724744")) == b"sAN SetAccessMode 1"
                break
            except TimeoutError:
                continue
        text._socket.settimeout(TIME_LIMIT_S)
        assert text.ask(ask_a("sWN LMDscandatacfg 01 00 1 1 0 00 00 0 0 0 0 +1")) == b"sWA LMDscandatacfg"
        assert text.ask(ask_a("sEN LMDscandata 1")) == b"sEA LMDscandata 1"
        assert binary.ask(ask_b("sEN LMDscandata", "01")) == b"sEA LMDscandata \x01"
        for host, dialect in ((text, "A"), (binary, "B")):
            reported = [host.next() for _ in range(10)]
            assert {one for one, _ in reported} == {dialect}
            scans = [read(*one) for one in reported]
            seen_right(np.array([scan.mm() for scan in scans]) / 1000.0, 0.5)
            assert all(min(scan.mm("RSSI1")[240:300]) > 0 for scan in scans)
    words = [*favour, str(mrpt / "mrpt_lms100"), str(ports[0]), "20", str(TIME_LIMIT_S)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=3 * TIME_LIMIT_S, check=False)
    assert done.returncode == 0, done.stdout[-2000:]
    scans = [line.split() for line in done.stdout.splitlines() if line.startswith("scan ")]
    polled = np.array([[float(word) for word in line[5:]] for line in scans if line[4] == "1081"])
    assert len(polled) >= 10
    seen_right(polled, 0.25)
    assert running.stop() == 0
    assert "Traceback" not in running.errors
