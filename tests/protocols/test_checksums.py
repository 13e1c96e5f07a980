"""Checks against published values."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocols.checksums import TABLE_BYTES, crc16_lms, crc16_lms_by_steps, sum8, xor8


@pytest.mark.parametrize(
    ("message", "registers"),
    [
        ("02 00 01 00 31", "0002 0204 0409 0912 1215"),
        ("02 80 03 00 A0 00 10", "0002 0284 850B 8913 9283 0503 0A16"),
        (
            "02 00 0A 00 20 00 53 49 43 4B 5F 4C 4D 53",
            "0002 0204 0402 0204 0428 2850 50F3 F2AF 2C18 1B7B 7DA9 A41E 8474 C5BE",
        ),
    ],
)
def test_the_lms_crc_goes_through_the_worked_steps(message: str, registers: str) -> None:
    data = bytes.fromhex(message)
    for count, register in enumerate(registers.split(), 1):
        assert crc16_lms(data[:count]) == int(register, 16)
        assert crc16_lms_by_steps(data[:count]) == int(register, 16)


@given(st.binary(max_size=TABLE_BYTES + 50))
def test_the_lms_crc_by_table_is_the_one_by_steps(data: bytes) -> None:
    assert crc16_lms(data) == crc16_lms_by_steps(data)


def test_the_lms_crc_takes_views() -> None:
    assert crc16_lms(memoryview(b"\x02\x00\x01\x001")) == crc16_lms(bytearray(b"\x02\x00\x01\x001")) == 0x1215


def test_the_lms_crc_of_nothing_is_zero() -> None:
    assert crc16_lms(b"") == 0


def test_xor8_is_the_check_of_a_published_nmea_sentence() -> None:
    # NMEA 0183, the GGA sentence of Wikipedia's article: ...*76
    assert xor8(b"GPGGA,092750.000,5321.6802,N,00630.3372,W,1,8,1.03,61.7,M,55.2,M,,") == 0x76


def test_xor8_is_the_check_of_a_published_cola_telegram() -> None:
    # SICK telegram listing 8014631, sMN SetAccessMode: ends in B3.
    body = "73 4D 4E 20 53 65 74 41 63 63 65 73 73 4D 6F 64 65 20 03 F4 72 47 44"
    assert xor8(bytes.fromhex(body)) == 0xB3


def test_sum8_of_a_whole_intel_hex_record_is_zero() -> None:
    # The record of Wikipedia's article: :10010000214601360121470136007EFE09D2190140
    assert sum8(bytes.fromhex("10010000214601360121470136007EFE09D2190140")) == 0


def test_sums_of_nothing_are_zero() -> None:
    assert (xor8(b""), sum8(b"")) == (0, 0)
