"""When virtual time waits for hosts, by a real clock that the test moves: what comes too late is counted."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from emulator.process.clock import ManualClock
from emulator.runtime import assembly
from emulator.runtime.virtual_daemon import ANSWER_NS
from emulator.scenario import scenario
from emulator.transports.urls import host_and_port, parse_url

CASE = """\
schema: 1
sensors:
  - {id: front, model: sick-lms111, links: ["tcp:127.0.0.1:0"]}
"""
ASK, STREAM = b"\x02sRN SCdevicestate\x03", b"\x02sEN LMDscandata 1\x03"
SECOND = 1_000_000_000
END_NS = 60 * SECOND


class Hosts:
    """A run of one sensor whose real clock stands, and hosts that speak when the test says so."""

    def __init__(self) -> None:
        loaded = scenario.loads(CASE, Path("case.yaml"))
        self.daemon, _ = assembly.start_virtual(loaded)
        self.clock = ManualClock(SECOND)
        self.daemon._real = self.clock  # type: ignore[assignment]
        self.daemon.power_on()
        self.daemon.advance(30 * SECOND)
        self.sockets: list[socket.socket] = []

    def come(self) -> socket.socket:
        place = host_and_port(self.daemon.links[0].url, parse_url(self.daemon.links[0].url).target)
        self.sockets.append(socket.create_connection(place))
        self.look()
        return self.sockets[-1]

    def look(self, after_ns: int = 0) -> None:
        """Everything that is to be done after so much real time."""
        self.clock.set(self.clock.now_ns() + after_ns)
        for _ in range(50):
            self.daemon._once(END_NS)

    def close(self) -> None:
        for one in self.sockets:
            one.close()
        self.daemon.close()


@pytest.fixture
def hosts() -> Iterator[Hosts]:
    made = Hosts()
    yield made
    made.close()


@pytest.mark.parametrize(("away_ns", "late"), [(ANSWER_NS - 1, 0), (ANSWER_NS * 3, 1)])
def test_a_request_after_a_reply_is_late_once_time_has_gone_on(hosts: Hosts, away_ns: int, late: int) -> None:
    host = hosts.come()
    host.sendall(ASK)
    hosts.look()
    assert host.recv(4096).startswith(b"\x02sRA SCdevicestate")
    before_ns = hosts.daemon.now_ns
    hosts.look(away_ns)
    assert (hosts.daemon.now_ns > before_ns) == bool(late)
    assert hosts.daemon.late_answers == 0, "it has not answered yet"
    host.sendall(ASK)
    hosts.look()
    assert hosts.daemon.late_answers == late
    host.sendall(ASK)
    hosts.look()
    assert hosts.daemon.late_answers == late, "time has stood since"


@pytest.mark.parametrize(("away_ns", "late"), [(ANSWER_NS - 1, 0), (ANSWER_NS, 1)])
def test_the_first_word_of_one_that_has_come_is_late_after_its_time(hosts: Hosts, away_ns: int, late: int) -> None:
    host = hosts.come()
    hosts.look(away_ns)
    host.sendall(ASK)
    hosts.look()
    assert hosts.daemon.late_answers == late


def test_a_longer_time_may_be_given(hosts: Hosts) -> None:
    hosts.daemon.answer_ns = 10 * SECOND
    host = hosts.come()
    hosts.look(9 * SECOND)
    host.sendall(ASK)
    hosts.look()
    host.recv(4096)
    before_ns = hosts.daemon.now_ns
    hosts.look(9 * SECOND)
    host.sendall(ASK)
    hosts.look()
    assert hosts.daemon.now_ns - before_ns < SECOND // 10
    assert hosts.daemon.late_answers == 0


def test_a_host_that_is_silent_or_goes_makes_nothing_late(hosts: Hosts) -> None:
    host = hosts.come()
    hosts.look(5 * ANSWER_NS)
    host.close()
    hosts.look(5 * ANSWER_NS)
    assert hosts.daemon.late_answers == 0


def test_one_that_comes_after_time_went_on_is_late(hosts: Hosts) -> None:
    hosts.daemon.waits_for_hosts = False
    hosts.look()
    hosts.come()
    assert hosts.daemon.late_answers == 1


def test_at_a_speed_every_word_depends_on_the_real_clock(hosts: Hosts) -> None:
    hosts.daemon.rebase(1.0)
    host = hosts.come()
    late = []
    for _ in range(3):
        hosts.look(ANSWER_NS // 2)
        host.sendall(ASK)
        hosts.look()
        late.append(hosts.daemon.late_answers)
    assert late[2] - late[1] == late[1] - late[0] == 1


def test_reading_alone_is_never_late(hosts: Hosts) -> None:
    host = hosts.come()
    host.sendall(STREAM)
    for _ in range(20):
        hosts.look(ANSWER_NS // 4)
        host.recv(1 << 20)
    assert hosts.daemon.late_answers == 0
