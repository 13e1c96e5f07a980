"""A link in memory, for tests under a virtual clock: every byte with the nanosecond at which it left the line.

`open_link("loop:front", loops=loops)` makes the device's end, `loops["front"].connect()` a host's. On a serial line
every host hears everything, at any time; with a speed of its own (`baud`) it hears and sends garbage while the device
has another one, and its bytes take their time on the line. On a stream hosts are connections with numbers.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from emulator.errors import LinkError
from emulator.transports.link import Link, Received
from emulator.transports.pacing import GROUP_NS, Left, PacedLine, leave_ns
from emulator.transports.uart import Receiver, resample, same_speed
from emulator.transports.urls import parse_url
from protocols.session import LinkKind


@dataclass(slots=True)
class Arrival:
    """Bytes that reached a host, of one payload."""

    data: bytes
    left: Left
    "As the device sent them."
    garbled: bool = False

    @property
    def times_ns(self) -> NDArray[np.int64]:
        """When the last bit of each byte was through, (len(data),). Of garbage: when the piece it came from was."""
        return np.full(len(self.data), self.left.last_ns, dtype=np.int64) if self.garbled else self.left.times_ns()


class Loops:
    """The links of a test by their names."""

    def __init__(self) -> None:
        self._links: dict[str, LoopLink] = {}

    def __getitem__(self, name: str) -> LoopLink:
        return self._links[name]

    def add(self, link: LoopLink) -> None:
        """Keep a link; a name that is open already is refused, as a port in use would be."""
        old = self._links.get(link.name)
        if old is not None and old.is_open:
            raise LinkError(f"loop:{link.name}: in use; want another name")
        self._links[link.name] = link


def check_link_loop(url: str) -> None:
    """Judge the text of a `loop:` link; raises ValueError."""
    parse_url(url).allow()


def open_link_loop(url: str, *, serial_line: bool, loops: Loops | None) -> LoopLink:
    """A link in memory; `loops` keeps it for the host's side."""
    link = LoopLink(parse_url(url).target, serial_line)
    if loops is not None:
        loops.add(link)
    return link


class LoopHost:
    """A host's end."""

    def __init__(self, link: LoopLink, peer: int, baud: int | None) -> None:
        self._link = link
        self.peer = peer
        self.baud = baud
        "Its own speed on a serial line; None: always the device's, and what it writes arrives at once."
        self.arrivals: list[Arrival] = []
        "What has arrived and was not taken by `read`."
        self.connected = True
        "The link has not hung up; a line never does."
        self._busy_ns = 0
        self._receiver: Receiver | None = None

    def reconnect(self, at_ns: int) -> bool:
        """Connect again after a hang-up; False: refused."""
        return self._link.accept(self, at_ns)

    def write(self, data: bytes, at_ns: int) -> int:
        """Send from `at_ns` on, behind what is still being sent; when the last byte is through."""
        start_ns = max(at_ns, self._busy_ns)
        self._busy_ns = leave_ns(start_ns, len(data), self.baud)
        self._link.arrive(self, data, start_ns)
        return self._busy_ns

    def read(self) -> bytes:
        """All that has arrived since the last call."""
        if not self.arrivals:
            return b""
        data = b"".join([arrival.data for arrival in self.arrivals])
        self.arrivals.clear()
        return data

    def close(self, at_ns: int) -> None:
        """Leave."""
        self._link.leave(self, at_ns)

    def hear(self, left: Left) -> None:
        """Take what the device sent, as this end's receiver sees it."""
        if left.speed is None or self.baud is None or same_speed(self.baud, left.speed):
            self.arrivals.append(Arrival(left.data, left))
            return
        if self._receiver is None or left.starts or self._receiver.speeds != (left.speed, self.baud):
            self._receiver = Receiver(left.speed, self.baud)
        garbage = self._receiver.feed(left.data, idle_after=left.ends).values.tobytes()
        self._link.stats.bytes_garbled += len(left.data)
        if garbage:
            self.arrivals.append(Arrival(garbage, left, garbled=True))


@dataclass(frozen=True)
class _Input:
    at_ns: int
    event: Received
    host_baud: int | None = None


class LoopLink(Link):
    """The device's end."""

    reports_input = True

    def __init__(self, name: str, serial_line: bool = True, group_ns: int = GROUP_NS) -> None:
        super().__init__()
        self.name = name
        self.kind = LinkKind.SERIAL if serial_line else LinkKind.STREAM
        self.is_open = True
        self.wakes_whole = False
        "It wants to be asked for ends of payloads, not on the way to them; whoever asks gets what has left by then."
        self._line = PacedLine(group_ns=group_ns)
        self._now_ns = 0
        self._flushed_ns = -1
        "When the line was asked last, and has not been changed since."
        self._line_ns: int | None = None
        "When it wants to be asked again."
        self._hosts: dict[int, LoopHost] = {}
        self._hosts_seen = 0
        self._input: deque[_Input] = deque()
        self._addressed: deque[int | None] = deque()
        "For whom each payload on the line is."
        self._leaving: list[tuple[int, int | None]] = []
        "Connections that the device ends: behind how many payloads from now on, and whose."
        self._pulled = self._refusals = 0
        "How often the plug was pulled, and hosts are refused, not undone yet."
        self._orphans: dict[LoopHost, bool] = {}
        "Hosts of a network stack that has died, and whether it has been revived since."

    @property
    def url(self) -> str:
        return f"loop:{self.name}"

    def connect(self, at_ns: int = 0, baud: int | None = None) -> LoopHost:
        """A host that is there from `at_ns` on."""
        serial = self.kind is LinkKind.SERIAL
        self._hosts_seen += 1
        host = LoopHost(self, 0 if serial else self._hosts_seen, baud)
        self._hosts[self._hosts_seen] = host
        if not serial:
            self._note(_Input(at_ns, Received(host.peer, opened=True)))
        return host

    def accept(self, host: LoopHost, at_ns: int) -> bool:
        """A host that was disconnected comes again, under another number."""
        if self._pulled or self._refusals or self.kind is LinkKind.SERIAL:
            return False
        self.leave(host, at_ns)
        self._orphans.pop(host, None)
        self._hosts_seen += 1
        host.peer, host.connected = self._hosts_seen, True
        self._hosts[self._hosts_seen] = host
        self._note(_Input(at_ns, Received(host.peer, opened=True)))
        return True

    def unplug(self) -> None:
        self._pulled += 1
        self.reset_hosts()

    def plug(self) -> None:
        self._pulled = max(0, self._pulled - 1)

    def refuse_hosts(self, refuse: bool) -> None:
        self._refusals = max(0, self._refusals + (1 if refuse else -1))

    def reset_hosts(self) -> int:
        if self.kind is LinkKind.SERIAL:
            return 0
        hosts = list(self._hosts.values())
        for host in hosts:
            host.connected = False
            self.leave(host, self._now_ns)
        return len(hosts)

    def abandon_hosts(self) -> int:
        if self.kind is LinkKind.SERIAL:
            return 0
        self._refusals += 1
        hosts = list(self._hosts.values())
        self._hosts.clear()
        self._orphans |= dict.fromkeys(hosts, False)
        return len(hosts)

    def revive(self) -> None:
        self.refuse_hosts(False)
        self._orphans = dict.fromkeys(self._orphans, True)

    def leave(self, host: LoopHost, at_ns: int) -> None:
        """A host has gone."""
        for number, present in list(self._hosts.items()):
            if present is host:
                del self._hosts[number]
                if self.kind is LinkKind.STREAM:
                    self._note(_Input(at_ns, Received(host.peer, closed=True)))

    def arrive(self, host: LoopHost, data: bytes, start_ns: int) -> None:
        """A host's bytes, the first of which starts at `start_ns`; at its speed one by one, without one all at once."""
        if host in self._orphans:
            host.connected = not self._orphans[host]
            return
        if self._pulled or not host.connected:
            return
        if host.baud is None or self.kind is LinkKind.STREAM:
            self._note(_Input(start_ns, Received(host.peer, data)))
            return
        for index in range(len(data)):
            at_ns = leave_ns(start_ns, index + 1, host.baud)
            self._note(_Input(at_ns, Received(host.peer, data[index : index + 1]), host.baud))

    def _note(self, entry: _Input) -> None:
        if self.is_open:
            self._input.append(entry)
            if len(self._input) > 1 and entry.at_ns < self._input[-2].at_ns:
                self._input = deque(sorted(self._input, key=lambda item: item.at_ns))

    def filenos(self) -> tuple[int, ...]:
        return ()

    def receive(self, now_ns: int) -> list[Received]:
        self.flush(now_ns)
        events: list[Received] = []
        while self._input and self._input[0].at_ns <= now_ns:
            entry = self._input.popleft()
            self.stats.bytes_in += len(entry.event.data)
            event = self._as_heard(entry)
            if event.data and events and events[-1].data and events[-1].peer == event.peer:
                events[-1] = Received(event.peer, events[-1].data + event.data, foreign=_joined(events[-1], event))
            elif event.data or event.opened or event.closed:
                events.append(event)
        return events

    def _as_heard(self, entry: _Input) -> Received:
        device, host = self._line.speed, entry.host_baud
        if device is None or host is None or same_speed(device, host):
            return entry.event
        self.stats.bytes_garbled += len(entry.event.data)
        sent = entry.event.data
        return Received(entry.event.peer, resample(sent, host, device).values.tobytes(), foreign=(host, sent))

    def send(self, payload: bytes, due_ns: int, peer: int | None = None, line_speed: int | None = None) -> None:
        if not self.is_open:
            return
        self._flushed_ns = -1
        stream = self.kind is LinkKind.STREAM
        if self._line.put(payload, due_ns, None if stream else line_speed):
            if payload:
                self._addressed.append(peer if stream else None)
        else:
            self.stats.payloads_dropped += 1

    def hang_up(self, due_ns: int, peer: int | None = None) -> None:
        if self.kind is LinkKind.STREAM:
            self._leaving.append((len(self._addressed), peer))
            self._end_leaving(0)

    def cut(self, now_ns: int) -> None:
        if self.kind is LinkKind.SERIAL:
            self._flushed_ns = -1
            for _ in range(self._line.cut(now_ns)):
                self._addressed.pop()

    def flush(self, now_ns: int) -> int | None:
        input_ns = self._input[0].at_ns if self._input else None
        if not self._line.waiting:
            self._now_ns = now_ns
            return input_ns
        if now_ns != self._flushed_ns:
            self._let_leave(now_ns)
        line_ns = self._line_ns
        return line_ns if input_ns is None else input_ns if line_ns is None else min(line_ns, input_ns)

    def _let_leave(self, now_ns: int) -> None:
        """Hand to the hosts what has left the line."""
        self._now_ns = now_ns
        for left in self._line.take(now_ns):
            peer = self._addressed.popleft() if left.ends else self._addressed[0]
            input_budget_ns = [host for host in self._hosts.values() if not self._pulled and peer in (None, host.peer)]
            for host in input_budget_ns:
                host.hear(left)
                self.stats.bytes_out += len(left.data)
            if not input_budget_ns:
                self.stats.bytes_lost += len(left.data)
            if left.ends:
                self.stats.note_left(left.last_ns, now_ns)
                if self._leaving:
                    self._end_leaving(1)
        self._line_ns = self._line.next_ns(now_ns, self.wakes_whole)
        self._flushed_ns = now_ns

    def _end_leaving(self, left: int) -> None:
        """So many payloads have left."""
        self._leaving = [(count - left, peer) for count, peer in self._leaving]
        for _, peer in [one for one in self._leaving if one[0] <= 0]:
            for host in [host for host in self._hosts.values() if peer in (None, host.peer)]:
                host.connected = False
                self.leave(host, self._now_ns)
        self._leaving = [one for one in self._leaving if one[0] > 0]

    @property
    def speed(self) -> int | None:
        return self._line.speed

    def set_speed(self, baud: int | None) -> None:
        if self.kind is LinkKind.SERIAL:
            self._flushed_ns = -1
            self._line.set_speed(baud)

    def clear(self) -> int:
        self._flushed_ns = -1
        self._addressed.clear()
        self._leaving.clear()
        return self._line.clear()

    def close(self) -> None:
        self.is_open = False
        self._input.clear()
        self.clear()


def _joined(one: Received, other: Received) -> tuple[int, bytes] | None:
    """What both were sent as; of two speeds the later one's."""
    if one.foreign is None or other.foreign is None or one.foreign[0] != other.foreign[0]:
        return other.foreign
    return one.foreign[0], one.foreign[1] + other.foreign[1]
