"""Frames and layouts: published bytes first."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocols.errors import EncodeError
from protocols.lms2xx import telegrams as wire
from protocols.lms2xx.outputs import INTENSITY, MEAN, REFLECTIVITY, SUB_RANGE, Output

FRAMES = [
    (bytes.fromhex(left), right.strip())
    for left, _, right in (
        line.partition("|")
        for line in (Path(__file__).parent / "data" / "frames.txt").read_text(encoding="utf-8").splitlines()
        if not line.startswith("#")
    )
]


@pytest.mark.parametrize(("frame", "meaning"), FRAMES, ids=[meaning for _, meaning in FRAMES])
def test_a_known_frame_opens_and_is_made_again_byte_for_byte(frame: bytes, meaning: str) -> None:
    telegram = wire.open_frame(frame)
    assert telegram is not None
    payload = bytes((telegram.command,)) + telegram.data
    if telegram.address & wire.REPLY:
        assert wire.reply(payload[:-1], payload[-1], telegram.address & 0x7F) == frame
    else:
        assert wire.request(payload, telegram.address) == frame


@pytest.mark.parametrize(("frame", "meaning"), FRAMES, ids=[meaning for _, meaning in FRAMES])
def test_a_frame_with_any_byte_changed_does_not_open(frame: bytes, meaning: str) -> None:
    for place in range(len(frame)):
        broken = bytearray(frame)
        broken[place] ^= 0x40
        assert wire.open_frame(bytes(broken)) is None


def test_all_values_of_181_points_in_mm_ends_as_computed_elsewhere() -> None:
    values = np.full(181, 1234, np.uint16)
    frame = wire.reply(wire.all_values(values, wire.Header(181, 1)), 0x10)
    assert len(frame) == 372
    assert frame.startswith(bytes.fromhex("02 80 6E 01 B0 B5 40"))
    assert frame.endswith(bytes.fromhex("10 2F 05"))


def test_all_values_of_361_points_in_cm_ends_as_computed_elsewhere() -> None:
    values = np.arange(100, 461).astype(np.uint16)
    frame = wire.reply(wire.all_values(values, wire.Header(361, 0)), 0x10)
    assert len(frame) == 732
    assert frame.startswith(bytes.fromhex("02 80 D6 02 B0 69 01 64 00 65 00"))
    assert frame.endswith(bytes.fromhex("CC 01 10 A7 48"))


@pytest.mark.parametrize(
    ("part", "count", "start", "end"),
    [(0, 181, "02 80 6E 01 B0 B5 20", "10 02 17"), (2, 180, "02 80 6C 01 B0 B4 30", "10 78 0D")],
)
def test_partial_scans_carry_their_number_and_bit_13(part: int, count: int, start: str, end: str) -> None:
    frame = wire.reply(wire.all_values(np.full(count, 1234, np.uint16), wire.Header(count, 0, part)), 0x10)
    assert frame.startswith(bytes.fromhex(start))
    assert frame.endswith(bytes.fromhex(end))


def test_indices_stand_between_values_and_status() -> None:
    payload = wire.all_values(np.full(401, 1234, np.uint16), wire.Header(401, 0)) + bytes((5, 6))
    frame = wire.reply(payload, 0x10)
    assert len(frame) == 814
    assert frame.startswith(bytes.fromhex("02 80 28 03 B0 91 01"))
    assert frame.endswith(bytes.fromhex("05 06 10 72 A7"))


@pytest.mark.parametrize(
    ("header", "word"),
    [
        (wire.Header(361, 0), "69 01"),
        (wire.Header(361, 1), "69 41"),
        (wire.Header(181, 1), "B5 40"),
        (wire.Header(401, 0), "91 01"),
        (wire.Header(180, 0, 1), "B4 28"),
        (wire.Header(180, 0, 3), "B4 38"),
        (wire.Header(181, 2), "B5 80"),
    ],
)
def test_header_words_of_the_sources(header: wire.Header, word: str) -> None:
    assert header.encode() == bytes.fromhex(word)
    assert wire.Header.decode(int.from_bytes(header.encode(), "little")) == header


@given(st.integers(0, 1023), st.integers(0, 3), st.none() | st.integers(0, 3))
def test_a_header_survives_its_word(count: int, unit: int, partial: int | None) -> None:
    header = wire.Header(count, unit, partial)
    assert wire.Header.decode(int.from_bytes(header.encode(), "little")) == header


def test_more_values_than_ten_bits_hold_are_an_error() -> None:
    with pytest.raises(EncodeError, match="1024"):
        wire.Header(1024).encode()


@pytest.mark.parametrize(
    ("output", "points", "size"),
    [
        (Output(0xB0), 101, 212),
        (Output(0xB0, partial=True), 180, 370),
        (Output(0xB0), 401, 812),
        (Output(MEAN, 5), 361, 733),
        (Output(SUB_RANGE, groups=((1, 401),)), 401, 816),
        (Output(REFLECTIVITY, groups=((1, 181),)), 181, 559),
        (Output(INTENSITY, groups=((1, 199),)), 361, 812),
    ],
)
def test_lengths_of_value_telegrams_are_those_of_the_sources(output: Output, points: int, size: int) -> None:
    assert output.telegram_bytes(points, indices=False) == size
    assert output.telegram_bytes(points, indices=True) == size + 2


def test_a_telegram_of_another_kind_holds_no_values() -> None:
    assert wire.read_values(wire.Telegram(0x80, 0xA0, b"\x00\x10")) is None
    assert wire.read_values(wire.Telegram(0x80, 0xB0, b"\x05\x00\x10")) is None
