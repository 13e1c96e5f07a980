"""What this machine allows the links to do, tried out: small questions for `lidaremu doctor`. Nothing stays open."""

from __future__ import annotations

import contextlib
import os
import select
import socket
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fcntl import ioctl
from pathlib import Path

from serial.tools import list_ports

from emulator.transports.inotify import OpenWatch
from emulator.transports.shim import COMPILERS, find_compiler
from emulator.transports.tty_modes import TCGETS2, TERMIOS2, read_modes

TCSETS2 = 0x402C542B
"linux/asm-generic/ioctls.h: _IOW('T', 0x2B, struct termios2)."
CBAUD, BOTHER = 0x100F, 0x1000
GROUP = "239.255.76.1"
"Administratively scoped (RFC 2365): never leaves a site."


INTERFACES, SEND_BUFFER = Path("/sys/class/net"), Path("/proc/sys/net/core/wmem_default")
IP_UDP_BYTES = 28
"Headers of IPv4 and UDP."
JUMBO_MTU, LOOPBACK_MTU = 9000, 65_536
LARGEST_BYTES = 24_896
"A lidar packet of 128 rows and 16 columns, legacy profile."


@dataclass(frozen=True)
class Probe:
    """One question and its answer."""

    name: str
    works: bool
    detail: str


def probe_pseudo_terminals() -> Probe:
    """Whether a pseudo-terminal can be had and takes any speed, seen from the other end."""
    try:
        master, slave = os.openpty()
    except OSError as error:
        return Probe("pseudo-terminals", False, f"none: {error.strerror}")
    seen = []
    try:
        for baud in (9600, 500_000, 123_457):
            modes = list(TERMIOS2.unpack(ioctl(slave, TCGETS2, bytes(TERMIOS2.size))))
            modes[2], modes[5], modes[6] = (modes[2] & ~CBAUD) | BOTHER, baud, baud
            ioctl(slave, TCSETS2, TERMIOS2.pack(*modes))
            if read_modes(master).sends_baud == baud:
                seen.append(baud)
    except OSError as error:
        return Probe("pseudo-terminals", False, f"speeds cannot be set: {error.strerror}")
    finally:
        os.close(master)
        os.close(slave)
    return Probe("pseudo-terminals", len(seen) == 3, f"speeds seen from the other end: {', '.join(map(str, seen))}")


def probe_open_watch() -> Probe:
    """Whether a host that opens a pseudo-terminal wakes us at once (inotify), or is found by looking every 10 ms."""
    try:
        OpenWatch("/").close()
    except OSError as error:
        return Probe("notice of opens", False, f"no inotify: {error}; pseudo-terminals are polled every 10 ms")
    return Probe("notice of opens", True, "inotify")


def probe_compiler(environment: Mapping[str, str]) -> Probe:
    """Whether the preload shim can be built."""
    found = find_compiler(environment)
    return Probe("C compiler for --shim", found is not None, found or f"none of {', '.join(COMPILERS)}")


def probe_multicast() -> Probe:
    """Whether a multicast datagram comes back on the loopback interface."""
    with contextlib.ExitStack() as stack:
        try:
            receiver = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            sender = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            receiver.bind((GROUP, 0))
            membership = struct.pack("4s4s", socket.inet_aton(GROUP), socket.inet_aton("127.0.0.1"))
            receiver.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
            sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
            sender.sendto(b"probe", (GROUP, receiver.getsockname()[1]))
        except OSError as error:
            return Probe("multicast on 127.0.0.1", False, str(error.strerror))
        came = bool(select.select([receiver], [], [], 0.5)[0])
    return Probe("multicast on 127.0.0.1", came, "a datagram was received" if came else "no datagram was received")


ARPHRD_CAN = "280"
"linux/if_arp.h: type of a CAN interface under /sys/class/net."


def probe_socketcan() -> Probe:
    """Whether the kernel speaks CAN, and its interfaces; socketcand and slcan need neither."""
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except (OSError, AttributeError) as error:
        return Probe("SocketCAN", False, f"not in this kernel ({error}); socketcand: and slcan: links need none")
    names = []
    for folder in Path("/sys/class/net").glob("*"):
        with contextlib.suppress(OSError):
            if (folder / "type").read_text().strip() == ARPHRD_CAN:
                names.append(folder.name)
    return Probe("SocketCAN", bool(names), ", ".join(sorted(names)) or "in the kernel, but no interface is up")


def probe_adapters() -> Probe:
    """The serial ports of this machine."""
    ports = sorted(f"{port.device} ({port.description})" for port in list_ports.comports())
    return Probe("serial ports", bool(ports), ", ".join(ports) or "none")


def probe_datagrams(folder: Path = INTERFACES, buffer: Path = SEND_BUFFER) -> Probe:
    """Largest datagrams that the interfaces carry whole, and how many bytes a socket holds until they have left."""
    found = []
    for name in sorted(path.name for path in folder.glob("*")) if folder.is_dir() else ():
        with contextlib.suppress(OSError, ValueError):
            mtu = int((folder / name / "mtu").read_text())
            whole = min(mtu, 65_535) - IP_UDP_BYTES
            kind = "jumbo, " if JUMBO_MTU <= mtu < LOOPBACK_MTU else ""
            found.append(f"{name} {mtu} ({kind}datagrams to {whole} bytes leave whole)")
    if not found:
        return Probe("datagrams", False, "the MTU of the interfaces cannot be read")
    held = "unknown"
    with contextlib.suppress(OSError, ValueError):
        held = str(int(buffer.read_text()))
    largest = f"larger ones, as an Ouster's of {LARGEST_BYTES} bytes, leave in fragments"
    return Probe("datagrams", True, f"MTU of {', '.join(found)}; {largest}; send buffer {held} bytes")


def probe_links(environment: Mapping[str, str]) -> tuple[Probe, ...]:
    """All of them."""
    questions: tuple[Callable[[], Probe], ...] = (
        probe_pseudo_terminals,
        probe_open_watch,
        lambda: probe_compiler(environment),
        probe_multicast,
        probe_datagrams,
        probe_socketcan,
        probe_adapters,
    )
    return tuple(question() for question in questions)
