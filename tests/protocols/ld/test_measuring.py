"""Revolutions: their instants, their beams, who gets which profile, and what happens when something is too slow."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocols.ld.head import Rotation
from protocols.scan import DAZZLED, Scan, ScanPlan
from protocols.session import LinkKind
from tests.protocols.ld.reader import request, words
from tests.protocols.ld.rig import MS, SECOND, TCP, measuring, profiles, scan_of, ten_metres

# the head


@given(st.integers(5, 20), st.integers(0, 10**15), st.integers(0, 10**9), st.integers(-5760, 11520))
def test_a_revolution_is_never_off_by_more_than_half_a_nanosecond(
    hz: int, origin_ns: int, revolution: int, ticks: int
) -> None:
    passes = Rotation(origin_ns, hz, 0).passes_ns(revolution, ticks)
    exact = origin_ns + Fraction((revolution * 5760 + ticks) * 10**9, 5760 * hz)
    assert abs(passes - exact) <= Fraction(1, 2)


@given(st.integers(5, 20), st.integers(0, 10**12), st.integers(0, 5759))
def test_the_first_revolution_from_an_instant_is_the_first(hz: int, instant_ns: int, ticks: int) -> None:
    rotation = Rotation(1_000_000_007, hz, 0)
    revolution = rotation.first_from(instant_ns, ticks)
    assert rotation.passes_ns(revolution, ticks) >= instant_ns
    assert revolution == 0 or rotation.passes_ns(revolution - 1, ticks) < instant_ns


@pytest.mark.parametrize(("instant_ns", "sweep"), [(0, 8), (1, 9), (100_000_000, 9), (100_000_001, 10)])
def test_a_head_begun_anew_counts_on_behind_the_revolution_under_way(instant_ns: int, sweep: int) -> None:
    rotation = Rotation(0, 10, 7)
    assert rotation.sweep_after(instant_ns) == sweep
    assert sweep > 7 + rotation.first_from(instant_ns, 0)


@pytest.mark.parametrize("hz", [5, 7, 13, 20])
def test_profiles_leave_once_a_revolution_without_drift(hz: int) -> None:
    rig = measuring({"motor_hz": hz, "step_deg": 22.5}, facts={"model": "sick-ld-oem1000"})
    rig.put(request(0x0301, 0, 0x0002))
    rig.run(30 * SECOND)
    sent = [emission for emission in rig.take() if emission.sweep is not None]
    assert len(sent) == 30 * hz
    for emission in sent:
        assert emission.sweep is not None
        exact = Fraction((emission.sweep + 1) * SECOND, hz)
        assert abs(emission.due_ns - exact) <= Fraction(1, 2)
    assert [emission.sweep for emission in sent] == list(range(30 * hz))


# the beams


def test_each_beam_has_its_own_instant_and_its_direction_clockwise() -> None:
    rig = measuring({"motor_hz": 8, "step_deg": 0.5, "sectors": [{"from_deg": 90, "to_deg": 270}]})
    rig.put(request(0x0301, 1, 0x0100))
    rig.run(SECOND)
    plan = rig.plans[0]
    directions = np.arange(1440, 4321, 8)
    assert len(plan) == 361
    azimuth = -directions * 2 * np.pi / 5760
    assert np.allclose(np.cos(plan.azimuth_rad), np.cos(azimuth), atol=1e-12)
    assert np.allclose(np.sin(plan.azimuth_rad), np.sin(azimuth), atol=1e-12)
    assert plan.azimuth_rad.min() >= -np.pi
    assert plan.azimuth_rad.max() < np.pi
    assert plan.elevation_rad.tolist() == [0.0] * 361
    offsets = [Fraction(int(ticks) - 1440, 5760 * 8) for ticks in directions]
    assert np.allclose(plan.fire_offset_s, [float(offset) for offset in offsets], rtol=1e-15, atol=0)
    # the revolution begins where its first sector does: a quarter of a turn after the head passed direction 0
    assert plan.start_ns == 125 * MS // 4
    assert plan.duration_s == 0.125


def test_direction_0_lies_where_the_scenario_says() -> None:
    rig = measuring({"step_deg": 90, "zero_deg": 90})
    rig.put(request(0x0301, 1, 0x0200))
    rig.run(SECOND)
    assert np.allclose(np.degrees(rig.plans[0].azimuth_rad), [90, 0, -90, -180])


def test_sectors_are_measured_only_where_active_and_in_order() -> None:
    table = [
        {"stop_deg": 30, "function": "normal"},
        {"stop_deg": 99.5, "function": "none"},
        {"stop_deg": 120, "function": "reference"},
        {"stop_deg": 350, "function": "none"},
    ]

    def by_direction(plan: ScanPlan) -> Scan:
        return scan_of(plan, 1.0 + np.round(-np.degrees(plan.azimuth_rad) % 360 * 16) / 256)

    rig = measuring({"sectors": table}, world=by_direction)
    rig.put(request(0x0301, 1, 0x3FFF))
    rig.run(SECOND)
    (profile,) = profiles(rig)
    assert [sector.count for sector in profile.sectors] == [80, 0, 41, 0]
    for sector in profile.sectors:
        assert sector.distances == [256 + direction for direction in sector.directions]
    assert [(sector.start, sector.end) for sector in profile.sectors] == [
        (5608, 480), (488, 1592), (1600, 1920), (1928, 5600),
    ]  # fmt: skip


def test_a_rested_device_asks_for_nothing() -> None:
    rig = measuring()
    rig.run(SECOND)
    assert rig.session.next_plan() is None
    assert rig.plans == []
    assert rig.session.next_deadline() is None


def test_amplitudes_are_asked_for_only_when_a_format_has_them() -> None:
    rig = measuring()
    rig.put(request(0x0301, 0, 0x0100))
    rig.run(300 * MS)
    assert not any(plan.wants_intensity for plan in rig.plans)
    measured = len(rig.plans)
    second = TCP._replace(peer=2)
    rig.session.connected(rig.now_ns, second, LinkKind.STREAM)
    rig.put(request(0x0301, 3, 0x0400), second)
    rig.run(SECOND)
    assert all(plan.wants_intensity for plan in rig.plans[measured : measured + 3])
    assert not rig.plans[-1].wants_intensity
    echoes = profiles(rig, second, [720])
    assert [set(profile.sectors[0].echoes) for profile in echoes] == [{1600}] * 3
    firsts = profiles(rig, TCP, [720])
    assert len(firsts) == 13  # the first host lost none
    assert [profile.sectors[0].distances[0] for profile in firsts] == [2560] * 13


def test_near_echoes_are_passed_over_while_the_filter_is_on() -> None:
    def two_echoes(plan: ScanPlan) -> Scan:
        ranges = np.full((len(plan), 2), np.nan)
        ranges[:, 0], ranges[1::2, 1] = 1.5, 7.0
        size = ranges.shape
        peaks = np.where(np.isnan(ranges), np.nan, ranges)
        return Scan(plan, ranges, peaks, np.zeros(len(plan), np.uint8), np.zeros(size, np.int32))

    rig = measuring({"step_deg": 90}, world=two_echoes)
    rig.put(request(0x0301, 1, 0x0500))
    rig.run(SECOND)
    assert profiles(rig, points=[4])[0].sectors[0].distances == [384] * 4
    rig.ask(0x0209, 1, 1)
    rig.ask(0x0403, 0)
    rig.ask(0x0404)
    rig.put(request(0x0301, 1, 0x0500))
    rig.run(SECOND)
    sector = profiles(rig, points=[4])[0].sectors[0]
    assert sector.distances == [0, 1792, 0, 1792]
    assert sector.echoes == [0, 112, 0, 112]
    assert rig.plans[-1].max_echoes == 2


def test_a_dazzled_beam_has_no_echo() -> None:
    def dazzled(plan: ScanPlan) -> Scan:
        scan = ten_metres(plan)
        scan.flags[1] = DAZZLED
        return scan

    rig = measuring({"step_deg": 90}, world=dazzled)
    rig.put(request(0x0301, 1, 0x0500))
    rig.run(SECOND)
    (profile,) = profiles(rig, points=[4])
    assert profile.sectors[0].distances == [2560, 0, 2560, 2560]
    assert profile.sectors[0].echoes == [1600, 0, 1600, 1600]


# who gets what


def test_exactly_so_many_profiles_come_as_were_asked_for() -> None:
    rig = measuring()
    for number in (1, 3):
        measured = len(rig.plans)
        rig.put(request(0x0301, number, 0x0003))
        rig.run(SECOND)
        assert [profile.sent for profile in profiles(rig)] == list(range(1, number + 1))
        assert len(rig.plans) - measured == number  # and no revolution is measured in vain


def test_the_first_profile_is_that_of_the_first_whole_revolution() -> None:
    rig = measuring()
    rig.run(130 * MS)
    rig.put(request(0x0301, 0, 0x0002))
    rig.run(SECOND)
    first = rig.take()[0]
    assert (first.sweep, first.due_ns) == (2, 300 * MS)


def test_a_new_request_replaces_the_old_one() -> None:
    rig = measuring()
    rig.put(request(0x0301, 0, 0x0001))
    rig.run(450 * MS)
    rig.put(request(0x0301, 2, 0x0003))
    rig.run(SECOND)
    found = profiles(rig)
    assert [profile.form for profile in found] == [1, 1, 1, 1, 3, 3]


def test_no_profile_follows_the_reply_to_a_cancel() -> None:
    rig = measuring()
    for instant in range(0, 100, 7):
        rig.put(request(0x0301, 0, 0x0100))
        rig.run((300 + instant) * MS)
        rig.put(request(0x0302))
        rig.run(500 * MS)
        assert rig.take()[-1].label == "8302"


@pytest.mark.parametrize(
    ("asked_us", "order"),
    [
        (98_500, [("8102", 99_500), ("8301", 104_500)]),  # five milliseconds behind the reply
        (99_500, [("8102", 100_500), ("8301", 105_500)]),  # and not before one that is on its way
        (99_999, [("8102", 100_999), ("8301", 105_999)]),
        (100_001, [("8301", 100_000), ("8102", 101_001)]),
    ],
)
def test_a_profile_keeps_its_distance_behind_a_reply(asked_us: int, order: list[tuple[str, int]]) -> None:
    rig = measuring()
    rig.put(request(0x0301, 0, 0x0001))
    rig.run(asked_us * 1000)
    rig.put(request(0x0102))
    rig.run(310 * MS - rig.now_ns)
    sent = [(emission.label, emission.due_ns // 1000) for emission in rig.take()]
    assert sent == [*order, ("8301", 200_000), ("8301", 300_000)]


def test_profiles_end_when_another_host_takes_the_device_out_of_measure() -> None:
    rig = measuring()
    other = TCP._replace(peer=2)
    rig.session.connected(0, other, LinkKind.STREAM)
    rig.put(request(0x0301, 0, 0x0001))
    rig.run(250 * MS)
    assert words(rig.ask(0x0403, 0, address=other)) == [0x8403, 0, 2]
    rig.take()
    rig.run(SECOND)
    assert rig.take() == []
    assert rig.session.next_plan() is None
    assert words(rig.ask(0x0404, address=other)) == [0x8404, 0, 3, 0]
    rig.run(SECOND)
    assert rig.take() == []  # to be asked for again


def test_measure_told_again_without_a_change_disturbs_nobody() -> None:
    rig = measuring()
    other = TCP._replace(peer=2)
    rig.session.connected(0, other, LinkKind.STREAM)
    rig.put(request(0x0301, 0, 0x0001))
    rig.run(250 * MS)
    assert words(rig.ask(0x0404, address=other)) == [0x8404, 0, 3, 0]
    rig.run(SECOND - rig.now_ns)
    assert len(profiles(rig, TCP)) == 10


def test_a_host_that_disappears_stops_its_profiles_and_no_others() -> None:
    rig = measuring()
    other = TCP._replace(peer=2)
    rig.session.connected(0, other, LinkKind.STREAM)
    rig.put(request(0x0301, 0, 0x0001))
    rig.put(request(0x0301, 0, 0x0001), other)
    rig.run(250 * MS)
    rig.session.disconnected(rig.now_ns, other)
    rig.run(250 * MS)
    assert len(profiles(rig, other)) == 2
    assert len(profiles(rig, TCP)) == 5
    rig.session.disconnected(rig.now_ns, TCP)
    rig.run(SECOND)
    assert rig.take() == []
    assert rig.session.next_plan() is None
    rig.session.disconnected(rig.now_ns, TCP)
    rig.session.connected(rig.now_ns, TCP, LinkKind.STREAM)
    assert words(rig.ask(0x0102)) == [0x8102, 0, 3]  # the device went on all the time


def test_a_faster_head_keeps_counting_revolutions() -> None:
    rig = measuring({"step_deg": 0.75}, facts={"model": "sick-ld-oem1000"})
    rig.put(request(0x0301, 0, 0x0002))
    rig.run(550 * MS)
    last = profiles(rig)[-1].counter
    rig.ask(0x0403, 20)
    assert words(rig.ask(0x0404)) == [0x8404, 0, 3, 0]
    rig.put(request(0x0301, 2, 0x0002))
    rig.run(SECOND)
    first, second = rig.take()
    assert second.due_ns - first.due_ns == 50 * MS
    assert last is not None
    assert first.sweep is not None
    assert first.sweep > last
    sweeps = [(plan.epoch, plan.sweep) for plan in rig.plans]
    assert len(set(sweeps)) == len(sweeps)


def test_time_stamps_follow_the_clock_and_the_arc() -> None:
    rig = measuring({"motor_hz": 10, "sectors": [{"from_deg": 0, "to_deg": 180}], "clock_ms": 65400})
    rig.put(request(0x0301, 4, 0x0840))
    rig.run(SECOND)
    found = profiles(rig, points=[361, 0])
    starts = [profile.sectors[0].start_ms for profile in found]
    assert starts == [65400, 65500, 64, 164]  # wraps at 65536
    assert [profile.sectors[0].end_ms for profile in found] == [65450, 14, 114, 214]
    assert [profile.sectors[1].end_ms for profile in found] == [65499, 63, 163, 263]
