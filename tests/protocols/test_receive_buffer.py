"""The buffer keeps order, keeps the beginning of a start, and keeps its bound."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocols.receive_buffer import ReceiveBuffer


def test_it_gives_bytes_back_in_order() -> None:
    buffer = ReceiveBuffer(10)
    assert buffer.add(b"abc") == 3
    assert buffer.add(b"def") == 3
    assert buffer.peek(4) == b"abcd"
    assert buffer.peek(7) is None
    assert buffer.take(2) == b"ab"
    assert buffer.take(99) == b"cdef"
    assert len(buffer) == 0


def test_it_takes_no_more_than_its_limit() -> None:
    buffer = ReceiveBuffer(4)
    assert buffer.add(b"abcdef") == 4
    assert buffer.room == 0
    assert buffer.add(b"g") == 0
    assert buffer.clear() == 4
    assert buffer.room == 4


def test_a_limit_below_one_byte_is_an_error() -> None:
    with pytest.raises(ValueError, match="limit 0"):
        ReceiveBuffer(0)


def test_skipping_to_a_start_keeps_the_beginning_of_one_at_the_end() -> None:
    buffer = ReceiveBuffer(20)
    buffer.add(b"xx\x02y\x02U")
    assert buffer.skip_to(b"\x02USP") == 4
    assert buffer.peek(2) == b"\x02U"
    buffer.add(b"SP!")
    assert buffer.skip_to(b"\x02USP") == 0
    assert buffer.take(5) == b"\x02USP!"


def test_skipping_where_nothing_begins_throws_everything_away() -> None:
    buffer = ReceiveBuffer(20)
    buffer.add(b"noise")
    assert buffer.skip_to(b"\x02") == 5
    assert len(buffer) == 0


@given(st.lists(st.binary(max_size=9), max_size=20), st.binary(min_size=1, max_size=3))
def test_skipping_in_any_pieces_loses_only_what_stands_before_the_start(pieces: list[bytes], start: bytes) -> None:
    buffer = ReceiveBuffer(1000)
    skipped = 0
    for piece in pieces:
        buffer.add(piece)
        skipped += buffer.skip_to(start)
        if (found := buffer.peek(len(start))) == start:
            break
    whole = b"".join(pieces)
    at = whole.find(start)
    if at >= 0:
        assert found == start
        assert skipped == at
    else:
        assert skipped + len(buffer) == len(whole)
        assert len(buffer) < len(start)
