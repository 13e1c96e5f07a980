"""When bytes leave a line: against exact fractions, and the figures of the LMS2xx's line."""

from __future__ import annotations

from fractions import Fraction
from math import ceil

import pytest
from hypothesis import given
from hypothesis import strategies as st

from emulator.transports.pacing import GROUP_NS, Left, PacedLine, leave_ns

SPEEDS = [9600, 19_200, 38_400, 500_000, 115_200, 123_457]


def drain(line: PacedLine, now_ns: int = 0) -> list[Left]:
    """All that waits, taken at the instants the line asks for."""
    left = line.take(now_ns)
    while (wake := line.next_ns(now_ns)) is not None:
        assert wake > now_ns
        now_ns = wake
        left += line.take(now_ns)
    return left


@pytest.mark.parametrize(
    ("count", "baud", "line_time_us"),
    [
        # calculated: bytes * 10 / baud; the telegram lengths of the LMS2xx stream
        (732, 500_000, 14_640),
        (372, 500_000, 7_440),
        (732, 9600, 762_500),
        (812, 38_400, Fraction(812 * 10_000_000, 38_400)),
        (1, 9600, Fraction(10_000_000, 9600)),
    ],
)
def test_a_telegram_takes_ten_bit_times_a_byte(count: int, baud: int, line_time_us: Fraction) -> None:
    line = PacedLine(baud)
    line.put(bytes(count), 1000)
    end = 1000 + ceil(line_time_us * 1000)
    assert sum(len(left.data) for left in line.take(end - 1)) == count - 1
    assert [left.data for left in line.take(end)] == [b"\0"]
    assert line.next_ns(end) is None


def test_732_bytes_at_500_kbd_take_14_64_ms_exactly() -> None:
    line = PacedLine(500_000)
    line.put(bytes(732), 0)
    assert drain(line)[-1].last_ns == 14_640_000


def test_hours_without_a_pause_do_not_shift_the_schedule_by_a_nanosecond() -> None:
    line = PacedLine(38_400)
    sent = 0
    now_ns = 0
    for _ in range(2000):
        line.put(bytes(3001), 0)
        sent += 3001
        now_ns = leave_ns(0, sent, 38_400)
        before = line.take(now_ns - 1)
        assert sum(len(left.data) for left in before) == 3000
        assert line.take(now_ns)[-1].last_ns == now_ns
    assert now_ns == ceil(Fraction(sent * 10**10, 38_400))


def test_it_wakes_in_groups_and_for_the_last_byte() -> None:
    line = PacedLine(500_000)
    line.put(bytes(732), 0)
    sizes = [len(left.data) for left in drain(line)]
    assert sizes == [100] * 7 + [32]
    assert GROUP_NS == 100 * 20_000


def test_a_slow_line_wakes_for_each_byte_but_never_without_one() -> None:
    line = PacedLine(1200)
    line.put(bytes(5), 0)
    assert [len(left.data) for left in drain(line)] == [1] * 5


def test_a_payload_starts_when_due_or_when_the_line_is_free() -> None:
    line = PacedLine(10_000)  # 1 ms a byte
    line.put(b"ab", 0)
    line.put(b"c", 500_000)
    line.put(b"d", 10_000_000)
    times = [int(time) for left in drain(line) for time in left.times_ns()]
    assert times == [1_000_000, 2_000_000, 3_000_000, 11_000_000]


def test_the_speed_changes_behind_the_last_bit() -> None:
    line = PacedLine(9600)
    line.put(bytes(3), 0, speed_after=500_000)
    line.put(bytes(2), 0)
    ends = [int(time) for left in drain(line) for time in left.times_ns()]
    assert ends == [1_041_667, 2_083_334, 3_125_000, 3_145_000, 3_165_000]
    assert line.speed == 500_000


def test_an_empty_payload_changes_the_speed_when_it_is_due() -> None:
    line = PacedLine(9600)
    line.put(b"", 5000, speed_after=38_400)
    assert line.take(4999) == []
    assert line.speed == 9600
    assert line.take(5000) == []
    assert line.speed == 38_400


def test_a_speed_set_at_once_leaves_what_has_gone_and_re_times_the_rest() -> None:
    line = PacedLine(10_000)
    line.put(b"abcd", 0)
    first = line.take(2_000_000)
    assert first[0].data == b"ab"
    assert first[0].starts
    line.set_speed(1000)
    rest = drain(line, 2_000_000)
    assert b"".join(left.data for left in rest) == b"cd"
    assert not rest[0].starts
    assert rest[-1].ends
    assert rest[-1].last_ns == 22_000_000


def test_without_a_speed_a_payload_leaves_whole_when_due_and_in_order() -> None:
    line = PacedLine()
    line.put(b"later", 100)
    line.put(b"behind it", 50)
    assert line.take(99) == []
    assert line.next_ns(99) == 100
    assert [(left.data, left.last_ns) for left in line.take(100)] == [(b"later", 100), (b"behind it", 100)]


def test_whole_payloads_come_when_their_last_byte_has_left() -> None:
    line = PacedLine(10_000, whole=True)
    line.put(b"abc", 0)
    assert line.next_ns(0) == 3_000_000
    assert line.take(2_999_999) == []
    assert [left.data for left in line.take(3_000_000)] == [b"abc"]


def test_a_full_line_refuses_more_but_takes_one_payload_of_any_size() -> None:
    line = PacedLine(9600, limit=10)
    assert line.put(bytes(100), 0)
    assert not line.put(b"x", 0)
    assert line.put(b"", 0, speed_after=19_200)
    assert line.queued == 100


def test_after_a_power_cut_the_line_is_free_at_once() -> None:
    line = PacedLine(1000)
    line.put(b"abc", 0)
    line.put(b"far", 10**12)
    line.take(10_000_000)
    assert line.clear() == 5
    line.put(b"z", 10_000_000)
    assert drain(line, 10_000_000)[-1].last_ns == 20_000_000


def test_a_payload_that_was_looked_at_but_not_begun_does_not_hold_the_line() -> None:
    line = PacedLine(1000)
    line.put(b"far", 10**12)
    assert line.next_ns(0) is not None
    assert line.take(5) == []
    line.clear()
    line.put(b"now", 10)
    assert drain(line, 10)[-1].last_ns == 30_000_010


@pytest.mark.parametrize("baud", [0, -1])
def test_a_speed_that_is_none_is_our_own_fault(baud: int) -> None:
    with pytest.raises(ValueError, match="baud > 0"):
        PacedLine(baud)


@given(
    baud=st.sampled_from(SPEEDS),
    payloads=st.lists(
        st.tuples(st.binary(max_size=40), st.integers(0, 50_000_000), st.none() | st.sampled_from(SPEEDS)), max_size=8
    ),
    looks=st.lists(st.integers(0, 3_000_000), max_size=30),
)
def test_any_looks_at_any_times_give_the_exact_schedule(
    baud: int, payloads: list[tuple[bytes, int, int | None]], looks: list[int]
) -> None:
    expected = []
    free, speed = Fraction(0), baud
    for data, due, after in payloads:
        start = max(Fraction(due), free)
        expected += [(value, start + Fraction((index + 1) * 10**10, speed)) for index, value in enumerate(data)]
        free = start + Fraction(len(data) * 10**10, speed)
        if after is not None and after != speed:
            free = Fraction(ceil(free))  # a change of speed is rounded up to a nanosecond, once
        speed = after or speed
    line = PacedLine(baud)
    for data, due, after in payloads:
        assert line.put(data, due, after)
    seen: list[tuple[int, int]] = []
    now_ns = 0
    for step in [*looks, 10**12]:
        now_ns += step
        left = line.take(now_ns)
        seen += [(value, int(time)) for item in left for value, time in zip(item.data, item.times_ns(), strict=True)]
        assert all(time <= now_ns for _, time in seen)
        assert len(seen) == sum(ceil(time) <= now_ns for _, time in expected)
    assert [value for value, _ in seen] == [value for value, _ in expected]
    assert all(abs(time - ceil(exact)) <= len(payloads) for (_, time), (_, exact) in zip(seen, expected, strict=True))
    assert line.queued == 0


@pytest.mark.parametrize("baud", [9600, 38_400, 500_000])
@pytest.mark.parametrize("looked", [False, True])
def test_a_cut_ends_a_payload_with_the_byte_that_is_on_its_way(baud: int, looked: bool) -> None:
    line = PacedLine(baud)
    line.put(bytes(range(200)), 1000)
    at_ns = 1000 + leave_ns(0, 57, baud) + 5
    taken = b"".join(left.data for left in line.take(at_ns)) if looked else b""
    assert line.cut(at_ns) == 0
    line.put(b"\x06", at_ns)
    left = line.take(at_ns + 10**9)
    assert taken + b"".join(one.data for one in left) == bytes(range(58)) + b"\x06"
    assert left[-1].last_ns == 1000 + leave_ns(0, 59, baud)
    assert line.queued == 0


def test_a_cut_forgets_what_waits_but_no_change_of_speed() -> None:
    line = PacedLine(9600)
    line.put(b"abc", 0)
    line.put(b"later", 10**9)
    assert line.cut(leave_ns(0, 1, 9600)) == 1
    assert b"".join(left.data for left in line.take(10**10)) == b"ab"
    line.put(b"xyz", 10**10, 38_400)
    line.cut(10**10)
    line.take(2 * 10**10)
    assert line.speed == 38_400


def test_nothing_is_cut_on_a_line_without_a_speed_or_without_a_payload() -> None:
    line = PacedLine(None)
    line.put(b"abc", 10)
    assert line.cut(20) == 0
    assert line.take(30)[0].data == b"abc"
    assert PacedLine(9600).cut(5) == 0
