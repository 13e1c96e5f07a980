"""A socketcand server: any number of stock CAN clients over TCP, no kernel module.

Belongs here: the modes of a client (none, BCM, raw, control), its commands, and who hears what. Not: what BCM mode does
with subscriptions and jobs (`socketcand_bcm`), the bus itself (`can_wire`) and connections (`tcp_hosts`).
Source: linux-can/socketcand (doc/protocol.md, the state_*.c files) and python-can's client, which wants exactly one
group an answer: it compares all it has received with `< ok >`, so frames wait for `SETTLE_NS` behind the one to
`< rawmode >`.

After `< open can0 >` a client is in BCM mode. `isotpmode`, `muxfilter`, `sendrtr` and `fdsend` are refused by name.
Frames of one client are shown to the others, not to itself, as a kernel bus does. A client that reads too slowly loses
frames, whole ones, counted. The real server says nothing to a command that it cannot read; here it is named.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from emulator.transports.can_link import BITRATE, HIGHEST_BITRATE, LOWEST_BITRATE, CanPort, CanPorts, Outlet
from emulator.transports.can_wire import HOST_FRAMES, CanWire, Carried, Node, Notice
from emulator.transports.intake import CAN_BURST, STREAM_BYTES_S, Intake
from emulator.transports.link import Link, LinkStats
from emulator.transports.socketcand_bcm import (
    BroadcastManager,
    Heard,
    bcm_text,
    parse_frame,
    parse_identifier,
    parse_time,
)
from emulator.transports.tcp_hosts import Host, Hosts
from emulator.transports.urls import host_and_port, join_host_port, parse_url
from protocols.can_frame import split_identifier

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
NOT_CARRIED = (b"isotpmode", b"muxfilter", b"sendrtr", b"fdsend")
"Commands of the real server that are refused by name."
LEAST_STATISTICS_NS = 10_000_000
"As often as the real server looks."
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
            server = SocketcandServer(url, host, port, ports.stamp_ns)
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
    mode: str = "none"
    "none | bcm | raw | control"
    manager: BroadcastManager = field(default_factory=BroadcastManager)
    "Of BCM mode; leaving that takes all of it away."
    statistics_ns: int = 0
    "Between two lines of statistics in control mode; 0: none."
    counted_ns: int | None = None
    "When it got statistics last, or entered control mode."
    listens_from_ns: int | None = None
    "In raw mode: when the first frame may go to it."
    held: list[bytes] = field(default_factory=list)
    "Frames since raw mode began, until then."
    blocked: bool = False
    "Its next frame waits for room on the bus."


class SocketcandServer:
    """The TCP side; carries one or more channels."""

    def __init__(self, url: str, host: str, port: int, stamp_ns: Callable[[int], int] | None = None) -> None:
        self.stamp_ns: Callable[[int], int] = stamp_ns if stamp_ns is not None else lambda at_ns: at_ns
        "From the run's time to what clients see."
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

    def present(self, channel: Channel) -> list[Client]:
        """Clients that have opened a channel."""
        return [c for c in self._clients.values() if c.channel is channel]

    def tend(self, client: Client, now_ns: int) -> None:
        """What is due for a client of itself: jobs and held frames of BCM mode, statistics of control mode."""
        channel = client.channel
        if channel is None:
            return
        if client.manager.jobs and self.hosts.ends(client.number):
            client.manager.jobs.clear()
        for job in client.manager.send(now_ns) if client.manager.jobs else ():
            channel.put(client, job.peer, job.data, job.at_ns)
        for heard in client.manager.flush(now_ns) if client.manager.subscriptions else ():
            channel.give_heard(client, [heard], now_ns)
        due_ns = statistics_due_ns(client)
        if due_ns is not None and due_ns <= now_ns:
            client.counted_ns = now_ns
            counts = " ".join(str(number & 0xFFFF_FFFF) for number in channel.counts)
            self.say(client.number, f"< stat {counts} >".encode(), now_ns)

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
        for client in self._clients.values():
            own = (client.manager.next_ns(), statistics_due_ns(client))
            times += [time for time in own if time is not None]
        lingering = self.hosts.next_ns()
        if lingering is not None:
            times.append(lingering)
        return min(times) if times else None

    def leave(self, channel: Channel) -> None:
        """A channel goes; the last one closes the server."""
        for client in [c for c in self._clients.values() if c.channel is channel]:
            client.channel = client.node = None
            self._enter(client, "none", 0)
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
        elif command == b"echo" and not arguments:
            self.say(client.number, b"< echo >", now_ns)
        elif command in NOT_CARRIED:
            self._malformed(client, command + b" is not supported", now_ns)
        elif client.channel is None:
            self._malformed(client, b"unknown command" if command else b"syntax error", now_ns)
        elif command in (b"rawmode", b"bcmmode", b"controlmode") and not arguments:
            self.say(client.number, b"< ok >", now_ns)
            self._enter(client, command[:-4].decode(), now_ns)
        elif command == b"send" and client.mode != "control":
            self._send(client, client.channel, arguments, now_ns)
        elif command == b"statistics" and client.mode == "control":
            if len(arguments) != 1 or not arguments[0].isdigit() or len(arguments[0]) > 10:
                self._malformed(client, b"syntax error in statistics command", now_ns)
                return
            interval_ns = int(arguments[0]) * 1_000_000
            client.statistics_ns = max(interval_ns, LEAST_STATISTICS_NS) if interval_ns else 0
        elif command in BCM_COMMANDS and client.mode == "bcm":
            refusal = BCM_COMMANDS[command](client.manager, arguments, now_ns)
            if refusal:
                self._malformed(client, refusal + b" in " + command + b" command", now_ns)
            self.tend(client, now_ns)
        else:
            self._malformed(client, b"unknown command" if command else b"syntax error", now_ns)

    def _enter(self, client: Client, mode: str, now_ns: int) -> None:
        """Change the mode; what belonged to the old one is gone. The same mode again changes nothing."""
        if mode == client.mode:
            return
        client.mode, client.manager = mode, BroadcastManager()
        client.held.clear()
        client.listens_from_ns = now_ns + SETTLE_NS if mode == "raw" else None
        client.counted_ns = now_ns if mode == "control" else None

    def _send(self, client: Client, channel: Channel, arguments: list[bytes], now_ns: int) -> None:
        frame = parse_send(arguments)
        if frame is None:
            self._malformed(client, b"syntax error in send command", now_ns)
        else:
            channel.put(client, *frame, now_ns)

    def _open(self, client: Client, name: bytes, now_ns: int) -> None:
        channel = self.channels.get(name.decode("ascii", "replace"))
        if channel is None:
            self._malformed(client, b"could not open bus", now_ns)
            return
        client.channel = channel
        client.node = channel.join(client.number)
        self._enter(client, "bcm", now_ns)
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
        self.counts = [0, 0, 0, 0]
        "Bytes and frames that hosts received, then those that hosts sent."

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
        for client in self._server.present(self):
            self._server.tend(client, now_ns)
            if client.held and client.listens_from_ns is not None and client.listens_from_ns <= now_ns:
                texts, client.held = client.held, []
                self._give(client, b"".join(texts), len(texts), now_ns)

    def next_ns(self) -> int | None:
        return self._server.next_ns()

    def deliver(self, carried: Sequence[Carried], now_ns: int) -> bool:
        self._count(carried)
        present = self._server.present(self)
        raw = [client for client in present if client.listens_from_ns is not None]
        heard = carried if raw else ()
        texts = [(frame.node, frame_text(frame.peer, frame.data, self._stamp(frame.end_ns))) for frame in heard]
        for client in raw:
            wanted = [text for node, text in texts if node is not client.node]
            if client.listens_from_ns is not None and client.listens_from_ns > now_ns:
                client.held += wanted
            elif wanted:
                self._give(client, b"".join(wanted), len(wanted), now_ns)
        subscribed = [client for client in present if client.manager.subscriptions]
        for client in subscribed:
            others = [Heard(one.peer, one.data, one.end_ns) for one in carried if one.node is not client.node]
            self.give_heard(client, [reported for one in others for reported in client.manager.hear(one)], now_ns)
        return bool(raw or subscribed)

    def give_heard(self, client: Client, heard: Sequence[Heard], now_ns: int) -> None:
        """Frames for a client in BCM mode."""
        if heard:
            texts = [bcm_text(one.peer, one.data, self._stamp(one.at_ns)) for one in heard]
            self._give(client, b"".join(texts), len(texts), now_ns)

    def _stamp(self, at_ns: int) -> int:
        return self._server.stamp_ns(at_ns)

    def _count(self, carried: Sequence[Carried]) -> None:
        sensors = [] if self._port is None else [link.node for link in self._port.links]
        for frame in carried:
            place = 0 if frame.node in sensors else 2
            self.counts[place] += len(frame.data)
            self.counts[place + 1] += 1

    def held(self) -> int:
        found = [self._server.hosts.find(client.number) for client in self._server.present(self)]
        return sum(host.backlog for host in found if host is not None)

    def has_host(self) -> bool:
        return self.listeners() > 0

    def listeners(self) -> int:
        present = self._server.present(self)
        return sum(client.listens_from_ns is not None or bool(client.manager.subscriptions) for client in present)

    def notify(self, notices: Sequence[Notice]) -> None:
        for notice in notices:
            if notice.state not in ERROR_IDS:
                continue
            seconds, rest_ns = divmod(self._stamp(notice.at_ns), 1_000_000_000)
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
    return parse_frame(arguments)


def statistics_due_ns(client: Client) -> int | None:
    """When a client gets statistics next."""
    return client.counted_ns + client.statistics_ns if client.counted_ns is not None and client.statistics_ns else None


def _subscribe(manager: BroadcastManager, arguments: Sequence[bytes], now_ns: int) -> bytes:
    interval_ns = parse_time(arguments)
    peer = parse_identifier(arguments[2]) if len(arguments) == 3 else None
    if interval_ns is None or peer is None:
        return b"syntax error"
    return b"" if manager.subscribe(peer, interval_ns) else b"too many subscriptions"


def _filter(manager: BroadcastManager, arguments: Sequence[bytes], now_ns: int) -> bytes:
    interval_ns, frame = parse_time(arguments), parse_frame(arguments[2:])
    if interval_ns is None or frame is None:
        return b"syntax error"
    return b"" if manager.subscribe(frame[0], interval_ns, frame[1]) else b"too many subscriptions"


def _unsubscribe(manager: BroadcastManager, arguments: Sequence[bytes], now_ns: int) -> bytes:
    peer = parse_identifier(arguments[0]) if len(arguments) == 1 else None
    if peer is None:
        return b"syntax error"
    manager.subscriptions.pop(peer, None)
    return b""


def _add(manager: BroadcastManager, arguments: Sequence[bytes], now_ns: int) -> bytes:
    interval_ns, frame = parse_time(arguments), parse_frame(arguments[2:])
    if interval_ns is None or frame is None:
        return b"syntax error"
    return b"" if manager.add(frame[0], interval_ns, frame[1], now_ns) else b"too many jobs"


def _update(manager: BroadcastManager, arguments: Sequence[bytes], now_ns: int) -> bytes:
    frame = parse_frame(arguments)
    if frame is None:
        return b"syntax error"
    return b"" if manager.update(*frame) else b"too many jobs"


def _delete(manager: BroadcastManager, arguments: Sequence[bytes], now_ns: int) -> bytes:
    peer = parse_identifier(arguments[0]) if len(arguments) == 1 else None
    if peer is None:
        return b"syntax error"
    manager.jobs.pop(peer, None)
    return b""


BCM_COMMANDS: dict[bytes, Callable[[BroadcastManager, Sequence[bytes], int], bytes]] = {
    b"subscribe": _subscribe,
    b"unsubscribe": _unsubscribe,
    b"filter": _filter,
    b"add": _add,
    b"update": _update,
    b"delete": _delete,
}
"What BCM mode does beside `send` and `echo`; an answer says why it could not."
