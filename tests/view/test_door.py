"""Without the token nothing is answered, neither the page nor its socket."""

from __future__ import annotations

import socket

import pytest

pytest.importorskip("viser", reason="extra `view` is not installed")
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from emulator.view.door import LONGEST_END_S, Lock, open_server

TOKEN = "correcthorse"


def lock() -> Lock:
    made = Lock(TOKEN)
    made.port = 8123
    return made


@pytest.mark.parametrize(
    ("path", "cookies", "found"),
    [
        (f"/?token={TOKEN}", "", "address"),
        (f"/a/b?x=1&token={TOKEN}", "", "address"),
        ("/", f"a=b; lidaremu-view-8123={TOKEN}", "cookie"),
        ("/", "", None),
        ("/?token=", "", None),
        (f"/?token={TOKEN}x", "", None),
        (f"/?token={TOKEN[:-1]}", "", None),
        (f"/?token=x&token={TOKEN}", "", None),
        (f"/{TOKEN}", "", None),
        ("/", f"lidaremu-view-8124={TOKEN}", None),
        ("/", f"lidaremu-view-8123={TOKEN}x", None),
        ("/?token=\udcff", "lidaremu-view-8123", None),
    ],
)
def test_the_token_opens_and_nothing_else(path: str, cookies: str, found: str | None) -> None:
    assert lock().opens(path, cookies) == found


def test_a_request_without_it_is_refused_before_anything_is_done() -> None:
    asked = []
    answer = lock().ask(Request("/", Headers()), lambda: asked.append(1))
    assert (answer.status_code, answer.body, asked) == (403, b"", [])


def test_the_first_page_brings_the_cookie_and_a_policy() -> None:
    page = Response(200, "OK", Headers(), b"page")
    answer = lock().ask(Request(f"/?token={TOKEN}", Headers()), lambda: page)
    assert answer.headers["Set-Cookie"] == f"lidaremu-view-8123={TOKEN}; HttpOnly; SameSite=Strict; Path=/"
    assert "connect-src 'self'" in answer.headers["Content-Security-Policy"]
    again = lock().ask(
        Request("/", Headers({"Cookie": f"lidaremu-view-8123={TOKEN}"})), lambda: Response(200, "", Headers())
    )
    assert "Set-Cookie" not in again.headers


def test_a_socket_with_the_cookie_goes_on_to_the_handshake() -> None:
    headers = Headers({"Upgrade": "websocket", "Cookie": f"lidaremu-view-8123={TOKEN}"})
    assert lock().ask(Request("/", headers), lambda: None) is None
    assert lock().ask(Request("/", Headers({"Upgrade": "websocket"})), lambda: None).status_code == 403


def test_a_server_that_ends_late_says_nothing(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    server = open_server("127.0.0.1", port, TOKEN, "late")
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
