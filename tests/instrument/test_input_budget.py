"""How long a sensor listens at one go: what waits, how long it rests, and that nothing is lost or out of order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import cast

import pytest

from emulator.instrument.input_budget import PIECE, InputBudget
from emulator.transports.link import Link, Received
from emulator.transports.turns import AT_ONCE_NS, CROWD_REST, REST, STOCK_NS, Turn
from protocols.session import LinkKind


@dataclass
class Clock:
    now: int = 0

    def now_ns(self) -> int:
        return self.now


class Flooded:
    """A link on which something has come in; it is asked for nothing else."""

    kind = LinkKind.SERIAL

    def __init__(self, *batches: Sequence[bytes]) -> None:
        self.batches = [list(batch) for batch in batches]
        self.looks = 0

    def receive(self, now_ns: int) -> list[Received]:
        self.looks += 1
        return [Received(0, data) for data in self.batches.pop(0)] if self.batches else []


@dataclass
class Sensor:
    """Hears one thing in so many nanoseconds."""

    input_budget: InputBudget
    clock: Clock
    each_ns: int
    heard: list[tuple[int, bytes]] = field(default_factory=list)

    def step(self, now_ns: int) -> int:
        self.clock.now = max(self.clock.now, now_ns)
        for index, received in self.input_budget.take(now_ns):
            self.heard.append((index, received.data))
            self.clock.now += self.each_ns
        self.input_budget.settle(now_ns)
        return len(self.heard)


def sensor(*links: Flooded, each_ns: int = 400_000, timed: bool = True) -> Sensor:
    clock, input_budget = Clock(), InputBudget(cast(Sequence[Link], links))
    if timed:
        input_budget.turn.clock_ns = clock.now_ns
    return Sensor(input_budget, clock, each_ns)


def test_what_takes_longer_than_its_share_waits_and_is_heard_in_order() -> None:
    words = [bytes((k,)) for k in range(20)]
    link = Flooded(words)
    one = sensor(link)
    assert one.step(0) == 3  # the third ends behind a millisecond
    assert one.input_budget.wake_ns(0) == 0, "it has worked ahead of its share, but others come first"
    assert one.step(0) == 6
    assert one.step(0) == 9
    assert one.input_budget.rests(1)
    wake = one.input_budget.wake_ns(1)
    assert wake == 9 * 400_000 * (1 + REST)
    assert one.step(wake - 1) == 9
    assert one.step(wake) == 12
    assert link.looks == 1, "the link is not asked before all has been heard"
    now_ns = 0
    while len(one.heard) < 20:
        now_ns = one.input_budget.wake_ns(one.clock.now) or one.clock.now
        one.step(now_ns)
    assert [data for _, data in one.heard] == words
    one.step(now_ns + 10**9)
    assert link.looks == 2


def test_a_fifth_of_a_core_is_the_most_for_all_who_share_it_and_a_quarter_for_one() -> None:
    for others in (1, 2, 7):
        one = sensor(*(Flooded([b"x"] * 1000) for _ in range(2)))
        one.input_budget.turn.resting = others
        now_ns = worked_ns = 0
        for _ in range(150):
            before = len(one.heard)
            one.step(now_ns)
            worked_ns += (len(one.heard) - before) * one.each_ns
            now_ns = one.input_budget.wake_ns(one.clock.now) or one.clock.now
        slower = 1 + (REST if others == 1 else CROWD_REST * others)
        assert worked_ns / now_ns == pytest.approx(1.0 / slower, rel=0.02)
        assert others * worked_ns / now_ns <= 1.02 / (4.0 if others == 1 else 5.0)


def test_many_short_goes_are_no_way_round_it() -> None:
    clock, turn = Clock(), Turn()
    turn.clock_ns = clock.now_ns
    worked_ns = 0
    for now_ns in range(0, 10**9, 500_000):  # less than a millisecond each, more than a quarter of the time
        clock.now = now_ns
        if not turn.rests(now_ns):
            began_ns = turn.begin()
            clock.now += 300_000
            turn.end(began_ns, now_ns)
            worked_ns += 300_000
    assert worked_ns <= STOCK_NS + 10**9 / (1 + REST)


def test_what_a_step_does_with_what_it_has_heard_counts_too() -> None:
    one = sensor(Flooded([b"x"]))
    for _ in one.input_budget.take(0):
        pass
    one.clock.now += 2 * STOCK_NS  # an answer that takes long to make
    one.input_budget.settle(0)
    assert one.input_budget.wake_ns(1) == 2 * STOCK_NS * (1 + REST)
    one.input_budget.settle(1)  # of a step in which nothing was heard
    assert one.input_budget.wake_ns(1) == 2 * STOCK_NS * (1 + REST)


@pytest.mark.parametrize("kind", list(LinkKind))
def test_what_has_no_borders_is_heard_in_pieces_and_whole_all_the_same(kind: LinkKind) -> None:
    text = bytes(range(256)) * 5 + b"end"
    link = Flooded([text, b"next"])
    link.kind = kind
    one = sensor(link, each_ns=1)
    one.step(0)
    heard = [data for _, data in one.heard]
    assert b"".join(heard) == text + b"next"
    assert max(map(len, heard)) == (PIECE if kind in (LinkKind.SERIAL, LinkKind.STREAM) else len(text))


def test_a_piece_says_once_that_a_host_came_and_last_that_it_has_gone() -> None:
    class Host(Flooded):
        def receive(self, now_ns: int) -> list[Received]:
            return [Received(3, bytes(600), opened=True, closed=True)] if not self.looks else []

    one = sensor(Host())
    found = [received for _, received in one.input_budget.take(0)]
    assert [(len(part.data), part.opened, part.closed, part.peer) for part in found] == [
        (256, True, False, 3),
        (256, False, False, 3),
        (88, False, True, 3),
    ]


def test_what_waits_when_the_power_goes_is_not_heard_afterwards() -> None:
    one = sensor(Flooded([b"abc"] * 10))
    assert one.step(0) == 3
    assert one.input_budget.forget() == 7 * 3
    assert one.step(10**9) == 3


def test_hosts_that_behave_are_heard_at_once() -> None:
    links = Flooded([b"a", b"b"]), Flooded([b"c"])
    one = sensor(*links, each_ns=AT_ONCE_NS // 4)
    assert one.step(5) == 3
    assert one.heard == [(0, b"a"), (0, b"b"), (1, b"c")]
    assert one.input_budget.wake_ns(6) is None


def test_in_virtual_time_everything_is_heard_at_its_instant() -> None:
    one = sensor(Flooded([b"x"] * 500), timed=False)
    assert one.step(0) == 500
    assert one.input_budget.wake_ns(one.clock.now) is None
