"""YDLIDAR's devices in virtual time: start-ups of drivers, every command, turns read by lds2d."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from emulator.hosts.ydlidar import Packet, StreamReader
from protocols.errors import DeviceSettingError
from protocols.session import DropReason, LinkKind
from protocols.ydlidar import FAMILY
from protocols.ydlidar.models import MODELS
from protocols.ydlidar.session import COMMANDS
from tests.protocols.lds2d_reader import turns
from tests.protocols.turning_rig import LINE, MS, SECOND, Rig

INFO = bytes.fromhex("A5 5A 14 00 00 00 04 06 05 01 03 02 00 02 04 00 01 01 05 00 00 00 00 00 01 02 03")
HEALTH = bytes.fromhex("A5 5A 03 00 00 00 06 00 00 00")
SCAN = bytes.fromhex("A5 5A 05 00 00 40 81")
TWO_WAY = ["ydlidar-x4", "ydlidar-g4", "ydlidar-tg15", "ydlidar-t-mini"]


def rig_of(model: str, device: dict[str, Any] | None = None, **more: Any) -> Rig:
    rig = Rig("ydlidar", model, {"speed_wobble": 0.01, **(device or {})}, **more)
    rig.run(SECOND)
    return rig


def reply(kind: int, data: bytes) -> bytes:
    return b"\xa5\x5a" + len(data).to_bytes(4, "little") + bytes((kind,)) + data


def packets(data: bytes, width: int = 2) -> list[Packet]:
    return [one for one in StreamReader(width).feed(data) if not isinstance(one, bytes)]


# start-ups, by the traces of the specification


@pytest.mark.parametrize(
    ("model", "asked"),
    [
        ("ydlidar-x4", [(0x92, HEALTH), (0x90, INFO)]),
        ("ydlidar-g4", [(0x92, HEALTH), (0x90, None), (0xD1, reply(4, b"\x02")), (0x0D, reply(4, b"\xbc\x02\0\0")),
                        (0x0B, reply(4, b"\x20\x03\0\0")), (0x09, reply(4, b"\x2a\x03\0\0")),
                        (0x09, reply(4, b"\x34\x03\0\0")), (0x0D, reply(4, b"\x34\x03\0\0"))]),
        ("ydlidar-tg15", [(0x92, HEALTH), (0x90, None), (0xD1, reply(4, b"\0")),
                          (0x0D, reply(4, (1040).to_bytes(4, "little"))), (0x0D, reply(4, b"\x10\x04\0\0")),
                          (0x93, reply(4, bytes(4)))]),
        ("ydlidar-t-mini", [(0x92, HEALTH), (0x90, None), (0x0D, reply(4, b"\xe8\x03\0\0")),
                            (0x0D, reply(4, b"\xe8\x03\0\0"))]),
    ],
)  # fmt: skip
def test_the_start_up_of_the_maker_s_sdk(model: str, asked: list[tuple[int, bytes | None]]) -> None:
    rig = rig_of(model)
    assert rig.raw() == b"", "a model with commands waits for one"
    for command in (0x00, 0x65):
        assert rig.ask(command, 5 * MS) == b""
    rig.run(500 * MS)
    for command, wanted in asked:
        found = rig.ask(command)
        assert found == wanted if wanted is not None else (len(found) == 27 and found[7] == MODELS[model].code)
    assert rig.ask(0x00, 5 * MS) + rig.ask(0x65, 500 * MS) == b""
    rig.put(b"\xa5\x60")
    begun_ns = rig.now_ns
    rig.run(2 * SECOND)
    sent = rig.take()
    assert sent[0].payload == SCAN
    assert sent[0].due_ns <= begun_ns + MS
    assert sent[1].payload[:2] == b"\xaa\x55", "behind the reply five bytes of the stream, not the module info"
    assert sent[1].due_ns - sent[0].due_ns < SECOND
    modules = [one for one in sent if one.payload[:2] == b"\xa5\x5a"][1:]
    assert [one.payload[7] for one in modules] == [MODELS[model].code]
    assert 100 * MS < modules[0].due_ns - sent[1].due_ns < 300 * MS
    rig.put(b"\xa5\x00\xa5\x65")
    rig.run(20 * MS)
    rig.raw()
    rig.run(SECOND)
    assert rig.raw() == b"", "the stream has ended"
    assert rig.ask(0x90)[:7] == INFO[:7]


def test_the_start_up_of_pylidar3() -> None:
    rig = rig_of("ydlidar-x4")
    rig.run(3 * SECOND)
    assert len(rig.ask(0x91)) == 10
    assert len(rig.ask(0x90)) == 27
    assert rig.ask(0x60, 500 * MS)[:7] == SCAN
    rig.run(SECOND)
    assert len(rig.raw()) > 6000


def test_an_x2_streams_from_power_on_and_takes_no_commands() -> None:
    rig = rig_of("ydlidar-x2")
    before = rig.raw()
    assert before[:2] == b"\xaa\x55"
    for command in (0x00, 0x65, 0x60, 0x90):
        rig.put(bytes((0xA5, command)))
    rig.run(SECOND)
    data = rig.raw()
    assert b"\xa5\x5a" not in data[:4]
    assert sum(len(one.words) for one in packets(before + data)) == pytest.approx(1.5 * 3000, rel=0.02)
    assert set(rig.dropped()) == {DropReason.UNKNOWN_COMMAND}


# turns


@pytest.mark.parametrize(("model", "theirs"), [("ydlidar-x4", "YDLIDAR-X4"), ("ydlidar-x2", "YDLIDAR-X2")])
def test_lds2d_finds_points_where_the_slanted_beam_meets_the_world(model: str, theirs: str) -> None:
    rig = rig_of(model)
    rig.put(b"\xa5\x60")
    rig.run(3 * SECOND)
    found = turns(theirs, rig.raw())
    per_turn = MODELS[model].rates_hz[0] / 7.0
    assert len(found) > 16
    errors, missing = [], []
    for angle, mm, _ in found[2:]:
        assert abs(len(angle) - per_turn) < 0.04 * per_turn
        there = (mm > 0) & (angle < 349.0)
        errors.append(np.abs(mm[there] - (1000.0 + 10.0 * angle[there])))
        missing.append((mm == 0).sum())
    all_errors = np.concatenate(errors)
    assert np.percentile(all_errors, 97.5) < 1.2, "its whole millimetres and 1/64 degrees"
    assert all_errors.max() < 15.0, "a sample and a half, at the edge of the open sector"
    assert all(0.02 < count / per_turn < 0.04 for count in missing), "ten degrees have no echo"


def test_without_the_correction_the_world_would_be_turned_by_seven_degrees() -> None:
    rig = rig_of("ydlidar-x4")
    rig.put(b"\xa5\x60")
    rig.run(2 * SECOND)
    one = packets(rig.raw())[60]
    raw_angle = one.angle_deg[one.words > 0] % 360.0
    true_angle = (one.words[one.words > 0] / 4.0 - 1000.0) / 10.0
    assert 6.5 < np.median((raw_angle - true_angle) % 360.0) < 8.0


@pytest.mark.parametrize(("model", "device", "width"), [
    ("ydlidar-x4", {}, 2), ("ydlidar-g4", {}, 2), ("ydlidar-t-mini", {}, 3), ("ydlidar-tg15", {}, 2),
    ("ydlidar-tg15", {"intensity_bits": 16}, 4),
])  # fmt: skip
def test_a_turn_begins_with_a_zero_packet_that_tells_the_speed(model: str, device: dict[str, Any], width: int) -> None:
    facts = MODELS[model]
    rig = rig_of(model, device)
    rig.put(b"\xa5\x60")
    rig.run(4 * SECOND)
    sent = [one for one in rig.take() if one.payload[:2] == b"\xaa\x55"]
    read = packets(b"".join(one.payload for one in sent), width)
    zeros = [k for k, one in enumerate(read) if one.kind & 1]
    assert zeros[0] > 0, "the stream begins within a turn, without one"
    assert len(zeros) > 15
    for k in zeros:
        assert len(read[k].words) == 1
        assert read[k].angle_deg[0] < 1.1 * 360.0 * facts.hz[1] / facts.rates_hz[facts.rate]
        assert read[k - 1].angle_deg[-1] > 358.0
    reported = np.array([(read[k].kind >> 1) / 10.0 + facts.speed_offset for k in zeros])
    instants = np.array([sent[k].due_ns for k in zeros]) / 1e9
    np.testing.assert_allclose(reported[:-1], 1.0 / np.diff(instants), rtol=0.02)
    assert len(set(reported)) > 1, "it wobbles"
    counts = [sum(len(one.words) for one in read[k:m]) for k, m in pairwise(zeros)]
    np.testing.assert_allclose(counts, facts.rates_hz[facts.rate] * np.diff(instants), atol=1.5)
    for k in range(zeros[0], zeros[-1]):
        step = (read[k + 1].angle_deg[0] - read[k].angle_deg[-1]) % 360.0
        assert step == pytest.approx(360.0 * facts.hz[1] / facts.rates_hz[facts.rate], rel=0.15)
    if not facts.triangulates:
        for one in read:
            angle, mm = one.angle_deg % 360.0, one.words * facts.unit_mm
            mm = (one.words >> 2).astype(float) if width == 3 else mm
            there = (mm > 0) & (angle < 349.0)
            np.testing.assert_allclose(mm[there], 1000.0 + 10.0 * angle[there], atol=0.7)
            if one.intensity is not None:
                assert (one.intensity[there] > 0).all()
                assert (one.intensity[mm == 0] == 0).all()
    assert rig.dropped() == []


@pytest.mark.parametrize("model", sorted(MODELS))
def test_the_check_of_the_maker_s_sdk_after_a_start(model: str) -> None:
    """Of five turns the samples times the speed must round to a rate of the model; none may take longer than 2 s."""
    facts = MODELS[model]
    rig = rig_of(model)
    rig.put(b"\xa5\x60")
    rig.run(int(7 * SECOND / facts.hz[1]) + SECOND)
    read = packets(rig.raw(), 3 if "mini" in model else 2)
    zeros = [k for k, one in enumerate(read) if one.kind & 1][:6]
    assert len(zeros) == 6
    for k, m in pairwise(zeros):
        hz = (read[k].kind >> 1) / 10.0 + facts.speed_offset
        count = sum(len(one.words) for one in read[k:m])
        assert round(count * hz / 1000.0) == round(facts.rates_hz[facts.rate] / 1000.0)


def test_too_near_and_too_far_are_no_return() -> None:
    rig = rig_of("ydlidar-g4", range_at=lambda angle: np.where(angle < 180.0, 0.2, 15.9))
    rig.put(b"\xa5\x60")
    rig.run(2 * SECOND)
    words = np.concatenate([one.words for one in packets(rig.raw())])
    assert set(np.unique(words)) == {0, 63_600}, "at 9 kHz nothing nearer than 0.28 m"
    rig.put(b"\xa5\x65")
    rig.run(50 * MS)
    rig.raw()
    assert rig.ask(0xD0)[-1] == 0
    rig.put(b"\xa5\x60")
    rig.run(2 * SECOND)
    words = np.concatenate([one.words for one in packets(rig.raw())])
    assert {800, 63_600} <= set(np.unique(words)), "at 4 kHz from 0.1 m on"


# commands


@pytest.mark.parametrize("model", TWO_WAY)
@pytest.mark.parametrize("command", sorted(COMMANDS))
def test_every_command_while_idle_and_while_scanning(model: str, command: bytes) -> None:
    facts = MODELS[model]
    rig = rig_of(model)
    rig.put(command)
    rig.run(2 * MS)
    found = rig.raw()
    known = facts.sets or command[1] in (0x60, 0x61, 0x65, 0x00, 0x90, 0x91, 0x92, 0x80)
    known = known and not (command[1] in (0x40, 0x80) and command[1] != facts.restart)
    silent = command[1] in (0x00, 0x65, 0x40, 0x80)
    assert bool(found) == (known and not silent)
    assert (rig.dropped() != []) == (not known)
    if command[1] in (0x60, 0x61, 0x40, 0x80):
        return
    rig.put(b"\xa5\x60")
    rig.run(2 * SECOND)
    rig.raw()
    rig.put(command)
    rig.run(100 * MS)
    data = rig.raw()
    assert (len(data) < 300) == (command[1] in (0x65, 0x00)), "only a stop ends the stream"
    assert all(isinstance(one, Packet) for one in StreamReader(3 if "mini" in model else 2).feed(data))


@pytest.mark.parametrize("model", ["ydlidar-g4", "ydlidar-tg15", "ydlidar-t-mini"])
def test_the_aimed_speed_stays_within_the_limits_and_the_motor_follows(model: str) -> None:
    facts = MODELS[model]
    rig = rig_of(model)
    for command, limit in ((0x0B, facts.hz[2]), (0x0C, facts.hz[0])):
        for _ in range(20):
            found = rig.ask(command)
        assert int.from_bytes(found[7:], "little") == round(100 * limit)
        assert int.from_bytes(rig.ask(0x0D)[7:], "little") == round(100 * limit) + facts.aim_offset
    for _ in range(7):
        rig.ask(0x09)
    hz = facts.hz[0] + 0.7
    rig.put(b"\xa5\x60")
    rig.run(4 * SECOND)
    zeros = [one for one in packets(rig.raw(), 3 if "mini" in model else 2) if one.kind & 1]
    assert (zeros[-1].kind >> 1) / 10.0 + facts.speed_offset == pytest.approx(hz, abs=0.11)


def test_rates_step_through_those_that_the_line_carries() -> None:
    rig = rig_of("ydlidar-tg15")
    assert [rig.ask(0xD0)[-1] for _ in range(5)] == [1, 2, 3, 0, 1]
    slow = rig_of("ydlidar-tg15", {"intensity_bits": 16})
    assert [slow.ask(0xD0)[-1] for _ in range(3)] == [0, 0, 0]
    assert rig.ask(0xD1) == reply(4, b"\x01")
    rig.put(b"\xa5\x60")
    rig.run(3 * SECOND)
    data = packets(rig.raw())
    zeros = [k for k, one in enumerate(data) if one.kind & 1]
    assert sum(len(one.words) for one in data[zeros[-2] : zeros[-1]]) == pytest.approx(1600, rel=0.02)


def test_a_restart_forgets_settings_but_a_g4_keeps_its_speed() -> None:
    for model, command, kept in (("ydlidar-g4", 0x40, 800), ("ydlidar-t-mini", 0x40, 1000)):
        rig = rig_of(model)
        rig.ask(0x0B) if model == "ydlidar-g4" else rig.ask(0x0C)
        rig.ask(0x01)
        assert rig.ask(command) == b""
        assert rig.ask(0x90) == b"", "it boots"
        rig.run(SECOND)
        assert int.from_bytes(rig.ask(0x0D)[7:], "little") == kept
        assert rig.ask(0x05)[-1] == (model == "ydlidar-g4")
        rig.session.power_on(rig.now_ns)
        rig.run(SECOND)
        rig.raw()
        assert int.from_bytes(rig.ask(0x0D)[7:], "little") == round(100 * MODELS[model].hz[1])
        assert rig.ask(0x05)[-1] == 0


def test_a_scan_that_runs_is_confirmed_and_goes_on() -> None:
    rig = rig_of("ydlidar-g4")
    rig.put(b"\xa5\x60")
    rig.run(2 * SECOND)
    rig.raw()
    rig.put(b"\xa5\x60")
    rig.run(SECOND)
    found = [one.payload for one in rig.take()]
    assert found.count(SCAN) == 1
    read = packets(b"".join(one for one in found if one != SCAN))
    assert sum(len(one.words) for one in read) == pytest.approx(9000, rel=0.01)


@pytest.mark.parametrize("after_ms", [3, 40, 150, 700])
def test_stopped_at_any_instant_it_ends_with_a_whole_packet_and_scans_again(after_ms: int) -> None:
    rig = rig_of("ydlidar-x4")
    for _ in range(4):
        rig.put(b"\xa5\x60")
        rig.run(after_ms * MS)
        rig.put(b"\xa5\x65")
        stopped_ns = rig.now_ns
        rig.run(400 * MS)
        sent = rig.take()
        assert max((one.due_ns for one in sent), default=0) <= stopped_ns
        assert sent[0].payload == SCAN
    rig.put(b"\xa5\x60")
    rig.run(SECOND)
    assert len(turns("YDLIDAR-X4", rig.raw())) >= 5
    assert set(rig.dropped()) <= {DropReason.STALE}


def test_health_and_a_motor_that_stands() -> None:
    assert rig_of("ydlidar-x4", {"health": "warning"}).ask(0x92)[7] == 1
    rig = rig_of("ydlidar-x4", {"health": "error"})
    assert rig.ask(0x91)[7] == 2
    assert rig.ask(0x60, SECOND) == SCAN
    rig = rig_of("ydlidar-g4")
    rig.put(b"\xa5\x60")
    rig.run(2 * SECOND)
    rig.session.impair(rig.now_ns, "motor stopped", 1.0)
    rig.raw()
    rig.run(SECOND)
    assert rig.raw() == b""
    rig.put(b"\xa5\x65")
    assert rig.ask(0x92) == reply(6, b"\x02\x01\x00")
    rig.put(b"\xa5\x60")
    rig.run(SECOND)
    assert rig.raw() == SCAN
    rig.session.impair(rig.now_ns, "motor stopped", 0.0)
    rig.run(2 * SECOND)
    assert sum(len(one.words) for one in packets(rig.raw())) > 9000


def test_dtr_stops_the_motor_of_the_usb_board() -> None:
    rig = rig_of("ydlidar-x4")
    rig.put(b"\xa5\x60")
    rig.run(SECOND)
    rig.session.modem_lines(False, False, rig.now_ns, LINE)
    rig.raw()
    rig.run(SECOND)
    assert rig.raw() == b""
    rig.session.modem_lines(True, True, rig.now_ns, LINE)
    rig.run(SECOND)
    assert len(rig.raw()) > 2000
    rig.session.modem_lines(False, False, rig.now_ns, LINE)
    rig.put(b"\xa5\x65")
    assert rig.ask(0x92) == HEALTH, "the maker's SDK asks with the motor off, and takes an error for the end"
    other = rig_of("ydlidar-g4")
    other.session.modem_lines(False, False, other.now_ns, LINE)
    assert other.ask(0x92) == HEALTH


def test_a_blocked_motor_is_not_freed_by_dtr_and_found_when_it_should_turn() -> None:
    rig = rig_of("ydlidar-x4")
    rig.session.modem_lines(False, False, rig.now_ns, LINE)
    rig.session.impair(rig.now_ns, "motor stopped", 1.0)
    assert rig.ask(0x92) == HEALTH
    rig.session.modem_lines(True, True, rig.now_ns, LINE)
    assert rig.ask(0x92) == reply(6, b"\x02\x01\x00")
    rig.put(b"\xa5\x60")
    rig.run(SECOND)
    assert rig.raw() == SCAN
    rig.session.impair(rig.now_ns, "motor stopped", 0.0)
    rig.run(2 * SECOND)
    assert len(rig.raw()) > 2000


def test_time_stamps_come_before_zero_packets_where_they_are_wanted() -> None:
    rig = rig_of("ydlidar-t-mini", {"stamp_packets": True})
    rig.put(b"\xa5\x60")
    rig.run(2 * SECOND)
    sent = [one for one in rig.take() if one.payload[:1] == b"\xaa"]
    stamps = [k for k, one in enumerate(sent) if one.payload[:2] == b"\xaa\x66"]
    assert len(stamps) > 10
    for k in stamps:
        data = sent[k].payload
        assert len(data) == 8
        assert np.bitwise_xor.reduce(np.frombuffer(data, np.uint8)) == 0
        assert int.from_bytes(data[3:7], "little") == pytest.approx(sent[k].due_ns / MS, abs=1)
        assert sent[k + 1].payload[2] & 1


@settings(max_examples=30)
@given(st.lists(st.tuples(st.binary(max_size=6), st.integers(0, 300)), max_size=8))
def test_whatever_a_host_sends_the_device_scans_afterwards(said: list[tuple[bytes, int]]) -> None:
    rig = rig_of("ydlidar-x4")
    for data, pause_ms in said:
        rig.put(data)
        rig.run(pause_ms * MS)
    rig.put(b"\x01")
    rig.run(1500 * MS)
    rig.put(b"\xa5\x00\xa5\x65")
    rig.run(600 * MS)
    rig.raw()
    rig.put(b"\xa5\x60")
    rig.run(SECOND)
    sent = rig.raw()
    assert sent[:7] == SCAN
    assert len(turns("YDLIDAR-X4", sent)) >= 5


def test_wrong_settings_are_refused_and_the_framing_knows_packets() -> None:
    for key, value, model in (
        ("speed_hz", 3.0, "ydlidar-x4"), ("intensity_bits", 8, "ydlidar-tg15"), ("serial_number", "12", "ydlidar-g4"),
        ("health", "bad", "ydlidar-x2"), ("baud", 9600, "ydlidar-x4"),
    ):  # fmt: skip
        with pytest.raises(DeviceSettingError, match=key):
            FAMILY.new_session({key: value}, {"model": model})
    with pytest.raises(DeviceSettingError, match="ydlidar-x4"):
        FAMILY.new_session({}, {"model": "ydlidar-x9"})
    rig = rig_of("ydlidar-x4")
    rig.put(b"\xa5\x60")
    rig.run(SECOND)
    first, one = rig.take()[:2]
    framing = FAMILY.framing(rig.session, LinkKind.SERIAL)
    assert packets(framing.bad_check(one) or b"") == []
    assert framing.bad_check(first) is None
    assert (framing.with_type(first, 0x77) or b"")[6] == 0x77
    assert framing.to_be_refused(b"\xa5\x60") == b"\xa5\x7f"
