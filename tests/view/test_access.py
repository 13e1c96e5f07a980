"""Who comes in, request by request: the token in the path, the hosts that were opened, the page's own origin."""

from __future__ import annotations

import re
from typing import Any

import pytest

pytest.importorskip("viser", reason="extra `view` is not installed")
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from emulator.errors import EmulatorError
from emulator.view.access import Lock

TOKEN = "correcthorse"
PORT = 8123
HERE = f"127.0.0.1:{PORT}"


def lock(host: str = "127.0.0.1", *further: str) -> Lock:
    made = Lock(TOKEN, host, further)
    made.port = PORT
    return made


def ask(
    path: str = f"/{TOKEN}/",
    host: str | None = HERE,
    by: Lock | None = None,
    reached: str | None = None,
    **more: str,
) -> Any:
    """What a request is answered; `more`: further headers, `_` for `-`."""
    headers = Headers({} if host is None else {"Host": host})
    for key, value in more.items():
        headers[key.replace("_", "-")] = value
    page = Response(200, "OK", Headers(), b"page")
    inner = (lambda request: None) if "Upgrade" in headers else (lambda request: page)
    return (by or lock()).ask(Request(path, headers), inner, reached)


def let_in(answer: Any) -> bool:
    """The page, or a handshake that goes on."""
    return answer is None or answer.status_code == 200


@pytest.mark.parametrize("path", [f"/{TOKEN}/", f"/{TOKEN}", f"/{TOKEN}/?websocket=x"])
def test_the_token_in_the_path_opens(path: str) -> None:
    assert ask(path).body == b"page"


@pytest.mark.parametrize(
    "path",
    [
        "/",
        f"/{TOKEN}x/",
        f"/{TOKEN[:-1]}/",
        f"/x/{TOKEN}/",
        f"//{TOKEN}/",
        f"{TOKEN}/",
        f"http://127.0.0.1/{TOKEN}/",
        "/?token=",
        f"/?token=x&token={TOKEN}",
        f"/?token={TOKEN}x",
        "/?token=\udcff",
        "/\udcff/",
        "//[",
        "/?" + "a=b&" * 100,
    ],
)
def test_without_it_nothing_is_told(path: str) -> None:
    asked: list[Request] = []
    answer = lock().ask(Request(path, Headers({"Host": HERE})), lambda request: asked.append(request))  # type: ignore[func-returns-value]
    assert (answer.status_code, answer.body, asked) == (403, b"", [])  # type: ignore[attr-defined]


def test_a_cookie_opens_nothing_and_none_is_given() -> None:
    assert not let_in(ask("/", Cookie=f"lidaremu-view-{PORT}={TOKEN}; token={TOKEN}"))
    assert "Set-Cookie" not in ask().headers


@pytest.mark.parametrize(
    "path", [f"/{TOKEN}/x.js", f"/{TOKEN}/../secret", f"/{TOKEN}/%2e%2e/x", f"/{TOKEN}//", f"/{TOKEN}/."]
)
def test_behind_the_token_there_is_the_page_alone(path: str) -> None:
    assert ask(path).status_code == 404


def test_an_address_of_older_versions_leads_on() -> None:
    answer = ask(f"/?token={TOKEN}")
    assert (answer.status_code, answer.headers["Location"]) == (303, f"/{TOKEN}/")


def test_a_ticket_opens_once() -> None:
    one = lock()
    ticket = one.ticket()
    assert TOKEN not in ticket
    assert not let_in(ask(ticket, host="evil.example", by=one))
    assert ask(ticket, by=one).headers["Location"] == f"/{TOKEN}/"
    assert ask(ticket, by=one).status_code == 403
    assert ask("/", by=one).status_code == 403


@pytest.mark.parametrize("host", [HERE, f"localhost:{PORT}", f"[::1]:{PORT}", f"LocalHost:{PORT}"])
def test_it_is_reached_by_the_names_of_this_machine(host: str) -> None:
    assert let_in(ask(host=host))
    assert let_in(ask(host=host, Upgrade="websocket", Origin=f"http://{host}"))


@pytest.mark.parametrize(
    "host",
    [
        None,
        "",
        "evil.example",
        f"evil.example:{PORT}",
        "127.0.0.1",
        "127.0.0.1:1",
        f"127.0.0.2:{PORT}",
        f"0.0.0.0:{PORT}",
        f"127.0.0.1.evil.example:{PORT}",
        f"localhost.:{PORT}",
        f"user@127.0.0.1:{PORT}",
        f"127.0.0.1:{PORT}, evil.example",
    ],
)
@pytest.mark.parametrize("upgrade", [{}, {"Upgrade": "websocket"}])
def test_by_another_name_nobody_comes_in(host: str | None, upgrade: dict[str, str]) -> None:
    assert ask(host=host, **upgrade).status_code == 403
    assert ask("/", host=host, **upgrade).body == b""


def test_two_hosts_are_none() -> None:
    headers = Headers([("Host", HERE), ("Host", HERE)])
    assert lock().ask(Request(f"/{TOKEN}/", headers), lambda request: None).status_code == 403  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    "origin",
    [
        "http://evil.example",
        "null",
        "",
        "http://127.0.0.1:9999",
        "http://127.0.0.1",
        f"https://{HERE}",
        f"http://localhost:{PORT}",
        f"http://{HERE}.evil.example",
        f"http://{HERE}/",
        "file://",
    ],
)
@pytest.mark.parametrize("upgrade", [{}, {"Upgrade": "websocket"}])
def test_another_origin_gets_nothing_though_it_has_the_token(origin: str, upgrade: dict[str, str]) -> None:
    answer = ask(Origin=origin, **upgrade)
    assert (answer.status_code, answer.body) == (403, b"")


def test_two_origins_are_none() -> None:
    own = f"http://{HERE}"
    headers = Headers([("Host", HERE), ("Origin", own), ("Origin", own)])
    assert lock().ask(Request(f"/{TOKEN}/", headers), lambda request: None).status_code == 403  # type: ignore[attr-defined]


def test_a_program_that_is_no_browser_needs_the_token_alone() -> None:
    assert let_in(ask(Upgrade="websocket"))
    assert not let_in(ask("/", Upgrade="websocket"))


def test_the_page_comes_with_a_policy_and_is_kept_nowhere() -> None:
    headers = ask(host=f"localhost:{PORT}").headers
    rules = dict(rule.strip().split(" ", 1) for rule in headers["Content-Security-Policy"].split(";"))
    assert rules["default-src"] == "'none'"
    assert rules["script-src-attr"] == "'none'"
    assert rules["connect-src"] == f"ws://localhost:{PORT} data: blob:"
    assert (headers["Cache-Control"], headers["Referrer-Policy"]) == ("no-store", "no-referrer")
    assert headers["Cross-Origin-Resource-Policy"] == "same-origin"


def test_who_has_the_token_is_told_what_was_opened() -> None:
    one, reported = lock(), []
    one.refused = reported.append
    assert f"opened for 127.0.0.1:{PORT}" in ask(host="tunnel:9000", by=one).body.decode()
    ask("/", host="evil.example", by=one)
    assert reported == ["tunnel:9000"]


# ---------------------------------------------------------------- other addresses


def test_an_address_that_is_listened_on_is_reached_by_itself_and_by_no_name_of_this_machine() -> None:
    one = lock("192.0.2.7")
    assert let_in(ask(host=f"192.0.2.7:{PORT}", by=one))
    assert not let_in(ask(by=one))


@pytest.mark.parametrize("host", ["0.0.0.0", "::"])
def test_of_all_addresses_that_one_counts_by_which_the_connection_came(host: str) -> None:
    one = lock(host)
    assert let_in(ask(host=f"192.0.2.7:{PORT}", by=one, reached="192.0.2.7"))
    assert let_in(ask(host=f"[2001:db8::7]:{PORT}", by=one, reached="2001:db8::7"))
    assert not let_in(ask(host=f"192.0.2.7:{PORT}", by=one, reached="192.0.2.8"))
    assert not let_in(ask(host=f"lab.example:{PORT}", by=one, reached="192.0.2.7"))


def test_a_name_that_is_listened_on_may_be_asked_for() -> None:
    assert let_in(ask(host=f"lab.local:{PORT}", by=lock("lab.local"), reached="192.0.2.7"))


def test_on_port_80_browsers_leave_it_out() -> None:
    one = lock()
    one.port = 80
    assert let_in(ask(host="localhost", by=one, Origin="http://localhost"))
    assert let_in(ask(host="localhost:80", by=one))


def test_a_tunnel_or_a_proxy_is_allowed_by_its_name() -> None:
    one = lock("127.0.0.1", "localhost:9000", "https://lab.example", "proxy")
    assert let_in(ask(host="localhost:9000", by=one, Origin="http://localhost:9000"))
    assert let_in(ask(host="lab.example", by=one, Origin="https://lab.example"))
    assert "wss://lab.example" in ask(host="lab.example", by=one).headers["Content-Security-Policy"]
    assert let_in(ask(host=f"proxy:{PORT}", by=one))
    assert not let_in(ask(host="lab.example", by=one, Origin="http://lab.example"))
    assert not let_in(ask(host="localhost:9000", by=one, Origin=f"http://{HERE}"))
    assert not let_in(ask(host="proxy:9000", by=one))


@pytest.mark.parametrize(
    "text", ["", "a/b", "a b", "ftp://a", "a:b", "a:99999", "*", "a?x", "u@a", "http://", "a\nb", "é"]
)
def test_what_is_no_host_is_refused(text: str) -> None:
    with pytest.raises(EmulatorError, match=re.escape("want NAME, NAME:PORT or https://NAME[:PORT]")):
        lock("127.0.0.1", text)
