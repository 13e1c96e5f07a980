"""PTC, HTTP, power, standby, time and faults of a Hesai in virtual time."""

from __future__ import annotations

import functools
import json
import operator
import ssl
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
from protocols.session import Address, DropReason, Emission, LinkKind
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
        if text.code.startswith(("GET", "PTC", "TCP")):
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
    assert rig.ok(0x08), "connections are closed 0.1 s later"
    rig.run(0.1)
    assert rig.raw(frame(0x08)) == b""
    assert not clouds(rig.run(10.5))
    rig.session.connected(rig.now_ns, PTC, LinkKind.STREAM)
    sent = clouds(rig.run(1.0))
    assert int.from_bytes(sent[0].payload[1076:1080], "little") == 1
    rig.ok(0x25)
    rig.run(4.9)
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
    assert dirty[15:19] == bytes((1, dirty[16], 1, 1))
    rig.session.impair(rig.now_ns, "heat", 1.0)
    both = [one.payload for one in rig.run(0.5) if one.address == FAULT]
    assert {(one[17], one[18]) for one in both} == {(2, 1), (2, 2)}
    assert len({one[19:23] for one in both}) == 2, "fault codes by turns"
    assert both[-1][59] == 1


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
    rig.ok(0x29, b"\1")
    rig.run(0.03)
    packet = reader.decode(clouds(rig.run(0.12))[-9].payload)
    fired = [{one.channel for one in packet.points if one.block == b} for b in (0, 1)]
    assert len(fired[0] | fired[1]) == 128
    assert len(fired[0] & fired[1]) == 64, "a laser that does not fire says nothing"


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


# ---------------------------------------------------------------- hosts that a device meets


def test_a_request_longer_than_any_is_answered_with_code_one_and_the_next_one_as_ever() -> None:
    rig = Rig(device={"standby": True})
    for length in (65_529, 1 << 20, 0xFFFF_FFFF):
        head = b"\x47\x74\x17\0" + length.to_bytes(4, "big")
        assert rig.raw(head + frame(0x28)) == frame(0x17, code=1) + frame(0x28, code=5)
    whole = frame(0x83, bytes(65_528))
    assert rig.raw(whole) == frame(0x83, code=5), "as long as allowed"


def test_ptc_2_is_refused_in_its_own_frame_whole_or_in_pieces() -> None:
    rig = Rig(device={"standby": True})
    ask = bytes.fromhex("577501 09 00 00 00 00") + (3).to_bytes(4, "big") + b"abc"
    said = bytes.fromhex("577501 09 05 00 00 00 00000000")
    assert rig.raw(ask + frame(0x28)) == said + frame(0x28, code=5)
    for byte in ask:
        rig.session.receive(bytes((byte,)), rig.now_ns, PTC)
    assert b"".join(one.payload for one in rig.run(0.002) if one.address == PTC) == said
    long = ask[:8] + (1 << 30).to_bytes(4, "big")
    assert rig.raw(long + frame(0x28)) == said + frame(0x28, code=5)
    assert DropReason.REFUSED in {one.reason for one in rig.dropped}


def test_what_is_no_request_of_http_is_refused_and_ptc_goes_on() -> None:
    rig = Rig(device={"standby": True})
    for wrong in (b"GET\x20/\xff HTTP/1.1", b"GET /x HTTP/1.1\r\n: y", b"GET /x", b"GET  HTTP/9.9"):
        said = rig.raw(wrong + b"\r\n\r\n" + frame(0x28))
        assert (said[:12], said[-8:]) == (b"HTTP/1.1 400", frame(0x28, code=5)), wrong
    assert rig.raw(b"GET /" + b"x" * 5000) == b""
    assert DropReason.OVERLONG in {one.reason for one in rig.dropped}
    with_body = b"GET /pandar.cgi?x HTTP/1.1\r\nContent-Length: 2\r\n\r\nab"
    assert rig.raw(with_body + frame(0x28)).endswith(b"}}" + frame(0x28, code=5))


def test_a_handshake_of_tls_is_refused_as_one_whole_or_in_pieces() -> None:
    ours, theirs = ssl.MemoryBIO(), ssl.MemoryBIO()
    client = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT).wrap_bio(theirs, ours, server_hostname="lidar")
    with pytest.raises(ssl.SSLWantReadError):
        client.do_handshake()
    rig, hello = Rig(device={"standby": True}), ours.read()
    for byte in hello[:-1]:
        rig.session.receive(bytes((byte,)), rig.now_ns, PTC)
    said = rig.raw(hello[-1:] + frame(0x28))
    assert said.endswith(frame(0x28, code=5))
    theirs.write(said[: -len(frame(0x28))])
    with pytest.raises(ssl.SSLError, match=r"(?i)handshake.failure"):
        client.do_handshake()
    assert rig.dropped[0].reason is DropReason.REFUSED
    assert rig.raw(b"\x16\x16\x03" + frame(0x28)) == frame(0x28, code=5), "garbage that begins alike"
    assert rig.raw(b"\x16\x03\1\2\0" + frame(0x28)) == b"", "a record that is not complete"
    assert b"".join(one.payload for one in rig.run(1.1) if one.address == PTC) == frame(0x28, code=5)


def test_several_clients_with_halves_of_requests_at_once_each_get_their_own_replies() -> None:
    rig = Rig(device={"standby": True})
    clients = [Address(PTC.link, peer) for peer in range(20, 26)]
    for one in clients:
        rig.session.connected(rig.now_ns, one, LinkKind.STREAM)
    request = frame(0x26)
    for half in (request[:5], request[5:]):
        for one in clients:
            rig.session.receive(half, rig.now_ns, one)
    sent = rig.run(0.002)
    assert [one.address for one in sent if one.payload[:3] == request[:3]] == clients
    rig.session.receive(request[:7], rig.now_ns, clients[0])
    rig.session.disconnected(rig.now_ns, clients[0])
    rig.session.connected(rig.now_ns, clients[0], LinkKind.STREAM)
    rig.session.receive(request, rig.now_ns, clients[0])
    assert [one.address for one in rig.run(0.002)] == [clients[0]], "nothing is left of the connection before"
    rig.session.receive(request[:7], rig.now_ns, clients[1])
    rig.run(1.5)
    rig.session.receive(frame(0x28), rig.now_ns, clients[1])
    assert [one.payload for one in rig.run(0.002)] == [frame(0x28, code=5)], "half a request is forgotten"


def conversation(name: str) -> list[tuple[int, bytes]]:
    """Of nebula's start, as recorded; then a poll of each second."""
    rpm = struct.pack(">H", MODELS[name].rpm[0])
    steps = [(0x07, b""), (0x08, b""), (0x1E, b"\2"), (0x17, rpm), (0x20, bytes.fromhex("7f0000010940277e"))]
    if name == "hesai-at128":
        return [*steps, (0x05, b""), (0x09, b""), (0x27, b"")]
    steps.append((0x18, b"\1\0\0"))
    if name in ("hesai-xt32", "hesai-xt32m2x", "hesai-pandar40p", "hesai-qt64"):
        steps.append((0x1F, b"\1"))
    ptp = bytes((3, 0, 1, 1)) if name == "hesai-ot128" else bytes((0, 0, 0, 1, 1, 0))
    steps += [(0x26, b""), (0x24, ptp), (0x3A, b""), (0x39, b"\1")]
    if MODELS[name].high_ns:
        steps += [(0x28, b""), (0x29, b"\0")]
    if name == "hesai-ot128":
        steps += [(0x59, b""), (0x58, b"\0")]
    whole = bytes.fromhex("0000000e10")
    return [*steps, (0x23, b""), (0x22, whole), (0x05, b""), (0x22, whole), (0x09, b""), (0x27, b"")]


@pytest.mark.parametrize("name", sorted(MODELS))
def test_the_start_of_nebula_is_answered_step_by_step_within_fifty_milliseconds(name: str) -> None:
    rig = Rig(name, {"range_deg": [0, 360]} if name == "hesai-at128" else QUIET)
    for command, payload in conversation(name):
        asked_ns = rig.now_ns
        rig.session.receive(frame(command, payload), rig.now_ns, PTC)
        (reply,) = [one for one in rig.run(0.05) if one.address == PTC]
        assert reply.due_ns - asked_ns < 50_000_000
        assert reply.payload[:4] == bytes((0x47, 0x74, command, 0)), hex(command)
    rig.run(0.02)
    mode = MODELS[name].returns(2)[1]
    assert {reader.decode(one.payload).mode for one in clouds(rig.run(0.22))} == {mode}


@pytest.mark.parametrize("name", ["hesai-pandar40p", "hesai-qt64"])
def test_models_set_by_http_take_all_three_of_its_speeds(name: str) -> None:
    rig = Rig(name, {"standby": True})
    for value, rpm in ((1, 300), (3, 1200), (2, 600)):
        ask = f"GET /pandar.cgi?action=set&object=lidar&key=spin_speed&value={value} HTTP/1.1\r\n\r\n"
        assert b'"ErrorCode":"0"' in rig.raw(ask.encode())
        assert rig.ok(0x08)[20:22] == rpm.to_bytes(2, "big")


def test_a_new_pandar40p_fires_by_time_and_by_angle_when_told_to() -> None:
    rig = Rig("hesai-pandar40p", {"range_deg": [0, 60]})
    assert rig.ok(0x08)[31] == 1
    places = []
    for trigger in (b"\1", b"\0"):
        rig.ok(0x1B, trigger)
        rig.run(0.02)
        found = np.array([reader.decode(one.payload).azimuths for one in clouds(rig.run(0.11))]) / 0.2
        places.append(np.abs(found - np.rint(found)).max())
    assert places[1] < 1e-6


def test_gpgga_is_told_in_gps_packets_and_in_the_configuration() -> None:
    rig = Rig(device={"pps": True, "nmea": True, "nmea_sentence": "gpgga", "standby": True})
    data = [one for one in rig.run(4.5) if one.label == "gps"][-1].payload
    assert data[18:118].startswith(b"$GPGGA,1200")
    assert data[506:508] == b"1\1"
    assert rig.ok(0x08)[38] == 1
    body = data[19 : data.index(b"*")]
    assert int(data[data.index(b"*") + 1 :][:2], 16) == functools.reduce(operator.xor, body)


def test_in_the_minute_before_it_stops_for_heat_it_says_so_and_goes_on() -> None:
    rig = Rig("hesai-ot128", {"range_deg": [0, 20]})
    rig.session.impair(rig.now_ns, "heat", 1.0)
    rig.run(0.03)
    packet = reader.decode(clouds(rig.run(0.11))[-1].payload)
    assert (packet.safety[1] >> 5, bool(packet.points)) == (5, True)


TAIL = {0: 0x38, 1: 0x37, 2: 0x39, 3: 0x33, 4: 0x3B, 5: 0x3C, 6: 0x3D}
"Codes of command 1E, and the byte of a packet."
ALL, MOST = {0, 1, 2, 3, 4, 5}, {0, 1, 2}
ALLOWED = {
    "hesai-xt32": ALL, "hesai-xt32m2x": ALL | {6}, "hesai-pandar128e3x": ALL, "hesai-ot128": ALL, "hesai-at128": MOST,
    "hesai-pandar40p": MOST, "hesai-qt64": {0, 2, 3},
}  # fmt: skip


@pytest.mark.parametrize("name", sorted(ALLOWED))
def test_codes_of_return_modes_are_those_of_the_maker(name: str) -> None:
    rig = Rig(name, {} if name == "hesai-at128" else {"range_deg": [0, 30]})
    for code in range(9):
        said = rig.ptc(0x1E, bytes((code,)))
        assert said == (0 if code in ALLOWED[name] else 1, b"")
        if said[0] == 0:
            rig.run(0.02)
            tail = 0x3B if (name, code) == ("hesai-qt64", 2) else TAIL[code]
            assert {reader.decode(one.payload).mode for one in clouds(rig.run(0.12))} == {tail}
            assert rig.ok(0x08)[32] == code


@pytest.mark.parametrize("name", sorted(MODELS))
def test_the_start_of_the_makers_sdk_is_answered_within_three_seconds_and_in_standby_too(name: str) -> None:
    rig = Rig(name, {"standby": True} if name == "hesai-at128" else {"standby": True, **QUIET})
    rpm = struct.pack(">H", MODELS[name].rpm[-1])
    for command, payload, length in (
        (0x1C, b"\0", 0), (0x17, rpm, 0), (0x05, b"", None), (0x06, b"\1", 16), (0x3A, b"", 1),
    ):  # fmt: skip
        said = rig.ok(command, payload)
        assert len(said) == length if length is not None else len(said) > 300
    assert not clouds(rig.run(9.8))
    sent = clouds(rig.run(0.5))
    assert reader.decode(sent[0].payload).rpm == MODELS[name].rpm[-1]


@pytest.mark.parametrize(
    ("request_", "ends"),
    [
        (b"GET /pandar.cgi?action=get&object=workmode HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n", True),
        (b"GET /pandar.cgi?action=get&object=workmode HTTP/1.1\r\nHost: x\r\n\r\n", False),
        (frame(0x42), False),
    ],
)
def test_a_connection_ends_with_the_reply_where_its_client_says_so(request_: bytes, ends: bool) -> None:
    rig = Rig()
    rig.session.receive(request_, rig.now_ns, PTC)
    (sent,) = (one for one in rig.run(0.02) if one.address == PTC)
    assert (sent.hangs_up, b"\r\nConnection: close\r\n" in sent.payload) == (ends, ends)
