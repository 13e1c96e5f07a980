"""Who keeps a place at the control socket when all are taken; the run behind it answers nothing here."""

from __future__ import annotations

import queue
import shutil
import socket
import stat
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import ExitStack
from pathlib import Path

import pytest

from emulator.process.clock import ManualClock
from emulator.runtime.control import LOOK_NS, MOST_CLIENTS, UNREAD_S, ControlServer, ask

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
        assert b"longest idle of 16 clients" in gone.recv(4096)
        assert gone.recv(1) == b""
    assert b'"result"' in room.ask(crowd[1])


def test_who_is_within_a_request_keeps_its_place_until_it_has_sent_nothing_for_long(room: Room) -> None:
    crowd = [room.client() for _ in range(MOST_CLIENTS)]
    for one in crowd:
        assert b'"result"' in room.ask(one, b'{"id": 1, "method": "echo"}\n{"id": 2, "meth')  # an answer: it has both
    assert b"16 clients are connected already" in room.client().recv(4096)
    room.clock.set(int(20e9))
    assert b'"result"' in room.ask(crowd[0], b'od": "echo"}\n{"id": 2,')  # and into the next one
    room.clock.set(int(UNREAD_S * 1e9) + 1)
    assert b'"result"' in room.ask(room.client())
    assert b"longest idle" in crowd[1].recv(4096)
    assert b'"result"' in room.ask(crowd[0], b' "method": "echo"}\n')


def test_a_socket_that_was_removed_is_put_back_and_who_is_connected_stays(tmp_path: Path) -> None:
    reported: queue.Queue[tuple[str, str]] = queue.Queue()
    methods = {"echo": lambda params: params}
    path = tmp_path / "folder" / "control.sock"
    path.parent.mkdir()
    with ExitStack() as stack:
        server = ControlServer(path, methods, AtOnce(), lambda *what: reported.put(what))
        stack.callback(server.close)
        clock = server._clock = ManualClock()  # type: ignore[assignment]
        bell = stack.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_STREAM))
        bell.settimeout(LIMIT_S)
        bell.connect(str(path))

        def look() -> None:
            """Let the server's thread look: a request of one who is here wakes it."""
            clock.set(clock.now_ns() + LOOK_NS)  # type: ignore[attr-defined]
            for _ in range(2):  # it looks after it has answered
                bell.sendall(b'{"id": 1, "method": "echo"}\n')
                assert b"result" in bell.recv(4096)

        path.unlink()
        look()
        assert reported.get(timeout=LIMIT_S) == ("link restored", f"{path}: was removed; listening again")
        assert ask(path, "echo", {"a": 1}) == {"a": 1}
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
        path.unlink()
        path.write_text("precious")
        look()
        assert reported.get(timeout=LIMIT_S)[0] == "link path taken"
        look()
        assert path.read_text() == "precious"
        shutil.rmtree(path.parent)
        path.parent.mkdir()
        look()
        assert reported.get(timeout=LIMIT_S)[0] == "link restored"
        other = path.with_name("other.sock")
        path.rename(other)
        second = ControlServer(path, methods, AtOnce())
        look()
        assert "Address already in use" in reported.get(timeout=LIMIT_S)[1]
        second.close()
        look()
        assert reported.get(timeout=LIMIT_S)[0] == "link restored"
        assert reported.empty()
    assert not path.exists()
