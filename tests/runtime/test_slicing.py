"""Slices of time in a fed run: when they are used, and what they are worth."""

from __future__ import annotations

import numpy as np
import pytest

from emulator.runtime.lead import FIRST_SPREAD, MARGIN_NS, SPREADS, Lead
from emulator.runtime.slicing import FIRST_REST, KNOWN_AFTER, SHARE, Slicing
from protocols.lms2xx.variants import STANDARD, comb
from protocols.scan import ScanPlan
from tests.runtime.fed_street import FedStreet

MS = 1_000_000
BEAMS = comb(STANDARD, None)
PLAN = ScanPlan(0, 1, 1000 * MS, BEAMS.azimuth_rad, BEAMS.elevation_rad, BEAMS.fire_offset_s, 2.0 / 75)
SETTLED = 60
"Sweeps."


def known(takes_ms: float, sweeps: int = 2 * KNOWN_AFTER) -> Slicing:
    found = Slicing()
    for _ in range(sweeps):
        assert found.choose(PLAN, False) == 1
        found.add(takes_ms * MS, 1)
    return found


@pytest.mark.parametrize(
    ("takes_ms", "of"), [(4.0, 1), (12.0, 2), (15.0, 2), (17.5, 1), (30.0, 1)],
    ids=["all have fired", "short", "long", "no time for both", "nor for the sweep"],
)  # fmt: skip
def test_slices_are_used_where_beams_wait_less_and_the_process_has_the_time(takes_ms: float, of: int) -> None:
    assert known(takes_ms).choose(PLAN, True) == of


def test_not_before_it_is_known_what_sweeps_take() -> None:
    found = known(14.0, 3)
    assert found.choose(PLAN, True) == 1


def test_the_last_slice_is_begun_as_early_as_it_takes_and_the_first_one_by_one_more() -> None:
    found = known(12.0, 500)
    assert found.choose(PLAN, True) == 2
    for _ in range(500):
        found.add(8.0 * MS, 2)
    last_ns, first_ns = found.before_end_ns(1, 2), found.before_end_ns(0, 2)
    assert last_ns == pytest.approx(8 * MS + MARGIN_NS, rel=0.05)
    assert first_ns - last_ns == pytest.approx(8 * MS, rel=1e-6)


def test_what_is_guessed_of_slices_has_room_as_of_a_first_sweep() -> None:
    lead = Lead()
    for _ in range(1000):
        lead.add(10.0 * MS)
    assert lead.times(SHARE).ns == MARGIN_NS + round(SHARE * (1.0 + SPREADS * FIRST_SPREAD) * 10.0 * MS)
    assert Lead().times(SHARE).ns == Lead().ns


def test_slices_that_take_too_long_are_left_at_once_and_tried_again_ever_later() -> None:
    found, tries, since = known(14.0), [], 0
    for _ in range(3000):
        of = found.choose(PLAN, True)
        if of == 2 and since:
            tries.append(since)
            since = 0
        since += of == 1
        found.add((14.0 if of == 1 else 13.5) * MS, of)
    assert tries[:4] == [2 * FIRST_REST, 4 * FIRST_REST, 8 * FIRST_REST, 16 * FIRST_REST]


def test_after_slices_that_have_held_a_busy_moment_costs_a_short_rest() -> None:
    found, busy = known(13.0), 0
    for _ in range(400):
        found.add(9.0 * MS, found.choose(PLAN, True))
    while found.choose(PLAN, True) == 2:
        found.add(20.0 * MS, 2)
        busy += 1
    assert busy < 10
    rests = 0
    while found.choose(PLAN, True) == 1:
        found.add(13.0 * MS, 1)
        rests += 1
        assert rests < 200
    assert rests == FIRST_REST


def test_where_none_can_be_had_sweeps_are_whole_again() -> None:
    found = known(13.0)
    assert found.choose(PLAN, True) == 2
    assert found.choose(PLAN, False) == 1


@pytest.mark.parametrize(
    ("takes_ms", "spread", "median_ms", "p99_ms", "most_late"),
    [(14, 0.03, 7.2, 14.0, 0), (16, 0.03, 8.5, 16.5, 0), (16, 0.08, 9.8, 17.0, 1)],
)
def test_poses_at_the_beams_of_a_sweep_in_slices(
    takes_ms: float, spread: float, median_ms: float, p99_ms: float, most_late: int
) -> None:
    """Beside the same feed, sensor and process with whole ones; `most_late`: of 860."""
    found = []
    for may in (True, False):
        run = FedStreet(takes_ms, 0.66, may, spread)
        run.run(SETTLED)
        notes = len(run.ages)
        run.run(800)
        age_ms = 1e3 * np.concatenate(run.ages[notes:])
        assert set(run.slices_of[SETTLED:]) == {2 if may else 1}
        found.append((float(np.median(age_ms)), float(np.percentile(age_ms, 99)), run.late))
    (age, worst, late), (age_whole, worst_whole, _) = found
    assert age < median_ms
    assert age < age_whole - 0.8
    assert worst < p99_ms
    assert worst < worst_whole - 4.0
    assert late <= most_late


def test_each_slice_is_begun_near_its_own_beams() -> None:
    """The turns of an LMS291 fire 20 to 26.7 ms and 6.7 to 13.3 ms before the telegram."""
    run = FedStreet(14, 0.66)
    run.run(400)
    first, last = np.array(run.begun_ns[SETTLED:]).T
    assert 17.0 < 1e-6 * np.median(first) < 26.7
    assert 9.24 < 1e-6 * np.median(last) < 13.3, "it takes 9.24 ms"
    took = run.feeding.report()["measuring_ms"]
    assert isinstance(took, dict)
    assert took["median"] == pytest.approx(0.66 * 14, rel=0.1)
    assert run.feeding.report()["in_slices"] == sum(of == 2 for of in run.slices_of)


def test_a_machine_held_up_for_a_while_measures_whole_sweeps_and_goes_back() -> None:
    run = FedStreet(14, 0.66)
    run.run(400)
    for takes in run._takes_ns:
        run._takes_ns[takes] *= 1.6
    run.run(60)
    assert run.slices_of[-20:] == [1] * 20
    for takes in run._takes_ns:
        run._takes_ns[takes] /= 1.6
    run.run(300)
    assert run.slices_of[-50:] == [2] * 50
