"""Whatever hosts send, in whatever pieces: nothing raises, nothing grows, and the same bytes get the same replies."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from protocols.ld import FAMILY
from protocols.ld.channels import MAX_INBOX
from protocols.ld.services import COMMANDS
from protocols.ld.session import MAX_CHANNELS
from protocols.ld.usp import MAX_REQUEST_BYTES
from protocols.session import MAX_EVENTS, Address, DropReason, LinkKind
from tests.draws import cases
from tests.protocols.ld.reader import can_frames, package, read_frames, read_packages, request, words
from tests.protocols.ld.rig import FACTS, MS, SECOND, TCP, Rig, measuring, ten_metres

word = st.integers(0, 0xFFFF) | st.sampled_from([0, 1, 2, 3, 8, 10, 16, 5752, 0x3DFF])
messages = st.tuples(st.sampled_from(sorted(COMMANDS)) | word).flatmap(
    lambda service: st.lists(word, max_size=5).map(lambda data: (*service, *data))
)


@settings(max_examples=cases(60))
@given(st.lists(messages, max_size=6), st.lists(st.integers(1, 20), max_size=30), st.binary(max_size=12))
def test_any_cut_of_the_same_bytes_gets_the_same_replies(asked: list, cuts: list[int], noise: bytes) -> None:
    stream = noise + b"".join(request(*message) for message in asked)
    results = []
    for pieces in ([len(stream)], cuts):
        rig = Rig({"delays": "fast", "mode": "measure", "step_deg": 5})
        rest = stream
        for piece in pieces:
            rig.put(rest[:piece])
            rest = rest[piece:]
        rig.put(rest)
        rig.run(3 * SECOND)
        results.append([(emission.due_ns, emission.payload) for emission in rig.take()])
        for _, payload in results[-1]:
            read_frames(payload)
    assert results[0] == results[1]


@settings(max_examples=cases(60))
@given(
    st.sampled_from([LinkKind.STREAM, LinkKind.SERIAL, LinkKind.CAN, LinkKind.DATAGRAM]),
    st.lists(st.tuples(st.binary(max_size=60), st.integers(0, 2 * SECOND), st.sampled_from([0, 1, 0x2AB])), max_size=9),
)
def test_random_bytes_on_any_link_raise_nothing_and_the_device_goes_on(kind: LinkKind, chunks: list) -> None:
    rig = Rig({"delays": "fast", "step_deg": 5}, ten_metres, kind, Address(0, 1 if kind is LinkKind.STREAM else 0))
    for data, pause_ns, peer in chunks:
        rig.put(data, Address(0, peer) if kind in (LinkKind.CAN, LinkKind.DATAGRAM) else None)
        rig.run(pause_ns)
    rig.run(5 * SECOND)
    rig.take()
    if kind is LinkKind.CAN:
        for data in can_frames(0x10, 0x0102):
            rig.put(data, Address(0, 0x2AB))
    else:
        rig.put(package(0x1410, 3, 0, 0x0102) if kind is LinkKind.SERIAL else request(0x0102))
    rig.run(SECOND)
    assert b"".join(emission.payload for emission in rig.take() if emission.label == "8102")


@settings(max_examples=cases(30))
@given(st.lists(messages, max_size=12), st.lists(st.integers(0, 400 * MS), min_size=12, max_size=12))
def test_two_hosts_saying_anything_at_any_time_get_one_answer_each(asked: list, pauses: list[int]) -> None:
    rig = Rig({"delays": "fast", "step_deg": 5})
    other = Address(0, 2)
    rig.session.connected(0, other, LinkKind.STREAM)
    for index, (message, pause_ns) in enumerate(zip(asked, pauses, strict=False)):
        rig.put(request(*message), other if index % 2 else TCP)
        rig.run(pause_ns)
    rig.run(20 * SECOND)
    answered = [outcome for _, outcome in rig.handled()]
    ignored = sum(message[0] == 0xFF00 for message in asked)
    unheard = rig.dropped().count(DropReason.BOOTING)
    booting = [message for message in asked if message[0] == 0x0401]
    assert len(answered) == len(asked) - ignored - unheard or booting
    replies = [emission for emission in rig.take() if emission.sweep is None]
    profiles = sum(command.startswith("0301") and outcome == "done" for command, outcome in rig.handled())
    assert len(replies) == len(answered) - profiles


def test_a_half_request_is_given_up_after_a_second_and_the_next_is_answered() -> None:
    for kind, half, whole in (
        (LinkKind.STREAM, request(0x0201, 0x0010, 16, 10, 8)[:-3], request(0x0102)),
        (LinkKind.SERIAL, package(0x1410, 3, 0, 0x0102)[:-1], package(0x1410, 3, 0, 0x0102)),
    ):
        rig = Rig({}, ten_metres, kind, Address(0, 1 if kind is LinkKind.STREAM else 0))
        rig.run(0)
        rig.take()
        rig.put(half)
        rig.run(990 * MS)
        assert rig.dropped() == []
        rig.run(20 * MS)
        assert DropReason.TIMEOUT in rig.dropped()
        assert rig.session.next_deadline() is None
        rig.put(whole)
        rig.run(SECOND)
        assert [emission.label for emission in rig.take()] == ["8102"]


def test_a_request_in_slow_pieces_is_not_given_up() -> None:
    rig = Rig()
    for byte in request(0x0102):
        rig.put(bytes([byte]))
        rig.run(900 * MS)
    assert [emission.label for emission in rig.take()] == ["8102"]


def test_a_half_message_on_can_is_given_up() -> None:
    rig = Rig({}, ten_metres, LinkKind.CAN, Address(0, 0))
    rig.put(can_frames(0x10, 0x0201, 1, 2, 3, 4)[0], Address(0, 0x2AB))
    rig.run(2 * SECOND)
    assert rig.dropped() == [DropReason.TIMEOUT]
    assert rig.session.next_deadline() is None


def test_replies_come_in_the_order_of_requests_a_millisecond_apart() -> None:
    rig = Rig({"delays": "fast"})
    rig.put(b"".join(request(code) for code in (0x0404, 0x0102, 0x0205, 0x0104)))  # the first wants a head that turns
    rig.put(request(0x0403, 0) + request(0x0102) + request(0x0404) + request(0x0205))
    rig.run(SECOND)
    sent = rig.take()
    labels = [emission.label for emission in sent]
    assert labels == ["FF00", "8102", "8205", "8104", "8403", "8102", "8404", "8205"]
    gaps = [after.due_ns - before.due_ns for before, after in pairwise(sent)]
    assert min(gaps) >= MS
    assert words(read_frames(sent[5].payload)[0]) == [0x8102, 0, 2]  # it waited for the head


def test_requests_beyond_what_can_wait_are_dropped_and_counted() -> None:
    rig = Rig()
    rig.put(request(0x0403, 0))
    rig.put(request(0x0102) * (MAX_INBOX + 10))
    rig.run(10 * SECOND)
    assert [emission.label for emission in rig.take()] == ["8403"] + ["8102"] * MAX_INBOX
    assert rig.dropped() == [DropReason.OVERLONG] * 10


def test_memory_is_bounded_whatever_comes() -> None:
    rig = measuring()
    session = rig.session
    flood = (b"\x02USP\x00\x00\x0f\xff" + bytes(4000)) * 20 + b"\x02" * 5000
    for _ in range(20):
        rig.put(flood)
        rig.put(flood, Address(0, 2))
    session.connected(0, Address(1, 0), LinkKind.SERIAL)
    session.connected(0, Address(2, 0), LinkKind.CAN)
    session.connected(0, Address(3, 0), LinkKind.DATAGRAM)
    for number in range(2000):
        rig.put(b"\x02" + b"0" * 3000, Address(1, 0))
        rig.put(bytes.fromhex("ffff 02ff 0010 0201"), Address(2, number))
        rig.put(b"\x02USP\x00\x00\x0f\xff", Address(3, number))
    assert len(session._channels) <= MAX_CHANNELS
    for channel in session._channels.values():
        held = getattr(channel.reader, "_buffer", b"")
        assert len(held) <= max(MAX_REQUEST_BYTES + 9, 4 * 2060)
    assert len(session._events) <= MAX_EVENTS
    assert DropReason.OVERLONG in rig.dropped()
    rig.run(10 * SECOND)
    rig.take()
    assert words(rig.ask(0x0102)) == [0x8102, 0, 3]


def test_senders_that_want_something_are_not_forgotten_for_strangers() -> None:
    rig = measuring(kind=LinkKind.DATAGRAM, address=Address(0, 0))
    rig.put(request(0x0301, 0, 0x0001), Address(0, 5))
    for number in range(10, 3 * MAX_CHANNELS):
        rig.put(request(0x0102), Address(0, number))
        rig.run(2 * MS)
    rig.take()
    rig.run(SECOND)
    assert len(rig.take(Address(0, 5))) == 10


def test_nobody_is_forgotten_when_all_want_something() -> None:
    rig = measuring(kind=LinkKind.DATAGRAM, address=Address(0, 0))
    for number in range(MAX_CHANNELS + 5):
        rig.put(request(0x0301, 0, 0x0001), Address(0, number))
    rig.run(0)
    assert rig.dropped().count(DropReason.OTHER_ADDRESS) == 5


@pytest.mark.parametrize("jump_ns", [1 * MS, 37 * MS, SECOND, 20 * SECOND])
def test_replies_do_not_depend_on_how_time_is_cut(jump_ns: int) -> None:
    rig = Rig({"start": "cold"})
    rig.session.advance(4 * SECOND)
    rig.now_ns = 4 * SECOND
    rig.put(request(0x0403, 0) + request(0x0404) + request(0x0102) + request(0x0401, 1) + request(0x0102))
    session = rig.session
    sent = []
    now_ns = rig.now_ns
    while now_ns < 24 * SECOND:
        now_ns += jump_ns
        sent += session.take_emissions(now_ns)
    assert [(emission.label, emission.due_ns // MS) for emission in sent] == [
        ("8403", 5505), ("8404", 5510), ("8102", 5515), ("8401", 5520),
    ]  # fmt: skip


def test_nothing_happens_before_the_device_is_switched_on() -> None:
    session = FAMILY.new_session({}, FACTS)
    session.receive(request(0x0102), 0)
    session.advance(SECOND)
    assert session.next_deadline() is None
    assert session.next_plan() is None
    assert session.take_emissions(SECOND) == []
    session.disconnected(SECOND, TCP)


def test_packages_and_frames_of_one_device_do_not_mix_between_links() -> None:
    rig = measuring()
    serial, bus = Address(1, 0), Address(2, 0)
    rig.session.connected(0, serial, LinkKind.SERIAL)
    rig.session.connected(0, bus, LinkKind.CAN)
    rig.put(request(0x0301, 0, 0x0100))
    rig.put(package(0x1410, 5, 0, 0x0301, 2, 0x0002), serial)
    for data in can_frames(0x10, 0x0102):
        rig.put(data, Address(2, 0x2AB))
    rig.run(450 * MS)
    sent = rig.take()
    tcp = [emission.payload for emission in sent if emission.address == TCP]
    line = [emission.payload for emission in sent if emission.address == serial]
    can = [emission.payload.hex() for emission in sent if emission.address == Address(2, 0x710)]
    assert len(tcp) + len(line) + len(can) == len(sent)
    assert [len(payload) for payload in tcp] == [6 + 1440 + 9] * 4
    assert [read_packages(payload)[0][1] for payload in line] == [[0x8301, 2, 0x0101, number] for number in (0, 1)]
    assert can == ["ffff000200038102", "000100000003"]
