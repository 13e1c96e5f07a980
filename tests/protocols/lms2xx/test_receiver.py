"""What a host sends, in any pieces and with anything around it."""

from __future__ import annotations

import pytest

from protocols.lms2xx.commands import KNOWN
from protocols.lms2xx.receiver import Receiver
from protocols.lms2xx.telegrams import Telegram, frame, request
from protocols.session import DropReason
from protocols.skeleton.receiving import Fault
from tests.protocols.lms2xx.rig import MS

STATUS = bytes.fromhex("02 00 01 00 31 15 12")
INSTALL = bytes.fromhex("02 00 0A 00 20 00 53 49 43 4B 5F 4C 4D 53 BE C5")
BLOCK = request(b"\x77" + bytes.fromhex("00 00 46 00 02 02 00 00 00 02 02 02 00 00 0A 0A 50 64") * 2)
GOOD = {"shortest": STATUS, "password": INSTALL, "with 02 inside": BLOCK}


def receiver(strict: bool = False) -> Receiver:
    return Receiver(KNOWN, 6 * MS if strict else 200 * MS, strict)


def telegrams(found: list[Telegram | Fault]) -> list[bytes]:
    return [bytes((one.command,)) + one.data for one in found if isinstance(one, Telegram)]


def reasons(found: list[Telegram | Fault]) -> list[DropReason]:
    return [one.reason for one in found if isinstance(one, Fault)]


def every_way(data: bytes, address: int = 0) -> list[list[bytes]]:
    """The telegrams found whole, byte by byte, in twos and sevens, and twice at once."""
    ways = []
    for size in (len(data), 1, 2, 7):
        taker, found = receiver(), []
        for at in range(0, len(data), size):
            found += telegrams(taker.feed(data[at : at + size], 5, address))
        ways.append(found)
    twice = telegrams(receiver().feed(data + data, 5, address))
    assert twice == ways[0] * 2
    return ways


@pytest.mark.parametrize("good", GOOD)
@pytest.mark.parametrize(
    "before", [b"", b"\x00", b"\xff\x06\x15", b"\x02\x00\x00\x00", b"\x02\x02", b"\x02\xff\xff\xff"]
)
@pytest.mark.parametrize("behind", [b"", b"\xee\xee", b"\x00\x00\x03"])
def test_a_telegram_is_found_in_any_pieces_with_garbage_around_it(good: str, before: bytes, behind: bytes) -> None:
    payload = GOOD[good][4:-2]
    for found in every_way(before + GOOD[good] + behind):
        assert found == [payload]


def test_a_wrong_crc_is_told_once_and_takes_the_whole_telegram_with_it() -> None:
    broken = INSTALL[:-1] + b"\x00"
    for size in (len(broken), 1):
        taker = receiver()
        found = [one for at in range(0, len(broken), size) for one in taker.feed(broken[at : at + size], 5, 0)]
        assert reasons(found) == [DropReason.BAD_CHECKSUM]
        assert telegrams(taker.feed(STATUS, 6, 0)) == [b"\x31"]


@pytest.mark.parametrize(("length", "reason"), [(0, DropReason.BAD_LENGTH), (818, DropReason.OVERLONG)])
def test_an_impossible_length_makes_the_stx_noise(length: int, reason: DropReason) -> None:
    data = b"\x02\x00" + length.to_bytes(2, "little") + b"\x31"
    found = receiver().feed(data + STATUS, 5, 0)
    assert reasons(found)[0] is reason
    assert telegrams(found) == [b"\x31"]


def test_the_longest_telegram_is_taken() -> None:
    longest = request(b"\x77" + bytes(816))
    assert telegrams(receiver().feed(longest, 5, 0)) == [b"\x77" + bytes(816)]


def test_the_own_and_the_universal_address_are_heard_and_no_other() -> None:
    assert telegrams(receiver().feed(request(b"\x31", 5) + request(b"\x31", 0), 5, 5)) == [b"\x31", b"\x31"]
    for foreign in (1, 4, 0x7F):
        found = receiver().feed(request(b"\x31", foreign), 5, 5)
        assert reasons(found) == [DropReason.OTHER_ADDRESS]
        assert telegrams(found) == []


def test_a_foreign_telegram_with_a_wrong_crc_is_noise() -> None:
    found = receiver().feed(request(b"\x31", 9)[:-1] + b"\x00" + STATUS, 5, 0)
    assert telegrams(found) == [b"\x31"]
    assert DropReason.BAD_CHECKSUM not in reasons(found)


def test_replies_of_another_device_on_the_line_are_noise() -> None:
    assert telegrams(receiver().feed(frame(0x80, b"\x31\x10") + STATUS, 5, 0)) == [b"\x31"]


def test_half_a_telegram_gives_way_after_the_pause() -> None:
    taker = receiver()
    assert taker.deadline() is None
    assert taker.feed(INSTALL[:9], 1_000 * MS, 0) == []
    deadline = taker.deadline()
    assert deadline is not None
    assert taker.expire(deadline - 1, 0) == []
    found = taker.expire(deadline, 0)
    assert reasons(found) == [DropReason.TIMEOUT]
    assert taker.deadline() is None
    assert telegrams(taker.feed(STATUS, deadline + 1, 0)) == [b"\x31"]


def test_a_telegram_right_behind_half_a_one_is_answered_after_the_pause() -> None:
    taker = receiver()
    assert taker.feed(INSTALL[:7] + STATUS, 0, 0) == []
    assert telegrams(taker.expire(201 * MS, 0)) == [b"\x31"]


def test_telegrams_swallowed_by_a_false_start_all_come_after_the_pause() -> None:
    taker = receiver()
    assert taker.feed(b"\x02\x00\xff\x01\x31" + STATUS + INSTALL + STATUS[:3], 0, 0) == []
    assert telegrams(taker.feed(STATUS, 300 * MS, 0)) == [b"\x31", INSTALL[4:-2], b"\x31"]


def test_the_device_s_own_rule_drops_everything_after_6_ms() -> None:
    taker = receiver(strict=True)
    assert taker.feed(INSTALL[:7] + STATUS, 0, 0) == []
    found = taker.expire(6 * MS + 1, 0)
    assert telegrams(found) == []
    assert reasons(found) == [DropReason.TIMEOUT]


def test_pauses_within_the_rule_do_no_harm() -> None:
    taker, found = receiver(strict=True), []
    for place, byte in enumerate(INSTALL):
        found += taker.feed(bytes((byte,)), place * 6 * MS, 0)
    assert telegrams(found) == [INSTALL[4:-2]]


def test_a_megabyte_of_garbage_is_read_and_forgotten() -> None:
    taker = receiver()
    garbage = bytes(range(256)) * 4096
    taker.feed(garbage, 0, 0)
    assert len(taker._buffer) <= 812
    taker.expire(10**9, 0)
    assert telegrams(taker.feed(STATUS, 10**9, 0)) == [b"\x31"]
