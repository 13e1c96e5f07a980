"""Captures of a device's socket: headers by hand from the formats' descriptions, TCP as it goes wrong."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pcapng import FileScanner

from emulator.commands.cli import main
from emulator.recording.captures import MOST_AHEAD, Segment, read_segments, streams_of
from emulator.recording.pcapng import TCP, PcapngWriter
from emulator.recording.reader import read_wire
from emulator.recording.writer import RecordingError
from tests.draws import cases

DEVICE, HOST = (bytes((192, 168, 1, 10)), 49_152), (bytes((192, 168, 1, 2)), 40_000)
IP6 = bytes.fromhex("fe800000000000000000000000000001"), bytes.fromhex("fe800000000000000000000000000002")
TELEGRAMS = [b"\x02USP\0\0\0\x02\x84\x01\x85", bytes(range(100)), b"third", b"and the last"]


def tcp(sequence: int, data: bytes, flags: int = 0x18, ports: tuple[int, int] = (49_152, 40_000)) -> bytes:
    """RFC 9293, 3.1: ports, sequence, acknowledgement, offset and flags, window, checksum, urgent pointer."""
    return struct.pack(">HHIIBBHHH", *ports, sequence & 0xFFFFFFFF, 1, 5 << 4, flags, 8192, 0, 0) + data


def udp(data: bytes) -> bytes:
    return struct.pack(">HHHH", 49_152, 40_000, 8 + len(data), 0) + data


def ip(segment: bytes, protocol: int = 6, fragment: int = 0) -> bytes:
    """RFC 791, 3.1."""
    head = struct.pack(">BBHHHBBH", 0x45, 0, 20 + len(segment), 7, fragment, 64, protocol, 0)
    return head + DEVICE[0] + HOST[0] + segment


def ip6(segment: bytes) -> bytes:
    """RFC 8200, 3."""
    return struct.pack(">IHBB", 6 << 28, len(segment), 6, 64) + IP6[0] + IP6[1] + segment


MAC = bytes(12)
LINKS = {
    "ethernet, padded to its least length": (1, lambda packet: MAC + b"\x08\x00" + packet + b"\0" * 18),
    "VLAN": (1, lambda packet: MAC + b"\x81\x00\x00\x05\x08\x00" + packet),
    "VLAN within VLAN": (1, lambda packet: MAC + b"\x88\xa8\x00\x05\x81\x00\x00\x06\x08\x00" + packet),
    "cooked": (113, lambda packet: b"\0\0\0\x01\0\x06" + bytes(8) + b"\x08\x00" + packet),
    "cooked VLAN": (113, lambda packet: b"\0\0\0\x01\0\x06" + bytes(8) + b"\x81\x00\x00\x05\x08\x00" + packet),
    "cooked, second version": (276, lambda packet: b"\x08\x00\0\0\0\0\0\x02\0\x01\0\x06" + bytes(8) + packet),
    "raw": (101, lambda packet: packet),
    "BSD loopback": (0, lambda packet: b"\x02\0\0\0" + packet),
}


def pcap(link_type: int, packets: Sequence[bytes], order: str = "<", magic: int = 0xA1B2C3D4) -> bytes:
    """draft-ietf-opsawg-pcap: one packet a millisecond."""
    found = struct.pack(order + "IHHiIII", magic, 2, 4, 0, 0, 65_535, link_type)
    unit = 1_000_000 if magic == 0xA1B23C4D else 1000
    for number, packet in enumerate(packets):
        found += struct.pack(order + "IIII", 12, number * unit, len(packet), len(packet)) + packet
    return found


@pytest.mark.parametrize("link", LINKS)
def test_telegrams_come_out_of_every_header(link: str) -> None:
    link_type, wrap = LINKS[link]
    at, packets = 1000, []
    for data in TELEGRAMS:
        packets.append(wrap(ip(tcp(at, data))))
        at += len(data)
    (found,) = streams_of(read_segments(pcap(link_type, packets)), 49_152)
    assert found == [(12_000_000_000 + n * 1_000_000, data) for n, data in enumerate(TELEGRAMS)]


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("magic", [0xA1B2C3D4, 0xA1B23C4D])
def test_both_byte_orders_and_both_units_of_time_are_read(order: str, magic: int) -> None:
    data = pcap(1, [MAC + b"\x86\xdd" + ip6(tcp(5, b"a")), MAC + b"\x08\x00" + ip(tcp(5, b"b"))], order, magic)
    assert [(item.at_ns, item.data) for item in read_segments(data)] == [
        (12_000_000_000, b"a"),
        (12_001_000_000, b"b"),
    ]


def test_what_is_no_segment_of_the_device_is_passed_over() -> None:
    arp = MAC + b"\x08\x06" + bytes(46)
    later_fragment = MAC + b"\x08\x00" + ip(udp(b"no ports of mine"), 17, fragment=3)
    icmp = MAC + b"\x08\x00" + ip(bytes(30), 1)
    asked = MAC + b"\x08\x00" + ip(tcp(1, b"request", ports=(40_000, 49_152)))
    packets = [arp, later_fragment, icmp, asked, MAC + b"\x08\x00" + ip(tcp(9, b"yes"))]
    (found,) = streams_of(read_segments(pcap(1, packets)), 49_152)
    assert [data for _, data in found] == [b"yes"]


def stream(*captured: tuple[int, bytes], start: int = 0xFFFFFFF0) -> list[tuple[int, bytes]]:
    """What comes out of segments that were captured in this order, a millisecond from each to the next."""
    syn = Segment(0, TCP, DEVICE, HOST, start, b"", begins=True)
    segments = [
        Segment((number + 1) * 10**6, TCP, DEVICE, HOST, (start + at) & 0xFFFFFFFF, data)
        for number, (at, data) in enumerate(captured)
    ]
    found = streams_of([syn, *segments], 49_152)
    return found[0] if found else []


MS = 10**6
CASES = {
    "in order": ([(0, b"ab"), (2, b"cd"), (4, b"ef")], [(MS, b"ab"), (2 * MS, b"cd"), (3 * MS, b"ef")]),
    "sent again": ([(0, b"ab"), (0, b"ab"), (2, b"cd"), (0, b"ab")], [(MS, b"ab"), (3 * MS, b"cd")]),
    "sent again with more": (
        [(0, b"ab"), (0, b"abcd"), (1, b"bcdef")],
        [(MS, b"ab"), (2 * MS, b"cd"), (3 * MS, b"ef")],
    ),
    "out of order": ([(2, b"cd"), (0, b"ab"), (4, b"ef")], [(2 * MS, b"ab"), (2 * MS, b"cd"), (3 * MS, b"ef")]),
    "lost, then sent again": (
        [(0, b"ab"), (4, b"ef"), (6, b"gh"), (2, b"cd"), (8, b"ij")],
        [(MS, b"ab"), (4 * MS, b"cd"), (4 * MS, b"ef"), (4 * MS, b"gh"), (5 * MS, b"ij")],
    ),
    "never captured": ([(0, b"ab"), (4, b"ef"), (6, b"gh")], [(MS, b"ab"), (2 * MS, b"ef"), (3 * MS, b"gh")]),
    "alive?": ([(0, b"ab"), (1, b"b"), (2, b"cd")], [(MS, b"ab"), (3 * MS, b"cd")]),
    "nothing": ([], []),
}


@pytest.mark.parametrize("case", CASES)
def test_a_stream_is_put_together_as_the_host_got_it(case: str) -> None:
    captured, wanted = CASES[case]
    assert stream(*captured) == wanted


@given(st.data())
@settings(max_examples=cases(50), deadline=None, derandomize=True)
def test_any_order_and_any_repeats_give_the_same_bytes(data: st.DataObject) -> None:
    whole = bytes(range(60))
    cuts = sorted(data.draw(st.sets(st.integers(1, 59), max_size=8)))
    parts = [(first, whole[first:last]) for first, last in zip([0, *cuts], [*cuts, 60], strict=True)]
    captured = data.draw(st.permutations(parts + data.draw(st.lists(st.sampled_from(parts), max_size=5))))
    assert b"".join(part for _, part in stream(*captured)) == whole


def test_what_the_capture_lacks_is_not_waited_for_without_end() -> None:
    many = [(10 + number, b"x") for number in range(MOST_AHEAD + 50)]
    assert len(stream((0, b"a"), *many)) == len(many) + 1
    early = Segment(10**9, TCP, DEVICE, HOST, 50, b"later")
    first = Segment(0, TCP, DEVICE, HOST, 1, b"first")
    late = Segment(9 * 10**9, TCP, DEVICE, HOST, 55, b"much later")
    (found,) = streams_of([first, early, late], 49_152)
    assert found == [(0, b"first"), (10**9, b"later"), (9 * 10**9, b"much later")]


def test_connections_one_after_the_other_are_one_stream_and_those_at_a_time_are_two(tmp_path: Path) -> None:
    other = (HOST[0], 40_001)
    one = [Segment(at, TCP, DEVICE, HOST, 1 + at, b"a") for at in (0, 1, 2)]
    again = [Segment(5, TCP, DEVICE, HOST, 700, b"", begins=True), Segment(6, TCP, DEVICE, HOST, 700, b"b")]
    beside = [Segment(at, TCP, DEVICE, other, at, b"c") for at in (1, 2, 3)]
    after = [Segment(9, TCP, DEVICE, other, 3, b"d")]
    assert streams_of([*one, *again, *after], 49_152) == [[(0, b"a"), (1, b"a"), (2, b"a"), (6, b"b"), (9, b"d")]]
    assert [[data for _, data in part] for part in streams_of([*one, *beside], 49_152)] == [[b"a"] * 3, [b"c"] * 3]
    packets = [MAC + b"\x08\x00" + ip(tcp(at, b"xy", ports=(49_152, port))) for at in (1, 3) for port in (4, 5)]
    path = tmp_path / "two.pcap"
    path.write_bytes(pcap(1, packets))
    wires = read_wire(path)
    assert [(wire.sensor, wire.url) for wire in wires] == [
        ("two", "tcp:127.0.0.1:49152"),
        ("two-2", "tcp:127.0.0.1:0"),
    ]
    assert [[one.start_ns for one in wire.payloads] for wire in wires] == [[0, 2 * MS], [MS, 3 * MS]]


def test_a_capture_of_ours_reads_back_without_repeats(tmp_path: Path) -> None:
    path = tmp_path / "x.pcapng"
    writer = PcapngWriter(path, "top")
    big = bytes(range(256)) * 600
    writer.add(5, b"hello", True, 49152, 1, False)
    writer.add(7, b"request", False, 49152, 1, False)
    writer.add(9, big, True, 49152, 1, False)
    writer.close()
    data = path.read_bytes()
    (found,) = streams_of(read_segments(data), 49152)
    assert found[0] == (5, b"hello")
    assert b"".join(part for _, part in found) == b"hello" + big
    (found,) = streams_of([*read_segments(data), *read_segments(data)], 49152)
    assert b"".join(part for _, part in found) == b"hello" + big


@pytest.mark.filterwarnings("ignore:Field type should not be:DeprecationWarning")  # its own
def test_a_stranger_reads_what_we_wrote(tmp_path: Path) -> None:
    """python-pcapng: blocks, interface, lengths and instants, and from them bytes and ports of both directions."""
    path = tmp_path / "x.pcapng"
    at_ns = 1_790_000_000_123_456_789
    writer = PcapngWriter(path, "top, über")
    big = bytes(range(256)) * 600
    said = [
        (b"hello", True, False),
        (b"request", False, False),
        (big, True, False),
        (b"odd", True, True),
        (b"", True, True),
    ]
    for number, (data, sent, datagram) in enumerate(said):
        writer.add(at_ns + number, data, sent, 2112, 5000, datagram)
    writer.close()
    with path.open("rb") as file:  # it forbids what the description forbids, unless told otherwise
        head, interface, *packets = FileScanner(file)
    assert (head.version_major, head.version_minor, interface.link_type) == (1, 0, 101)
    assert interface.options["if_name"] == "top, über"
    assert [packet.packet_len for packet in packets] == [packet.captured_len for packet in packets]
    per_s = round(1 / interface.timestamp_resolution)
    assert per_s == 1_000_000_000
    found: dict[tuple[int, int, int], bytes] = {}
    for packet in packets:
        number = (packet.timestamp_high << 32) + packet.timestamp_low - at_ns
        data = packet.packet_data
        assert data[0] == 0x45
        assert int.from_bytes(data[2:4], "big") == len(data)
        ports = struct.unpack(">HH", data[20:24])
        found[number, *ports] = found.get((number, *ports), b"") + data[28 if said[number][2] else 40 :]
    stream = 1024 + 5000
    assert found == {
        (0, 2112, stream): b"hello",
        (1, stream, 2112): b"request",
        (2, 2112, stream): big,
        (3, 2112, 5000): b"odd",
    }


def test_datagrams_are_kept_apart_and_a_wrong_port_is_told_with_the_right_ones(tmp_path: Path) -> None:
    path = tmp_path / "x.pcap"
    path.write_bytes(pcap(1, [MAC + b"\x08\x00" + ip(udp(data), 17) for data in (b"hi", b"ho")]))
    assert [one.data for one in read_wire(path)[0].payloads] == [b"hi", b"ho"]
    with pytest.raises(RecordingError, match=r"no data sent by port 1; want --port .*: 49152"):
        read_wire(path, port=1)
    path.write_bytes(pcap(1, []))
    with pytest.raises(RecordingError, match="none did"):
        read_wire(path)


@given(st.binary(max_size=200))
@settings(max_examples=cases(60))
def test_any_bytes_behind_a_captures_magic_end_it_quietly(data: bytes) -> None:
    for magic in (b"\x0a\x0d\x0d\x0a", b"\xd4\xc3\xb2\xa1", b"\xa1\xb2\x3c\x4d"):
        list(read_segments(magic + data))


def test_captures_of_a_device_at_any_port_are_compared(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    paths = tmp_path / "one.pcap", tmp_path / "two.pcap"
    for path, data in zip(paths, (b"same, and this", b"same, and thus"), strict=True):
        path.write_bytes(pcap(101, [ip(tcp(1, data, ports=(2112, 40_000)))]))
    names = list(map(str, paths))
    assert main(["diff", *names]) == 2
    assert "one of: 2112" in capsys.readouterr().err
    assert main(["diff", *names, "--port", "2112"]) == 1
    assert "payload 0, byte 12: 69 and 75" in capsys.readouterr().out
    assert main(["diff", names[0], names[0], "--port", "2112"]) == 0
