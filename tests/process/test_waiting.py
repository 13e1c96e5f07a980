"""Waiting, by a clock and a sleep of the test's own: never too early, awake as little as promised."""

from __future__ import annotations

import os

import pytest

from emulator.process.waiting import MOST_AWAKE_NS, STOCK_NS, Poller, Waiter

MS = 1_000_000


class World:
    """A clock that each look moves on by 100 ns, and a sleep that oversleeps."""

    def __init__(self, oversleeps_ns: int) -> None:
        self.time_ns = 0
        self.oversleeps_ns = oversleeps_ns
        self.ready_after_ns: int | None = None

    def now_ns(self) -> int:
        self.time_ns += 100
        return self.time_ns

    def wait(self, timeout_ns: int) -> bool:
        if self.ready_after_ns is not None and self.ready_after_ns <= timeout_ns:
            self.time_ns += self.ready_after_ns
            return True
        self.time_ns += timeout_ns + (self.oversleeps_ns if timeout_ns else 0)
        return False


def waiter_in(world: World, share: float = 0.05) -> Waiter:
    made = Waiter(world, 0, share)
    made._poller = world  # type: ignore[assignment]
    return made


@pytest.mark.parametrize("oversleeps_ns", [0, 50_000, 150_000, 3 * MS])
def test_no_deadline_is_left_early_and_what_the_machine_oversleeps_is_made_up_for(oversleeps_ns: int) -> None:
    world = World(oversleeps_ns)
    waiter = waiter_in(world)
    late = []
    for number in range(1, 200):
        deadline_ns = number * 10 * MS
        while world.time_ns < deadline_ns:
            assert not waiter.until(deadline_ns)
        late.append(world.time_ns - deadline_ns)
    assert min(late) >= 0
    later = late[16:]
    assert max(later) <= (1_000 if oversleeps_ns < MOST_AWAKE_NS else oversleeps_ns)
    assert waiter.awake_ns <= 0.05 * world.time_ns + STOCK_NS


def test_deadlines_without_end_are_not_waited_for_awake_beyond_the_share() -> None:
    world = World(150_000)
    waiter = waiter_in(world)
    for number in range(1, 4_000):
        while world.time_ns < number * 300_000:
            waiter.until(number * 300_000)
    assert 0 < waiter.awake_ns <= 0.05 * world.time_ns + STOCK_NS + MOST_AWAKE_NS


def test_nothing_is_waited_for_awake_where_that_is_not_wanted() -> None:
    world = World(80_000)
    waiter = waiter_in(world, share=0.0)
    for number in range(1, 40):
        waiter.until(number * 10 * MS)
    assert waiter.awake_ns == 0


def test_a_descriptor_ends_a_wait_and_a_rehearsal_comes_before_the_deadline_alone() -> None:
    world = World(50_000)
    waiter = waiter_in(world)
    seen: list[int] = []
    for number in range(1, 40):
        waiter.until(number * 10 * MS, seen.append)
    assert len(seen) > 20
    assert all(at_ns % (10 * MS) > 9 * MS for at_ns in seen)
    world.ready_after_ns = 1 * MS
    assert waiter.until(world.time_ns + 10 * MS)
    assert waiter.until(None)


def test_descriptors_are_polled_together() -> None:
    one, other = os.pipe(), os.pipe()
    poller = Poller([one[0], other[0]])
    assert not poller.wait(0)
    os.write(other[1], b".")
    assert poller.wait(0)
    for number in (*one, *other):
        os.close(number)
