"""Scans that come late or not at all, and lines slower than the head: what is dropped, and that it is counted."""

from __future__ import annotations

import numpy as np
import pytest

from protocols.errors import ScanRefused
from protocols.scan import Scan
from protocols.session import Address, DropReason, LinkKind
from tests.protocols.ld.reader import can_frames, package, read_can, read_packages, request
from tests.protocols.ld.rig import MS, SECOND, TCP, Rig, measuring, ten_metres


def test_a_scan_of_other_settings_is_refused() -> None:
    rig = measuring()
    session = rig.session
    session.receive(request(0x0301, 0, 0x0100), 0, TCP)
    plan = session.next_plan()
    assert plan is not None
    assert session.next_plan() is plan
    session.receive(request(0x0302), 0, TCP)
    session.advance(SECOND)
    with pytest.raises(ScanRefused):
        session.submit(ten_metres(plan))
    session.receive(request(0x0301, 0, 0x0100), SECOND, TCP)
    plan = session.next_plan()
    assert plan is not None
    session.receive(request(0x0403, 0), SECOND, TCP)
    session.advance(2 * SECOND)
    with pytest.raises(ScanRefused):
        session.submit(ten_metres(plan))


def test_a_scan_of_another_size_is_refused() -> None:
    rig = measuring()
    rig.session.receive(request(0x0301, 0, 0x0100), 0, TCP)
    plan = rig.session.next_plan()
    assert plan is not None
    scan = ten_metres(plan)
    with pytest.raises(ScanRefused, match="719"):
        rig.session.submit(Scan(plan, scan.range_m[1:], scan.intensity[1:], scan.flags[1:], scan.actor[1:]))


def test_revolutions_that_are_not_measured_in_time_are_passed_over_and_counted() -> None:
    rig = measuring()
    session = rig.session
    session.receive(request(0x0301, 0, 0x0002), 0, TCP)
    plan = session.next_plan()
    assert plan is not None
    session.advance(730 * MS)  # the measurement took more than seven revolutions
    session.submit(ten_metres(plan))
    (late,) = session.take_emissions(730 * MS)
    assert (late.sweep, late.due_ns) == (0, 100 * MS)  # sent late, with its own instant
    rig.dropped()
    plan = session.next_plan()
    assert plan is not None
    assert (plan.sweep, plan.start_ns) == (7, 700 * MS)
    assert [(event.reason, event.count) for event in session.take_events()] == [(DropReason.LATE, 6)]  # type: ignore[union-attr]


def test_no_more_than_four_revolutions_are_measured_ahead() -> None:
    rig = measuring()
    session = rig.session
    session.receive(request(0x0301, 0, 0x0100), 0, TCP)
    measured = 0
    while (plan := session.next_plan()) is not None:
        session.submit(ten_metres(plan))
        measured += 1
        assert measured < 10
    assert measured == 4
    assert session.take_emissions(99 * MS) == []
    assert len(session.take_emissions(100 * MS)) == 1


def test_a_serial_line_slower_than_the_head_drops_whole_profiles_and_counts_them() -> None:
    rig = Rig({"mode": "measure", "motor_hz": 10, "step_deg": 1}, ten_metres, LinkKind.SERIAL, Address(0, 0))
    rig.run(0)
    rig.take()
    rig.put(package(0x0010, 5, 0, 0x0301, 0, 0x0700))
    rig.run(10 * SECOND)
    sent = [emission for emission in rig.take() if emission.sweep is not None]
    size = len(sent[0].payload)
    assert size * 10 / 115200 == pytest.approx(0.389, abs=0.01)
    assert len(sent) == 25  # every fourth of a hundred
    assert rig.dropped().count(DropReason.LINE_BUSY) == 75
    free_ns = 0
    for emission in sent:
        assert emission.due_ns >= free_ns  # never two on the line at once
        free_ns = emission.due_ns + size * 10 * SECOND // 115200
        ((address, message),) = read_packages(emission.payload)
        assert (address, len(message)) == (0x1000, 3 + 3 * 360)
    assert [read_packages(emission.payload)[0][1][3] for emission in sent] == [2560] * 25


def test_a_bus_slower_than_the_head_drops_whole_profiles_and_counts_them() -> None:
    rig = Rig({"mode": "measure", "can_kbit_s": 125}, ten_metres, LinkKind.CAN, Address(0, 0))
    for data in can_frames(16, 0x0301, 0, 0x0100):
        rig.put(data, Address(0, 0x2AB))
    rig.run(5 * SECOND // 2)
    sent = rig.take()
    messages = read_can([emission.payload for emission in sent][: len(sent) // 242 * 242])
    assert all(len(message) == 723 for _, message in messages)
    dropped = rig.dropped()
    assert set(dropped) == {DropReason.LINE_BUSY}
    assert sum(emission.sweep is not None for emission in sent) + len(dropped) == 25
    gaps = np.diff([emission.due_ns for emission in sent[:242]])
    assert gaps.min() >= 111 * SECOND // 125_000  # no frame before the bus can carry it


def test_a_reply_waits_for_the_profile_that_is_on_the_serial_line() -> None:
    rig = Rig({"mode": "measure", "step_deg": 1}, ten_metres, LinkKind.SERIAL, Address(0, 0))
    rig.run(0)
    rig.take()
    rig.put(package(0x0010, 5, 0, 0x0301, 0, 0x0700))
    rig.run(150 * MS)
    rig.put(package(0x0010, 3, 0, 0x0302) + b"\x020\x03")
    rig.run(SECOND)
    profile, reply, nak = rig.take()
    left_ns = profile.due_ns + len(profile.payload) * 10 * SECOND // 115200
    assert (profile.label, reply.label, nak.label) == ("8301", "8302", "NAK")
    assert reply.due_ns >= left_ns
    assert nak.due_ns >= reply.due_ns + len(reply.payload) * 10 * SECOND // 115200


def test_a_late_profile_does_not_overtake_the_one_on_the_serial_line() -> None:
    session = Rig({"mode": "measure", "step_deg": 1}, ten_metres, LinkKind.SERIAL, Address(0, 0)).session
    session.receive(package(0x0010, 5, 0, 0x0301, 0, 0x0700), 0, Address(0, 0))
    session.take_emissions(0)
    plans = []
    for _ in range(4):
        plan = session.next_plan()
        assert plan is not None
        plans.append(plan)
        if len(plans) < 4:
            session.submit(ten_metres(plan))
    (first,) = session.take_emissions(399 * MS)
    left_ns = first.due_ns + -(-len(first.payload) * 10 * SECOND // 115200)
    session.advance(600 * MS)
    session.submit(ten_metres(plans[3]))  # of the revolution that ended at 400 ms, when the line was not yet free
    (late,) = session.take_emissions(600 * MS)
    assert (late.sweep, late.due_ns) == (3, left_ns)


def test_a_message_on_can_that_has_begun_is_finished_before_the_reply_to_a_cancel() -> None:
    rig = Rig({"mode": "measure"}, ten_metres, LinkKind.CAN, Address(0, 0))
    for data in can_frames(16, 0x0301, 0, 0x0100):
        rig.put(data, Address(0, 0x2AB))
    rig.run(110 * MS)
    for data in can_frames(16, 0x0302):
        rig.put(data, Address(0, 0x2AB))
    rig.run(SECOND)
    sent = rig.take()
    messages = read_can([emission.payload for emission in sent])
    assert [message[0] for _, message in messages] == [0x8301, 0x8302]
    assert len(messages[0][1]) == 723
    times = [emission.due_ns for emission in sent]
    assert times == sorted(times)


def test_a_reply_to_a_host_that_has_gone_is_not_sent() -> None:
    rig = measuring()
    rig.put(request(0x0102))
    rig.session.disconnected(rig.now_ns, TCP)
    rig.session.connected(rig.now_ns, TCP, LinkKind.STREAM)
    rig.run(SECOND)
    assert rig.take() == []


def test_two_telegrams_on_one_channel_are_a_millisecond_apart() -> None:
    session = measuring().session
    channel = session._channels[TCP]
    first = channel.telegram(b"\x81\x02", 0, SECOND, session.device)
    second = channel.telegram(b"\x81\x02", 0, SECOND, session.device)
    profile = channel.telegram(b"\x83\x01", 0, SECOND, session.device, sweep=1)
    assert [sent.emissions[0].due_ns - SECOND for sent in (first, second, profile)] == [0, 1 * MS, 6 * MS]


def test_a_profile_withdrawn_before_it_begins_keeps_nobody_waiting() -> None:
    for kind, host in ((LinkKind.CAN, Address(0, 0x2AB)), (LinkKind.SERIAL, Address(0, 0))):

        def put(rig: Rig, *message: int, kind: LinkKind = kind, host: Address = host) -> None:
            count = len(message) + 2
            telegrams = can_frames(16, *message) if kind is LinkKind.CAN else [package(0x0010, count, 0, *message)]
            for data in telegrams:
                rig.put(data, host)

        rig = Rig({"mode": "measure", "delays": "fast"}, ten_metres, kind, Address(0, 0))
        rig.run(0)
        rig.take()
        put(rig, 0x0301, 0, 0x0100)
        rig.run(98 * MS)
        put(rig, 0x0102)  # its reply pushes the profile back by five milliseconds
        rig.run(4 * MS)
        assert {emission.label for emission in rig.take()} == {"8102"}
        put(rig, 0x0302)
        rig.run(SECOND)
        reply, *more = rig.take()
        assert reply.label == "8302"
        assert reply.due_ns <= 107 * MS  # not when the profile would have left
        assert {emission.label for emission in more} <= {"8302"}
