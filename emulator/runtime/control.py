"""Orders to a running daemon: JSON-RPC 2.0, one object per line, on a Unix socket that its owner alone can open.

    {"jsonrpc": "2.0", "id": 1, "method": "status"}
    {"jsonrpc": "2.0", "id": 1, "result": {"clock": "real", "now_s": 12.5, ...}}

Belongs here: the server and its client. Not: what the methods do (orders), and the socket's place (control_socket). The
server waits in a thread of its own; what an order does is done by the run's own thread, between two steps. Garbage is
answered with an error. Clients are answered in turn, a line each, and all together take `SHARE` of a core. One is
answered no further while it leaves `MOST_UNREAD` unread; one that reads nothing for `DEAF_S`, or whose line is longer
than `LONGEST_LINE`, is disconnected. Of `MOST_CLIENTS` the one that has been silent longest makes room for the
next. The
run goes on in any case.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import selectors
import socket
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from concurrent.futures import TimeoutError as TookTooLong
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from emulator.config.budgets import TooMuch, loads_json
from emulator.errors import EmulatorError, LinkError
from emulator.process.clock import SystemClock, ThreadClock
from emulator.runtime.control_socket import Doorway, default_folder, new_path, running

LONGEST_LINE = 65_536
"Bytes of a request. Answers may be longer."
MOST_UNREAD = 1 << 18
MOST_UNREAD_ALL = 1 << 20
"Of all clients together: beyond that only who has read everything is answered."
MOST_CLIENTS = 16
SHARE, STOCK_NS = 0.1, 200_000_000
"Of one core, and processor time that may be spent ahead: what clients ask for is paid by the process that sends scans."
DEAREST_NS = 50_000_000
"Of one answer at most so much counts: an order that takes long holds up nobody for seconds."
UNREAD_S = 30.0
TICK_S = 1.0
LOOK_NS = 1_000_000_000
"So often it is seen whether the socket is still where clients look for it."
TIME_LIMIT_S = 60.0

__all__ = ["ControlServer", "Later", "Method", "OrderError", "ask", "default_folder", "new_path", "running"]

PARSE, INVALID, NO_METHOD, BAD_PARAMS, REFUSED = -32700, -32600, -32601, -32602, -32000


class OrderError(Exception):
    """An order that is not carried out; code and text of the answer."""

    def __init__(self, code: int, text: str) -> None:
        super().__init__(text)
        self.code = code


class Budget:
    """Processor time for answers, of all clients together; it fills with time."""

    def __init__(self, share: float = SHARE, stock_ns: int = STOCK_NS) -> None:
        self._share, self._stock_ns = share, stock_ns
        self._left_ns = float(stock_ns)
        self._at_ns = 0

    def wait_ns(self, now_ns: int) -> int:
        """How long nobody is answered; 0: somebody may be."""
        self._left_ns = min(self._stock_ns, self._left_ns + max(0, now_ns - self._at_ns) * self._share)
        self._at_ns = now_ns
        return 0 if self._left_ns > 0 else math.ceil((1 - self._left_ns) / self._share)

    def spend(self, took_ns: int) -> None:
        """An answer took so long."""
        self._left_ns -= min(took_ns, DEAREST_NS)


class Controlled(Protocol):
    """What a run offers: the methods of the list, each called in the run's thread."""

    def call(self, action: Callable[[], object]) -> Future[object]: ...


Method = Callable[[Mapping[str, Any]], object]


@dataclass(frozen=True)
class Later:
    """A result whose text is made in the control's thread, not in the run's; from what changes no more."""

    make: Callable[[], object]


@dataclass
class _Client:
    connection: socket.socket
    text: bytes = b""
    unread: bytes = b""
    read_at_ns: int = 0
    "When it last took some of what it had not read."
    spoke_at_ns: int = 0
    "When it last sent something, or came."
    wanted: int = selectors.EVENT_READ
    "What the selector watches it for; 0: it is not there."

    @property
    def asks(self) -> bool:
        """A whole line of it has not been answered."""
        return b"\n" in self.text


@dataclass
class ControlServer:
    """Serves a run's methods until closed."""

    path: Path
    methods: Mapping[str, Method]
    run: Controlled
    on_incident: Callable[[str, str], None] | None = None
    "Informed of the kind and text of incidents of the socket's place; called in the control's thread."
    limited: bool = True
    "Answers take no more than their share of the processor; not so where nothing can be late."
    _clients: dict[int, _Client] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._doorway = Doorway(self.path)
        self._bell, self._ring = socket.socketpair()
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._doorway.listener, selectors.EVENT_READ)
        self._selector.register(self._bell, selectors.EVENT_READ)
        self._closing = False
        self._clock = SystemClock()
        self._processor = ThreadClock()
        self._budget = Budget() if self.limited else Budget(share=1.0, stock_ns=1 << 60)
        self._cost_ns = 0
        "Of the order that was obeyed last, in the run's own thread."
        self._full = False
        "No descriptor is left for another client; looked at again with the next tick."
        self._look_ns = 0
        self._away = False
        "It has been reported that the socket's place is somebody else's."
        self._thread = threading.Thread(target=self._serve, name="lidaremu-control", daemon=True)
        self._thread.start()

    @property
    def url(self) -> str:
        """As reported in `ready`."""
        return f"unix:{self.path}"

    def close(self) -> None:
        """End the server and remove its socket; may be called twice."""
        if self._closing:
            return
        self._closing = True
        self._ring.send(b".")
        self._thread.join(2.0)
        for client in list(self._clients.values()):
            client.connection.close()
        for one in (self._doorway, self._bell, self._ring):
            one.close()
        self._selector.close()

    def _serve(self) -> None:
        while not self._closing:
            wait_ns = self._budget.wait_ns(self._clock.now_ns())
            asked = any(client.asks and self._may_be_answered(client) for client in self._clients.values())
            ready = self._selector.select(min(TICK_S, wait_ns * 1e-9) if asked else TICK_S)
            door = self._doorway.listener
            for key, mask in sorted(ready, key=lambda one: one[0].fileobj is door):  # who is here comes first
                if key.fileobj is door:
                    while self._accept():
                        pass
                elif key.fileobj is not self._bell:
                    client = self._clients.get(key.fd)
                    if client is not None:
                        self._attend(client, mask)
            self._answer_round()
            self._tick()

    def _tick(self) -> None:
        if self._full:
            self._full = False
            self._selector.register(self._doorway.listener, selectors.EVENT_READ)
        now_ns = self._clock.now_ns()
        if now_ns >= self._look_ns:
            self._look_ns = now_ns + LOOK_NS
            self._tend()
        for client in list(self._clients.values()):
            if client.unread and now_ns - client.read_at_ns > UNREAD_S * 1e9:
                self._hang_up(client)

    def _tend(self) -> None:
        """Listen at the path again when somebody took it away; what stands in its place alive is left alone."""
        if self._doorway.stands():
            return
        try:
            old = self._doorway.restore()
        except LinkError as error:
            if not self._away and self.on_incident is not None:
                kind = "link path taken" if os.path.lexists(self.path) else "link path gone"
                self.on_incident(kind, f"{error}; tried again every second")
            self._away = True
            return
        self._away = False
        with contextlib.suppress(KeyError):
            self._selector.unregister(old)
        old.close()
        self._full = False
        self._selector.register(self._doorway.listener, selectors.EVENT_READ)
        if self.on_incident is not None:
            self.on_incident("link restored", f"{self.path}: was removed; listening again")

    def _accept(self) -> bool:
        """Let one client in, or turn it away; whether there was one."""
        try:
            connection, _ = self._doorway.listener.accept()
        except BlockingIOError:
            return False
        except OSError:  # out of descriptors: the listener would be ready for ever
            self._selector.unregister(self._doorway.listener)
            self._full = True
            return False
        now_ns = self._clock.now_ns()
        if len(self._clients) >= MOST_CLIENTS:
            idle = [client for client in self._clients.values() if not _is_busy(client, now_ns)]
            if not idle:
                _farewell(connection, f"{MOST_CLIENTS} clients are connected already, all busy")
                return True
            silent = min(idle, key=lambda client: client.spoke_at_ns)
            self._hang_up(silent, f"longest idle of {MOST_CLIENTS} clients when a new one connected; disconnected")
        connection.setblocking(False)
        self._clients[connection.fileno()] = _Client(connection, spoke_at_ns=now_ns)
        self._selector.register(connection, selectors.EVENT_READ)
        return True

    def _attend(self, client: _Client, mask: int) -> None:
        try:
            if mask & selectors.EVENT_WRITE:
                self._flush(client)
            elif mask & selectors.EVENT_READ:
                data = client.connection.recv(LONGEST_LINE)
                if not data:
                    self._hang_up(client)
                    return
                client.text += data
                client.spoke_at_ns = self._clock.now_ns()
                if len(client.text) > LONGEST_LINE and not client.asks:
                    self._hang_up(client, f"a line longer than {LONGEST_LINE} bytes; disconnected")
                    return
            self._watch(client)
        except BlockingIOError:
            pass
        except OSError:
            self._hang_up(client)

    def _answer_round(self) -> None:
        """One line of everybody who has asked and may be answered, as far as the budget goes."""
        for number, client in list(self._clients.items()):
            if not client.asks or not self._may_be_answered(client):
                continue
            if self._budget.wait_ns(self._clock.now_ns()):
                return
            self._clients[number] = self._clients.pop(number)  # behind all others
            try:
                began_ns, self._cost_ns = self._processor.now_ns(), 0
                self._answer_line(client)
                self._budget.spend(self._processor.now_ns() - began_ns + self._cost_ns)
                self._watch(client)
            except OSError:
                self._hang_up(client)

    def _may_be_answered(self, client: _Client) -> bool:
        unread = len(client.unread)
        if unread and sum(len(one.unread) for one in self._clients.values()) > MOST_UNREAD_ALL:
            return False
        return unread <= MOST_UNREAD

    def _answer_line(self, client: _Client) -> None:
        line, _, client.text = client.text.partition(b"\n")
        answer = self.answer(line) if line.strip() else None
        if answer is not None:
            client.unread += json.dumps(answer).encode() + b"\n"
            self._flush(client)

    def _watch(self, client: _Client) -> None:
        """Hear it only while nothing of it waits: what it sends ahead stays in the kernel."""
        wanted = selectors.EVENT_WRITE if client.unread else 0
        if not client.asks:
            wanted |= selectors.EVENT_READ
        if wanted == client.wanted:
            return
        if not wanted:
            self._selector.unregister(client.connection)
        elif client.wanted:
            self._selector.modify(client.connection, wanted)
        else:
            self._selector.register(client.connection, wanted)
        client.wanted = wanted

    def _flush(self, client: _Client) -> None:
        if not client.unread:
            client.read_at_ns = self._clock.now_ns()
            return
        sent = 0
        view = memoryview(client.unread)
        with contextlib.suppress(BlockingIOError):
            while sent < len(view):
                sent += client.connection.send(view[sent:])
        if sent:
            client.read_at_ns = self._clock.now_ns()
            client.unread = bytes(view[sent:])

    def _hang_up(self, client: _Client, why: str = "") -> None:
        self._clients.pop(client.connection.fileno(), None)
        if client.wanted:
            self._selector.unregister(client.connection)
        if why:
            _farewell(client.connection, why)
        else:
            client.connection.close()

    def answer(self, line: bytes) -> dict[str, Any] | None:
        """The answer to one line; None to a notification."""
        number: Any = None
        try:
            request = _request(line)
            number = request.get("id")
            result = self._obey(request)
        except OrderError as error:
            return {"jsonrpc": "2.0", "id": number, "error": {"code": error.code, "message": str(error)}}
        return None if "id" not in request else {"jsonrpc": "2.0", "id": number, "result": result}

    def _obey(self, request: Mapping[str, Any]) -> object:
        method = self.methods.get(request["method"])
        if method is None:
            raise OrderError(NO_METHOD, f"method {request['method']!r}; want one of {', '.join(self.methods)}")
        params = request.get("params", {})
        if not isinstance(params, dict):
            raise OrderError(BAD_PARAMS, "params; want a table of names and values")

        def obeyed() -> object:
            began_ns = self._processor.now_ns()
            try:
                return method(params)
            finally:
                self._cost_ns = self._processor.now_ns() - began_ns

        done = self.run.call(obeyed)
        try:
            found = done.result(TIME_LIMIT_S)
            return found.make() if isinstance(found, Later) else found
        except OrderError:
            raise
        except TookTooLong:
            raise OrderError(REFUSED, f"no result within {TIME_LIMIT_S:g} s") from None
        except (EmulatorError, ValueError, TypeError, RuntimeError, ArithmeticError) as error:
            raise OrderError(REFUSED, str(error)) from None


def _is_busy(client: _Client, now_ns: int) -> bool:
    """Whether it has an answer to read, or a request on its way of which something came within `DEAF_S`."""
    if client.unread:
        return True
    try:
        sent = client.connection.recv(1, socket.MSG_PEEK)
    except BlockingIOError:
        sent = client.text
    except OSError:
        return False
    return bool(sent) and now_ns - client.spoke_at_ns <= UNREAD_S * 1e9


def _farewell(connection: socket.socket, why: str) -> None:
    """Say why, as far as the other end takes it, and close."""
    answer = {"jsonrpc": "2.0", "id": None, "error": {"code": REFUSED, "message": why}}
    with contextlib.suppress(OSError):
        connection.setblocking(False)
        connection.send(json.dumps(answer).encode() + b"\n")
    connection.close()


def _request(line: bytes) -> dict[str, Any]:
    try:
        request = loads_json(line)
    except TooMuch as error:
        raise OrderError(PARSE, str(error)) from None
    except ValueError:
        raise OrderError(PARSE, "not JSON; want one object per line") from None
    if not isinstance(request, dict) or not isinstance(request.get("method"), str):
        raise OrderError(INVALID, 'not a request; want {"jsonrpc": "2.0", "id": 1, "method": "status"}')
    return request


def ask(path: Path, method: str, params: Mapping[str, Any], time_limit_s: float = TIME_LIMIT_S + 5.0) -> object:
    """One order to a daemon; its result. `EmulatorError` has the daemon's own words; `LinkError`: none answers."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
        connection.settimeout(time_limit_s)
        try:
            connection.connect(str(path))
            request = {"jsonrpc": "2.0", "id": 1, "method": method, "params": dict(params)}
            with contextlib.suppress(BrokenPipeError):  # turned away: it has said why
                connection.sendall(json.dumps(request).encode() + b"\n")
            text = b""
            while not text.endswith(b"\n"):
                data = connection.recv(65_536)
                if not data:
                    raise LinkError(f"{path}: the daemon closed the connection")
                text += data
        except OSError as error:
            raise LinkError(f"{path}: no daemon answers: {error.strerror or error}") from None
    answer = json.loads(text)
    if "error" in answer:
        raise EmulatorError.of(answer["error"]["message"].split("\n"))
    return answer["result"]
