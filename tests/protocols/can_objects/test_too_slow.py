"""Lists that are measured more slowly than the device sends them."""

from __future__ import annotations

from dataclasses import replace

from protocols.scan import Scan
from protocols.session import Dropped, DropReason
from tests.protocols.can_objects.rig import BOOT_NS, MS, start

CYCLE_NS = 50 * MS


def test_lists_that_are_not_measured_in_time_are_passed_over_and_counted() -> None:
    rig = start({"format": "esr", "radiate": "always"})
    session = rig.session
    now_ns, worst_ns, measured, late = BOOT_NS, 0, 0, 0
    while now_ns < BOOT_NS + 3000 * MS:
        session.advance(now_ns)
        plan = session.next_plan()
        assert plan is not None
        now_ns = max(now_ns, plan.start_ns) + 130 * MS  # measuring takes more than two and a half cycles
        session.advance(now_ns)
        worst_ns = max(worst_ns, now_ns - plan.start_ns)
        session.submit(replace(Scan.empty(plan), objects=()))
        session.take_emissions(now_ns)
        measured += 1
        assert plan.start_ns % CYCLE_NS == BOOT_NS % CYCLE_NS  # those that are made keep their own instants
        events = session.take_events()
        late += sum(one.count for one in events if isinstance(one, Dropped) and one.reason is DropReason.LATE)
    assert worst_ns <= 130 * MS + CYCLE_NS, "lateness must not add up"
    plan = session.next_plan()
    late += sum(one.count for one in session.take_events() if isinstance(one, Dropped))
    assert plan is not None
    assert measured + late == plan.sweep
    assert late > measured
