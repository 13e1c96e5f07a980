"""The hosts connected to one listening socket: who comes, who goes, what they send, what still waits for them.

One epoll descriptor stands for all of them, so whoever waits need not know how many there are; it is readable also
when a slow host can take more. Everything a host can do is bounded: connections, bytes read a call, bytes that wait.

A host that has closed its sending half is still sent to. It is gone when a send fails, or `LINGER_NS` after the last
thing sent to it. When all places are taken, the oldest connection that never sent a byte makes room; without one the
new host is turned away.
"""

from __future__ import annotations

import contextlib
import errno
import select
import socket
import struct
from collections import deque
from dataclasses import dataclass, field

from emulator.errors import LinkError
from emulator.transports.link import LinkStats, Received

MAX_HOSTS = 64
BACKLOG_LIMIT = 65_536
"Bytes that may wait for one host; while as much waits, further payloads for it are dropped whole."
SEND_BUFFER = 65_536
"Asked of the kernel (it takes twice as much): bounds how much a host that does not read finds when it reads again."
READ_SIZE = 16_384
READ_LIMIT = 262_144
"Bytes taken from all hosts in one call, so that a flood on one link does not delay the other sensors."
ACCEPTS_A_CALL = 32
LINGER_NS = 10_000_000_000
"Longer than the slowest reply of an LMS2xx (7 s): a host that half-closes behind its request still gets it."
NO_DESCRIPTOR_PAUSE_NS = 1_000_000_000
"How long nobody is accepted after the process ran out of descriptors."
KEEPALIVE = (("TCP_KEEPIDLE", 30), ("TCP_KEEPINTVL", 10), ("TCP_KEEPCNT", 3))
"""A host whose machine has vanished is noticed after a minute. No TCP_USER_TIMEOUT: it would also end a host that is
stopped in its debugger and does not read."""


@dataclass
class Host:
    """One connection."""

    number: int
    connection: socket.socket
    waiting: deque[memoryview] = field(default_factory=deque)
    backlog: int = 0
    "Bytes in `waiting`."
    spoke: bool = False
    half_closed_ns: int | None = None
    "When its sending half was closed, or when it was sent to last after that."
    broken: bool = False
    skipping: bool = False
    "The payload being sent in pieces is not for this host: it reads too slowly."
    mask: int = select.EPOLLIN


class Hosts:
    """Listens and keeps the connections. Numbers count up from 1 and are not used again."""

    def __init__(self, url: str, host: str, port: int, stats: LinkStats) -> None:
        self._stats = stats
        self._listener = _listen(url, host, port)
        name = self._listener.getsockname()
        self.address: tuple[str, int] = (name[0], name[1])
        self._epoll = select.epoll()
        self._epoll.register(self._listener, select.EPOLLIN)
        self._hosts: dict[int, Host] = {}
        self._by_fd: dict[int, Host] = {}
        self._accepted = 0
        self._pause_until_ns: int | None = None

    def fileno(self) -> int:
        """Readable when `poll` has something to do; -1 once closed."""
        return -1 if self._epoll.closed else self._epoll.fileno()

    def present(self) -> list[Host]:
        """Connections that can be sent to, oldest first."""
        return [host for host in self._hosts.values() if not host.broken]

    def find(self, number: int) -> Host | None:
        """The connection of that number, None when it has gone."""
        host = self._hosts.get(number)
        return None if host is None or host.broken else host

    def poll(self, now_ns: int) -> list[Received]:
        """Let hosts come and go, read what they sent, send what waited for them."""
        if self._epoll.closed:
            return []
        events: list[Received] = []
        budget = READ_LIMIT
        for fd, mask in self._epoll.poll(0):
            host = self._by_fd.get(fd)
            if fd == self._listener.fileno():
                self._accept(now_ns, events)
            elif host is not None:
                if mask & select.EPOLLOUT:
                    self._send_waiting(host, now_ns)
                if budget > 0 or host.broken:
                    budget -= self._read(host, mask, now_ns, events)
        self._end_lingering(now_ns, events)
        return events

    def next_ns(self) -> int | None:
        """When `poll` has something to do even if nothing happens."""
        since = [host.half_closed_ns for host in self._hosts.values() if host.half_closed_ns is not None]
        wakes = [] if self._pause_until_ns is None else [self._pause_until_ns]
        if since:
            wakes.append(min(since) + LINGER_NS)
        return min(wakes, default=None)

    def send(self, host: Host, data: bytes, now_ns: int) -> None:
        """Send now what the kernel takes; the rest waits its turn. Errors are noticed by the next `poll`."""
        if host.broken:
            return
        host.waiting.append(memoryview(data))
        host.backlog += len(data)
        self._send_waiting(host, now_ns)

    def close(self) -> None:
        """Close all connections and the listening socket; may be called twice."""
        for host in list(self._hosts.values()):
            self._forget(host)
        self._listener.close()
        self._epoll.close()

    def _accept(self, now_ns: int, events: list[Received]) -> None:
        for _ in range(ACCEPTS_A_CALL):
            try:
                connection, _address = self._listener.accept()
            except OSError as error:
                if error.errno in (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM):
                    self._stats.hosts_refused += 1
                    self._pause_until_ns = now_ns + NO_DESCRIPTOR_PAUSE_NS
                    self._epoll.modify(self._listener, 0)
                return  # nobody else waits, or this one has given up already
            if len(self._hosts) >= MAX_HOSTS and not self._make_room(events):
                _reset(connection)
                self._stats.hosts_refused += 1
                continue
            _prepare(connection)
            self._accepted += 1
            host = Host(self._accepted, connection)
            self._hosts[host.number] = self._by_fd[connection.fileno()] = host
            self._epoll.register(connection, host.mask)
            events.append(Received(host.number, opened=True))

    def _make_room(self, events: list[Received]) -> bool:
        silent = next((host for host in self._hosts.values() if not host.spoke and not _has_unread(host)), None)
        if silent is None:
            return False
        self._stats.hosts_refused += 1
        self._end(silent, events)
        return True

    def _read(self, host: Host, mask: int, now_ns: int, events: list[Received]) -> int:
        try:
            data = b"" if host.broken else host.connection.recv(READ_SIZE)
        except BlockingIOError:
            return 0
        except OSError:
            host.broken = True
            data = b""
        if data:
            host.spoke = True
            self._stats.bytes_in += len(data)
            events.append(Received(host.number, data))
        elif host.broken or mask & (select.EPOLLHUP | select.EPOLLERR):
            self._end(host, events)
        elif host.half_closed_ns is None:
            host.half_closed_ns = now_ns
            self._watch(host)
        return len(data)

    def _send_waiting(self, host: Host, now_ns: int) -> None:
        try:
            while host.waiting:
                sent = host.connection.send(host.waiting[0])
                self._stats.bytes_out += sent
                host.backlog -= sent
                if host.half_closed_ns is not None:
                    host.half_closed_ns = now_ns
                if sent < len(host.waiting[0]):
                    host.waiting[0] = host.waiting[0][sent:]
                    break
                host.waiting.popleft()
        except BlockingIOError:
            pass
        except OSError:
            host.broken = True  # the connection stays watched: `poll` finds it and tells
            self._stats.bytes_lost += host.backlog
            host.waiting.clear()
            host.backlog = 0
        self._watch(host)

    def _watch(self, host: Host) -> None:
        """Wait for what the host may do next. A broken connection reports itself whatever the mask."""
        reading = select.EPOLLIN if host.half_closed_ns is None else 0
        mask = reading | (select.EPOLLOUT if host.waiting or host.broken else 0)
        if mask != host.mask:
            host.mask = mask
            self._epoll.modify(host.connection, mask)

    def _end_lingering(self, now_ns: int, events: list[Received]) -> None:
        if self._pause_until_ns is not None and now_ns >= self._pause_until_ns:
            self._pause_until_ns = None
            self._epoll.modify(self._listener, select.EPOLLIN)
        for host in list(self._hosts.values()):
            if host.half_closed_ns is not None and now_ns >= host.half_closed_ns + LINGER_NS:
                self._end(host, events)

    def _end(self, host: Host, events: list[Received]) -> None:
        self._stats.bytes_lost += host.backlog
        self._forget(host)
        events.append(Received(host.number, closed=True))

    def _forget(self, host: Host) -> None:
        del self._hosts[host.number]
        del self._by_fd[host.connection.fileno()]
        self._epoll.unregister(host.connection)
        host.connection.close()


def _listen(url: str, host: str, port: int) -> socket.socket:
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
    except (OSError, UnicodeError) as error:
        raise LinkError(f"{url}: host {host!r} not found: {error}") from None
    listener = socket.socket(family, kind, protocol)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
        listener.bind(address)
        listener.listen(128)
        listener.setblocking(False)
    except OSError as error:
        listener.close()
        raise LinkError(f"{url}: {_cause(error, host, port)}") from None
    return listener


def _cause(error: OSError, host: str, port: int) -> str:
    if error.errno == errno.EADDRINUSE:
        return f"port {port} is in use; want a free one, or 0 for any"
    if error.errno == errno.EADDRNOTAVAIL:
        return f"{host} is no address of this machine; want 127.0.0.1, * or one of its own"
    if error.errno == errno.EACCES:
        return f"port {port} needs more rights than this user has; want one above 1023"
    return f"cannot listen: {error.strerror}"


def _prepare(connection: socket.socket) -> None:
    connection.setblocking(False)
    with contextlib.suppress(OSError):  # a host that has reset already: the first read tells
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for name, value in KEEPALIVE:
            if hasattr(socket, name):
                connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)


def _has_unread(host: Host) -> bool:
    """Whether something has come that was not read yet: hosts of one crowd are accepted before any of them is heard."""
    try:
        return bool(host.connection.recv(1, socket.MSG_PEEK))
    except OSError:
        return False


def _reset(connection: socket.socket) -> None:
    """Close at once: the host sees a reset, and nothing of it stays in our kernel."""
    with contextlib.suppress(OSError):
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    connection.close()
