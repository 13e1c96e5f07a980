"""A socketcand server: any number of stock CAN clients over TCP, no kernel module.

Belongs here: the text protocol (`< open can0 >`, `< rawmode >`, `< frame 60A 1.500000 03FBF710 >`, `< send ... >`) and
who hears what. Not: the bus itself (`can_wire`) and connections (`tcp_hosts`).
Source: the protocol page of linux-can/socketcand and python-can's client, which wants exactly one group an answer: it
compares all it has received with `< ok >`, so frames wait for `SETTLE_NS` behind the answer to `< rawmode >`.

Of socketcand's modes only raw mode is there; others are refused with an error group. Frames of one client are shown to
the others, not to itself, as a kernel bus does. A client that reads too slowly loses frames, whole ones, counted.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field

from emulator.transports.can_link import BITRATE, HIGHEST_BITRATE, LOWEST_BITRATE, CanPort, CanPorts, Outlet
from emulator.transports.can_wire import HOST_FRAMES, CanWire, Carried, Node, Notice
from emulator.transports.intake import CAN_BURST, STREAM_BYTES_S, Intake
from emulator.transports.link import Link, LinkStats
from emulator.transports.tcp_hosts import Host, Hosts
from emulator.transports.urls import host_and_port, join_host_port, parse_url
from protocols.can_frame import EXTENDED, MAX_DATA_BYTES, MAX_EXTENDED_ID, MAX_STANDARD_ID, split_identifier

SETTLE_NS = 20_000_000
LONGEST_GROUP = 512
"Bytes between < and > beyond which a client is not speaking this protocol."
TEXT_LIMIT = 32_768
"Text of a client that waits for room on the bus. It is not read any further meanwhile, so no client gets there."
CHANNEL = re.compile(r"[A-Za-z0-9_.-]{1,15}")
"As the kernel names its interfaces."
GROUP = re.compile(rb"<([^<>]*)>")
BUS_OFF_ERROR = 0x20000040
"linux/can/error.h: CAN_ERR_FLAG | CAN_ERR_BUSOFF."
CONTROLLER_ERROR = 0x20000004
"CAN_ERR_FLAG | CAN_ERR_CRTL: error passive."
RESTARTED = 0x20000100
"CAN_ERR_FLAG | CAN_ERR_RESTARTED."
ERROR_IDS = {"bus off": BUS_OFF_ERROR, "error passive": CONTROLLER_ERROR, "recovered": RESTARTED}


def check_link_socketcand(url: str) -> None:
    """Judge the text of a `socketcand:` link; raises ValueError."""
    _parts(url)


def open_link_socketcand(url: str, *, can_ports: CanPorts | None = None, can_bitrate: int | None = None) -> Link:
    """A sensor on the bus that `socketcand:HOST:PORT/CHANNEL[?bitrate=...]` names; raises LinkError.

    `can_ports`: the buses of the run; sensors that give the same text share one, and channels of one host and port
    share a server. Without it the bus is this sensor's alone.
    """
    host, port, channel, bitrate = _parts(url, can_bitrate)
    ports = can_ports if can_ports is not None else CanPorts()

    def make() -> tuple[CanWire, Outlet]:
        key = (host, port)
        server = ports.servers.get(key)
        if not isinstance(server, SocketcandServer) or server.closed:
            server = SocketcandServer(url, host, port)
            ports.servers[key] = server
        outlet: Outlet = server.channel(channel)
        if ports.sockets is not None:
            from emulator.transports.can_sockets import beside

            outlet = beside(outlet, ports.sockets, channel, url)
        return CanWire(bitrate), outlet

    return ports.link(f"socketcand:{host}:{port}/{channel}", make)


def _parts(url: str, default_bitrate: int | None = None) -> tuple[str, int, str, int]:
    parts = parse_url(url)
    parts.allow("bitrate")
    address, slash, channel = parts.target.partition("/")
    if not slash or CHANNEL.fullmatch(channel) is None:
        raise ValueError(f"{url!r}: channel {channel!r}; want socketcand:HOST:PORT/CHANNEL, for example .../can0")
    host, port = host_and_port(url, address)
    return host, port, channel, parts.number("bitrate", default_bitrate or BITRATE, LOWEST_BITRATE, HIGHEST_BITRATE)


@dataclass
class Client:
    """One connection."""

    number: int
    text: bytearray = field(default_factory=bytearray)
    "What has come and was not understood yet."
    channel: Channel | None = None
    node: Node | None = None
    listens_from_ns: int | None = None
    "In raw mode: when the first frame may go to it."
    held: list[bytes] = field(default_factory=list)
    "Frames since raw mode began, until then."
    blocked: bool = False
    "Its next frame waits for room on the bus."


class SocketcandServer:
    """The TCP side; carries one or more channels."""

    def __init__(self, url: str, host: str, port: int) -> None:
        self.stats = LinkStats()
        self.hosts = Hosts(url, host, port, self.stats, Intake(STREAM_BYTES_S, CAN_BURST))
        self.channels: dict[str, Channel] = {}
        self._clients: dict[int, Client] = {}
        self.closed = False

    @property
    def address(self) -> str:
        """Where it listens, with the real port."""
        return join_host_port(*self.hosts.address)

    def channel(self, name: str) -> Channel:
        """A new channel."""
        self.channels[name] = Channel(self, name)
        return self.channels[name]

    def poll(self, now_ns: int) -> None:
        """Connections come and go, clients speak."""
        for event in self.hosts.poll(now_ns):
            if event.opened:
                self._clients[event.peer] = Client(event.peer)
                self.say(event.peer, b"< hi >", now_ns)
            client = self._clients.get(event.peer)
            if client is None:
                continue
            if event.data:
                client.text += event.data
                self._understand(client, now_ns)
            if event.closed:
                self._forget(client)
        for client in list(self._clients.values()):
            if client.blocked:
                self._understand(client, now_ns)

    def clients(self, channel: Channel) -> list[Client]:
        """Clients in raw mode on a channel."""
        return [c for c in self._clients.values() if c.channel is channel and c.listens_from_ns is not None]

    def say(self, number: int, text: bytes, now_ns: int) -> bool:
        """Send to one client; False when it reads too slowly."""
        host: Host | None = self.hosts.find(number)
        if host is None or not self.hosts.takes(host):
            return False
        self.hosts.send(host, text, now_ns)
        return True

    def next_ns(self) -> int | None:
        """When a client's held frames are due, a blocked one may go on, or a connection is looked at."""
        times = [c.listens_from_ns for c in self._clients.values() if c.held and c.listens_from_ns is not None]
        lingering = self.hosts.next_ns()
        if lingering is not None:
            times.append(lingering)
        return min(times) if times else None

    def leave(self, channel: Channel) -> None:
        """A channel goes; the last one closes the server."""
        for client in [c for c in self._clients.values() if c.channel is channel]:
            client.channel = client.node = None
            client.listens_from_ns = None
        self.channels = {name: kept for name, kept in self.channels.items() if kept is not channel}
        if not self.channels:
            self.close()

    def close(self) -> None:
        """Close every connection."""
        self.closed = True
        self._clients.clear()
        self.hosts.close()

    def _forget(self, client: Client) -> None:
        self._clients.pop(client.number, None)
        if client.channel is not None and client.node is not None:
            client.channel.leave(client.node)

    def _understand(self, client: Client, now_ns: int) -> None:
        """Obey the groups that are complete; a frame without room on the bus keeps the rest waiting."""
        text, position, client.blocked = client.text, 0, False
        while match := GROUP.search(text, position):
            words = match.group(1).split()
            if words[:1] == [b"send"] and client.channel is not None and not client.channel.has_room(client):
                client.blocked = True
                break
            position = match.end()
            self._obey(client, words, now_ns)
        del text[:position]
        if not client.blocked and text.find(b"<") > 0:
            del text[: text.find(b"<")]
        elif not client.blocked and b"<" not in text:
            text.clear()
        if len(text) > (TEXT_LIMIT if client.blocked else LONGEST_GROUP):
            self._malformed(client, b"too long", now_ns)
            text.clear()
        host = self.hosts.find(client.number)
        if host is not None:
            self.hosts.pause(host, client.blocked)

    def _obey(self, client: Client, words: list[bytes], now_ns: int) -> None:
        command, arguments = (words[0], words[1:]) if words else (b"", [])
        if command == b"open" and client.channel is None and len(arguments) == 1:
            self._open(client, arguments[0], now_ns)
        elif command == b"rawmode" and client.channel is not None:
            self.say(client.number, b"< ok >", now_ns)
            if client.listens_from_ns is None:
                client.listens_from_ns = now_ns + SETTLE_NS
        elif command == b"send" and client.channel is not None:
            frame = parse_send(arguments)
            if frame is None:
                self._malformed(client, b"syntax error in send command", now_ns)
            else:
                client.channel.put(client, *frame, now_ns)
        elif command == b"echo":
            self.say(client.number, b"< echo >", now_ns)
        else:
            self._malformed(client, b"unknown command" if command else b"syntax error", now_ns)

    def _open(self, client: Client, name: bytes, now_ns: int) -> None:
        channel = self.channels.get(name.decode("ascii", "replace"))
        if channel is None:
            self._malformed(client, b"could not open bus", now_ns)
            return
        client.channel = channel
        client.node = channel.join(client.number)
        self.say(client.number, b"< ok >", now_ns)

    def _malformed(self, client: Client, text: bytes, now_ns: int) -> None:
        counted = client.channel or next(iter(self.channels.values()), None)
        if counted is not None:
            counted.counters.malformed += 1
        self.say(client.number, b"< error " + text + b" >", now_ns)


class Channel(Outlet):
    """One bus of a server."""

    def __init__(self, server: SocketcandServer, name: str) -> None:
        super().__init__()
        self._server = server
        self.name = name
        self._port: CanPort | None = None

    def attached(self, port: CanPort) -> None:
        self._port = port

    @property
    def url(self) -> str:
        return f"socketcand:{self._server.address}/{self.name}"

    @property
    def _first(self) -> bool:
        """The first channel of a server watches its sockets for all."""
        return next(iter(self._server.channels.values()), None) is self

    def filenos(self) -> tuple[int, ...]:
        number = self._server.hosts.fileno()
        return (number,) if number >= 0 and self._first and not self._server.hosts.intake.closed else ()

    def poll(self, now_ns: int) -> None:
        self._server.poll(now_ns)
        for client in self._server.clients(self):
            if client.held and client.listens_from_ns is not None and client.listens_from_ns <= now_ns:
                texts, client.held = client.held, []
                self._give(client, b"".join(texts), len(texts), now_ns)

    def next_ns(self) -> int | None:
        return self._server.next_ns()

    def deliver(self, carried: Sequence[Carried], now_ns: int) -> bool:
        texts = [(frame.node, frame_text(frame.peer, frame.data, frame.end_ns)) for frame in carried]
        clients = self._server.clients(self)
        for client in clients:
            wanted = [text for node, text in texts if node is not client.node]
            if client.listens_from_ns is not None and client.listens_from_ns > now_ns:
                client.held += wanted
            elif wanted:
                self._give(client, b"".join(wanted), len(wanted), now_ns)
        return bool(clients)

    def held(self) -> int:
        found = [self._server.hosts.find(client.number) for client in self._server.clients(self)]
        return sum(host.backlog for host in found if host is not None)

    def has_host(self) -> bool:
        return bool(self._server.clients(self))

    def listeners(self) -> int:
        return len(self._server.clients(self))

    def notify(self, notices: Sequence[Notice]) -> None:
        for notice in notices:
            if notice.state not in ERROR_IDS:
                continue
            seconds, rest_ns = divmod(notice.at_ns, 1_000_000_000)
            text = f"< error {ERROR_IDS[notice.state]:08X} {seconds}.{rest_ns // 1000:06d} >".encode()
            for client in self._server.clients(self):
                self._server.say(client.number, text, notice.at_ns)

    def close(self) -> None:
        self._server.leave(self)

    def join(self, number: int) -> Node | None:
        """A client's controller."""
        return None if self._port is None else self._port.wire.join(f"client {number}", HOST_FRAMES)

    def leave(self, node: Node) -> None:
        """A client has gone; what it had queued goes with it."""
        if self._port is not None:
            self._port.wire.leave(node)

    def has_room(self, client: Client) -> bool:
        """Whether the client's controller takes another frame."""
        return self._port is None or client.node is None or self._port.wire.has_room(client.node)

    def put(self, client: Client, peer: int, data: bytes, now_ns: int) -> None:
        """A client's frame."""
        if self._port is None or client.node is None:
            return
        if self._port.wire.put(client.node, peer, data, now_ns):
            self.counters.host_frames += 1
            for link in self._port.links[:1]:
                if self._port.wake_others(link):
                    link.wake()
        else:
            self.counters.host_drops += 1

    def _give(self, client: Client, text: bytes, frames: int, now_ns: int) -> None:
        if not self._server.say(client.number, text, now_ns) and self._port is not None:
            for link in self._port.links[:1]:
                link.stats.payloads_dropped += frames


def frame_text(peer: int, data: bytes, at_ns: int) -> bytes:
    """`< frame ID SECONDS.MICROSECONDS DATA >`: three digits of a standard identifier, eight of an extended one."""
    identifier, extended = split_identifier(peer)
    seconds, rest_ns = divmod(at_ns, 1_000_000_000)
    name = f"{identifier:08X}" if extended else f"{identifier:03X}"
    return f"< frame {name} {seconds}.{rest_ns // 1000:06d} {data.hex().upper()} >".encode()


def parse_send(arguments: Sequence[bytes]) -> tuple[int, bytes] | None:
    """Identifier (bit 31: extended) and data of `ID LENGTH BYTE...`, None when it is no frame.

    Eight digits are an extended identifier, up to three a standard one, as the stock client writes them.
    """
    try:
        if len(arguments) < 2 or any(not word.isalnum() for word in arguments):
            return None
        digits = len(arguments[0])
        identifier, length = int(arguments[0], 16), int(arguments[1], 16)
        data = bytes(int(word, 16) for word in arguments[2:])
    except ValueError:
        return None
    if length > MAX_DATA_BYTES or len(data) != length:
        return None
    if digits == 8:
        return (identifier | EXTENDED, data) if identifier <= MAX_EXTENDED_ID else None
    return (identifier, data) if digits <= 3 and identifier <= MAX_STANDARD_ID else None
