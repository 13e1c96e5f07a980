"""Any bytes, in any pieces: the same replies, no exception, bounded memory."""

from __future__ import annotations

import itertools

from hypothesis import given
from hypothesis import strategies as st

from protocols.lms2xx.session import Lms2xxSession
from protocols.lms2xx.telegrams import frame, open_frame, request
from protocols.session import Emission, ModeChanged
from protocols.skeleton.serial_lines import line_ns
from tests.protocols.lms2xx.rig import MS, SECOND, new_session, wall

PASSWORD = b"SICK_LMS"
COMMANDS = [
    b"\x10",
    b"\x20\x00" + PASSWORD,
    b"\x20\x10",
    b"\x20\x24",
    b"\x20\x25",
    b"\x20\x26\x03",
    b"\x20\x27\x01\x00\x09\x00",
    b"\x20\x28\x02\x01\x00\x09\x00",
    b"\x20\x2a",
    b"\x20\x2b\x01\x00\x01\x00\x09\x00",
    b"\x20\x40",
    b"\x20\x42",
    b"\x20\x48",
    b"\x30\x01",
    b"\x31",
    b"\x36\x02",
    b"\x37\x02\x00\x05\x00",
    b"\x3a",
    b"\x3b\xb4\x00\x64\x00",
    b"\x3b\x64\x00\x19\x00",
    b"\x66\x01",
    b"\x74",
    b"\x77\x00\x00\x46\x00\x02\x01\x01",
    b"\x77\x00\x00\x46\x00\x00\x00\x00",
    b"\x20\x20",
    b"\x20\x23",
    b"\x20\x27\x01\x80\xb5\x00",
    b"\x20\x29\x01\x00\x04\x00",
    b"\x20\x2c\x01\x01\x00\x09\x00",
    b"\x30\x02",
    b"\x30\x06",
    b"\x30\x08",
    b"\x37\x01\x80\x09\x00",
    b"\x3e\x01\x00\x04\x00",
    b"\x41\x02",
    b"\x46\x01\x40\xb4\x00\x32\x00\x00\x05\x00\x00\x00\x00\x00",
    b"\x46\x01\x40\xb4\x00\x32\x00\x01\x05\x00\x00\x00\x00\x00",
    b"\x4a",
    b"\x76\x01\x00\x09\x00",
    b"\x7b",
    b"\x99",
]

requests = st.builds(request, st.sampled_from(COMMANDS), st.sampled_from([0, 0, 0, 0, 7, 9]))
broken = st.builds(lambda whole, cut: whole[:cut], requests, st.integers(1, 12))


def spoil(whole: bytes, at: int) -> bytes:
    at %= len(whole)
    return whole[:at] + b"\x02" + whole[at + 1 :]


spoilt = st.builds(spoil, requests, st.integers(0, 50))
nested = st.builds(lambda inner, address: frame(address, b"\x77" + inner), requests, st.integers(0, 127))
lookalike = st.builds(lambda a, n, c: bytes((2, a)) + n.to_bytes(2, "little") + bytes((c,)), *[st.integers(0, 20)] * 3)
pieces = st.one_of(requests, requests, requests, broken, spoilt, nested, lookalike, st.binary(max_size=20))


def finish(session: Lms2xxSession, from_ns: int, duration_ns: int) -> list[Emission]:
    """Let time pass as an instrument would."""
    measure, sent, now_ns, until_ns = wall(), [], from_ns, from_ns + duration_ns
    for _ in range(400):
        while (plan := session.next_plan()) is not None:
            session.submit(measure(plan))
        sent += session.take_emissions(now_ns)
        deadline = session.next_deadline()
        if deadline is None or deadline > until_ns:
            break
        now_ns = max(now_ns, deadline)
    return sent


def outcome(chunks: list[bytes]) -> tuple[list[Emission], object]:
    session = new_session(address=7)
    session.power_on(0)
    for chunk in chunks:
        session.receive(chunk, 1 * MS)
    sent = finish(session, 1 * MS, 2 * SECOND)
    return sent, session.device


@given(st.lists(pieces, max_size=8), st.data())
def test_any_chunking_of_any_bytes_gives_the_same_replies(parts: list[bytes], data: st.DataObject) -> None:
    stream = b"".join(parts)
    cuts = data.draw(st.lists(st.integers(0, len(stream)), max_size=12).map(sorted))
    edges = [0, *cuts, len(stream)]
    chunks = [stream[a:b] for a, b in itertools.pairwise(edges)]
    assert outcome(chunks) == outcome([stream])
    assert outcome([bytes((byte,)) for byte in stream]) == outcome([stream])


@given(st.lists(st.tuples(st.integers(0, 300), pieces), max_size=25))
def test_whatever_comes_whenever_the_line_carries_whole_telegrams_in_order(talk: list[tuple[int, bytes]]) -> None:
    session, now_ns, sent = new_session(address=7), 0, []
    session.power_on(0)
    for pause_ms, chunk in talk:
        sent += finish(session, now_ns, pause_ms * MS)
        now_ns += pause_ms * MS
        session.receive(chunk, now_ns)
    sent += finish(session, now_ns, 3 * SECOND)
    start_ns, end_ns, baud = 0, 0, 9600
    for emission in sent:
        if emission.cuts:
            done = (emission.due_ns - start_ns) * baud // 10**10 + 1
            end_ns = min(end_ns, start_ns + line_ns(done, baud))
            continue
        assert emission.due_ns >= end_ns, "telegrams overlap on the line"
        count, start_ns = emission.pause or (0, emission.due_ns)
        end_ns = start_ns + line_ns(len(emission.payload) - count, baud)
        baud = emission.line_speed or baud
        if emission.payload not in (b"", b"\x06", b"\x15"):
            telegram = open_frame(emission.payload)
            assert telegram is not None
            assert telegram.address == 0x87
            assert telegram.data[-1] == 0x10
    assert len(session._reply_ends_ns) <= 8
    assert all(len(receiver._buffer) <= 813 for receiver in session._receivers.values())


@given(st.lists(pieces, max_size=12))
def test_after_anything_a_pause_and_a_request_are_answered(parts: list[bytes]) -> None:
    session = new_session(address=7)
    session.power_on(0)
    session.receive(b"".join(parts), 0)
    finish(session, 0, 30 * SECOND)
    now_ns = 100 * SECOND
    session.receive(request(b"\x20\x25", 7), now_ns)
    labels = [emission.label for emission in finish(session, now_ns, 3 * SECOND)]
    assert labels[-2:] == ["ACK", "A0"]


@given(st.lists(st.sampled_from([command for command in COMMANDS if command[0] != 0x36]), max_size=8))
def test_nothing_of_a_stream_stands_between_ack_and_reply_nor_behind_a_stop(commands: list[bytes]) -> None:
    session, now_ns, sent = new_session(), 0, []
    session.power_on(0)
    for command in commands:
        session.receive(request(command), now_ns)
        sent += finish(session, now_ns, 150 * MS)
        now_ns += 150 * MS
    stop_ns = now_ns + 10 * SECOND
    sent += finish(session, now_ns, 10 * SECOND)
    session.receive(request(b"\x20\x25"), stop_ns)
    behind = finish(session, stop_ns, 3 * SECOND)
    assert [emission.label for emission in behind][-2:] == ["ACK", "A0"]
    for ack, reply in itertools.pairwise(sent):
        if ack.label == "ACK":
            assert reply.label != "ACK"


@given(st.integers(0, 40), st.sampled_from([b"\x20\x24", b"\x20\x2a", b"\x20\x26\x02"]))
def test_scans_come_back_as_they_were_measured_whatever_the_order_of_asking(scans: int, mode: bytes) -> None:
    session = new_session(baud=500_000)
    session.power_on(0)
    session.receive(request(mode), 0)
    seen = set()
    now_ns = 0
    for _ in range(scans):
        now_ns += 7 * MS
        session.advance(now_ns)
        if (plan := session.next_plan()) is not None:
            assert (plan.epoch, plan.sweep) not in seen, "a scan is wanted once"
            seen.add((plan.epoch, plan.sweep))
            session.submit(wall()(plan))
        session.take_emissions(now_ns)
    assert [event.mode for event in session.take_events() if isinstance(event, ModeChanged)][-1] == f"{mode[1]:02X}"
