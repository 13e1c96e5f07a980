"""One sweep in slices of time: which slice is begun when, and that none is left out."""

from __future__ import annotations

from dataclasses import replace

import pytest

from emulator.instrument.slices import Slices
from emulator.live.tracks import World
from emulator.measuring.conditions import NORMAL, Conditions
from protocols.scan import ScanPlan
from tests.instrument.test_instrument import plan

MS = 1_000_000


class Asked:
    """Whoever measures, and a feed that has three slices begun every 10 ms from 100 ms on."""

    def __init__(self, of: int = 3) -> None:
        self.of, self.worlds = of, 0
        self.slices_of: list[tuple[int, int, int]] = []
        "Sweep, slice, of how many."
        self.found: list[Conditions] = []

    def request_slice(self, sensor: str, plan: ScanPlan, conditions: Conditions, number: int, of: int) -> None:
        self.slices_of.append((plan.sweep, number, of))
        self.found.append(conditions)

    def slices(self, sensor: str, plan: ScanPlan) -> int:
        return self.of

    def slice_ns(self, sensor: str, plan: ScanPlan, number: int, of: int) -> int:
        return (100 + 10 * number) * MS

    def world(self, sensor: str, plan: ScanPlan, now_ns: int, number: int = 0, of: int = 1) -> World:
        self.worlds += 1
        return World(gone=frozenset({str(now_ns // MS)}))


@pytest.fixture
def asked() -> Asked:
    return Asked()


def test_each_is_begun_at_its_instant_with_the_poses_known_then(asked: Asked) -> None:
    found = Slices("front", asked)
    weather = replace(NORMAL, weather=None, faults=())
    assert found.open(plan(0, 7, 0), weather, asked, 100 * MS)
    assert found.are_left
    assert found.begin_due(105 * MS) == 110 * MS
    assert found.begin_due(111 * MS) == 120 * MS
    assert found.begin_due(120 * MS) is None
    assert not found.are_left
    assert asked.slices_of == [(7, 0, 3), (7, 1, 3), (7, 2, 3)]
    assert [set(one.world.gone) for one in asked.found if one.world is not None] == [{"100"}, {"111"}, {"120"}]


def test_all_that_are_due_are_begun_by_a_sender_that_comes_late(asked: Asked) -> None:
    found = Slices("front", asked)
    found.open(plan(0, 7, 0), NORMAL, asked, 100 * MS)
    assert found.begin_due(200 * MS) is None
    assert len(asked.slices_of) == 3


def test_one_that_has_no_slices_is_left_to_others(asked: Asked) -> None:
    asked.of = 1
    found = Slices("front", asked)
    assert not found.open(plan(0, 7, 0), NORMAL, asked, 100 * MS)
    assert (asked.slices_of, asked.worlds, found.are_left) == ([], 0, False)


def test_of_a_sweep_that_has_come_nothing_more_is_wanted(asked: Asked) -> None:
    found = Slices("front", asked)
    found.open(plan(0, 7, 0), NORMAL, asked, 100 * MS)
    found.came(plan(0, 6, 0))
    found.came(plan(1, 7, 0))
    assert found.are_left, "others"
    found.came(plan(0, 7, 0))
    assert found.begin_due(200 * MS) is None
    assert len(asked.slices_of) == 1


def test_what_has_been_begun_is_ended_before_another_sweep_and_at_a_power_cut(asked: Asked) -> None:
    found = Slices("front", asked)
    found.open(plan(0, 7, 0), NORMAL, asked, 100 * MS)
    found.open(plan(0, 8, 0), NORMAL, asked, 101 * MS)
    found.finish(102 * MS)
    found.finish(103 * MS)
    assert asked.slices_of == [(sweep, number, 3) for sweep in (7, 8) for number in range(3)]
