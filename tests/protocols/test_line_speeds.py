"""Hosts at a wrong speed of the line: garbage both ways, each driver's search for the speed, and its negotiation."""

from __future__ import annotations

import struct

import pytest

from emulator.hosts.ldrobot import PacketReader
from protocols.ldrobot import MODELS as LDROBOT
from protocols.rplidar.models import MODELS as RPLIDAR
from protocols.ydlidar.models import MODELS as YDLIDAR
from tests.protocols.line_rig import MS, SECOND, LineRig

SLAMTEC = (115_200, 256_000, 460_800, 1_000_000)
"As the launch files of sllidar_ros2 try them, model by model."
EAI = (115_200, 128_000, 230_400, 512_000)
INFO, STOP, RESET = b"\xa5\x50", b"\xa5\x25", b"\xa5\x40"
INFO_HEAD = bytes.fromhex("A5 5A 14 00 00 00 04")


def confirmation(bps: int) -> bytes:
    text = b"\xa5\x90\x08" + struct.pack("<HIH", 0x5F5F, bps, 0)
    total = 0
    for one in text:
        total ^= one
    return text + bytes((total,))


@pytest.mark.parametrize("model", sorted(RPLIDAR))
def test_a_host_that_tries_all_speeds_finds_an_rplidar_at_its_own_alone(model: str) -> None:
    rig = LineRig("rplidar", model, {"boot_s": 0.1})
    rig.run(200 * MS)
    found = []
    for baud in (*SLAMTEC, *SLAMTEC):
        host = rig.host(baud)
        if INFO_HEAD in rig.ask(host, STOP + INFO, 60 * MS):
            found.append(baud)
        host.close(rig.now_ns)
    assert found == [RPLIDAR[model].baud] * 2, "what came at other speeds has not upset it"


@pytest.mark.parametrize("model", sorted(set(YDLIDAR) - {"ydlidar-x2"}))
def test_a_host_that_tries_all_speeds_finds_a_ydlidar_at_its_own_alone(model: str) -> None:
    rig = LineRig("ydlidar", model, {"boot_s": 0.1, "spin_up_s": 0.0})
    rig.run(200 * MS)
    found = []
    for baud in (*EAI, *EAI):
        host = rig.host(baud)
        rig.ask(host, b"\xa5\x00\xa5\x65", 20 * MS)
        if INFO_HEAD in rig.ask(host, b"\xa5\x90", 60 * MS):
            found.append(baud)
            assert bytes.fromhex("A5 5A 05 00 00 40 81 AA 55") in rig.ask(host, b"\xa5\x60", 500 * MS)
            rig.ask(host, b"\xa5\x65", 20 * MS)
        host.close(rig.now_ns)
    assert found == [YDLIDAR[model].baud] * 2


@pytest.mark.parametrize("model", sorted(LDROBOT))
def test_an_ldrobot_is_read_at_its_own_speed_alone(model: str) -> None:
    rig = LineRig("ldrobot", model, {"spin_up_s": 0.0})
    rig.run(200 * MS)
    hosts = {baud: rig.host(baud) for baud in (115_200, 230_400, 460_800, 921_600)}
    rig.run(400 * MS)
    valid = {baud: len(list(PacketReader().feed(host.read()))) for baud, host in hosts.items()}
    assert [baud for baud, count in valid.items() if count > 100] == [LDROBOT[model].baud]
    assert sorted(valid.values())[-2] < 8, "a sum of 8 bits fits by chance"


@pytest.mark.parametrize("asked", [19_200, 38_400, 115_200])
@pytest.mark.parametrize("true", [19_200, 38_400, 57_600, 115_200])
def test_urg_c_finds_the_speed_of_an_rs232_scanner_and_sets_its_own(asked: int, true: int) -> None:
    """Its search: the asked speed first, then 19200, 38400, 115200, QT at each; where it answered, SS to the asked."""
    rig = LineRig("scip", "hokuyo-urg-04lx", {"port": "rs232", "baud": true, "boot_s": 0.0, "spin_up_s": 0.0})
    rig.run(20 * MS)
    at = None
    host = rig.host(asked)
    for baud in (asked, *(one for one in (19_200, 38_400, 115_200) if one != asked)):
        host.baud = baud
        if rig.ask(host, b"QT\n", 140 * MS).endswith(b"QT\n00P\n\n"):
            at = baud
            break
    assert at == (true if true != 57_600 else None), "57600 is not among those that it tries"
    if at is None:
        return
    if at != asked:
        assert rig.ask(host, b"SS%06d\n" % asked, 140 * MS) == b"SS%06d\n00P\n\n" % asked
        host.baud = asked
    assert rig.ask(host, b"VV\n", 250 * MS).startswith(b"VV\n00P\nVEND:Hokuyo")


@pytest.mark.parametrize("model", ["rplidar-c1m1", "rplidar-a2m12"])
@pytest.mark.parametrize("baud", [115_200, 128_000, 230_400, 256_000, 460_800, 512_000])
def test_a_host_s_speed_is_measured_by_a_run_of_41_and_kept_when_it_is_confirmed(model: str, baud: int) -> None:
    """custom_baudrate of rplidar_sdk: STOP, reopen, blocks of 16 bytes for 1.5 s at most, u32, confirmation."""
    rig = LineRig("rplidar", model, {"boot_s": 0.0})
    rig.run(20 * MS)
    host = rig.host(baud)
    said, blocks = b"", 0
    while len(said) < 4 and blocks < 100:
        said += rig.ask(host, b"\x41" * 16, MS)
        blocks += 1
    assert struct.unpack("<I", said) == (baud,), said
    assert 4 <= blocks < 12, "64 bytes, at the pace of the line"
    assert rig.ask(host, confirmation(baud), 20 * MS) == b""
    assert INFO_HEAD in rig.ask(host, INFO, 20 * MS)
    rig.run(2 * SECOND)
    assert INFO_HEAD in rig.ask(host, INFO, 20 * MS), "it is kept"
    rig.ask(host, RESET, 100 * MS)
    own = rig.host(RPLIDAR[model].baud)
    assert INFO_HEAD in rig.ask(own, INFO, 20 * MS), "until the next start"


def test_a_measured_speed_that_is_not_confirmed_is_left_after_half_a_second() -> None:
    rig = LineRig("rplidar", "rplidar-c1m1", {"boot_s": 0.0})
    rig.run(20 * MS)
    host, own = rig.host(256_000), rig.host(460_800)
    assert struct.pack("<I", 256_000) in rig.ask(host, b"\x41" * 64, 20 * MS)
    assert INFO_HEAD in rig.ask(host, INFO, 20 * MS)
    rig.run(500 * MS)
    assert INFO_HEAD not in rig.ask(host, INFO, 20 * MS)
    assert INFO_HEAD in rig.ask(own, INFO, 20 * MS)
    assert INFO_HEAD not in rig.ask(host, confirmation(256_000) + INFO, 20 * MS), "too late"


@pytest.mark.parametrize(("model", "baud", "run"), [
    ("rplidar-a1m8", 256_000, b"\x41" * 200), ("rplidar-c1m1", 1_500_000, b"\x41" * 200),
    ("rplidar-c1m1", 256_000, b"\x41" * 63 + b"\x42" + b"\x41" * 63),
])  # fmt: skip
def test_what_is_no_run_or_of_no_speed_that_it_measures_changes_nothing(model: str, baud: int, run: bytes) -> None:
    rig = LineRig("rplidar", model, {"boot_s": 0.0})
    rig.run(20 * MS)
    host, own = rig.host(baud), rig.host(RPLIDAR[model].baud)
    rig.ask(host, run, 50 * MS)
    assert INFO_HEAD in rig.ask(own, INFO + INFO, 20 * MS)
