"""The host's end of a line: a serial device, a pseudo-terminal's slave, a TCP connection, a port for datagrams."""

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

    asks = True
    "Whether a device can be sent requests on it."

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


class DatagramLine(Line):
    """Datagrams that arrive on a port, of one sender or of all; nothing is sent."""

    asks = False

    def __init__(self, host: str, port: int, sender: str | None) -> None:
        """`host`: an address of this machine, or a multicast group. `sender`: the address of the device."""
        self._sender = sender
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
            self._socket.setblocking(False)
            self._socket.bind((host, port))
            if 224 <= socket.inet_aton(host)[0] < 240:
                group = socket.inet_aton(host) + socket.inet_aton("0.0.0.0")
                self._socket.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, group)
        except OSError as error:
            self._socket.close()
            raise LinkError(f"cannot listen on {host}:{port}: {error.strerror or error}") from None

    def fileno(self) -> int:
        return self._socket.fileno()

    def write(self, data: bytes) -> None:
        """Nobody is there to be asked."""

    def _take(self) -> bytes:
        found = bytearray()
        while len(found) < 65_536:
            try:
                data, source = self._socket.recvfrom(65_536)
            except BlockingIOError:
                break
            if self._sender in (None, source[0]):
                found += data
        return bytes(found)

    def close(self) -> None:
        self._socket.close()


def _datagrams(url: str, place: str, query: str) -> DatagramLine:
    host, _, port = place.rpartition(":")
    key, _, sender = query.partition("=")
    if not (port.isascii() and port.isdecimal() and 1 <= int(port[:6]) <= 65535):
        raise EmulatorError(f"{url}: port {port!r}; want udp:ADDRESS:PORT, a port of 1..65535")
    if query and key != "from":
        raise EmulatorError(f"{url}: {query!r}; want udp:ADDRESS:PORT?from=ADDRESS")
    for text in [host, sender] if query else [host]:
        try:
            socket.inet_pton(socket.AF_INET, text or ("0.0.0.0" if text is host else ""))
        except OSError:
            raise EmulatorError(f"{url}: address {text!r}; want four numbers, as 192.168.1.201") from None
    return DatagramLine(host or "0.0.0.0", int(port), sender or None)


def open_line(url: str, baud: int) -> Line:
    """Connect to `pty:PATH`, `serial:DEVICE`, `tcp:HOST:PORT`, `udp:ADDRESS:PORT`, or a path of a serial device."""
    scheme, separator, rest = url.partition(":")
    place = rest.partition("?")[0]
    if separator and scheme in ("pty", "serial"):
        return SerialLine(place, baud)
    if separator and scheme == "tcp":
        host, _, port = place.rpartition(":")
        if not (port.isascii() and port.isdecimal() and 1 <= int(port[:6]) <= 65535):
            raise EmulatorError(f"{url}: port {port!r}; want tcp:HOST:PORT, a port of 1..65535")
        return SocketLine(host.strip("[]") or "127.0.0.1", int(port))
    if separator and scheme == "udp":
        return _datagrams(url, place, rest.partition("?")[2])
    if Path(url).exists():
        return SerialLine(url, baud)
    raise EmulatorError(f"{url}; want pty:PATH, serial:DEVICE, tcp:HOST:PORT or udp:ADDRESS:PORT")
