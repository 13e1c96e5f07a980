"""Sweeps begun before they are asked for: which count, and which are measured again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np
import pytest

from emulator.instrument.ahead import MEASURED, MOST_EARLY, NAMES, Ahead, Several, same_sweep
from emulator.instrument.instrument import LOOK_AHEAD_NS, Instrument
from emulator.live.tracks import NOTHING, World
from emulator.measuring.conditions import NORMAL, ActiveFault, Conditions
from emulator.scenario.weather import WeatherConfig
from protocols.scan import Scan, ScanPlan
from protocols.session import LinkKind
from tests.instrument.test_instrument import PERIOD_NS, ListLink, ScriptedSession, plan

RAIN = Conditions(weather=WeatherConfig.model_validate({"rain": {"rate_mm_h": 5.0}}))


class Foreseeing(ScriptedSession):
    """Says what comes next, if nothing changes."""

    def plan_after(self, asked: ScanPlan) -> ScanPlan | None:
        return plan(self.epoch, asked.sweep + 1, (asked.sweep + 1) * PERIOD_NS)


class Pool:
    """Measures when it is told to, in any order."""

    def __init__(self, most: int = 3, virtual: bool = False) -> None:
        self.most, self.in_virtual_time = most, virtual
        self.asked: list[ScanPlan] = []
        self.early: list[tuple[ScanPlan, Conditions]] = []
        self.claimed: list[tuple[ScanPlan, ScanPlan]] = []
        self.dropped: list[int] = []
        self.done: list[Scan] = []

    def request(self, sensor: str, wanted: ScanPlan, conditions: Conditions = NORMAL) -> None:
        self.asked.append(wanted)

    def collect(self, sensor: str) -> list[Scan]:
        done, self.done = self.done, []
        return done

    def spare(self, sensor: str, behind: bool = True) -> int:
        return max(0, self.most - len(self.asked) - len(self.early))

    def request_ahead(self, sensor: str, wanted: ScanPlan, conditions: Conditions) -> None:
        self.early.append((wanted, conditions))

    def claim(self, sensor: str, early: ScanPlan, wanted: ScanPlan) -> bool:
        self.claimed.append((early, wanted))
        self.early = [one for one in self.early if one[0] is not early]
        self.asked.append(wanted)
        return True

    def drop(self, sensor: str, plans: Sequence[ScanPlan]) -> None:
        self.dropped += [one.sweep for one in plans]
        self.early = [one for one in self.early if all(one[0] is not gone for gone in plans)]

    def finish(self, number: int) -> None:
        """The sweep that was asked for under that number is measured."""
        wanted = next(one for one in self.asked if one.sweep == number)
        self.asked.remove(wanted)
        self.done.append(Scan.empty(wanted))


def made(pool: Pool) -> tuple[Instrument, Foreseeing]:
    session = Foreseeing()
    instrument = Instrument("front", session, [ListLink(LinkKind.SERIAL)], pool)
    instrument.power_on(0)
    session.on = True
    instrument.step(0)
    return instrument, session


def test_a_pool_is_known_as_one() -> None:
    assert isinstance(Pool(), Several)


def test_sweeps_behind_the_one_asked_for_are_begun_where_there_is_room_and_claimed_in_their_turn() -> None:
    pool = Pool(3)
    instrument, session = made(pool)
    assert [one.sweep for one in pool.asked] == [0]
    assert [one.sweep for one, _ in pool.early] == [1, 2]
    for number in range(4):
        pool.finish(number)
        instrument.step(number + 1)
        assert session.sweep == number + 1
        assert [one.sweep for one in pool.asked] == [number + 1]
    assert [early.sweep for early, _ in pool.claimed] == [1, 2, 3, 4]
    assert pool.dropped == []
    assert instrument.ledger.account()["unaccounted"] == 0


def test_no_sweep_is_begun_before_its_look_ahead_in_real_time() -> None:
    pool = Pool(100)
    instrument, _ = made(pool)
    newest = max(one.start_ns for one, _ in pool.early)
    assert LOOK_AHEAD_NS - PERIOD_NS < newest <= LOOK_AHEAD_NS
    wake_ns = instrument.step(1)
    assert wake_ns is not None
    assert wake_ns == newest + PERIOD_NS - LOOK_AHEAD_NS, "it wakes for the next one"
    instrument.step(wake_ns)
    assert max(one.start_ns for one, _ in pool.early) == newest + PERIOD_NS


def test_what_waits_is_bounded_in_virtual_time_too() -> None:
    pool = Pool(1000, virtual=True)
    made(pool)
    assert len(pool.early) == MOST_EARLY


def test_a_changed_setting_drops_what_was_begun_if_it_is_another_sweep_and_keeps_it_if_it_is_the_same() -> None:
    pool = Pool(3)
    instrument, session = made(pool)
    session.epoch += 1  # the same directions and instants under another number
    pool.finish(0)
    instrument.step(1)  # refused: asked for again
    assert [(one.epoch, one.sweep) for one in pool.asked] == [(1, 0)]
    assert pool.dropped == [1, 2], "none of them is the sweep that is asked for now"


@pytest.mark.parametrize(
    "name", [one.name for one in fields(ScanPlan) if one.name not in NAMES and one.name != "sweep"]
)
def test_a_plan_that_differs_in_what_is_measured_is_another_sweep(name: str) -> None:
    one = replace(plan(0, 1, 5), origin_m=np.zeros((1, 3)), turn=4, max_range_m=80.0)
    value = getattr(one, name)
    other = replace(one, **{name: value + 1 if not isinstance(value, bool) else not value})
    assert same_sweep(one, replace(one, azimuth_rad=one.azimuth_rad.copy()))
    assert not same_sweep(one, other)
    assert name in MEASURED


def test_other_conditions_for_a_sweep_have_it_measured_again() -> None:
    pool = Pool(3)
    instrument, _ = made(pool)
    instrument.conditions = RAIN
    pool.finish(0)
    instrument.step(1)
    assert pool.dropped == [1]
    assert [one.sweep for one in pool.asked] == [1]
    assert pool.claimed == []
    pool.finish(1)
    instrument.step(2)
    assert pool.dropped == [1, 2], "so is the next one that was begun in dry air"


def test_a_fault_of_later_sweeps_leaves_those_before_it(monkeypatch: pytest.MonkeyPatch) -> None:
    pool = Pool(3)
    instrument, _ = made(pool)
    fault = ActiveFault("front", "dead laser", 1, 2 * PERIOD_NS)
    instrument.conditions = Conditions(faults=(fault, replace(fault, sensor="other", from_ns=0)))
    for number in range(2):
        pool.finish(number)
        instrument.step(number + 1)
    assert [early.sweep for early, _ in pool.claimed] == [1]
    assert pool.dropped == [2]


def test_a_power_cut_drops_what_was_begun_and_an_old_scan_that_comes_after_new_ones_is_not_taken_for_theirs() -> None:
    pool = Pool(3)
    instrument, session = made(pool)
    old = pool.asked[0]
    instrument.power_off(1)
    assert pool.dropped == [1, 2]
    pool.asked.clear()
    session.epoch, session.sweep = 5, 0
    instrument.power_back(2)
    instrument.step(3)
    assert [one.epoch for one in pool.asked] == [5]
    pool.finish(0)
    instrument.step(4)
    assert session.sweep == 1, "the new one counts, though the old one has not come"
    pool.done.append(Scan.empty(old))
    instrument.step(5)
    assert session.sweep == 1
    assert instrument.ledger.account()["unaccounted"] == 0


def test_ahead_begins_nothing_that_does_not_go_forward() -> None:
    class Standing(Foreseeing):
        def plan_after(self, asked: ScanPlan) -> ScanPlan | None:
            return asked

    pool, session = Pool(3), Standing()
    ahead = Ahead("front", pool)
    assert ahead.begin(session, plan(0, 0, 0), 0, lambda one: 0, lambda one: NORMAL, True) is None
    assert pool.early == []


class Feed:
    """Moves the world; knows its future, or does not."""

    known = False

    def ask_ns(self, sensor: str, plan: ScanPlan, earliest_ns: int) -> int:
        """Its lead reaches back so far, or all is known."""
        return earliest_ns

    def knows(self, plan: ScanPlan) -> bool:
        return self.known

    def world(self, sensor: str, plan: ScanPlan, now_ns: int) -> World:
        return NOTHING

    def came(self, sensor: str, plan: ScanPlan, now_ns: int) -> None: ...


class Busy(Pool):
    """One process: a further sweep would wait behind the one in its hands."""

    def spare(self, sensor: str, behind: bool = True) -> int:
        return super().spare(sensor) if behind or not self.asked else 0


@pytest.mark.parametrize("knows", [False, True])
def test_what_is_asked_for_as_late_as_possible_waits_for_a_process_and_behind_no_sweep(knows: bool) -> None:
    pool, session, feed = Busy(), Foreseeing(), Feed()
    instrument = Instrument("front", session, [ListLink(LinkKind.SERIAL)], pool)
    instrument.feed, feed.known = feed, knows
    instrument.power_on(0)
    session.on = True
    instrument.step(1)
    assert [one.sweep for one in pool.asked] == [0]
    assert [one.sweep for one, _ in pool.early] == ([1, 2] if knows else []), "newer poses may come while it waits"
