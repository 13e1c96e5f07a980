"""What a session says will be wanted next is what it wants then, and saying so changes nothing."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from emulator.instrument.ahead import same_sweep
from emulator.sensors.spec import load_spec
from protocols import family
from protocols.quartz import Quartz
from protocols.scan import Scan, ScanPlan
from protocols.session import Address, Dropped, DropReason, LinkKind, Session
from protocols.timebase import Timebase

QUICK: dict[str, Any] = {"boot_s": 0.0, "spin_up_s": 0.1}
LOOK_AHEAD_NS = 250_000_000
FROM_S, LOCKED_S, FOR_S = 0.0, 2.6, 0.7
"Looked at from spinning up on; with a phase lock when it begins, at the third pulse. Before that nobody measures."
CASES = {
    "velodyne, whole turn": ("velodyne-vlp-16", QUICK),
    "velodyne, part of it, phase lock": (
        "velodyne-vlp-16", QUICK | {"pps": True, "nmea": True, "phase_lock": True, "fov_deg": [300, 60]},
    ),
    "velodyne, phase lock, dual": (
        "velodyne-vls-128", QUICK | {"pps": True, "nmea": True, "phase_lock": True, "returns": "dual"},
    ),
    "hesai, whole turn": ("hesai-xt32", QUICK),
    "hesai, mirrors": ("hesai-at128", QUICK),
    "ouster, whole turn": ("ouster-os1-64", QUICK | {"init_s": 0.0}),
}  # fmt: skip


def started(name: str, wrap: Callable[[Session], Session] = lambda one: one) -> Session:
    model, device = CASES[name]
    session = wrap(family(model.partition("-")[0]).new_session(device, load_spec(model).device))
    session.connected(0, Address(0, 0), LinkKind.DATAGRAM)
    session.power_on(0)
    return session


def wanted(session: Session, from_s: float, asked: Callable[[ScanPlan], None]) -> list[ScanPlan]:
    """Every plan from then on, each submitted at its look-ahead; `asked` hears of each before."""
    plans, now_ns = [], round(1e9 * from_s)
    while now_ns < 1e9 * (from_s + FOR_S):
        session.advance(now_ns)
        while (plan := session.next_plan()) is not None and plan.start_ns - LOOK_AHEAD_NS <= now_ns:
            asked(plan)
            plans.append(plan)
            session.submit(Scan.empty(plan))
        session.take_emissions(now_ns)
        now_ns += 5_000_000
    return plans


@pytest.mark.parametrize("name", list(CASES))
@pytest.mark.parametrize("drifts", [False, True])
def test_a_foreseen_sweep_is_the_one_that_is_wanted_and_looking_changes_nothing(name: str, drifts: bool) -> None:
    wrap = (lambda one: Timebase(one, Quartz().at_rate(0, 30_000))) if drifts else lambda one: one
    foreseen: dict[int, ScanPlan] = {}
    from_s = LOCKED_S if "phase_lock" in CASES[name][1] else FROM_S
    session = started(name, wrap)

    def look(plan: ScanPlan) -> None:
        last = plan
        for _ in range(4):
            following = session.plan_after(last)
            if following is None:
                return
            foreseen[following.sweep] = last = following

    plans = wanted(session, from_s, look)
    alone = wanted(started(name, wrap), from_s, lambda plan: None)
    assert len(plans) == len(alone)
    assert all(same_sweep(one, other) for one, other in zip(plans, alone, strict=True))
    known = [plan for plan in plans if plan.sweep in foreseen]
    assert all(same_sweep(plan, foreseen[plan.sweep]) for plan in known)
    assert len(known) > 0.7 * len(plans)


def test_a_sweep_that_is_being_measured_is_not_skipped_when_it_has_ended() -> None:
    session = started("velodyne, whole turn")
    session.advance(200_000_000)
    first = session.next_plan()
    assert first is not None
    session.submit(Scan.empty(first))
    plan = session.next_plan()
    assert plan is not None
    following = session.plan_after(plan)
    assert following is not None
    session.take_events()
    session.begun(following)
    late_ns = following.start_ns + round(5e9 * following.duration_s)
    session.advance(late_ns)
    session.submit(Scan.empty(plan))
    again = session.next_plan()
    assert again is not None
    assert same_sweep(again, following)
    session.submit(Scan.empty(again))
    after = session.next_plan()
    assert after is not None
    assert after.start_ns + round(1e9 * after.duration_s) >= late_ns, "others that have ended are"
    late = [one for one in session.take_events() if isinstance(one, Dropped) and one.reason is DropReason.LATE]
    assert [one.sweeps for one in late] == [range(again.sweep + 1, after.sweep)]
