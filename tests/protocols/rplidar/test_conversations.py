"""Conversations in virtual time: start-ups of drivers, requests in every state, motor, health, boot, line speed."""

from __future__ import annotations

import struct
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocols.errors import DeviceSettingError
from protocols.rplidar import FAMILY
from protocols.rplidar.commands import COMMANDS
from protocols.rplidar.models import MODELS
from protocols.session import Address, DropReason, LinkKind
from tests.protocols.lds2d_reader import turns
from tests.protocols.rplidar.rig import (
    LINE,
    MS,
    SECOND,
    SIZES,
    Rig,
    points_of,
    request,
    restarts,
    room,
)

SCAN, FORCE, STOP, RESET, INFO, HEALTH, RATE = (request(code) for code in (0x20, 0x21, 0x25, 0x40, 0x50, 0x52, 0x59))
PWM, RPM = request(0xF0, struct.pack("<H", 660)), request(0xA8, struct.pack("<H", 600))
SERIAL = "A0A1A2A3A4A5A6A7A8A9AAABACADAEAF"


def express(mode: int) -> bytes:
    return request(0x82, bytes([mode, 0, 0, 0, 0]))


def conf(entry: int, mode: int | None = None) -> bytes:
    return request(0x84, struct.pack("<I", entry) + (b"" if mode is None else struct.pack("<H", mode)))


def turning(model: str, **device: object) -> Rig:
    rig = Rig(model, device)
    rig.ask(PWM + RPM, 20 * MS)
    return rig


def whole(kind: int, data: bytes) -> bytes:
    return data[: len(data) // SIZES[kind] * SIZES[kind]]


@pytest.mark.parametrize(("asked", "answer"), [
    (INFO, "A5 5A 14 00 00 00 04 18 1D 01 07 " + SERIAL),
    (HEALTH, "A5 5A 03 00 00 00 06 00 00 00"),
    (RATE, "A5 5A 04 00 00 00 15 FC 01 FE 00"),
    (conf(0x7C), "A5 5A 06 00 00 00 20 7C 00 00 00 03 00"),
    (conf(0x71, 3), "A5 5A 08 00 00 00 20 71 00 00 00 00 7F 00 00"),
    (conf(0x75, 3), "A5 5A 05 00 00 00 20 75 00 00 00 84"),
    (conf(0x7F, 3), "A5 5A 10 00 00 00 20 7F 00 00 00 53 65 6E 73 69 74 69 76 69 74 79 00"),
    (conf(0x12345), "A5 5A 04 00 00 00 20 45 23 01 00"),
    (STOP, ""),
    (request(0x60), ""),
    (conf(0x7C)[:-1] + b"\0", ""),
])  # fmt: skip
@pytest.mark.parametrize("chunk", [1, 3, 100])
def test_worked_exchanges_of_the_specification(asked: bytes, answer: str, chunk: int) -> None:
    rig = Rig(device={"serial_number": SERIAL, "turn_hz": 10})
    for at in range(0, len(asked), chunk):
        rig.put(asked[at : at + chunk])
    rig.run(2 * MS)
    assert rig.raw() == bytes.fromhex(answer)


def test_more_worked_exchanges() -> None:
    assert turning("rplidar-a2m8").ask(request(0xFF, bytes(4))).hex(" ") == "a5 5a 04 00 00 00 ff 01 00 00 00"
    assert turning("rplidar-c1m1").ask(request(0xFF, bytes(4))).endswith(bytes(4))
    assert Rig().ask(request(0xFF, bytes(4))) == b""
    assert turning("rplidar-a2m8").conf(0x01) == bytes.fromhex("58 02 94 02")


@pytest.mark.parametrize("model", sorted(MODELS))
def test_the_sdk_finds_every_mode_and_each_streams_at_its_rate(model: str) -> None:
    """Conversation of rplidar_sdk: count, name, rate, range, answer; then the mode itself."""
    rig = turning(model)
    (count,) = struct.unpack("<H", rig.conf(0x70))
    assert struct.unpack("<H", rig.conf(0x7C))[0] < count
    for mode in range(count):
        number = struct.pack("<H", mode)
        (us,) = struct.unpack("<I", rig.conf(0x71, number))
        assert us > 0
        assert rig.conf(0x7F, number).endswith(b"\0")
        (kind,) = rig.conf(0x75, number)
        asked = SCAN if kind == 0x81 else express(mode)
        found, data = rig.stream(asked, SECOND)
        points = points_of(kind, whole(kind, data))
        if mode or kind == 0x81:
            assert found == kind
            line = SIZES[kind] * 10e6 / MODELS[model].baud / {0x81: 1, 0x82: 32, 0x84: 96, 0x85: 40}[kind]
            assert len(points) == pytest.approx(1e6 / max(us / 256.0, line), rel=0.04)
        seen = [point for point in points if point.mm]
        assert len(seen) > 0.7 * len(points)
        error = [abs(point.mm - (1000.0 + 10.0 * point.angle)) for point in seen if point.angle < 359.0]
        assert max(error) < 7.4, "the specification's own responder"
        assert not any(10.0 < point.angle < 299.0 for point in points if not point.mm), "no sample is lost"
        assert rig.ask(STOP, 50 * MS)[: SIZES[kind]] is not None
        assert rig.ask(b"", 100 * MS) == b""
    assert rig.conf(0x71, struct.pack("<H", count)) == b""
    assert rig.dropped().count(DropReason.BAD_CHECKSUM) == 0


@pytest.mark.parametrize(("kind", "number"), [(0x86, 2), (0x83, 3)])
def test_the_extra_modes_are_of_the_newest_forms(kind: int, number: int) -> None:
    rig = turning("rplidar-s2m1", extra_modes=True)
    found, data = rig.stream(express(number), SECOND)
    assert found == kind
    points = points_of(kind, whole(kind, data))
    assert max(abs(point.mm - (1000.0 + 10.0 * point.angle)) for point in points if point.mm) < 3.0
    assert max(point.quality for point in points) > 0
    assert rig.stream(request(0x83, bytes(33)), SECOND)[0] == 0x83


SDK_A1 = [INFO, INFO, HEALTH, conf(1), STOP, INFO, INFO, conf(0x7C), STOP, INFO,
          *(conf(e, 3) for e in (0x71, 0x74, 0x75)), conf(0x7F, 3), conf(1), express(3)]  # fmt: skip
SDK_A2 = [
    INFO,
    request(0xFF, bytes(4)),
    INFO,
    HEALTH,
    PWM,
    STOP,
    request(0xF0, bytes(2)),
    INFO,
    conf(0x7C),
    PWM,
    express(3),
]
SDK_S = [INFO, HEALTH, conf(1), RPM, STOP, INFO, conf(0x7C), conf(0x79), express(1)]
SDK_C1 = [INFO, request(0xFF, bytes(4)), HEALTH, STOP, INFO, conf(0x7C), conf(0x71, 0), SCAN]
ROBOTICIA = [INFO, HEALTH, PWM, HEALTH, SCAN]
PYRPLIDARSDK = [INFO, HEALTH, STOP, INFO, INFO, conf(0x7C), STOP, INFO, conf(0x75, 3), express(3)]


@pytest.mark.parametrize(("model", "trace"), [
    ("rplidar-a1m8", SDK_A1), ("rplidar-a2m12", SDK_A2), ("rplidar-a3m1", SDK_A2), ("rplidar-s2m1", SDK_S),
    ("rplidar-s3m1", SDK_S), ("rplidar-c1m1", SDK_C1), ("rplidar-a1m8", ROBOTICIA), ("rplidar-a1m8", PYRPLIDARSDK),
    ("rplidar-c1m1", [HEALTH, HEALTH, SCAN]),
])  # fmt: skip
def test_start_ups_of_drivers_are_answered_and_end_in_data(model: str, trace: list[bytes]) -> None:
    rig = Rig(model, {"spin_up_s": 1.0})
    for asked in trace[:-1]:
        said = rig.ask(asked, 5 * MS)
        silent = asked == STOP or asked[1] in (0xF0, 0xA8)
        assert (said == b"") == silent, asked
    said = rig.ask(trace[-1], 5 * MS)
    assert len(said) == 7, "the descriptor comes at once, data when the motor is at speed"
    assert len(rig.ask(b"", 3 * SECOND)) > 5000


def test_turns_have_as_many_samples_as_the_motor_leaves_and_each_has_one_start() -> None:
    counts = {}
    for rpm in (480, 600, 900):
        rig = Rig("rplidar-c1m1")
        rig.ask(request(0xA8, struct.pack("<H", rpm)))
        kind, data = rig.stream(SCAN, 3 * SECOND)
        points = points_of(kind, whole(kind, data))
        starts = [at for at, point in enumerate(points) if point.start]
        lengths = np.diff(starts)
        assert len(set(lengths.tolist())) > 1, "angles are measured: turns are not of one length"
        hz = min(rpm / 60.0, 12.0)
        assert lengths.mean() == pytest.approx(5000.0 / hz, rel=0.01)
        assert lengths.std() / lengths.mean() < 0.01
        for first, end in pairwise(starts):
            angles = [point.angle for point in points[first:end]]
            assert angles == sorted(angles)
            assert angles[0] < 360.0 * hz / 5000.0 + 0.1 or angles[0] > 359.9
        assert starts[0] > 0, "the first turn has begun before the scan, and has no start"
        counts[rpm] = lengths.mean()
    assert counts[480] > counts[600] > counts[900]


def test_capsules_have_the_flag_only_at_the_start_of_a_stream() -> None:
    rig = Rig(world=room)
    kind, data = rig.stream(express(1), 2 * SECOND)
    flags = restarts([data[at : at + 84] for at in range(0, len(whole(kind, data)), 84)])
    assert flags[0]
    assert not any(flags[1:])


def test_data_leaves_when_its_last_sample_is_measured() -> None:
    rig = Rig()
    rig.put(SCAN)
    rig.run(SECOND)
    sent = [one for one in rig.sent if one.label == "81"]
    first = rig.plans[0].start_ns
    number = 0
    for one in sent:
        number += len(one.payload) // 5
        assert one.due_ns - first == pytest.approx(number * 508_000, abs=2_000)
        assert len(one.payload) <= 4 * 5
    carried = [one.sweep for one in sent if one.sweep is not None]
    assert carried == list(range(carried[0], carried[0] + len(carried)))


@pytest.mark.parametrize("code", sorted(set(COMMANDS) - {b"\xa8", b"\xf0", b"\x20", b"\x21", b"\x82", b"\x83"}))
def test_any_request_but_those_of_the_motor_ends_a_scan(code: bytes) -> None:
    rig = Rig()
    rig.stream(SCAN, SECOND)
    rig.ask(request(code[0]) if code[0] < 0x80 else request(code[0], struct.pack("<I", 0x7C)), 50 * MS)
    rig.raw()
    assert len(rig.ask(b"", 200 * MS)) == 0
    assert rig.session.next_plan() is None


def test_a_stop_lets_not_one_group_more_out() -> None:
    rig = Rig()
    rig.stream(express(3), SECOND)
    assert rig.ask(STOP, SECOND) == b""
    assert DropReason.LATE not in rig.dropped()


def test_speed_steps_go_on_in_the_stream() -> None:
    rig = Rig("rplidar-a2m8", {"spin_up_s": 1.0}, world=room)
    rig.ask(PWM, 2 * SECOND)
    rig.stream(SCAN, SECOND)
    rig.ask(request(0xF0, struct.pack("<H", 330)), 3 * SECOND)
    kind, data = 0x81, rig.ask(b"", 2 * SECOND)
    starts = [at for at, one in enumerate(points_of(kind, whole(kind, data))) if one.start]
    assert np.diff(starts).mean() == pytest.approx(2000.0 / 5.0, rel=0.02)
    rig.ask(request(0xF0, bytes(2)), 100 * MS)
    rig.ask(PWM, 500 * MS)
    assert len(rig.ask(b"", SECOND)) > 5000, "a gap of 100 ms does not end a scan"
    rig.ask(request(0xF0, bytes(2)), 5 * SECOND)
    assert rig.ask(b"", SECOND) == b"", "a motor that stands has no samples"


def test_a_motor_by_dtr_stands_while_it_is_set() -> None:
    rig = Rig(device={"spin_up_s": 1.0})
    rig.run(2 * SECOND)
    rig.raw()
    rig.session.modem_lines(True, False, rig.now_ns, LINE)
    rig.run(10 * SECOND)
    assert len(rig.ask(SCAN, SECOND)) == 7
    rig.session.modem_lines(False, False, rig.now_ns, LINE)
    assert len(rig.ask(b"", 3 * SECOND)) > 5000


def test_a_blocked_motor_is_a_protection_stop_which_only_a_reset_ends() -> None:
    rig = Rig(device={"boot_s": 0.8}, ready=False)
    rig.run(2 * SECOND)
    rig.raw()
    rig.stream(SCAN, SECOND)
    assert rig.session.impair(rig.now_ns, "motor stopped", 1.0)
    rig.ask(b"", 2 * SECOND)
    assert rig.ask(HEALTH)[7] == 2
    assert rig.ask(SCAN, SECOND) == b""
    assert rig.ask(express(3), SECOND) == b""
    assert rig.session.impair(rig.now_ns, "motor stopped", 0.0)
    assert rig.ask(HEALTH)[7] == 2
    assert rig.ask(SCAN, SECOND) == b""
    kind, data = rig.stream(FORCE, SECOND)
    assert (kind, len(data) > 5000) == (0x81, True)
    rig.ask(RESET, 2 * SECOND)
    assert rig.ask(HEALTH)[7] == 0
    assert len(rig.stream(SCAN, SECOND)[1]) > 5000


def test_a_motor_that_is_free_again_still_has_its_wrong_speed() -> None:
    rig = Rig(world=room)
    for what, degree in (("motor speed", 0.5), ("motor stopped", 1.0), ("motor stopped", 0.0)):
        assert rig.session.impair(rig.now_ns, what, degree)
    points = points_of(0x81, rig.stream(SCAN, 4 * SECOND)[1])
    starts = [at for at, one in enumerate(points) if one.start]
    assert 3.4 < 1e6 / 508 / ((starts[-1] - starts[0]) / (len(starts) - 1)) < 3.6


def test_a_forced_scan_of_a_motor_that_stands_looks_in_one_direction() -> None:
    rig = Rig("rplidar-a2m8", world=room)
    assert len(rig.ask(SCAN, SECOND)) == 7
    kind, data = rig.stream(FORCE, SECOND)
    points = points_of(kind, whole(kind, data))
    assert len(points) == pytest.approx(2000, rel=0.1)
    assert len({point.angle for point in points}) == 1
    assert not any(point.start for point in points)


def test_roboticia_recovers_from_health_2() -> None:
    """Its health, RESET, two seconds, health, scan."""
    rig = Rig(device={"health": "error", "error_code": 1, "boot_s": 0.8}, ready=False)
    rig.run(2 * SECOND)
    rig.raw()
    assert rig.ask(HEALTH)[7:] == b"\x02\x01\x00"
    assert rig.ask(SCAN, 100 * MS) == b""
    text = rig.ask(RESET, 2 * SECOND)
    assert text == b"RP LIDAR System.\r\nFirmware Ver 1.29 - rtm, HW Ver 7\r\nModel: 18\r\n"
    assert rig.ask(HEALTH)[7] == 0
    assert len(rig.stream(SCAN, SECOND)[1]) > 5000


@pytest.mark.parametrize("model", sorted(MODELS))
def test_only_the_a_series_boots_with_text_and_nothing_is_answered_before(model: str) -> None:
    rig = Rig(model, {"boot_s": 0.8}, ready=False)
    assert rig.ask(INFO, 700 * MS) == b""
    assert DropReason.BOOTING in rig.dropped()
    said = rig.ask(b"", SECOND)
    assert said.startswith(b"RP LIDAR System.\r\n") == (model[8] == "a")
    assert bool(said) == (model[8] == "a")


def test_old_firmware_leaves_configuration_unanswered() -> None:
    rig = Rig(device={"firmware": "1.20"})
    assert rig.ask(INFO)[7:11] == bytes((0x18, 20, 1, 7))
    assert rig.ask(conf(0x7C), SECOND) == b""
    assert rig.ask(RATE)[7:] == struct.pack("<HH", 500, 250)
    assert rig.ask(request(0x83, bytes(33)), SECOND) == b"", "HQ_SCAN came with 1.24"
    assert rig.stream(express(0), SECOND)[0] == 0x82


def test_a_static_address_is_kept_over_a_reset() -> None:
    rig = Rig("rplidar-s2m1")
    entry, address = struct.pack("<I", 0x1CCC0), bytes(range(12))
    assert rig.ask(request(0x85, entry + address))[7:] == entry + bytes(4)
    assert rig.ask(request(0x85, struct.pack("<I", 0x71) + address))[11:] != bytes(4)
    rig.ask(RESET, 3 * SECOND)
    assert rig.conf(0x1CCC0, bytes(2)) == address


def test_a_run_of_41_is_answered_with_the_speed_and_confirmed() -> None:
    rig = Rig("rplidar-c1m1")
    assert rig.ask(b"\x41" * 60) == b""
    assert rig.ask(b"\x41" * 20) == struct.pack("<I", 460_800)
    rig.put(request(0x90, struct.pack("<HIH", 0x5F5F, 512_000, 0)))
    rig.run(2 * MS)
    assert [one.line_speed for one in rig.sent if one.line_speed] == [512_000]
    assert struct.unpack("<I", rig.conf(0xA1)) == (512_000,)
    rig.put(request(0x90, struct.pack("<HIH", 0x5F5F, 115_200, 0)))
    rig.run(2 * MS)
    assert not [one for one in rig.sent if one.line_speed], "without a run of 41 nothing is confirmed"
    assert Rig().ask(b"\x41" * 128) == b"", "an A1 does not measure the speed"


def test_a_request_is_found_behind_noise_and_after_a_wrong_sum() -> None:
    rig = Rig()
    assert rig.ask(b"\xff\x00\x11" + INFO)[6] == 4
    assert rig.dropped() == [DropReason.NO_START_BYTE]
    assert rig.ask(b"\xa5\x84\x04\x7c\x00\x00\x00\x00" + INFO)[6] == 4
    assert DropReason.BAD_CHECKSUM in rig.dropped()
    assert rig.ask(INFO + HEALTH)[6] == 4
    rig.put(b"\xa5")
    rig.run(6 * SECOND)
    rig.raw()
    assert rig.ask(INFO)[6] == 4
    assert DropReason.TIMEOUT in rig.dropped()


def test_over_udp_the_last_sender_gets_the_stream_and_over_tcp_its_end_ends_it() -> None:
    one, two = Address(0, 5001), Address(0, 5002)
    rig = Rig("rplidar-s2m1", kind=LinkKind.DATAGRAM)
    rig.put(SCAN, one)
    rig.run(SECOND)
    assert {sent.address for sent in rig.sent if sent.label == "81"} == {one}
    rig.raw()
    rig.put(express(1), two)
    rig.run(SECOND)
    assert {sent.address for sent in rig.sent if sent.label == "85"} == {two}
    assert max(len(sent.payload) for sent in rig.sent) <= 1024, "the SDK reads no more of a datagram"
    tcp = Rig("rplidar-s2m1", kind=LinkKind.STREAM)
    tcp.session.connected(tcp.now_ns, one, LinkKind.STREAM)
    tcp.put(SCAN, one)
    tcp.run(SECOND)
    tcp.session.disconnected(tcp.now_ns, one)
    tcp.raw()
    tcp.run(SECOND)
    assert tcp.raw() == b""
    tcp.session.connected(tcp.now_ns, two, LinkKind.STREAM)
    tcp.put(INFO, two)
    tcp.run(2 * MS)
    assert tcp.raw()[6] == 4


def test_over_tcp_a_second_client_waits_and_does_not_disturb_the_first() -> None:
    one, two = Address(0, 5001), Address(0, 5002)
    rig = Rig("rplidar-s2m1", {"boot_s": 0.8}, kind=LinkKind.STREAM)
    rig.run(SECOND)
    for client in (one, two):
        rig.session.connected(rig.now_ns, client, LinkKind.STREAM)
    rig.put(SCAN, one)
    rig.run(SECOND)
    rig.raw()
    rig.put(INFO, two)
    rig.run(SECOND)
    assert {sent.address for sent in rig.sent} == {one}
    assert len(points_of(0x81, rig.raw())) > 10_000
    rig.session.disconnected(rig.now_ns, one)
    rig.raw()
    rig.run(SECOND)
    assert {sent.address for sent in rig.sent} == {two}
    assert rig.raw()[6] == 4
    rig.ask(RESET, 100 * MS)
    rig.session.disconnected(rig.now_ns, two)
    rig.session.connected(rig.now_ns, one, LinkKind.STREAM)
    rig.put(INFO, one)
    rig.run(3 * SECOND)
    assert rig.raw() == b"", "the server is up, the scanner behind it is not"


@given(st.lists(st.one_of(st.binary(max_size=20), st.sampled_from([SCAN, STOP, INFO, PWM, RESET, express(3), FORCE]),
                          st.integers(0, 700)), max_size=12))  # fmt: skip
def test_whatever_comes_at_any_instant_a_reset_device_scans_again(inputs: list[bytes | int]) -> None:
    rig = Rig("rplidar-a1m8", {"boot_s": 0.1}, world=room)
    rig.run(200 * MS)
    for one in inputs:
        if isinstance(one, int):
            rig.run(one * MS)
        else:
            rig.put(one)
    rig.run(6 * SECOND)
    rig.raw()
    rig.session.power_on(rig.now_ns)
    rig.run(200 * MS)
    rig.raw()
    assert len(rig.stream(SCAN, 500 * MS)[1]) > 2000


@pytest.mark.parametrize(("key", "value"), [("serial_number", "xyz"), ("firmware", "9.99"), ("turn_hz", 0.0),
                                            ("health", "ill"), ("nonsense", 1)])  # fmt: skip
def test_settings_that_no_device_has_are_refused(key: str, value: object) -> None:
    with pytest.raises(DeviceSettingError, match=key):
        FAMILY.new_session({key: value}, {"model": "rplidar-a1m8"})


def test_a_model_that_is_not_in_the_table_is_refused() -> None:
    with pytest.raises(DeviceSettingError, match="rplidar-a1m8"):
        FAMILY.new_session({}, {"model": "rplidar-z9"})


@pytest.mark.parametrize(
    ("model", "theirs", "us"), [("rplidar-a1m8", "RPLIDAR-A1", 508), ("rplidar-c1m1", "RPLIDAR-C1", 200)]
)
def test_lds2d_reads_turns_of_the_world(model: str, theirs: str, us: int) -> None:
    rig = turning(model)
    found = turns(theirs, rig.ask(SCAN, 2 * SECOND))
    hz = 7.0 if "a1" in model else 10.0
    assert len(found) >= 2 * hz - 4
    for angle, mm, quality in found[1:]:
        assert len(angle) == pytest.approx(1e6 / us / hz, rel=0.02)
        seen = (angle < 299.0) & (angle > 1.0)
        np.testing.assert_allclose(mm[seen], 1000.0 + 10.0 * angle[seen], atol=1.0)
        assert (mm[angle > 301.0] == 0).all()
        assert (quality[seen] > 0).all()


class Device:
    """A device in virtual time as the serial port of a client in Python: time passes while it reads, or sleeps."""

    def __init__(self, rig: Rig) -> None:
        self.rig, self._held = rig, b""

    def _let(self, duration_ns: int) -> None:
        self.rig.run(duration_ns)
        self._held += self.rig.raw()

    def read(self, size: int = 1) -> bytes:
        for _ in range(2000):
            if len(self._held) >= size:
                break
            self._let(MS)
        found, self._held = self._held[:size], self._held[size:]
        return found

    def write(self, data: bytes) -> int:
        self.rig.put(data)
        return len(data)

    def sleep(self, seconds: float) -> None:
        self._let(round(seconds * 1e9))

    def inWaiting(self) -> int:
        if not self._held:
            self._let(MS)
        return len(self._held)

    def flushInput(self) -> None:
        self._let(0)
        self._held = b""

    def setDTR(self, level: bool) -> None:
        self.rig.session.modem_lines(level, False, self.rig.now_ns, LINE)

    def close(self) -> None:
        pass


def test_roboticia_scans_recovers_from_health_2_and_switches_the_motor(monkeypatch: pytest.MonkeyPatch) -> None:
    """rplidar-roboticia, unmodified, in virtual time: its waits, its DTR, its RESET."""
    import rplidar

    rig = Rig(device={"health": "error", "boot_s": 0.8, "spin_up_s": 1.0}, ready=False)
    rig.run(3 * SECOND)
    rig.raw()
    port = Device(rig)
    monkeypatch.setattr(rplidar.serial, "Serial", lambda *_, **__: port)
    monkeypatch.setattr(rplidar.time, "sleep", port.sleep)
    lidar = rplidar.RPLidar("x")
    assert lidar.get_info()["model"] == 24
    assert lidar.get_health()[0] == "Error"
    for kind, count, step_deg in (("normal", 281, 0.0), ("express", 562, 360.0 * 7.0 * 254e-6)):
        scans = lidar.iter_scans(kind, max_buf_meas=False, min_len=20)
        found = [next(scans) for _ in range(5)][2:]
        for turn in found:
            angle, mm = np.array([one[1:] for one in turn]).T
            assert len(angle) == pytest.approx(count, rel=0.2), "it keeps those with an echo: 300 degrees of 360"
            seen = (angle > 2.0) & (angle < 298.0) & (mm > 0)
            np.testing.assert_allclose(mm[seen], 1000.0 + 10.0 * (angle[seen] - step_deg), atol=4.0)
        lidar.stop()
        lidar.clean_input()
    assert lidar.get_health()[0] == "Good"
    lidar.stop_motor()
    rig.run(10 * SECOND)
    rig.raw()
    assert len(rig.ask(SCAN, SECOND)) == 7, "DTR is set: it stands"
