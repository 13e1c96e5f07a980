"""The hosts connected to one listening socket: who comes, who goes, what they send, what still waits for them.

One epoll descriptor stands for all of them, so whoever waits need not know how many there are; it is readable also
when a slow host can take more. Everything a host can do is bounded: connections, bytes read a call, bytes that wait.

A host that has closed its sending half is still sent to. It is gone when a send fails, or `LINGER_NS` after the last
thing sent to it. When all places are taken, one that has closed its half and has been sent everything makes room, else
the oldest connection that never sent a byte; without one the new host is turned away.
"""

from __future__ import annotations

import contextlib
import errno
import select
import socket
import struct
from dataclasses import dataclass, field

from emulator.errors import LinkError
from emulator.transports.intake import Intake
from emulator.transports.link import LinkStats, Received

MAX_HOSTS = 64
BACKLOG_LIMIT = 65_536
"Bytes that may wait for one host; while as much waits, further payloads for it are dropped whole."
BACKLOG_TOTAL = 1_048_576
"Bytes that may wait for all hosts of a socket: who reads slowly shares it with the others that do."
SEND_BUFFER = 65_536
"Asked of the kernel (it takes twice as much): bounds how much a host that does not read finds when it reads again."
READ_SIZE = 16_384
ACCEPTS_A_CALL = 8
ACCEPT_BYTES = 256
"What a new connection takes of the intake: a flood of connections is no more work than one of bytes."
LEAST_SHARE = 256
"Bytes of one host that are read at once, however many there are."
LINGER_NS = 10_000_000_000
"Longer than the slowest reply of an LMS2xx (7 s): a host that half-closes behind its request still gets it."
FLOOD_NS = 10_000_000_000
"""A host that has written faster than it is read for so long, or has read nothing of what waits for it, loses its place
when somebody else wants it."""
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
    waiting: bytearray = field(default_factory=bytearray)
    "What the kernel has not taken yet."
    unread_since_ns: int | None = None
    "Since when it has taken nothing of what waits for it."
    paused: bool = False
    "What it sends stays in the kernel."
    spoke: bool = False
    flooding_ns: int | None = None
    "Since when more of it has waited than was read; None: it has been read to the end."
    half_closed_ns: int | None = None
    "When its sending half was closed, or when it was sent to last after that."
    leaves: bool = False
    "The device ends the connection when nothing waits for it any more."
    broken: bool = False
    skipping: bool = False
    "The payload being sent in pieces is not for this host: it reads too slowly."
    mask: int = select.EPOLLIN

    @property
    def backlog(self) -> int:
        """Bytes that wait for it."""
        return len(self.waiting)


class Hosts:
    """Listens and keeps the connections. Numbers count up from 1 and are not used again."""

    def __init__(self, url: str, host: str, port: int, stats: LinkStats, intake: Intake) -> None:
        self._stats = stats
        self._url = url
        self._listener = _listen(url, host, port)
        name = self._listener.getsockname()
        self.address: tuple[str, int] = (name[0], name[1])
        self._epoll = select.epoll()
        self._epoll.register(self._listener, select.EPOLLIN)
        self._hosts: dict[int, Host] = {}
        self._by_fd: dict[int, Host] = {}
        self._accepted = 0
        self._pause_until_ns: int | None = None
        self.intake = intake
        "While it is closed, nobody needs to wait for the descriptor: `next_ns` says when."
        self._read_last = -1
        "Descriptor of the host that was read last."
        self._slow: set[int] = set()
        "Numbers of hosts for which something waits."
        self._gone: list[int] = []
        "Numbers of connections that were reset, still to be reported."
        self._orphans: dict[int, socket.socket] = {}
        "Connections of a network stack that has died."
        self._refusals = 0
        "How many want that nobody connects."

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

    def ends(self, number: int) -> bool:
        """Whether a connection has gone, or has closed its sending half and is only sent to."""
        host = self.find(number)
        return host is None or host.half_closed_ns is not None

    def poll(self, now_ns: int) -> list[Received]:
        """Let hosts come and go, read what they sent, send what waited for them."""
        if self._epoll.closed:
            return []
        events: list[Received] = [Received(number, closed=True) for number in self._gone]
        self._gone.clear()
        budget = self.intake.room(now_ns)
        ready = self._epoll.poll(0)
        listener = self._listener.fileno()
        # who wants to come is first, then whoever comes behind the host that was read last: none can starve the others
        ready.sort(key=lambda one: (one[0] != listener, one[0] <= self._read_last, one[0]))
        share = max(LEAST_SHARE, budget // max(1, sum(fd in self._by_fd for fd, _ in ready)))
        for fd, mask in ready:
            host = self._by_fd.get(fd)
            if fd == listener:
                if budget > 0:
                    budget -= self._accept(now_ns, events)
            elif fd in self._orphans:
                orphan = self._orphans.pop(fd)
                self._epoll.unregister(fd)
                _reset(orphan)
            elif host is not None:
                if mask & select.EPOLLOUT:
                    self._send_waiting(host, now_ns)
                if host.broken or (budget > 0 and (not host.paused or mask & (select.EPOLLHUP | select.EPOLLERR))):
                    budget -= self._read(host, mask, now_ns, events, max(1, min(budget, share)))
                    self._read_last = fd
        self._end_lingering(now_ns, events)
        return events

    def next_ns(self) -> int | None:
        """When `poll` has something to do even if nothing happens."""
        since = [host.half_closed_ns for host in self._hosts.values() if host.half_closed_ns is not None]
        wakes = [] if self._pause_until_ns is None else [self._pause_until_ns]
        opens_ns = self.intake.next_ns()
        if opens_ns is not None:
            wakes.append(opens_ns)
        if since:
            wakes.append(min(since) + LINGER_NS)
        return min(wakes, default=None)

    def send(self, host: Host, data: bytes, now_ns: int) -> None:
        """Send now what the kernel takes; the rest waits its turn. Errors are noticed by the next `poll`."""
        if host.broken or host.leaves:
            return
        if host.waiting:
            host.waiting += data  # the kernel says when it takes more
            return
        sent = self._hand_over(host, data, now_ns)
        if sent < len(data) and not host.broken:
            host.waiting += memoryview(data)[sent:]
            host.unread_since_ns = now_ns
            self._slow.add(host.number)
        self._watch(host)

    def hang_up(self, host: Host, now_ns: int) -> None:
        """End the connection behind what waits for it; what the host sends from now on is not read."""
        host.leaves = True
        if not host.waiting and not host.broken:
            with contextlib.suppress(OSError):  # it has gone: `poll` reports that
                host.connection.shutdown(socket.SHUT_WR)
            host.half_closed_ns = now_ns
            self._watch(host)

    def takes(self, host: Host) -> bool:
        """Whether another payload may wait for it."""
        if not host.waiting:
            return True
        total = sum(self._hosts[number].backlog for number in self._slow)
        return total < BACKLOG_TOTAL and host.backlog < min(BACKLOG_LIMIT, BACKLOG_TOTAL // len(self._slow))

    def pause(self, host: Host, paused: bool) -> None:
        """Leave what it sends in the kernel, where it holds up its sender; or read it again."""
        if host.paused != paused:
            host.paused = paused
            self._watch(host)

    def reset_all(self) -> int:
        """Reset every connection; the next `poll` reports them. How many it were."""
        hosts = list(self._hosts.values())
        for host in hosts:
            self._stats.bytes_lost += host.backlog
            self._gone.append(host.number)
            self._leave(host)
            _reset(host.connection)
        return len(hosts)

    def refuse(self, refuse: bool) -> None:
        """Listen no more, or again on the same port; `LinkError` when somebody has taken it."""
        if self._epoll.closed:
            return
        before, self._refusals = self._refusals, max(0, self._refusals + (1 if refuse else -1))
        if bool(before) == bool(self._refusals):
            return
        if refuse:
            self._epoll.unregister(self._listener)
            self._listener.close()
            self._pause_until_ns = None
            return
        self._listener = _listen(self._url, *self.address)
        self._epoll.register(self._listener, select.EPOLLIN)

    def abandon_all(self) -> int:
        """Leave connections open and silent, reported to nobody; nobody can connect. How many it were."""
        hosts = list(self._hosts.values())
        for host in hosts:
            self._stats.bytes_lost += host.backlog
            self._leave(host)
            self._orphans[host.connection.fileno()] = host.connection
        self.refuse(True)
        return len(hosts)

    def revive(self) -> None:
        """Listen again; a connection that was abandoned is reset when its host next says something, or leaves."""
        self.refuse(False)
        for fd in self._orphans:
            with contextlib.suppress(FileExistsError):  # revived once already
                self._epoll.register(fd, select.EPOLLIN)

    def close(self) -> None:
        """Close all connections and the listening socket; may be called twice."""
        for host in list(self._hosts.values()):
            self._forget(host)
        for orphan in self._orphans.values():
            orphan.close()
        self._orphans.clear()
        self._listener.close()
        self._epoll.close()

    def _accept(self, now_ns: int, events: list[Received]) -> int:
        """Take in who waits; what that takes of the intake."""
        for number in range(ACCEPTS_A_CALL):
            try:
                connection, address = self._listener.accept()
            except OSError as error:
                if error.errno in (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM):
                    self._stats.hosts_refused += 1
                    self._pause_until_ns = now_ns + NO_DESCRIPTOR_PAUSE_NS
                    self._epoll.modify(self._listener, 0)
                return number * ACCEPT_BYTES  # nobody else waits, or this one has given up already
            self.intake.take(ACCEPT_BYTES)
            if len(self._hosts) >= MAX_HOSTS and not self._make_room(now_ns, events):
                _reset(connection)
                self._stats.hosts_refused += 1
                continue
            _prepare(connection)
            self._accepted += 1
            host = Host(self._accepted, connection)
            self._hosts[host.number] = self._by_fd[connection.fileno()] = host
            self._epoll.register(connection, host.mask)
            events.append(Received(host.number, opened=True, host=(str(address[0]), int(address[1]))))
        return ACCEPTS_A_CALL * ACCEPT_BYTES

    def _make_room(self, now_ns: int, events: list[Received]) -> bool:
        """Whether one has lost its place: the one that hung up first, with nothing left for it; else the oldest that
        never spoke; else who has flooded or been without input for longest.

        What a flood left in the kernel is read for minutes after its programs are gone.
        """
        hung_up = {host.half_closed_ns: host for host in self._hosts.values() if not host.waiting}
        if left := [at_ns for at_ns in hung_up if at_ns is not None]:  # clients of HTTP: a connection per request
            self._end(hung_up[min(left)], events)
            return True
        silent = next((host for host in self._hosts.values() if not host.spoke and not _has_unread(host)), None)
        if silent is not None:
            self._end(silent, events)
        else:
            since = {host.number: _bad_since_ns(host) for host in self._hosts.values()}
            bad = ((ns, number) for number, ns in since.items() if ns is not None)
            worst_ns, number = min(bad, default=(now_ns, 0))
            if now_ns - worst_ns < FLOOD_NS:
                return False
            worst = self._hosts[number]
            self._stats.bytes_lost += worst.backlog
            self._leave(worst)
            _reset(worst.connection)
            events.append(Received(worst.number, closed=True))
        self._stats.hosts_refused += 1
        return True

    def _read(self, host: Host, mask: int, now_ns: int, events: list[Received], most: int) -> int:
        most = min(most, READ_SIZE)
        try:
            data = b"" if host.broken else host.connection.recv(most)
        except BlockingIOError:
            return 0
        except OSError:
            host.broken = True
            data = b""
        if data:
            host.spoke = True
            if len(data) < most:
                host.flooding_ns = None
            elif host.flooding_ns is None:
                host.flooding_ns = now_ns
            self._stats.bytes_in += len(data)
            self.intake.take(len(data))
            events.append(Received(host.number, data))
        elif host.broken or mask & (select.EPOLLHUP | select.EPOLLERR):
            self._end(host, events)
        elif host.half_closed_ns is None:
            host.half_closed_ns = now_ns
            self._watch(host)
        return len(data)

    def _send_waiting(self, host: Host, now_ns: int) -> None:
        if host.waiting:
            if sent := self._hand_over(host, host.waiting, now_ns):
                del host.waiting[:sent]
                host.unread_since_ns = now_ns
        if not host.waiting:
            host.unread_since_ns = None
            self._slow.discard(host.number)
            if host.leaves:
                self.hang_up(host, now_ns)
        self._watch(host)

    def _hand_over(self, host: Host, data: bytes | bytearray, now_ns: int) -> int:
        """Bytes that the kernel has taken."""
        try:
            sent = host.connection.send(data)
        except BlockingIOError:
            return 0
        except OSError:
            host.broken = True  # the connection stays watched: `poll` finds it and reports
            self._stats.bytes_lost += len(data)
            host.waiting.clear()
            return 0
        self._stats.bytes_out += sent
        if host.half_closed_ns is not None:
            host.half_closed_ns = now_ns
        return sent

    def _watch(self, host: Host) -> None:
        """Wait for what the host may do next. A broken connection reports itself whatever the mask."""
        reading = select.EPOLLIN if host.half_closed_ns is None and not host.paused else 0
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
        self._leave(host)
        host.connection.close()

    def _leave(self, host: Host) -> None:
        self._slow.discard(host.number)
        del self._hosts[host.number]
        del self._by_fd[host.connection.fileno()]
        self._epoll.unregister(host.connection)


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
    with contextlib.suppress(OSError):  # a host that has reset already: the first read reports
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for name, value in KEEPALIVE:
            if hasattr(socket, name):
                connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)


def _bad_since_ns(host: Host) -> int | None:
    """Since when it floods, or is without input; None: it does not and is not."""
    return min((ns for ns in (host.flooding_ns, host.unread_since_ns) if ns is not None), default=None)


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
