"""CoLa binary beside the user protocol (SICK 9106698, p. 18-21): frames, login, errors; frames computed here."""

from __future__ import annotations

from functools import reduce

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocols.ld.cola import ColaSplitter
from protocols.ld.packages import encode_packages
from protocols.ld.usp import encode_frame as encode_usp
from protocols.session import Address, DropReason, LinkKind
from tests.protocols.ld.reader import package, request
from tests.protocols.ld.rig import SECOND, Rig


def frame(payload: bytes) -> bytes:
    check = reduce(lambda a, b: a ^ b, payload, 0)
    return b"\x02\x02\x02\x02" + len(payload).to_bytes(4, "big") + payload + bytes((check,))


TALK = [
    (b"sMN SetAccessMode \x03\xf4\x72\x47\x44", b"sAN SetAccessMode \x01"),
    (b"sMN SetAccessMode \x03\xf4\x72\x47\x45", b"sAN SetAccessMode \x00"),
    (b"sMN SetAccessMode \x04\xf4\x72\x47\x44", b"sAN SetAccessMode \x00"),
    (b"sMN SetAccessMode \x03", b"sFA\x00\x05"),
    (b"sMN Run", b"sAN Run \x01"),
    (b"sRN DeviceIdent", b"sRA DeviceIdent \x00\x0aLD-LRS1000\x00\x05V1.00"),
    (b"sRN Nothing", b"sFA\x00\x03"),
    (b"sWN Nothing \x01", b"sFA\x00\x03"),
    (b"sMN Nothing", b"sFA\x00\x02"),
    (b"sEN Nothing \x01", b"sFA\x00\x0f"),
    (b"", b"sFA\x00\x0c"),
]


@pytest.mark.parametrize(("asked", "reported"), TALK)
def test_a_telegram_is_answered_on_tcp_and_on_the_line(asked: bytes, reported: bytes) -> None:
    for kind, address in ((LinkKind.STREAM, Address(0, 1)), (LinkKind.SERIAL, Address(0, 0))):
        for chunks in ([frame(asked)], [bytes((byte,)) for byte in frame(asked)]):
            rig = Rig({"delays": "fast"}, kind=kind, address=address)
            rig.run(0)
            rig.take()
            for chunk in chunks:
                rig.put(chunk)
            rig.run(SECOND // 2)
            assert b"".join(emission.payload for emission in rig.take()) == frame(reported)
            assert (DropReason.REFUSED in rig.dropped()) is (reported.startswith(b"sFA") or reported.endswith(b"\x00"))


def test_both_protocols_share_a_link_in_any_order() -> None:
    rig = Rig({"delays": "fast"})
    rig.put(request(0x0102) + frame(b"sMN Run") + request(0x0102))
    rig.run(SECOND)
    labels = [emission.label for emission in rig.take()]
    assert sorted(labels) == ["8102", "8102", "CoLa"]
    line = Rig({"delays": "fast"}, kind=LinkKind.SERIAL, address=Address(0, 0))
    line.put(frame(b"sMN Run") + package(0x1410, 3, 0, 0x0102))
    line.run(SECOND)
    said = [emission.payload for emission in line.take() if emission.payload]
    assert sorted(said) == sorted([frame(b"sAN Run \x01"), encode_packages(bytes.fromhex("810200000001"), 0x1014)])


def test_a_model_without_cola_hears_noise() -> None:
    rig = Rig({"delays": "fast"}, facts={"model": "sick-ld-oem1000"})
    rig.put(frame(b"sMN Run"))
    rig.run(2 * SECOND)
    assert not rig.take()


def test_a_frame_with_a_wrong_checksum_is_not_answered() -> None:
    rig = Rig({"delays": "fast"})
    whole = frame(b"sMN Run")
    rig.put(whole[:-1] + bytes((whole[-1] ^ 1,)) + request(0x0102))
    rig.run(2 * SECOND)
    assert [emission.label for emission in rig.take()] == ["8102"]
    assert DropReason.NO_START_BYTE in rig.dropped()


def test_half_a_frame_is_given_up_and_the_user_protocol_goes_on() -> None:
    rig = Rig({"delays": "fast"})
    rig.put(frame(b"sMN Run")[:9])
    rig.run(2 * SECOND)
    rig.put(request(0x0102))
    rig.run(SECOND)
    assert [emission.label for emission in rig.take()] == ["8102"]


@given(st.binary(max_size=60), st.lists(st.integers(0, 60), max_size=6).map(sorted))
def test_bytes_that_are_no_frame_go_on_unchanged_however_they_are_cut(data: bytes, cuts: list[int]) -> None:
    splitter, others = ColaSplitter(), b""
    for start, end in zip([0, *cuts], [*cuts, len(data)], strict=True):
        rest, found = splitter.feed(data[start:end])
        assert not found or b"\x02\x02\x02\x02" in data
        others += rest
    if b"\x02\x02\x02\x02" not in data:
        assert others + splitter.expire() == data


@given(st.binary(max_size=200))
def test_a_frame_is_taken_out_whole(payload: bytes) -> None:
    assert ColaSplitter().feed(b"\x55" + frame(payload) + b"\x66") == (b"\x55\x66", [payload])


@given(st.lists(st.sampled_from([0x02, 0x55, 0x00]), max_size=20).map(bytes), st.integers(1, 40))
def test_a_frame_of_the_user_protocol_goes_on_at_once_whatever_it_holds(payload: bytes, chunk: int) -> None:
    splitter, whole = ColaSplitter(), encode_usp(payload)
    others, taken = b"", []
    for start in range(0, len(whole), chunk):
        rest, found = splitter.feed(whole[start : start + chunk])
        others, taken = others + rest, taken + found
    assert (others, taken, bool(splitter)) == (whole, [], False)
    assert splitter.feed(frame(b"sMN Run")) == (b"", [b"sMN Run"])


def test_a_request_that_ends_with_stx_is_answered_at_once() -> None:
    rig = Rig({"mode": "idle", "delays": "fast"})
    asked = request(0x0103)
    assert asked.endswith(b"\x02")
    rig.put(asked)
    rig.run(SECOND // 100)
    assert [emission.label for emission in rig.take()] == ["FF00"]
