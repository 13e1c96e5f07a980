"""Framing garbage, against lines drawn by hand."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from emulator.transports.uart import Receiver, Sampled, line_levels, resample, same_speed

SPEEDS = [9600, 19_200, 38_400, 57_600, 115_200, 500_000]


def text_of(sampled: Sampled) -> list[tuple[int, bool]]:
    return list(zip(sampled.values.tolist(), sampled.framing_error.tolist(), strict=True))


def test_a_byte_on_the_line_is_start_eight_bits_lowest_first_stop() -> None:
    assert line_levels(b"\x55\x01").tolist() == [0, 1, 0, 1, 0, 1, 0, 1, 0, 1, 0, 1, 0, 0, 0, 0, 0, 0, 0, 1]


@pytest.mark.parametrize(
    ("sent", "slower", "faster", "expected"),
    [
        # 55 in receiver bits is 00 11 00 11 00 11 00 11 00 11. Start, then 0 11 00 11 0: 66 lowest bit first, and
        # the stop bit is low. The next edge is two bits on: start, then 0 11 00, the line idle from there: E6.
        (b"\x55", 9600, 19_200, [(0x66, True), (0xE6, False)]),
        # FF is a start bit and nothing but high: two low receiver bits, the second one read as bit 0.
        (b"\xff", 9600, 19_200, [(0xFE, False)]),
        # 00: low for 18 receiver bits, a break; its stop bit is the next rise, no further edge.
        (b"\x00", 9600, 19_200, [(0x00, True)]),
        # F0: low for start and four bits = 10 receiver bits, all of one frame with its stop: a break, too.
        (b"\xf0", 9600, 19_200, [(0x00, True)]),
        # F8: low for 8 receiver bits: start and seven zero bits, then high: bit 7 set, stop high.
        (b"\xf8", 9600, 19_200, [(0x80, False)]),
    ],
)
def test_a_receiver_twice_as_fast_reads_each_bit_twice(
    sent: bytes, slower: int, faster: int, expected: list[tuple[int, bool]]
) -> None:
    assert text_of(resample(sent, slower, faster)) == expected


def test_a_receiver_at_half_the_speed_reads_two_bytes_as_one() -> None:
    # 00 00 at 19 200: nine low, one high, nine low, one high. At 9 600, in half bits from the edge: samples at 3, 5, 7
    # low, 9 high (the first stop bit), 11, 13, 15, 17 low, the stop sample at 19 high.
    assert text_of(resample(b"\x00\x00", 19_200, 9600)) == [(0x08, False)]


def test_a_low_pulse_shorter_than_half_a_bit_is_a_glitch() -> None:
    # FF at 500 000: one low bit of 2 us; a receiver at 38 400 looks again after 13 us.
    assert text_of(resample(b"\xff", 500_000, 38_400)) == []


@pytest.mark.parametrize("baud", SPEEDS)
def test_at_the_same_speed_every_byte_is_read_as_sent(baud: int) -> None:
    every = bytes(range(256))
    sampled = resample(every, baud, baud)
    assert sampled.values.tobytes() == every
    assert not sampled.framing_error.any()


@given(data=st.binary(max_size=50), baud=st.sampled_from(SPEEDS), off=st.floats(-0.02, 0.02))
def test_speeds_that_count_as_the_same_are_read_without_error(data: bytes, baud: int, off: float) -> None:
    other = round(baud * (1 + off))
    if same_speed(baud, other):
        assert resample(data, baud, other).values.tobytes() == data


@given(
    data=st.binary(max_size=60),
    cuts=st.lists(st.integers(0, 60), max_size=6),
    sender=st.sampled_from(SPEEDS),
    receiver=st.sampled_from(SPEEDS),
)
def test_garbage_does_not_depend_on_the_pieces_it_comes_in(
    data: bytes, cuts: list[int], sender: int, receiver: int
) -> None:
    whole = resample(data, sender, receiver)
    places = sorted({min(cut, len(data)) for cut in cuts} | {0, len(data)})
    pieces = [data[start:end] for start, end in pairwise(places)] or [b""]
    machine = Receiver(sender, receiver)
    heard = [machine.feed(piece, idle_after=index == len(pieces) - 1) for index, piece in enumerate(pieces)]
    assert b"".join(part.values.tobytes() for part in heard) == whole.values.tobytes()
    assert [error for part in heard for error in part.framing_error.tolist()] == whole.framing_error.tolist()


@given(data=st.binary(min_size=1, max_size=60), sender=st.sampled_from(SPEEDS), receiver=st.sampled_from(SPEEDS))
def test_no_more_frames_are_read_than_the_line_has_time_for(data: bytes, sender: int, receiver: int) -> None:
    frames = len(resample(data, sender, receiver).values)
    assert (frames - 1) * 9.5 / receiver <= len(data) * 10 / sender


def test_the_next_payload_begins_afresh_after_the_line_was_idle() -> None:
    machine = Receiver(9600, 19_200)
    once = machine.feed(b"\x55", idle_after=True)
    again = machine.feed(b"\x55", idle_after=True)
    assert text_of(once) == text_of(again)


@pytest.mark.parametrize(
    ("ignore_break", "ignore_errors", "zero_errors", "expected"),
    [
        (False, False, False, b"A\x66\x00"),
        (True, False, False, b"A\x66"),
        (False, True, False, b"A\x00"),
        (False, False, True, b"A\x00\x00"),
    ],
)
def test_a_terminal_gives_errors_as_its_flags_say(
    ignore_break: bool, ignore_errors: bool, zero_errors: bool, expected: bytes
) -> None:
    parts = [resample(b"A", 9600, 9600), resample(b"\x55", 9600, 19_200), resample(b"\x00", 9600, 19_200)]
    joined = Sampled(
        np.concatenate([parts[0].values, parts[1].values[:1], parts[2].values]),
        np.concatenate([parts[0].framing_error, parts[1].framing_error[:1], parts[2].framing_error]),
    )
    assert joined.as_tty(ignore_break, ignore_errors, zero_errors) == expected


@pytest.mark.parametrize(("sender", "receiver"), [(0, 9600), (9600, 0)])
def test_a_speed_of_zero_is_our_own_fault(sender: int, receiver: int) -> None:
    with pytest.raises(ValueError, match="baud > 0"):
        Receiver(sender, receiver)
