"""The page's server: the lock is fitted, waiting connections are bounded, its end is silent."""

from __future__ import annotations

import socket
from collections.abc import Iterator

import pytest

pytest.importorskip("viser", reason="extra `view` is not installed")

from emulator.view import local_server
from emulator.view.local_server import LONGEST_END_S, LocalServer, open_server

TOKEN = "correcthorse"
KEY = "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ=="
UPGRADE = ("Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Version: 13", KEY)


def free_port() -> int:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[LocalServer]:
    monkeypatch.setattr(local_server, "OPEN_S", 1.0)  # the rest of a request without an end is waited for
    made = open_server("127.0.0.1", free_port(), TOKEN, "test")
    yield made
    made.stop()


def asked(port: int, request: bytes) -> bytes:
    """The first line of the answer; empty when it was hung up."""
    with socket.create_connection(("127.0.0.1", port), timeout=20.0) as connection:
        connection.sendall(request)
        answer = b""
        while b"\r\n" not in answer:
            data = connection.recv(4096)
            if not data:
                break
            answer += data
        return answer.partition(b"\r\n")[0]


def request(path: str, *headers: str) -> bytes:
    return "\r\n".join([f"GET {path} HTTP/1.1", *headers, "", ""]).encode("latin-1")


def test_the_lock_holds_for_pages_and_for_sockets(server: LocalServer) -> None:
    port = server.get_port()
    host = f"Host: 127.0.0.1:{port}"
    own, evil = f"Origin: http://127.0.0.1:{port}", "Origin: http://evil.example"
    cookie = f"Cookie: lidaremu-view-{port}={TOKEN}"
    found = {
        "page": asked(port, request(f"/{TOKEN}/", host)),
        "socket": asked(port, request(f"/{TOKEN}", host, own, *UPGRADE)),
        "no token": asked(port, request("/", host)),
        "cookie": asked(port, request("/", host, cookie)),
        "socket, cookie": asked(port, request("/", host, own, cookie, *UPGRADE)),
        "evil origin": asked(port, request(f"/{TOKEN}", host, evil, cookie, *UPGRADE)),
        "evil host": asked(port, request(f"/{TOKEN}/", f"Host: evil.example:{port}")),
        "evil host, socket": asked(port, request(f"/{TOKEN}", "Host: evil.example", evil, *UPGRADE)),
    }
    words = {name: line.split(b" ")[1:2] for name, line in found.items()}
    assert words == {name: [b"403"] for name in found} | {"page": [b"200"], "socket": [b"101"]}


@pytest.mark.parametrize(
    "garbage",
    [
        f"POST /{TOKEN}/ HTTP/1.1\r\nHost: a\r\nContent-Length: 3\r\n\r\nabc".encode(),
        f"HEAD /{TOKEN}/ HTTP/1.1\r\n\r\n".encode(),
        b"GET / HTTP/1.0\r\n\r\n",
        b"\x16\x03\x01\x02\x00\x01\x00",
        b"GET /" + b"a" * 20_000 + b" HTTP/1.1\r\n\r\n",
        b"GET / HTTP/1.1\r\n" + b"".join(b"x%d: y\r\n" % number for number in range(300)) + b"\r\n",
        b"\r\n" * 10,
    ],
    ids=["post", "head", "old", "tls", "long", "many headers", "empty"],
)
def test_garbage_is_hung_up_and_the_page_stays(server: LocalServer, garbage: bytes) -> None:
    port = server.get_port()
    try:
        assert asked(port, garbage) == b""
    except ConnectionError:
        pass  # hung up while it was still sending
    assert b"200" in asked(port, request(f"/{TOKEN}/", f"Host: 127.0.0.1:{port}"))


def test_of_those_who_wait_and_ask_for_nothing_the_first_makes_room(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(local_server, "OPEN_S", 1000.0)
    server = open_server("127.0.0.1", free_port(), TOKEN, "test")
    port = server.get_port()
    silent = [socket.create_connection(("127.0.0.1", port), timeout=20.0) for _ in range(local_server.MOST_WAITING + 3)]
    assert b"200" in asked(port, request(f"/{TOKEN}/", f"Host: 127.0.0.1:{port}"))
    assert _hung_up(silent[0])
    assert _hung_up(silent[1])
    for one in silent:
        one.close()
    server.stop()


def _hung_up(connection: socket.socket) -> bool:
    try:
        return connection.recv(1) == b""
    except ConnectionError:
        return True


def test_who_asks_for_nothing_is_hung_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(local_server, "OPEN_S", 0.05)
    server = open_server("127.0.0.1", free_port(), TOKEN, "test")
    with socket.create_connection(("127.0.0.1", server.get_port()), timeout=5.0) as slow:
        slow.sendall(b"GET / HT")
        assert _hung_up(slow)
    server.stop()


def test_a_server_that_ends_late_says_nothing(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    server = open_server("127.0.0.1", free_port(), TOKEN, "late")
    thread = server._websock_server._server_thread
    assert thread is not None
    join = thread.join

    def late(timeout: float | None = None) -> None:
        if timeout == LONGEST_END_S:  # for less it is as if a browser did not let go in time
            join(timeout)

    monkeypatch.setattr(thread, "join", late)
    server.stop()
    assert not thread.is_alive()
    assert capfd.readouterr() == ("", "")
