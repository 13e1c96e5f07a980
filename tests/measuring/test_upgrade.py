"""Processes with arrays that are replaced by ones with loops while a run lives: played, on a clock of the test."""

from __future__ import annotations

import errno
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from emulator.measuring import upgrade
from emulator.process import time_limits
from tests.measuring.process_rig import MS, SECOND, Played, PlayedBuilding, Rig

RATE_HZ = 37.5
EACH = 2
"The sensor turns at 75 Hz."


class Upgraded(Rig):
    """A rig whose loops are not built yet."""

    def __init__(self, *sensors: str, refused: OSError | None = None, **words: Any) -> None:
        self.building = PlayedBuilding()

        def begin() -> PlayedBuilding:
            if refused is not None:
                raise refused
            return self.building

        super().__init__(*sensors, build_loops=begin, **words)

    def built(self, seconds: float = 5.0) -> None:
        self.building.done = True
        self.advance(seconds)

    def forms(self) -> list[object]:
        return [row["form"] for row in self.workers.rows()]

    def unheard(self) -> list[str]:
        """What has been told but for the beginning of building."""
        assert self.reported[0] == upgrade.BUILDING
        return self.reported[1:]

    def sound(self, *sensors: str) -> None:
        """No scan is lost, none sent twice, nothing counts as a fault."""
        for name in sensors:
            sweeps = self.sent.sweeps[name]
            assert sweeps == list(range(sweeps[0], sweeps[0] + EACH * len(sweeps), EACH)), name
            assert not self.by_name[name].stats.scans_dropped
        assert self.kinds() == []
        assert self.daemon.incidents.exit_code == 0


@pytest.fixture
def rig() -> Iterator[Callable[..., Upgraded]]:
    made: list[Upgraded] = []

    def make(*sensors: str, **words: object) -> Upgraded:
        made.append(Upgraded(*sensors, **words))  # type: ignore[arg-type]
        return made[-1]

    yield make
    for one in made:
        one.close()


def test_a_run_begins_with_arrays_while_loops_are_built(rig: Callable[..., Upgraded]) -> None:
    run = rig("front")
    run.stream()
    run.advance(10.0)
    assert run.forms() == ["arrays"]
    assert [one.loops for one in run.processes] == [False]
    assert run.unheard() == []
    run.sound("front")


def test_processes_are_replaced_one_by_one_and_no_scan_is_lost(rig: Callable[..., Upgraded]) -> None:
    run = rig("front", "left", "right", workers=3)
    run.stream()
    alive: list[int] = []
    run.building.done = True
    while run.forms() != ["loops"] * 3 and run.clock.now_ns() < 60 * SECOND:
        run.advance(0.004)
        alive.append(sum(one.code is None for one in run.processes))
    assert run.forms() == ["loops"] * 3
    assert max(alive) == 4, "never more than one beside those that measure"
    assert len(run.processes) == 6
    assert [one.loops for one in run.processes] == [False] * 3 + [True] * 3
    run.advance(3.0)
    assert [one.code for one in run.processes[:3]] == [-15] * 3
    assert run.building.closed
    assert len(run.unheard()) == 1
    assert run.unheard()[0].startswith("compiled loops are in use; built in ")
    assert run.rate_hz("left", 2.0) == pytest.approx(RATE_HZ, abs=1.0)
    run.sound("front", "left", "right")
    assert [row["started"] for row in run.workers.rows()] == [2] * 3


def test_the_new_process_is_tried_and_goes_on_from_what_the_old_one_remembers(rig: Callable[..., Upgraded]) -> None:
    run = rig("front", "left", slice_ns=4 * MS)
    run.stream()
    run.built()
    old, new = run.processes
    assert new.state == {"of": 0}
    tried, served = new.measured[:2], new.measured[2:]
    assert {sensor for sensor, _ in tried} == {"front", "left"}
    for sensor in ("front", "left"):
        last = max(sweep for name, sweep in old.measured if name == sensor)
        assert min(sweep for name, sweep in served if name == sensor) == last + EACH
    run.sound("front", "left")


def test_a_slow_first_sweep_of_the_new_process_holds_nothing_up(rig: Callable[..., Upgraded]) -> None:
    """It is measured for nobody."""
    run = rig("front")
    run.stream()
    run.on_launch = lambda made: setattr(made, "takes_ns", 3 * SECOND)
    run.building.done = True
    assert run.advance(2.0, lambda: len(run.processes) == 2 and run.process.busy)
    run.process.takes_ns = None
    run.advance(1.0)
    assert run.forms() == ["arrays"]
    assert run.advance(5.0, lambda: run.forms() == ["loops"])
    run.advance(1.0)
    run.sound("front")


@pytest.mark.parametrize("how", ["killed", "refused at its start"])
def test_a_build_that_comes_to_nothing_is_told_once_and_arrays_go_on(rig: Callable[..., Upgraded], how: str) -> None:
    if how == "killed":
        run = rig("front")
        run.stream()
        run.building.done = False
        run.advance(1.0)
        assert run.unheard() == [
            "compiled loops are not used in this run: they could not be built (signal 9); arrays go on"
        ]
        assert run.building.closed
    else:
        run = rig("front", refused=OSError(errno.EAGAIN, "no room"))
        run.stream()
        assert run.reported == [upgrade.NOT_USED.format("no process can be started: no room")]
    reported = len(run.reported)
    run.advance(5.0)
    assert (len(run.reported), run.forms(), len(run.processes)) == (reported, ["arrays"], 1)
    run.sound("front")


def refuses(made: Played) -> None:
    made.refuses = "wall.obj: gone"


def dies(made: Played) -> None:
    made.end(-4)


def stands_still(made: Played) -> None:
    made.stopped = True


def has_none(made: Played) -> None:
    made.form = "arrays"


def dies_on_trial(made: Played) -> None:
    made.dies_at = lambda sensor, plan: True


@pytest.mark.parametrize("wrong", [refuses, dies, stands_still, has_none, dies_on_trial])
def test_a_process_that_does_not_get_ready_is_told_once_and_arrays_go_on(
    rig: Callable[..., Upgraded], wrong: Callable[[Played], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("emulator.process.time_limits.IDLE_BUILD_NS", 2 * SECOND)
    run = rig("front", "left", workers=2)
    run.stream()
    run.on_launch = wrong
    run.built(4.0)
    assert len(run.processes) == 3
    assert run.forms() == ["arrays"] * 2
    assert run.process.code is not None
    assert len(run.unheard()) == 1
    assert run.unheard()[0].startswith("compiled loops are not used in this run: ")
    run.on_launch = lambda made: None
    run.processes[0].end(-9)
    run.advance(2.0)
    assert run.process.loops is False, "who is started later has none either"
    assert run.kinds() == ["worker replaced"]


@pytest.mark.parametrize("when", ["before it is ready", "while it is tried", "when it is warm"])
def test_a_process_that_dies_while_another_gets_ready_is_replaced_as_ever(
    rig: Callable[..., Upgraded], when: str
) -> None:
    run = rig("front")
    run.stream()
    run.on_launch = lambda made: setattr(made, "takes_ns", SECOND if when == "while it is tried" else None)
    run.building.done = True
    assert run.advance(2.0, lambda: len(run.processes) == 2)
    run.on_launch = lambda made: None
    if when != "before it is ready":
        assert run.advance(2.0, lambda: run.process.is_ready)
        if when == "while it is tried":
            assert run.advance(1.0, lambda: run.process.busy)
        else:  # what it remembers is asked for, and never told
            run.processes[0].stopped = True
            run.advance(0.2)
    run.processes[0].end(-9)
    run.advance(3.0)
    assert len(run.processes) == (3 if when == "while it is tried" else 2)
    assert run.process.loops
    assert run.forms() == ["loops"]
    assert run.kinds() == ["worker replaced"]
    assert run.rate_hz("front", 2.0) == pytest.approx(RATE_HZ, abs=1.0)
    assert run.unheard()[0].startswith("compiled loops are in use")


def test_a_worker_that_stands_still_when_asked_what_it_remembers_is_replaced_by_the_new_one(
    rig: Callable[..., Upgraded],
) -> None:
    run = rig("front")
    run.stream()
    run.building.done = True
    assert run.advance(2.0, lambda: len(run.processes) == 2)
    run.processes[0]._hand_over = lambda state: None  # type: ignore[method-assign]
    run.advance(time_limits.QUESTION_NS / SECOND + 2.0)
    assert "hung" in " ".join(run.texts())
    assert "handing over" in " ".join(run.texts())
    assert run.forms() == ["loops"]
    assert run.rate_hz("front", 2.0) == pytest.approx(RATE_HZ, abs=1.0)


def test_the_end_of_a_run_ends_what_builds_and_what_gets_ready(rig: Callable[..., Upgraded]) -> None:
    run = rig("front")
    run.stream()
    run.workers.close()
    assert run.building.closed
    run = rig("front")
    run.stream()
    run.building.done = True
    assert run.advance(2.0, lambda: len(run.processes) == 2)
    run.process.stopped = True
    run.workers.close()
    assert [one.code is None for one in run.processes] == [False, False]


def test_a_sensor_that_has_never_been_asked_goes_over_too(rig: Callable[..., Upgraded]) -> None:
    run = rig("front")
    run.built()
    assert run.forms() == ["loops"]
    run.stream()
    run.sound("front")


def test_weather_is_judged_while_processes_change(rig: Callable[..., Upgraded]) -> None:
    from emulator.scenario.weather import WeatherConfig

    run = rig("front")
    run.stream()
    run.building.done = True
    assert run.advance(2.0, lambda: len(run.processes) == 2 and run.process.is_ready)
    answers = run.workers.judge(WeatherConfig())
    run.advance(3.0)
    assert run.forms() == ["loops"]
    assert [one.result(0) for one in answers] == [{}]
    run.sound("front")


def test_without_anything_to_build_nothing_changes() -> None:
    run = Rig("front")
    try:
        run.stream()
        assert [one.loops for one in run.processes] == [None]
        assert run.reported == []
    finally:
        run.close()


def test_time_that_a_build_took_is_told(rig: Callable[..., Upgraded]) -> None:
    run = rig("front")
    run.stream()
    run.advance(8.0)
    run.built(2.0)
    assert 8.0 <= float(run.unheard()[0].split()[-2]) <= 10.0
    assert run.takes_ns == 2 * MS
