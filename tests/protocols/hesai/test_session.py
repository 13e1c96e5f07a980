"""PTC, HTTP, power, standby, time and faults of a Hesai in virtual time."""

from __future__ import annotations

import json
import struct
from datetime import UTC, datetime

import numpy as np
import pytest

from protocols.errors import DeviceSettingError
from protocols.hesai import FAMILY, codec
from protocols.hesai.framing import HesaiFraming
from protocols.hesai.models import MODELS
from protocols.hesai.motor import FREE, FROZEN, LOCKED, TRACKING
from protocols.hesai.session import frame
from protocols.scan import Scan
from protocols.session import DropReason, Emission, LinkKind
from tests.protocols.hesai import reader
from tests.protocols.hesai.rig import DATA, FAULT, GPS, PTC, SECOND, Rig, clouds

QUIET = {"range_deg": [350, 351]}


def slow(**more: object) -> dict[str, object]:
    return {"boot_s": 3.0, "spin_up_s": 8.0, **QUIET, **more}


# ---------------------------------------------------------------- framing


def test_worked_requests_have_the_worked_replies() -> None:
    rig = Rig(device={**QUIET, "returns": "dual", "destination": "127.0.0.1", "data_port": 2368, "gps_port": 10110})
    assert rig.raw(bytes.fromhex("4774ee0000000000")) == bytes.fromhex("4774ee0500000000")
    assert rig.raw(bytes.fromhex("477405 00 00000000")).startswith(
        bytes.fromhex("4774050000 00012f") + b"Channel,Elevation"
    )
    assert rig.raw(bytes.fromhex("47740700 00000000")).startswith(bytes.fromhex("4774070000000078 58543332413142"))
    for request, reply in (
        ("47741e00 00000001 02", "47741e00 00000000"), ("47741800 00000003 01005a", "47741800 00000000"),
        ("47741700 00000002 04b0", "47741700 00000000"), ("47742200 00000005 00012c05dc", "47742200 00000000"),
        ("47742400 00000004 03000101", "47742400 00000000"), ("47742600 00000000", "47742600 00000005 0103000101"),
    ):  # fmt: skip
        assert rig.raw(bytes.fromhex(request)) == bytes.fromhex(reply)
    config = rig.ok(0x08)
    assert len(config) == 47
    assert config[22:25] == bytes.fromhex("012328"), "the sync angle is told in 0.01 deg"
    assert struct.unpack(">HHH", config[16:22]) == (2368, 10110, 1200)
    assert config[25:29] == bytes.fromhex("001e0096")


@pytest.mark.parametrize("cuts", [1, 3, 8])
def test_requests_in_pieces_and_two_at_once_with_rubbish_before_are_answered_in_order(cuts: int) -> None:
    rig = Rig(device=QUIET)
    data = b"rubbishG" + frame(0x28) + b"\x47" + frame(0x26)
    for at in range(0, len(data), cuts):
        rig.session.receive(data[at : at + cuts], rig.now_ns, PTC)
    replies = b"".join(one.payload for one in rig.run(0.002) if one.address == PTC)
    assert replies[:8] == frame(0x28, code=5)
    assert replies[8:11] == b"\x47\x74\x26"


SETS = {
    0x17: b"\x02\x58", 0x18: b"\1\0\x5a", 0x1B: b"\1", 0x1C: b"\0", 0x1E: b"\0", 0x1F: b"\1",
    0x20: bytes((127, 0, 0, 1, 9, 64, 39, 126)), 0x21: bytes(15), 0x22: b"\0\0\0\x0e\x10", 0x24: bytes((3, 0, 1, 1)),
    0x28: b"", 0x29: b"\1", 0x2A: b"\1", 0x39: b"\5", 0x58: b"\1", 0x06: b"\1",
}  # fmt: skip


@pytest.mark.parametrize("name", sorted(MODELS))
def test_every_command_answers_its_own_code_and_refuses_a_wrong_length_with_code_one(name: str) -> None:
    rig = Rig(name, {"standby": True})
    for text in FAMILY.commands():
        if text.code.startswith("GET"):
            continue
        command = int(text.code, 16)
        if command in (0x10, 0x25):
            continue
        good = b"\0\xc8" if command == 0x17 and name == "hesai-at128" else SETS.get(command, b"")
        code, _ = rig.ptc(command, good)
        lacks = {
            0x22: name == "hesai-at128", 0x23: name == "hesai-at128", 0x28: not MODELS[name].high_ns,
            0x29: not MODELS[name].high_ns, 0x58: name != "hesai-ot128", 0x59: name != "hesai-ot128",
            0x2A: name in ("hesai-at128", "hesai-pandar40p"),
        }.get(command, False)  # fmt: skip
        assert code == (5 if lacks or text.status == "refused" else 0), text
        if code == 0:
            before = rig.session.settings
            wrong, said = rig.ptc(command, SETS.get(command, b"") + b"\xff" * 9)
            assert (wrong, said) == (1, b""), text
            assert rig.session.settings == before


LENGTHS = {
    "hesai-xt32": (120, 54), "hesai-xt32m2x": (120, 54), "hesai-pandar128e3x": (120, 54), "hesai-ot128": (162, 54),
    "hesai-at128": (184, 58), "hesai-pandar40p": (120, 54), "hesai-qt64": (120, 54),
}  # fmt: skip


@pytest.mark.parametrize("name", sorted(MODELS))
def test_replies_have_the_lengths_of_the_model(name: str) -> None:
    rig = Rig(name, {"standby": True, "serial_number": "AB12"})
    inventory, status = LENGTHS[name]
    found = rig.ok(0x07)
    assert len(found) == inventory
    assert found[:18] == b"AB12".ljust(18, b"\0")
    assert found[34:37] == b"\xec\x9f\x0d"
    at = 170 if name == "hesai-at128" else 106
    assert found[at] == MODELS[name].number
    assert found[at + 2] == MODELS[name].lasers
    assert len(rig.ok(0x09)) == status
    assert len(rig.ok(0x27)) == 64
    assert [len(rig.ok(0x06, bytes((query,)))) for query in (1, 2, 3, 4)] == [16, 26, 50, 8]
    assert rig.ptc(0x06, b"\5") == (1, b"")
    new = name in ("hesai-at128", "hesai-ot128")
    assert len(rig.ok(0x26)) == (5 if name == "hesai-ot128" else 7 + new)
    assert rig.ptc(0x24, bytes((0, 0, 0, 1, 1, 0) + (0,) * new))[0] == 0
    assert len(rig.ok(0x26)) == 7 + new


WRONG = [
    (0x17, b"\x02\x59"), (0x18, b"\2\0\0"), (0x18, b"\1\1\x69"), (0x1B, b"\2"), (0x1C, b"\2"), (0x1E, b"\6"),
    (0x1F, b"\2"), (0x20, bytes(8)), (0x22, b"\0\x0e\x11\0\0"), (0x22, b"\1" + bytes(64)), (0x22, b"\3\2" + bytes(4)),
    (0x24, b"\4\0\0"), (0x24, b""),
]  # fmt: skip


@pytest.mark.parametrize(("command", "payload"), WRONG)
def test_what_is_out_of_range_is_refused_and_changes_nothing(command: int, payload: bytes) -> None:
    rig = Rig(device={"standby": True})
    before = rig.session.settings
    assert rig.ptc(command, payload) == (1, b"")
    assert rig.session.settings == before
    assert any(one.reason in (DropReason.BAD_ARGUMENT, DropReason.BAD_LENGTH) for one in rig.dropped)


def test_http_sets_what_old_drivers_set_there_with_raw_spaces_and_quotes() -> None:
    rig = Rig("hesai-pandar40p", {"standby": True})

    def ask(query: str) -> dict[str, dict[str, str]]:
        head, _, body = rig.raw(f"GET /pandar.cgi?{query} HTTP/1.1\r\nHost: x\r\n\r\n".encode()).partition(b"\r\n\r\n")
        assert f"Content-Length: {len(body)}".encode() in head
        return json.loads(body)  # type: ignore[no-any-return]

    assert ask("action=set&object=lidar&key=spin_speed&value=3")["Head"]["ErrorCode"] == "0"
    assert rig.session.settings.rpm == 1200
    said = ask('action=set&object=lidar_sync&key=sync_angle&value={"sync": 1,"syncAngle": 30}')
    assert said["Head"]["ErrorCode"] == "0"
    assert rig.session.settings.sync_deg == 30
    ptp = '{"Profile": 0,"Domain": 4,"Network": 1,"LogAnnounceInterval": 1,'
    ptp += '"LogSyncInterval": -3,"LogMinDelayReqInterval": 0,"tsn_switch": 0}'
    assert ask(f"action=set&object=lidar&key=ptp_configuration&value={ptp}")["Head"]["ErrorCode"] == "0"
    assert rig.ok(0x26) == bytes((1, 0, 4, 1, 1, 0xFD, 0))
    assert "lidarInCur" in ask("action=get&object=lidar_monitor")["Body"]
    for query in (
        "action=get&object=device_info",
        "action=set&object=lidar&key=spin_speed&value=9",
        "%ff",
        "value=[[[",
    ):
        assert ask(query)["Head"]["ErrorCode"] == "1"


# ---------------------------------------------------------------- power and settings


def test_it_answers_after_its_boot_and_sends_when_the_motor_is_at_speed() -> None:
    rig = Rig(device=slow())
    assert rig.raw(frame(0x08)) == b""
    rig.run(3.1)
    assert rig.ok(0x05)
    speeds = []
    for _ in range(4):
        speeds.append(struct.unpack(">H", rig.ok(0x09)[4:6])[0])
        rig.run(1.5)
    assert speeds == sorted(speeds)
    assert speeds[0] < 50
    assert not clouds(rig.sent)
    sent = clouds(rig.run(3.0))
    assert 11.0 <= sent[0].due_ns / SECOND < 11.2
    first = reader.decode(sent[0].payload)
    assert (first.sequence, first.rpm) == (1, 600)


def test_standby_stops_packets_and_motor_and_settings_survive_power_off() -> None:
    rig = Rig(device=slow(boot_s=0.0, spin_up_s=0.0))
    assert clouds(rig.run(0.3))
    rig.ok(0x1C, b"\1")
    rig.run(0.02)
    assert not clouds(rig.run(6.0))
    assert rig.ok(0x08)[33] == 1
    assert struct.unpack(">H", rig.ok(0x09)[4:6])[0] == 0
    rig.ok(0x17, (1200).to_bytes(2, "big"))
    rig.ok(0x1C, b"\0")
    assert not clouds(rig.run(9.9))
    packets = clouds(rig.run(0.3))
    assert reader.decode(packets[0].payload).rpm == 1200
    rig.ok(0x1E, b"\2")
    rig.power_on()
    rig.run(0.3)
    assert struct.unpack(">H", rig.ok(0x08)[20:22])[0] == 1200
    assert rig.ok(0x08)[32] == 2
    assert struct.unpack(">I", rig.ok(0x09)[40:44])[0] == 2, "switched on twice"


def test_another_speed_ramps_and_the_stream_goes_on_with_wider_steps_and_no_number_missing() -> None:
    rig = Rig(device={"range_deg": [0, 20]})
    rig.run(0.3)
    rig.ok(0x17, (1200).to_bytes(2, "big"))
    rig.run(6.0)
    rig.ok(0x1E, b"\1")
    rig.run(0.3)
    sent = clouds(rig.sent)
    numbers = [int.from_bytes(one.payload[1076:1080], "little") for one in sent]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    packets = [reader.decode(one.payload) for one in (sent[0], sent[len(sent) // 2], sent[-1])]
    assert packets[0].rpm < packets[1].rpm < packets[2].rpm == 1200
    assert packets[2].azimuths[1] - packets[2].azimuths[0] == pytest.approx(0.36)
    assert packets[2].mode == 0x37


def test_a_range_leaves_out_packets_and_the_rest_of_those_at_its_edges() -> None:
    rig = Rig()
    rig.ok(0x22, bytes.fromhex("00012c05dc"))
    assert rig.ok(0x23) == bytes.fromhex("00012c05dc")
    rig.run(0.02)
    packets = [reader.decode(one.payload) for one in clouds(rig.run(0.3))]
    azimuths = np.array([one.azimuth_deg for packet in packets for one in packet.points])
    assert azimuths.min() == pytest.approx(30.0, abs=0.18)
    assert azimuths.max() == pytest.approx(150.0, abs=0.18)
    assert len(packets) == pytest.approx(0.3 * 2500 / 3, abs=20)
    rig.ok(0x22, bytes.fromhex("03020000 00640708 0834"))
    rig.run(0.02)
    seen = {round(one.azimuth_deg) // 10 for e in clouds(rig.run(0.2)) for one in reader.decode(e.payload).points}
    assert seen == {0, 1, 18, 19, 20, 21}


def test_a_destination_redirects_the_point_cloud_and_gps_packets_at_once() -> None:
    rig = Rig(device={"nmea": True, "pps": True, **QUIET})
    assert {(one.address, one.place) for one in clouds(rig.run(0.3))} == {(DATA, None)}
    rig.ok(0x20, bytes((127, 0, 0, 9)) + struct.pack(">HH", 5000, 5001))
    rig.run(0.02)
    sent = rig.run(1.3)
    assert {(one.address, one.place) for one in clouds(sent)} == {(DATA, ("127.0.0.9", 5000))}
    assert {(one.address, one.place) for one in sent if one.label == "gps"} == {(GPS, ("127.0.0.9", 5001))}
    rig.session.power_on(rig.now_ns)
    assert {one.place for one in clouds(rig.run(0.3))} == {("127.0.0.9", 5000)}


def test_reboot_answers_then_restarts_from_one_and_a_reset_is_quicker() -> None:
    rig = Rig(device=slow())
    rig.run(11.5)
    assert clouds(rig.sent)
    rig.ok(0x10)
    assert rig.raw(frame(0x08)) == b""
    assert not clouds(rig.run(10.5))
    rig.session.connected(rig.now_ns, PTC, LinkKind.STREAM)
    sent = clouds(rig.run(1.0))
    assert int.from_bytes(sent[0].payload[1076:1080], "little") == 1
    rig.ok(0x25)
    rig.run(4.8)
    assert clouds(rig.run(0.5))


def test_turning_backwards_the_azimuth_falls() -> None:
    rig = Rig(device={"range_deg": [0, 20]})
    rig.ok(0x2A, b"\1")
    assert rig.ok(0x08)[34] == 0x11
    packets = [reader.decode(one.payload) for one in clouds(rig.run(6.0))[-9:]]
    steps = np.diff([one.azimuths for one in packets], axis=1)
    assert np.median(steps) == pytest.approx(-0.18)


# ---------------------------------------------------------------- time


@pytest.mark.parametrize(("source", "keys"), [("ptp", {}), ("gps", {"pps": True, "nmea": True})])
def test_with_a_source_it_has_the_time_of_day_and_at_full_seconds_the_sync_angle(
    source: str, keys: dict[str, bool]
) -> None:
    rig = Rig(device={"clock_source": source, "sync": True, "sync_deg": 90, "range_deg": [60, 120], **keys})
    rig.run(7.6)
    packets = [reader.decode(one.payload) for one in clouds(rig.run(0.8))]
    utc = datetime(2026, 1, 1, 12, tzinfo=UTC).timestamp()
    assert utc + 7.5 < packets[0].t0_s < utc + 7.7
    at = [(point.at_s, point.azimuth_deg) for one in packets for point in one.points[::32]]
    _, azimuth = min(at, key=lambda one: abs(one[0] - (utc + 8.0)))
    assert azimuth == pytest.approx(90.0, abs=0.4)


def test_the_state_of_ptp_goes_from_tracking_to_locked_to_frozen_to_free() -> None:
    rig = Rig(device={"clock_source": "ptp", "standby": True})
    states = []
    for wait, degree in ((0.5, None), (4.0, None), (0.0, 1.0), (61.0, None), (0.0, 0.0), (4.0, None)):
        if degree is not None:
            rig.session.impair(rig.now_ns, "no ptp", degree)
        rig.run(wait)
        status = rig.ok(0x09)
        states.append(status[48])
        assert struct.unpack(">qii", rig.ok(0x06, b"\1"))[1] == status[48]
    assert states == [TRACKING, LOCKED, FROZEN, FREE, TRACKING, LOCKED]


def test_without_a_source_the_clock_counts_from_its_own_date() -> None:
    rig = Rig(device={"ptp": False, **QUIET})
    packet = reader.decode(clouds(rig.run(0.3))[0].payload)
    assert datetime.fromtimestamp(packet.t0_s, UTC).year == 2017


def test_gps_packets_leave_each_second_in_gps_mode_alone_with_digits_reversed() -> None:
    rig = Rig(device={"pps": True, "nmea": True, "utc": "2026-01-02T03:04:05", "standby": True})
    sent = [one for one in rig.run(6.5) if one.label == "gps"]
    assert [one.address for one in sent] == [GPS] * 6
    data = sent[-1].payload
    assert len(data) == 512
    assert data[:14] == b"\xff\xee" + b"621020" + b"114030"
    sentence = data[18:118].rstrip(b"\0").decode()
    assert sentence.startswith("$GPRMC,030411.00,A,")
    assert data[118] == 0xDF
    assert data[506:] == b"A\1" + bytes(4)
    rig.ok(0x1F, b"\1")
    assert not [one for one in rig.run(2.5) if one.label == "gps"]


# ---------------------------------------------------------------- faults


def test_heat_raises_the_flag_and_stops_it_after_a_minute_until_it_is_cool() -> None:
    rig = Rig(device={"range_deg": [0, 2]})
    rig.run(0.2)
    rig.session.impair(rig.now_ns, "heat", 1.0)
    rig.run(0.3)
    assert reader.decode(clouds(rig.run(0.3))[-1].payload).shutdown == 1
    rig.session._hot_ns -= 59 * SECOND  # a minute of it is long
    assert clouds(rig.run(0.3))
    rig.run(0.2)
    assert not clouds(rig.run(2.0))
    assert rig.ok(0x09)
    rig.session.impair(rig.now_ns, "heat", 0.0)
    assert not clouds(rig.run(9.8))
    assert reader.decode(clouds(rig.run(0.5))[-1].payload).shutdown == 0


def test_injected_return_codes_and_damaged_calibration() -> None:
    rig = Rig(device={"standby": True})
    good = rig.ok(0x05)
    rig.session.impair(rig.now_ns, "calibration", 1.0)
    assert rig.ptc(0x05) == (3, b"")
    rig.session.impair(rig.now_ns, "calibration", 2.0)
    assert 8 < len(rig.ok(0x05)) < len(good)
    rig.session.impair(rig.now_ns, "calibration", 0.0)
    assert rig.ok(0x05) == good
    rig.session.impair(rig.now_ns, "ptc error", 6.0)
    assert rig.ptc(0x17, b"\x04\xb0") == (6, b"")
    assert rig.session.settings.rpm == 600
    rig.session.impair(rig.now_ns, "ptc error", 0.0)
    assert rig.ptc(0x17, b"\x04\xb0") == (0, b"")


def test_an_at128_reports_a_dirty_lens_in_its_fault_messages() -> None:
    rig = Rig("hesai-at128", {"standby": True})
    sent = [one for one in rig.run(1.05) if one.address == FAULT]
    assert len(sent) == pytest.approx(10, abs=1)
    data = sent[-1].payload
    assert (len(data), data[:2], data[13]) == (99, b"\xcd\xdc", 4)
    assert int.from_bytes(data[63:67], "little") == reader.crc(data[2:63])
    assert data[26:50] == bytes(24)
    rig.session.impair(rig.now_ns, "window", 0.3)
    dirty = [one for one in rig.run(0.3) if one.address == FAULT][-1].payload
    assert dirty[26:50] == b"\xff" * 24
    assert dirty[14] == 4


def test_an_ot128_that_watches_for_blockage_says_why_there_is_no_return() -> None:
    rig = Rig("hesai-ot128", {"range_deg": [0, 20]})
    rig.world = lambda plan: Scan.empty(plan, 2)
    rig.ok(0x58, b"\1")
    rig.run(0.02)
    words = {round(one.range_m * 250) for e in clouds(rig.run(0.11))[-9:] for one in reader.decode(e.payload).points}
    assert words == {codec.NOTHING}
    rig.session.impair(rig.now_ns, "window", 0.2)
    rig.run(0.03)
    words = {round(one.range_m * 250) for e in clouds(rig.run(0.11))[-9:] for one in reader.decode(e.payload).points}
    assert words == {codec.BLOCKED}


def test_a_stopped_motor_sends_nothing_and_a_free_one_again() -> None:
    rig = Rig(device=QUIET)
    assert clouds(rig.run(0.3))
    assert rig.session.impair(rig.now_ns, "motor stopped", 1.0)
    rig.run(0.02)
    assert not clouds(rig.run(0.5))
    rig.session.impair(rig.now_ns, "motor stopped", 0.0)
    assert clouds(rig.run(0.5))
    assert not rig.session.impair(rig.now_ns, "login", 1.0)


def test_packets_are_changed_on_their_way_with_right_or_wrong_checks() -> None:
    rig = Rig("hesai-ot128")
    one, two = clouds(rig.run(0.1))[3:5]
    framing = HesaiFraming()
    counted = framing.with_counter(one, 5)
    assert counted is not None
    assert reader.decode(counted).sequence == reader.decode(one.payload).sequence + 5
    old = framing.stale(one, two)
    assert old is not None
    assert reader.decode(old).azimuths == reader.decode(one.payload).azimuths
    assert reader.decode(old).sequence == reader.decode(two.payload).sequence
    wrong = framing.bad_check(one)
    assert wrong is not None
    with pytest.raises(AssertionError):
        reader.decode(wrong)
    reply = Emission(0, frame(0x23, bytes(5)))
    assert framing.with_length(reply, 3) == frame(0x23, bytes(5)).replace(b"\0\0\0\5", b"\0\0\0\x08", 1)
    assert framing.bad_check(reply) is None


@pytest.mark.parametrize(
    ("model", "key", "value", "want"),
    [("hesai-xt32", "rpm", 700, "600 | 300 | 1200"), ("hesai-xt32", "high_resolution", True, "false"),
     ("hesai-at128", "range_deg", [0, 90], "AT128"), ("hesai-qt64", "returns", "dual", "last | first | last_first"),
     ("hesai-xt32", "destination", "there", "an IPv4 address"), ("hesai-xt32", "slice_packets", 1, "from 2 to 1000"),
     ("hesai-xt32", "signature", True, "false"), ("hesai-xt32", "speed", 1, "no such key")],
)  # fmt: skip
def test_what_a_model_does_not_have_is_refused_by_name(model: str, key: str, value: object, want: str) -> None:
    with pytest.raises(DeviceSettingError) as error:
        FAMILY.new_session({key: value}, {"model": model})
    assert error.value.key == key
    assert want in str(error.value)


def test_a_path_that_it_does_not_have_is_not_found() -> None:
    rig = Rig(device={"standby": True})
    assert rig.raw(b"GET /packets HTTP/1.1\r\n\r\n").startswith(b"HTTP/1.1 404 ")
    assert rig.raw(b"GET /point_cloud HTTP/1.1\r\n\r\n").startswith(b"HTTP/1.1 200 ")
