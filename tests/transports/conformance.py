"""What every link keeps, whatever carries it. Collected by `test_conformance.py`, once for each entry of `RIGS`."""

from __future__ import annotations

import os
from collections import deque

import pytest

from emulator.transports.link import Received
from protocols.session import LinkKind
from tests.transports.rigs import RIGS, LoopStreamRig, Rig

MS = 1_000_000
STEP = 2 * MS


def payloads() -> list[bytes]:
    return [bytes([number]) * (1 + number % 7) + b"|" for number in range(40)]


def open_descriptors() -> int:
    return len(os.listdir("/proc/self/fd"))


class LinkConformance:
    """Subclass it and give the fixture `rig`."""

    @pytest.fixture
    def rig(self) -> Rig:
        raise NotImplementedError

    def test_what_is_sent_arrives_whole_and_in_order(self, rig: Rig) -> None:
        host = rig.host()
        rig.link.set_speed(500_000)
        for index, payload in enumerate(payloads()):
            rig.link.send(payload, rig.now_ns + index * MS)
        read = rig.advance(100 * MS, [host])[id(host)]
        sent = b"".join(payloads())
        read += host.read(len(sent) - len(read)) if len(read) < len(sent) else b""
        assert read == sent
        assert rig.link.stats.bytes_out == len(sent)
        assert rig.link.stats.bytes_lost == rig.link.stats.payloads_dropped == 0

    def test_what_hosts_write_comes_in_whole_and_in_order(self, rig: Rig) -> None:
        host = rig.host()
        written = b""
        for payload in payloads():
            host.write(payload)
            written += payload
        events = rig.take_input(len(written))
        assert b"".join(event.data for event in events) == written
        assert rig.link.stats.bytes_in == len(written)

    def test_all_byte_values_pass_both_ways(self, rig: Rig) -> None:
        host = rig.host()
        every = bytes(range(256))
        host.write(every)
        assert b"".join(event.data for event in rig.take_input(256)) == every
        rig.link.send(every, rig.now_ns)
        rig.advance(STEP)
        assert host.read(256) == every

    def test_a_line_has_no_connections_and_a_stream_tells_of_them(self, rig: Rig) -> None:
        first = rig.connect()
        second = rig.connect()
        first.write(b"1")
        second.write(b"2")
        events: list[Received] = []
        while sum(len(event.data) for event in events) < 2:
            events += rig.wait_input()
        numbers = {event.peer for event in events}
        if rig.link.kind is LinkKind.SERIAL:
            assert numbers == {0}
            assert not any(event.opened or event.closed for event in events)
        elif rig.link.kind is LinkKind.STREAM:
            assert [event.peer for event in events if event.opened] == [1, 2]
            assert {event.peer: event.data for event in events if event.data} == {1: b"1", 2: b"2"}

    def test_what_is_for_one_host_goes_to_no_other(self, rig: Rig) -> None:
        one, other = rig.host(), rig.host()
        rig.link.send(b"for one", rig.now_ns, peer=1)
        rig.link.send(b"for all", rig.now_ns)
        rig.advance(STEP)
        if rig.link.kind is LinkKind.STREAM:
            assert one.read(14) == b"for onefor all"
            assert other.read(7) == b"for all"
        elif rig.connections or type(rig) is RIGS["loop"]:
            assert one.read(14) == other.read(14) == b"for onefor all"

    def test_nothing_leaves_before_it_is_due(self, rig: Rig) -> None:
        host = rig.host()
        rig.link.set_speed(500_000)
        rig.link.send(b"later", rig.now_ns + 10 * MS)
        assert rig.link.flush(rig.now_ns + 10 * MS - 1) is not None
        assert host.read_now() == b""
        rig.link.flush(rig.now_ns + 20 * MS)
        assert host.read(5) == b"later"

    def test_a_paced_byte_is_never_early_and_the_last_one_wakes_exactly(self, rig: Rig) -> None:
        if not rig.paced:
            return
        host = rig.host()
        rig.link.set_speed(9600)
        start = rig.now_ns
        rig.link.send(bytes(20), start)
        wakes = []
        wake = rig.link.flush(start)
        got = 0
        while wake is not None:
            assert wake > rig.now_ns
            wakes.append(wake)
            rig.link.flush(wake - 1)
            rig.now_ns = wake
            wake = rig.link.flush(wake)
            got += len(host.read_now())
            assert got * 10_000_000_000 <= (rig.now_ns - start) * 9600
        got += len(host.read(20 - got)) if got < 20 else 0
        assert got == 20
        assert wakes[-1] == start + -(-20 * 10_000_000_000 // 9600)

    def test_flush_asks_for_nothing_when_nothing_waits(self, rig: Rig) -> None:
        rig.host()
        rig.link.receive(rig.now_ns)
        assert rig.link.flush(rig.now_ns) is None

    def test_a_late_flush_shifts_no_schedule(self, rig: Rig) -> None:
        if not rig.paced:
            return
        rig.host()
        rig.link.set_speed(9600)
        start = rig.now_ns
        rig.link.send(bytes(96), start)
        rig.link.send(bytes(96), start)
        rig.link.flush(start + 150 * MS)
        end = start + 200 * MS
        wake: int | None = start + 150 * MS
        last = 0
        while wake is not None:
            last = wake
            wake = rig.link.flush(wake)
        assert last == end

    def test_the_speed_changes_behind_the_payload_that_asks_for_it(self, rig: Rig) -> None:
        if not rig.paced:
            return
        host = rig.host()
        rig.link.set_speed(9600)
        start = rig.now_ns
        rig.link.send(bytes(12), start, line_speed=500_000)
        rig.link.send(b"x" * 50, start)
        rig.link.flush(start + 12_500_000 - 1)
        assert b"x" not in host.read_now()
        rig.link.flush(start + 12_500_000 + 1 * MS - 1)
        assert host.read_now().count(b"x") in (0, 49)
        rig.link.flush(start + 12_500_000 + 1 * MS)
        host.read(1)
        assert rig.link.flush(start + 12_500_000 + 1 * MS) is None

    def test_a_huge_payload_passes(self, rig: Rig) -> None:
        host = rig.host()
        rig.link.set_speed(5_000_000 if rig.paced else None)
        huge = bytes(range(250)) * (rig.huge // 250)
        rig.link.send(huge, rig.now_ns)
        read = rig.advance(1000 * MS, [host])[id(host)]
        for _ in range(1000):
            if len(read) >= len(huge):
                break
            read += rig.advance(MS, [host])[id(host)]
            host.wait()
        assert read == huge

    def test_without_a_host_bytes_are_lost_and_counted(self, rig: Rig) -> None:
        rig.link.send(b"nobody", rig.now_ns)
        rig.advance(STEP)
        if rig.knows_absence:
            assert rig.link.stats.bytes_lost == 6
            assert rig.link.stats.bytes_out == 0

    def test_a_host_leaves_and_another_finds_nothing_stale(self, rig: Rig) -> None:
        if not rig.knows_absence:
            return
        first = rig.host()
        rig.link.send(b"unread", rig.now_ns)
        rig.advance(STEP)
        first.close()
        rig.wait_input()
        rig.link.send(b"while away", rig.now_ns)
        rig.advance(STEP)
        second = rig.host()
        rig.link.send(b"fresh", rig.now_ns)
        rig.advance(STEP)
        assert second.read(5) == b"fresh"
        second.write(b"back")
        assert b"".join(event.data for event in rig.take_input(4)) == b"back"

    def test_many_hosts_come_and_go_without_leaving_descriptors(self, rig: Rig) -> None:
        rig.host().close()
        rig.advance(STEP)
        before = open_descriptors()
        for _ in range(20):
            host = rig.host()
            host.write(b"hello")
            rig.take_input(5)
            host.close()
            if rig.connections and not isinstance(rig, LoopStreamRig):
                rig.wait_input()
        rig.now_ns += 11_000 * MS
        rig.link.receive(rig.now_ns)
        assert open_descriptors() <= before

    def test_a_closed_link_is_silent_and_harmless(self, rig: Rig) -> None:
        rig.link.send(b"queued", rig.now_ns + MS)
        rig.link.close()
        rig.link.close()
        rig.link.send(b"after", rig.now_ns)
        assert rig.link.flush(rig.now_ns + 10 * MS) is None
        assert rig.link.receive(rig.now_ns) == []
        assert rig.link.filenos() == ()
        rig.link.set_speed(9600)
        rig.link.clear()

    def test_an_empty_payload_does_nothing_but_change_the_speed(self, rig: Rig) -> None:
        host = rig.host()
        rig.link.send(b"", rig.now_ns, line_speed=38_400)
        rig.link.send(b"after", rig.now_ns)
        rig.advance(10 * MS)
        assert host.read(5) == b"after"

    def test_clear_forgets_what_has_not_left(self, rig: Rig) -> None:
        host = rig.host()
        rig.link.send(b"forgotten", rig.now_ns + 5 * MS)
        assert rig.link.clear() == 9
        rig.link.send(b"kept", rig.now_ns)
        rig.advance(10 * MS)
        assert host.read(4) == b"kept"

    def test_a_line_that_is_never_served_fills_to_a_bound(self, rig: Rig) -> None:
        rig.link.set_speed(9600 if rig.paced else None)
        for _ in range(5000):
            rig.link.send(bytes(1000), rig.now_ns + 10 * MS)
        assert rig.link.stats.payloads_dropped >= 100

    def test_lateness_is_counted_for_each_payload(self, rig: Rig) -> None:
        rig.host()
        rig.link.send(b"one", rig.now_ns)
        rig.link.send(b"two", rig.now_ns + 1000)
        rig.link.flush(rig.now_ns + 1500)
        assert list(rig.link.stats.lateness_ns) == [1500, 500]

    def test_departures_are_kept_with_what_was_due_while_they_are_recorded(self, rig: Rig) -> None:
        rig.host()
        rig.link.stats.departures = deque()
        rig.link.send(b"one", rig.now_ns)
        rig.link.send(b"two", rig.now_ns + 1000)
        rig.link.flush(rig.now_ns + 1500)
        one, two = rig.link.stats.departures
        assert rig.now_ns <= one[0] < two[0]
        assert all(due_ns <= actual_ns for due_ns, actual_ns in (one, two))
        if rig.paced or rig.link.speed is None:  # a real UART takes its own time
            assert (one[1], two) == (rig.now_ns + 1500, (rig.now_ns + 1000, rig.now_ns + 1500))
