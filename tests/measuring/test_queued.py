"""Sweeps that wait in the pipe of a measuring process behind the one in its hands: played processes, no waiting."""

from __future__ import annotations

import pytest

from emulator.instrument.ahead import MOST_EARLY
from emulator.measuring.conditions import NORMAL
from emulator.measuring.homes import Home, Sweep
from emulator.measuring.sharing import QUEUED_NS
from emulator.process.clock import ManualClock
from emulator.scenario.weather import WeatherConfig
from protocols.scan import ScanPlan
from tests.instrument.test_instrument import plan
from tests.measuring.process_rig import MS, SECOND, Make, Played, Rig
from tests.measuring.test_sharing import Pool

TAKES_NS = 6 * MS


class Sender:
    """Asks for one sweep after the other of a sensor, begins further ones, and comes round every few milliseconds."""

    def __init__(self, processes: int = 1, takes_ns: int = TAKES_NS) -> None:
        self.pool = Pool(processes)
        self.pool.takes_ns = takes_ns
        self.workers = self.pool.workers
        self.workers._run_clock = ManualClock()  # it stands: nothing becomes late
        self.plans: list[ScanPlan] = []
        "All that have been begun."
        self.came: list[int] = []
        self.idle: list[bool] = []
        "Whether a process had nothing to do, each millisecond."
        self.workers.request("front", self.next_plan())

    def next_plan(self) -> ScanPlan:
        self.plans.append(plan(0, len(self.plans), len(self.plans) * SECOND))
        return self.plans[-1]

    def pass_ms(self, count: int) -> None:
        for _ in range(count):
            self.pool.now_ns()
            self.idle.append(not all(one.busy for one in self.pool.processes))

    def come_round(self) -> None:
        self.workers.poll()
        self.workers.check()
        self.take()
        while len(self.plans) - len(self.came) < MOST_EARLY and self.workers.spare("front"):
            self.workers.request_ahead("front", self.next_plan(), NORMAL)

    def take(self) -> None:
        while scans := self.workers.collect("front"):
            for scan in scans:
                self.came.append(scan.plan.sweep)
                wanted = len(self.came)
                if wanted == len(self.plans) or not self.workers.claim("front", *[self.plans[wanted]] * 2):
                    self.workers.request("front", self.next_plan() if wanted == len(self.plans) else self.plans[wanted])

    def run(self, rounds: int, every_ms: int = 3) -> None:
        for _ in range(rounds):
            self.pass_ms(every_ms)
            self.come_round()

    @property
    def home(self) -> Home:
        return self.workers._homes[0]

    @property
    def process(self) -> Played:
        return self.pool.processes[-1]

    def close(self) -> None:
        assert self.came == list(range(len(self.came))), "each once, in order"
        self.workers.close()


@pytest.mark.parametrize("processes", [1, 2])
def test_a_process_is_never_without_work_though_the_sender_comes_round_late(processes: int) -> None:
    sender = Sender(processes)
    sender.run(10)
    sender.idle.clear()
    sender.run(100)
    assert sum(sender.idle) == 0
    assert len(sender.came) > 80 * processes
    sender.close()


def test_a_process_has_one_more_and_never_two() -> None:
    sender = Sender()
    sender.run(20)
    sender.process.stopped = True
    sender.run(5)
    assert isinstance(sender.home.in_hand, Sweep)
    assert sender.home.behind is not None
    assert sender.home.behind.plan.sweep == sender.home.in_hand.plan.sweep + 1
    assert len(sender.home.owed) == 2 + sender.home.waiting
    sender.process.stopped = False
    for _ in range(60):
        sender.run(1)
        assert len(sender.process.jobs) <= 2
    sender.close()


def test_long_sweeps_do_not_wait_in_pipes() -> None:
    sender = Sender(2, QUEUED_NS + 10 * MS)
    sender.run(100)
    assert all(one.behind is None for one in sender.workers._homes)
    assert len(sender.came) > 5
    sender.close()


def test_only_the_sweep_in_hand_is_blamed_for_the_end_of_its_process() -> None:
    sender = Sender()
    sender.run(20)
    assert sender.home.behind is not None
    deadly = len(sender.plans) + 1

    def arm(made: Played) -> None:
        made.dies_at = lambda sensor, wanted: wanted.sweep == deadly

    sender.pool.on_launch = arm
    arm(sender.process)
    sender.run(300)
    assert len(sender.pool.processes) == 3
    assert sender.workers.failures == [f"front: sweep {deadly}: terminated its measuring process twice"]
    assert len(sender.came) > deadly + 50
    sender.close()


def test_what_is_in_the_pipe_of_a_killed_process_goes_to_the_next_one() -> None:
    sender = Sender()
    sender.run(20)
    behind = sender.home.behind
    assert behind is not None
    sender.process.end(-9)
    sender.run(40)
    assert ("front", behind.plan.sweep) in sender.process.measured
    assert behind.tries == 0
    assert sender.workers.failures == []
    sender.close()


def test_what_waits_behind_a_sweep_that_stands_still_goes_to_another_process_too() -> None:
    sender = Sender(2)
    sender.run(20)
    lost = sender.pool.processes[0]
    in_hand, behind = sender.home.in_hand, sender.home.behind
    assert isinstance(in_hand, Sweep)
    assert behind is not None
    lost.stopped = True
    before = len(sender.came)
    sender.run(200)
    assert len(sender.came) > before + 100, "the other one goes on alone"
    measured = set(sender.pool.processes[1].measured)
    assert {("front", in_hand.plan.sweep), ("front", behind.plan.sweep)} <= measured
    lost.stopped = False
    sender.run(20)
    assert sender.home.in_hand not in (in_hand, behind)
    sender.close()


def test_what_is_dropped_in_a_pipe_does_not_come() -> None:
    sender = Sender()
    sender.run(20)
    behind = sender.home.behind
    assert behind is not None
    assert behind.ahead
    sender.workers.drop("front", [one for one in sender.plans if one.sweep >= behind.plan.sweep])
    del sender.plans[behind.plan.sweep :]
    assert behind.given_up
    sender.process.end(-9)
    assert sender.home.behind is behind
    sender.workers.poll()
    sender.workers.check()
    assert behind not in sender.home.owed, "no other process is given it"
    sender.run(20)
    sender.close()


def test_a_question_comes_next_after_what_is_in_the_pipe() -> None:
    sender = Sender()
    sender.run(20)
    first, behind = sender.home.in_hand, sender.home.behind
    [answer] = sender.workers.judge(WeatherConfig())
    while sender.home.in_hand in (first, behind):
        assert not answer.done()
        assert sender.home.behind in (behind, None), "nothing is put before it"
        sender.pass_ms(1)
        sender.come_round()
    assert not isinstance(sender.home.in_hand, Sweep)
    assert sender.home.behind is None
    sender.run(5)
    assert answer.result(0) == {}
    sender.close()


def test_a_sensor_keeps_what_its_own_process_can_begin_sooner(rig: Make) -> None:
    """A sweep does not wait in the pipe of a process that has others of its own."""
    run = rig("heavy", "light", workers=2, shared=["heavy", "light"], slice_ns=MS)
    for one in run.processes:
        one.takes_of = {"heavy": 18 * MS, "light": 2 * MS}
    run.stream()
    run.advance(2.0)
    of = {name: number for number, home in enumerate(run.workers._homes) for name in home.sensors}
    for _ in range(500):
        run.advance(0.001)
        behind = run.workers._homes[of["heavy"]].behind
        assert behind is None or behind.sensor == "heavy"


def test_behind_a_sensor_that_remembers_and_hangs_waits_none_that_another_process_could_measure() -> None:
    rig = Rig("remembers", "b", "a", workers=2, shared=["a", "b"], slice_ns=2 * MS, builds_ns=100 * MS)
    rig.takes_ns = 9 * MS
    rig.stream()
    home = rig.workers._home["remembers"]
    assert "a" in home.sensors

    def measures() -> bool:
        waits = any(isinstance(one, Sweep) and one.sensor == "a" for one in home.owed)
        return isinstance(home.in_hand, Sweep) and home.in_hand.sensor == "remembers" and not waits

    for _ in range(6000):
        rig.advance(0.002)
        if measures():
            break
    assert measures()
    rig.processes[rig.workers._homes.index(home)].stopped = True
    late = rig.late("a")
    rig.advance(1.5)
    assert rig.late("a") - late <= 1
    rig.close()
