"""The table of process faults, and its rows in virtual time: real measuring processes, no wall clock."""

from __future__ import annotations

import errno
import os
import re
import signal
from collections.abc import Mapping
from pathlib import Path

import pytest

from emulator.endurance.process_faults import PROCESS_FAULTS, drawn, table
from emulator.errors import SceneError
from emulator.judging.trial import Trial
from emulator.measuring.measuring import Measure, Measures
from emulator.process import time_limits
from emulator.process.incidents import KINDS
from emulator.recording.folder import RecordingFile
from emulator.runtime import assembly
from emulator.scenario import scenario
from emulator.scenario.scenario import Scenario
from protocols.scan import Scan, ScanPlan

ROOT = Path(__file__).resolve().parents[2]
CASE = """\
schema: 1
duration_s: 2
world:
  - {box: {size_m: [0.3, 50, 4]}, at_m: [10, 0, 0], material: concrete}
sensors:
  - {id: front, model: sick-lms291-s05, device: {delays: fast, start: running}, physics: {rule: axis, sub_beams: 1}}
"""


@pytest.fixture
def case() -> Scenario:
    return scenario.loads(CASE, Path("case.yaml"))


def digest(case: Scenario, workers: int = 0) -> tuple[str, list[object], int]:
    trial = Trial(case, workers)
    try:
        verdict = trial.finish()
    finally:
        trial.close()
    assert verdict.sensors[0]["scans_sent"] > 30
    return verdict.sha256, [row["kind"] for row in verdict.incidents], verdict.exit_code


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_worker_that_is_killed_or_stopped_changes_no_byte_of_virtual_time(
    case: Scenario, number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected, kinds, _ = digest(case)
    assert kinds == []
    build = assembly.build_measures
    monkeypatch.setattr(time_limits, "SWEEP_NS", time_limits.SECOND_NS // 2)

    def breaking(wanted: Scenario) -> Mapping[str, Measure]:
        measure = build(wanted)["front"]
        calls = [0]

        def once(plan: ScanPlan, *more: object) -> Scan:
            calls[0] += 1
            if calls[0] == 10 and not (tmp_path / "done").exists():
                (tmp_path / "done").touch()
                os.kill(os.getpid(), number)
            return measure(plan, *more)

        return Measures({"front": once})

    monkeypatch.setattr(assembly, "build_measures", breaking)
    got, kinds, code = digest(case, workers=1)
    assert (tmp_path / "done").exists()
    assert got == expected
    assert kinds == ["worker replaced"]
    assert code == 0


def test_virtual_time_does_not_stand_for_ever_for_a_worker(case: Scenario, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time_limits, "FIRST_PAUSE_NS", 1)
    trial = Trial(case, 1)
    try:
        trial.run.advance(200_000_000)

        def none_left(_loops: bool | None) -> None:
            raise OSError(errno.EAGAIN, "Resource temporarily unavailable")

        trial._workers._launch = none_left  # type: ignore[union-attr, assignment]
        os.kill(int(str(trial._workers.rows()[0]["pid"])), signal.SIGKILL)  # type: ignore[union-attr]
        with pytest.raises(SceneError, match=r"worker 0: 5 processes in a row: .* Resource temporarily unavailable"):
            trial.run.advance(2_000_000_000)
    finally:
        trial.close()


def test_a_run_on_a_virtual_clock_ends_when_no_worker_can_be_started(
    case: Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(time_limits, "FIRST_PAUSE_NS", 1)
    looped = scenario.loads(CASE.replace("physics:", 'links: ["loop:front"], physics:'), Path("case.yaml"))
    daemon, instruments = assembly.start_virtual(looped, None, 1)
    reported: list[str] = []
    daemon.on_failure = reported.append
    try:
        daemon.power_on()

        def none_left(_loops: bool | None) -> None:
            raise OSError(errno.ENOMEM, "Cannot allocate memory")

        workers = daemon._workers
        assert workers is not None
        workers._launch = none_left  # type: ignore[assignment]
        os.kill(int(str(workers.rows()[0]["pid"])), signal.SIGKILL)
        instruments[0].links[0].connect().write(b"\x02\x00\x02\x00\x20\x24\x34\x08", 0)  # type: ignore[attr-defined]
        daemon.advance(2_000_000_000)
        assert daemon._stop
        assert daemon.incidents.totals() == {"worker replaced": 2, "worker lost": 1}
        assert daemon.incidents.exit_code == 5
        assert "Cannot allocate memory" in reported[-1]
    finally:
        daemon.close()


def test_a_full_disk_ends_the_recording_and_not_the_run(
    case: Scenario, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    room = [20_000]
    write = RecordingFile.write

    def full(self: RecordingFile, data: bytes) -> None:
        room[0] -= len(data)
        if room[0] < 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        write(self, data)

    expected, _, _ = digest(case)
    monkeypatch.setattr(RecordingFile, "write", full)
    trial = Trial(case, record=tmp_path / "kept")
    try:
        found = trial.finish()
    finally:
        trial.close()
    assert found.sha256 == expected
    assert [row["kind"] for row in found.incidents] == ["recording ended"]
    assert found.exit_code == 4


# the table


@pytest.mark.parametrize("row", PROCESS_FAULTS, ids=lambda row: row.name)
def test_every_row_is_held_by_a_test_and_names_known_incidents(row: object) -> None:
    path, _, name = row.held_by.partition("::")  # type: ignore[attr-defined]
    assert re.search(rf"^def {name}\(", (ROOT / path).read_text(), re.MULTILINE), row
    assert {kind.strip("()") for kind in row.incidents} <= set(KINDS)  # type: ignore[attr-defined]
    codes = {KINDS[kind].exit_code for kind in row.incidents if not kind.startswith("(")}  # type: ignore[attr-defined]
    assert all(str(code) in row.exit_code for code in codes - {0})  # type: ignore[attr-defined]


def test_the_page_shows_the_table() -> None:
    page = (ROOT / "docs" / "process_faults.md").read_text()
    assert "\n".join(table()) in page, "python -m emulator.endurance.process_faults"


def test_the_page_states_the_times() -> None:
    page = (ROOT / "docs" / "process_faults.md").read_text()
    from emulator.runtime import liveness

    for seconds in (
        time_limits.SWEEP_NS, time_limits.IDLE_NS, time_limits.IDLE_BUILD_NS,
        time_limits.FIRST_SWEEP_NS, time_limits.LONGEST_PAUSE_NS,
        time_limits.STALLED_NS, liveness.SILENT_NS,
    ):  # fmt: skip
        assert f"{seconds / 1e9:g} s" in page
    assert f"{liveness.SILENT_SCANS} scan times" in page


def test_the_soak_draws_kills_and_stops() -> None:
    assert {row.drawn.number for row in drawn() if row.drawn is not None} == {signal.SIGKILL, signal.SIGSTOP}
