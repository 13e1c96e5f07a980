"""Reads pcap and pcapng: what a device sent over TCP and UDP, put together as its host got it.

Belongs here: packets of a file, the headers around them, streams of TCP. Not: what bytes mean, nor writing (pcapng).
Sources: IETF draft-ietf-opsawg-pcap and -pcapng; libpcap's list of link types; RFC 791, 8200, 9293.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from emulator.recording.pcapng import RAW_IP, TCP, UDP

NULL_LOOP, ETHERNET, BSD_LOOP, LINUX_SLL, IPV4, IPV6, LINUX_SLL2 = 0, 1, 108, 113, 228, 229, 276
"Link types. The cooked ones are Linux's `-i any`, the older and the newer."
ETHER_IPV4, ETHER_IPV6 = 0x0800, 0x86DD
VLAN_TAGS = (0x8100, 0x88A8, 0x9100)
MOST_BLOCK = 1 << 26
MOST_AHEAD = 256
"Segments that wait for a missing one. Of more, or after `PATIENCE_NS`, it is the capture that lacks it."
TIME_LIMIT_NS = 3_000_000_000
SYN = 0x02


@dataclass(frozen=True)
class Segment:
    """Bytes of one TCP segment or UDP datagram."""

    at_ns: int
    protocol: int
    source: tuple[bytes, int]
    target: tuple[bytes, int]
    sequence: int
    "Of TCP: of the first of these bytes; 0 for UDP."
    data: bytes
    begins: bool = False
    "The first of its connection (SYN)."


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
    packet = _internet_packet(link_type, packet)
    if len(packet) >= 20 and packet[0] >> 4 == 4:
        head, total, protocol = (packet[0] & 15) * 4, int.from_bytes(packet[2:4], "big"), packet[9]
        if int.from_bytes(packet[6:8], "big") & 0x1FFF:  # a later fragment has no ports
            return None
        source, target = packet[12:16], packet[16:20]
        body = packet[head : max(total, head)] if total else packet[head:]  # 0: left to the network card
    elif len(packet) >= 40 and packet[0] >> 4 == 6:
        total, protocol = int.from_bytes(packet[4:6], "big"), packet[6]
        source, target = packet[8:24], packet[24:40]
        body = packet[40 : 40 + total] if total else packet[40:]
    else:
        return None
    ports = int.from_bytes(body[:2], "big"), int.from_bytes(body[2:4], "big")
    ends = (source, ports[0]), (target, ports[1])
    if protocol == UDP and len(body) >= 8:
        return Segment(at_ns, protocol, *ends, 0, body[8:])
    if protocol == TCP and len(body) >= 20:
        begins = bool(body[13] & SYN)
        sequence = (int.from_bytes(body[4:8], "big") + begins) & 0xFFFFFFFF
        return Segment(at_ns, protocol, *ends, sequence, body[(body[12] >> 4) * 4 :], begins)
    return None


def _internet_packet(link_type: int, packet: bytes) -> bytes:
    """What is within the header of the link; empty: something else than IP."""
    if link_type in (RAW_IP, IPV4, IPV6):
        return packet
    if link_type in (NULL_LOOP, BSD_LOOP):
        return packet[4:]
    places = {ETHERNET: (12, 14), LINUX_SLL: (14, 16), LINUX_SLL2: (0, 20)}
    if link_type not in places:
        return b""
    at, behind = places[link_type]
    kind, rest = int.from_bytes(packet[at : at + 2], "big"), packet[behind:]
    while kind in VLAN_TAGS and len(rest) >= 4:
        kind, rest = int.from_bytes(rest[2:4], "big"), rest[4:]
    return rest if kind in (ETHER_IPV4, ETHER_IPV6) else b""


@dataclass
class Stream:
    """What the device sent to one host: instants, and bytes in the order in which the host got them."""

    parts: list[tuple[int, bytes]] = field(default_factory=list)
    _next: int | None = None
    "Sequence number of the first byte that has not come."
    _ahead: list[Segment] = field(default_factory=list)
    "What came before something that was sent earlier."

    def begin(self, sequence: int) -> None:
        """A connection begins with this number."""
        self.end()
        self._next = sequence

    def add(self, item: Segment) -> None:
        """A segment as it was captured: once more, too early, or overlapping another."""
        if self._next is None:
            self._next = item.sequence
        self._ahead.append(item)
        self._take()
        while self._ahead and (
            len(self._ahead) > MOST_AHEAD or item.at_ns - min(one.at_ns for one in self._ahead) > TIME_LIMIT_NS
        ):
            self._skip()

    def end(self) -> None:
        """Nothing more comes: what still waits goes out without what is missing."""
        while self._ahead:
            self._skip()

    def _distance(self, item: Segment) -> int:
        """How far a segment begins after the next byte wanted; negative: before it."""
        assert self._next is not None
        return ((item.sequence - self._next + (1 << 31)) & 0xFFFFFFFF) - (1 << 31)

    def _take(self) -> None:
        while found := [one for one in self._ahead if self._distance(one) <= 0]:
            for one in found:
                self._ahead.remove(one)
                fresh = one.data[-self._distance(one) :]
                if fresh:
                    got_ns = max(one.at_ns, self.parts[-1][0]) if self.parts else one.at_ns
                    self.parts.append((got_ns, fresh))
                    self._next = (one.sequence + len(one.data)) & 0xFFFFFFFF

    def _skip(self) -> None:
        self._next = min(self._ahead, key=self._distance).sequence
        self._take()


def streams_of(segments: Iterable[Segment], port: int) -> list[list[tuple[int, bytes]]]:
    """What the device with that port sent, a list a host: instants and bytes, as TCP gives them to the host.

    Connections that follow each other are one list, and so are all datagrams: a host of then hears them from one place.
    """
    streams: dict[tuple[object, ...], Stream] = {}
    for item in segments:
        if item.source[1] != port:
            continue
        if item.protocol == UDP:
            streams.setdefault((UDP,), Stream()).parts.append((item.at_ns, item.data))
            continue
        stream = streams.setdefault((item.source, item.target), Stream())
        if item.begins:
            stream.begin(item.sequence)
        if item.data:
            stream.add(item)
    for stream in streams.values():
        stream.end()
    found: list[list[tuple[int, bytes]]] = []
    for parts in sorted((one.parts for one in streams.values() if one.parts), key=lambda parts: parts[0][0]):
        before = next((one for one in found if one[-1][0] <= parts[0][0]), None)
        if before is None:
            found.append(parts)
        else:
            before += parts
    return found
