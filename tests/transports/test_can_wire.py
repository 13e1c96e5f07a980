"""One bus in time: arbitration, bit rate, queues, error counters; and links of sensors that share it."""

from __future__ import annotations

import os
import re
import select

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from emulator.errors import LinkError
from emulator.transports.can_link import CanLink, CanPorts
from emulator.transports.can_wire import BUS_OFF, RECOVERY_BITS, CanWire, Carried, Node
from emulator.transports.link import Received
from emulator.transports.schemes import check_url, open_link
from protocols.can_frame import arbitration_key, frame_bits
from protocols.session import LinkKind
from tests.draws import cases

MS = 1_000_000
SECOND = 1_000_000_000
BIT_NS = 2000

frames = st.tuples(st.integers(0, 2), st.integers(0, 0x7FF), st.binary(max_size=8), st.integers(0, 3 * MS))


def drain(wire: CanWire) -> list[Carried]:
    """Everything that waits, taken at the instants the bus asks for."""
    carried: list[Carried] = []
    now_ns = 0
    while (wake := wire.next_ns()) is not None:
        assert wake >= now_ns
        now_ns = wake
        carried += wire.take(now_ns)
    return carried


@given(st.lists(frames, max_size=40))
def test_frames_follow_each_other_without_overlap_each_node_in_its_order(
    queued: list[tuple[int, int, bytes, int]],
) -> None:
    wire = CanWire(500_000)
    nodes = [wire.join(str(k)) for k in range(3)]
    for number, peer, data, due_ns in queued:
        assert wire.put(nodes[number], peer, data, due_ns)
    carried = drain(wire)
    assert len(carried) == len(queued)
    free_ns = 0
    for frame in carried:
        assert frame.start_ns >= max(free_ns, frame.due_ns)
        assert frame.end_ns - frame.start_ns == frame_bits(frame.peer, frame.data) * BIT_NS
        free_ns = frame.end_ns
    for number, node in enumerate(nodes):
        sent = [(frame.peer, frame.data) for frame in carried if frame.node is node]
        assert sent == [(peer, data) for owner, peer, data, _ in queued if owner == number]


@given(st.lists(frames, min_size=1, max_size=30))
def test_whoever_starts_had_the_lowest_identifier_of_those_that_were_ready(
    queued: list[tuple[int, int, bytes, int]],
) -> None:
    wire = CanWire(500_000)
    nodes = [wire.join(str(k)) for k in range(3)]
    waiting: dict[int, list[tuple[int, int]]] = {0: [], 1: [], 2: []}
    for number, peer, data, due_ns in queued:
        wire.put(nodes[number], peer, data, due_ns)
        waiting[number].append((peer, due_ns))
    for frame in drain(wire):
        rivals = [line[0] for line in waiting.values() if line and line[0][1] <= frame.start_ns]
        assert arbitration_key(frame.peer) == min(arbitration_key(peer) for peer, _ in rivals)
        waiting[nodes.index(frame.node)].pop(0)


def test_a_frame_that_has_begun_is_finished_before_a_more_urgent_one() -> None:
    wire = CanWire(500_000)
    slow, urgent = wire.join("slow"), wire.join("urgent")
    wire.put(slow, 0x700, bytes(8), 0)
    assert wire.take(100 * BIT_NS) == []
    wire.put(urgent, 0x001, bytes(8), 0)
    assert [frame.peer for frame in drain(wire)] == [0x700, 0x001]


@pytest.mark.parametrize("bitrate", [125_000, 500_000, 800_000, 1_000_000])
def test_a_bus_carries_its_bit_rate_and_no_more(bitrate: int) -> None:
    wire = CanWire(bitrate, queue_frames=10_000)
    node = wire.join("a")
    data = [bytes([k & 255] * 8) for k in range(1000)]
    for item in data:
        wire.put(node, 0x123, item, 0)
    total_bits = sum(frame_bits(0x123, item) for item in data)
    assert drain(wire)[-1].end_ns == pytest.approx(total_bits * SECOND / bitrate, abs=1000)


def test_the_load_is_the_share_of_the_last_second() -> None:
    wire = CanWire(500_000)
    node = wire.join("a")
    for k in range(100):
        wire.put(node, 0x123, b"\x55" * 8, k * 10 * MS)
    carried = drain(wire)
    busy_ns = sum(frame.end_ns - frame.start_ns for frame in carried)
    assert wire.load(carried[-1].end_ns) == pytest.approx(busy_ns / SECOND)
    assert wire.load(carried[-1].end_ns + 2 * SECOND) == 0.0


def test_a_full_queue_drops_and_counts() -> None:
    wire = CanWire(500_000, queue_frames=3)
    node = wire.join("a")
    assert [wire.put(node, k, b"", SECOND) for k in range(5)] == [True, True, True, False, False]
    assert node.dropped == 2
    assert [frame.peer for frame in drain(wire)] == [0, 1, 2]


@pytest.mark.parametrize(("peer", "data"), [(0x800, b""), (-1, b""), (0x100, bytes(9)), ((1 << 31) + (1 << 29), b"")])
def test_what_is_no_frame_is_dropped_and_counted(peer: int, data: bytes) -> None:
    wire = CanWire(500_000)
    node = wire.join("a")
    assert not wire.put(node, peer, data, 0)
    assert node.dropped == 1


def disturbed(count: int) -> tuple[CanWire, Node, list[Carried]]:
    wire = CanWire(500_000)
    node = wire.join("a")
    wire.disturb(node, count)
    for k in range(10):
        wire.put(node, 0x100 + k, bytes(8), 0)
    return wire, node, drain(wire)


def test_a_disturbed_frame_is_sent_again() -> None:
    wire, node, carried = disturbed(3)
    assert [frame.peer for frame in carried] == list(range(0x100, 0x10A))
    assert node.error_counter == 3 * 8 - 10
    assert wire.notices == []


def test_sixteen_errors_make_a_controller_error_passive() -> None:
    wire, _, carried = disturbed(16)
    assert len(carried) == 10
    assert [notice.state for notice in wire.notices] == ["error passive", "active"], "the first good frame ends it"


def test_thirty_two_errors_take_a_controller_off_the_bus_until_it_has_recovered() -> None:
    wire, node, carried = disturbed(32)
    assert carried == []
    assert [notice.state for notice in wire.notices] == ["error passive", "bus off", "recovered"]
    off_ns, back_ns = wire.notices[1].at_ns, wire.notices[2].at_ns
    assert back_ns - off_ns == RECOVERY_BITS * BIT_NS
    assert (node.bus_offs, node.dropped, node.error_counter) == (1, 10, 0)
    assert BUS_OFF == 32 * 8
    assert wire.put(node, 0x100, b"", back_ns)
    assert len(wire.take(back_ns + MS)) == 1


def test_while_off_the_bus_frames_are_lost_and_others_go_on() -> None:
    wire = CanWire(500_000)
    node, other = wire.join("a"), wire.join("b")
    wire.disturb(node, 32)
    wire.put(node, 0x100, b"", 0)
    wire.take(6 * MS)
    off_until_ns = node.off_until_ns
    assert off_until_ns is not None
    assert not wire.put(node, 0x100, b"", off_until_ns - 1)
    wire.put(other, 0x200, b"", 0)
    assert [frame.peer for frame in wire.take(20 * MS)] == [0x200]


# Sensors on one bus


def two_sensors(url: str = "can:virtual:two") -> tuple[CanLink, CanLink]:
    ports = CanPorts()
    first, second = open_link(url, can_ports=ports), open_link(url, can_ports=ports)
    assert isinstance(first, CanLink)
    assert isinstance(second, CanLink)
    return first, second


def test_sensors_of_the_same_text_share_a_bus_and_hear_each_other_in_arbitration_order() -> None:
    first, second = two_sensors()
    try:
        assert first.kind is LinkKind.CAN
        for k in range(3):
            first.send(bytes([k]), 0, 0x300)
            second.send(bytes([k]), 0, 0x200)
        first.flush(MS)
        assert second.receive(10 * MS) == [Received(0x300, bytes([k])) for k in range(3)]
        assert first.receive(10 * MS) == [Received(0x200, bytes([k])) for k in range(3)]
        assert (first.can.frames_sent, second.can.frames_received) == (3, 3)
    finally:
        first.close()
        second.close()


def test_a_sensor_is_woken_when_the_other_one_s_run_has_something_for_it() -> None:
    first, second = two_sensors()
    try:
        assert len(first.filenos()) == len(second.filenos()) == 1
        second.send(b"x", 0, 0x200)
        second.flush(MS)
        readable, _, _ = select.select([*first.filenos(), *second.filenos()], [], [], 0)
        assert readable == list(first.filenos())
        assert first.receive(MS) == [Received(0x200, b"x")]
        assert select.select([*first.filenos()], [], [], 0)[0] == []
    finally:
        first.close()
        second.close()


def test_without_a_shared_run_each_link_has_a_bus_of_its_own() -> None:
    first, second = open_link("socketcand:127.0.0.1:0/can0"), open_link("socketcand:127.0.0.1:0/can0")
    try:
        assert first.url != second.url
    finally:
        first.close()
        second.close()


def test_closing_gives_every_descriptor_back_and_can_be_repeated() -> None:
    before = len(os.listdir("/proc/self/fd"))
    ports = CanPorts()
    links = [open_link("socketcand:127.0.0.1:0/can0", can_ports=ports) for _ in range(3)]
    links += [open_link("socketcand:127.0.0.1:0/can1", can_ports=ports)]
    for link in links:
        link.close()
        link.close()
        assert link.receive(0) == []
        assert link.flush(0) is None
        link.send(b"", 0, 0x100)
    assert len(os.listdir("/proc/self/fd")) == before


def test_a_frame_without_an_identifier_is_dropped_and_counted() -> None:
    link = open_link("can:virtual:none")
    try:
        link.send(b"x", 0)
        link.send(b"x", 0, 0x800)
        assert link.stats.payloads_dropped == 2
    finally:
        link.close()


def test_power_off_forgets_what_has_not_left() -> None:
    link = open_link("can:virtual:forget")
    try:
        link.send(b"abc", 0, 0x100)
        link.send(b"de", 0, 0x100)
        assert link.clear() == 5
        assert link.flush(MS) == pytest.approx(2 * MS)
    finally:
        link.close()


def test_bus_off_of_a_sensor_is_counted_on_its_link() -> None:
    link = open_link("socketcand:127.0.0.1:0/can0")
    assert isinstance(link, CanLink)
    try:
        link.disturb(32)
        for _ in range(5):
            link.send(bytes(8), 0, 0x100)
        link.flush(10 * MS)
        assert (link.can.state, link.can.bus_offs, link.can.overload_drops) == ("bus off", 1, 5)
        link.flush(20 * MS)
        assert link.can.state == "active"
        assert link.stats.payloads_dropped == 5
    finally:
        link.close()


@pytest.mark.parametrize(
    ("url", "what"),
    [
        ("socketcand:127.0.0.1:0", "want socketcand:HOST:PORT/CHANNEL"),
        ("socketcand:127.0.0.1:0/", "channel ''"),
        ("socketcand:127.0.0.1:0/can 0", "channel 'can 0'"),
        ("socketcand:127.0.0.1/can0", "want HOST:PORT"),
        ("socketcand:127.0.0.1:0/can0?bitrate=5", "bitrate is '5'"),
        ("socketcand:127.0.0.1:0/can0?speed=5", "unknown option 'speed'"),
        ("slcan:/x?bitrate=fast", "bitrate is 'fast'"),
        ("can:nothing:x", "interface 'nothing'"),
        ("can:virtual", "no channel"),
        ("can:virtual:x?gap_us=-1", "gap_us is '-1'"),
    ],
)
def test_a_text_that_cannot_be_is_refused_with_what_is_allowed(url: str, what: str) -> None:
    with pytest.raises(ValueError, match=re.escape(what)):
        check_url(url)
    with pytest.raises(LinkError):
        open_link(url)


def test_an_interface_that_the_machine_does_not_have_says_why() -> None:
    with pytest.raises(LinkError, match="can:socketcan:no_such0: cannot be opened: "):
        open_link("can:socketcan:no_such0")


@settings(max_examples=cases(30))
@given(st.lists(st.tuples(st.integers(0, 0x7FF), st.binary(max_size=8)), max_size=30))
def test_a_stock_python_can_bus_sees_every_frame_of_a_virtual_link(sent: list[tuple[int, bytes]]) -> None:
    import can

    link = open_link("can:virtual:stock")
    host = can.Bus(channel="stock", interface="virtual")
    try:
        for peer, data in sent:
            link.send(data, 0, peer)
        link.flush(SECOND)
        seen = [host.recv(0) for _ in sent]
        assert [(m.arbitration_id, bytes(m.data)) for m in seen if m is not None] == sent
        assert host.recv(0) is None
        host.send(can.Message(arbitration_id=0x12345, data=b"hi", is_extended_id=True))
        assert link.receive(SECOND) == [Received(0x12345 | 1 << 31, b"hi")]
    finally:
        host.shutdown()
        link.close()


def test_a_bursty_interface_gets_its_frames_one_at_a_time() -> None:
    import can

    link = open_link("can:virtual:gap?gap_us=200")
    host = can.Bus(channel="gap", interface="virtual")
    try:
        for k in range(4):
            link.send(bytes([k]), 0, 0x100)
        now_ns, seen = 100 * MS, []
        for _ in range(4):
            link.flush(now_ns)
            message = host.recv(0)
            assert message is not None
            seen.append(message.data[0])
            assert host.recv(0) is None
            now_ns += 200_000
        assert seen == [0, 1, 2, 3]
    finally:
        host.shutdown()
        link.close()
