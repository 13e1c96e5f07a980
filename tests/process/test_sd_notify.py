"""What systemd is told, over a socket of its own."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from emulator.process.sd_notify import Notifier


@pytest.fixture
def service(tmp_path: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(str(tmp_path / "notify"))
        listener.setblocking(False)
        yield listener


def heard(listener: socket.socket) -> list[str]:
    found = []
    while True:
        try:
            found.append(listener.recv(1000).decode())
        except BlockingIOError:
            return found


def test_a_run_from_ready_to_the_end(service: socket.socket) -> None:
    environment = {"NOTIFY_SOCKET": str(service.getsockname()), "WATCHDOG_USEC": "1000000", "PATH": "/bin"}
    said = Notifier.of_environment(environment)
    assert environment == {"PATH": "/bin"}, "no child speaks for us"
    said.ready()
    for now_ms in range(0, 2000, 100):
        said.alive(now_ms * 1_000_000, "2 sensors" if now_ms < 1500 else "2 sensors; silent: a")
    said.stopping()
    said.close()
    said.stopping()  # nothing more
    words = heard(service)
    assert words[0] == "READY=1"
    assert words[-1] == "STOPPING=1"
    assert words.count("WATCHDOG=1") == 4, "every half of its time"
    assert [word for word in words if word.startswith("STATUS=")] == ["STATUS=2 sensors", "STATUS=2 sensors; silent: a"]


def test_an_abstract_socket() -> None:
    name = f"\0lidaremu-test-{os.getpid()}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(name)
        said = Notifier.of_environment({"NOTIFY_SOCKET": "@" + name[1:]})
        said.ready()
        said.close()
        assert listener.recv(100) == b"READY=1"


@pytest.mark.parametrize(
    ("more", "barks"),
    [
        ({"WATCHDOG_PID": str(os.getpid())}, True),
        ({"WATCHDOG_PID": str(os.getpid() + 1)}, False),
        ({"WATCHDOG_USEC": "soon"}, False),
        ({"WATCHDOG_USEC": "-5"}, False),
        ({"WATCHDOG_USEC": "9" * 30}, False),
        ({"WATCHDOG_USEC": "0"}, False),
    ],
)
def test_the_watchdog_is_ours_only_if_it_says_so(service: socket.socket, more: dict[str, str], barks: bool) -> None:
    said = Notifier.of_environment({"NOTIFY_SOCKET": str(service.getsockname()), "WATCHDOG_USEC": "1000"} | more)
    said.alive(10**12, "")
    said.close()
    assert heard(service) == (["WATCHDOG=1"] if barks else [])


@pytest.mark.parametrize("address", ["", "vsock:2:1234", "relative", "/no/such/socket"])
def test_where_nobody_listens_nothing_happens(address: str) -> None:
    said = Notifier.of_environment({"NOTIFY_SOCKET": address, "WATCHDOG_USEC": "1000"})
    said.ready()
    said.alive(0, "1 sensors")
    said.close()


def test_a_service_manager_that_does_not_read_holds_nobody_up(service: socket.socket) -> None:
    said = Notifier(str(service.getsockname()), 2)
    for turn in range(5000):
        said.alive(turn * 1_000_000, str(turn))
    said.close()
    assert 0 < len(heard(service)) < 10_000
