"""The hosts of RPLIDARs: turns of every form in any chunking, damage counted, a device in any state brought to send."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from emulator.hosts.rplidar import RplidarHost, RplidarScript, name_of
from emulator.hosts.rplidar_reading import Reader, Reply, Turn
from emulator.hosts.scans import HostScan
from protocols.rplidar.models import MODELS
from tests.hosts.test_scip_host import End
from tests.protocols.rplidar.rig import MS, SECOND, Rig, points_of, request, room

NAMES = {"a1m8": "A1M8", "a2m8": "A2M8", "a2m12": "A2M12", "a3m1": "A3M1", "s1m1": "S1M1", "s2m1": "S2M1",
         "s3m1": "S3M1", "c1m1": "C1M1"}  # fmt: skip


def agrees(scan: HostScan) -> None:
    """A square room of 6 m by 6 m."""
    assert (np.diff(scan.azimuth_rad) >= 0.0).all()
    true = 3.0 / np.maximum(np.abs(np.cos(scan.azimuth_rad)), np.abs(np.sin(scan.azimuth_rad)))
    np.testing.assert_allclose(scan.range_m, true, atol=0.02)


@pytest.mark.parametrize("before", [b"", request(0x20), request(0x82, b"\x01" + bytes(4)), b"\xa5\x82\x05"])
@pytest.mark.parametrize("model", sorted(MODELS))
def test_the_host_streams_whatever_the_device_did_before(before: bytes, model: str) -> None:
    rig = Rig(model, world=room)
    rig.put(before)
    rig.run(100 * MS)
    line: Any = End(rig)  # type: ignore[arg-type]
    host = RplidarHost(line, 115_200)
    assert host.title == f"RPLIDAR {NAMES[model[8:]]}"
    scans = host.scans(0.5)
    for _ in range(2):
        scan = next(scans)
        assert scan is not None
        agrees(scan)
    assert host.errors == 0
    host.close()
    rig.run(SECOND)
    assert line.closed
    assert rig.session.next_plan() is None


def test_a_probe_asks_for_the_name_alone() -> None:
    rig = Rig("rplidar-a2m8")
    line: Any = End(rig)  # type: ignore[arg-type]
    host = RplidarHost(line, None)
    assert (host.title, host.found_baud) == ("RPLIDAR A2M8", 115_200)
    rig.run(SECOND)
    assert rig.session.rotor.hz == 0.0


def test_the_script_asks_again_after_a_restart_and_whatever_the_mode() -> None:
    for model in ("rplidar-a1m8", "rplidar-s2m1", "rplidar-c1m1"):
        rig = Rig(model, world=room)
        seen: list[HostScan] = []
        line: Any = End(rig)  # type: ignore[arg-type]
        script = RplidarScript(line, lambda now_ns, scan, seen=seen: seen.append(scan))  # type: ignore[misc]
        for _ in range(2):
            until_ns = rig.now_ns + 5 * SECOND
            before = len(seen)
            while rig.now_ns < until_ns:
                script.step(rig.now_ns)
            assert len(seen) - before > 15, model
            rig.session.power_on(rig.now_ns)
        agrees(seen[-1])


def stream(mode: int, world: Any = room) -> bytes:
    rig = Rig("rplidar-s2m1", {"extra_modes": True}, world=world)
    return rig.ask(request(0x82, bytes([mode, 0, 0, 0, 0])) if mode else request(0x20), SECOND)


@pytest.mark.parametrize("mode", [0, 1, 2, 3])
@pytest.mark.parametrize("chunk", [1, 100, 10_000])
def test_turns_are_the_same_in_any_chunking_and_as_another_decoder_reads_them(mode: int, chunk: int) -> None:
    data = stream(mode)
    data = data if chunk > 1 else data[:30_000]
    reader = Reader()
    turns = [one for at in range(0, len(data), chunk) for one in reader.feed(data[at : at + chunk])]
    assert reader.errors == 0
    found = np.concatenate([turn.mm for turn in turns if isinstance(turn, Turn)])
    size = {0: 5, 1: 84, 2: 170, 3: 781}[mode]
    points = points_of(data[6], data[7 : 7 + (len(data) - 7) // size * size])
    first = np.flatnonzero(np.diff([point.angle for point in points]) < -180.0)[0] + 1
    np.testing.assert_allclose(found, [point.mm for point in points][first : first + len(found)])
    assert len(found) > 800


@pytest.mark.parametrize("mode", [0, 1, 2])
def test_a_lost_byte_costs_a_group_or_two_and_is_counted(mode: int) -> None:
    data = stream(mode)
    reader = Reader()
    whole = sum(len(one.mm) for one in Reader().feed(data) if isinstance(one, Turn))
    left = sum(len(one.mm) for one in reader.feed(data[:9_000] + data[9_001:]) if isinstance(one, Turn))
    assert reader.errors > 0
    assert whole - 2 * 64 - 1 <= left <= whole


def test_replies_are_found_behind_text_and_no_length_is_believed() -> None:
    reader = Reader()
    data = b"RP LIDAR System.\r\n\xa5\x5a\x03\0\0\0\x06\x01\x02\x03"
    assert list(reader.feed(data)) == [Reply(0x06, b"\x01\x02\x03")]
    assert list(reader.feed(b"\xa5\x5a\xff\xff\xff\x3f\x06" + data[-10:])) == [Reply(0x06, b"\x01\x02\x03")]
    assert reader.errors == 1


def test_names_are_those_of_the_sdk() -> None:
    assert [name_of(bytes((byte,))) for byte in (0x18, 0x71, 0x41, 0x2C)] == [
        "RPLIDAR A1M8", "RPLIDAR S2M1", "RPLIDAR C1M1", "RPLIDAR A2M12"]  # fmt: skip
