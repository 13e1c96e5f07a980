"""Bit lengths of classic frames: against a bit-by-bit construction of the frame, and the bounds of ISO 11898-1."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocols import can_frame
from protocols.can_frame import (
    EXTENDED,
    MAX_EXTENDED_ID,
    MAX_STANDARD_ID,
    arbitration_key,
    frame_bits,
    frames_bits,
    is_identifier,
    split_identifier,
)

peers = st.one_of(
    st.integers(0, MAX_STANDARD_ID), st.integers(0, MAX_EXTENDED_ID).map(lambda identifier: identifier | EXTENDED)
)
# runs of equal bits make stuff bits: mostly zeros and ones
payloads = st.lists(st.sampled_from([0x00, 0xFF, 0x0F, 0xF8, 0x07, 0x5A]) | st.integers(0, 255), max_size=8).map(bytes)


def crc15(bits: list[int]) -> int:
    """CRC-15/CAN, bit by bit."""
    register = 0
    for bit in bits:
        feedback = bit ^ register >> 14 & 1
        register = register << 1 & 0x7FFF
        if feedback:
            register ^= 0x4599
    return register


def written(value: int, width: int) -> list[int]:
    return [int(bit) for bit in f"{value:0{width}b}"]


def header_bits(peer: int, length: int) -> list[int]:
    identifier, extended = split_identifier(peer)
    if extended:
        middle = [*written(identifier >> 18, 11), 1, 1, *written(identifier & 0x3FFFF, 18), 0, 0, 0]
    else:
        middle = [*written(identifier, 11), 0, 0, 0]
    return [0, *middle, *written(length, 4)]


def length_bit_by_bit(peer: int, data: bytes) -> int:
    bits = header_bits(peer, len(data)) + [bit for byte in data for bit in written(byte, 8)]
    bits += written(crc15(bits), 15)
    sent: list[int] = []
    for bit in bits:
        sent.append(bit)
        if len(sent) >= 5 and len(set(sent[-5:])) == 1:
            sent.append(1 - bit)
    return len(sent) + 1 + 2 + 7 + 3


def test_the_checksum_used_here_has_the_published_check_value() -> None:
    # CRC-15/CAN of the digits 1 to 9, catalogue of parametrised CRC algorithms
    assert crc15([bit for byte in b"123456789" for bit in written(byte, 8)]) == 0x059E


def test_the_tables_are_what_single_bits_make() -> None:
    for byte, row in enumerate(can_frame._crc_table()):
        assert row == crc15(written(byte, 8))
    for state in (0, 1, 2, 3, 5, 6, 7, 8):  # five equal bits are followed by a stuff bit at once
        for bits in range(256):
            stream = [state // 5] * (state % 5 + 1)
            before = len(stream)
            for bit in written(bits, 8):
                stream.append(bit)
                if len(stream) >= 5 and len(set(stream[-5:])) == 1:
                    stream.append(1 - bit)
            run = next((n for n in range(1, len(stream)) if stream[-n - 1] != stream[-1]), len(stream))
            expected = 5 * stream[-1] + run - 1, len(stream) - before - 8
            assert can_frame._stuff_row(state, bits, 8) == expected


@given(peers, payloads)
def test_every_frame_is_as_long_as_when_it_is_built_bit_by_bit(peer: int, data: bytes) -> None:
    assert frame_bits(peer, data) == length_bit_by_bit(peer, data)


@given(st.lists(st.tuples(peers, payloads), max_size=20))
def test_many_frames_at_once_are_as_long_as_one_by_one(frames: list[tuple[int, bytes]]) -> None:
    many = frames_bits([peer for peer, _ in frames], [data for _, data in frames])
    assert many.tolist() == [frame_bits(peer, data) for peer, data in frames]


@given(st.integers(0, MAX_STANDARD_ID), payloads)
def test_a_standard_frame_keeps_the_bounds_of_the_standard(peer: int, data: bytes) -> None:
    plain = 47 + 8 * len(data)
    assert plain <= frame_bits(peer, data) <= plain + (33 + 8 * len(data)) // 4


def test_eight_bytes_of_alternating_bits_need_few_stuff_bits_and_zeros_many() -> None:
    assert frame_bits(0x555, b"\x55" * 8) < frame_bits(0x000, bytes(8))
    assert frame_bits(0x555, b"\x55" * 8) >= 111


def test_the_lower_identifier_wins_and_a_standard_frame_beats_an_extended_one_of_the_same_start() -> None:
    extended = 0x200 << 18 | EXTENDED
    order = sorted([0x201, extended | 5, 0x200, extended, 0x1FF], key=arbitration_key)
    assert order == [0x1FF, 0x200, extended, extended | 5, 0x201]


@pytest.mark.parametrize(
    ("peer", "legal"),
    [(0, True), (0x7FF, True), (0x800, False), (EXTENDED, True), (EXTENDED | 0x1FFFFFFF, True), (-1, False)],
)
def test_only_identifiers_that_fit_their_kind_are_identifiers(peer: int, legal: bool) -> None:
    assert is_identifier(peer) is legal


def test_the_bus_compares_eleven_bits_then_the_kind_then_eighteen_bits() -> None:
    assert arbitration_key(0x2A5) == (0x2A5, 0, 0)
    assert arbitration_key(0x2A5 << 18 | 0x31234 | EXTENDED) == (0x2A5, 1, 0x31234)


def test_a_bus_counts_whole_bits() -> None:
    assert frames_bits([1, 2], [b"", b"\xff" * 8]).dtype == frames_bits([], []).dtype == "int64"
    with pytest.raises(ValueError, match="zip"):
        frames_bits([1, 2], [b""])


def test_an_extended_identifier_beyond_29_bits_is_none() -> None:
    assert not is_identifier(EXTENDED | 1 << 29)
