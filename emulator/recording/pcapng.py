"""Writes pcapng: what went over a sensor's sockets, for Wireshark. Reading is captures' part.

Packets are made around the bytes (raw IPv4, link type 101) with addresses of this machine; timestamps in nanoseconds.
Source: IETF draft-ietf-opsawg-pcapng.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import BinaryIO

RAW_IP = 101
MOST_IN_PACKET = 65_000
LOOPBACK = bytes((127, 0, 0, 1))
TCP, UDP = 6, 17
LD_PORT = 49_152
"Of an LD's user protocol: where a capture has its device unless it is said otherwise, or the link has no port."


def _block(kind: int, body: bytes) -> bytes:
    body += b"\0" * (-len(body) % 4)
    size = struct.pack("<I", len(body) + 12)
    return struct.pack("<I", kind) + size + body + size


class Packets:
    """What one sensor said and heard, as the bytes of a capture."""

    def __init__(self, name: str) -> None:
        self._sequence: dict[tuple[int, bool], int] = {}
        title = name.encode()[:200]
        options = struct.pack("<HH", 2, len(title)) + title + b"\0" * (-len(title) % 4)
        options += struct.pack("<HHB3x", 9, 1, 9) + struct.pack("<HH", 0, 0)  # if_name, if_tsresol 10^-9, end
        self.head = _block(0x0A0D0D0A, struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1))
        "What the file begins with."
        self.head += _block(1, struct.pack("<HHI", RAW_IP, 0, 0) + options)

    def of(self, at_ns: int, data: bytes, sent: bool, device_port: int, peer: int, datagram: bool) -> bytes:
        """Bytes of one direction; a stream's are cut into packets."""
        size = MOST_IN_PACKET if not datagram else max(1, len(data))
        host_port = 1024 + peer % 64_000 if not datagram else (peer or 1024)
        ports = (device_port, host_port) if sent else (host_port, device_port)
        blocks = []
        for first in range(0, len(data), size):
            part = data[first : first + size]
            segment = _udp(ports, part) if datagram else self._tcp(peer, sent, ports, part)
            packet = _ipv4(UDP if datagram else TCP, segment)
            head = struct.pack("<IIIII", 0, at_ns >> 32, at_ns & 0xFFFFFFFF, len(packet), len(packet))
            blocks.append(_block(6, head + packet))
        return b"".join(blocks)

    def _tcp(self, peer: int, sent: bool, ports: tuple[int, int], part: bytes) -> bytes:
        number = self._sequence.get((peer, sent), 1)
        other = self._sequence.get((peer, not sent), 1)
        self._sequence[(peer, sent)] = (number + len(part)) & 0xFFFFFFFF
        return struct.pack(">HHIIHHHH", *ports, number, other, 0x5018, 65535, 0, 0) + part


class PcapngWriter:
    """One file of one sensor."""

    def __init__(self, path: Path, name: str) -> None:
        self._packets = Packets(name)
        self._file: BinaryIO = path.open("wb")
        self._file.write(self._packets.head)

    def add(self, at_ns: int, data: bytes, sent: bool, device_port: int, peer: int, datagram: bool) -> None:
        """Bytes of one direction."""
        self._file.write(self._packets.of(at_ns, data, sent, device_port, peer, datagram))

    def close(self) -> None:
        """Everything is in the file."""
        self._file.close()


def _udp(ports: tuple[int, int], part: bytes) -> bytes:
    return struct.pack(">HHHH", *ports, len(part) + 8, 0) + part


def _ipv4(protocol: int, segment: bytes) -> bytes:
    head = struct.pack(">BBHHHBBH", 0x45, 0, 20 + len(segment), 0, 0x4000, 64, protocol, 0) + LOOPBACK + LOOPBACK
    total = sum(struct.unpack(">10H", head))
    check = ~((total & 0xFFFF) + (total >> 16)) & 0xFFFF
    return head[:10] + struct.pack(">H", check) + head[12:] + segment
