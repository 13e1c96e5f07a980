"""Measuring processes that are killed, stopped, slow, or cannot be started: played ones, on a clock of the test."""

from __future__ import annotations

import errno
from collections.abc import Callable

import numpy as np
import pytest

from emulator.errors import EmulatorError, SceneError
from emulator.measuring.conditions import NORMAL
from emulator.measuring.supervision import Workers
from emulator.process import time_limits
from emulator.process.time_limits import Pace, RunningTime, Stillness, pause_ns
from protocols.scan import ScanPlan
from tests.measuring.process_rig import LD, LISTS, MS, RATE_HZ, SECOND, Make, Played, Rig


@pytest.mark.parametrize("when", ["between sweeps", "in mid sweep", "in mid scan"])
def test_a_killed_worker_costs_some_scans(rig: Make, when: str) -> None:
    run = rig("front")
    run.stream()
    if when == "between sweeps":
        assert run.advance(1.0, lambda: not run.process.busy)
        run.process.end(-9)
    else:
        assert run.advance(1.0, lambda: run.process.busy)
        run.process.end(-9) if when == "in mid sweep" else run.process.die_in_a_message()
    run.advance(1.0)
    assert run.rate_hz("front", 2.0) == pytest.approx(RATE_HZ, abs=1.0)
    assert run.kinds() == ["worker replaced"]
    assert "ended with signal 9 (SIGKILL)" in run.texts()[0]
    # the scene is built in 0.3 s: so long nothing is measured, and a tenth until the late ones are given up
    assert 0 < run.late("front") < 0.5 * RATE_HZ
    assert run.daemon.incidents.exit_code == 0


def test_sensors_of_another_worker_go_on_at_full_rate(rig: Make) -> None:
    run = rig("front", "left", workers=2, builds_ns=5 * SECOND)
    run.stream()
    homes = {row["sensors"][0]: row["pid"] for row in run.workers.rows()}  # type: ignore[index]
    assert set(homes) == {"front", "left"}
    run.processes[0].end(-9)
    assert run.rate_hz("left", 3.0) == pytest.approx(RATE_HZ, abs=1.0)
    assert run.late("left") == 0
    assert run.daemon.liveness.silent == ("front",)
    run.advance(3.0)
    assert run.rate_hz("front", 2.0) == pytest.approx(RATE_HZ, abs=1.0)


def test_the_descriptor_waited_for_is_the_same_however_often_a_process_is_replaced(rig: Make) -> None:
    run = rig("front")
    run.stream()
    before = run.workers.filenos()
    for _ in range(3):
        run.process.end(-9)
        run.advance(1.5)
    assert run.workers.filenos() == before
    assert run.rate_hz("front", 1.0) == pytest.approx(RATE_HZ, abs=1.0)


def test_a_hung_worker_is_replaced_after_the_stated_time(rig: Make) -> None:
    run = rig("front")
    run.stream()
    began_ns = run.clock.now_ns()
    run.process.stopped = True
    assert run.advance(20.0, lambda: "worker replaced" in run.kinds())
    took_s = (run.clock.now_ns() - began_ns) * 1e-9
    stated_s = (time_limits.SWEEP_NS + time_limits.SWEEP_TIMES * run.takes_ns) * 1e-9
    assert stated_s < took_s < stated_s + 0.5
    assert run.processes[0].code == -9
    text = next(text for text in run.texts() if "hung: " in text)
    assert "measuring front, sweep" in text
    assert text.count("sweep") == 1
    assert "limit 5." in text
    run.advance(1.0)
    assert run.rate_hz("front", 1.0) == pytest.approx(RATE_HZ, abs=1.0)
    assert run.kinds() == ["sensor silent", "worker replaced", "sensor back"]
    assert run.daemon.incidents.exit_code == 5


def test_a_worker_that_goes_on_in_time_is_kept_and_what_it_owed_is_not_sent(rig: Make) -> None:
    run = rig("front", "left", slice_ns=4 * MS)
    run.stream()
    assert run.advance(1.0, lambda: run.process.busy)
    run.process.stopped = True
    run.advance(4.0)
    measured = len(run.process.measured)
    run.process.stopped = False
    back_ns = run.clock.now_ns()
    run.advance(0.3)
    assert len(run.processes) == 1
    assert "worker replaced" not in run.kinds()
    for sensor in ("front", "left"):
        first_ns = next(at for at in run.sent.at_ns[sensor] if at >= back_ns)
        assert first_ns < back_ns + 0.2 * SECOND
        assert run.late(sensor) == pytest.approx(4.0 * RATE_HZ, abs=8)
        assert set(run.by_name[sensor].stats.scans_dropped) == {"measured too late"}
    # nothing is measured for the bin: the one in hand, then what is fresh
    assert len(run.process.measured) - measured <= 2 * (0.3 * RATE_HZ + 3)
    sweeps = [sweep for sensor, sweep in run.process.measured[measured + 1 :] if sensor == "left"]
    assert sweeps == sorted(sweeps)
    assert run.rate_hz("left", 1.0) == pytest.approx(RATE_HZ, abs=1.0)


def test_a_worker_is_not_judged_by_time_in_which_the_sender_was_stopped(rig: Make) -> None:
    run = rig("front")
    run.stream()
    assert run.advance(1.0, lambda: run.process.busy)
    run.process.stopped = True  # the whole container is frozen
    run.sleep(60.0)
    run.process.stopped = False
    sent = len(run.sent.at_ns["front"])
    run.advance(0.2)
    assert run.kinds() == []
    assert len(run.processes) == 1
    assert len(run.sent.at_ns["front"]) - sent < 0.2 * RATE_HZ + 3, "a storm of stale telegrams"
    assert run.rate_hz("front", 1.0) == pytest.approx(RATE_HZ, abs=1.0)
    assert run.late("front") == pytest.approx(60 * RATE_HZ, rel=0.02)


@pytest.mark.parametrize("uses_cpu", [True, False])
def test_a_first_sweep_may_take_long_while_it_uses_the_processor(rig: Make, uses_cpu: bool) -> None:
    run = rig("front", builds_ns=0)
    run.takes_ns = 60 * SECOND
    run.cpu_ns = MS if uses_cpu else 0
    for sensor in run.hosts:
        run.hosts[sensor].step(0)
    run.advance(55.0, lambda: len(run.processes) > 1)
    assert (len(run.processes) == 1) == uses_cpu
    if not uses_cpu:
        assert "without processor time measuring front" in run.texts()[0]


def test_a_slow_worker_sends_the_newest_and_counts_the_others(rig: Make) -> None:
    run = rig("front")
    run.takes_ns = 80 * MS
    run.stream()
    before, late = len(run.sent.at_ns["front"]), run.late("front")
    run.advance(10.0)
    sent = len(run.sent.at_ns["front"]) - before
    assert sent == pytest.approx(125, rel=0.2)
    assert sent + run.late("front") - late == pytest.approx(10 * RATE_HZ, abs=5)
    newest = run.sent.at_ns["front"][-1]
    assert run.clock.now_ns() - newest < 0.3 * SECOND
    assert run.kinds() == []


def test_a_sweep_out_of_memory_comes_back_without_echoes(rig: Make) -> None:
    run = rig("front")
    run.stream()
    run.process.sends = lambda scan: MemoryError("no room")
    assert run.rate_hz("front", 1.0) == pytest.approx(RATE_HZ, abs=1.0)
    run.process.sends = lambda scan: scan
    assert run.kinds() == ["sweep unmeasured"]
    assert "MemoryError: no room" in run.texts()[0]
    assert run.daemon.failures["no room"] > 30


def test_a_full_pipe_does_not_block_the_sender(rig: Make) -> None:
    run = rig("front")
    run.stream()
    assert run.advance(1.0, lambda: not run.process.busy)
    run.process.stopped = True
    zeros = np.zeros(20_000)
    run.workers.request("front", ScanPlan(9, 1, run.clock.now_ns() + SECOND, zeros, zeros, zeros), NORMAL)
    assert run.workers._homes[0].pipe is not None
    run.advance(1.0)
    assert run.workers._homes[0].pipe.is_full
    run.process.stopped = False
    run.advance(3.0)
    assert run.rate_hz("front", 1.0) == pytest.approx(RATE_HZ, abs=1.0)
    assert len(run.processes) == 1


def test_a_worker_that_cannot_be_started_is_tried_again_and_the_others_go_on(rig: Make) -> None:
    run = rig("front", "left", workers=2)
    run.stream()
    run.launch_error = OSError(errno.EAGAIN, "Resource temporarily unavailable")
    run.processes[0].end(-9)
    assert run.rate_hz("left", 12.0) == pytest.approx(RATE_HZ, abs=1.0)
    assert run.kinds().count("worker lost") == 1
    text = run.texts()[run.kinds().index("worker lost")]
    assert text.startswith("cannot be started: Resource temporarily unavailable: 3 times in a row")
    assert run.workers.rows()[0]["state"] == "dead"
    assert int(str(run.workers.rows()[0]["started"])) < 12, "pauses grow"
    assert run.daemon.liveness.silent_s("front") > 8.0
    run.launch_error = None
    assert run.advance(17.0, lambda: run.kinds()[-1] == "sensor back")
    run.advance(0.5)
    assert run.rate_hz("front", 1.0) == pytest.approx(RATE_HZ, abs=1.0)
    assert run.kinds()[-2:] == ["worker back", "sensor back"]
    assert run.late("front") > 12 * RATE_HZ
    assert run.daemon.incidents.exit_code == 5


def test_a_mesh_that_has_gone_is_told_and_tried_again(rig: Make) -> None:
    run = rig("front")
    run.stream()

    def refuse(made: Played) -> None:
        made.refuses = "wall.obj: No such file or directory"

    run.on_launch = refuse
    run.process.end(-9)
    run.advance(10.0)
    assert run.kinds().count("worker lost") == 1
    assert "refused: wall.obj: No such file" in run.texts()[run.kinds().index("worker lost")]
    run.on_launch = lambda made: None
    assert run.advance(30.0, lambda: run.kinds()[-1] == "sensor back"), run.kinds()
    run.advance(0.5)
    assert run.rate_hz("front", 1.0) == pytest.approx(RATE_HZ, abs=1.0)


def test_one_sensor_that_ends_its_worker_with_every_sweep_does_not_stop_the_others(rig: Make) -> None:
    run = rig("deadly", "good", slice_ns=4 * MS)
    run.stream()

    def arm(made: Played) -> None:
        made.dies_at = lambda sensor, plan: sensor == "deadly"

    run.on_launch = arm
    arm(run.process)
    run.advance(8.0)
    assert run.rate_hz("good", 16.0) > 0.9 * RATE_HZ
    assert len(run.processes) < 12, "it is tried less and less often"
    assert run.daemon.liveness.silent == ("deadly",)
    assert run.late("deadly") > 22 * RATE_HZ
    run.on_launch = lambda made: None
    run.process.dies_at = lambda sensor, plan: False
    assert run.advance(17.0, lambda: run.daemon.liveness.silent == ())
    run.advance(1.0)
    assert run.rate_hz("deadly", 2.0) == pytest.approx(RATE_HZ, abs=1.0)


def test_a_crash_loop_between_sweeps_is_slowed_down(rig: Make) -> None:
    run = rig("front", builds_ns=50 * MS)
    run.stream()
    for _ in range(200):
        if run.workers.rows()[0]["state"] == "ready":
            run.process.end(-9)
        run.advance(0.1)
    assert len(run.processes) < 40, "of 200 that were killed"
    assert run.advance(31.0, lambda: run.workers.rows()[0]["state"] == "ready")
    run.advance(0.5)
    assert run.rate_hz("front", 1.0) == pytest.approx(RATE_HZ, abs=1.0)


def test_a_successor_that_is_stopped_while_it_builds_is_replaced(rig: Make) -> None:
    run = rig("front")
    run.stream()

    def stop(made: Played) -> None:
        made.stopped = True

    run.on_launch = stop
    run.process.end(-9)
    run.advance(1.0)
    run.on_launch = lambda made: None
    assert run.advance(70.0, lambda: len(run.processes) == 3)
    assert run.processes[1].code == -9
    assert "without processor time building the scene" in run.texts()[-1]
    run.advance(1.0)
    assert run.rate_hz("front", 1.0) == pytest.approx(RATE_HZ, abs=1.0)


def test_every_family_is_at_its_rate_again(rig: Make) -> None:
    text = LD.format("top") + "\n" + LISTS.format("objects", "front", "process-rig")
    run = rig("front", text=text, builds_ns=3 * SECOND, slice_ns=4 * MS)
    run.stream("front", "top", "objects")
    before = {name: len(at) for name, at in run.sent.at_ns.items()}
    rates = {"front": RATE_HZ, "top": 10.0, "objects": 1e3 / 75.0}
    run.process.end(-9)
    run.advance(4.0)
    for name, rate_hz in rates.items():
        sent = len(run.sent.at_ns[name]) - before[name]
        assert 0.5 * rate_hz < sent < rate_hz + 6, "what was measured ahead, and nothing stale"
        assert sent + run.late(name) == pytest.approx(4.0 * rate_hz, abs=4)
    for name, rate_hz in rates.items():
        assert run.rate_hz(name, 2.0) == pytest.approx(rate_hz, rel=0.05)
    for name, sweeps in run.sent.sweeps.items():
        assert sweeps == sorted(sweeps), name


def test_a_single_scan_that_was_asked_for_comes_when_a_worker_is_there_again(rig: Make) -> None:
    from protocols.lms2xx.telegrams import request

    run = rig("front", builds_ns=2 * SECOND)
    run.stream()
    run.ends[0].write(request(b"\x20\x25"), run.clock.now_ns())
    run.advance(1.0)
    run.process.end(-9)
    sent = len(run.sent.at_ns["front"])
    run.ends[0].write(request(b"\x30\x01"), run.clock.now_ns())
    run.advance(4.0)
    assert len(run.sent.at_ns["front"]) == sent + 1
    assert run.sent.at_ns["front"][-1] > run.clock.now_ns() - 2.5 * SECOND


# the first start


def started(play: Callable[[Played], None], clock_rig: Rig) -> Workers:
    def launch(_loops: bool | None) -> Played:
        made = Played(clock_rig, 10 * MS)
        clock_rig.processes.append(made)
        play(made)
        return made

    class Moving:
        def now_ns(self) -> int:
            clock_rig.clock.set(clock_rig.clock.now_ns() + time_limits.TICK_NS)
            clock_rig.processes[-1].step(clock_rig.clock.now_ns()) if clock_rig.processes else None
            return clock_rig.clock.now_ns()

    return Workers(dict, ["front"], 1, clock_rig.clock, Moving(), launch)


@pytest.mark.parametrize(
    ("play", "reported"),
    [
        (lambda made: made.end(-9), r"ended with signal 9 \(SIGKILL\) while it built the scene \(out of memory\?\)"),
        (lambda made: setattr(made, "refuses", "wall.obj: no triangle"), "wall.obj: no triangle"),
        (lambda made: setattr(made, "stopped", True), "hung: 2.. s without processor time building the sce"),
    ],
)
def test_a_first_start_that_fails_says_why(
    rig: Make, play: Callable[[Played], None], reported: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("emulator.process.time_limits.IDLE_BUILD_NS", 2 * SECOND)
    run = rig("front")
    run.processes.clear()
    with pytest.raises(SceneError, match=reported):
        started(play, run)


def test_a_machine_without_processes_to_give_says_so() -> None:
    def launch(_loops: bool | None) -> Played:
        raise OSError(errno.EAGAIN, "Resource temporarily unavailable")

    with pytest.raises(EmulatorError, match="measuring process cannot be started: Resource temporarily unavailable"):
        Workers(dict, ["front"], 1, launch=launch)


def test_the_end_of_a_run_does_not_wait_for_a_stopped_worker(rig: Make) -> None:
    run = rig("front")
    run.stream()
    run.process.stopped = True
    run.workers.close()
    assert run.process.code == -9


# arithmetic


def test_running_time_leaves_out_what_was_not_ours() -> None:
    ran = RunningTime()
    assert ran.pass_to(5 * SECOND) == 0
    assert ran.pass_to(5 * SECOND + 50 * MS) == 50 * MS
    assert ran.pass_to(15 * SECOND) == 50 * MS + time_limits.MOST_AT_ONCE_NS
    assert ran.pass_to(1 * SECOND) == 50 * MS + time_limits.MOST_AT_ONCE_NS, "a clock that begins again"


def test_a_deadline_follows_what_sweeps_take() -> None:
    pace = Pace()
    assert pace.deadline_ns == time_limits.FIRST_SWEEP_NS
    pace.add(100 * SECOND)  # it compiled
    assert pace.deadline_ns == time_limits.SWEEP_NS
    pace.add(2 * SECOND)
    assert pace.deadline_ns == 45 * SECOND
    assert pace.stalled_ns == 20 * SECOND
    for _ in range(time_limits.LATEST_KEPT):
        pace.add(MS)
    assert pace.deadline_ns == time_limits.SWEEP_NS + 20 * MS
    assert pace.stalled_ns == time_limits.STALLED_NS


def test_pauses_double_up_to_half_a_minute() -> None:
    assert [pause_ns(count) / SECOND for count in range(11)] == [0, 0, 0.25, 0.5, 1, 2, 4, 8, 16, 30, 30]
    assert pause_ns(10_000) == 30 * SECOND


def test_stillness_is_time_without_processor_time() -> None:
    still = Stillness(0)
    assert still.look(SECOND, 5) == 0
    assert still.look(3 * SECOND, 5) == 2 * SECOND
    assert still.look(4 * SECOND, 6) == 0
    assert still.look(9 * SECOND, None) == 0
