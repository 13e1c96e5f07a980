"""A sensor that sends datagrams, and may be sent some.

Each payload is one datagram, sent when it is due; with `serial_line` when its last bit has left the paced line, as a
device server in UDP mode packs it. Without `listen` nothing is received and the sending port is any. Multicast leaves
by the interface given with `interface=` (an address of this machine), otherwise by the route the kernel has for it; it
travels `ttl` networks far, 1 without it.
"""

from __future__ import annotations

import contextlib
import ipaddress
import socket
from collections import OrderedDict, deque
from collections.abc import Callable
from typing import Any

from emulator.errors import LinkError
from emulator.transports.intake import STREAM_BURST, STREAM_BYTES_S, Intake
from emulator.transports.link import Link, Received
from emulator.transports.pacing import PacedLine
from emulator.transports.urls import host_and_port, join_host_port, parse_url
from protocols.session import LinkKind

DATAGRAM_LIMIT = 65_535
DATAGRAMS_A_CALL = 256
QUEUE_BYTES = 4_194_304
"That may wait: of the fastest sensor, 8 Mbyte/s, what has come due while the sender stood still for half a second."
DATAGRAM_COST = 64
"Bytes of the intake that the shortest datagram takes."
RECEIVE_ERRORS = {socket.AF_INET: (socket.IPPROTO_IP, 11), socket.AF_INET6: (socket.IPPROTO_IPV6, 25)}
"IP_RECVERR and IPV6_RECVERR of Linux (ip(7)): a socket hears of ports that are closed at the host."
PEERS_KEPT = 64
"Senders whose address is remembered for a reply; the one unheard longest is forgotten."


def check_link_udp(url: str) -> None:
    """Judge the text of a `udp:` link; raises ValueError."""
    parts = parse_url(url)
    parts.allow("listen", "ttl", "interface")
    host_and_port(url, parts.target, lowest=1)
    _listen_at(url, parts.options.get("listen"))
    parts.number("ttl", 1, 0, 255)
    if "interface" in parts.options:
        try:
            ipaddress.IPv4Address(parts.options["interface"])
        except ValueError:
            given = parts.options["interface"]
            raise ValueError(f"{url!r}: interface={given}; want an IPv4 address of this machine") from None


def _listen_at(url: str, listen: str | None) -> tuple[str, int] | None:
    if listen is None:
        return None
    return host_and_port(url, listen if ":" in listen else f":{listen}")


def open_link_udp(url: str, *, serial_line: bool) -> UdpSender:
    """Send where `udp:HOST:PORT?...` says; raises LinkError."""
    parts = parse_url(url)
    ttl = parts.number("ttl", 1, 0, 255)
    there = host_and_port(url, parts.target, lowest=1)
    listen = _listen_at(url, parts.options.get("listen"))
    return UdpSender(url, there, listen, ttl, parts.options.get("interface"), serial_line)


class UdpSender(Link):
    """Datagrams to one place, and back to whoever sent some."""

    def __init__(
        self,
        url: str,
        there: tuple[str, int],
        listen: tuple[str, int] | None,
        ttl: int,
        interface: str | None,
        serial_line: bool,
    ) -> None:
        super().__init__()
        self.kind = LinkKind.SERIAL if serial_line else LinkKind.DATAGRAM
        self._line = PacedLine(whole=True) if serial_line else None
        self._queue: deque[tuple[int, bytes, int | tuple[str, int] | None]] = deque()
        self._queued = 0
        self._intake = Intake(STREAM_BYTES_S, STREAM_BURST)
        self._senders: OrderedDict[int, tuple[str, int]] = OrderedDict()
        self._undelivered: Callable[[bool], None] | None = None
        self._open = True
        try:
            family, _, _, _, address = socket.getaddrinfo(*there, type=socket.SOCK_DGRAM)[0]
        except (OSError, UnicodeError) as error:
            raise LinkError(f"{url}: host {there[0]!r} not found: {error}") from None
        self._there = address
        self._out = socket.socket(family, socket.SOCK_DGRAM)
        self._in: socket.socket | None = None
        try:
            self._prepare(family, ttl, interface)
            if listen is not None:
                self._listen(family, listen)
        except OSError as error:
            self.close()
            raise LinkError(f"{url}: {error.strerror or error}") from None

    def _prepare(self, family: int, ttl: int, interface: str | None) -> None:
        self._out.setblocking(False)
        self._out.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        if family == socket.AF_INET6:
            self._out.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_MULTICAST_HOPS, ttl)
            return
        self._out.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, ttl)
        if interface is not None:
            self._out.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(interface))

    def _listen(self, family: int, listen: tuple[str, int]) -> None:
        """Listen, and send from the listening port where the addresses allow it: many hosts answer to it."""
        address = socket.getaddrinfo(*listen, family=family, type=socket.SOCK_DGRAM)[0][4]
        here, there = ipaddress.ip_address(address[0]), ipaddress.ip_address(str(self._there[0]).partition("%")[0])
        receiver = self._out if not here.is_loopback or there.is_loopback else socket.socket(family, socket.SOCK_DGRAM)
        self._in = receiver
        receiver.setblocking(False)
        receiver.bind(address)

    def tell_undelivered(self, to: Callable[[bool], None]) -> None:
        level, option = RECEIVE_ERRORS[self._out.family]
        try:
            self._out.setsockopt(level, option, 1)
        except OSError:  # pragma: no cover - of Linux alone; elsewhere only what cannot be sent is told
            pass
        self._undelivered = to

    def _forget_errors(self) -> None:
        """Empty the queue of errors, else the socket stays ready for ever."""
        if self._undelivered is not None:
            with contextlib.suppress(OSError):
                while True:
                    self._out.recvmsg(0, 0, socket.MSG_ERRQUEUE)

    @property
    def url(self) -> str:
        place = f"udp:{join_host_port(str(self._there[0]), int(self._there[1]))}"
        if self._in is None or not self._open:
            return place
        name = self._in.getsockname()
        return f"{place}?listen={join_host_port(name[0], name[1])}"

    def filenos(self) -> tuple[int, ...]:
        return () if self._in is None or not self._open or self._intake.closed else (self._in.fileno(),)

    def receive(self, now_ns: int) -> list[Received]:
        received: list[Received] = []
        if not self._open:
            return received
        if self._line is not None:
            self.flush(now_ns)
        for _ in range(DATAGRAMS_A_CALL if self._in is not None else 0):
            if not self._intake.room(now_ns):
                break
            try:
                data, sender = self._in.recvfrom(DATAGRAM_LIMIT)  # type: ignore[union-attr]
            except BlockingIOError:
                break
            except OSError:  # what an earlier datagram of ours met on its way
                self._met()
                continue
            self._remember(sender[1], sender)
            self.stats.bytes_in += len(data)
            self._intake.take(max(DATAGRAM_COST, len(data)))
            received.append(Received(0 if self._line is not None else sender[1], data))
        return received

    def _remember(self, port: int, sender: tuple[str, int]) -> None:
        self._senders[port] = sender
        self._senders.move_to_end(port)
        while len(self._senders) > PEERS_KEPT:
            self._senders.popitem(last=False)

    def send(self, payload: bytes, due_ns: int, peer: int | None = None, line_speed: int | None = None) -> None:
        if not self._open:
            return
        if self._line is not None:
            if not self._line.put(payload, due_ns, line_speed):
                self.stats.payloads_dropped += 1
        elif self._queued and self._queued + len(payload) > QUEUE_BYTES:
            self.stats.payloads_dropped += 1
        else:
            self._queue.append((due_ns, payload, peer))
            self._queued += len(payload)

    def send_to(self, payload: bytes, due_ns: int, place: tuple[str, int]) -> None:
        if not self._open:
            return
        if self._line is not None or (self._queued and self._queued + len(payload) > QUEUE_BYTES):
            self.stats.payloads_dropped += 1
        else:
            self._queue.append((due_ns, payload, place))
            self._queued += len(payload)

    @property
    def place(self) -> tuple[str, int]:
        return str(self._there[0]), int(self._there[1])

    def flush(self, now_ns: int) -> int | None:
        if not self._open:
            return None
        if self._line is not None:
            for left in self._line.take(now_ns):
                self._send(left.data, None, left.last_ns, now_ns)
            return self._earliest(self._line.next_ns(now_ns))
        while self._queue and self._queue[0][0] <= now_ns:
            due_ns, payload, peer = self._queue.popleft()
            self._queued -= len(payload)
            self._send(payload, peer, due_ns, now_ns)
        return self._earliest(self._queue[0][0] if self._queue else None)

    def _earliest(self, wake_ns: int | None) -> int | None:
        if self._in is None:  # nothing is heard
            return wake_ns
        return min((wake for wake in (wake_ns, self._intake.next_ns()) if wake is not None), default=None)

    def _send(self, payload: bytes, peer: int | tuple[str, int] | None, due_ns: int, now_ns: int) -> None:
        if isinstance(peer, tuple):
            return self._send_to(payload, peer, due_ns, now_ns)
        place = self._there if peer is None else self._senders.get(peer, self._there)
        return self._send_to(payload, place, due_ns, now_ns)

    def _send_to(self, payload: bytes, place: Any, due_ns: int, now_ns: int) -> None:
        try:
            try:
                self._out.sendto(payload, place)
            except ConnectionRefusedError:  # that was an earlier one, only with `tell_undelivered`
                self._met()
                self._out.sendto(payload, place)
        except OSError:  # no route, no room, or longer than a datagram can be
            self.stats.payloads_dropped += 1
            self.on_given_up(payload)
            if self._undelivered is not None:
                self._undelivered(False)
        else:
            self.stats.bytes_out += len(payload)
            self.stats.note_left(due_ns, now_ns)

    def _met(self) -> None:
        """An earlier datagram has met a closed port."""
        self._forget_errors()
        if self._undelivered is not None:
            self._undelivered(True)

    @property
    def speed(self) -> int | None:
        return None if self._line is None else self._line.speed

    def set_speed(self, baud: int | None) -> None:
        if self._line is not None:
            self._line.set_speed(baud)

    def clear(self) -> int:
        forgotten, self._queued = self._queued, 0
        self._queue.clear()
        return forgotten if self._line is None else self._line.clear()

    def close(self) -> None:
        self._open = False
        for endpoint in (self._out, self._in):
            if endpoint is not None:
                endpoint.close()
