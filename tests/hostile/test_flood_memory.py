"""What floods may fill: every queue of a link and of the control socket has its bound, and the sum is told."""

from __future__ import annotations

import contextlib
import socket
import tracemalloc
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from emulator.runtime.control import MOST_CLIENTS, MOST_UNREAD, MOST_UNREAD_ALL, Budget, ControlServer
from emulator.transports.can_link import AT_ONCE_FRAMES, GROUP_NS, CanLink
from emulator.transports.can_wire import HOST_FRAMES, STALE, CanWire
from emulator.transports.intake import CAN_BURST
from emulator.transports.link import Link, Received
from emulator.transports.schemes import open_link
from emulator.transports.socketcand import SocketcandServer
from emulator.transports.tcp_hosts import BACKLOG_LIMIT, BACKLOG_TOTAL, FLOOD_NS, MAX_HOSTS
from tests.runtime.test_control import LIMIT_S, AtOnce

MS = 1_000_000
SEND = b"< send 123 8 1 2 3 4 5 6 7 8 >"


@pytest.fixture
def hosts() -> Iterator[Callable[[Link, int, bytes], list[socket.socket]]]:
    opened: list[socket.socket] = []
    seen: list[Received] = []
    links: list[Link] = []

    def connect(link: Link, count: int, word: bytes = b"", at_ns: int = 0) -> list[socket.socket]:
        links.append(link)
        port = int(link.url.partition("/")[0].rpartition(":")[2])
        for number in range(count):
            one = socket.socket()
            one.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)  # the kernel's own grows to megabytes
            one.connect(("127.0.0.1", port))
            one.sendall(word)
            one.setblocking(False)
            opened.append(one)
            seen.extend(link.receive(at_ns + number * 10 * MS))
            link.flush(at_ns + number * 10 * MS)
        return opened

    connect.seen = seen  # type: ignore[attr-defined]
    yield connect
    for one in (*opened, *links):
        one.close()


def test_deaf_hosts_of_a_socket_share_a_megabyte(hosts: Callable[..., list[socket.socket]]) -> None:
    link = open_link("tcp:127.0.0.1:0", serial_line=False)
    payload = bytes(5000)
    for _ in range(MAX_HOSTS):  # one after the other: who comes first must not take all, nor who comes last more
        hosts(link, 1)
        for number in range(100):
            link.send(payload, 0)
            link.flush(number)
    assert link.stats.payloads_dropped > 0
    assert BACKLOG_TOTAL // 2 < link.held() <= BACKLOG_TOTAL + MAX_HOSTS * len(payload)


def test_one_deaf_host_does_not_take_the_share_of_one_who_reads(hosts: Callable[..., list[socket.socket]]) -> None:
    link = open_link("tcp:127.0.0.1:0", serial_line=False)
    _, reads = hosts(link, 2)
    payload, got = bytes(5000), 0
    for number in range(1000):
        link.send(payload, 0)
        link.flush(number)
        with contextlib.suppress(BlockingIOError):
            while data := reads.recv(1 << 20):
                got += len(data)
    reads.settimeout(LIMIT_S)
    while got < 1000 * len(payload):
        got += len(reads.recv(1 << 20))  # whole, every one
    assert link.held() <= BACKLOG_LIMIT + len(payload)


def test_who_is_deaf_for_long_makes_room_for_who_wants_to_come(hosts: Callable[..., list[socket.socket]]) -> None:
    link = open_link("tcp:127.0.0.1:0", serial_line=False)
    hosts(link, MAX_HOSTS, b"a request")
    for number in range(1000):
        link.send(bytes(5000), 0)
        link.flush(1000 * MS + number)
        link.receive(1000 * MS + number)
    before = len(hosts.seen)  # type: ignore[attr-defined]
    hosts(link, 1, at_ns=2000 * MS)
    hosts(link, 1, at_ns=2001 * MS + FLOOD_NS)
    came = [one.opened for one in hosts.seen[before:] if one.opened or one.closed]  # type: ignore[attr-defined]
    assert came == [False, True], "one has gone, and one of the two is there"
    assert link.stats.hosts_refused == 2


def test_clients_of_a_full_bus_are_left_unread_and_hear_no_more_than_they_hold(
    hosts: Callable[..., list[socket.socket]],
) -> None:
    link = open_link("socketcand:127.0.0.1:0/can0")
    assert isinstance(link, CanLink)
    assert link._port is not None
    server = link._port.outlet._server  # type: ignore[attr-defined]
    assert isinstance(server, SocketcandServer)
    clients = hosts(link, MAX_HOSTS, b"< open can0 >< rawmode >")
    link.receive(1000 * MS)
    tracemalloc.start()
    for number in range(150):
        for one in clients:
            with contextlib.suppress(BlockingIOError):
                one.send(SEND * 100)
        now_ns = (1000 + 10 * number) * MS
        link.receive(now_ns)
        link.flush(now_ns)
        link.send(bytes(8), now_ns, 0x60A)
        link.stats.lateness_ns.clear()
    grown = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    waiting = [len(node.waiting) for node in link.wire._nodes.values()]
    assert max(waiting[1:]) == HOST_FRAMES
    texts = [len(client.text) for client in server._clients.values()]
    assert len(texts) == MAX_HOSTS
    assert sum(client.blocked for client in server._clients.values()) > MAX_HOSTS // 2
    assert max(texts) <= CAN_BURST + len(SEND)
    assert len(link.wire._later) + len(link.wire._ready) <= 3 * MAX_HOSTS + STALE
    assert grown < 4_000_000, "with what waits for deaf clients, a megabyte"


def test_hosts_that_come_send_and_go_do_not_pile_up() -> None:
    wire = CanWire(500_000)
    busy = [wire.join("busy"), wire.join("busier")]
    for number in range(1000):
        guests = [wire.join("host") for _ in range(20)]
        for guest in guests:
            wire.put(guest, 0x7FF, bytes(8), 0)
        for node in busy:
            wire.put(node, 0x001, bytes(8), 0)
        wire.take(number * 260_000)
        for guest in guests:
            wire.leave(guest)
    assert len(wire._later) + len(wire._ready) <= STALE + 4


def test_a_bus_that_rests_stands_and_loses_nothing() -> None:
    link = open_link("socketcand:127.0.0.1:0/can0")
    assert isinstance(link, CanLink)
    assert link._port is not None
    port, busy = link._port, [0]
    port.turn.clock_ns = lambda: busy[0]
    stranger = link.wire.join("stranger")
    for _ in range(100):
        link.wire.put(stranger, 0x123, bytes(8), 0)
    poll = port.outlet.poll

    def dear(now_ns: int) -> None:
        poll(now_ns)
        busy[0] += 5 * MS

    port.outlet.poll = dear  # type: ignore[method-assign]
    seen: list[int] = []
    link.on_carried = lambda frame, _: seen.append(frame.start_ns)
    now_ns = 0
    while len(seen) < 100:
        link.receive(now_ns)
        wake = link.flush(now_ns)
        assert wake is not None
        assert wake > now_ns
        now_ns = wake
    assert len(seen) == 100
    assert seen == sorted(seen)
    assert now_ns > 100 * MS, "27 ms of frames, and rests of 20 ms for each 5 ms of work"
    assert busy[0] <= now_ns / 4 + 20 * MS
    link.close()


def test_frames_of_hosts_are_grouped_on_real_time_and_a_sensors_own_are_not() -> None:
    link = open_link("socketcand:127.0.0.1:0/can0")
    assert isinstance(link, CanLink)
    assert link._port is not None
    link._port.turn.clock_ns = lambda: 0
    stranger = link.wire.join("stranger")
    for _ in range(1000):
        link.wire.put(stranger, 0x123, bytes(8), 0)
    link.receive(2 * MS)
    assert link.flush(2 * MS) == 2 * MS + GROUP_NS
    link.send(bytes(8), 3 * MS, 0x60A)
    link.receive(3 * MS)
    wake = link.flush(3 * MS)
    assert wake is not None
    assert wake < 3 * MS + 300_000, "the frame on the wire ends, and then the sensor's own is to be seen"
    assert len(link._port.wire.take(10**9, AT_ONCE_FRAMES)) == AT_ONCE_FRAMES
    link.close()


# ------------------------------------------------------------ the control socket


def test_answers_that_nobody_reads_are_bounded_together_and_who_reads_is_answered(tmp_path: Path) -> None:
    big = "x" * 100_000
    server = ControlServer(tmp_path / "control.sock", {"big": lambda _: big}, AtOnce(), limited=False)
    line = b'{"id": 1, "method": "big"}\n'
    not_reading = []
    try:
        for _ in range(MOST_CLIENTS - 1):
            not_reading.append(socket.socket(socket.AF_UNIX))
            not_reading[-1].connect(str(server.path))
            not_reading[-1].sendall(line * 1000)
        reader = socket.socket(socket.AF_UNIX)
        not_reading.append(reader)
        reader.settimeout(LIMIT_S)
        reader.connect(str(server.path))
        for _ in range(20):
            reader.sendall(line)
            text = b""
            while not text.endswith(b"\n"):
                text += reader.recv(1 << 20)
            assert len(text) > len(big)
        unread = [len(client.unread) for client in list(server._clients.values())]
        assert sum(unread) <= MOST_UNREAD_ALL + MOST_CLIENTS * (len(big) + 100)
        assert max(unread) <= MOST_UNREAD + len(big) + 100
    finally:
        for one in not_reading:
            one.close()
        server.close()


class OneAtATime:
    """A budget that is used up by each answer, and full again when it is asked for the third time."""

    def __init__(self) -> None:
        self.blocked = 0

    def wait_ns(self, now_ns: int) -> int:
        self.blocked -= self.blocked > 0
        return self.blocked

    def spend(self, took_ns: int) -> None:
        self.blocked = 3


def test_clients_are_answered_in_turn(tmp_path: Path) -> None:
    asked: list[str] = []
    server = ControlServer(
        tmp_path / "control.sock", {"name": lambda params: asked.append(params["of"])}, AtOnce(), limited=False
    )
    server._budget = OneAtATime()  # type: ignore[assignment]
    with socket.socket(socket.AF_UNIX) as greedy, socket.socket(socket.AF_UNIX) as modest:
        for one, name, count in ((greedy, b"greedy", 1000), (modest, b"modest", 3)):
            one.settimeout(LIMIT_S)
            one.connect(str(server.path))
            one.sendall(b'{"id": 1, "method": "name", "params": {"of": "%s"}}\n' % name * count)
        while asked.count("modest") < 3:
            assert greedy.recv(65_536)
        first = asked.index("modest")
        assert asked[first : first + 6].count("modest") == 3, "every second answer from when it has asked"
    server.close()


def test_answers_take_no_more_than_their_share() -> None:
    budget = Budget(share=0.1, stock_ns=100 * MS)
    spent = now_ns = 0
    while now_ns < 10_000 * MS:
        if wait_ns := budget.wait_ns(now_ns):
            now_ns += wait_ns
            continue
        budget.spend(3 * MS)
        spent += 3 * MS
        now_ns += 3 * MS
    assert 0.9 * 1000 * MS <= spent <= 1000 * MS + 103 * MS
    budget.spend(10**12)  # one order that takes minutes
    assert budget.wait_ns(now_ns) <= 1000 * MS
