"""A sensor on TCP: its own network interface (`TcpStream`), or its serial line behind a device server (`TcpLine`).

TcpStream: connections are numbered and reported to the session; each payload is one `send`, without Nagle's delay,
to one
host or to all; nothing is paced. While a host reads too slowly, payloads for it are dropped whole and counted; what has
been begun is always finished, so nothing is cut or interleaved.

TcpLine: all connected hosts share the one line, as on a device server that allows several: each hears all that the
device says, at the line's pace, and what they send arrives in the order in which it came, mixed where they talk at
once. The device knows nothing of connections. Without a host, what leaves is lost; a host that connects in the middle
of a telegram gets the rest of it.
"""

from __future__ import annotations

from collections import deque

from emulator.transports.intake import STREAM_BURST, STREAM_BYTES_S, Intake
from emulator.transports.link import Link, Received
from emulator.transports.pacing import QUEUE_LIMIT, PacedLine
from emulator.transports.tcp_hosts import Host, Hosts
from emulator.transports.urls import host_and_port, join_host_port, parse_url
from protocols.session import LinkKind


def check_link_tcp(url: str) -> None:
    """Judge the text of a `tcp:` link; raises ValueError."""
    parts = parse_url(url)
    parts.allow()
    host_and_port(url, parts.target)


def open_link_tcp(url: str, *, serial_line: bool) -> Link:
    """Listen where `tcp:HOST:PORT` says; raises LinkError."""
    host, port = host_and_port(url, parse_url(url).target)
    return TcpLine(url, host, port) if serial_line else TcpStream(url, host, port)


class _TcpLink(Link):
    def __init__(self, url: str, host: str, port: int) -> None:
        super().__init__()
        self._hosts = Hosts(url, host, port, self.stats, Intake(STREAM_BYTES_S, STREAM_BURST))

    @property
    def url(self) -> str:
        return f"tcp:{join_host_port(*self._hosts.address)}"

    def filenos(self) -> tuple[int, ...]:
        number = self._hosts.fileno()
        return () if number < 0 or self._hosts.intake.closed else (number,)

    def held(self) -> int:
        return sum(host.backlog for host in self._hosts.present())

    def has_host(self) -> bool:
        return bool(self._hosts.present())

    def close(self) -> None:
        self._hosts.close()

    def unplug(self) -> None:
        self._hosts.refuse(True)
        self._hosts.reset_all()

    def plug(self) -> None:
        self._hosts.refuse(False)

    def reset_hosts(self) -> int:
        return self._hosts.reset_all()

    def refuse_hosts(self, refuse: bool) -> None:
        self._hosts.refuse(refuse)

    def _earliest(self, wake_ns: int | None) -> int | None:
        return min((wake for wake in (wake_ns, self._hosts.next_ns()) if wake is not None), default=None)


class TcpStream(_TcpLink):
    """The sensor's own TCP port."""

    kind = LinkKind.STREAM

    def __init__(self, url: str, host: str, port: int) -> None:
        super().__init__(url, host, port)
        self._queue: deque[tuple[int, bytes, int | None]] = deque()
        self._queued = 0

    def receive(self, now_ns: int) -> list[Received]:
        return self._hosts.poll(now_ns)

    def send(self, payload: bytes, due_ns: int, peer: int | None = None, line_speed: int | None = None) -> None:
        if not payload or self._hosts.fileno() < 0:
            return
        if self._queued and self._queued + len(payload) > QUEUE_LIMIT:
            self.stats.payloads_dropped += 1
            return
        self._queue.append((due_ns, payload, peer))
        self._queued += len(payload)

    def hang_up(self, due_ns: int, peer: int | None = None) -> None:
        self._queue.append((due_ns, b"", peer))

    def flush(self, now_ns: int) -> int | None:
        while self._queue and self._queue[0][0] <= now_ns:
            due_ns, payload, peer = self._queue.popleft()
            self._queued -= len(payload)
            hosts = self._hosts.present() if peer is None else [self._hosts.find(peer)]
            if not payload:
                for host in hosts:
                    if host is not None:
                        self._hosts.hang_up(host, now_ns)
                continue
            given = [self._give(host, payload, now_ns) for host in hosts if host is not None]
            if given and not any(given):
                self.on_given_up(payload)
            if not any(hosts):
                self.stats.bytes_lost += len(payload)
            self.stats.note_left(due_ns, now_ns)
        return self._earliest(self._queue[0][0] if self._queue else None)

    def _give(self, host: Host, payload: bytes, now_ns: int) -> bool:
        """Whether it was not given up."""
        if not (self.hold or self._hosts.takes(host)):
            self.stats.payloads_dropped += 1
            return False
        self._hosts.send(host, payload, now_ns)
        return True

    def clear(self) -> int:
        forgotten, self._queued = self._queued, 0
        self._queue.clear()
        return forgotten

    def abandon_hosts(self) -> int:
        return self._hosts.abandon_all()

    def revive(self) -> None:
        self._hosts.revive()


class TcpLine(_TcpLink):
    """A serial device server's port in front of the sensor's line."""

    kind = LinkKind.SERIAL

    def __init__(self, url: str, host: str, port: int) -> None:
        super().__init__(url, host, port)
        self._line = PacedLine()
        self._waiting: deque[bytes] = deque()
        "Payloads that have not begun to leave."

    def receive(self, now_ns: int) -> list[Received]:
        self.flush(now_ns)
        data = b"".join(event.data for event in self._hosts.poll(now_ns))
        return [Received(0, data)] if data else []

    def send(self, payload: bytes, due_ns: int, peer: int | None = None, line_speed: int | None = None) -> None:
        if self._hosts.fileno() < 0:
            return
        if not self._line.put(payload, due_ns, line_speed):
            self.stats.payloads_dropped += 1
        elif payload:
            self._waiting.append(payload)

    def cut(self, now_ns: int) -> None:
        for _ in range(min(self._line.cut(now_ns), len(self._waiting))):
            self._waiting.pop()

    def flush(self, now_ns: int) -> int | None:
        if self._hosts.fileno() < 0:
            return None
        for left in self._line.take(now_ns):
            hosts = self._hosts.present()
            payload = self._waiting.popleft() if left.starts and self._waiting else b""
            for host in hosts:
                if left.starts:
                    host.skipping = not (self.hold or self._hosts.takes(host))
                    self.stats.payloads_dropped += host.skipping
                if not host.skipping:
                    self._hosts.send(host, left.data, now_ns)
            if payload and hosts and all(host.skipping for host in hosts):
                self.on_given_up(payload)
            if not hosts:
                self.stats.bytes_lost += len(left.data)
            if left.ends:
                self.stats.note_left(left.last_ns, now_ns)
        return self._earliest(self._line.next_ns(now_ns))

    @property
    def speed(self) -> int | None:
        return self._line.speed

    def set_speed(self, baud: int | None) -> None:
        self._line.set_speed(baud)

    def clear(self) -> int:
        self._waiting.clear()
        return self._line.clear()
