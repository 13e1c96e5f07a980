"""Who may come in: the page's server on one address, and a token without which it answers nothing.

viser has no door of its own. Its server asks `process_request` about every request, also the one that opens a web
socket; here that question is asked first whether the request brings the token, in the address the first time, later in
a cookie of this port. `open_server` tries the lock after it was fitted, and refuses to run without it.
"""

from __future__ import annotations

import hmac
import http.client
import io
import logging
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs, urlsplit

import viser
import websockets.asyncio.server as websocket_server
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from emulator.errors import LinkError

LOCAL = ("127.0.0.1", "localhost", "::1")
POLICY = (
    "default-src 'self' 'unsafe-inline' 'unsafe-eval' data: blob:; connect-src 'self' ws: data: blob:;"
    " frame-ancestors 'none'"
)
"The browser fetches nothing from elsewhere: the page is whole by itself."
GOODBYE_S = 1.0
"A browser that does not answer the goodbye for so long is cut off."
LONGEST_END_S = 30.0
_FITTING = threading.Lock()


class Lock:
    """Lets in who has the token."""

    def __init__(self, token: str) -> None:
        self._token = token
        self.port = 0

    @property
    def cookie(self) -> str:
        """Its name: browsers keep one jar for all ports of a host."""
        return f"lidaremu-view-{self.port}"

    def opens(self, path: str, cookies: str) -> str | None:
        """`address` or `cookie`, wherever the token was found; None: stay outside."""
        given = parse_qs(urlsplit(path).query).get("token", [""])[0]
        if hmac.compare_digest(given.encode(errors="surrogatepass"), self._token.encode()):
            return "address"
        try:
            kept = SimpleCookie(cookies).get(self.cookie)
        except CookieError:
            return None
        return (
            "cookie"
            if kept is not None and hmac.compare_digest(kept.value.encode(errors="surrogatepass"), self._token.encode())
            else None
        )

    def ask(self, request: Request, inner: Callable[[], Any]) -> Any:
        """The answer to a request: what lies behind the door, or 403."""
        found = self.opens(request.path, "; ".join(request.headers.get_all("Cookie")))
        if found is None:
            headers = Headers({"Content-Type": "text/plain", "Content-Length": "0"})
            return Response(HTTPStatus.FORBIDDEN, "FORBIDDEN", headers, b"")
        response = inner()
        if isinstance(response, Response):
            response.headers["Content-Security-Policy"] = POLICY
            response.headers["Referrer-Policy"] = "no-referrer"
            if found == "address":
                response.headers["Set-Cookie"] = f"{self.cookie}={self._token}; HttpOnly; SameSite=Strict; Path=/"
        return response


class LocalServer(viser.ViserServer):
    """viser's server without its tunnel to the outside, and without its words at the end."""

    def stop(self) -> None:
        """End it. Its thread says on the standard output that it ended, later than viser waits when hosts are slow."""
        thread = self._websock_server._server_thread
        with redirect_stdout(io.StringIO()):
            super().stop()
            if thread is not None:
                thread.join(LONGEST_END_S)

    def request_share_url(self, verbose: bool = True) -> None:
        """Nothing leaves this machine."""


def open_server(host: str, port: int, token: str, title: str) -> LocalServer:
    """The page's server, listening. Raises `LinkError` when the address cannot be had, or the lock does not hold."""
    be_free(host, port)
    lock = Lock(token)
    logging.getLogger("websockets.server").addFilter(_quiet)
    with _FITTING, _fitted(lock), redirect_stdout(io.StringIO()):  # it prints its address even when told not to
        server = LocalServer(host=host, port=port, label=title, verbose=False)
    lock.port = server.get_port()
    if _answers(host, lock.port, "/") != HTTPStatus.FORBIDDEN:
        server.stop()
        raise LinkError("this version of viser lets in whoever comes; want viser 1.1, see extra `view`")
    return server


def _quiet(record: logging.LogRecord) -> bool:
    return record.levelno >= logging.CRITICAL


def be_free(host: str, port: int) -> None:
    """`LinkError` unless the address can be had: viser would take another port, or try a thousand of them."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except (OSError, OverflowError, UnicodeError) as error:
            raise LinkError(f"cannot listen on {host}:{port}: {getattr(error, 'strerror', None) or error}") from None


@contextmanager
def _fitted(lock: Lock) -> Iterator[None]:
    """While this lasts, servers of websockets are made with the lock."""
    serve = websocket_server.serve

    def locked(*args: Any, process_request: Any = None, **options: Any) -> Any:
        def ask(connection: Any, request: Request) -> Any:
            return lock.ask(request, lambda: None if process_request is None else process_request(connection, request))

        return serve(*args, process_request=ask, **{"close_timeout": GOODBYE_S} | options)

    websocket_server.serve = locked  # type: ignore[assignment, misc]
    try:
        yield
    finally:
        websocket_server.serve = serve  # type: ignore[misc]


def _answers(host: str, port: int, path: str) -> int:
    reached = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)
    connection = http.client.HTTPConnection(reached, port, timeout=10.0)
    try:
        connection.request("GET", path)
        return connection.getresponse().status
    except OSError as error:
        raise LinkError(f"the page does not answer on {reached}:{port}: {error}") from None
    finally:
        connection.close()
