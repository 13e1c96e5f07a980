"""The parts of the brake example: its host reads what the device says, its car and its brake do what they are told."""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

FOLDER = Path(__file__).resolve().parents[2] / "docs/examples/brake"


@pytest.fixture
def car(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    monkeypatch.syspath_prepend(FOLDER)
    import car

    yield car
    sys.modules.pop("car", None)


@pytest.fixture
def host(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    monkeypatch.syspath_prepend(FOLDER)
    import lms_host

    yield lms_host
    sys.modules.pop("lms_host", None)


class Port:
    def __init__(self, data: bytes, piece: int) -> None:
        self.data, self.piece, self.written = data, piece, b""

    def read(self, most: int) -> bytes:
        out, self.data = self.data[: self.piece], self.data[self.piece :]
        return out

    def write(self, data: bytes) -> None:
        self.written += data


def braked(car: ModuleType, friction: float) -> float:
    mine, t = car.Car(20.0, friction), 0.0
    mine.demand(0.0, math.inf)
    while mine.speed > 0:
        mine.move(t, 0.001)
        t += 0.001
    return float(mine.x)


@pytest.mark.parametrize("road", ["dry", "wet", "snow"])
def test_a_car_stops_after_delay_ramp_and_braking_distance(car: ModuleType, road: str) -> None:
    most = car.FRICTION[road] * car.GRAVITY
    ramp = most / 40.0
    slower = 20.0 - 0.5 * most * ramp
    want = 20.0 * 0.15 + 20.0 * ramp - most * ramp**2 / 6 + slower**2 / (2 * most)
    assert braked(car, car.FRICTION[road]) == pytest.approx(want, rel=0.003)


def test_the_brake_wants_three_scans_in_a_row_and_two_echoes_in_the_lane(car: ModuleType) -> None:
    wall = [(20.0, 0.1), (20.1, -0.2)]
    brake = car.Brake()
    assert [brake.see(points, 10.0) for points in (wall, wall, [], wall, wall)] == [False] * 5
    assert brake.see(wall, 10.0)
    assert brake.at == 20.0
    assert brake.see([], 10.0), "it holds"
    for wrong in ([(20.0, 0.1)], [(20.0, 3.0), (20.1, 2.0)], [(26.0, 0.0), (26.1, 0.0)]):
        brake = car.Brake()
        assert not any([brake.see(wrong, 10.0) for _ in range(9)])


@pytest.mark.parametrize("piece", [1, 5, 1000])
def test_the_host_reads_scans_in_any_pieces(host: ModuleType, monkeypatch: pytest.MonkeyPatch, piece: int) -> None:
    payload = b"\xb0" + (5).to_bytes(2, "little") + b"".join(v.to_bytes(2, "little") for v in (800, 0x1FFF, 900, 1, 2))
    frame = b"\x02\x80" + (len(payload) + 1).to_bytes(2, "little") + payload + b"\x10"
    frame += host.crc(frame).to_bytes(2, "little")
    port = Port(b"\x06\x02\x80" + frame[:-1] + b"\x00" + frame + frame, piece)
    monkeypatch.setattr(host.serial, "Serial", lambda *_, **__: port)
    mine = host.LmsHost("port", 100, 25)
    mine.start()
    assert port.written == bytes.fromhex("020002002024") + b"\x34\x08"
    scans = [scan for _ in range(100) for scan in mine.scans()]
    assert len(scans) == mine.count == 2
    assert [round(math.hypot(*point), 6) for point in scans[0]] == [8.0, 9.0, 0.01, 0.02]
    assert math.degrees(math.atan2(*scans[0][0][::-1])) == pytest.approx(-50)


def test_a_campaigns_driver_starts_without_numpy() -> None:
    # a process for every case: numpy alone takes as long as a second of the scanner
    driver = FOLDER.parent / "campaign/braking.py"
    heavy = "{'numpy', 'argparse', 'tempfile', 'concurrent.futures', 'emulator.live.json_lines'}"
    code = f"import runpy, sys; runpy.run_path({str(driver)!r}); print(sorted({heavy} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert done.stdout == "[]\n", done.stderr
