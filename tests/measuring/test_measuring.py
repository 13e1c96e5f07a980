"""Worker processes: scans come back, faults stay with their sensor, a dead worker is replaced."""

from __future__ import annotations

import os
import select
import signal
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager

import numpy as np
import pytest

from emulator.errors import SceneError
from emulator.measuring.measuring import InPlace, Measures
from emulator.measuring.supervision import Workers
from emulator.process import time_limits
from protocols.scan import Scan, ScanPlan


def plan(sweep: int, beams: int = 3) -> ScanPlan:
    zeros = np.zeros(beams)
    return ScanPlan(0, sweep, 0, zeros, zeros, zeros)


def constant(metres: float) -> Callable[[ScanPlan], Scan]:
    def measure(wanted: ScanPlan) -> Scan:
        scan = Scan.empty(wanted)
        scan.range_m[:] = metres + wanted.sweep
        return scan

    return measure


def two_sensors() -> Mapping[str, Callable[[ScanPlan], Scan]]:
    def broken(wanted: ScanPlan) -> Scan:
        raise ValueError("no such beam")

    def deadly(wanted: ScanPlan) -> Scan:
        if wanted.sweep == 13:
            os._exit(9)
        return constant(0.0)(wanted)

    return {"a": constant(1.0), "b": constant(2.0), "broken": broken, "deadly": deadly}


@contextmanager
def workers(count: int = 1) -> Iterator[Workers]:
    with closing(Workers(two_sensors, ["a", "b", "broken", "deadly"], count)) as made:
        yield made


def gather(made: Workers, sensor: str, wanted: int) -> list[Scan]:
    scans: list[Scan] = []
    for _ in range(400):
        if len(scans := scans + made.collect(sensor)) >= wanted:
            return scans
        select.select(made.filenos(), [], [], 0.05)
        made.poll()
        made.check()
    raise AssertionError("no scan came")


@pytest.mark.parametrize("count", [1, 2, 8])
def test_scans_come_back_in_the_order_of_their_plans(count: int) -> None:
    with workers(count) as made:
        for sweep in range(5):
            made.request("a", plan(sweep))
            made.request("b", plan(sweep))
        assert [float(scan.range_m[0, 0]) for scan in gather(made, "a", 5)] == [1.0, 2.0, 3.0, 4.0, 5.0]
        assert [float(scan.range_m[0, 0]) for scan in gather(made, "b", 5)] == [2.0, 3.0, 4.0, 5.0, 6.0]


def test_plans_larger_than_a_pipe_do_not_block_the_sender() -> None:
    with workers() as made:
        for sweep in range(6):
            made.request("a", plan(sweep, beams=20_000))
        assert len(gather(made, "a", 6)) == 6


def test_a_scan_that_cannot_be_measured_is_named_and_comes_back_empty() -> None:
    with workers() as made:
        made.request("broken", plan(4))
        made.request("a", plan(1))
        (scan,) = gather(made, "broken", 1)
        assert np.isnan(scan.range_m).all()
        assert made.failures == ["broken: sweep 4: ValueError: no such beam"]
        assert len(gather(made, "a", 1)) == 1


def test_a_worker_that_dies_is_started_again_and_given_what_it_owed() -> None:
    with workers() as made:
        made.request("deadly", plan(13))
        made.request("deadly", plan(14))
        made.request("a", plan(1))
        given_up, good = gather(made, "deadly", 2)
        assert np.isnan(given_up.range_m).all()
        assert float(good.range_m[0, 0]) == 14.0
        assert len(gather(made, "a", 1)) == 1
        assert made.failures == [
            "deadly: sweep 13: terminated its measuring process twice",
        ]
        why = "ended with exit code 9 while it measured deadly, sweep 13"
        assert made.incidents == [
            ("worker replaced", "worker 0", f"{why}; a new one is started at once"),
            ("worker replaced", "worker 0", f"{why}; a new one is started in 0.25 s"),
        ]


def test_a_scene_that_cannot_be_built_is_told_before_the_run_begins() -> None:
    def refuse() -> Mapping[str, Callable[[ScanPlan], Scan]]:
        raise SceneError("wall.obj: triangle 7 is not finite")

    with pytest.raises(SceneError, match="triangle 7 is not finite"):
        Workers(refuse, ["a"], 1)


def test_a_worker_holds_none_of_the_senders_descriptors() -> None:
    read_end, write_end = os.pipe()
    os.set_inheritable(write_end, True)
    with workers(2) as made:
        os.close(write_end)
        made.request("a", plan(0))
        gather(made, "a", 1)
        assert select.select([read_end], [], [], 5.0)[0], "a worker keeps the other end of a pipe open"
        assert os.read(read_end, 1) == b""
    os.close(read_end)


class Doubtful:
    """Measures outside the range of a law; once it has measured, of two."""

    def __init__(self) -> None:
        self.warnings: tuple[str, ...] = ("fog: too thin",)

    def __call__(self, wanted: ScanPlan) -> Scan:
        self.warnings = ("fog: too thin", "too deep")
        return Scan.empty(wanted)


def doubtful() -> Measures:
    return Measures({"a": Doubtful()}, ["a mesh is odd"])


def test_warnings_of_worker_processes_come_out_once() -> None:
    with closing(Workers(doubtful, ["a"], 1)) as made:
        assert made.warnings == ["a mesh is odd", "a: fog: too thin"]
        for sweep in range(3):
            made.request("a", plan(sweep))
        assert len(gather(made, "a", 3)) == 3
        assert made.warnings == ["a mesh is odd", "a: fog: too thin", "a: too deep"]


def test_warnings_of_measuring_in_place_come_out_once() -> None:
    made = InPlace(doubtful())
    assert made.warnings == ["a mesh is odd", "a: fog: too thin"]
    for sweep in range(3):
        made.request("a", plan(sweep))
    assert made.warnings == ["a mesh is odd", "a: fog: too thin", "a: too deep"]


def test_a_process_that_was_made_to_end_leaves_no_descriptor_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time_limits, "SWEEP_NS", time_limits.SECOND_NS // 5)
    with workers() as made:
        made.request("a", plan(0))
        gather(made, "a", 1)
        before = len(os.listdir("/proc/self/fd"))
        os.kill(int(str(made.rows()[0]["pid"])), signal.SIGSTOP)
        made.request("a", plan(1))
        gather(made, "a", 1)
        assert [kind for kind, _, _ in made.incidents] == ["worker replaced"]
        for _ in range(400):
            made.check()
            if len(os.listdir("/proc/self/fd")) == before:
                return
            select.select([], [], [], 0.005)
        raise AssertionError("left open")
