"""Bytes to messages and back: the TCP frame, the serial package, the CAN segments."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocols.can_frame import frame_bits
from protocols.errors import EncodeError
from protocols.ld.packages import LATER_WORDS, Package, PackageJoiner, PackageReader, crc_of, encode_packages, swapped
from protocols.ld.segments import SegmentJoiner, encode_segments, worst_case_bits
from protocols.ld.telegrams import payload_of, text_words, words_of
from protocols.ld.usp import MAX_REQUEST_BYTES, UspReader, encode_frame, xor_of
from protocols.session import DropReason
from protocols.skeleton.receiving import Fault
from tests.protocols.ld import reader

GARBAGE = b"\x00USP\x02\x02U\x03?"


def cases(data: bytes, other: bytes) -> list[tuple[str, list[bytes]]]:
    """One telegram whole, byte by byte, twice at once, and with garbage before and after it."""
    return [
        ("whole", [data]),
        ("byte by byte", [data[i : i + 1] for i in range(len(data))]),
        ("two at once", [data + other]),
        ("garbage before", [GARBAGE + data]),
        ("garbage after", [data + GARBAGE]),
        ("garbage between", [data + GARBAGE + other]),
    ]


def whole(items: list[object], kind: type = bytes) -> list[object]:
    return [item for item in items if isinstance(item, kind)]


def fed(feed: Callable[[bytes], list], chunks: list[bytes]) -> list[object]:
    return [item for chunk in chunks for item in feed(chunk)]


# TCP

PUBLISHED = """
02 55 53 50 00 00 00 02 01 02 03
02 55 53 50 00 00 00 06 81 02 00 00 00 01 82
02 55 53 50 00 00 00 12 81 01 4c 44 2d 4c 52 53 31 30 30 30 00 00 00 00 00 01 e8
02 55 53 50 00 00 00 0a 02 01 00 10 00 10 00 0a 00 08 01
02 55 53 50 00 00 00 08 82 0b 00 00 00 03 16 78 e4
02 55 53 50 00 00 00 06 03 01 00 00 39 ff c4
02 55 53 50 00 00 00 06 ff 00 00 00 00 01 fe
""".strip().splitlines()
"Frames recomputed in the protocol's description; several were seen by running sicktoolbox."


@pytest.mark.parametrize("line", PUBLISHED)
def test_a_published_frame_is_made_of_its_payload_and_read_back(line: str) -> None:
    data = bytes.fromhex(line)
    assert encode_frame(data[8:-1]) == data
    for name, chunks in cases(data, bytes.fromhex(PUBLISHED[0])):
        found = whole(fed(UspReader().feed, chunks))
        expected = [data[8:-1]] + ([b"\x01\x02"] if name in ("two at once", "garbage between") else [])
        assert found == expected, name


@given(st.binary(max_size=300))
def test_the_checksum_is_the_xor_of_all_bytes_however_long(payload: bytes) -> None:
    plain = 0
    for byte in payload:
        plain ^= byte
    assert xor_of(payload) == plain


def test_a_frame_with_a_wrong_checksum_is_dropped_and_the_next_one_read() -> None:
    data = bytearray(encode_frame(b"\x01\x02"))
    data[-1] ^= 1
    found = UspReader().feed(bytes(data) + encode_frame(b"\x02\x05"))
    assert whole(found) == [b"\x02\x05"]
    assert next(item.reason for item in found if isinstance(item, Fault)) is DropReason.BAD_CHECKSUM


def test_a_frame_behind_one_with_a_damaged_length_is_not_lost() -> None:
    damaged = bytearray(encode_frame(b"\x01\x02"))
    damaged[7] = 12  # swallows the next frame
    assert whole(UspReader().feed(bytes(damaged) + encode_frame(b"\x02\x05") * 2)) == [b"\x02\x05"] * 2


def test_a_frame_longer_than_any_request_is_skipped_at_once() -> None:
    reader_ = UspReader()
    found = reader_.feed(b"\x02USP\xff\xff\xff\xff" + encode_frame(b"\x01\x02"))
    assert found[0] == Fault(DropReason.OVERLONG, 4, "payload of 4294967295 bytes")
    assert whole(found) == [b"\x01\x02"]
    assert whole(UspReader().feed(encode_frame(bytes(MAX_REQUEST_BYTES)))) == [bytes(MAX_REQUEST_BYTES)]
    assert whole(UspReader().feed(encode_frame(bytes(MAX_REQUEST_BYTES + 1)))) == []


def test_what_a_half_frame_swallowed_is_read_when_it_is_given_up() -> None:
    half = b"\x02USP\x00\x00\x00\x30\x02\x02"
    reader_ = UspReader()
    assert reader_.feed(half + encode_frame(b"\x01\x02")) == []
    assert reader_
    found = reader_.expire()
    assert found[0] == Fault(DropReason.TIMEOUT, 4)
    assert whole(found) == [b"\x01\x02"]
    assert not reader_


@given(st.lists(st.binary(min_size=0, max_size=40), max_size=5), st.lists(st.integers(1, 50), max_size=20))
def test_any_cut_of_the_stream_gives_the_same_payloads(payloads: list[bytes], cuts: list[int]) -> None:
    stream = b"".join(encode_frame(payload) for payload in payloads)
    chunks, rest = [], stream
    for cut in cuts:
        chunks.append(rest[:cut])
        rest = rest[cut:]
    assert fed(UspReader().feed, [*chunks, rest]) == payloads


@given(st.binary(max_size=2000))
def test_random_bytes_are_all_accounted_for(data: bytes) -> None:
    reader_ = UspReader()
    items = reader_.feed(data) + reader_.expire()
    while reader_:
        items += reader_.expire()
    frames = sum(len(item) + 9 for item in items if isinstance(item, bytes))
    assert frames + sum(item.count for item in items if isinstance(item, Fault)) == len(data)


# serial


@pytest.mark.parametrize(
    "line",
    ["1410 0004 0000 0202 0001 2BBC", "1410 0004 0000 0403 000A 9130", "0010 0003 0000 0102 6D36",
     "1014 0005 0000 8102 0000 0001 6334"],
)  # fmt: skip
def test_a_published_package_has_this_crc(line: str) -> None:
    # the first is printed in COMTEST's notes from the vendor's documentation; the others are recomputed
    data = bytes.fromhex(line)
    assert crc_of(data[:-2]) == int.from_bytes(data[-2:], "big")
    address, body = int.from_bytes(data[:2], "big"), data[6:-2]
    assert encode_packages(body, address) == b"\x02" + line.replace(" ", "").lower().encode() + b"\x03"


@given(st.binary(max_size=300))
def test_the_crc_follows_the_vendors_recurrence(data: bytes) -> None:
    assert crc_of(data) == reader.crc(data)


@pytest.mark.parametrize("lower_case", [False, True])
def test_a_package_is_read_in_either_case_and_any_pieces(lower_case: bool) -> None:
    data = reader.package(0x1410, 4, 0, 0x0202, 1, lower_case=lower_case)
    other = reader.package(0x0010, 3, 0, 0x0102, lower_case=lower_case)
    for name, chunks in cases(data, other):
        found = whole(fed(PackageReader().feed, chunks), Package)
        expected = [Package(0x1410, payload_of(0, 0x0202, 1))]
        if name in ("two at once", "garbage between"):
            expected.append(Package(0x0010, payload_of(0, 0x0102)))
        assert found == expected, name


@given(st.integers(1, 3000), st.integers(0, 0xFFFF))
def test_a_message_of_any_length_is_put_together_by_a_host_and_by_ourselves(size: int, address: int) -> None:
    message = [(7 * index + size) & 0xFFFF for index in range(size)]
    stream = encode_packages(payload_of(*message), address)
    assert reader.read_packages(stream) == [(address, message)]
    joiner = PackageJoiner()
    results = [joiner.add(package) for package in PackageReader().feed(stream)]
    if size <= 2048:
        assert results[-1] == payload_of(*message)
        assert results[:-1] == [None] * (len(results) - 1)
    else:
        assert any(isinstance(result, Fault) for result in results)


@pytest.mark.parametrize(("size", "packages"), [(124, 1), (125, 2), (247, 2), (248, 3), (371, 3), (372, 4)])
def test_a_package_is_never_longer_than_miro_takes(size: int, packages: int) -> None:
    stream = encode_packages(payload_of(*range(size)), 0x1014)
    assert reader.read_packages(stream) == [(0x1014, list(range(size)))]
    assert stream.count(b"\x02") == packages


def test_several_packages_count_down_from_ffff() -> None:
    stream = encode_packages(payload_of(*range(3 * LATER_WORDS)), 0x1014)
    numbers = [package.body[:2].hex() for package in PackageReader().feed(stream)]
    assert numbers == ["ffff", "0003", "0002", "0001"]


FOUR_WORDS = "want four or more words of four hex characters"


@pytest.mark.parametrize(
    ("data", "reason", "detail"),
    [
        (b"\x02141000040000020200012BBD\x03", DropReason.BAD_CHECKSUM, ""),
        (b"\x02141000050000020200012BBC\x03", DropReason.BAD_LENGTH, "count word"),
        (b"\x0214100004000002020001 2BBC\x03", DropReason.BAD_LENGTH, FOUR_WORDS),
        (b"\x021410000400000202000G2BBC\x03", DropReason.BAD_ARGUMENT, "not hexadecimal"),
        (b"\x02\x03", DropReason.BAD_LENGTH, FOUR_WORDS),
        (b"\x02141000012BBC\x03", DropReason.BAD_LENGTH, FOUR_WORDS),
    ],
)
def test_a_package_that_cannot_be_accepted_is_a_fault_that_is_answered(
    data: bytes, reason: DropReason, detail: str
) -> None:
    assert PackageReader().feed(data) == [Fault(reason, len(data), detail, whole=True)]


def test_the_shortest_package_has_four_words_and_the_longest_as_many_as_a_message() -> None:
    assert PackageReader().feed(encode_packages(b"", 0x1410)) == [Package(0x1410, b"\0\0")]
    longest = reader.package(0x1410, 2051, *[0] * 2050)
    assert PackageReader().feed(longest) == [Package(0x1410, bytes(2 * 2050))]
    (fault,) = PackageReader().feed(reader.package(0x1410, 2052, *[0] * 2051))
    assert fault == Fault(DropReason.BAD_LENGTH, 4 * 2054 + 2, FOUR_WORDS, whole=True)


def test_a_new_start_ends_what_was_begun() -> None:
    found = PackageReader().feed(b"\x021410" + reader.package(0x1410, 3, 0, 0x0102))
    assert found == [Fault(DropReason.BAD_LENGTH, 5), Package(0x1410, payload_of(0, 0x0102))]


def test_a_package_without_end_is_given_up() -> None:
    reader_ = PackageReader()
    items = [item for _ in range(20) for item in reader_.feed(b"\x02" * (not reader_) + b"0" * 1000)]
    assert DropReason.OVERLONG in {item.reason for item in items if isinstance(item, Fault)}
    reader_.feed(b"\x0200")
    assert reader_.expire() == [Fault(DropReason.TIMEOUT, 3)]
    assert reader_.expire() == []


@pytest.mark.parametrize("numbers", [[0xFFFF, 3], [0xFFFF, 1], [2], [0xFFFF, 2, 2]])
def test_packages_out_of_turn_are_a_fault(numbers: list[int]) -> None:
    joiner = PackageJoiner()
    bodies = [payload_of(number, 3, 7) if number == 0xFFFF else payload_of(number, 7) for number in numbers]
    results = [joiner.add(Package(0, body)) for body in bodies]
    detail = f"package {numbers[-1]:04X} out of turn"
    assert results == [None] * (len(bodies) - 1) + [Fault(DropReason.BAD_LENGTH, 4, detail, whole=True)]
    assert joiner.add(Package(0, payload_of(1, 7))) == Fault(
        DropReason.BAD_LENGTH, 4, "package 0001 out of turn", whole=True
    )
    assert joiner.add(Package(0, payload_of(0, 0x0102))) == payload_of(0x0102)


def test_a_message_of_no_package_is_a_fault() -> None:
    fault = Fault(DropReason.BAD_LENGTH, 4, "message of no package", whole=True)
    assert PackageJoiner().add(Package(0, payload_of(0xFFFF, 0))) == fault


def test_a_message_of_too_many_words_is_a_fault_at_the_package_that_is_too_much() -> None:
    joiner = PackageJoiner()
    assert joiner.add(Package(0, payload_of(0xFFFF, 3, *range(2000)))) is None
    assert joiner.add(Package(0, payload_of(2, *range(48)))) is None
    fault = Fault(DropReason.OVERLONG, 2 * 2049, whole=True)
    assert joiner.add(Package(0, payload_of(1, 0))) == fault
    assert joiner.add(Package(0, payload_of(0, 0x0102))) == payload_of(0x0102)
    assert joiner.add(Package(0, payload_of(0xFFFF, 1, *range(2048)))) == payload_of(*range(2048))


def test_a_reply_swaps_source_and_destination() -> None:
    assert swapped(0x1410) == 0x1014
    assert swapped(0x0010) == 0x1000


# CAN


@pytest.mark.parametrize(
    ("message", "frames"),
    [
        ((0x0403, 10), ["0000 0010 0403 000a"]),
        ((0x0201, 16, 16, 10, 8), ["ffff 0003 0010 0201", "0002 0010 0010 000a", "0001 0008"]),
        ((0x0301, 0, 0x0100), ["ffff 0002 0010 0301", "0001 0000 0100"]),
    ],
)
def test_a_message_on_can_has_these_frames(message: tuple[int, ...], frames: list[str]) -> None:
    assert [data.hex() for data in encode_segments(payload_of(*message), 16)] == [f.replace(" ", "") for f in frames]


@given(st.integers(1, 6000), st.integers(0, 0xFFFF))
def test_a_message_of_any_length_crosses_the_bus(size: int, identity: int) -> None:
    message = [(5 * index + size) & 0xFFFF for index in range(size)]
    frames = encode_segments(payload_of(*message), identity)
    assert reader.read_can(frames) == [(identity, message)]
    assert max(map(len, frames)) <= 8
    if size <= 2048:
        assert frames == reader.can_frames(identity, *message)
        joiner = SegmentJoiner()
        assert [joiner.add(data) for data in frames][-1] == (identity, payload_of(*message))
        assert not joiner


WHOLE_WORDS = "want two to four whole words"


@pytest.mark.parametrize(
    ("frames", "reason", "detail"),
    [
        (["0001"], DropReason.BAD_LENGTH, WHOLE_WORDS),
        (["000100"], DropReason.BAD_LENGTH, WHOLE_WORDS),
        ([""], DropReason.BAD_LENGTH, WHOLE_WORDS),
        (["0002 0001 0002 0003"], DropReason.BAD_LENGTH, "frame 0002 out of turn"),
        (["ffff 0001 0010 0201"], DropReason.BAD_LENGTH, "1 frames"),
        (["ffff 0000 0010 0201"], DropReason.BAD_LENGTH, "0 frames"),
        (["ffff 02ad 0010 0201"], DropReason.OVERLONG, "685 frames"),
        (["ffff ffff 0010 0201"], DropReason.OVERLONG, "65535 frames"),
        (["ffff 0003 0010 0201", "0001 0010"], DropReason.BAD_LENGTH, "frame 0001 out of turn"),
        (["ffff 0003 0010 0201", "0002 0010"], DropReason.BAD_LENGTH, "only the last frame may be short"),
        (["ffff 0003"], DropReason.BAD_LENGTH, "frame FFFF out of turn"),
    ],
)
def test_frames_that_make_no_message_are_a_fault_and_the_next_message_is_read(
    frames: list[str], reason: DropReason, detail: str
) -> None:
    joiner = SegmentJoiner()
    results = [joiner.add(bytes.fromhex(data)) for data in frames]
    assert results == [None] * (len(frames) - 1) + [Fault(reason, len(bytes.fromhex(frames[-1])), detail)]
    assert not joiner
    assert joiner.add(bytes.fromhex("0001 0008")) == Fault(DropReason.BAD_LENGTH, 4, "frame 0001 out of turn")
    assert joiner.add(bytes.fromhex("0000 0010 0102")) == (16, payload_of(0x0102))


def test_a_message_that_stops_on_can_is_given_up() -> None:
    joiner = SegmentJoiner()
    assert joiner.expire() == []
    joiner.add(bytes.fromhex("ffff 0003 0010 0201"))
    assert joiner.expire() == [Fault(DropReason.TIMEOUT, 2)]


def test_the_most_bits_of_a_standard_frame_are_those_of_the_books() -> None:
    # 44 + 8 n of the frame, 3 between frames, a stuff bit for each four of 34 + 8 n less one (Davis et al. 2007)
    assert [worst_case_bits(length) for length in range(9)] == [55, 65, 75, 85, 95, 105, 115, 125, 135]


def test_no_standard_frame_takes_more_bits_than_the_bus_is_given() -> None:
    for length in range(9):
        for data in (bytes(length), b"\xff" * length, b"\x0f" * length, b"\x78\x1e\x3c" * 3):
            assert frame_bits(0x700, data[:length]) <= worst_case_bits(length)


# words


def test_words_beyond_sixteen_bits_are_our_own_misuse() -> None:
    with pytest.raises(EncodeError, match="65536"):
        payload_of(1, 65536)
    with pytest.raises(EncodeError, match="12 characters"):
        text_words("thirteen char")


def test_an_odd_byte_at_the_end_of_a_payload_is_left_out() -> None:
    assert words_of(b"\x03\x01\x00\x00\x3d\xff\x07") == (0x0301, 0, 0x3DFF)
    assert words_of(b"") == ()
