"""Values in both dialects: inverse to each other, and every wrong argument has its error code."""

from __future__ import annotations

import contextlib
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocols.cola.layouts import TIME
from protocols.errors import EncodeError
from protocols.skeleton.cola_values import ASCII, BINARY, INTEGERS, Code, Rejected, decode, encode

TEXT = "u8 u16 u32 i8 i16 i32 p32 f32 str s4 [u16 [i8]]"


def integers(kind: str) -> st.SearchStrategy[int]:
    bits = 8 * INTEGERS[kind]
    return st.integers(0, 2**bits - 1) if kind[0] == "u" else st.integers(-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)


LATIN = st.characters(min_codepoint=0x21, max_codepoint=0x7E)
VALUES = st.tuples(
    *map(integers, ("u8", "u16", "u32", "i8", "i16", "i32", "p32")),
    st.floats(width=32, allow_nan=False, allow_infinity=False),
    st.text(st.characters(min_codepoint=0x20, max_codepoint=0xFF), max_size=20).map(lambda text: f"<{text}>"),
    st.text(LATIN, min_size=4, max_size=4),
    st.lists(
        st.tuples(integers("u16"), st.lists(st.tuples(integers("i8")).map(list), max_size=3)).map(list), max_size=3
    ),
)


@pytest.mark.parametrize("dialect", [ASCII, BINARY])
@given(values=VALUES)
def test_what_is_written_is_read_back(dialect: bytes, values: tuple[Any, ...]) -> None:
    assert decode(TEXT, dialect, encode(TEXT, dialect, values)) == list(values)


@pytest.mark.parametrize("dialect", [ASCII, BINARY])
@pytest.mark.parametrize("kind", ["u8*", "u16*"])
@given(numbers=st.lists(st.integers(0, 255), max_size=30))
def test_arrays_too(dialect: bytes, kind: str, numbers: list[int]) -> None:
    found = decode(kind, dialect, encode(kind, dialect, [np.array(numbers)]))
    assert found[0].tolist() == numbers


@given(
    st.sampled_from([TEXT, TIME, "u8 *", "str str", "[u16]"]), st.sampled_from([ASCII, BINARY]), st.binary(max_size=60)
)
def test_any_bytes_are_values_or_an_error_code(text: str, dialect: bytes, data: bytes) -> None:
    with contextlib.suppress(Rejected):  # the only exception that it may raise
        decode(text, dialect, data)


@pytest.mark.parametrize(
    ("reported", "wanted"),
    [
        ("FFF92230", -450_000),
        ("-450000", -450_000),
        ("+2250000", 2_250_000),
        ("225510", 2_250_000),
        ("0", 0),
        ("00", 0),
    ],
)
def test_hosts_write_numbers_as_drivers_do(reported: str, wanted: int) -> None:
    assert decode("i32", ASCII, reported.encode()) == [wanted]


def test_numbers_are_upper_case_hexadecimal_without_leading_zeros_but_where_drivers_read_eight_digits() -> None:
    assert encode("i32 u16 f32 p32 str", ASCII, [-450_000, 5000, 1.0, 450, "not defined"]) == (
        b"FFF92230 1388 3F800000 000001C2 B not defined"
    )


@pytest.mark.parametrize(
    ("text", "dialect", "data", "code"),
    [
        ("u8", ASCII, b"", Code.TOO_LITTLE),
        ("u8", BINARY, b"", Code.TOO_LITTLE),
        ("u8", ASCII, b"1 2", Code.TOO_MUCH),
        ("u8", BINARY, b"12", Code.TOO_MUCH),
        ("u8", ASCII, b"100", Code.VALUE_OVERFLOW),
        ("u8", ASCII, b"-1", Code.VALUE_OVERFLOW),
        ("u32", ASCII, rb"\x00\x00\x13\x88", Code.INVALID_CHARACTER),
        ("u32", ASCII, b"1_0", Code.INVALID_CHARACTER),
        ("f32", ASCII, b"7FC00000", Code.INVALID_DATA),
        ("str", ASCII, b"3 abcd", Code.INVALID_DATA),
        ("str", BINARY, b"\x00\x05abcd", Code.TOO_LITTLE),
        ("str", BINARY, b"\x00\x03a\x03b", Code.INVALID_CHARACTER),  # CoLa-A could not tell it any more
        ("s4", BINARY, b"RA\x02G", Code.INVALID_CHARACTER),
        ("[u16]", BINARY, b"\xff\xff", Code.TOO_LITTLE),
    ],
)
def test_wrong_arguments_have_their_code(text: str, dialect: bytes, data: bytes, code: Code) -> None:
    with pytest.raises(Rejected) as caught:
        decode(text, dialect, data)
    assert caught.value.code is code


@pytest.mark.parametrize(
    ("text", "values"), [("u8", [256]), ("u8", [-1]), ("i16", [40_000]), ("s4", ["abc"]), ("u8", [1, 2])]
)
def test_what_the_wire_cannot_hold_is_refused(text: str, values: list[Any]) -> None:
    with pytest.raises(EncodeError):
        encode(text, BINARY, values)
