"""Instants come from their numbers, in order, each once, however time is cut into calls."""

from __future__ import annotations

import heapq
from fractions import Fraction

from hypothesis import given
from hypothesis import strategies as st

from protocols.skeleton.instants import FAR_BEHIND, Raster, Timers, earliest, rounded, run_until

RASTERS = st.builds(
    Raster,
    st.integers(-(10**15), 10**15),
    st.fractions(Fraction(1), Fraction(10**10), max_denominator=1000),
    st.integers(0, 10**9),
)


@given(st.lists(st.none() | st.integers()))
def test_the_earliest_is_the_least_of_those_there_are(instants: list[int | None]) -> None:
    found = earliest(instants)
    known = [one for one in instants if one is not None]
    assert (found is None) == (not known)
    assert found is None or (found in known and all(found <= one for one in known))


@given(RASTERS, st.integers(-(10**18), 10**18))
def test_the_first_number_from_an_instant_is_the_least(raster: Raster, instant_ns: int) -> None:
    number = raster.first_from(instant_ns)
    assert raster.at(number) >= instant_ns
    assert raster.at(number - 1) < instant_ns


@given(RASTERS, st.integers(-(10**9), 10**9))
def test_an_instant_is_its_number_times_the_period_rounded_down(raster: Raster, steps: int) -> None:
    exact = raster.zero_ns + steps * raster.period_ns
    assert 0 <= exact - raster.at(raster.first + steps) < 1


@given(RASTERS, st.integers(0, 10**6), st.fractions(Fraction(1), Fraction(10**10), max_denominator=1000))
def test_a_raster_goes_on_where_another_period_begins(raster: Raster, number: int, period_ns: Fraction) -> None:
    then = raster.going_on(number, period_ns)
    assert then.at(number) == raster.at(number)
    assert 0 <= then.at(number) + period_ns - then.at(number + 1) < 1


@given(st.lists(st.integers(0, 1000)), st.lists(st.integers(0, 1200)))
def test_everything_happens_at_its_own_instant_however_time_is_cut(due: list[int], cuts: list[int]) -> None:
    def run(calls: list[int]) -> list[int]:
        waiting, happened, now_ns = sorted(due), [], 0

        def happen(at_ns: int) -> None:
            assert heapq.heappop(waiting) == at_ns
            happened.append(at_ns)

        for call in calls:
            now_ns = run_until(call, now_ns, lambda: waiting[0] if waiting else None, happen)
            assert now_ns == call
            assert not waiting or waiting[0] > call
        return happened

    assert run([*sorted(cuts), 2000]) == run([2000]) == sorted(due)


def test_what_lies_behind_happens_now_and_time_does_not_go_back() -> None:
    waiting, happened = [5, 20], []

    def happen(at_ns: int) -> None:
        happened.append(at_ns)
        waiting.pop(0)

    assert run_until(12, 10, lambda: waiting[0], happen) == 12
    assert happened == [10]
    assert run_until(3, 12, lambda: waiting[0], happen) == 12


@given(
    st.lists(st.tuples(st.integers(0, 100), st.integers(1, 50)), min_size=1, max_size=4),
    st.lists(st.integers(1, 9), min_size=1, max_size=30),
)
def test_timers_are_exact_and_in_order(starts: list[tuple[int, int]], steps: list[int]) -> None:
    timers, happened, now_ns = Timers(), [], 0
    for index, (first_ns, period_ns) in enumerate(starts):
        timers.add(first_ns, period_ns, lambda at_ns, index=index: happened.append((at_ns, index)))  # type: ignore[misc]
    for step in steps:  # never so far that a timer of 1 ns is behind
        now_ns += step
        timers.run(now_ns)
        following = timers.next_ns()
        assert following is not None
        assert following > now_ns
    assert [at_ns for at_ns, _ in happened] == sorted(at_ns for at_ns, _ in happened)
    for index, (first_ns, period_ns) in enumerate(starts):
        assert [at for at, whose in happened if whose == index] == list(range(first_ns, now_ns + 1, period_ns))
    timers.clear()
    assert timers.next_ns() is None


def test_a_timer_that_nobody_called_for_long_happens_once_and_keeps_its_raster() -> None:
    timers, happened = Timers(), []
    timers.add(7, 10, happened.append)
    timers.run(7 + 10 * FAR_BEHIND)
    assert len(happened) == FAR_BEHIND + 1
    timers.run(1_000_003)
    assert happened[FAR_BEHIND + 1 :] == [999_997]
    assert timers.next_ns() == 1_000_007


@given(st.fractions(Fraction(1, 1000), Fraction(10**10), max_denominator=1 << 30), st.sampled_from((1, 2, 300)))
def test_many_instants_are_rounded_as_one_is(period_ns: Fraction, count: int) -> None:
    assert rounded(period_ns, count) == [round(at * period_ns) for at in range(count)]
    assert rounded(Fraction(5, 2), 4) == [0, 2, 5, 8]


def test_an_alarm_happens_once_at_its_instant_and_may_be_set_anew() -> None:
    timers, happened = Timers(), []
    alarm = timers.alarm(happened.append)
    assert timers.next_ns() is None
    alarm.at_ns = 7
    timers.add(5, 10, lambda at_ns: None)
    timers.run(6)
    assert (happened, timers.next_ns()) == ([], 7)
    timers.run(7)
    timers.run(8)
    assert (happened, alarm.at_ns, timers.next_ns()) == ([7], None, 15)
    alarm.at_ns = 9
    timers.clear()
    timers.run(20)
    assert happened == [7]
    alarm.at_ns = 21
    timers.run(30)
    assert happened == [7, 30], "the time reached"
