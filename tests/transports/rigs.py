"""A link and the hosts on its other end, all links alike: what the conformance suite drives. Time is the test's own."""

from __future__ import annotations

import contextlib
import os
import select
import socket
import termios
from abc import ABC, abstractmethod
from collections.abc import Iterator
from pathlib import Path

from emulator.transports.link import Link, Received
from emulator.transports.loopback import LoopHost, LoopLink
from emulator.transports.pseudo_terminal import PseudoTerminal
from emulator.transports.schemes import open_link

TIME_LIMIT_S = 5.0
"Longest wait for something that the kernel has been given already."
STEP_NS = 2_000_000


class HostEnd(ABC):
    """A host."""

    @abstractmethod
    def write(self, data: bytes) -> None: ...

    @abstractmethod
    def read_now(self) -> bytes:
        """What has arrived, without waiting."""

    @abstractmethod
    def close(self) -> None: ...

    def wait(self) -> None:
        """Wait until something has arrived."""

    def read(self, count: int) -> bytes:
        """At least `count` bytes, or what came until nothing more did."""
        data = self.read_now()
        while len(data) < count:
            self.wait()
            more = self.read_now()
            if not more:
                break
            data += more
        return data


class FdHost(HostEnd):
    """A host on a descriptor."""

    def __init__(self, fd: int) -> None:
        self.fd = fd

    def write(self, data: bytes) -> None:
        while data:
            select.select([], [self.fd], [], TIME_LIMIT_S)
            data = data[os.write(self.fd, data) :]

    def read_now(self) -> bytes:
        data = b""
        with contextlib.suppress(BlockingIOError):
            while chunk := os.read(self.fd, 65_536):
                data += chunk
        return data

    def wait(self) -> None:
        select.select([self.fd], [], [], TIME_LIMIT_S)

    def close(self) -> None:
        if self.fd >= 0:
            os.close(self.fd)
            self.fd = -1


class SocketHost(FdHost):
    """A host on a socket."""

    def __init__(self, endpoint: socket.socket) -> None:
        endpoint.setblocking(False)
        self.socket = endpoint
        super().__init__(endpoint.fileno())

    def close(self) -> None:
        self.socket.close()


class MemoryHost(HostEnd):
    """A host on a loop."""

    def __init__(self, rig: LoopRig, end: LoopHost) -> None:
        self.rig = rig
        self.end = end

    def write(self, data: bytes) -> None:
        self.end.write(data, self.rig.now_ns)

    def read_now(self) -> bytes:
        return self.end.read()

    def close(self) -> None:
        self.end.close(self.rig.now_ns)


class Rig(ABC):
    """One link under test."""

    paced = True
    huge = 200_000
    "Bytes of a payload that the link must still carry."
    connections = False
    "Hosts are told apart."
    knows_absence = True
    "Without a host the bytes are counted as lost."

    def __init__(self, folder: Path) -> None:
        self.now_ns = 1_000_000_000
        self.folder = folder
        self._hosts: list[HostEnd] = []
        self.link = self.open()

    @abstractmethod
    def open(self) -> Link: ...

    @abstractmethod
    def _connect(self) -> HostEnd: ...

    def connect(self) -> HostEnd:
        """A host, of which the link may not know yet."""
        end = self._connect()
        self._hosts.append(end)
        return end

    def host(self) -> HostEnd:
        """A host of which the link knows."""
        end = self.connect()
        if self.connections:
            self.wait_input()
        return end

    def wait_input(self) -> list[Received]:
        """What comes in next."""
        if self.link.filenos():
            select.select(self.link.filenos(), [], [], TIME_LIMIT_S)
        return self.link.receive(self.now_ns)

    def take_input(self, count: int) -> list[Received]:
        """Events until `count` bytes have come in."""
        events = self.link.receive(self.now_ns)
        for _ in range(1000):
            if sum(len(event.data) for event in events) >= count:
                return events
            events += self.wait_input()
        raise AssertionError(f"only {events} came in")

    def advance(self, duration_ns: int, hosts: list[HostEnd] | None = None) -> dict[int, bytes]:
        """Let time pass as the daemon would, woken at least every `STEP_NS`; what the hosts read meanwhile."""
        end_ns = self.now_ns + duration_ns
        read: dict[int, bytes] = {id(host): b"" for host in hosts or []}
        while True:
            self.link.receive(self.now_ns)
            wake = self.link.flush(self.now_ns)
            for host in hosts or []:
                read[id(host)] += host.read_now()
            if self.now_ns >= end_ns:
                return read
            steps = [end_ns, self.now_ns + STEP_NS] + ([] if wake is None else [max(wake, self.now_ns + 1)])
            self.now_ns = min(steps)

    def close(self) -> None:
        for host in self._hosts:
            host.close()
        self.link.close()


class PtyRig(Rig):
    def open(self) -> Link:
        return open_link(f"pty:{self.folder / 'port'}?speed=ignore")

    def _connect(self) -> HostEnd:
        link = self.link
        assert isinstance(link, PseudoTerminal)
        host = FdHost(os.open(self.folder / "port", os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK))
        link.flush(self.now_ns)
        return host


class SerialRig(Rig):
    """A real port's code path; the port is the slave of a pseudo-terminal, the host holds its master."""

    huge = 3_000
    knows_absence = False
    paced = False  # the UART paces; there is none here

    def open(self) -> Link:
        self.master, slave = os.openpty()
        modes = termios.tcgetattr(slave)
        modes[3] = 0
        termios.tcsetattr(slave, termios.TCSANOW, modes)
        os.set_blocking(self.master, False)
        link = open_link(f"serial:{os.ttyname(slave)}?baud=9600")
        os.close(slave)
        return link

    def _connect(self) -> HostEnd:
        return FdHost(os.dup(self.master))

    def close(self) -> None:
        super().close()
        os.close(self.master)


class TcpRig(Rig):
    connections = True
    serial_line = False
    paced = False

    def open(self) -> Link:
        return open_link("tcp:127.0.0.1:0", self.serial_line)

    def _connect(self) -> HostEnd:
        port = int(self.link.url.rpartition(":")[2])
        return SocketHost(socket.create_connection(("127.0.0.1", port), TIME_LIMIT_S))


class TcpLineRig(TcpRig):
    serial_line = True
    paced = True


class UdpRig(Rig):
    serial_line = False
    paced = False
    huge = 60_000
    knows_absence = False

    def open(self) -> Link:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        return open_link(f"udp:127.0.0.1:{self.socket.getsockname()[1]}?listen=0", self.serial_line)

    def _connect(self) -> HostEnd:
        other = self.socket.dup()
        other.connect(("127.0.0.1", int(self.link.url.rpartition(":")[2])))
        return SocketHost(other)

    def close(self) -> None:
        super().close()
        self.socket.close()


class UdpLineRig(UdpRig):
    serial_line = True
    paced = True


class LoopRig(Rig):
    serial_line = True

    def open(self) -> Link:
        return open_link("loop:test", self.serial_line)

    def _connect(self) -> HostEnd:
        assert isinstance(self.link, LoopLink)
        return MemoryHost(self, self.link.connect(self.now_ns))


class LoopStreamRig(LoopRig):
    serial_line = False
    paced = False
    connections = True


RIGS: dict[str, type[Rig]] = {
    "pty": PtyRig,
    "serial": SerialRig,
    "tcp as a line": TcpLineRig,
    "tcp": TcpRig,
    "udp as a line": UdpLineRig,
    "udp": UdpRig,
    "loop": LoopRig,
    "loop as a stream": LoopStreamRig,
}
"Every byte link, by name."


@contextlib.contextmanager
def rig_of(name: str, folder: Path) -> Iterator[Rig]:
    """A rig, closed at the end."""
    rig = RIGS[name](folder)
    try:
        yield rig
    finally:
        rig.close()
