"""SocketCAN without a kernel module: the emulator's side of the CAN sockets that the preload shim gives a driver.

Belongs here: the Unix seqpacket socket to which the shim (`preload_can.c`) connects each CAN_RAW socket of a driver,
what each of them wants to hear (filters, loop-back, own frames, error frames), and their frames. Not: the bus itself
(`can_wire`), and what a driver calls.

The socket's name is in the abstract namespace: nothing is left behind in the file system, and it is reachable from the
same network namespace, as a CAN interface is. Frames that a program had written before it ended still go out.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import select
import socket
import struct
import termios
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from emulator.errors import LinkError
from emulator.transports.can_link import CanPort, DriverSockets, Outlet
from emulator.transports.can_wire import HOST_FRAMES, CanWire, Carried, Node, Notice
from protocols.can_frame import EXTENDED, MAX_DATA_BYTES, MAX_EXTENDED_ID, MAX_STANDARD_ID

VARIABLE = "LIDAREMU__CAN"
"Of a driver's environment: `@SOCKET;NAME=INDEX;...`. Two low lines: no sensor's variable is called so."
FIRST_INDEX = 1_000_001
"Interface numbers far above those that a kernel gives."
LONGEST_NAME = 15
MAX_INTERFACES = 16
MAX_SOCKETS = 256
"Of all programs together; further ones learn that there is no room (ENOBUFS)."
FRAMES_A_CALL = 64
"Taken from one socket at a time: none can starve the others."
BACKLOG_FRAMES = 1024
"Frames that wait for a program that does not read, beyond what the kernel holds (about 280); then they are dropped."
SEND_BUFFER = 212_992
MOST_FILTERS = 4096

MAGIC, VERSION = 0x4E41434C, 1
REQUEST = struct.Struct("=IIQiIII")
"magic, version, number of the socket (0: a new one), interface, flags, error mask, count of filters; filters follow."
ANSWER = struct.Struct("=IiQ")
"magic, errno, number."
FILTER = struct.Struct("=II")
FRAME = struct.Struct("=IB3x8s")
"struct can_frame."
BEHIND = struct.Struct("=iIqII")
"interface, flags, time in ns, drops, reserved."
PACKET_BYTES = FRAME.size + BEHIND.size
LONGEST = REQUEST.size + MOST_FILTERS * FILTER.size
LOOPBACK, RECEIVE_OWN, JOIN_FILTERS = 1, 2, 4
FROM_HERE, OWN = 1, 2
ALL_INTERFACES, NO_INTERFACE = 0, -1

EFF, RTR, ERR = 0x8000_0000, 0x4000_0000, 0x2000_0000
"linux/can.h: CAN_EFF_FLAG, CAN_RTR_FLAG, CAN_ERR_FLAG; the last is CAN_INV_FILTER in a filter's identifier."
ERR_MASK = 0x1FFF_FFFF
ERROR_FRAMES = {
    "bus off": (0x40, bytes(8)),
    "error passive": (0x04, bytes([0, 0x20, 0, 0, 0, 0, 0, 0])),  # CAN_ERR_CRTL_TX_PASSIVE
    "recovered": (0x100, bytes(8)),
}
"linux/can/error.h: class and data of what becomes of a controller."


@dataclass
class Options:
    """What a socket wants to hear, as the kernel keeps it."""

    flags: int = LOOPBACK
    error_mask: int = 0
    filters: tuple[tuple[int, int, bool], ...] = ((0, 0, False),)
    "(identifier, mask, inverted), made ready by `ready_filter`."

    def hears(self, identifier: int) -> bool:
        """Whether a frame with that identifier, flags included, passes."""
        passes = (((identifier & mask) == wanted) != inverted for wanted, mask, inverted in self.filters)
        return (bool(self.filters) and all(passes)) if self.flags & JOIN_FILTERS else any(passes)


def ready_filter(identifier: int, mask: int) -> tuple[int, int, bool]:
    """A struct can_filter as `raw_rcv` compares it (net/can/af_can.c, can_rcv_list_find)."""
    inverted = bool(identifier & ERR)
    identifier &= ~ERR
    if mask & EFF and not identifier & EFF:
        mask &= MAX_STANDARD_ID | EFF | RTR
    return identifier & mask, mask, inverted


@dataclass(eq=False)
class Client:
    """One CAN socket of a driver."""

    number: int
    connection: socket.socket
    options: Options = field(default_factory=Options)
    greeted: bool = False
    nodes: dict[int, Node] = field(default_factory=dict)
    "Its controllers by the number of the interface; one is made when it listens or sends there."
    interface: int = NO_INTERFACE
    blocked: bool = False
    "Its next frame waits for room on the bus."
    waiting: deque[bytes] = field(default_factory=deque)
    drops: int = 0
    mask: int = select.EPOLLIN

    def listens(self, index: int) -> bool:
        """Whether it is bound to that interface, or to all."""
        return self.interface in (index, ALL_INTERFACES)


class CanSockets:
    """All CAN sockets of a run's drivers."""

    def __init__(self, stamp_ns: Callable[[int], int] = lambda now_ns: now_ns) -> None:
        self._stamp_ns = stamp_ns
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK)
        self.name = f"lidaremu-{os.getpid()}-{os.urandom(4).hex()}"
        self._listener.bind(f"\0{self.name}")
        self._listener.listen(MAX_SOCKETS)
        self._epoll = select.epoll()
        self._epoll.register(self._listener, select.EPOLLIN)
        self._clients: dict[int, Client] = {}
        "By descriptor."
        self._leaving: list[Client] = []
        "Their programs have closed them; frames of theirs still wait for the bus."
        self._made = 0
        self.outlets: dict[int, SocketOutlet] = {}
        "By the number of the interface."

    def set_stamps(self, stamp_ns: Callable[[int], int]) -> None:
        """From the run's time to what a program sees in its time stamps, both in nanoseconds."""
        self._stamp_ns = stamp_ns

    def environment(self) -> dict[str, str]:
        """What a driver's environment needs beside the shim; nothing when no bus is there."""
        names = [f"{outlet.name}={index}" for index, outlet in self.outlets.items()]
        return {VARIABLE: ";".join([f"@{self.name}", *names])} if names else {}

    def outlet(self, name: str, url: str) -> SocketOutlet:
        """A new interface of that name; `LinkError` when there is one."""
        if not 0 < len(name) <= LONGEST_NAME or any(letter in name for letter in ";=@/ :"):
            raise LinkError(f"{url}: {name!r} cannot be the name of a CAN interface; want up to {LONGEST_NAME} letters")
        if any(outlet.name == name for outlet in self.outlets.values()):
            raise LinkError(f"{url}: --shim: another bus of this run is called {name}; want a name for each")
        if len(self.outlets) == MAX_INTERFACES:
            raise LinkError(f"{url}: --shim carries {MAX_INTERFACES} CAN interfaces, not more")
        index = next(number for number in range(FIRST_INDEX, FIRST_INDEX + 99) if number not in self.outlets)
        self.outlets[index] = SocketOutlet(self, name, index, url)
        return self.outlets[index]

    def fileno(self) -> int:
        """Readable when `poll` has something to do; -1 once closed."""
        return -1 if self._epoll.closed else self._epoll.fileno()

    def clients(self) -> list[Client]:
        """Sockets that are bound."""
        return [client for client in self._clients.values() if client.interface != NO_INTERFACE]

    def sender(self, node: Node) -> Client | None:
        """The socket that sent from that controller; None: it is none of ours."""
        every = (*self._clients.values(), *self._leaving)
        return next((client for client in every if node in client.nodes.values()), None)

    def poll(self, now_ns: int) -> None:
        """Sockets come and go, their frames go to the bus, what waited for them goes to them."""
        if self._epoll.closed:
            return
        for fd, mask in self._epoll.poll(0):
            client = self._clients.get(fd)
            if fd == self._listener.fileno():
                self._accept()
            elif client is not None:
                if mask & select.EPOLLOUT:
                    self._send_waiting(client)
                if mask & ~select.EPOLLOUT:
                    self._read(client, now_ns)
        for client in [one for one in self._clients.values() if one.blocked]:
            if self._has_room(client):
                client.blocked = False
                self._epoll.register(client.connection, client.mask)
                self._read(client, now_ns)
        for client in list(self._leaving):
            self._leave_if_done(client)

    def _accept(self) -> None:
        while True:
            try:
                connection, _ = self._listener.accept()
            except OSError:  # nobody else waits, or no descriptor is left
                return
            connection.setblocking(False)
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
            _, user, _ = struct.unpack("3i", connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))
            if user not in (os.getuid(), 0) and os.getuid() != 0:
                connection.close()
                continue
            if len(self._clients) >= MAX_SOCKETS:
                _say(connection, ANSWER.pack(MAGIC, errno.ENOBUFS, 0))
                connection.close()
                continue
            self._made += 1
            client = Client(self._made, connection)
            self._clients[connection.fileno()] = client
            self._epoll.register(connection, client.mask)

    def _read(self, client: Client, now_ns: int) -> None:
        for _ in range(FRAMES_A_CALL):
            if not self._has_room(client):
                client.blocked = True
                self._epoll.unregister(client.connection)
                return
            try:
                packet = client.connection.recv(PACKET_BYTES if client.greeted else LONGEST)
            except BlockingIOError:
                return
            except OSError:
                packet = b""
            if not packet or (not client.greeted and not self._greet(client, packet)):
                self._gone(client)
                return
            if len(packet) in (FRAME.size, PACKET_BYTES):
                self._send(client, packet, now_ns)

    def _greet(self, client: Client, packet: bytes) -> bool:
        """The first packet: options of a new socket, or of another one; False: this connection has done its work."""
        parts = _request(packet)
        if parts is None:
            return False
        number, interface, options = parts
        about = client if number == 0 else self._find(number)
        if about is None or (interface not in (ALL_INTERFACES, NO_INTERFACE) and interface not in self.outlets):
            _say(client.connection, ANSWER.pack(MAGIC, errno.ENODEV, 0))
            return False
        about.options, about.interface = options, interface
        for index in self.outlets:
            if about.listens(index):
                self._node(about, index)
        client.greeted = about is client
        return _say(client.connection, ANSWER.pack(MAGIC, 0, about.number)) and client.greeted

    def _find(self, number: int) -> Client | None:
        return next((one for one in self._clients.values() if one.number == number and one.greeted), None)

    def _node(self, client: Client, index: int) -> Node | None:
        """Its controller on that bus, made when there is none."""
        if index not in client.nodes and index in self.outlets:
            node = self.outlets[index].join(client.number)
            if node is not None:
                client.nodes[index] = node
        return client.nodes.get(index)

    def _has_room(self, client: Client) -> bool:
        return all(self.outlets[index].has_room(node) for index, node in client.nodes.items() if index in self.outlets)

    def _send(self, client: Client, packet: bytes, now_ns: int) -> None:
        identifier, length, data = FRAME.unpack_from(packet)
        index = BEHIND.unpack_from(packet, FRAME.size)[0] if len(packet) == PACKET_BYTES else client.interface
        outlet, node = self.outlets.get(index), self._node(client, index)
        if outlet is None or node is None:
            return
        plain = identifier & (MAX_EXTENDED_ID if identifier & EFF else MAX_STANDARD_ID)
        if identifier & (RTR | ERR) or length > MAX_DATA_BYTES:
            outlet.counters.malformed += 1
            return
        outlet.put(node, plain | (EXTENDED if identifier & EFF else 0), data[:length], now_ns)

    def give(self, client: Client, head: bytes, index: int, flags: int, at_ns: int) -> bool:
        """A frame for a program; False when it reads too slowly."""
        packet = head + BEHIND.pack(index, flags, self._stamp_ns(at_ns), client.drops & 0xFFFF_FFFF, 0)
        if client.waiting:
            if len(client.waiting) >= BACKLOG_FRAMES:
                client.drops += 1
                return False
            client.waiting.append(packet)
        elif not _say(client.connection, packet):
            client.waiting.append(packet)
            self._watch(client)
        return True

    def _send_waiting(self, client: Client) -> None:
        while client.waiting and _say(client.connection, client.waiting[0]):
            client.waiting.popleft()
        self._watch(client)

    def _watch(self, client: Client) -> None:
        client.mask = select.EPOLLIN | (select.EPOLLOUT if client.waiting else 0)
        if not client.blocked:
            self._epoll.modify(client.connection, client.mask)

    def _gone(self, client: Client) -> None:
        """Its program has closed it."""
        self._clients.pop(client.connection.fileno(), None)
        if not client.blocked:
            self._epoll.unregister(client.connection)
        client.connection.close()
        self._leaving.append(client)
        self._leave_if_done(client)

    def _leave_if_done(self, client: Client) -> None:
        for index, node in list(client.nodes.items()):
            outlet = self.outlets.get(index)
            if outlet is None or outlet.leave_if_done(node):
                del client.nodes[index]
        if not client.nodes:
            self._leaving.remove(client)

    def remove(self, outlet: SocketOutlet) -> None:
        """A bus goes; the last one takes all sockets with it."""
        self.outlets.pop(outlet.index, None)
        for client in list(self._clients.values()):
            client.nodes.pop(outlet.index, None)
            if client.interface == outlet.index:  # its next read is ENETDOWN
                self._gone(client)
        if not self.outlets:
            self.close()

    def close(self) -> None:
        """Close everything; may be called twice."""
        for client in self._clients.values():
            client.connection.close()
        self._clients.clear()
        self._leaving.clear()
        self._listener.close()
        self._epoll.close()


class SocketOutlet(Outlet):
    """One interface: the sockets of drivers on one bus."""

    def __init__(self, sockets: CanSockets, name: str, index: int, url: str) -> None:
        super().__init__()
        self._sockets = sockets
        self._url = url
        self.name = name
        self.index = index
        self._port: CanPort | None = None
        self._bell = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        "Rung when another bus's look at the sockets has found a frame for this one."

    def attached(self, port: CanPort) -> None:
        self._port = port

    @property
    def url(self) -> str:
        return self._url

    def filenos(self) -> tuple[int, ...]:
        if self._bell < 0:
            return ()
        first = next(iter(self._sockets.outlets.values()), None) is self
        return (self._sockets.fileno(), self._bell) if first and self._sockets.fileno() >= 0 else (self._bell,)

    def poll(self, now_ns: int) -> None:
        with contextlib.suppress(OSError):  # not rung
            os.eventfd_read(self._bell)
        self._sockets.poll(now_ns)

    def deliver(self, carried: Sequence[Carried], now_ns: int) -> bool:
        clients = [client for client in self._sockets.clients() if client.listens(self.index)]
        if not clients:
            return False
        for frame in carried:
            sender = self._sockets.sender(frame.node)
            if sender is not None and not sender.options.flags & LOOPBACK:
                continue
            head = FRAME.pack(frame.peer, len(frame.data), frame.data)
            for client in clients:
                if client is sender and not client.options.flags & RECEIVE_OWN:
                    continue
                if client.options.hears(frame.peer):
                    flags = (FROM_HERE if sender is not None else 0) | (OWN if client is sender else 0)
                    self._count(self._sockets.give(client, head, self.index, flags, frame.end_ns))
        return True

    def notify(self, notices: Sequence[Notice]) -> None:
        for notice in notices:
            kind, data = ERROR_FRAMES.get(notice.state, (0, b""))
            for client in self._sockets.clients():
                if kind & client.options.error_mask and client.listens(self.index):
                    self._sockets.give(client, FRAME.pack(kind | ERR, 8, data), self.index, 0, notice.at_ns)

    def listeners(self) -> int:
        return sum(client.listens(self.index) for client in self._sockets.clients())

    def held(self) -> int:
        return sum(
            PACKET_BYTES * len(client.waiting) + _unread(client.connection)
            for client in self._sockets.clients()
            if client.listens(self.index)
        )

    def has_host(self) -> bool:
        return bool(self.listeners())

    def close(self) -> None:
        if self._bell >= 0:
            self._sockets.remove(self)
            os.close(self._bell)
            self._bell = -1

    def join(self, number: int) -> Node | None:
        """A socket's controller."""
        return None if self._port is None else self._port.wire.join(f"socket {number}", HOST_FRAMES)

    def leave_if_done(self, node: Node) -> bool:
        """Take a controller away once all it had to send has gone out; whether it is away."""
        if self._port is not None:
            if self._port.wire.is_busy(node):
                return False
            self._port.wire.leave(node)
        return True

    def has_room(self, node: Node) -> bool:
        """Whether a controller takes another frame."""
        return self._port is None or self._port.wire.has_room(node)

    def put(self, node: Node, peer: int, data: bytes, now_ns: int) -> None:
        """A program's frame."""
        if self._port is None:
            return
        if self._port.wire.put(node, peer, data, now_ns):
            self.counters.host_frames += 1
            for link in self._port.links[:1]:
                if self._port.wake_others(link):
                    os.eventfd_write(self._bell, 1)
        else:
            self.counters.host_drops += 1

    def _count(self, given: bool) -> None:
        if not given and self._port is not None:
            for link in self._port.links[:1]:
                link.stats.payloads_dropped += 1


class BesideOutlet(Outlet):
    """A bus with another way out and the sockets of drivers."""

    def __init__(self, other: Outlet, sockets: Outlet) -> None:
        super().__init__()
        self._both: tuple[Outlet, Outlet] = (other, sockets)
        other.counters = sockets.counters = self.counters

    def attached(self, port: CanPort) -> None:
        for one in self._both:
            one.attached(port)

    @property
    def url(self) -> str:
        return self._both[0].url

    @property
    def path(self) -> str | None:
        return self._both[0].path

    def filenos(self) -> tuple[int, ...]:
        return (*self._both[0].filenos(), *self._both[1].filenos())

    def poll(self, now_ns: int) -> None:
        for one in self._both:
            one.poll(now_ns)

    def deliver(self, carried: Sequence[Carried], now_ns: int) -> bool:
        heard = [one.deliver(carried, now_ns) for one in self._both]
        return any(heard)

    def notify(self, notices: Sequence[Notice]) -> None:
        for one in self._both:
            one.notify(notices)

    def listeners(self) -> int:
        return sum(one.listeners() for one in self._both)

    def next_ns(self) -> int | None:
        return self._both[0].next_ns()

    def held(self) -> int:
        return sum(one.held() for one in self._both)

    def has_host(self) -> bool:
        return any(one.has_host() for one in self._both)

    def close(self) -> None:
        for one in self._both:
            one.close()


def beside(outlet: Outlet, sockets: DriverSockets | None, name: str, url: str) -> Outlet:
    """`outlet`, and with `sockets` an interface of that name on the same bus; `LinkError` closes `outlet`."""
    if sockets is None:
        return outlet
    try:
        return BesideOutlet(outlet, sockets.outlet(name, url))
    except LinkError:
        outlet.close()
        raise


def kernel_has(name: str) -> bool:
    """Whether the kernel has an interface of that name."""
    with contextlib.suppress(OSError):
        return socket.if_nametoindex(name) > 0
    return False


def socket_bus(sockets: DriverSockets, name: str, url: str, bitrate: int) -> tuple[CanWire, Outlet]:
    """A bus whose only way out are the sockets of drivers."""
    return CanWire(bitrate), sockets.outlet(name, url)


def _request(packet: bytes) -> tuple[int, int, Options] | None:
    """Number, interface and options; None when it is no request of our shim."""
    if len(packet) < REQUEST.size:
        return None
    magic, version, number, interface, flags, error_mask, count = REQUEST.unpack_from(packet)
    if (magic, version) != (MAGIC, VERSION) or len(packet) != REQUEST.size + count * FILTER.size:
        return None
    pairs = list(FILTER.iter_unpack(packet[REQUEST.size :]))
    masks = [mask & ERR_MASK for _, mask in pairs if mask & ERR]
    for mask in masks:
        error_mask |= mask
    filters = tuple(ready_filter(identifier, mask) for identifier, mask in pairs if not mask & ERR)
    return number, interface, Options(flags, error_mask, filters)


def _say(connection: socket.socket, packet: bytes) -> bool:
    """Whether the kernel has taken it; who has closed takes everything."""
    try:
        connection.send(packet, socket.MSG_DONTWAIT | socket.MSG_NOSIGNAL)
    except BlockingIOError:
        return False
    except OSError:
        return True  # closed: `poll` finds it
    return True


def _unread(connection: socket.socket) -> int:
    """Bytes, as the kernel counts them, that a program has not read; 0: none."""
    with contextlib.suppress(OSError):
        return int.from_bytes(fcntl.ioctl(connection, termios.TIOCOUTQ, b"\0" * 4), "little")
    return 0
