"""Reading pcap and pcapng: packets with instant and link type, in place of ours in `recording/captures.py`."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from io import BytesIO
from typing import Any

from emulator.recording import captures
from emulator.recording.pcapng import Packets
from tests.benchmarks.libraries.measure import Row, added, bounded, failing, import_cost, lines, per_s, version_of
from tests.recording.test_captures import ip, pcap, udp

Packet = tuple[int, int, bytes]
TESTS = ("tests/recording/test_captures.py",)


def ours(data: bytes) -> Iterator[Packet]:
    return (captures._pcapng_packets if data[:1] == b"\x0a" else captures._pcap_packets)(data)


def by_dpkt(data: bytes) -> Iterator[Packet]:
    import dpkt

    reader = dpkt.pcap.UniversalReader(BytesIO(data))
    for at_s, packet in reader:
        yield round(at_s * 1_000_000_000), reader.datalink(), packet


def by_python_pcapng(data: bytes) -> Iterator[Packet]:
    import pcapng

    for block in pcapng.FileScanner(BytesIO(data)):
        if isinstance(block, pcapng.blocks.EnhancedPacket):
            units = (block.timestamp_high << 32) + block.timestamp_low
            per_s = round(1 / block.timestamp_resolution)  # its own `timestamp` is a float: 128 ns wrong
            yield units * 1_000_000_000 // per_s, block.interface.link_type, block.packet_data


def by_scapy(data: bytes) -> Iterator[Packet]:
    from scapy.utils import RawPcapReader

    reader = RawPcapReader(BytesIO(data))
    for packet, found in reader:
        if hasattr(found, "tshigh"):
            units = (found.tshigh << 32) + found.tslow
            yield units * 1_000_000_000 // found.tsresol, found.linktype, packet
        else:
            yield found.sec * 1_000_000_000 + found.usec * (1 if reader.nano else 1000), reader.linktype, packet


LIBRARIES: dict[str, tuple[str, str, Callable[[bytes], Iterator[Packet]]]] = {
    "dpkt": ("dpkt", "dpkt", by_dpkt),
    "python-pcapng": ("python-pcapng", "pcapng", by_python_pcapng),
    "scapy": ("scapy", "scapy.utils", by_scapy),
}


def put_in(name: str) -> None:
    """Read with a library instead of ourselves."""
    read: Any = LIBRARIES[name][2]
    captures._pcap_packets = captures._pcapng_packets = read


AT_NS = 1_790_000_000_123_456_789
"An instant of our century, to the nanosecond."


def a_capture(count: int = 2000) -> bytes:
    """A capture of ours: datagrams of 1206 bytes."""
    packets = Packets("top")
    return packets.head + b"".join(
        packets.of(AT_NS + number, bytes(1206), True, 2368, 2368, True) for number in range(count)
    )


def _block(kind: int, body: bytes, size: int | None = None) -> bytes:
    return struct.pack("<II", kind, size or len(body) + 12) + body + struct.pack("<I", size or len(body) + 12)


def _section() -> bytes:
    return _block(0x0A0D0D0A, struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1))


def _head(resolution: int = 6) -> bytes:
    options = struct.pack("<HHB3xHH", 9, 1, resolution, 0, 0)
    return _section() + _block(1, struct.pack("<HHI", 101, 0, 0) + options)


def two_interfaces() -> bytes:
    """Microseconds on a raw interface, then nanoseconds on an Ethernet: a packet of each, at the same instant."""
    second = _block(1, struct.pack("<HHI", 1, 0, 0) + struct.pack("<HHB3xHH", 9, 1, 9, 0, 0))
    packet = ip(udp(b"x" * 4), 17)
    at = [divmod(12_000_000, 1 << 32), divmod(12_000_000_000, 1 << 32)]
    return (
        _head()
        + second
        + b"".join(
            _block(6, struct.pack("<IIIII", number, *at[number], len(packet), len(packet)) + packet)
            for number in (0, 1)
        )
    )


HOSTILE = {
    "cut in a packet": "a_capture(3)[:-100]",
    "block of 4 GB": "_head() + b'\\6\\0\\0\\0\\xfc\\xff\\xff\\xff' + bytes(100)",
    "block of 0 bytes": "_head() + b'\\6\\0\\0\\0\\0\\0\\0\\0' * 9",
    "resolution 2^-127": "_head(255) + _block(6, struct.pack('<IIIII', 0, 9, 9, 4, 4) + b'data')",
    "packet of no interface": "_section() + _block(6, bytes(20))",
    "pcap: packet of 4 GB": "pcap(101, [b'x'])[:32] + b'\\xff\\xff\\xff\\xff' * 2 + bytes(100)",
    "pcap: cut in a head": "pcap(101, [b'x' * 50])[:-60]",
}


def hostile(name: str, data: str) -> str:
    """For `bounded`: packets that came before the end, and what ended it."""
    read, count = ours if name == "ours" else LIBRARIES[name][2], 0
    try:
        for _ in read(eval(data)):
            count += 1
    except Exception as error:
        return f"{count} packets, {type(error).__name__}"
    return f"{count} packets"


def _measured(name: str, read: Callable[[bytes], Iterator[Packet]]) -> dict[str, str]:
    data = a_capture()
    found = {"packets/s": f"{2000 * per_s(lambda: sum(1 for _ in read(data)), 1.0):.0f}"}
    try:
        off_ns = max(abs(at_ns - AT_NS - number) for number, (at_ns, *_) in enumerate(read(data)))
        found["instants wrong by up to"] = f"{off_ns} ns"
    except Exception as error:
        found["instants wrong by up to"] = f"cannot ({type(error).__name__})"
    for label, made, wanted in (
        ("two interfaces", two_interfaces(), [(12_000_000_000, 101), (12_000_000_000, 1)]),
        (
            "classic pcap, nanoseconds",
            pcap(1, [b"a", b"b"], ">", 0xA1B23C4D),
            [(12_000_000_000, 1), (12_001_000_000, 1)],
        ),
    ):
        try:
            found[label] = "right" if [packet[:2] for packet in read(made)] == wanted else "wrong"
        except Exception as error:
            found[label] = f"cannot ({type(error).__name__})"
    for label, text in HOSTILE.items():
        found[label] = bounded(f"tests.benchmarks.libraries.captures:hostile({name!r}, {text!r})").removeprefix(
            "answers "
        )
    return found


OURS = (captures._pcap_packets, captures._pcapng_packets, captures._resolution)
"What of ours a library would replace; headers of links and IP, and streams of TCP, stay: none puts those together."


def rows(tests: bool = False) -> list[Row]:
    """Ours, then every library."""
    found = [Row("ours", {"lines to replace": str(lines(*OURS))} | _measured("ours", ours))]
    for name, (distribution, module, read) in LIBRARIES.items():
        version = version_of(distribution)
        if version is None:
            found.append(Row(name))
            continue
        cost = {"install": added(distribution), "import": import_cost(module, "import emulator.recording.captures")}
        cost |= {"lines of glue": str(lines(read))} | _measured(name, read)
        if tests:
            cost["our tests that fail with it"] = failing(TESTS, f"captures:{name}")
        found.append(Row(f"{name} {version}", cost))
    return found
