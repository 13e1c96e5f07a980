"""pcapng: what went over a sensor's sockets, for Wireshark, and the reading of pcap and pcapng.

Packets are made around the bytes (raw IPv4, link type 101) with addresses of this machine; timestamps in nanoseconds.
Source: IETF draft-ietf-opsawg-pcapng; libpcap's list of link types.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

RAW_IP, ETHERNET, LINUX_SLL, NULL_LOOP = 101, 1, 113, 0
LINKTYPE_IPV4 = 228
MOST_IN_PACKET = 65_000
LOOPBACK = bytes((127, 0, 0, 1))
TCP, UDP = 6, 17
MOST_BLOCK = 1 << 26


def _block(kind: int, body: bytes) -> bytes:
    body += b"\0" * (-len(body) % 4)
    size = struct.pack("<I", len(body) + 12)
    return struct.pack("<I", kind) + size + body + size


class PcapngWriter:
    """One file of one sensor."""

    def __init__(self, path: Path, name: str) -> None:
        self._file: BinaryIO = path.open("wb")
        self._sequence: dict[tuple[int, bool], int] = {}
        title = name.encode()[:200]
        options = struct.pack("<HH", 2, len(title)) + title + b"\0" * (-len(title) % 4)
        options += struct.pack("<HHB3x", 9, 1, 9) + struct.pack("<HH", 0, 0)  # if_name, if_tsresol 10^-9, end
        self._file.write(_block(0x0A0D0D0A, struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1)))
        self._file.write(_block(1, struct.pack("<HHI", RAW_IP, 0, 0) + options))
        self._file.flush()

    def add(self, at_ns: int, data: bytes, sent: bool, device_port: int, peer: int, datagram: bool) -> None:
        """Bytes of one direction; a stream's are cut into packets."""
        size = MOST_IN_PACKET if not datagram else max(1, len(data))
        host_port = 1024 + peer % 64_000 if not datagram else (peer or 1024)
        ports = (device_port, host_port) if sent else (host_port, device_port)
        for first in range(0, len(data), size):
            part = data[first : first + size]
            segment = _udp(ports, part) if datagram else self._tcp(peer, sent, ports, part)
            packet = _ipv4(UDP if datagram else TCP, segment)
            head = struct.pack("<IIIII", 0, at_ns >> 32, at_ns & 0xFFFFFFFF, len(packet), len(packet))
            self._file.write(_block(6, head + packet))
        self._file.flush()

    def _tcp(self, peer: int, sent: bool, ports: tuple[int, int], part: bytes) -> bytes:
        number = self._sequence.get((peer, sent), 1)
        other = self._sequence.get((peer, not sent), 1)
        self._sequence[(peer, sent)] = (number + len(part)) & 0xFFFFFFFF
        return struct.pack(">HHIIHHHH", *ports, number, other, 0x5018, 65535, 0, 0) + part

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


@dataclass(frozen=True)
class Segment:
    """Bytes of one TCP segment or UDP datagram."""

    at_ns: int
    protocol: int
    source: tuple[bytes, int]
    target: tuple[bytes, int]
    sequence: int
    "Of TCP; 0 for UDP."
    data: bytes


def read_segments(data: bytes) -> Iterator[Segment]:
    """What a pcap or pcapng file carried in TCP and UDP over IPv4, to where it is cut; `ValueError`: neither."""
    magic = data[:4]
    if magic == b"\x0a\x0d\x0d\x0a":
        packets = _pcapng_packets(data)
    elif magic in (b"\xd4\xc3\xb2\xa1", b"\xa1\xb2\xc3\xd4", b"\x4d\x3c\xb2\xa1", b"\xa1\xb2\x3c\x4d"):
        packets = _pcap_packets(data)
    else:
        raise ValueError("neither pcap nor pcapng")
    for at_ns, link_type, packet in packets:
        found = _segment(at_ns, link_type, packet)
        if found is not None:
            yield found


def _pcap_packets(data: bytes) -> Iterator[tuple[int, int, bytes]]:
    order = "<" if data[:4] in (b"\xd4\xc3\xb2\xa1", b"\x4d\x3c\xb2\xa1") else ">"
    unit_ns = 1 if b"\x3c" in data[:4] else 1000
    if len(data) < 24:
        return
    link_type = struct.unpack_from(order + "I", data, 20)[0] & 0xFFFF
    at = 24
    while at + 16 <= len(data):
        seconds, part, size, _ = struct.unpack_from(order + "IIII", data, at)
        if size > MOST_BLOCK or at + 16 + size > len(data):
            return
        yield seconds * 1_000_000_000 + part * unit_ns, link_type, data[at + 16 : at + 16 + size]
        at += 16 + size


def _pcapng_packets(data: bytes) -> Iterator[tuple[int, int, bytes]]:
    order, at = "<", 0
    interfaces: list[tuple[int, int, int]] = []
    while at + 12 <= len(data):
        kind = struct.unpack_from(order + "I", data, at)[0]
        if kind == 0x0A0D0D0A:
            order = "<" if data[at + 8 : at + 12] == b"\x4d\x3c\x2b\x1a" else ">"
            interfaces = []
        size = struct.unpack_from(order + "I", data, at + 4)[0]
        if size < 12 or size % 4 or size > MOST_BLOCK or at + size > len(data):
            return
        body = data[at + 8 : at + size - 4]
        if kind == 1 and len(body) >= 8:
            interfaces.append((struct.unpack_from(order + "H", body)[0], *_resolution(order, body[8:])))
        elif kind == 6 and len(body) >= 20:
            number, high, low, length = struct.unpack_from(order + "IIII", body)
            if number < len(interfaces):
                link_type, multiply, divide = interfaces[number]
                yield ((high << 32 | low) * multiply) // divide, link_type, body[20 : 20 + length]
        at += size


def _resolution(order: str, options: bytes) -> tuple[int, int]:
    """Nanoseconds a unit of an interface's time stamps, as a fraction."""
    at = 0
    while at + 4 <= len(options):
        code, size = struct.unpack_from(order + "HH", options, at)
        if code == 9 and size >= 1 and at + 4 < len(options):
            value = options[at + 4]
            base = 2 if value & 0x80 else 10
            return 1_000_000_000, int(base ** (value & 0x7F))
        at += 4 + size + (-size % 4)
    return 1000, 1


def _segment(at_ns: int, link_type: int, packet: bytes) -> Segment | None:
    if link_type == ETHERNET:
        kind, offset = packet[12:14], 14
        if kind == b"\x81\x00":
            kind, offset = packet[16:18], 18
        packet = packet[offset:] if kind == b"\x08\x00" else b""
    elif link_type == LINUX_SLL:
        packet = packet[16:] if packet[14:16] == b"\x08\x00" else b""
    elif link_type == NULL_LOOP:
        packet = packet[4:]
    elif link_type not in (RAW_IP, LINKTYPE_IPV4):
        return None
    if len(packet) < 20 or packet[0] >> 4 != 4:
        return None
    head, total, protocol = (packet[0] & 15) * 4, int.from_bytes(packet[2:4], "big"), packet[9]
    body = packet[head : max(total, head)] if total else packet[head:]
    if protocol == UDP and len(body) >= 8:
        sequence, data = 0, body[8:]
    elif protocol == TCP and len(body) >= 20:
        sequence, data = int.from_bytes(body[4:8], "big"), body[(body[12] >> 4) * 4 :]
    else:
        return None
    source, target = int.from_bytes(body[:2], "big"), int.from_bytes(body[2:4], "big")
    return Segment(at_ns, protocol, (packet[12:16], source), (packet[16:20], target), sequence, data)


def stream_of(segments: Iterator[Segment], port: int) -> list[tuple[int, bytes]]:
    """What the device with that port sent: times and bytes, repeats and overlaps of TCP left out.

    Of several connections each keeps its order; UDP datagrams go in as they are.
    """
    expected: dict[tuple[tuple[bytes, int], tuple[bytes, int]], int] = {}
    found = []
    for item in segments:
        if item.source[1] != port or not item.data:
            continue
        data = item.data
        if item.protocol == TCP:
            key = (item.source, item.target)
            at = expected.get(key, item.sequence)
            behind = (at - item.sequence) & 0xFFFFFFFF
            if 0 < behind < 1 << 31:
                data = data[behind:]
            if not data:
                continue
            expected[key] = (item.sequence + len(item.data)) & 0xFFFFFFFF
        found.append((item.at_ns, data))
    return found
