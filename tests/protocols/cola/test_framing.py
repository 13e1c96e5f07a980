"""Frames of both dialects: every case whole, byte by byte, with garbage around it; telegrams changed by faults."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocols.cola.framing import ColaFraming
from protocols.session import DropReason, Emission
from protocols.skeleton.cola_frames import ColaSplitter, frame
from protocols.skeleton.cola_values import BINARY
from protocols.skeleton.receiving import Fault
from tests.protocols.cola.reader import ask_a, ask_b, frames, read
from tests.protocols.cola.rig import Rig

STATE = bytes.fromhex("02 02 02 02 00 00 00 11 73 52 4e 20 53 43 64 65 76 69 63 65 73 74 61 74 65 30".replace(" ", ""))
"`sRN SCdevicestate`, worked frame of the specification, section 1.5."
RUN = bytes.fromhex("02 02 02 02 00 00 00 07 73 4d 4e 20 52 75 6e 19".replace(" ", ""))

CASES = {
    "CoLa-B": (STATE, [b"BsRN SCdevicestate"]),
    "CoLa-A": (b"\x02sRN SCdevicestate\x03", [b"AsRN SCdevicestate"]),
    "both": (RUN + b"\x02sMN Run\x03" + RUN, [b"BsMN Run", b"AsMN Run", b"BsMN Run"]),
    "empty": (b"\x02\x03", [b"A"]),
    "binary arguments like frame bytes": (
        frame(BINARY, b"sWN x \x02\x02\x02\x02\x03"),
        [b"BsWN x \x02\x02\x02\x02\x03"],
    ),
}


def fed(data: bytes, size: int) -> list[bytes | Fault]:
    splitter, found = ColaSplitter(), []
    for at in range(0, len(data), size):
        found += splitter.feed(data[at : at + size])
    while splitter:
        found += splitter.expire()
    return found


@pytest.mark.parametrize("size", [1, 3, 1000])
@pytest.mark.parametrize("before", [b"", b"\x00garbage", b"\x03\x03"])
@pytest.mark.parametrize("after", [b"", b"\xff\x00"])
@pytest.mark.parametrize("case", CASES)
def test_telegrams_are_found_in_any_chunking_and_between_garbage(
    case: str, before: bytes, after: bytes, size: int
) -> None:
    data, wanted = CASES[case]
    found = fed(before + data + after, size)
    assert [one for one in found if isinstance(one, bytes)] == wanted
    assert sum(one.count for one in found if isinstance(one, Fault)) == len(before) + len(after)


@pytest.mark.parametrize(
    ("damaged", "reason"),
    [
        (STATE[:-1] + b"\x00", DropReason.BAD_CHECKSUM),
        (b"\x02\x02\x02\x02\x7f\xff\xff\xff", DropReason.BAD_LENGTH),
        (b"\x02sRN half of a telegram", DropReason.BAD_LENGTH),
        (b"\x02\x02\x02", DropReason.NO_START_BYTE),
    ],
)
@pytest.mark.parametrize("size", [1, 1000])
def test_a_damaged_telegram_does_not_hide_the_next_one(damaged: bytes, reason: DropReason, size: int) -> None:
    found = fed(damaged + b"\x02sMN Run\x03", size)
    assert b"AsMN Run" in found
    assert reason in [one.reason for one in found if isinstance(one, Fault)]


def test_half_a_telegram_is_given_up_after_a_second_and_what_it_swallowed_is_read() -> None:
    rig = Rig()
    rig.forget()
    rig.put(b"\x02\x02\x02\x02\x00\x00\x03\x00" + b"\x02sRN SCdevicestate\x03")
    assert rig.next(within_ns=2_000_000_000) == ("A", b"sRA SCdevicestate 1")
    assert DropReason.TIMEOUT in rig.dropped()


@given(st.lists(st.binary(max_size=40), max_size=6))
def test_whatever_comes_every_byte_is_told_of(parts: list[bytes]) -> None:
    splitter, reported = ColaSplitter(), 0
    for part in parts:
        for one in splitter.feed(part):
            reported += one.count if isinstance(one, Fault) else len(frame(one[:1], one[1:]))
    while splitter:
        for one in splitter.expire():
            reported += one.count if isinstance(one, Fault) else len(frame(one[:1], one[1:]))
    assert reported == sum(map(len, parts))


@given(st.binary(min_size=1, max_size=300))
def test_any_payload_comes_back_from_a_frame(payload: bytes) -> None:
    assert ColaSplitter().feed(frame(BINARY, payload)) == [BINARY + payload]


# ---------------------------------------------------------------- faults


@pytest.fixture(params=["A", "B"])
def scan(request: pytest.FixtureRequest) -> tuple[str, Emission]:
    rig = Rig()
    rig.put(ask_a("sEN LMDscandata 1") if request.param == "A" else ask_b("sEN LMDscandata", "01"))
    rig.run(200_000_000)
    return request.param, next(one for one in rig.sent if one.sweep is not None)


def test_counters_jump_and_nothing_else_changes(scan: tuple[str, Emission]) -> None:
    dialect, one = scan
    changed = ColaFraming().with_counter(one, 5)
    assert changed is not None
    old, new = read(*frames(one.payload)[0]), read(*frames(changed)[0])
    assert (new.telegrams, new.scans) == (old.telegrams + 5, old.scans + 5)
    assert (new.scan_us, new.channels) == (old.scan_us, old.channels)
    assert frames(changed)[0][0] == dialect


def test_an_old_scan_comes_with_the_counters_of_a_fresh_one(scan: tuple[str, Emission]) -> None:
    _, one = scan
    fresh = ColaFraming().with_counter(one, 700)
    assert fresh is not None
    reported = ColaFraming().stale(one, Emission(0, fresh))
    assert reported == fresh


def test_check_and_length_are_those_of_cola_b_alone(scan: tuple[str, Emission]) -> None:
    dialect, one = scan
    bad, longer = ColaFraming().bad_check(one), ColaFraming().with_length(one, 3)
    assert (bad is None, longer is None) == (dialect == "A", dialect == "A")
    if bad is not None and longer is not None:
        assert bad[:-1] == one.payload[:-1]
        assert int.from_bytes(longer[4:8], "big") == int.from_bytes(one.payload[4:8], "big") + 3


@pytest.mark.parametrize("asked", [ask_a("sRN SCdevicestate"), ask_b("sRN SCdevicestate")])
def test_a_request_is_made_one_that_the_device_refuses(asked: bytes) -> None:
    reported = ColaFraming().to_be_refused(asked)
    assert reported is not None
    rig = Rig()
    rig.put(reported)
    assert rig.next()[1] in (b"sFA 3", b"sFA\x00\x03")
    assert ColaFraming().is_whole(asked)
    assert not ColaFraming().is_whole(asked[:-1])
