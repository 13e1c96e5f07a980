"""Writes classic pcap with Ethernet frames: datagrams of a recorded run, for players and decoders that read no pcapng.

Belongs here: frames around recorded datagrams, with the addresses of their links. Not: streams and pcapng (pcapng).
Source: tcpdump.org, pcap-savefile(5): magic 0xa1b2c3d4, microseconds, link type 1.
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import parse_qs

from emulator.recording.folder import RecordingError
from emulator.recording.reader import WireOf

ETHERNET = 1
IPV4, UDP = 0x0800, 17
MOST_BYTES = 65_507
"Of a datagram."
Place = tuple[str, int]


def places_of(url: str) -> tuple[Place, Place]:
    """Where a `udp:` link sends from and to; 127.0.0.1 and port 0 where its text does not say."""
    reported, _, query = url.removeprefix("udp:").partition("?")
    listen = parse_qs(query).get("listen", [""])[0]
    return _place(listen), _place(reported)


def _place(text: str) -> Place:
    host, _, port = text.rpartition(":")
    number = int(port) if port.isdecimal() and int(port) <= 0xFFFF else 0
    try:
        socket.inet_aton(host)
    except OSError:
        host = "127.0.0.1"
    return host, number


def frame(source: Place, target: Place, data: bytes) -> bytes:
    """One datagram in an Ethernet frame; no checksum of UDP."""
    segment = struct.pack(">HHHH", source[1], target[1], len(data) + 8, 0) + data
    hosts = socket.inet_aton(source[0]) + socket.inet_aton(target[0])
    head = struct.pack(">BBHHHBBH", 0x45, 0, 20 + len(segment), 0, 0x4000, 64, UDP, 0) + hosts
    total = sum(struct.unpack(">10H", head))
    total = (total & 0xFFFF) + (total >> 16)
    check = ~((total & 0xFFFF) + (total >> 16)) & 0xFFFF
    own = b"\x02\x00" + hosts[:4]
    return b"\xff" * 6 + own + struct.pack(">H", IPV4) + head[:10] + struct.pack(">H", check) + head[12:] + segment


def capture(wires: Sequence[WireOf]) -> bytes:
    """A capture of what was sent as datagrams, in the order of the instants at which it had left."""
    rows = []
    for wire in wires:
        source, target = places_of(wire.url)
        source = source if source[1] else (source[0], target[1])
        for one in wire.payloads:
            if len(one.data) <= MOST_BYTES:
                rows.append((max(0, one.end_ns), frame(source, target, one.data)))
    rows.sort(key=lambda row: row[0])
    parts = [struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 0x40000, ETHERNET)]
    for at_ns, data in rows:
        second, rest = divmod(at_ns // 1000, 1_000_000)
        parts.append(struct.pack("<IIII", second, rest, len(data), len(data)) + data)
    return b"".join(parts)


def write(path: Path, wires: Sequence[WireOf]) -> int:
    """A file of the datagrams; how many they are. Raises `RecordingError`."""
    sent = [wire for wire in wires if wire.kind == "datagram" and wire.payloads]
    if not sent:
        raise RecordingError(f"{path}: no datagrams were sent; want a recording of a sensor with a udp: link")
    try:
        path.write_bytes(capture(sent))
    except OSError as error:
        raise RecordingError(f"{path}: cannot be written: {error.strerror}") from None
    return sum(len(wire.payloads) for wire in sent)
