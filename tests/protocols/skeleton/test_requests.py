"""A device made of the shared parts, with several hosts: replies, scans, settings, reset, every sweep told."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocols.errors import ScanRefused
from protocols.scan import Scan, ScanPlan
from protocols.session import Address, CommandHandled, Dropped, DropReason, LinkKind, Restarted
from protocols.skeleton.requests import MAX_WAITING, coverage
from tests.protocols.skeleton.ranger import BOOT_NS, HEARTBEAT_NS, MS, Ranger, framed, request

ONE, TWO = Address(0, 1), Address(0, 2)


def awake(heartbeat: bool = False) -> Ranger:
    session = Ranger(heartbeat)
    session.power_on(0)
    for host in (ONE, TWO):
        session.connected(0, host, LinkKind.STREAM)
    session.take_emissions(BOOT_NS)
    session.take_events()
    return session


def measured(session: Ranger, range_m: float = 5.0) -> ScanPlan:
    plan = session.next_plan()
    assert plan is not None
    scan = Scan.empty(plan)
    scan.range_m[:, 0] = range_m
    session.submit(scan)
    return plan


def reasons(session: Ranger) -> list[DropReason]:
    return [one.reason for one in session.take_events() if isinstance(one, Dropped)]


def test_it_is_deaf_while_it_boots_and_its_line_has_its_speed() -> None:
    session = Ranger()
    session.receive(request(b"S"), 5)
    session.power_on(10)
    assert [(one.due_ns, one.payload, one.line_speed) for one in session.take_emissions(10)] == [(10, b"", 115_200)]
    assert session.next_deadline() == 10 + BOOT_NS
    session.receive(request(b"S"), 10 + BOOT_NS - 1, ONE)
    assert reasons(session) == [DropReason.BOOTING, DropReason.BOOTING]
    assert not session.is_up
    session.receive(request(b"S"), 10 + BOOT_NS, ONE)
    assert session.is_up
    assert [one.payload for one in session.take_emissions(10 + BOOT_NS + MS)] == [framed(b"BA", b"S")]


@given(st.lists(st.integers(0, 100), max_size=10))
def test_replies_are_the_same_in_any_pieces(cuts: list[int]) -> None:
    data = request(b"R", b"\x14") + b"noise" + request(b"Z") + request(b"\x00") + request(b"R", b"") + request(b"Q")
    session = awake()
    places = [0, *sorted(min(cut, len(data)) for cut in cuts), len(data)]
    for begin, end in pairwise(places):
        session.receive(data[begin:end], BOOT_NS, ONE)
    assert session.take_emissions(BOOT_NS + MS - 1) == []
    said = session.take_emissions(BOOT_NS + MS)
    assert [one.payload for one in said] == [
        framed(b"BA", b"R\x14"),
        framed(b"BA", b"?Z"),
        framed(b"BA", b"?\x00"),
        framed(b"BA", b"?R"),
    ]
    assert {one.address for one in said} == {ONE}
    events = session.take_events()
    assert [(one.command, one.outcome) for one in events if isinstance(one, CommandHandled)] == [
        ("R", "done"),
        ("00", DropReason.REFUSED.value),
        ("R", DropReason.BAD_ARGUMENT.value),
        ("Q", "done"),
    ]
    dropped = [one for one in events if isinstance(one, Dropped)]
    assert sum(one.count for one in dropped if one.reason is DropReason.NO_START_BYTE) == len(b"noise")


def test_a_damaged_frame_is_complained_of_to_its_sender_and_half_a_one_times_out() -> None:
    session = awake()
    session.receive(request(b"S")[:-1] + b"\xff", BOOT_NS, TWO)
    assert [(one.payload, one.address) for one in session.take_emissions(BOOT_NS + MS)] == [(b"\x15", TWO)]
    session.take_events()
    session.receive(b"AB", BOOT_NS + 2 * MS, TWO)
    assert session.next_deadline() == BOOT_NS + 52 * MS
    session.advance(BOOT_NS + 52 * MS - 1)
    assert reasons(session) == []
    session.advance(BOOT_NS + 52 * MS)
    assert reasons(session) == [DropReason.TIMEOUT]
    assert session.next_deadline() is None


def test_a_datagram_ends_what_it_holds() -> None:
    session = awake()
    session.connected(BOOT_NS, Address(3, 0), LinkKind.DATAGRAM)
    session.receive(request(b"S")[:3], BOOT_NS, Address(3, 5000))
    assert reasons(session) == [DropReason.TIMEOUT, DropReason.NO_START_BYTE]
    session.receive(request(b"S"), BOOT_NS, Address(3, 5001))
    assert [one.address for one in session.take_emissions(BOOT_NS + MS)] == [Address(3, 5001)]


def test_a_flood_of_requests_is_bounded_for_each_host() -> None:
    session = awake()
    session.receive(request(b"R", b"\x0a") * 500, BOOT_NS, ONE)
    session.receive(request(b"R", b"\x0a"), BOOT_NS, TWO)
    said = session.take_emissions(BOOT_NS + MS)
    assert [one.address for one in said] == [ONE] * MAX_WAITING + [TWO]
    assert reasons(session) == [DropReason.BUSY] * (500 - MAX_WAITING)
    session.receive(request(b"R", b"\x0a"), BOOT_NS + MS, ONE)
    assert len(session.take_emissions(BOOT_NS + 2 * MS)) == 1


def test_each_host_gets_the_scans_that_begin_after_it_asked_in_parts_at_their_instants() -> None:
    session = awake()
    session.receive(request(b"S"), BOOT_NS, ONE)
    session.receive(request(b"S"), BOOT_NS + 5 * MS, TWO)
    assert measured(session).start_ns == BOOT_NS
    session.take_emissions(BOOT_NS + 5 * MS)
    second = measured(session)
    assert second.start_ns == BOOT_NS + 33_333_333
    left = [(one.due_ns - BOOT_NS, one.address, one.sweep, one.scans, one.payload[:1])
            for one in session.take_emissions(BOOT_NS + 50 * MS) if one.label in "12"]  # fmt: skip
    assert left == [
        (6 * MS, ONE, 0, 1, b"1"),
        (10 * MS, ONE, None, 0, b"2"),
        (39_333_333, ONE, 1, 1, b"1"),
        (39_333_333, TWO, 1, 1, b"1"),
        (43_333_333, ONE, None, 0, b"2"),
        (43_333_333, TWO, None, 0, b"2"),
    ]


def test_a_host_that_goes_takes_only_its_own_scans_and_replies_along() -> None:
    session = awake()
    for host in (ONE, TWO):
        session.receive(request(b"S"), BOOT_NS, host)
    first = measured(session)
    session.take_emissions(first.start_ns + 6 * MS)  # begun for both: what has begun goes on to whoever is there
    second = measured(session)
    session.take_events()
    session.disconnected(first.start_ns + 7 * MS, ONE)
    reported = [one for one in session.take_events() if isinstance(one, Dropped)]
    assert [(one.reason, one.sweeps, one.address) for one in reported] == [
        (DropReason.STALE, range(second.sweep, second.sweep + 1), ONE)
    ]
    assert {one.address for one in session.take_emissions(BOOT_NS + 99 * MS)} == {TWO}
    assert session.next_plan() is not None
    session.receive(request(b"E"), BOOT_NS + 99 * MS, TWO)
    assert session.next_plan() is None


def test_a_sweep_whose_only_host_has_gone_is_told_though_another_waits_for_the_next() -> None:
    session = awake()
    session.receive(request(b"S"), BOOT_NS, ONE)
    session.receive(request(b"S"), BOOT_NS + MS, TWO)
    session.receive(request(b"E"), BOOT_NS + 2 * MS, ONE)
    session.take_events()
    plan = measured(session)
    reported = [(one.reason, one.sweeps) for one in session.take_events() if isinstance(one, Dropped)]
    assert reported == [(DropReason.STALE, range(plan.sweep, plan.sweep + 1))]
    measured(session)
    assert {one.address for one in session.take_emissions(BOOT_NS + 99 * MS) if one.label in ("1", "2")} == {TWO}


def test_a_changed_setting_refuses_and_withdraws_what_was_measured_under_the_old_one() -> None:
    session = awake()
    session.receive(request(b"S"), BOOT_NS, ONE)
    waiting = measured(session)
    stale = session.next_plan()
    assert stale is not None
    session.receive(request(b"R", b"\x0a"), BOOT_NS + MS, ONE)
    with pytest.raises(ScanRefused):
        session.submit(Scan.empty(stale))
    reported = [one.sweeps for one in session.take_events() if isinstance(one, Dropped)]
    assert reported == [range(waiting.sweep, waiting.sweep + 1)]
    plan = session.next_plan()
    assert plan is not None
    assert plan.epoch > stale.epoch
    assert plan.stream != stale.stream
    assert plan.period_ns == 100 * MS
    assert plan.start_ns == BOOT_NS + 33_333_333


def test_a_reset_answers_first_then_is_deaf_and_loses_what_is_volatile() -> None:
    session = awake()
    session.receive(request(b"S") + request(b"R", b"\x05") + request(b"X"), BOOT_NS, ONE)
    said = session.take_emissions(BOOT_NS + MS)
    assert [one.payload[3:4] for one in said if one.payload] == [b"S", b"R", b"X"]
    assert (said[-1].payload, said[-1].line_speed) == (b"", 115_200)
    assert [one.at_ns for one in session.take_events() if isinstance(one, Restarted)] == [BOOT_NS + MS]
    session.receive(request(b"S"), BOOT_NS + 2 * MS, ONE)
    assert reasons(session) == [DropReason.BOOTING]
    session.receive(request(b"S"), 2 * BOOT_NS + MS, ONE)
    plan = session.next_plan()
    assert plan is not None
    assert (plan.sweep, plan.start_ns, plan.period_ns) == (0, 2 * BOOT_NS + MS, 33_333_333)


def test_the_line_changes_its_speed_behind_the_reply() -> None:
    session = awake()
    session.receive(request(b"B"), BOOT_NS, ONE)
    assert [one.line_speed for one in session.take_emissions(BOOT_NS + MS)] == [460_800]


@given(st.lists(st.integers(1, 400), min_size=1, max_size=12), st.lists(st.booleans(), min_size=12, max_size=12))
def test_sweeps_are_numbered_without_gaps_each_measured_or_told(steps_ms: list[int], gives_up: list[bool]) -> None:
    session, now_ns = awake(), BOOT_NS
    session.receive(request(b"S"), now_ns, ONE)
    stream, seen = None, set()
    for step, given_up in zip(steps_ms, gives_up, strict=False):
        plan = session.next_plan()
        assert plan is not None
        stream = plan.stream if stream is None else stream
        assert (plan.stream, plan.start_ns) == (stream, BOOT_NS + plan.sweep * 100 * MS // 3)
        now_ns += step * MS
        session.advance(now_ns)
        if given_up:
            assert session.missed(plan, now_ns)
            continue
        session.submit(Scan.empty(plan))
        assert plan.sweep not in seen
        seen.add(plan.sweep)
    following = session.next_plan()
    assert following is not None
    late = [n for one in session.take_events() if isinstance(one, Dropped) and one.sweeps for n in one.sweeps]
    assert sorted([*seen, *late]) == list(range(following.sweep))
    assert following.start_ns + 10 * MS >= now_ns or session.next_plan() is following


@given(st.lists(st.integers(1, 900), max_size=20))
def test_the_same_bytes_leave_at_the_same_instants_however_time_is_cut(cuts_ms: list[int]) -> None:
    def run(calls: list[int]) -> list[tuple[int, bytes]]:
        session = awake(heartbeat=True)
        session.receive(request(b"S"), BOOT_NS, ONE)
        for _ in range(5):
            measured(session)
        left = [one for call in calls for one in session.take_emissions(BOOT_NS + call * MS)]
        return [(one.due_ns, one.payload) for one in left]

    whole = run([900])
    assert run([*sorted(cuts_ms), 900]) == whole
    assert [at for at, payload in whole if payload == b"beat"] == [BOOT_NS + k * HEARTBEAT_NS for k in (1, 2, 3)]


def test_deadlines_are_those_of_the_next_telegram_or_instant() -> None:
    session = awake(heartbeat=True)
    session.receive(request(b"S"), BOOT_NS, ONE)
    measured(session)
    seen = []
    while (due_ns := session.next_deadline()) is not None and due_ns <= BOOT_NS + HEARTBEAT_NS:
        assert session.take_emissions(due_ns - 1) == []
        seen.append((due_ns - BOOT_NS, len(session.take_emissions(due_ns))))
    assert seen == [(MS, 1), (6 * MS, 1), (10 * MS, 1), (HEARTBEAT_NS, 1)]


def test_a_fast_motor_turns_everything_faster() -> None:
    session = awake()
    session.receive(request(b"S"), BOOT_NS, ONE)
    before = session.next_plan()
    assert before is not None
    assert session.impair(BOOT_NS + MS, "motor speed", 2.0)
    assert not session.impair(BOOT_NS + MS, "window", 0.5)
    plan = measured(session)
    np.testing.assert_allclose(plan.fire_offset_s, before.fire_offset_s / 2.0)
    assert plan.duration_s == before.duration_s / 2.0
    assert session.next_plan().start_ns - plan.start_ns == int(Fraction(50 * MS, 3))  # type: ignore[union-attr]
    left = [one.due_ns for one in session.take_emissions(plan.start_ns + 30 * MS) if one.label in ("1", "2")]
    assert left == [plan.start_ns + 3 * MS, plan.start_ns + 5 * MS]


def test_the_table_is_the_coverage() -> None:
    rows = {row.code: (row.status, row.note) for row in coverage(Ranger.COMMANDS)}
    assert rows["R"] == ("done", "1 to 50")
    assert rows["00"] == ("refused", "")
