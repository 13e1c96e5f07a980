"""Datagrams: whole, to the place named, and back to whoever asked."""

from __future__ import annotations

import contextlib
import os
import select
import socket
from collections.abc import Iterator

import pytest

from emulator.errors import LinkError
from emulator.transports.link import Link
from emulator.transports.schemes import open_link
from protocols.session import LinkKind

MS = 1_000_000


@contextlib.contextmanager
def opened(url: str, serial_line: bool = False) -> Iterator[Link]:
    link = open_link(url, serial_line)
    try:
        yield link
    finally:
        link.close()


@pytest.fixture
def host() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as endpoint:
        endpoint.bind(("127.0.0.1", 0))
        endpoint.settimeout(5.0)
        yield endpoint


def port_of(endpoint: socket.socket) -> int:
    port: int = endpoint.getsockname()[1]
    return port


def test_each_payload_is_one_datagram_sent_when_due(host: socket.socket) -> None:
    with opened(f"udp:127.0.0.1:{port_of(host)}") as link:
        assert link.kind is LinkKind.DATAGRAM
        assert link.filenos() == ()
        link.send(b"first", 5)
        link.send(b"second", 10)
        assert link.flush(4) == 5
        assert link.flush(5) == 10
        assert host.recv(100) == b"first"
        assert link.flush(10) is None
        assert host.recv(100) == b"second"


def test_a_line_s_telegram_is_one_datagram_sent_when_its_last_bit_has_left(host: socket.socket) -> None:
    with opened(f"udp:127.0.0.1:{port_of(host)}", serial_line=True) as link:
        assert link.kind is LinkKind.SERIAL
        link.set_speed(500_000)
        link.send(bytes(732), 0)
        assert link.flush(0) == 14_640_000
        link.flush(14_639_999)
        assert select.select([host], [], [], 0)[0] == []
        link.flush(14_640_000)
        assert len(host.recv(2000)) == 732


def test_a_reply_goes_to_whoever_asked_and_comes_from_the_listening_port(host: socket.socket) -> None:
    with opened("udp:127.0.0.1:9?listen=0") as link:
        listening = int(link.url.rpartition(":")[2])
        host.sendto(b"request", ("127.0.0.1", listening))
        select.select(link.filenos(), [], [], 5.0)
        (received,) = link.receive(0)
        assert (received.peer, received.data) == (port_of(host), b"request")
        link.send(b"reply", 0, peer=received.peer)
        link.flush(0)
        assert host.recvfrom(100) == (b"reply", ("127.0.0.1", listening))


def test_a_datagram_longer_than_any_is_dropped_whole_and_counted(host: socket.socket) -> None:
    with opened(f"udp:127.0.0.1:{port_of(host)}") as link:
        link.send(bytes(70_000), 0)
        link.send(b"short", 0)
        link.flush(0)
        assert host.recv(100) == b"short"
        assert link.stats.payloads_dropped == 1


def test_nobody_there_is_no_fault() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as gone:
        gone.bind(("127.0.0.1", 0))
        port = port_of(gone)
    with opened(f"udp:127.0.0.1:{port}?listen=0") as link:
        for number in range(10):
            link.send(b"x", number)
            link.flush(number)
            assert link.receive(number) == []


@pytest.mark.parametrize("listen", ["", "?listen=127.0.0.1:0"])
def test_a_closed_port_is_told_to_who_asks_and_an_open_one_loses_nothing(listen: str) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as host:
        host.bind(("127.0.0.1", 0))
        port, told = port_of(host), []
        with opened(f"udp:127.0.0.1:{port}{listen}") as link:
            link.tell_undelivered(told.append)
            link.send(b"a", 0)
            link.flush(0)
            assert (host.recv(10), told) == (b"a", [])
            host.close()
            for number in range(1, 4):
                link.send(b"lost", number)
                link.flush(number)
            assert told == [True, True]  # each by the next one
            ready = [one for one in link.filenos() if select.select([one], [], [], 0.0)[0]]
            link.receive(4)
            assert not any(select.select([one], [], [one], 0.0)[0] for one in ready), "nothing is left to read"
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as again:
                again.bind(("127.0.0.1", port))
                again.settimeout(5.0)
                for number in range(5, 8):
                    link.send(b"%d" % number, number)
                    link.flush(number)
                    assert again.recv(10) == b"%d" % number
                assert told == [True, True, True]
            link.send(bytes(70_000), 9)
            link.flush(9)
            assert told[-1] is False
            assert link.stats.payloads_dropped == 1


def test_only_so_many_senders_are_remembered() -> None:
    with opened("udp:127.0.0.1:9?listen=0") as link:
        listening = int(link.url.rpartition(":")[2])
        for _ in range(100):
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
                sender.sendto(b"x", ("127.0.0.1", listening))
                select.select(link.filenos(), [], [], 5.0)
                assert len(link.receive(0)) == 1
        assert len(link._senders) <= 64  # type: ignore[attr-defined]


def test_multicast_stays_on_the_interface_asked_for() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as host:
        host.bind(("239.255.77.1", 0))
        host.settimeout(5.0)
        group = socket.inet_aton("239.255.77.1") + socket.inet_aton("127.0.0.1")
        host.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, group)
        with opened(f"udp:239.255.77.1:{port_of(host)}?interface=127.0.0.1") as link:
            link.send(b"to the group", 0)
            link.flush(0)
            assert host.recv(100) == b"to the group"


def test_a_listening_port_in_use_is_said_so_plainly(host: socket.socket) -> None:
    before = len(os.listdir("/proc/self/fd"))
    with pytest.raises(LinkError, match="Address already in use"):
        open_link(f"udp:127.0.0.1:9?listen={port_of(host)}")
    assert len(os.listdir("/proc/self/fd")) == before


def test_an_unknown_host_is_said_so_plainly() -> None:
    with pytest.raises(LinkError, match=r"host 'no-such-host\.invalid' not found"):
        open_link("udp:no-such-host.invalid:9")


def test_a_device_can_be_redirected_to_another_address_and_port(host: socket.socket) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.77", 0))
        other.settimeout(5.0)
        with opened(f"udp:127.0.0.1:{port_of(host)}") as link:
            link.send_to(b"there", 0, ("127.0.0.77", port_of(other)))
            link.send(b"here", 0, 0)
            link.flush(0)
            assert other.recv(100) == b"there"
            assert host.recv(100) == b"here"
