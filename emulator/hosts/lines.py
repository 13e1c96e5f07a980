"""The host's end of a line: a serial device, a pseudo-terminal's slave, or a TCP connection."""

from __future__ import annotations

import os
import select
import socket
from abc import ABC, abstractmethod
from pathlib import Path

import serial

from emulator.errors import EmulatorError, LinkError


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
        except (serial.SerialException, OSError) as error:
            raise LinkError(f"{self._port.name}: the device has gone: {error}") from None

    def _take(self) -> bytes:
        try:
            return bytes(self._port.read(65536))
        except serial.SerialException as error:
            raise LinkError(f"{self._port.name}: the device has gone: {error}") from None

    def set_baud(self, baud: int) -> None:
        self._port.baudrate = baud

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
        except OSError as error:
            raise LinkError(f"the device has gone: {error}") from None

    def _take(self) -> bytes:
        try:
            data = self._socket.recv(65536)
        except OSError as error:
            raise LinkError(f"the device has gone: {error}") from None
        if not data:
            raise LinkError("the device has closed the connection")
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
    raise EmulatorError(f"{url}: a host connects to pty:PATH, serial:DEVICE or tcp:HOST:PORT")
