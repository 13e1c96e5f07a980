"""Rates, slots, instants: what the mirror and the line allow."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from protocols.errors import EncodeError, ScanRefused
from protocols.lms2xx.telegrams import open_frame, read_values, request
from protocols.lms2xx.timing import Mirror
from protocols.lms2xx.variants import FAST, VARIANTS, Variant, comb
from protocols.scan import Scan
from protocols.session import Dropped, DropReason
from protocols.skeleton.serial_lines import line_ns
from tests.protocols.lms2xx.rig import MS, SECOND, Rig, new_session, rate_hz, wall

CODES = {9600: "42", 19200: "41", 38400: "40", 500_000: "48"}
TURN_S = 40 / 3 / 1000

STREAMS = {
    "101 points": ("sick-lms291-s05", "3B 64 00 64 00", "20 24", 212, 1),
    "181 points": ("sick-lms291-s05", "3B B4 00 64 00", "20 24", 372, 1),
    "201 points": ("sick-lms291-s05", "3B 64 00 32 00", "20 24", 412, 2),
    "361 points": ("sick-lms291-s05", "3B B4 00 32 00", "20 24", 732, 2),
    "401 points": ("sick-lms291-s05", "3B 64 00 19 00", "20 24", 812, 4),
    "partial 1 deg": ("sick-lms291-s05", "3B B4 00 64 00", "20 2A", 372, 1),
    "401 points as B7": ("sick-lms291-s05", "3B 64 00 19 00", "20 27 01 00 91 01", 816, 4),
    "S14 C4": ("sick-lms291-s14", "31", "20 50 01 00 B5 00", 559, 1),
}
TABLE_HZ = {
    ("101 points", 9600): 4.41,
    ("101 points", 19200): 8.33,
    ("101 points", 38400): 15.0,
    ("101 points", 500_000): 75.0,
    ("181 points", 9600): 2.50,
    ("181 points", 19200): 5.00,
    ("181 points", 38400): 9.38,
    ("181 points", 500_000): 75.0,
    ("201 points", 9600): 2.21,
    ("201 points", 19200): 4.17,
    ("201 points", 38400): 7.50,
    ("201 points", 500_000): 37.5,
    ("361 points", 9600): 1.29,
    ("361 points", 19200): 2.50,
    ("361 points", 38400): 4.69,
    ("361 points", 500_000): 37.5,
    ("401 points", 9600): 1.17,
    ("401 points", 19200): 2.34,
    ("401 points", 38400): 4.69,
    ("401 points", 500_000): 18.75,
    ("partial 1 deg", 9600): 2.50,
    ("partial 1 deg", 19200): 5.00,
    ("partial 1 deg", 38400): 9.38,
    ("partial 1 deg", 500_000): 75.0,
    ("401 points as B7", 38400): 4.69,
    ("S14 C4", 9600): 1.70,
    ("S14 C4", 19200): 3.41,
    ("S14 C4", 38400): 6.82,
    ("S14 C4", 500_000): 75.0,
}


def streaming(stream: str, baud: int, telegrams: int, **device: object) -> Rig:
    model, variant, mode, _, _ = STREAMS[stream]
    rig = Rig.on(model, **device)  # type: ignore[arg-type]
    rig.reply_to(f"20 {CODES[baud]}")
    rig.set_speed(baud)
    rig.reply_to(variant)
    rig.ask(mode)
    while len(rig.scans()) < telegrams:
        rig.wait(1.0)
    return rig


@pytest.mark.parametrize("stream", ["361 points", "401 points", "181 points"])
def test_a_sweep_is_asked_for_at_the_instant_at_which_a_telegram_is_sent(stream: str) -> None:
    rig = streaming(stream, 500_000, 4)
    sent: set[int] = set()
    asked: set[int] = set()
    for _ in range(60):
        due_ns = rig.session.next_deadline()
        assert due_ns is not None
        rig.session.advance(due_ns)
        sent |= {one.due_ns for one in rig.session.take_emissions(due_ns) if one.sweep is not None}
        while (plan := rig.session.next_plan()) is not None:
            asked.add(due_ns)
            rig.session.submit(wall()(plan))
    assert len(sent) > 20
    assert len(asked - sent) < 6, "before the first telegram"


@pytest.mark.parametrize(("stream", "baud"), TABLE_HZ)
def test_every_stream_has_the_rate_that_the_line_allows(stream: str, baud: int) -> None:
    *_, size, turns = STREAMS[stream]
    scans = streaming(stream, baud, 4).scans()
    sizes = [size, *[size - 2 * ("partial" in stream)] * 3]  # the set x.00 has a value more than the others
    periods_s = [math.ceil(each * 10 / baud / (turns * TURN_S)) * turns * TURN_S for each in sizes]
    assert [len(scan.payload) for scan in scans[:4]] == sizes
    assert rate_hz(scans) == pytest.approx((len(scans) - 1) / sum((periods_s * 99)[: len(scans) - 1]), rel=1e-6)
    assert rate_hz(scans[:2]) == pytest.approx(TABLE_HZ[stream, baud], abs=0.006)


def test_the_schedule_is_exact_after_any_time() -> None:
    mirror = Mirror(12345)
    assert mirror.turn_ns(75 * 3600 * 24) == 12345 + 24 * 3600 * SECOND
    for time_ns in (12345, 12346, 12345 + 13_333_333, 12345 + 13_333_334, 10**15):
        turn = mirror.first_turn_from(time_ns)
        assert mirror.turn_ns(turn) >= time_ns
        assert turn == 0 or mirror.turn_ns(turn - 1) < time_ns


def test_instants_of_sending_are_scan_ends_and_never_drift() -> None:
    rig = streaming("361 points", 500_000, 200)
    scans = rig.scans()
    for scan in scans:
        assert scan.sweep is not None
        assert scan.due_ns == (scan.sweep + 2) * 40_000_000 // 3
    assert [b.sweep - a.sweep for a, b in pairwise(scans)] == [2] * (len(scans) - 1)  # type: ignore[operator]


def test_no_scan_is_measured_that_the_line_cannot_take() -> None:
    rig = streaming("361 points", 38400, 10)
    assert len(rig.plans) <= len(rig.scans()) + 2
    passed = [event.count for event in rig.events if getattr(event, "reason", None) is DropReason.LINE_BUSY]
    assert set(passed) == {7}, "one of eight is sent"


@pytest.mark.parametrize(("stream", "baud"), [("361 points", 500_000), ("181 points", 500_000), ("361 points", 38400)])
def test_a_plan_is_given_out_two_scans_ahead(stream: str, baud: int) -> None:
    model, variant, mode, _, turns = STREAMS[stream]
    rig = Rig.on(model)
    ahead = []
    measure = rig.measure

    def noting(plan: object) -> Scan:
        ahead.append(plan.start_ns - rig.now_ns)  # type: ignore[attr-defined]
        return measure(plan)  # type: ignore[arg-type]

    rig.measure = noting
    rig.reply_to(f"20 {CODES[baud]}")
    rig.set_speed(baud)
    rig.reply_to(variant)
    rig.ask(mode)
    rig.wait(3.0)
    steady = ahead[3:]
    assert min(steady) >= 2 * turns * 13 * MS
    assert max(steady) <= 60 * MS


def test_the_first_telegram_holds_a_scan_begun_after_a0() -> None:
    rig = streaming("361 points", 500_000, 1)
    a0 = [emission for emission in rig.emissions if emission.label == "A0"][-1]
    first = rig.scans()[0]
    start_ns = Mirror(0).turn_ns(first.sweep)  # type: ignore[arg-type]
    assert start_ns >= a0.due_ns + line_ns(len(a0.payload), 500_000)
    assert start_ns - a0.due_ns < 28 * MS


@pytest.mark.parametrize("variant", [*VARIANTS, FAST], ids=str)
def test_beams_go_from_right_to_left_about_straight_ahead(variant: Variant) -> None:
    made = comb(variant, None)
    azimuth_deg = np.degrees(made.azimuth_rad)
    assert made.points == variant.points
    assert azimuth_deg[0] == pytest.approx(-variant.field_deg / 2)
    assert azimuth_deg[-1] == pytest.approx(variant.field_deg / 2)
    assert np.diff(azimuth_deg) == pytest.approx(variant.step_cdeg / 100)
    assert not made.elevation_rad.any()


@pytest.mark.parametrize("variant", [*VARIANTS, FAST], ids=str)
def test_neighbours_of_a_fine_grid_are_fired_a_turn_apart(variant: Variant) -> None:
    made = comb(variant, None)
    angle_deg = np.degrees(made.azimuth_rad) + 90
    turn = (made.fire_offset_s - angle_deg / 360 * TURN_S) / TURN_S
    assert turn == pytest.approx(np.arange(made.points) % variant.turns, abs=1e-9)
    assert made.fire_offset_s.max() < variant.turns * TURN_S
    if variant.step_cdeg == 100:
        assert np.diff(made.fire_offset_s) == pytest.approx(TURN_S / 360)


@pytest.mark.parametrize(("part", "count"), [(0, 181), (1, 180), (2, 180), (3, 180)])
def test_partial_scans_are_one_turn_of_whole_degrees(part: int, count: int) -> None:
    made = comb(VARIANTS[4], part)
    assert (made.points, made.turns) == (count, 1)
    assert np.degrees(made.azimuth_rad[0]) == pytest.approx(-90 + part / 4)
    assert np.diff(np.degrees(made.azimuth_rad)) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("step", "parts"), [("64 00", [0, 1, 2, 3]), ("32 00", [0, 1, 2, 3, 0]), ("19 00", [0, 1, 2, 3, 0])]
)
@pytest.mark.parametrize("baud", [38400, 500_000])
def test_partial_scans_follow_each_other_at_every_line_speed(step: str, parts: list[int], baud: int) -> None:
    rig = Rig.on()
    rig.reply_to(f"20 {CODES[baud]}")
    rig.set_speed(baud)
    rig.reply_to(f"3B {'64 00' if step == '19 00' else 'B4 00'} {step}")
    rig.ask("20 2A")
    found = []
    while len(found) < len(parts):
        telegram = rig.await_reply(0xB0, 1.0)
        assert telegram is not None
        values = read_values(telegram)
        assert values is not None
        found.append(values.header.partial)
    assert found == parts


def test_plans_say_what_can_be_reported() -> None:
    rig = Rig.on(measuring_mode="32m-field-a", unit="mm", sensitivity="low")
    rig.ask("30 01")
    rig.wait(0.2)
    plan = rig.plans[0]
    assert plan.max_range_m == pytest.approx(32.7585)
    assert plan.gain == pytest.approx((20 / 30) ** 2)
    assert (plan.wants_intensity, plan.wants_objects, plan.max_echoes) == (False, False, 1)
    assert plan.duration_s == pytest.approx(2 * TURN_S)


@pytest.mark.parametrize("mode", [1, 3, 5, 0x3F])
def test_modes_with_reflectivity_want_intensities(mode: int) -> None:
    rig = Rig.on(measuring_mode=mode)
    rig.ask("30 01")
    rig.wait(0.2)
    assert rig.plans[0].wants_intensity


def test_the_same_plan_stays_until_it_is_submitted() -> None:
    rig = Rig.on()
    rig.measuring_ns = 500 * MS
    rig.ask("30 01")
    rig.wait(0.1)
    plan = rig.session.next_plan()
    assert plan is not None
    rig.wait(0.2)
    assert rig.session.next_plan() is plan


def test_a_scan_that_is_not_wanted_any_more_is_refused() -> None:
    rig = streaming("361 points", 500_000, 2)
    rig.measuring_ns = 10 * SECOND
    rig.wait(0.2)
    plan = rig.session.next_plan()
    assert plan is not None
    rig.ask("3B B4 00 64 00")
    rig.wait(0.1)
    with pytest.raises(ScanRefused):
        rig.session.submit(wall()(plan))
    assert rig.session.next_plan() is None
    assert DropReason.STALE not in rig.dropped(), "nothing that was measured is lost"


def test_a_changed_setting_withdraws_what_was_measured_for_the_stream() -> None:
    rig = streaming("361 points", 500_000, 2)
    begin = len(rig.plans)
    rig.ask("20 25")
    rig.wait(1.0)
    assert DropReason.STALE in rig.dropped()
    assert rig.plans[-1].epoch == rig.plans[begin - 1].epoch
    rig.ask("30 01")
    rig.wait(0.2)
    assert rig.plans[-1].epoch > rig.plans[begin - 1].epoch


def test_a_scan_asked_for_is_sent_before_what_is_asked_behind_it() -> None:
    rig = Rig.on()
    rig.write(request(b"\x30\x01") + request(b"\x3b\xb4\x00\x64\x00") + request(b"\x20\x24"))
    rig.wait(3.0)
    labels = [emission.label for emission in rig.emissions[1:]]
    assert labels[:6] == ["ACK", "B0", "ACK", "BB", "ACK", "A0"]
    assert [len(scan.payload) for scan in rig.scans()[:2]] == [732, 372]


def test_a_scan_asked_for_is_still_sent_before_a_reset() -> None:
    rig = Rig.on()
    rig.write(request(b"\x30\x01") + request(b"\x10"))
    rig.wait(5.0)
    assert [emission.label for emission in rig.emissions[1:]] == ["ACK", "B0", "ACK", "91", "90"]


def test_a_scan_submitted_twice_is_refused() -> None:
    rig = Rig.on()
    rig.measuring_ns = 10 * SECOND
    rig.ask("30 01")
    rig.wait(0.1)
    plan = rig.session.next_plan()
    assert plan is not None
    rig.session.submit(wall()(plan))
    with pytest.raises(ScanRefused):
        rig.session.submit(wall()(plan))


def test_a_scan_of_a_wrong_size_is_our_own_mistake() -> None:
    rig = Rig.on()
    rig.measuring_ns = 10 * SECOND
    rig.ask("30 01")
    rig.wait(0.1)
    plan = rig.session.next_plan()
    assert plan is not None
    wrong = Scan(plan, np.ones((3, 1)), np.ones((3, 1)), np.zeros(3, np.uint8), np.zeros((3, 1), np.int32))
    with pytest.raises(EncodeError, match="361"):
        rig.session.submit(wrong)


def late_by(late_ns: int) -> tuple[int, int, int]:
    """Slot, instant of sending, and next slot of a streamed scan that comes so much after its slot."""
    session = new_session(baud=500_000)
    session.power_on(0)
    session.receive(request(b"\x20\x24"), 0)
    session.take_emissions(60 * MS)
    plan = session.next_plan()
    assert plan is not None
    slot_ns = (plan.sweep + 2) * 40_000_000 // 3
    session.advance(slot_ns + late_ns)
    session.submit(wall()(plan))
    sent = session.take_emissions(slot_ns + late_ns)
    after = session.next_plan()
    assert after is not None
    return slot_ns, sent[0].due_ns, (after.sweep + 2) * 40_000_000 // 3


@pytest.mark.parametrize("late_ms", [0, 1, 10, 26])
def test_a_scan_less_than_a_scan_time_late_keeps_its_place_in_the_schedule(late_ms: int) -> None:
    slot_ns, due_ns, next_ns = late_by(late_ms * MS)
    assert due_ns == slot_ns
    assert next_ns == pytest.approx(slot_ns + 80_000_000 / 3, abs=1)


def test_a_later_scan_goes_out_at_once_and_the_stream_goes_on_from_there() -> None:
    slot_ns, due_ns, next_ns = late_by(100 * MS)
    assert due_ns == slot_ns + 100 * MS
    assert next_ns == pytest.approx(slot_ns + 5 * 80_000_000 / 3, abs=1)


@pytest.mark.parametrize("late_ms", [5, 26, 27, 100])
def test_the_plan_given_out_behind_a_late_scan_is_still_wanted_when_that_scan_was_sent(late_ms: int) -> None:
    # The caller asks for the next plan as soon as a scan is in, so that who measures is never idle.
    session = new_session(baud=500_000)
    session.power_on(0)
    session.receive(request(b"\x20\x24"), 0)
    session.take_emissions(60 * MS)
    plan = session.next_plan()
    assert plan is not None
    now_ns = (plan.sweep + 2) * 40_000_000 // 3 + late_ms * MS
    session.advance(now_ns)
    session.submit(wall()(plan))
    following = session.next_plan()
    assert following is not None
    assert len(session.take_emissions(now_ns)) == 1
    session.submit(wall()(following))


def test_measuring_slower_than_the_mirror_slows_the_stream_and_never_stops_it() -> None:
    rig = streaming("361 points", 500_000, 3)
    rig.measuring_ns = 150 * MS
    begin = len(rig.scans())
    rig.wait(6.0)
    late = rig.scans()[begin + 5 :]
    assert 6.0 < rate_hz(late) < 7.5
    assert all(b.due_ns > a.due_ns for a, b in pairwise(late))


@pytest.mark.parametrize(("stream", "baud", "by_line"), [("361 points", 500_000, 0), ("361 points", 38_400, 7)])
def test_scans_lost_to_slow_measuring_are_not_put_down_to_the_line(stream: str, baud: int, by_line: int) -> None:
    rig = streaming(stream, baud, 3)
    rig.measuring_ns = 400 * MS
    rig.wait(6.0)
    drops = [event for event in rig.events if isinstance(event, Dropped)]
    first = next(index for index, event in enumerate(drops) if event.reason is DropReason.LATE)
    assert {event.reason for event in drops} <= {DropReason.LATE, DropReason.LINE_BUSY}
    assert {event.count for event in drops[first:] if event.reason is DropReason.LINE_BUSY} <= {by_line} - {0}
    # Every scan of these seconds was sent, or lost for one of the two reasons.
    sent = [scan.sweep for scan in rig.scans() if scan.sweep is not None]
    lost = [number for event in drops for number in event.sweeps or () if number < sent[-1]]
    assert sorted(sent + lost) == list(range(sent[0], sent[-1] + 1, 2))


def test_a_stream_that_was_held_up_does_not_make_good_what_it_missed() -> None:
    rig = streaming("181 points", 500_000, 3)
    rig.measuring_ns = 2 * SECOND
    rig.wait(2.5)
    rig.measuring_ns = 0
    rig.wait(3.0)
    begin = len(rig.scans())
    rig.wait(1.0)
    assert len(rig.scans()) - begin == 75


def test_a_mean_takes_n_scans_of_its_own() -> None:
    rig = Rig.on()
    rig.reply_to("20 48")
    rig.set_speed(500_000)
    rig.ask("20 26 05")
    rig.wait(3.0)
    scans = rig.scans()
    assert rate_hz(scans) == pytest.approx(37.5 / 5, rel=1e-6)
    starts = [plan.sweep for plan in rig.plans]
    assert [b - a for a, b in pairwise(starts)] == [2] * (len(starts) - 1)


def test_a_mean_is_that_of_its_scans() -> None:
    ranges = iter([1.00, 1.02, 1.04, 1.06, 9.0, 9.0, 9.0, 9.0])

    def measure(plan: object) -> Scan:
        return wall(next(ranges))(plan)  # type: ignore[arg-type]

    rig = Rig.on(measure=measure)
    telegram = None
    rig.ask("36 04")
    telegram = rig.await_reply(0xB6, 1.5)
    assert telegram is not None
    values = read_values(telegram)
    assert values is not None
    assert values.scans == 4
    assert set(values.values.tolist()) == {103}


def test_indices_count_turns_and_telegrams() -> None:
    rig = streaming("361 points", 38400, 4, real_time_indices=True)
    found = []
    for scan in rig.scans():
        telegram = open_frame(scan.payload)
        assert telegram is not None
        values = read_values(telegram)
        assert values is not None
        found.append(values.indices)
    turns, telegrams = zip(*[pair for pair in found if pair], strict=True)
    assert {(b - a) % 256 for a, b in pairwise(turns)} == {16}
    assert list(telegrams) == list(range(len(telegrams)))


def test_scans_begin_at_scan_ends_however_requests_come_between() -> None:
    rig = streaming("361 points", 500_000, 3)
    for pause_ms in range(3, 40):
        rig.wait(pause_ms / 1000)
        rig.ask("31")
    rig.wait(0.2)
    for scan in rig.scans():
        assert scan.due_ns == (scan.sweep + 2) * 40_000_000 // 3  # type: ignore[operator]


@pytest.mark.parametrize("baud", [38400, 500_000])
def test_requests_do_not_disturb_the_order_of_partial_scans(baud: int) -> None:
    rig = streaming("partial 1 deg", baud, 1)
    rig.ask("20 25")
    rig.wait(0.5)
    rig.ask("3B 64 00 19 00")
    rig.wait(0.5)
    begin = len(rig.scans())
    rig.ask("20 2A")
    for pause_ms in range(110, 150):
        rig.wait(pause_ms / 1000)
        rig.ask("31")
    found = [read_values(open_frame(scan.payload)) for scan in rig.scans()[begin:]]  # type: ignore[arg-type]
    parts = [values.header.partial for values in found if values is not None]
    assert len(parts) >= 8
    assert parts == [place % 4 for place in range(len(parts))]


def test_a_caller_that_sleeps_for_a_second_gets_no_second_of_old_scans() -> None:
    session = new_session(baud=500_000)
    session.power_on(0)
    session.receive(request(b"\x20\x24"), 0)
    session.take_emissions(60 * MS)
    while (plan := session.next_plan()) is not None:
        session.submit(wall()(plan))
    sent = session.take_emissions(SECOND)
    assert 1 <= len(sent) <= 4
    plan = session.next_plan()
    assert plan is not None
    assert plan.start_ns > SECOND - 60 * MS
