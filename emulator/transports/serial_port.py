"""A real serial port or adapter, through pyserial. The device, not the URL, sets the speed once it runs.

The UART paces itself, so a payload is handed over whole when it is due. A change of speed waits until the last bit is
through: the driver's queue is empty, the transmitter says so where it can be asked, and the time that the bytes take on
the line has passed (an adapter on USB reports an empty queue while its own buffer still sends).

An adapter that is pulled out, or that refuses a speed, makes the next `receive` raise `LinkError`, once; from then on
the link is silent.
"""

from __future__ import annotations

import array
import contextlib
import fcntl
import os
import select
import termios
from collections import deque
from dataclasses import dataclass

import serial
from serial.tools import list_ports

from emulator.errors import LinkError
from emulator.transports.link import Link, Received
from emulator.transports.pacing import QUEUE_LIMIT, PacedLine, leave_ns
from emulator.transports.tty_modes import waiting_output
from emulator.transports.urls import parse_url
from protocols.session import LinkKind

TIOCSERGETLSR, TIOCSER_TEMT = 0x5459, 0x01
"linux/serial.h: the transmitter is empty."
RETRY_NS = 2_000_000
"How often a full driver, or a transmitter that is not empty yet, is looked at again."
READ_SIZE = 65_536
FAULTS = (OSError, ValueError, termios.error)
"What pyserial and the system raise at a port that has gone or does not know a setting."
PARITIES = ("N", "E", "O", "M", "S")


def check_link_serial(url: str) -> None:
    """Judge the text of a `serial:` link; raises ValueError."""
    parts = parse_url(url)
    parts.allow("baud", "parity", "stop")
    parts.number("baud", 9600, 50, 20_000_000)
    parts.choice("parity", PARITIES)
    parts.choice("stop", ("1", "2"))


def open_link_serial(url: str) -> SerialPort:
    """Open the port that `serial:DEVICE?...` names; raises LinkError."""
    parts = parse_url(url)
    baud = parts.number("baud", 9600, 50, 20_000_000)
    return SerialPort(parts.target, baud, parts.choice("parity", PARITIES), int(parts.choice("stop", ("1", "2"))))


@dataclass
class _Waiting:
    data: memoryview
    due_ns: int
    speed_after: int | None
    ends_ns: int | None = None
    "When its last bit should leave; None: nobody records it."


class SerialPort(Link):
    """One serial line that the operating system drives."""

    kind = LinkKind.SERIAL

    def __init__(self, device: str, baud: int = 9600, parity: str = "N", stop: int = 1) -> None:
        super().__init__()
        self._device = device
        try:
            self._port = serial.Serial(
                device, baud, parity=parity, stopbits=stop, timeout=0, write_timeout=0, exclusive=True
            )
        except FAULTS as error:
            known = ", ".join(sorted(port.device for port in list_ports.comports())) or "none"
            reason = os.strerror(error.errno) if isinstance(error, OSError) and error.errno else str(error)
            raise LinkError(f"serial:{device}: cannot be opened: {reason}; ports of this machine: {known}") from None
        self._fd: int = self._port.fileno()
        self._poll = select.poll()
        self._poll.register(self._fd, select.POLLIN)
        self._queue: deque[_Waiting] = deque()
        self._queued = 0
        self._busy_ns = 0
        "When the line has sent what was handed over."
        self._new_speed: int | None = None
        "The line changes to it as soon as it is empty; nothing is handed over before."
        self._lost: str | None = None
        self._reported = False
        self._schedule: PacedLine | None = None
        "The line as it should be, where departures are recorded: the UART's own pace is not asked."

    @property
    def url(self) -> str:
        return f"serial:{self._device}"

    @property
    def baud(self) -> int:
        """Speed of the line now."""
        return int(self._port.baudrate)

    def filenos(self) -> tuple[int, ...]:
        return () if self._gone else (self._fd,)

    @property
    def _gone(self) -> bool:
        return self._fd < 0 or self._lost is not None

    def receive(self, now_ns: int) -> list[Received]:
        data = b"" if self._gone else self._read()
        if self._lost is not None and not self._reported:
            self._reported = True
            raise LinkError(f"serial:{self._device}: lost: {self._lost}")
        if not data:
            return []
        self.stats.bytes_in += len(data)
        return [Received(0, data)]

    def _read(self) -> bytes:
        try:
            data = os.read(self._fd, READ_SIZE)
        except BlockingIOError:
            return b""
        except OSError as error:
            self._lose(error)
            return b""
        # nothing to read and nothing there look alike (VMIN 0); only a port that has gone is hung up
        if not data and any(events & (select.POLLHUP | select.POLLERR) for _, events in self._poll.poll(0)):
            self._lose(OSError("the device was removed"))
        return data

    def _lose(self, error: Exception) -> None:
        self._lost = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        self.clear()

    def send(self, payload: bytes, due_ns: int, peer: int | None = None, line_speed: int | None = None) -> None:
        if self._gone:
            return
        if self._queued and payload and self._queued + len(payload) > QUEUE_LIMIT:
            self.stats.payloads_dropped += 1
            return
        ends_ns = None if self.stats.departures is None else self._scheduled(payload, due_ns, line_speed)
        self._queue.append(_Waiting(memoryview(payload), due_ns, line_speed, ends_ns))
        self._queued += len(payload)

    def _scheduled(self, payload: bytes, due_ns: int, line_speed: int | None) -> int | None:
        """When the last bit should leave; None where there is none."""
        if self._schedule is None:
            self._schedule = PacedLine(self.baud)
        self._schedule.put(payload, due_ns, line_speed)
        left = self._schedule.take(1 << 62)
        return left[-1].last_ns if left else None

    def cut(self, now_ns: int) -> None:
        """What the driver of the port still holds goes too: its own buffer cannot be cut at a byte."""
        kept = [item for item in self._queue if item.speed_after is not None]
        self._queue.clear()
        self._queue.extend(kept)
        self._queued = sum(len(item.data) for item in kept)
        if not self._gone:
            with contextlib.suppress(OSError, termios.error):
                termios.tcflush(self._fd, termios.TCOFLUSH)
            self._busy_ns = min(self._busy_ns, now_ns)

    def flush(self, now_ns: int) -> int | None:
        try:
            return None if self._gone else self._flush(now_ns)
        except FAULTS as error:
            self._lose(error)
            return now_ns  # at once, so that `receive` reports

    def _flush(self, now_ns: int) -> int | None:
        while True:
            if self._new_speed is not None:
                wake_ns = self._empty_at(now_ns)
                if wake_ns is not None:
                    return wake_ns
                self._port.baudrate, self._new_speed = self._new_speed, None
            if not self._queue:
                return None
            head = self._queue[0]
            if head.due_ns > now_ns:
                return head.due_ns
            if not self._hand_over(head, now_ns):
                return now_ns + RETRY_NS
            self._queue.popleft()
            self._new_speed = head.speed_after

    def _hand_over(self, head: _Waiting, now_ns: int) -> bool:
        """Write what the driver takes; whether that was all."""
        if head.data:
            try:
                written = os.write(self._fd, head.data)
            except BlockingIOError:
                written = 0
            self._busy_ns = leave_ns(max(self._busy_ns, now_ns), written, self.baud)
            self.stats.bytes_out += written
            self._queued -= written
            head.data = head.data[written:]
        if not head.data:
            self.stats.lateness_ns.append(now_ns - head.due_ns)
            if self.stats.departures is not None and head.ends_ns is not None:
                self.stats.departures.append((head.ends_ns, max(head.ends_ns, self._busy_ns)))
        return not head.data

    def _empty_at(self, now_ns: int) -> int | None:
        """When to look again; None when the last bit has left."""
        if now_ns < self._busy_ns:
            return self._busy_ns
        if waiting_output(self._fd) or not self._transmitter_empty():
            return now_ns + RETRY_NS
        return None

    def _transmitter_empty(self) -> bool:
        status = array.array("i", [TIOCSER_TEMT])
        with contextlib.suppress(OSError):  # cannot be asked: the time on the line has passed, that must do
            fcntl.ioctl(self._fd, TIOCSERGETLSR, status)
        return bool(status[0] & TIOCSER_TEMT)

    @property
    def speed(self) -> int | None:
        return self.baud

    def set_speed(self, baud: int | None) -> None:
        if baud is None or self._gone:
            return
        self._new_speed = None
        self._schedule = None
        try:
            self._port.baudrate = baud
        except FAULTS as error:
            self._lose(error)

    def clear(self) -> int:
        forgotten, self._queued = self._queued, 0
        self._queue.clear()
        if not self._gone:
            with contextlib.suppress(*FAULTS):
                self._port.reset_output_buffer()
        return forgotten

    def close(self) -> None:
        if self._fd < 0:
            return
        self._fd = -1
        with contextlib.suppress(*FAULTS):
            self._port.close()
