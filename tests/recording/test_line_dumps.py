"""Raw bytes of a serial line, cut into what can be sent one by one."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from emulator.recording.line_dumps import telegrams_of
from tests.draws import cases

# published: the LMS2xx's type request's and stop's answers begin so; SICK's listing, 4.3 and 4.4
STREAM = bytes.fromhex("06 0280 0300 A000 1016 0A 06 15")
PACKAGES = b"\x021014000400000202000119F3\x03\x0210140004\x03"
"As on RS-232 of an LD: hexadecimal digits between STX and ETX."


def test_acknowledgements_telegrams_and_packages_are_pieces() -> None:
    assert telegrams_of(STREAM) == [b"\x06", STREAM[1:10], b"\x06", b"\x15"]
    assert telegrams_of(PACKAGES) == [PACKAGES[:26], PACKAGES[26:]]


@pytest.mark.parametrize("garbage", [b"x", b"\x02", b"\x02\x80", b"\x02\x80\xff\xff", b"\x06\x06", b"\0" * 9])
def test_garbage_before_and_behind_stays_where_it_is(garbage: bytes) -> None:
    one = STREAM[1:10]
    parts = telegrams_of(garbage + one + one + garbage)
    assert b"".join(parts) == garbage + one + one + garbage
    assert one in parts


@given(st.lists(st.sampled_from([b"\x02\x80", b"\x02", b"\x06", b"\x15", b"\x03\0", b"A1", STREAM, PACKAGES, b"\xff"])))
@settings(max_examples=cases(200), deadline=None, derandomize=True)
def test_nothing_is_lost_and_nothing_is_empty(parts: list[bytes]) -> None:
    found = telegrams_of(b"".join(parts))
    assert b"".join(found) == b"".join(parts)
    assert all(found)
