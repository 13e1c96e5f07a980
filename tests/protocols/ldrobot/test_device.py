"""LDROBOT's devices in virtual time: read by lds2d, by the rules of the maker's SDK, under faults of the motor."""

from __future__ import annotations

import struct
from itertools import pairwise

import numpy as np
import pytest

from emulator.hosts.ldrobot import PacketReader
from protocols.errors import DeviceSettingError
from protocols.ldrobot import FAMILY, MODELS
from protocols.session import DropReason, LinkKind
from tests.protocols.lds2d_reader import turns
from tests.protocols.turning_rig import MS, SECOND, Rig


@pytest.mark.parametrize(("model", "theirs"), [("ldrobot-ld06", "LD06"), ("ldrobot-ld19", "LD19")])
def test_lds2d_reads_turns_of_the_world(model: str, theirs: str) -> None:
    rig = Rig("ldrobot", model)
    rig.run(4 * SECOND)
    found = turns(theirs, rig.raw())
    assert len(found) >= 23
    for angle, mm, quality in found:
        assert abs(len(angle) - 450) < 12
        there = (angle > 0.05) & (angle < 349.5)  # 359.998 deg is 0.00 on the wire
        np.testing.assert_allclose(mm[there], 1000.0 + 10.0 * angle[there], atol=0.65)
        assert (mm[angle > 350.5] == 0).all()
        assert (quality[there] == 180).all()
        assert (quality[angle > 350.5] == 0).all()
    assert len({len(angle) for angle, _, _ in found}) > 2, "the rotor turns freely"
    assert rig.dropped() == []


@pytest.mark.parametrize("model", sorted(MODELS))
def test_the_rules_of_the_maker_s_sdk_are_kept(model: str) -> None:
    rate = MODELS[model].rate_hz
    rig = Rig("ldrobot", model, {"speed_wobble": 0.02})
    rig.run(4 * SECOND)
    sent = rig.take()
    assert sent[0].due_ns >= 1.5 * SECOND, "silent until the motor is at speed"
    gaps = [other.due_ns - one.due_ns for one, other in pairwise(sent)]
    assert {round(gap / MS, 3) for gap in gaps} == {round(12_000 / rate, 3)}
    last, size, counts = 0.0, 0, []
    for one in sent:
        head, speed, start = struct.unpack_from("<HHH", one.payload)
        end, _ = struct.unpack_from("<HH", one.payload, 42)
        assert (head, len(one.payload)) == (0x2C54, 47)
        span = (end // 100 - start // 100) % 360
        assert span <= speed * 12 / rate * 1.5
        assert ((end - start) % 36_000) / 100.0 == pytest.approx(speed * 11 / rate, abs=0.05 * speed * 11 / rate)
        for angle in (start / 100.0 + np.arange(12) * ((end - start) % 36_000) / 1100.0) % 360.0:
            if angle < 20.0 and last > 340.0:
                counts.append(size)
                size = 0
            size, last = size + 1, angle
    assert len(counts) >= 23
    assert all(abs(count - rate / 10) < 0.04 * rate / 10 for count in counts[1:])


def test_the_stream_begins_in_the_middle_of_a_turn_and_all_samples_follow_each_other() -> None:
    rig = Rig("ldrobot", "ldrobot-ld19")
    rig.run(3 * SECOND)
    packets = list(PacketReader().feed(rig.raw()))
    assert 20.0 < packets[0].angle_deg[0] < 340.0
    for one, other in pairwise(packets):
        step = (other.angle_deg[0] - one.angle_deg[-1]) % 360.0
        assert step == pytest.approx(0.8, abs=0.05), "no sample is missing or twice"


def test_time_stamps_run_to_thirty_seconds() -> None:
    rig = Rig("ldrobot", "ldrobot-ld19")
    rig.session.clock = rig.session.clock.set_to(0, 28 * SECOND)
    rig.run(4 * SECOND)
    stamps = [one.stamp_ms for one in PacketReader().feed(rig.raw())]
    assert 29_997 <= max(stamps) <= 29_999
    assert {(other - one) % 30_000 for one, other in pairwise(stamps)} == {2, 3}
    assert min(stamps) < 3


def test_input_is_ignored() -> None:
    rig, quiet = Rig("ldrobot", "ldrobot-ld19"), Rig("ldrobot", "ldrobot-ld19")
    rig.run(2 * SECOND)
    quiet.run(2 * SECOND)
    rig.put(bytes.fromhex("54 A1 04 00 00 00 00 4A"))
    rig.run(SECOND)
    quiet.run(SECOND)
    assert rig.raw() == quiet.raw()
    assert rig.dropped() == [DropReason.UNKNOWN_COMMAND]


@pytest.mark.parametrize(("duty", "hz"), [(0.0, 10.0), (0.4, 10.0), (0.28, 7.0), (0.1, 5.0), (1.0, 13.0)])
def test_the_pwm_pin_sets_the_speed(duty: float, hz: float) -> None:
    rig = Rig("ldrobot", "ldrobot-ld19", {"pwm_duty": duty, "speed_wobble": 0.0, "spin_up_s": 3})
    rig.run(5 * SECOND)
    packets = list(PacketReader().feed(rig.raw()))
    assert packets[-1].speed_dps == pytest.approx(360.0 * hz, rel=0.01)
    assert len(turns("LD19", b"")) == 0
    angle = np.unwrap(np.radians([one.angle_deg[0] for one in packets[-100:]]))
    assert angle[-1] - angle[0] == pytest.approx(2 * np.pi * hz * 99 * 12 / 4500, rel=0.01)


def test_another_speed_changes_points_a_turn_and_none_is_lost() -> None:
    rig = Rig("ldrobot", "ldrobot-ld19", {"speed_wobble": 0.0})
    rig.run(3 * SECOND)
    rig.session.impair(rig.now_ns, "motor speed", 0.6)
    rig.run(4 * SECOND)
    data = rig.raw()
    packets = list(PacketReader().feed(data))
    for one, other in pairwise(packets):
        step = (other.angle_deg[0] - one.angle_deg[-1]) % 360.0
        assert 0.45 < step < 0.85, "the angle goes on, and the speed changes slowly"
    counts = [len(angle) for angle, _, _ in turns("LD19", data)]
    assert abs(counts[5] - 450) < 12
    assert abs(counts[-2] - 750) < 13
    for angle, mm, _ in turns("LD19", data):
        there = (angle > 0.05) & (angle < 349.5)  # 359.998 deg is 0.00 on the wire
        np.testing.assert_allclose(mm[there], 1000.0 + 10.0 * angle[there], atol=0.75)


def test_a_blocked_rotor_stops_the_stream_and_a_free_one_starts_it_at_speed() -> None:
    rig = Rig("ldrobot", "ldrobot-ld19")
    rig.run(3 * SECOND)
    assert rig.session.impair(rig.now_ns, "motor stopped", 1.0)
    rig.raw()
    rig.run(3 * SECOND)
    assert rig.raw() == b""
    assert rig.session.impair(rig.now_ns, "motor stopped", 0.0)
    freed_ns = rig.now_ns
    rig.run(4 * SECOND)
    sent = rig.take()
    assert sent[0].due_ns == pytest.approx(freed_ns + 1.5 * SECOND, abs=10 * MS)
    assert len(turns("LD19", b"".join(one.payload for one in sent))) >= 22
    assert not rig.session.impair(rig.now_ns, "window", 0.5)


def test_switched_off_and_on_it_streams_again() -> None:
    rig = Rig("ldrobot", "ldrobot-ld19")
    rig.run(int(2.3456 * SECOND))
    rig.session.power_on(rig.now_ns)
    rig.raw()
    on_ns = rig.now_ns
    rig.run(3 * SECOND)
    sent = rig.take()
    assert sent[0].due_ns >= on_ns + 1.5 * SECOND
    assert len(turns("LD19", b"".join(one.payload for one in sent))) >= 12


def test_turns_that_are_not_measured_are_reported() -> None:
    rig = Rig("ldrobot", "ldrobot-ld19")
    rig.run(2 * SECOND)
    rig.measures = False
    rig.run(SECOND)
    rig.measures = True
    rig.run(SECOND)
    late = rig.dropped()
    assert set(late) == {DropReason.LATE}
    plans = [plan.sweep for plan in rig.plans]
    assert plans == sorted(set(plans))


def test_wrong_settings_are_refused_and_the_framing_knows_packets() -> None:
    for key, value in (("pwm_duty", 1.5), ("spin_up_s", -1), ("speed_wobble", "x"), ("baud", 9600)):
        with pytest.raises(DeviceSettingError, match=key):
            FAMILY.new_session({key: value}, {})
    with pytest.raises(DeviceSettingError, match="ldrobot-ld06"):
        FAMILY.new_session({}, {"model": "ldrobot-ld20"})
    rig = Rig("ldrobot", "ldrobot-ld19")
    rig.run(2 * SECOND)
    one, other = rig.take()[:2]
    framing = FAMILY.framing(rig.session, LinkKind.SERIAL)
    bad = framing.bad_check(one)
    assert bad is not None
    assert list(PacketReader().feed(bad)) == []
    (found,) = PacketReader().feed(framing.with_counter(one, -29_000) or b"")
    (true,) = PacketReader().feed(one.payload)
    assert (true.stamp_ms - found.stamp_ms) % 30_000 == 29_000
    (mixed,) = PacketReader().feed(framing.stale(one, other) or b"")
    (fresh,) = PacketReader().feed(other.payload)
    assert mixed.stamp_ms == fresh.stamp_ms
    np.testing.assert_array_equal(mixed.range_m, true.range_m)
    assert (framing.with_type(one, 0x99) or b"")[1] == 0x99
