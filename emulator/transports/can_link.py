"""What all CAN links share: sensors and hosts as nodes of one emulated bus.

Belongs here: the `Link` of a sensor on a bus, the bus with its way out (`CanPort`), and the buses of a run, so that two
sensors that name the same link sit on the same bus. Not: how hosts are reached (socketcand, slcan, python-can), and who
sends next (`can_wire`).
"""

from __future__ import annotations

import contextlib
import os
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from emulator.errors import LinkError
from emulator.transports.can_wire import CanWire, Carried, Node, Notice
from emulator.transports.link import Link, LinkIncident, Received
from emulator.transports.turns import CROWD_NS, Turn
from protocols.session import LinkKind

BITRATE = 500_000
"Default bit rate of a bus."
GROUP_NS = 2_000_000
"Frames of hosts that follow each other are looked at together, so long, while no sensor has one to send."
MOST_LISTENERS = 8
"Hosts to whom each frame is shown when it ends; more of them get those of `GROUP_NS` in one piece."
AT_ONCE_FRAMES = 64
"Frames that are carried at once on a bus whose time is limited; other sensors come before the rest."
LOWEST_BITRATE, HIGHEST_BITRATE = 10_000, 1_000_000


@dataclass
class CanCounters:
    """What a CAN link counts beside the link's own statistics."""

    frames_sent: int = 0
    frames_received: int = 0
    overload_drops: int = 0
    "Frames of the sensor that found no room at its controller, or lost while it was off the bus."
    bus_offs: int = 0
    state: str = "active"
    "active | error passive | bus off"
    host_frames: int = 0
    "Frames that hosts put on the bus."
    host_drops: int = 0
    "Frames of hosts that found no room."
    malformed: int = 0
    "Things hosts said that are no frame and no command."


class Outlet(ABC):
    """How hosts are reached on one bus."""

    def __init__(self) -> None:
        self.counters = CanCounters()
        "Those of hosts; the links count their own."
        self.failure: str | None = None
        "What is gone for good, once it is."

    def attached(self, port: CanPort) -> None:
        """The bus that this is the way out of is there."""
        return None

    @property
    @abstractmethod
    def url(self) -> str:
        """What a host needs to connect."""

    @abstractmethod
    def filenos(self) -> tuple[int, ...]:
        """Descriptors that become readable when `poll` has something to do."""

    @abstractmethod
    def poll(self, now_ns: int) -> None:
        """Take what hosts sent and put their frames on the bus."""

    @abstractmethod
    def deliver(self, carried: Sequence[Carried], now_ns: int) -> bool:
        """Show frames to hosts; whether anybody listens."""

    def notify(self, notices: Sequence[Notice]) -> None:
        """Tell hosts of error states, where they have a word for it."""
        return None

    def listeners(self) -> int:
        """Hosts to whom each frame has to be shown one by one."""
        return 1

    def next_ns(self) -> int | None:
        """When `poll` has something to do even if nothing arrives."""
        return None

    @property
    def path(self) -> str | None:
        """As of a link."""
        return None

    def tend(self, now_ns: int) -> list[LinkIncident]:
        """As of a link."""
        return []

    def held(self) -> int:
        """Bytes that hosts have not read, as far as that can be known."""
        return 0

    def has_host(self) -> bool:
        """Whether somebody listens; True where that cannot be known."""
        return True

    @abstractmethod
    def close(self) -> None:
        """Release everything."""


class LoopOutlet(Outlet):
    """A bus whose hosts live in this process: nobody else can connect."""

    @property
    def url(self) -> str:
        return "loop:can"

    def filenos(self) -> tuple[int, ...]:
        return ()

    def close(self) -> None:
        pass


class CanPort:
    """One bus and its way out; runs when any of its links is asked."""

    def __init__(self, wire: CanWire, outlet: Outlet, on_closed: Callable[[], None] = lambda: None) -> None:
        self.wire = wire
        self.outlet = outlet
        self.links: list[CanLink] = []
        self._on_closed = on_closed
        self._asking: CanLink | None = None
        self.turn = Turn()
        "Of all that happens on this bus. While it rests, the bus stands."
        self._rests = False
        self._untrusted_until_ns = 0
        """Hosts said something, or had frames on the bus, a moment ago: until then time is counted. What sensors alone
        say is not limited."""
        self._crowded_ns: int | None = None
        "When frames of hosts were carried, and none of a sensor waited."
        outlet.attached(self)

    def run(self, now_ns: int, asking: CanLink | None = None) -> None:
        """Let hosts speak, then everything happen on the bus up to `now_ns`."""
        self._rests = self.turn.rests(now_ns)
        if self._rests:
            return
        self._asking = asking
        timed = self.turn.clock_ns is not None
        began_ns = self.turn.begin() if timed and now_ns < self._untrusted_until_ns else None
        said = self.outlet.counters.host_frames + self.outlet.counters.malformed
        self.outlet.poll(now_ns)
        carried = self.wire.take(now_ns, AT_ONCE_FRAMES if timed else None)
        if carried:
            heard = self.outlet.deliver(carried, now_ns)
            for link in self.links:
                link.take(carried, heard, now_ns)
        if self.wire.notices:
            notices, self.wire.notices = self.wire.notices, []
            self.outlet.notify(notices)
            for link in self.links:
                link.note(notices)
        self._asking = None
        if timed:
            said = self.outlet.counters.host_frames + self.outlet.counters.malformed - said
            self._judge(now_ns, bool(said), carried)
        if began_ns is not None and self.turn.end(began_ns, now_ns):
            self._rests = True
            self.wire.stall(self.turn.wake_ns(now_ns) or now_ns)

    def _judge(self, now_ns: int, said: bool, carried: Sequence[Carried]) -> None:
        """See whether it is hosts that keep this bus busy, and whether what they say may wait a little."""
        many = self.outlet.listeners() > MOST_LISTENERS
        own = [link.node for link in self.links]
        if said or many or any(frame.node not in own for frame in carried):
            self._untrusted_until_ns = now_ns + CROWD_NS
        exact = not many and any(node.waiting for node in own)
        self._crowded_ns = now_ns if now_ns < self._untrusted_until_ns and not exact else None

    @property
    def resting(self) -> bool:
        """The bus stands, as far as was seen when it ran last or was asked when to run."""
        return self._rests

    def inject(self, received: Sequence[Received]) -> None:
        """Frames that were on a real bus already: they go to every sensor, not to the emulated wire."""
        for link in self.links:
            link.inject(received)

    def wake_others(self, link: CanLink) -> bool:
        """Whether `link` is not the one that is being asked and must be woken."""
        return link is not self._asking

    def next_ns(self, now_ns: int) -> int | None:
        """When `run` should be called again."""
        if (until_ns := self.turn.wake_ns(now_ns)) is not None:
            return until_ns
        wire_ns = self.wire.next_ns()
        if wire_ns is not None and self._crowded_ns is not None:
            wire_ns = max(wire_ns, self._crowded_ns + GROUP_NS)
        times = [time for time in (wire_ns, self.outlet.next_ns()) if time is not None]
        return min(times) if times else None

    def remove(self, link: CanLink) -> None:
        """A sensor leaves; the last one closes the way out."""
        self.wire.leave(link.node)
        self.links.remove(link)
        if not self.links:
            self.outlet.close()
            self._on_closed()


class CanLink(Link):
    """One sensor on a bus."""

    kind = LinkKind.CAN

    def __init__(self, port: CanPort) -> None:
        super().__init__()
        self._port: CanPort | None = port
        self._last_url = port.outlet.url
        self.wire = port.wire
        self.node: Node = port.wire.join(f"sensor {len(port.links) + 1}")
        self.can = CanCounters()
        self.on_carried: Callable[[Carried, bool], None] | None = None
        "Called with each frame of the bus and whether it is this sensor's own."
        self._inbox: deque[Received] = deque()
        self._wake_fd: int | None = None
        port.links.append(self)
        if len(port.links) > 1:
            for link in port.links:
                link.share()

    @property
    def url(self) -> str:
        return self._last_url if self._port is None else self._port.outlet.url

    @property
    def turn(self) -> Turn | None:
        return None if self._port is None else self._port.turn

    @property
    def path(self) -> str | None:
        return self._port.outlet.path if self._port is not None and self._port.links[0] is self else None

    def tend(self, now_ns: int) -> list[LinkIncident]:
        return self._port.outlet.tend(now_ns) if self._port is not None and self._port.links[0] is self else []

    def share(self) -> None:
        """Make a descriptor by which another sensor's run can wake this one."""
        if self._wake_fd is None:
            self._wake_fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)

    def wake(self) -> None:
        """Make the wake descriptor readable."""
        if self._wake_fd is not None:
            os.eventfd_write(self._wake_fd, 1)

    def filenos(self) -> tuple[int, ...]:
        if self._port is None:
            return ()
        own = () if self._wake_fd is None else (self._wake_fd,)
        # a descriptor may be watched once: the first sensor of the bus does it
        if self._port.resting:
            return own
        return (*self._port.outlet.filenos(), *own) if self._port.links[0] is self else own

    def receive(self, now_ns: int) -> list[Received]:
        if self._port is None:
            return []
        if self._wake_fd is not None:
            with contextlib.suppress(BlockingIOError):
                os.eventfd_read(self._wake_fd)
        self._port.run(now_ns, self)
        if self._port.outlet.failure is not None:
            failure, self._port.outlet.failure = self._port.outlet.failure, None
            raise LinkError(failure)
        found = list(self._inbox)
        self._inbox.clear()
        return found

    def send(self, payload: bytes, due_ns: int, peer: int | None = None, line_speed: int | None = None) -> None:
        if self._port is None:
            return
        if peer is None or not self.wire.put(self.node, peer, payload, due_ns):
            self.stats.payloads_dropped += 1
            self.can.overload_drops += 1

    def flush(self, now_ns: int) -> int | None:
        if self._port is None:
            return None
        self._port.run(now_ns, self)
        if self._inbox:
            return now_ns
        return self._port.next_ns(now_ns)

    def clear(self) -> int:
        return self.wire.clear(self.node)

    def close(self) -> None:
        if self._port is None:
            return
        port, self._port = self._port, None
        self._last_url = port.outlet.url
        port.remove(self)
        if self._wake_fd is not None:
            os.close(self._wake_fd)
            self._wake_fd = None

    def held(self) -> int:
        return 0 if self._port is None else self._port.outlet.held()

    def has_host(self) -> bool:
        return self._port is not None and self._port.outlet.has_host()

    def disturb(self, frames: int) -> None:
        """Fault: the next `frames` frames of this sensor are destroyed on the bus; 32 in a row take it off."""
        self.wire.disturb(self.node, frames)

    def restart(self, now_ns: int) -> None:
        """The end of that fault: firmware waits no longer with starting a controller that is off the bus."""
        self.wire.restart(self.node, now_ns)

    @property
    def hosts(self) -> CanCounters:
        """What hosts on the same bus did."""
        return CanCounters() if self._port is None else self._port.outlet.counters

    def load(self, now_ns: int) -> float:
        """Share of the last second in which the bus was taken."""
        return self.wire.load(now_ns)

    def take(self, carried: Sequence[Carried], heard: bool, now_ns: int) -> None:
        """Frames that were on the bus: own ones are counted, others received."""
        before = len(self._inbox)
        for frame in carried:
            if self.on_carried is not None:
                self.on_carried(frame, frame.node is self.node)
            if frame.node is self.node:
                self.can.frames_sent += 1
                self.stats.note_left(frame.end_ns, now_ns)
                if heard:
                    self.stats.bytes_out += len(frame.data)
                else:
                    self.stats.bytes_lost += len(frame.data)
            else:
                self._hear(Received(frame.peer, frame.data))
        self._wake_for(before)

    def inject(self, received: Sequence[Received]) -> None:
        """Frames from a real bus."""
        before = len(self._inbox)
        for frame in received:
            self._hear(frame)
        self._wake_for(before)

    def note(self, notices: Sequence[Notice]) -> None:
        """Error states of this sensor's controller."""
        for notice in notices:
            if notice.node is self.node:
                self.can.state = "active" if notice.state == "recovered" else notice.state
                self.can.bus_offs = self.node.bus_offs
                lost = self.node.dropped - self.can.overload_drops
                if lost > 0:
                    self.can.overload_drops += lost
                    self.stats.payloads_dropped += lost

    def _hear(self, frame: Received) -> None:
        self._inbox.append(frame)
        self.can.frames_received += 1
        self.stats.bytes_in += len(frame.data)

    def _wake_for(self, before: int) -> None:
        if len(self._inbox) > before and self._port is not None and self._port.wake_others(self):
            self.wake()


class Server(Protocol):
    """Something that carries several buses."""

    def close(self) -> None: ...


class DriverSockets(Protocol):
    """Gives drivers under the preload shim an interface for each bus: `can_sockets.CanSockets`."""

    def outlet(self, name: str, url: str) -> Outlet: ...

    def set_stamps(self, stamp_ns: Callable[[int], int]) -> None: ...


class CanPorts:
    """The buses of a run by the text of their links: sensors that name the same one share it."""

    def __init__(self, sockets: DriverSockets | None = None, stamp_ns: Callable[[int], int] | None = None) -> None:
        self.sockets = sockets
        "None: there is no shim."
        self.stamp_ns = stamp_ns
        "From the run's time to the time stamps that hosts see, in ns; None: they are the run's own."
        if sockets is not None and stamp_ns is not None:
            sockets.set_stamps(stamp_ns)
        self._ports: dict[str, CanPort] = {}
        self.servers: dict[tuple[str, int], Server] = {}
        "Servers that carry several buses, by what their links say of host and port."

    def link(self, key: str, make: Callable[[], tuple[CanWire, Outlet]]) -> CanLink:
        """A new sensor on the bus of that text, which is made when it is the first."""
        port = self._ports.get(key)
        if port is None:
            wire, outlet = make()
            port = self._ports[key] = CanPort(wire, outlet, lambda: self._forget(key))
        return CanLink(port)

    def _forget(self, key: str) -> None:
        self._ports.pop(key, None)
