"""One sensor's sweeps in several processes at once: played processes, on a clock of the test."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from emulator.live.tracks import NOTHING
from emulator.measuring.conditions import NORMAL, Conditions
from emulator.measuring.measuring import Measures, NotMeasured, part_measured
from emulator.measuring.sharing import WHOLE_FOR
from emulator.measuring.supervision import Workers
from emulator.process.clock import ManualClock
from protocols.scan import Scan, ScanPlan
from tests.instrument.test_instrument import plan
from tests.measuring.process_rig import LISTS, MS, RATE_HZ, SECOND, Make, Played, Rig


def in_order(sweeps: list[int]) -> bool:
    return sweeps == sorted(set(sweeps))


@pytest.mark.parametrize(("workers", "rate_hz"), [(1, 20.0), (2, 37.5)])
def test_sweeps_that_take_longer_than_their_period_are_measured_by_two_processes(
    rig: Make, workers: int, rate_hz: float
) -> None:
    run = rig("front", workers=workers, shared=["front"], slice_ns=MS)
    run.takes_ns = 45 * MS
    run.stream()
    assert run.rate_hz("front", 4.0) == pytest.approx(rate_hz, abs=2.5)
    assert in_order(run.sent.sweeps["front"])
    assert all(one.measured for one in run.processes)
    assert run.by_name["front"].ledger.account()["unaccounted"] == 0
    assert run.kinds() == []


def test_results_that_come_in_another_order_are_sent_in_theirs(rig: Make) -> None:
    run = rig("front", workers=2, shared=["front"], slice_ns=MS)
    run.takes_ns = 26 * MS
    run.processes[1].takes_ns = 3 * MS
    run.stream()
    assert run.rate_hz("front", 4.0) == pytest.approx(RATE_HZ, abs=1.0)
    assert in_order(run.sent.sweeps["front"])
    assert run.late("front") == 0


@pytest.mark.parametrize("how", ["killed", "killed in a message", "stopped"])
def test_a_process_that_is_lost_costs_no_scan_while_another_is_free(rig: Make, how: str) -> None:
    run = rig("front", workers=2, shared=["front"], slice_ns=2 * MS, builds_ns=3 * SECOND)
    run.takes_ns = 20 * MS
    run.stream()
    lost = run.processes[0]
    assert run.advance(1.0, lambda: lost.busy)
    if how == "stopped":
        lost.stopped = True
    else:
        lost.end(-9) if how == "killed" else lost.die_in_a_message()
    late = run.late("front")
    assert run.rate_hz("front", 12.0) == pytest.approx(RATE_HZ, abs=1.0)
    # an LMS291 lets a sweep be measured 53 ms before it begins: a stop is noticed after as long as that
    assert run.late("front") - late <= (8 if how == "stopped" else 1)
    assert run.kinds() == ["worker replaced"]
    assert in_order(run.sent.sweeps["front"])
    assert run.by_name["front"].ledger.account()["unaccounted"] == 0
    assert run.daemon.incidents.exit_code == 0


def test_a_process_that_is_new_measures_once_for_nobody_before_it_is_given_what_is_wanted(rig: Make) -> None:
    run = rig("front", workers=2, shared=["front"], slice_ns=MS)
    run.takes_ns = 22 * MS
    run.stream()
    run.on_launch = lambda made: setattr(made, "takes_ns", 2 * SECOND)  # its first sweep fills tables
    run.processes[0].end(-9)
    assert run.advance(5.0, lambda: run.process.busy)
    sensor, wanted, *_ = run.process.jobs[0]
    assert (sensor, wanted.sweep) in run.processes[1].measured, "another has measured it"
    late, sent = run.late("front"), run.sent.sweeps["front"]
    before = len(sent)
    run.advance(1.0)
    assert len(sent) - before > 0.8 * RATE_HZ, "the other goes on alone"
    run.process.takes_ns = 2 * MS
    run.advance(2.0)
    assert len(run.process.measured) > 1
    assert run.late("front") - late < 0.3 * RATE_HZ * 3
    assert in_order(sent)


def test_one_that_remembers_stays_with_its_own_process(rig: Make) -> None:
    run = rig("front", workers=2, text=LISTS.format("list", "front", "bus-sharing"), shared=["front"], slice_ns=2 * MS)
    run.takes_ns = 10 * MS
    run.stream("front")
    run.advance(2.0)
    homes = {sensor: index for index, row in enumerate(run.workers.rows()) for sensor in row["sensors"]}  # type: ignore[attr-defined]
    measured = [{sensor for sensor, _ in one.measured} for one in run.processes]
    assert measured[homes["list"]] >= {"list"}
    assert "list" not in measured[1 - homes["list"]]
    assert "front" in measured[homes["list"]], "and its process helps others"


def test_what_is_too_much_for_the_process_of_two_sensors_goes_to_that_of_the_third(rig: Make) -> None:
    run = rig("a", "b", "c", workers=2, shared=["a", "b", "c"], slice_ns=MS)
    run.takes_ns = 14 * MS  # twice that is more than a scan time
    run.stream()
    for name in "abc":
        late = run.late(name)
        assert run.rate_hz(name, 2.0) == pytest.approx(RATE_HZ, abs=1.0)
        assert run.late(name) == late
        assert in_order(run.sent.sweeps[name])
        assert run.by_name[name].ledger.account()["unaccounted"] == 0


@pytest.mark.parametrize("how", ["is building", "stands still"])
def test_sensors_of_a_process_that_is_away_get_their_turn_of_one_that_has_too_much(rig: Make, how: str) -> None:
    names = ("left", "front", "right")
    run = rig(*names, workers=2, shared=names, slice_ns=2 * MS)
    run.takes_ns = 8 * MS
    run.stream()
    lost = run.processes[1]
    run.takes_ns = 40 * MS
    assert run.advance(1.0, lambda: lost.busy)
    if how == "is building":
        run.builds_ns = 30 * SECOND
        lost.end(-9)
    else:
        lost.stopped = True
    run.advance(1.0)
    before = {name: len(run.sent.at_ns[name]) for name in names}
    run.advance(3.0)
    sent = {name: len(run.sent.at_ns[name]) - before[name] for name in names}
    assert sum(sent.values()) > 60
    assert min(sent.values()) > 10, sent


def test_a_process_is_not_lent_for_sweeps_that_would_make_its_own_late(rig: Make) -> None:
    run = rig("heavy", "light", workers=2, shared=["heavy", "light"], slice_ns=MS)
    takes = {"heavy": 60 * MS, "light": 2 * MS}
    for one in run.processes:
        one.takes_of = takes
    run.stream()
    late = run.late("light")
    assert run.rate_hz("light", 4.0) == pytest.approx(RATE_HZ, abs=1.0)
    assert run.late("light") == late
    assert run.rate_hz("heavy", 4.0) == pytest.approx(RATE_HZ / 3, abs=2.0), "alone"


class Pool:
    """Workers on a virtual clock, with played processes that take no time."""

    clock = ManualClock()
    builds_ns, takes_ns, cpu_ns = 0, 0, MS
    scan_of = staticmethod(Rig.scan_of)

    def __init__(self, count: int = 2) -> None:
        self.processes: list[Played] = []
        self.on_launch: Callable[[Played], None] = lambda made: None
        self.workers = Workers(Measures, ["front"], count, None, self, self._launch, shared=["front"])

    def now_ns(self) -> int:
        for one in self.processes:
            one.step(self.clock.now_ns())
        self.clock.set(self.clock.now_ns() + MS)
        return self.clock.now_ns()

    def _launch(self, loops: bool | None) -> Played:
        self.processes.append(Played(self, 0, loops))  # type: ignore[arg-type]
        self.on_launch(self.processes[-1])
        return self.processes[-1]


def test_virtual_time_waits_for_what_is_asked_for_and_not_for_what_is_begun_early() -> None:
    pool = Pool()
    first, second, asked = plan(0, 1, 0), plan(0, 2, SECOND), plan(7, 2, SECOND)
    pool.workers.request("front", first)
    assert pool.workers.spare("front") == 2
    pool.workers.request_ahead("front", second, NORMAL)
    busy = next(one for one in pool.processes if one is not pool.processes[0])
    busy.stopped = True
    assert pool.workers.settle() == {"front"}
    assert [scan.plan.sweep for scan in pool.workers.collect("front")] == [1]
    busy.stopped = False
    pool.workers.settle()
    assert pool.workers.collect("front") == [], "nobody has asked for it"
    assert pool.workers.claim("front", second, asked)
    assert pool.workers.collect("front") == [], "as all others it comes when time stands"
    assert pool.workers.settle() == {"front"}
    [scan] = pool.workers.collect("front")
    assert scan.plan is asked
    assert not pool.workers.claim("front", second, asked)
    pool.workers.close()


def test_what_is_dropped_is_measured_no_more_and_does_not_come() -> None:
    pool = Pool()
    plans = [plan(0, number, number * SECOND) for number in range(1, 5)]
    for one in plans[:3]:
        pool.workers.request_ahead("front", one, NORMAL)
    pool.workers.drop("front", plans[:3])
    pool.workers.request("front", plans[3])
    assert pool.workers.settle() == {"front"}
    scans: list[Scan] = pool.workers.collect("front")
    assert [scan.plan.sweep for scan in scans] == [4]
    measured: list[ScanPlan | int] = [sweep for one in pool.processes for _, sweep in one.measured]
    assert 3 not in measured, "it was in nobody's hands"
    pool.workers.close()


FED = Conditions(world=NOTHING)
"A world that somebody else moves."


def sweep(number: int, beams: int = 181) -> ScanPlan:
    return replace(
        plan(0, number, number * SECOND), azimuth_rad=np.arange(beams) / beams, elevation_rad=np.zeros(beams),
        fire_offset_s=np.zeros(beams),
    )  # fmt: skip


def numbered(scan: Scan) -> Scan:
    """Ranges by which the beams can be told."""
    scan.range_m[:, 0] = np.arange(len(scan.plan))
    return scan


def pool_of(processes: int = 2) -> Pool:
    pool = Pool(processes)
    for one in pool.processes:
        one.sends = numbered
    return pool


def asked(pool: Pool, wanted: ScanPlan, conditions: Conditions = FED) -> Scan:
    pool.workers.request("front", wanted, conditions)
    assert pool.workers.settle() == {"front"}
    [scan] = pool.workers.collect("front")
    assert scan.plan.sweep == wanted.sweep
    return scan


def counts(pool: Pool) -> list[int]:
    return [len(one.measured) for one in pool.processes]


@pytest.mark.parametrize("processes", [1, 2, 3])
def test_a_sweep_of_a_fed_world_is_measured_by_all_processes_at_once(processes: int) -> None:
    pool = pool_of(processes)
    assert asked(pool, sweep(1)).range_m[:, 0].tolist() == list(range(181))
    assert counts(pool) == [1] * processes
    pool.workers.close()


def test_one_of_the_file_and_one_of_few_beams_are_measured_whole() -> None:
    pool = pool_of()
    asked(pool, sweep(1), NORMAL)
    asked(pool, sweep(2, beams=20))
    assert sum(counts(pool)) == 2
    pool.workers.close()


def test_a_killed_process_costs_its_part_being_measured_again() -> None:
    pool = pool_of()
    asked(pool, sweep(1))
    lost, other = pool.processes
    lost.dies_at = lambda sensor, _: True
    pool.on_launch = lambda made: setattr(made, "sends", numbered)
    assert asked(pool, sweep(2)).range_m[:, 0].tolist() == list(range(181))
    assert [count for _, count in other.measured] in ([1, 2], [1, 2, 2])
    assert sum(counts(pool)) == 4, "two parts each"
    assert pool.workers.failures == []
    pool.workers.close()


def test_what_cannot_be_divided_is_whole_and_asked_again_after_some_sweeps() -> None:
    pool = pool_of()
    for one in pool.processes:
        one.divides = False
    assert asked(pool, sweep(1)).range_m[:, 0].tolist() == list(range(181))
    for number in range(2, 2 + WHOLE_FOR):
        asked(pool, sweep(number))
    assert sum(counts(pool)) <= 2 + WHOLE_FOR, "one process each"
    for one in pool.processes:
        one.divides = True
    before = counts(pool)
    asked(pool, sweep(100))
    assert [now - then for now, then in zip(counts(pool), before, strict=True)] == [1, 1]
    pool.workers.close()


def test_a_part_that_fails_is_told_once_and_the_sweep_comes_without_echoes() -> None:
    pool = pool_of()
    for one in pool.processes:
        one.sends = lambda scan: ArithmeticError("no")
    assert np.isnan(asked(pool, sweep(1)).range_m).all()
    pool.workers.settle()
    assert pool.workers.failures == ["front: sweep 1: ArithmeticError: no"]
    assert pool.workers.collect("front") == []
    for one in pool.processes:
        one.sends = numbered
    assert asked(pool, sweep(2)).range_m[:, 0].tolist() == list(range(181)), "nothing of the former is left"
    pool.workers.close()


def test_a_sweep_of_which_a_part_is_late_comes_back_once_and_nothing_more_of_it_is_measured() -> None:
    pool = pool_of()
    clock = ManualClock()
    pool.workers._run_clock = clock
    asked(pool, sweep(1))
    for one in pool.processes:
        one.stopped = True
    pool.workers.request("front", sweep(2), FED)
    clock.set(3 * SECOND)
    came: list[Scan] = []
    for _ in range(60):
        pool.clock.set(pool.clock.now_ns() + 50 * MS)
        pool.workers.check()
        came += pool.workers.collect("front")
    assert [type(scan) for scan in came] == [NotMeasured]
    for one in pool.processes:
        one.stopped = False
    for _ in range(10):
        pool.now_ns()
        pool.workers.poll()
    assert pool.workers.collect("front") == []
    pool.workers.close()


def pool_in_real_time() -> tuple[Pool, ManualClock]:
    pool, clock = pool_of(1), ManualClock()
    pool.workers._run_clock = clock
    return pool, clock


def served(pool: Pool, rounds: int = 10) -> list[Scan]:
    for _ in range(rounds):
        pool.now_ns()
        pool.workers.poll()
    return pool.workers.collect("front")


def sliced(pool: Pool, wanted: ScanPlan, number: int, of: int = 2) -> None:
    pool.workers.request_slice("front", wanted, FED, number, of)


def test_slices_of_a_sweep_come_together_when_the_last_one_has_been_measured() -> None:
    pool, _ = pool_in_real_time()
    wanted = sweep(1)
    assert pool.workers.has_slices("front", wanted)
    sliced(pool, wanted, 0)
    assert served(pool) == []
    sliced(pool, wanted, 1)
    [scan] = served(pool)
    assert scan.plan is wanted
    assert scan.range_m[:, 0].tolist() == list(range(181))
    sliced(pool, wanted, 1)
    assert served(pool) == [], "it has come"
    assert counts(pool) == [2]
    pool.workers.close()


def test_slices_are_of_one_process_in_real_time_alone() -> None:
    several = pool_of(2)
    assert not several.workers.has_slices("front", sweep(1)), "virtual time"
    several.workers._run_clock = ManualClock()
    assert not several.workers.has_slices("front", sweep(1)), "all parts at once"
    several.workers.close()
    pool, _ = pool_in_real_time()
    assert not pool.workers.has_slices("front", sweep(1, beams=20))
    pool.workers.close()


@pytest.mark.parametrize("number", [0, 1])
def test_a_killed_process_costs_its_slice_being_measured_again(number: int) -> None:
    pool, _ = pool_in_real_time()
    pool.on_launch = lambda made: setattr(made, "sends", numbered)
    wanted = sweep(1)
    for k in range(2):
        if k == number:
            pool.processes[0].dies_at = lambda sensor, plan: True
        sliced(pool, wanted, k)
        early = served(pool, 5)
        pool.workers.check()
        early += served(pool, 5)
        assert len(early) == k
    assert early[0].range_m[:, 0].tolist() == list(range(181))
    assert len(pool.processes) == 2
    assert pool.workers.failures == []
    pool.workers.close()


def test_a_sweep_that_has_no_parts_is_whole_when_its_first_slice_has_been_measured() -> None:
    pool, _ = pool_in_real_time()
    pool.processes[0].divides = False
    wanted = sweep(1)
    sliced(pool, wanted, 0)
    [scan] = served(pool)
    assert scan.range_m[:, 0].tolist() == list(range(181))
    sliced(pool, wanted, 1)
    assert served(pool) == []
    assert not pool.workers.has_slices("front", sweep(2)), "for some sweeps"
    for number in range(2, 2 + WHOLE_FOR):
        pool.workers.request("front", sweep(number), FED)
        served(pool, 3)
    assert pool.workers.has_slices("front", sweep(100))
    pool.workers.close()


def test_a_slice_that_stands_still_ends_its_sweep_when_it_is_late() -> None:
    pool, clock = pool_in_real_time()
    sliced(pool, sweep(1), 0)
    sliced(pool, sweep(1), 1)
    served(pool)
    wanted = sweep(2)
    sliced(pool, wanted, 0)
    pool.processes[0].stopped = True
    sliced(pool, wanted, 1)
    clock.set(3 * SECOND)
    came: list[Scan] = []
    for _ in range(60):
        pool.clock.set(pool.clock.now_ns() + 50 * MS)
        pool.workers.check()
        came += pool.workers.collect("front")
    assert [type(scan) for scan in came] == [NotMeasured]
    pool.processes[0].stopped = False
    assert served(pool) == []
    pool.workers.close()


def test_weather_that_has_no_parts_any_more_makes_a_later_slice_the_whole_sweep() -> None:
    """A process that was asked for a slice never answers that it is nothing: what holds may have changed meanwhile."""
    asked_for: list[int] = []

    class Whole:
        def __call__(self, wanted: ScanPlan, conditions: Conditions = NORMAL) -> Scan:
            asked_for.append(wanted.sweep)
            return numbered(Scan.empty(wanted))

        def part(self, wanted: ScanPlan, conditions: Conditions, number: int, of: int, in_time: bool) -> None:
            return None

    assert isinstance(part_measured(Whole(), sweep(3), FED, 1, 2, True), Scan)
    assert part_measured(Whole(), sweep(4), FED, 1, 2) is None
    assert asked_for == [3]
