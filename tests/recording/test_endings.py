"""A recording that cannot go on: told once, counted, exit code 4; what is before can be read."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import threading
from collections.abc import Callable
from pathlib import Path

import can
import pytest

from emulator.instrument.observer import Payload
from emulator.judging.trial import Trial, Verdict, run_trial
from emulator.process.incidents import Incidents
from emulator.recording import writer, writing
from emulator.recording.reader import read_run
from emulator.recording.writer import Recorder, RecordingError
from emulator.recording.writing import IN_STEP, Manner, Writing
from emulator.scenario import scenario
from protocols.session import Address, CommandHandled, DropReason, dropped_scans

CASE = """\
schema: 1
duration_s: 0.8
world:
  - {plane: {size_m: [6, 60]}, at_m: [8, 0, 1], pitch_deg: -90, material: white_plaster}
sensors:
  - {id: front, model: sick-lms291-s05, mount: {at_m: [0, 0, 1]}, device: {resolution_deg: 1, field_deg: 100}}
  - {id: top, model: sick-ld-lrs1000, links: ["tcp:127.0.0.1:0"], device: {delays: fast, step_deg: 4.0}}
"""
ON_CAN = """\
schema: 1
duration_s: 0.8
world:
  - {plane: {size_m: [6, 60]}, at_m: [8, 0, 1], pitch_deg: -90, material: white_plaster}
sensors:
  - {id: front, model: sick-lms291-s05, mount: {at_m: [0, 0, 1]}, device: {resolution_deg: 1, field_deg: 100}}
  - {id: list, model: can-ars408, from: [front], links: ["can:virtual:bus"]}
"""


def trial_in(folder: Path, text: str = CASE) -> Trial:
    return Trial(scenario.loads(text, Path("case.yaml")), record=folder)


def judged(trial: Trial, meanwhile: Callable[[], object] = lambda: None) -> Verdict:
    """The verdict, with something done half way."""
    trial.run.advance(400_000_000)
    meanwhile()
    try:
        return trial.finish()
    finally:
        trial.close()


def ended(verdict: Verdict, why: str) -> None:
    """The recording ended early because of that, told once."""
    assert verdict.exit_code == 4
    rows = [row for row in verdict.incidents if row["kind"] == "recording ended"]
    assert len(rows) == 1
    assert why in str(rows[0]["text"])
    assert verdict.recording is not None
    assert verdict.recording["state"] == "ended"
    assert why in verdict.recording["why"]
    assert verdict.recording["at_s"] == rows[0]["at_s"]


@pytest.fixture
def small_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writer, "CHUNK_BYTES", 6_000)


@pytest.fixture(scope="module")
def digest() -> str:
    return run_trial(scenario.loads(CASE, Path("case.yaml"))).sha256


class Disk:
    """Takes so many bytes, at most 1000 in one go, and then none."""

    def __init__(self, room: int, error: int = errno.ENOSPC) -> None:
        self.room, self.error = room, error
        self._write = os.write

    def write(self, number: int, data: memoryview) -> int:
        if self.room <= 0:
            raise OSError(self.error, os.strerror(self.error))
        taken = self._write(number, data[: min(1000, self.room)])
        self.room -= taken
        return taken


def test_a_recording_that_goes_well_is_told_as_that(tmp_path: Path) -> None:
    verdict = judged(trial_in(tmp_path / "run"))
    assert (verdict.exit_code, verdict.incidents) == (0, ())
    size = sum(path.stat().st_size for path in (tmp_path / "run").iterdir())
    assert verdict.recording == {
        "folder": str(tmp_path / "run"),
        "state": "on",
        "why": None,
        "bytes": size,
        "at_s": None,
    }
    assert judged(Trial(scenario.loads(CASE, Path("case.yaml")))).recording is None


@pytest.mark.usefixtures("small_chunks")
@pytest.mark.parametrize("error", [errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EFBIG])
@pytest.mark.parametrize("room", [9_000, 25_500, 31_234])
def test_a_full_disk_ends_the_recording_and_not_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, digest: str, room: int, error: int
) -> None:
    trial = trial_in(tmp_path / "run")
    monkeypatch.setattr("emulator.recording.folder.os.write", Disk(room, error).write)
    verdict = judged(trial)
    ended(verdict, os.strerror(error))
    assert verdict.sha256 == digest
    run = read_run(tmp_path / "run")
    assert run.cut == "the file ends within a record"
    data, at = (tmp_path / "run" / "run.mcap").read_bytes(), 8
    while at < len(data):
        at += 9 + int.from_bytes(data[at + 1 : at + 9], "little")
    assert at == len(data)  # the piece that was broken off is taken away
    assert sum(len(wire.payloads) for wire in run.sent.values()) > room / 2_000
    assert verdict.recording is not None
    at_ns = round(verdict.recording["at_s"] * 1e9)
    last_ns = max(one.start_ns for wire in run.sent.values() for one in wire.payloads)
    assert at_ns - 400_000_000 < last_ns <= at_ns + 100_000_000
    assert (tmp_path / "run" / "top.pcapng").stat().st_size % 4 == 0


def test_a_disk_that_is_full_at_the_very_beginning_refuses_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("emulator.recording.folder.os.write", Disk(0).write)
    with pytest.raises(RecordingError, match="run: cannot record there: No space left on device"):
        trial_in(tmp_path / "run")
    assert list((tmp_path / "run").iterdir()) == []


@pytest.mark.usefixtures("small_chunks")
@pytest.mark.parametrize(
    ("act", "why"),
    [
        (shutil.rmtree, "run.mcap was removed"),
        (lambda folder: (folder / "top.pcapng").unlink(), "top.pcapng was removed"),
        (lambda folder: (folder / "scenario.yaml").replace(folder / "run.mcap"), "run.mcap was removed"),
        (lambda folder: os.truncate(folder / "run.mcap", 5_000), "run.mcap was cut: "),
    ],
)
def test_files_that_somebody_takes_away_end_the_recording(
    tmp_path: Path, digest: str, act: Callable[[Path], object], why: str
) -> None:
    trial = trial_in(tmp_path / "run")
    verdict = judged(trial, lambda: act(tmp_path / "run"))
    ended(verdict, why)
    assert verdict.sha256 == digest
    assert verdict.recording is not None
    assert verdict.recording["at_s"] < 0.7  # when the next chunk was written, not only at the end


@pytest.mark.usefixtures("small_chunks")
def test_a_file_that_is_moved_is_told_though_another_takes_its_name(tmp_path: Path, digest: str) -> None:
    def swap() -> None:
        (tmp_path / "run" / "run.mcap").rename(tmp_path / "run" / "kept.mcap")
        (tmp_path / "run" / "run.mcap").write_bytes(b"of somebody else")

    trial = trial_in(tmp_path / "run")
    verdict = judged(trial, swap)
    kept = tmp_path / "run" / "kept.mcap"
    assert [(row["kind"], row["text"]) for row in verdict.incidents] == [
        ("recording moved", f"run.mcap was moved to {kept}; the recording goes on there")
    ]
    assert (verdict.exit_code, verdict.sha256) == (0, digest)
    assert (tmp_path / "run" / "run.mcap").read_bytes() == b"of somebody else"
    kept.replace(tmp_path / "run" / "run.mcap")
    assert read_run(tmp_path / "run").cut == ""


def test_of_files_that_are_gone_nobody_says_that_they_can_be_read(tmp_path: Path) -> None:
    trial = trial_in(tmp_path / "run")
    verdict = judged(trial, lambda: shutil.rmtree(tmp_path / "run"))
    assert "can be read" not in str(verdict.incidents)


def test_scans_that_are_measured_too_late_are_recorded_as_events(tmp_path: Path, digest: str) -> None:
    trial = trial_in(tmp_path / "run")
    recorder = trial.recorder
    assert recorder is not None
    (late,) = dropped_scans(400_000_000, DropReason.LATE, range(30, 33), address=Address(0, 1))
    verdict = judged(trial, lambda: recorder.event("front", late))
    assert (verdict.exit_code, verdict.incidents, verdict.sha256) == (0, (), digest)
    rows = [event for _, _, event in read_run(tmp_path / "run").events]
    assert [row["sweeps"] for row in rows if row.get("reason") == "measured too late"] == [[30, 33, 1]]


def test_an_event_that_cannot_be_written_ends_the_recording_and_not_the_run(tmp_path: Path, digest: str) -> None:
    trial = trial_in(tmp_path / "run")
    recorder = trial.recorder
    assert recorder is not None
    strange = CommandHandled(400_000_000, "20", object())  # type: ignore[arg-type]
    verdict = judged(trial, lambda: recorder.event("front", strange))
    ended(verdict, "TypeError: ")
    assert verdict.sha256 == digest


def test_files_taken_away_after_the_last_chunk_are_found_at_the_end(tmp_path: Path) -> None:
    trial = trial_in(tmp_path / "run")
    ended(judged(trial, lambda: shutil.rmtree(tmp_path / "run")), "the folder was removed")


@pytest.mark.usefixtures("small_chunks")
def test_a_folder_that_is_moved_takes_its_recording_along(tmp_path: Path) -> None:
    trial = trial_in(tmp_path / "run")
    verdict = judged(trial, lambda: (tmp_path / "run").rename(tmp_path / "kept"))
    assert verdict.exit_code == 0
    assert [row["kind"] for row in verdict.incidents] == ["recording moved"]
    assert verdict.recording is not None
    assert verdict.recording["folder"] == str(tmp_path / "kept")
    run = read_run(tmp_path / "kept")
    assert run.cut == ""
    assert {"event", "kind", "at_s", "on", "text"} == set(run.events[-1][2]) or any(
        row.get("kind") == "recording moved" for _, _, row in run.events
    )
    assert not (tmp_path / "run").exists()


def test_a_log_that_cannot_be_made_at_the_end_counts_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = judged(trial_in(tmp_path / "whole", ON_CAN))
    assert whole.exit_code == 0
    frames = [len(list(can.LogReader(tmp_path / "whole" / f"bus{ending}"))) for ending in (".log", ".blf", ".asc")]
    assert frames[0] == frames[1] == frames[2] > 3

    (tmp_path / "full").mkdir()
    trial = trial_in(tmp_path / "full", ON_CAN)
    os.symlink("/dev/full", tmp_path / "full" / "bus.blf")  # planted while the run goes on: not followed
    ended(judged(trial), "bus.blf: File exists")

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(can.BLFWriter, "on_message_received", full)
    ended(judged(trial_in(tmp_path / "late", ON_CAN)), "No space left on device")
    assert read_run(tmp_path / "late").cut == ""  # run.mcap has its end: only the copies are missing


def test_what_the_disk_tells_when_a_file_is_closed_counts_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(_: int) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr("emulator.recording.folder.os.fsync", broken)
    trial = Trial(scenario.loads(CASE, Path("case.yaml")))
    incidents = Incidents()
    recorder = Recorder(
        tmp_path / "run", trial.scenario, trial.instruments, incidents=incidents, manner=Manner(None, sync=True)
    )
    trial.finish()
    trial.close()
    recorder.close()
    assert incidents.exit_code == 4
    assert recorder.failure == "run.mcap: Input/output error"


def test_a_fault_of_our_own_ends_the_recording_and_not_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, digest: str
) -> None:
    def broken(*_: object) -> bytes:
        raise KeyError("of ours")

    trial = trial_in(tmp_path / "run")
    monkeypatch.setattr("emulator.recording.layout.encode_scan", broken)
    verdict = judged(trial)
    ended(verdict, "KeyError: 'of ours'")
    assert verdict.sha256 == digest


def test_nobody_who_listens_any_more_is_no_fault(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def gone(_: object) -> None:
        raise BrokenPipeError

    trial = Trial(scenario.loads(CASE, Path("case.yaml")))
    trial.incidents.listeners.append(gone)
    recorder = Recorder(
        tmp_path / "run", trial.scenario, trial.instruments, incidents=trial.incidents, manner=Manner(1000.0)
    )
    monkeypatch.setattr("emulator.recording.folder.os.write", Disk(2_000).write)
    trial.finish()
    trial.close()
    recorder.close()
    assert recorder.failure == "No space left on device"
    assert trial.incidents.exit_code == 4


def test_connections_without_end_are_recorded_without_their_numbers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(writer, "MOST_CHANNELS", 20)
    trial = trial_in(tmp_path / "run")
    assert trial.recorder is not None
    for number in range(1, 100):
        trial.recorder.payload(Payload("top", 0, number, bytes([number]), number, number, True))
    trial.close()
    found = read_run(tmp_path / "run").sent["top", 0].payloads
    assert [one.data[0] for one in found] == list(range(1, 100))
    assert [one.peer for one in found[:5]] == [1, 2, 3, 4, 5]
    assert {one.peer for one in found[20:]} == {0}


# ---------------------------------------------------------------- the thread


def test_pieces_are_written_in_their_order_and_all_of_them_at_the_end() -> None:
    found: list[int] = []
    pen = Writing(Manner(1000.0), lambda: None, lambda error: None)
    for number in range(1000):
        pen.put(lambda number=number: found.append(number), 1)  # type: ignore[misc]
    assert pen.close()
    assert found == list(range(1000))


def test_what_waits_is_handed_over_again_and_again_though_nothing_comes() -> None:
    ticked = threading.Semaphore(0)
    pen = Writing(Manner(0.001), ticked.release, lambda error: None)
    for _ in range(3):
        assert ticked.acquire(timeout=30.0)
    assert pen.close()


@pytest.mark.parametrize("waits", [True, False])
def test_a_disk_that_is_too_slow_holds_virtual_time_and_ends_a_recording_in_real_time(
    monkeypatch: pytest.MonkeyPatch, waits: bool
) -> None:
    monkeypatch.setattr(writing, "MOST_WAITING", 100)
    reported: list[str] = []
    may_go, begun = threading.Event(), threading.Event()

    def slow() -> None:
        begun.set()
        may_go.wait()

    pen = Writing(Manner(1000.0, waits), lambda: None, lambda error: reported.append(str(error)))
    for _ in range(3):
        pen.put(slow, 50)
    assert begun.wait(30.0)
    if waits:
        threading.Timer(0.0, may_go.set).start()
        pen.make_room()  # comes back when the disk has taken some
        assert reported == []
    else:
        pen.make_room()
        assert len(reported) == 1
        assert "the disk is too slow" in reported[0]
        may_go.set()
    assert pen.close()


def test_a_disk_that_stands_still_does_not_hold_the_end_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writing, "TIME_LIMIT_S", 0.01)
    reported: list[str] = []
    may_go = threading.Event()
    pen = Writing(Manner(1000.0), lambda: None, lambda error: reported.append(str(error)))
    pen.put(lambda: bool(may_go.wait()), 1)
    assert not pen.close()
    assert "the disk has taken nothing" in reported[0]
    may_go.set()


def test_trouble_in_the_thread_is_told_once_and_nothing_is_written_after_it() -> None:
    reported: list[Exception] = []
    done: list[int] = []
    pen = Writing(Manner(1000.0), lambda: None, reported.append)

    def broken() -> None:
        raise ValueError("of ours")

    for job in (lambda: done.append(1), broken, lambda: done.append(2), broken):
        pen.put(job, 1)
    assert pen.close()
    pen.do(lambda: done.append(3))
    assert done == [1]
    assert [str(error) for error in reported] == ["of ours"]


def test_a_recorder_with_a_thread_makes_the_same_messages(tmp_path: Path) -> None:
    trial = Trial(scenario.loads(CASE, Path("case.yaml")), record=tmp_path / "one")
    other = Recorder(tmp_path / "two", trial.scenario, trial.instruments, manner=Manner(0.001))
    trial.finish()
    other.close()
    trial.close()
    one, two = read_run(tmp_path / "one"), read_run(tmp_path / "two")
    assert (one.cut, two.cut) == ("", "")
    for key, wire in one.sent.items():
        assert [(item.start_ns, item.data) for item in wire.payloads] == [
            (item.start_ns, item.data) for item in two.sent[key].payloads
        ]
    assert (tmp_path / "one" / "top.pcapng").read_bytes() == (tmp_path / "two" / "top.pcapng").read_bytes()


# ---------------------------------------------------------------- refused before it begins


def listing(folder: Path) -> dict[str, tuple[object, ...]]:
    """Everything about the files in a folder."""
    return {
        path.name: (os.lstat(path).st_ino, os.lstat(path).st_mtime_ns, path.is_symlink() or path.read_bytes())
        for path in folder.iterdir()
    }


@pytest.mark.parametrize("name", ["run.mcap", "scenario.yaml", "top.pcapng", "TOP.PCAPNG", "Run.mcap", "front.pcapng"])
@pytest.mark.parametrize("kind", ["file", "link", "dangling", "folder"])
def test_a_folder_that_holds_what_would_be_written_is_refused_untouched(tmp_path: Path, name: str, kind: str) -> None:
    folder, victim = tmp_path / "run", tmp_path / "victim"
    folder.mkdir()
    victim.write_text("mine")
    if kind == "file":
        (folder / name).write_text("mine")
    elif kind == "folder":
        (folder / name).mkdir()
    else:
        (folder / name).symlink_to(victim if kind == "link" else tmp_path / "nowhere")
    before = sorted(path.name for path in folder.iterdir())
    with pytest.raises(RecordingError, match=f"run: holds a recording already: {name}; want another folder"):
        trial_in(folder)
    assert sorted(path.name for path in folder.iterdir()) == before
    assert victim.read_text() == "mine"
    assert not (tmp_path / "nowhere").exists()


@pytest.mark.parametrize("name", ["bus.log", "bus.blf", "bus.asc"])
def test_a_folder_that_holds_a_log_of_that_bus_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / name).write_text("mine")
    before = listing(tmp_path / "run")
    with pytest.raises(RecordingError, match=name):
        trial_in(tmp_path / "run", ON_CAN)
    assert listing(tmp_path / "run") == before


def test_a_finished_recording_is_not_written_over(tmp_path: Path) -> None:
    judged(trial_in(tmp_path / "run"))
    before = listing(tmp_path / "run")
    with pytest.raises(RecordingError, match="holds a recording already"):
        trial_in(tmp_path / "run")
    assert listing(tmp_path / "run") == before


@pytest.mark.parametrize("name", ["run.mcap", "scenario.yaml"])
def test_of_two_runs_that_begin_at_once_one_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    """The other run's file comes between the look and the making."""
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / name).write_text("theirs")
    before = listing(tmp_path / "run")
    with monkeypatch.context() as patch:
        patch.setattr("emulator.recording.folder.os.listdir", lambda _: [])
        with pytest.raises(RecordingError, match=r"run: "):
            trial_in(tmp_path / "run")
    assert listing(tmp_path / "run") == before


def test_a_folder_that_is_a_link_of_the_users_is_used_and_a_file_is_not(tmp_path: Path) -> None:
    (tmp_path / "big").mkdir()
    (tmp_path / "run").symlink_to(tmp_path / "big")
    judged(trial_in(tmp_path / "run"))
    assert read_run(tmp_path / "big").cut == ""
    (tmp_path / "file").write_text("mine")
    for wrong in (tmp_path / "file", tmp_path / "file" / "below", Path("/proc/nothing")):
        with pytest.raises(RecordingError, match="cannot record there"):
            trial_in(wrong)


def test_other_files_in_the_folder_are_left_alone(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "driver.log").write_text("mine")
    assert judged(trial_in(tmp_path / "run")).exit_code == 0
    assert (tmp_path / "run" / "driver.log").read_text() == "mine"


def test_no_descriptor_is_left_open(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def count() -> int:
        return len(os.listdir("/proc/self/fd"))

    judged(trial_in(tmp_path / "zero"))  # libraries that open something once
    before = count()
    judged(trial_in(tmp_path / "one"))
    with contextlib.suppress(RecordingError):
        trial_in(tmp_path / "one")
    trial = trial_in(tmp_path / "two")
    monkeypatch.setattr("emulator.recording.folder.os.write", Disk(2_000).write)
    judged(trial)
    assert count() == before
    assert IN_STEP.flush_s is None
