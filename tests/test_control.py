"""Who keeps a place at the control socket when all are taken; the run behind it answers nothing here."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import ExitStack
from pathlib import Path

import pytest

from emulator.clock import ManualClock
from emulator.control import DEAF_S, MOST_CLIENTS, ControlServer

LIMIT_S = 60.0


class AtOnce:
    """A run that does what it is told in the caller's thread."""

    def call(self, action: Callable[[], object]) -> Future[object]:
        done: Future[object] = Future()
        done.set_result(action())
        return done


class Room:
    """A server whose clock is moved by hand, and its clients."""

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        self.clock, self._stack = ManualClock(), stack
        self.server = ControlServer(folder / "control.sock", {"echo": lambda params: params}, AtOnce())
        self.server._clock = self.clock  # type: ignore[assignment]
        stack.callback(self.server.close)

    def client(self) -> socket.socket:
        one = self._stack.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_STREAM))
        one.settimeout(LIMIT_S)
        one.connect(str(self.server.path))
        return one

    def ask(self, one: socket.socket, rest: bytes = b'{"id": 1, "method": "echo"}\n') -> bytes:
        one.sendall(rest)
        return one.recv(4096)


@pytest.fixture
def room(tmp_path: Path) -> Iterator[Room]:
    with ExitStack() as stack:
        yield Room(tmp_path, stack)


def test_the_longest_silent_makes_room(room: Room) -> None:
    crowd = [room.client() for _ in range(MOST_CLIENTS)]
    for second, one in enumerate((crowd[3], crowd[0], *crowd[4:], crowd[2], crowd[1]), start=1):
        room.clock.set(second * 10**9)
        assert b'"result"' in room.ask(one)
    for gone in (crowd[3], crowd[0], crowd[4]):
        assert b'"result"' in room.ask(room.client())
        assert b"the longest silent of 16 clients" in gone.recv(4096)
        assert gone.recv(1) == b""
    assert b'"result"' in room.ask(crowd[1])


def test_who_is_within_a_request_keeps_its_place_until_it_has_sent_nothing_for_long(room: Room) -> None:
    crowd = [room.client() for _ in range(MOST_CLIENTS)]
    for one in crowd:
        assert b'"result"' in room.ask(one, b'{"id": 1, "method": "echo"}\n{"id": 2, "meth')  # an answer: it has both
    assert b"16 clients are connected already" in room.client().recv(4096)
    room.clock.set(int(20e9))
    assert b'"result"' in room.ask(crowd[0], b'od": "echo"}\n{"id": 2,')  # and into the next one
    room.clock.set(int(DEAF_S * 1e9) + 1)
    assert b'"result"' in room.ask(room.client())
    assert b"the longest silent" in crowd[1].recv(4096)
    assert b'"result"' in room.ask(crowd[0], b' "method": "echo"}\n')
