"""Links over any python-can interface: `virtual` in process, `socketcan` and adapters where the machine has them.

Belongs here: python-can's bus as a way out of our own. Not: socketcand and slcan, where we are the other side.
Frames are spaced by our own bus at its bit rate before the interface gets them. Loaded only when such a link is opened.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any

from emulator.errors import LinkError
from emulator.transports.can_link import BITRATE, HIGHEST_BITRATE, LOWEST_BITRATE, CanPort, CanPorts, Outlet
from emulator.transports.can_wire import CanWire, Carried
from emulator.transports.link import Link, Received
from emulator.transports.urls import LinkUrl, option_value, parse_url
from protocols.can_frame import EXTENDED, split_identifier

POLL_NS = 1_000_000
"How often an interface without a descriptor is looked at."
READ_LIMIT = 2_000
"Frames taken in one call."
GAPS_US = {"udp_multicast": 200}
"""Interfaces that lose frames when they come in a burst, with the least time between two. Measured with python-can's
multicast: without a gap up to half are lost in the receiver's socket buffer, with 250 us none."""
OURS = ("bitrate", "gap_us")
"Options of the link that are not, or not only, python-can's."
KNOWS_BITRATE = frozenset({"pcan", "kvaser", "vector", "ixxat", "slcan", "canalystii", "gs_usb", "nican", "usb2can"})
"Interfaces that set the bit rate of their hardware when they are opened."
CAN_ERR_BUSOFF = 0x40
"linux/can/error.h."


def check_link_can(url: str) -> None:
    """Judge the text of a `can:` link; raises ValueError."""
    _numbers(*_parts(url)[:2])


def open_link_can(url: str, *, can_ports: CanPorts | None = None, can_bitrate: int | None = None) -> Link:
    """A sensor on the bus that `can:INTERFACE:CHANNEL[?bitrate=...&gap_us=...&KEY=VALUE]` names; raises LinkError.

    Further options go to python-can. `can_ports`: the buses of the run; sensors that give the same text share one.
    Under the preload shim a `socketcan` interface that the kernel does not have is ours.
    """
    parts, interface, channel = _parts(url)
    bitrate, gap_ns = _numbers(parts, interface, can_bitrate)
    ports = can_ports if can_ports is not None else CanPorts()

    def make() -> tuple[CanWire, Outlet]:
        if interface == "socketcan" and ports.sockets is not None:
            from emulator.transports.can_sockets import kernel_has, socket_bus

            if not kernel_has(channel):
                return socket_bus(ports.sockets, channel, url, bitrate)
        options: dict[str, Any] = {key: option_value(text) for key, text in parts.options.items() if key not in OURS}
        if interface in KNOWS_BITRATE:
            options["bitrate"] = bitrate
        return CanWire(bitrate), Interface(url, interface, channel, options, gap_ns)

    return ports.link(f"can:{interface}:{channel}", make)


def _parts(url: str) -> tuple[LinkUrl, str, str]:
    from can.interfaces import VALID_INTERFACES

    parts = parse_url(url)
    interface, colon, channel = parts.target.partition(":")
    if interface not in VALID_INTERFACES:
        raise ValueError(f"{url!r}: interface {interface!r}; want one of {', '.join(sorted(VALID_INTERFACES))}")
    if not colon or not channel:
        raise ValueError(f"{url!r}: no channel; want can:INTERFACE:CHANNEL, for example can:socketcan:vcan0")
    return parts, interface, channel


def _numbers(parts: LinkUrl, interface: str, default_bitrate: int | None = None) -> tuple[int, int]:
    """Bit rate, and the least time between two frames in nanoseconds."""
    bitrate = parts.number("bitrate", default_bitrate or BITRATE, LOWEST_BITRATE, HIGHEST_BITRATE)
    return bitrate, 1000 * parts.number("gap_us", GAPS_US.get(interface, 0), 0, 1_000_000)


class Interface(Outlet):
    """A python-can bus."""

    def __init__(self, url: str, interface: str, channel: str, options: dict[str, Any], gap_ns: int) -> None:
        import can

        super().__init__()
        self._text = url
        self._gap_ns = gap_ns
        self._gap_ends_ns = 0
        self._waiting: deque[Carried] = deque()
        self._port: CanPort | None = None
        self._error = can.CanError
        self._make_message = can.Message
        try:
            self._bus = can.Bus(channel=channel, interface=interface, **options)
        except (can.CanError, OSError, ImportError, NotImplementedError, TypeError, ValueError) as error:
            raise LinkError(f"{url}: cannot be opened: {error}") from None
        self._fileno = self._descriptor()
        self._closed = False
        self._polled_ns = 0

    def _descriptor(self) -> int:
        try:
            return int(self._bus.fileno())
        except (NotImplementedError, OSError, self._error):
            return -1

    def attached(self, port: CanPort) -> None:
        self._port = port

    @property
    def url(self) -> str:
        return self._text

    def filenos(self) -> tuple[int, ...]:
        return () if self._fileno < 0 or self._closed else (self._fileno,)

    def poll(self, now_ns: int) -> None:
        self._polled_ns = now_ns
        found: list[Received] = []
        for _ in range(READ_LIMIT):
            try:
                message = self._bus.recv(0)
            except (self._error, OSError) as error:
                self.failure = f"{self._text}: lost: {error}"
                break
            if message is None:
                break
            if message.is_error_frame:
                self._note_error(message.arbitration_id)
            elif message.is_remote_frame or message.is_fd:
                self.counters.malformed += 1  # no sensor here answers remote or FD frames
            else:
                flag = EXTENDED if message.is_extended_id else 0
                found.append(Received(message.arbitration_id | flag, bytes(message.data)))
        self.counters.host_frames += len(found)
        if found and self._port is not None:
            self._port.inject(found)
        self._send_waiting(now_ns)

    def next_ns(self) -> int | None:
        times = [self._gap_ends_ns] if self._waiting else []
        if self._fileno < 0:
            times.append(self._polled_ns + POLL_NS)
        return min(times) if times else None

    def deliver(self, carried: Sequence[Carried], now_ns: int) -> bool:
        self._waiting.extend(carried)
        self._send_waiting(now_ns)
        return True

    def close(self) -> None:
        if not self._closed:
            self._closed = True
            self._bus.shutdown()

    def _send_waiting(self, now_ns: int) -> None:
        while self._waiting and self._gap_ends_ns <= now_ns:
            frame = self._waiting.popleft()
            identifier, extended = split_identifier(frame.peer)
            message = self._make_message(
                timestamp=frame.end_ns * 1e-9, arbitration_id=identifier, is_extended_id=extended, data=frame.data
            )
            try:
                self._bus.send(message, timeout=0)
            except (self._error, OSError, ValueError):  # its queue is full, or it is off the bus
                if self._port is not None:
                    self._port.links[0].stats.payloads_dropped += 1
                    self._port.links[0].can.overload_drops += 1
            if self._gap_ns:
                self._gap_ends_ns = now_ns + self._gap_ns

    def _note_error(self, identifier: int) -> None:
        if identifier & CAN_ERR_BUSOFF and self._port is not None:
            for link in self._port.links:
                link.can.bus_offs += 1
                link.can.state = "bus off"
