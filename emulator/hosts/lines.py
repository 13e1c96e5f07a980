"""The host's end of a line: a serial device, a pseudo-terminal's slave, or a TCP connection."""

from __future__ import annotations

import os
import select
import socket
import termios
from abc import ABC, abstractmethod
from pathlib import Path

import serial

from emulator.errors import EmulatorError, LinkError

GONE = "the other end has closed the line: the run or the replay has ended, or the device was unplugged"


class LineClosed(LinkError):
    """The other end has gone: the run, or the replay, has ended, or the device was unplugged."""


class Line(ABC):
    """Bytes out, bytes in, and a speed where the line has one."""

    @abstractmethod
    def fileno(self) -> int: ...

    @abstractmethod
    def write(self, data: bytes) -> None: ...

    @abstractmethod
    def _take(self) -> bytes: ...

    @abstractmethod
    def close(self) -> None: ...

    def set_baud(self, baud: int) -> None:
        """Change the host's own speed; a TCP connection has none."""

    def flush_input(self) -> None:
        """Forget what has arrived and was not read."""
        while self.read(0.0):
            pass

    def read(self, timeout_s: float) -> bytes:
        """What has arrived, at most waiting `timeout_s` for the first byte; empty when nothing came."""
        ready, _, _ = select.select([self.fileno()], [], [], max(0.0, timeout_s))
        return self._take() if ready else b""


class SerialLine(Line):
    """A serial device or a pseudo-terminal."""

    def __init__(self, path: str, baud: int) -> None:
        self._path = path
        try:
            self._port = serial.Serial(os.path.realpath(path), baud, timeout=0, exclusive=False)
        except (serial.SerialException, OSError, ValueError) as error:
            number = getattr(error, "errno", None)
            raise LinkError(f"cannot open {path}: {os.strerror(number) if number else error}") from None

    def fileno(self) -> int:
        return int(self._port.fileno())

    def write(self, data: bytes) -> None:
        try:
            self._port.write(data)
        except (serial.SerialException, OSError):
            raise LineClosed(f"{self._path}: {GONE}") from None

    def _take(self) -> bytes:
        try:
            return bytes(self._port.read(65536))
        except (serial.SerialException, OSError):  # of pyserial "device disconnected or multiple access on port"
            raise LineClosed(f"{self._path}: {GONE}") from None

    def set_baud(self, baud: int) -> None:
        try:
            self._port.baudrate = baud
        except (serial.SerialException, OSError, termios.error):
            raise LineClosed(f"{self._path}: {GONE}") from None

    def close(self) -> None:
        self._port.close()


class SocketLine(Line):
    """A TCP connection."""

    def __init__(self, host: str, port: int) -> None:
        try:
            self._socket = socket.create_connection((host, port), timeout=5.0)
        except UnicodeError:  # a name that no name server could have
            raise LinkError(f"cannot connect to {host}:{port}: not a host's name") from None
        except OSError as error:
            raise LinkError(f"cannot connect to {host}:{port}: {error.strerror or error}") from None
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def fileno(self) -> int:
        return self._socket.fileno()

    def write(self, data: bytes) -> None:
        try:
            self._socket.sendall(data)
        except OSError:
            raise LineClosed(GONE) from None

    def _take(self) -> bytes:
        try:
            data = self._socket.recv(65536)
        except OSError:
            raise LineClosed(GONE) from None
        if not data:
            raise LineClosed(GONE)
        return data

    def close(self) -> None:
        self._socket.close()


def open_line(url: str, baud: int) -> Line:
    """Connect to `pty:PATH`, `serial:DEVICE`, `tcp:HOST:PORT`, or a path of a serial device."""
    scheme, separator, rest = url.partition(":")
    place = rest.partition("?")[0]
    if separator and scheme in ("pty", "serial"):
        return SerialLine(place, baud)
    if separator and scheme == "tcp":
        host, _, port = place.rpartition(":")
        if not (port.isascii() and port.isdecimal() and 1 <= int(port[:6]) <= 65535):
            raise EmulatorError(f"{url}: port {port!r}; want tcp:HOST:PORT, a port of 1..65535")
        return SocketLine(host.strip("[]") or "127.0.0.1", int(port))
    if Path(url).exists():
        return SerialLine(url, baud)
    raise EmulatorError(f"{url}; want pty:PATH, serial:DEVICE or tcp:HOST:PORT")
