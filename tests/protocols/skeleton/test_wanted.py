"""The scan that was asked for is taken, once; those of old settings are refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocols.errors import ScanRefused
from protocols.scan import ScanPlan
from protocols.skeleton.wanted import Wanted


def plan(epoch: int, sweep: int, beams: int = 3) -> ScanPlan:
    nothing = np.zeros(beams)
    return ScanPlan(epoch, sweep, 0, nothing, nothing, nothing)


@given(st.lists(st.sampled_from(("ask", "renew", "forget", "take", "stale")), max_size=40))
def test_only_the_plan_asked_for_last_is_taken(steps: list[str]) -> None:
    wanted: Wanted[int] = Wanted()
    given_out: list[ScanPlan] = []
    open_plan: ScanPlan | None = None
    for number, step in enumerate(steps):
        if step == "ask":
            open_plan = wanted.ask(plan(wanted.epoch, number), number)
            given_out.append(open_plan)
        elif step == "renew":
            wanted.renew()
            open_plan = None
        elif step == "forget":
            wanted.forget()
            open_plan = None
        elif step == "take" and open_plan is not None:
            assert wanted.expect(open_plan) == open_plan.sweep
            assert wanted.expect(replace(open_plan, start_ns=9)) == open_plan.sweep, "a copy, as a worker sends it back"
            wanted.forget()
            open_plan = None
        for old in given_out:
            if old is not open_plan:
                with pytest.raises(ScanRefused, match="not requested any more"):
                    wanted.expect(old)
        assert wanted.plan is open_plan


def test_the_same_number_of_another_epoch_is_another_sweep() -> None:
    wanted: Wanted[str] = Wanted()
    old = wanted.ask(plan(wanted.epoch, 5), "old")
    wanted.renew()
    new = wanted.ask(plan(wanted.epoch, 5), "new")
    with pytest.raises(ScanRefused, match="sweep 5 of epoch 0"):
        wanted.expect(old)
    assert wanted.expect(new) == "new"


def test_a_scan_with_other_beams_is_refused_and_the_right_one_still_wanted() -> None:
    wanted: Wanted[str] = Wanted()
    asked = wanted.ask(plan(0, 1), "slot")
    with pytest.raises(ScanRefused, match="2 beams; the plan has 3"):
        wanted.expect(asked, 2)
    assert wanted.expect(asked, 3) == "slot"


def test_a_plan_without_beams_is_a_plan() -> None:
    wanted: Wanted[str] = Wanted()
    assert wanted.expect(wanted.ask(plan(0, 1, beams=0), "list"), 0) == "list"
