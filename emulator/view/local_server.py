"""The page's server behind its lock.

viser has no door of its own. Its server asks `process_request` about every request, also the one that opens a web
socket; here the lock is asked first (`lock`). `open_server` tries the lock after it was fitted, and refuses to run
without it. Who connects and does not ask is cut off, and of too many such the one that came first.
"""

from __future__ import annotations

import http.client
import io
import logging
import socket
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from http import HTTPStatus
from typing import Any

import viser
import websockets.asyncio.server as websocket_server
from websockets.http11 import Request

from emulator.errors import LinkError
from emulator.view.access import Lock
from emulator.view.browser import prepared

OPEN_S = 5.0
"Until a connection has asked for something."
MOST_WAITING = 32
"Connections that have not asked yet."
GOODBYE_S = 1.0
"A browser that does not answer the goodbye for so long is cut off."
LONGEST_END_S = 30.0
_FITTING = threading.Lock()
PANEL = "lidaremu · "
"What the name of the main panel begins with."


class LocalServer(viser.ViserServer):
    """viser's server without its tunnel to the outside, and without its words at the end."""

    lock: Lock

    def stop(self) -> None:
        """End it. Its thread says on the standard output that it ended, later than viser waits when hosts are slow."""
        thread = self._websock_server._server_thread
        with redirect_stdout(io.StringIO()):
            super().stop()
            if thread is not None:
                thread.join(LONGEST_END_S)

    def request_share_url(self, verbose: bool = True) -> None:
        """Nothing leaves this machine."""


class LimitedConnection(websocket_server.ServerConnection):
    """A connection; of those that have not asked yet only so many are kept."""

    waiting: dict[LimitedConnection, None]
    "Of its server, in the order in which they came."

    def connection_made(self, transport: Any) -> None:
        """One more has come."""
        super().connection_made(transport)
        self.waiting[self] = None
        while len(self.waiting) > MOST_WAITING:
            first = next(iter(self.waiting))
            del self.waiting[first]
            first.transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        """It has gone."""
        self.waiting.pop(self, None)
        super().connection_lost(exc)

    async def handshake(self, *args: Any, **options: Any) -> None:
        """Until it has asked and was answered."""
        try:
            await super().handshake(*args, **options)
        finally:
            self.waiting.pop(self, None)


def open_server(
    host: str,
    port: int,
    token: str,
    title: str,
    further: Sequence[str] = (),
    refused: Callable[[str], None] = lambda host: None,
) -> LocalServer:
    """The page's server, listening. Raises `LinkError` when the address cannot be had, or the lock does not hold.

    `further`: hosts by which it may be reached besides, as with `--allow-host`; `refused` is informed of others.
    """
    be_free(host, port)
    lock = Lock(token, host, further)
    logging.getLogger("websockets.server").addFilter(_quiet)
    with _FITTING, _fitted(lock), redirect_stdout(io.StringIO()):  # it prints its address even when reported not to
        server = LocalServer(host=host, port=port, label=title, verbose=False)
    server.lock = lock
    lock.port = server.get_port()
    if any(_answers(host, lock.port, path) != HTTPStatus.FORBIDDEN for path in ("/", f"/{token}/")):
        server.stop()
        raise LinkError("this version of viser cannot restrict access; want viser 1.1, see extra `view`")
    lock.refused = refused
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
    limited = type("LimitedConnection", (LimitedConnection,), {"waiting": {}})

    def locked(*args: Any, process_request: Any = None, **options: Any) -> Any:
        def ask(connection: Any, request: Request) -> Any:
            reached = connection.local_address[0]
            return lock.ask(
                request,
                lambda asked: None if process_request is None else prepared(process_request(connection, asked)),
                reached,
            )

        fixed = {"create_connection": limited, "open_timeout": OPEN_S, "close_timeout": GOODBYE_S}
        return serve(*args, process_request=ask, **options | fixed)

    websocket_server.serve = locked  # type: ignore[assignment, misc]
    try:
        yield
    finally:
        websocket_server.serve = serve  # type: ignore[misc]


def _answers(host: str, port: int, path: str) -> int:
    """What others are answered: nobody has opened the name by which it asks."""
    reached = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)
    connection = http.client.HTTPConnection(reached, port, timeout=10.0)
    try:
        connection.request("GET", path, headers={"Host": "stranger.invalid"})
        return connection.getresponse().status
    except OSError as error:
        raise LinkError(f"the page does not answer on {reached}:{port}: {error}") from None
    finally:
        connection.close()
