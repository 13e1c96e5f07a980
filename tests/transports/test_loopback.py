"""Links in memory: each byte with its nanosecond, garbage at another speed, hosts by name."""

from __future__ import annotations

import pytest

from emulator.errors import LinkError
from emulator.transports.link import Received
from emulator.transports.loopback import Loops
from emulator.transports.schemes import open_link
from emulator.transports.uart import resample

MS = 1_000_000


def test_every_byte_arrives_with_its_nanosecond_however_rarely_the_line_is_served() -> None:
    loops = Loops()
    link = open_link("loop:front", loops=loops)
    link.set_speed(500_000)
    host = loops["front"].connect()
    link.send(bytes(732), 1000)
    link.flush(7 * MS)
    link.flush(100 * MS)
    times = [int(time) for arrival in host.arrivals for time in arrival.times_ns]
    assert times == [1000 + 20_000 * (index + 1) for index in range(732)]
    assert len(host.read()) == 732


def test_a_host_at_its_own_speed_takes_its_time_to_write() -> None:
    loops = Loops()
    link = open_link("loop:front", loops=loops)
    link.set_speed(9600)
    host = loops["front"].connect(baud=9600)
    assert host.write(b"abc", 1000) == 3_126_000
    assert link.flush(0) == 1_042_667
    assert link.receive(1_042_666) == []
    assert link.receive(1_042_667) == [Received(0, b"a")]
    assert link.receive(10 * MS) == [Received(0, b"bc")]


def test_at_another_speed_both_get_garbage_until_the_host_follows() -> None:
    loops = Loops()
    link = open_link("loop:front", loops=loops)
    link.set_speed(9600)
    host = loops["front"].connect(baud=38_400)
    link.send(b"telegram", 0)
    link.flush(10 * MS)
    assert host.arrivals[0].garbled
    assert host.read() == resample(b"telegram", 9600, 38_400).values.tobytes()
    host.write(b"\x02", 10 * MS)
    (received,) = link.receive(20 * MS)
    assert received.data == resample(b"\x02", 38_400, 9600).values.tobytes()
    assert received.foreign == (38_400, b"\x02")
    host.baud = 9600
    host.write(b"\x02", 20 * MS)
    assert link.receive(30 * MS) == [Received(0, b"\x02")]
    assert link.stats.bytes_garbled == 9


def test_input_is_heard_in_the_order_of_time_not_of_writing() -> None:
    loops = Loops()
    link = open_link("loop:front", loops=loops)
    one, other = loops["front"].connect(), loops["front"].connect()
    one.write(b"late", 200)
    other.write(b"early", 100)
    assert link.flush(0) == 100
    assert [event.data for event in link.receive(300)] == [b"earlylate"]


def test_on_a_stream_hosts_are_connections() -> None:
    loops = Loops()
    link = open_link("loop:ld", serial_line=False, loops=loops)
    link.set_speed(9600)
    one, other = loops["ld"].connect(at_ns=5), loops["ld"].connect(at_ns=6)
    assert link.receive(5) == [Received(1, opened=True)]
    one.write(b"hello", 7)
    assert link.receive(7) == [Received(2, opened=True), Received(1, b"hello")]
    link.send(b"to one", 8, peer=1, line_speed=9600)
    link.send(b"to all", 8)
    link.flush(8)
    assert one.read() == b"to oneto all"
    assert other.read() == b"to all"
    one.close(9)
    assert link.receive(9) == [Received(1, closed=True)]


def test_a_name_in_use_is_refused_and_free_again_after_close() -> None:
    loops = Loops()
    link = open_link("loop:front", loops=loops)
    with pytest.raises(LinkError, match="loop:front: in use"):
        open_link("loop:front", loops=loops)
    link.close()
    open_link("loop:front", loops=loops)


def test_a_device_ends_one_connection_behind_what_was_queued_for_it() -> None:
    loops = Loops()
    link = open_link("loop:web", serial_line=False, loops=loops)
    one, other = loops["web"].connect(), loops["web"].connect()
    link.receive(0)
    link.send(b"reply", 5 * MS, 1)
    link.hang_up(5 * MS, 1)
    link.send(b"both", 6 * MS)
    assert (link.receive(4 * MS), one.connected) == ([], True)
    assert link.receive(10 * MS) == [Received(1, closed=True)]
    assert (one.read(), other.read(), one.connected, other.connected) == (b"reply", b"both", False, True)
