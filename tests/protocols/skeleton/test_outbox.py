"""What has not left: in the order in which it is due, whole, and withdrawn where the device would."""

from __future__ import annotations

from collections import deque

from hypothesis import given
from hypothesis import strategies as st

from protocols.session import Address, Emission
from protocols.skeleton.outbox import Outbox, Outgoing

DUE = st.lists(st.integers(0, 50), max_size=30)


def telegram(number: int, due_ns: int) -> Emission:
    return Emission(due_ns, number.to_bytes(2, "big"))


@given(DUE, st.lists(st.integers(0, 60)))
def test_telegrams_leave_when_due_in_order_and_none_is_lost(due: list[int], calls: list[int]) -> None:
    outbox, taken = Outbox(), []
    for number, due_ns in enumerate(due):
        outbox.send(telegram(number, due_ns))
    for now_ns in [*sorted(calls), 60]:
        following = outbox.next_ns()
        got = outbox.take(now_ns)
        assert bool(got) == (following is not None and following <= now_ns)
        assert all(one.due_ns <= now_ns for one in got)
        assert all(entry.due_ns > now_ns for entry in [telegram(0, outbox.next_ns() or 61)])
        taken += got
    assert taken == [telegram(number, due_ns) for due_ns, number in sorted((at, n) for n, at in enumerate(due))]
    assert len(outbox) == 0


@given(DUE, st.sets(st.integers(0, 29)), st.integers(0, 60))
def test_what_is_withdrawn_does_not_leave_and_all_else_does(due: list[int], gone: set[int], now_ns: int) -> None:
    outbox = Outbox()
    sent = [outbox.send(telegram(number, due_ns)) for number, due_ns in enumerate(due)]
    left = {one.payload for one in outbox.take(now_ns)}
    wanted = [sent[number] for number in gone if number < len(sent)]
    back = outbox.withdraw(lambda one: any(one is other for other in wanted))
    assert all(not one.begun for one in back)
    assert [one.emissions[0].due_ns for one in back] == sorted((one.emissions[0].due_ns for one in back), reverse=True)
    later = {one.payload for one in outbox.take(60)}
    assert len(left) + len(back) + len(later) == len(due)
    assert {one.emissions[0].payload for one in back} | left | later == {
        telegram(n, 0).payload for n in range(len(due))
    }


@given(st.lists(st.lists(st.integers(0, 9), min_size=1, max_size=5), max_size=6), st.integers(1, 4))
def test_the_parts_of_a_telegram_keep_their_order(gaps: list[list[int]], burst: int) -> None:
    outbox = Outbox(burst)
    for number, steps in enumerate(gaps):
        instants = [sum(steps[: k + 1]) for k in range(len(steps))]
        parts = deque(Emission(due_ns, bytes((number, k))) for k, due_ns in enumerate(instants))
        outbox.put(Outgoing(Address(0, number), parts))
    taken = [one for now_ns in range(60) for one in outbox.take(now_ns)]
    for number, steps in enumerate(gaps):
        assert [one.payload[1] for one in taken if one.payload[0] == number] == list(range(len(steps)))
    if burst == 1:
        assert [one.due_ns for one in taken] == sorted(one.due_ns for one in taken)


def test_the_rest_of_a_telegram_that_has_begun_can_be_told_from_one_that_has_not() -> None:
    outbox = Outbox()
    outbox.put(Outgoing(None, deque((Emission(1, b"a"), Emission(5, b"b")))))
    outbox.send(Emission(5, b"c"))
    assert [one.payload for one in outbox.take(1)] == [b"a"]
    (gone,) = outbox.withdraw(lambda sent: not sent.begun)
    assert gone.emissions[0].payload == b"c"
    assert [one.payload for one in outbox.take(9)] == [b"b"]
    outbox.send(Emission(9, b"d"))
    outbox.clear()
    assert outbox.next_ns() is None
