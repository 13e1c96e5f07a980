"""Hosts on TCP that are slow, many, rude or half gone."""

from __future__ import annotations

import contextlib
import itertools
import os
import select
import socket
import struct
from collections.abc import Iterator

import pytest

from emulator.errors import LinkError
from emulator.transports.intake import STREAM_BURST
from emulator.transports.link import LATENESS_KEPT, Link, Received
from emulator.transports.schemes import open_link
from emulator.transports.tcp_hosts import BACKLOG_LIMIT, LINGER_NS, MAX_HOSTS, NO_DESCRIPTOR_PAUSE_NS

MS = 1_000_000


@contextlib.contextmanager
def opened(serial_line: bool = False, url: str = "tcp:127.0.0.1:0") -> Iterator[Link]:
    link = open_link(url, serial_line)
    try:
        yield link
    finally:
        link.close()


@contextlib.contextmanager
def host_of(link: Link, receive_buffer: int | None = None) -> Iterator[socket.socket]:
    with socket.socket() as host:
        if receive_buffer is not None:
            host.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer)
        host.settimeout(5.0)
        host.connect(("127.0.0.1", port_of(link)))
        yield host


def port_of(link: Link) -> int:
    return int(link.url.rpartition(":")[2])


def events_of(link: Link, now_ns: int = 0, wait_s: float = 5.0) -> list[Received]:
    """`now_ns` must move on where more is said than the intake holds."""
    if link.filenos():
        select.select(link.filenos(), [], [], wait_s)
    return link.receive(now_ns)


def ticks() -> Iterator[int]:
    """Instants 20 ms apart: the intake is full again at each."""
    return itertools.count(0, 20_000_000)


def until_closed(link: Link, now_ns: int = 0) -> list[Received]:
    events: list[Received] = []
    for _ in range(100):
        events += events_of(link, now_ns)
        if any(event.closed for event in events):
            return events
    raise AssertionError(f"never closed: {events}")


def reset(host: socket.socket) -> None:
    host.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    host.close()


def read_all(host: socket.socket, count: int) -> bytes:
    data = b""
    while len(data) < count:
        data += host.recv(65_536)
    return data


def test_connections_are_numbered_told_and_never_numbered_twice() -> None:
    with opened() as link:
        for number in (1, 2, 3):
            with host_of(link) as host:
                assert events_of(link) == [Received(number, opened=True)]
                host.sendall(b"x")
                assert events_of(link) == [Received(number, b"x")]
                reset(host)
                assert until_closed(link) == [Received(number, closed=True)]


def test_nagle_is_off_and_a_telegram_is_one_segment() -> None:
    with opened() as link, host_of(link) as host:
        events_of(link)
        for number in range(20):
            link.send(bytes([number]) * 700, 0)
            link.flush(0)
            assert host.recv(65_536) == bytes([number]) * 700
        (ours,) = link._hosts.present()  # type: ignore[attr-defined]
        assert ours.connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)


def test_a_host_that_closed_its_sending_half_still_gets_its_reply() -> None:
    with opened() as link, host_of(link) as host:
        host.sendall(b"request")
        host.shutdown(socket.SHUT_WR)
        events = events_of(link)
        while not any(event.data for event in events):
            events += events_of(link)
        link.receive(0)
        assert select.select(link.filenos(), [], [], 0)[0] == []  # nothing spins
        link.send(b"reply", 7_000 * MS, peer=1)
        link.flush(7_000 * MS)
        assert host.recv(100) == b"reply"
        assert link.flush(7_000 * MS) == 7_000 * MS + LINGER_NS
        assert link.receive(7_000 * MS + LINGER_NS) == [Received(1, closed=True)]
        assert host.recv(100) == b""


def test_a_connection_that_the_device_ends_ends_behind_what_waits_for_it() -> None:
    data = bytes(range(256)) * 2048
    with opened() as link, host_of(link, receive_buffer=4096) as host, host_of(link) as other:
        events = events_of(link)
        while len(events) < 2:
            events += events_of(link)
        link.send(data, 0, peer=1)
        link.hang_up(0, peer=1)
        link.flush(0)
        link.send(b"for both", 1)
        assert link.held()  # the kernel has not taken all of it
        found = b""
        while more := host.recv(65_536):
            found += more
            link.receive(0)
        assert found == data
        link.flush(1)
        assert other.recv(100) == b"for both"
        link.receive(0)
        assert select.select(link.filenos(), [], [], 0)[0] == []  # nothing spins
        host.close()
        assert until_closed(link) == [Received(1, closed=True)]


def test_a_host_that_stays_when_the_device_has_ended_its_connection_is_left_behind() -> None:
    with opened() as link, host_of(link) as host:
        events_of(link)
        link.send(b"reply", 0, peer=1)
        link.hang_up(0, peer=1)
        assert link.flush(0) == LINGER_NS
        assert (host.recv(100), host.recv(100)) == (b"reply", b"")
        host.sendall(b"more")
        assert link.receive(LINGER_NS - 1) == []
        assert link.receive(LINGER_NS) == [Received(1, closed=True)]


def test_a_host_that_has_gone_is_noticed_by_the_stream_sent_to_it() -> None:
    with opened() as link, host_of(link) as host:
        events_of(link)
        host.close()
        link.receive(0)
        events: list[Received] = []
        for number in range(100):
            link.send(b"profile", number, peer=1)
            link.flush(number)
            events += link.receive(number)
            if events:
                break
            select.select(link.filenos(), [], [], 0.05)
        assert events == [Received(1, closed=True)]
        link.send(b"profile", 0, peer=1)
        link.flush(1000)
        assert link.stats.bytes_lost >= 7


def test_a_reset_in_the_middle_of_a_telegram_ends_that_connection_only() -> None:
    with opened() as link, host_of(link) as rude, host_of(link) as other:
        while len([event for event in events_of(link) if event.opened]) < 1:
            pass
        rude.sendall(b"\x02USP\x00\x00")
        reset(rude)
        events = until_closed(link)
        assert [event for event in events if event.closed] == [Received(1, closed=True)]
        other.sendall(b"still here")
        assert events_of(link)[-1] == Received(2, b"still here")


def test_a_slow_host_loses_whole_payloads_and_gets_the_others_unmixed() -> None:
    with opened() as link, host_of(link, receive_buffer=8192) as slow, host_of(link) as quick:
        while len(link.receive(0)) < 2:
            select.select(link.filenos(), [], [], 1.0)
        size, total = 5000, 400
        seen = b""
        for number in range(total):
            link.send(struct.pack(">I", number) * (size // 4), number)
            link.flush(number)
            seen += read_all(quick, size)
        dropped = link.stats.payloads_dropped
        assert 0 < dropped < total
        assert seen == b"".join(struct.pack(">I", number) * (size // 4) for number in range(total))
        received = b""
        while len(received) < (total - dropped) * size:
            select.select([slow], [], [], 5.0)
            received += slow.recv(65_536)
            link.receive(total)
        numbers = [received[place : place + size] for place in range(0, len(received), size)]
        assert all(len(set(struct.unpack(f">{size // 4}I", payload))) == 1 for payload in numbers)
        order = [struct.unpack(">I", payload[:4])[0] for payload in numbers]
        assert order == sorted(order)
        assert len(order) == total - dropped


def test_what_waits_for_a_host_is_bounded() -> None:
    with opened() as link, host_of(link, receive_buffer=4096):
        events_of(link)
        for number in range(2000):
            link.send(bytes(5000), number)
            link.flush(number)
        assert link.stats.bytes_out < 400_000
        held = 2000 * 5000 - link.stats.payloads_dropped * 5000 - link.stats.bytes_out
        assert held <= BACKLOG_LIMIT + 5000


def test_on_a_line_a_slow_host_loses_whole_telegrams_and_holds_up_nobody() -> None:
    with opened(serial_line=True) as link, host_of(link, receive_buffer=4096) as slow, host_of(link) as quick:
        link.set_speed(5_000_000)
        link.receive(0)
        select.select(link.filenos(), [], [], 1.0)
        link.receive(0)
        now_ns, size, total = 0, 5000, 300
        for number in range(total):
            link.send(struct.pack(">I", number) * (size // 4), now_ns)
            for _ in range(6):
                now_ns += 2 * MS
                link.flush(now_ns)
            assert read_all(quick, size) == struct.pack(">I", number) * (size // 4)
        dropped = link.stats.payloads_dropped
        assert dropped > 0
        received = b""
        while len(received) < (total - dropped) * size:
            select.select([slow], [], [], 5.0)
            received += slow.recv(65_536)
            link.receive(now_ns)
        assert len(received) == (total - dropped) * size
        for place in range(0, len(received), size):
            assert len(set(struct.unpack(f">{size // 4}I", received[place : place + size]))) == 1


def test_idle_connections_make_room_for_a_host_that_talks() -> None:
    now = ticks()
    with opened() as link, contextlib.ExitStack() as stack:
        talker = stack.enter_context(host_of(link))
        talker.sendall(b"hello")
        while not any(event.data for event in events_of(link, next(now))):
            pass
        for _ in range(MAX_HOSTS + 20):
            stack.enter_context(host_of(link))
            events_of(link, next(now))
        assert link.stats.hosts_refused == 21
        talker.sendall(b"again")
        data = b""
        while data != b"again":
            data += b"".join(event.data for event in events_of(link, next(now)) if event.peer == 1)


def test_a_host_that_spoke_is_kept_when_a_crowd_comes_with_it() -> None:
    with opened() as link, contextlib.ExitStack() as stack:
        host = stack.enter_context(host_of(link))
        host.sendall(b"hello")
        for _ in range(MAX_HOSTS + 20):
            stack.enter_context(host_of(link))
        events = [event for _ in range(10) for event in events_of(link, wait_s=0.0)]
        (heard,) = [event for event in events if event.data]
        assert (heard.data, heard.peer) == (b"hello", 1)
        assert all(event.peer != 1 for event in events if event.closed)
        link.send(b"you too", 0, 1)
        link.flush(0)
        assert host.recv(10) == b"you too"


def test_a_client_that_connects_for_each_request_is_never_turned_away() -> None:
    with opened() as link:
        heard = 0
        for number in range(2 * MAX_HOSTS):  # all of them within `LINGER_NS`
            with host_of(link) as host:
                host.sendall(b"x")
                while not any(event.data for event in events_of(link, number * LINGER_NS // (4 * MAX_HOSTS))):
                    pass
                heard += 1
        assert (heard, link.stats.hosts_refused) == (2 * MAX_HOSTS, 0)


def test_when_all_places_are_taken_by_talkers_a_new_host_is_reset() -> None:
    now = ticks()
    with opened() as link, contextlib.ExitStack() as stack:
        for _ in range(MAX_HOSTS):
            stack.enter_context(host_of(link)).sendall(b"x")
        talked = 0
        while talked < MAX_HOSTS:
            talked += sum(bool(event.data) for event in events_of(link, next(now)))
        late = stack.enter_context(host_of(link))
        events_of(link, next(now))
        with contextlib.suppress(ConnectionResetError):
            assert late.recv(1) == b""
        assert link.stats.hosts_refused == 1


def test_without_descriptors_nobody_is_accepted_for_a_while_and_nothing_spins(monkeypatch: pytest.MonkeyPatch) -> None:
    class Starved:
        def __init__(self, listener: socket.socket) -> None:
            self.listener = listener

        def accept(self) -> None:
            raise OSError(24, "Too many open files")

        def fileno(self) -> int:
            return self.listener.fileno()

        def close(self) -> None:
            self.listener.close()

    with opened() as link, host_of(link) as host:
        hosts = link._hosts  # type: ignore[attr-defined]
        listener = hosts._listener
        hosts._listener = Starved(listener)
        assert events_of(link) == []
        assert select.select(link.filenos(), [], [], 0)[0] == []
        assert link.flush(0) == NO_DESCRIPTOR_PAUSE_NS
        hosts._listener = listener
        link.receive(NO_DESCRIPTOR_PAUSE_NS)
        assert link.receive(NO_DESCRIPTOR_PAUSE_NS) == [Received(1, opened=True)]
        host.sendall(b"x")
        assert events_of(link) == [Received(1, b"x")]


def test_a_flood_is_taken_in_bounded_pieces_and_the_other_host_is_heard() -> None:
    now = ticks()
    with opened() as link, host_of(link) as flood, host_of(link) as quiet:
        flood.setblocking(False)
        seen = 0
        while seen < 2:
            seen += len(events_of(link))
        heard = False
        for _ in range(200):
            with contextlib.suppress(BlockingIOError):
                flood.send(bytes(65_536))
            if not heard:
                quiet.sendall(b"?")
            events = link.receive(next(now))
            assert sum(len(event.data) for event in events) <= STREAM_BURST
            heard = heard or any(event.peer == 2 and event.data for event in events)
        assert heard


def test_many_floods_at_once_are_taken_in_bounded_pieces_and_lose_nothing() -> None:
    now = ticks()
    with opened() as link, contextlib.ExitStack() as stack:
        hosts = [stack.enter_context(host_of(link)) for _ in range(30)]
        for host in hosts:
            host.sendall(bytes(60_000))
        got, most = 0, 0
        while got < 30 * 60_000:
            size = sum(len(event.data) for event in events_of(link, next(now)))
            got, most = got + size, max(most, size)
        assert STREAM_BURST // 2 < most <= STREAM_BURST


def test_lateness_nobody_asks_for_is_kept_to_a_bound() -> None:
    with opened() as link:
        for number in range(LATENESS_KEPT + 10):
            link.send(b"x", number)
            link.flush(number)
        assert len(link.stats.lateness_ns) == LATENESS_KEPT


def test_on_a_line_all_hosts_hear_the_same_at_its_pace() -> None:
    with opened(serial_line=True) as link, host_of(link) as one, host_of(link) as other:
        link.set_speed(9600)
        for _ in range(3):
            events_of(link, wait_s=0.2)
        link.send(bytes(96), 0, peer=7)
        assert link.flush(0) is not None
        link.flush(50 * MS)
        assert len(read_all(one, 48)) == len(read_all(other, 48)) == 48
        link.flush(100 * MS)
        assert len(read_all(one, 48)) == len(read_all(other, 48)) == 48


def test_a_port_in_use_is_said_so_plainly() -> None:
    with opened() as link, pytest.raises(LinkError, match=rf"port {port_of(link)} is in use; want a free one"):
        open_link(f"tcp:127.0.0.1:{port_of(link)}")


def test_a_port_is_free_again_at_once_after_a_run_with_hosts() -> None:
    with opened() as link, host_of(link):
        events_of(link)
        port = port_of(link)
        link.close()  # the closing side keeps the pair in TIME_WAIT
        open_link(f"tcp:127.0.0.1:{port}", serial_line=False).close()


@pytest.mark.parametrize(
    ("url", "cause"),
    [
        ("tcp:192.0.2.1:0", "no address of this machine"),
        ("tcp:no-such-host.invalid:0", "host 'no-such-host.invalid' not found"),
        ("tcp:" + "x" * 70 + ".invalid:0", "not found"),
    ],
)
def test_a_place_that_cannot_be_listened_at_is_said_so_plainly(url: str, cause: str) -> None:
    before = len(os.listdir("/proc/self/fd"))
    with pytest.raises(LinkError, match=cause):
        open_link(url)
    assert len(os.listdir("/proc/self/fd")) == before


def test_nothing_listens_beyond_the_loopback_unless_told_to() -> None:
    with opened(url="tcp::0") as link:
        assert link.url.startswith("tcp:127.0.0.1:")
    with opened(url="tcp:*:0") as link:
        assert link.url.startswith("tcp:0.0.0.0:")


@pytest.mark.skipif(not os.path.exists("/proc/sys/net/ipv6"), reason="this kernel has no IPv6")
def test_ipv6_is_written_in_brackets() -> None:
    with opened(url="tcp:[::1]:0") as link:
        assert link.url.startswith("tcp:[::1]:")
        with socket.create_connection(("::1", port_of(link)), 5.0):
            assert events_of(link) == [Received(1, opened=True)]


def test_hosts_that_flood_starve_neither_each_other_nor_whoever_wants_to_come() -> None:
    with opened() as link, contextlib.ExitStack() as stack:
        floods = [stack.enter_context(host_of(link)) for _ in range(4)]
        for host in floods:
            host.setblocking(False)
        heard: set[int] = set()
        late = None
        for now_ns in itertools.islice(ticks(), 12):
            for host in floods:
                with contextlib.suppress(BlockingIOError):
                    host.send(bytes(100_000))
            if now_ns == 100_000_000:
                late = stack.enter_context(host_of(link))
                late.sendall(b"hello")
            heard |= {event.peer for event in events_of(link, now_ns) if event.data}
        assert late is not None
        assert heard == {1, 2, 3, 4, 5}
