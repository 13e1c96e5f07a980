"""Hosts of LDROBOT and YDLIDAR: the speed of the line is found, turns are those of the world, a restart is survived."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from emulator.errors import LinkError
from emulator.hosts.describe import Speaker, describe
from emulator.hosts.ldrobot import LdrobotHost, LdrobotScript
from emulator.hosts.scans import HostScan
from emulator.hosts.turns import MOST, TurnAssembler
from emulator.hosts.ydlidar import YdlidarHost, YdlidarScript
from tests.protocols.turning_rig import LINE, MS, SECOND, Rig

SPEED = {"ldrobot-ld19": 230_400, "ldrobot-stl-27l": 921_600, "ydlidar-x2": 115_200, "ydlidar-x4": 128_000,
         "ydlidar-g4": 230_400, "ydlidar-tg15": 512_000, "ydlidar-t-mini": 230_400}  # fmt: skip


class End:
    """A host's end of a line to a rig: at another speed both ends get noise, and time passes while the host reads."""

    def __init__(self, rig: Rig, speed: int) -> None:
        self.rig, self.speed, self.baud, self.closed = rig, speed, speed, False
        self.written = b""

    def set_baud(self, baud: int) -> None:
        self.baud = baud

    def write(self, data: bytes, at_ns: int = 0) -> int:
        self.written += data
        self.rig.session.receive(data if self.baud == self.speed else b"\x00\xf8", self.rig.now_ns, LINE)
        return len(data)

    def read(self, timeout_s: float = 0.0) -> bytes:
        for _ in range(1 + round(timeout_s / 0.005)):
            self.rig.run(5 * MS)
            if data := self.rig.raw():
                return data if self.baud == self.speed else bytes(one * 7 & 0xFF for one in data)
        return b""

    def close(self) -> None:
        self.closed = True


def rig_and_end(model: str, device: dict[str, Any] | None = None) -> tuple[Rig, Any]:
    rig = Rig(model.partition("-")[0], model, device)
    return rig, End(rig, SPEED[model])


def check(scan: HostScan, offset: float = 0.06) -> None:
    angle = np.degrees(-scan.azimuth_rad) % 360.0
    there = ~np.isnan(scan.range_m) & (angle < 349.0) & (angle > 1.0)
    assert there.sum() > 0.9 * len(angle)
    error = np.abs(scan.range_m[there] - (1.0 + 0.01 * angle[there]))
    assert np.percentile(error, 97) < 0.001
    assert error.max() < 0.02


class Clock:
    """Time of the rig, for hosts that wait."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig

    def now_ns(self) -> int:
        return self.rig.now_ns


@pytest.mark.parametrize("model", sorted(SPEED))
@pytest.mark.parametrize("baud", [9600, None])
def test_the_host_finds_speed_and_turns(model: str, baud: int | None, monkeypatch: pytest.MonkeyPatch) -> None:
    rig, end = rig_and_end(model)
    place = "ldrobot" if "ldrobot" in model else "ydlidar"
    monkeypatch.setattr(f"emulator.hosts.{place}.SystemClock", lambda: Clock(rig))
    rig.run(2 * SECOND)
    rig.raw()
    made = LdrobotHost if place == "ldrobot" else YdlidarHost
    host = made(end, baud)
    assert host.found_baud == SPEED[model]
    assert host.listens == (place == "ldrobot" or model == "ydlidar-x2")
    named = {"ydlidar-x2": "YDLIDAR (sends only)", "ydlidar-t-mini": "YDLIDAR T-MINI, firmware 1.5"}
    assert host.title == named.get(model, host.title)
    if baud is None and not host.listens:
        assert rig.session.next_plan() is None, "asked for its name, and left alone"
        assert b"\xa5\x60" not in end.written
        return
    found: list[HostScan] = []
    for scan in host.scans(1.0):
        assert scan is not None
        found.append(scan)
        if len(found) == 5:
            break
    for scan in found[2:]:
        check(scan)
        assert (scan.intensity is None) == (model in ("ydlidar-x2", "ydlidar-x4", "ydlidar-g4", "ydlidar-tg15"))
    host.close()
    rig.run(SECOND)
    assert end.closed
    assert (rig.session.next_plan() is None) == (not host.listens)


@pytest.mark.parametrize("model", sorted(SPEED))
def test_the_script_finds_it_and_finds_it_again_after_a_restart(model: str) -> None:
    rig, end = rig_and_end(model)
    end.baud = 9600
    seen: list[tuple[int, HostScan]] = []
    script: Any = (LdrobotScript if "ldrobot" in model else YdlidarScript)(end, lambda *one: seen.append(one))
    for _ in range(2):
        began_ns, before = rig.now_ns, len(seen)
        while len(seen) - before <= 25 and rig.now_ns < began_ns + 10 * SECOND:
            script.step(rig.now_ns)
        assert len(seen) - before > 25, "within ten seconds"
        check(seen[-1][1])
        rig.session.power_on(rig.now_ns)


def test_nothing_that_sends_is_no_device(monkeypatch: pytest.MonkeyPatch) -> None:
    rig, end = rig_and_end("ldrobot-ld19", {"spin_up_s": 60})
    for place in ("ldrobot", "ydlidar"):
        monkeypatch.setattr(f"emulator.hosts.{place}.SystemClock", lambda: Clock(rig))
    with pytest.raises(LinkError, match="no LDROBOT packet"):
        LdrobotHost(end, None)
    with pytest.raises(LinkError, match="no YDLIDAR answers"):
        YdlidarHost(end, None)


def test_turns_end_where_the_angle_passes_zero() -> None:
    turns, found = TurnAssembler(), []
    angle = np.arange(0.0, 1500.0, 0.7) + 100.0
    for at in range(0, len(angle), 11):
        part = angle[at : at + 11] % 360.0
        found += list(turns.add(part, 1.0 + part / 100.0, None))
    assert [len(one.range_m) for one in found] == [514, 514, 515]
    assert found[0].azimuth_rad[0] == pytest.approx(0.0, abs=np.radians(0.7))
    assert found[0].azimuth_rad[100] < 0.0, "clockwise is to the right"
    stuck = TurnAssembler()
    for _ in range(MOST // 1000 + 2):
        assert list(stuck.add(np.full(1000, 5.0), np.ones(1000), None)) == []
    assert list(stuck.add(np.zeros(0), np.zeros(0), None)) == []


def test_bytes_are_taken_apart() -> None:
    rig, _ = rig_and_end("ldrobot-ld19")
    rig.run(2 * SECOND)
    names = [one.name for one in describe(Speaker("ldrobot"), rig.take()[0].payload)]
    assert names == ["speed", "angles", "distances", "intensities", "time stamp"]
    assert describe(Speaker("ldrobot"), b"\x54\x2c\x00")[0].unit.startswith("no whole packet")
    assert describe(Speaker("ldrobot"), b"\x54\xa0", sent=False)[0].unit.startswith("ignored")
    assert describe(Speaker("ydlidar"), b"\xa5\x60\xa5\x90", sent=False)[1].value == "a5 90: device info"
    assert describe(Speaker("ydlidar"), b"\x01", sent=False)[0].unit == "no command"
    reply = describe(Speaker("ydlidar"), bytes.fromhex("A5 5A 03 00 00 00 06 00 00 00"))
    assert [one.value for one in reply] == ["06", "00 00 00"]
    rig, _ = rig_and_end("ydlidar-x2")
    rig.run(2 * SECOND)
    data = b"".join(one.payload for one in rig.take()[:2])
    assert [one.name for one in describe(Speaker("ydlidar"), data)][:3] == ["type", "angles", "words"]
    assert describe(Speaker("ydlidar"), b"\xaa\x55\x00")[0].unit.startswith("no whole packet")
