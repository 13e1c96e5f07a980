"""Recording and replaying as users do: a killed run, `--record`, `lidaremu replay` to a host; a disk that fails."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import serial

from emulator.recording.reader import read_run
from emulator.runtime.control import ask
from tests.system.conftest import TIME_LIMIT_S, RunningDaemon
from tests.system.hosts import LmsHost
from tests.system.nursery import begun, ran

ROOT = Path(__file__).resolve().parents[2]


def replay(folder: Path, *arguments: str, stdin: int | None = None) -> subprocess.Popen[str]:
    process = begun("replay", *arguments, "--json", cwd=folder, stdin=stdin)
    assert process.stdout is not None
    first = process.stdout.readline()
    assert first, process.communicate()[1]
    assert json.loads(first)["event"] == "ready"
    return process


@pytest.fixture
def recording(daemon: Callable[..., object], tmp_path: Path) -> Path:
    running = daemon("flat_wall", "--record", "rec")
    with LmsHost(running.path("front")) as host:
        host.set_baud(38_400)
        host.stream()
        for _ in range(20):  # over a second
            host.scan()
        running.process.kill()  # a run that is killed leaves everything but its last half second
        running.process.wait()
    (tmp_path / "lms291").unlink(missing_ok=True)
    return tmp_path / "rec"


def test_a_killed_runs_recording_is_replayed_with_its_gaps_and_its_bytes(recording: Path, tmp_path: Path) -> None:
    run = read_run(recording)
    assert run.cut
    sent = run.sent["front", 0].payloads
    assert sum(1 for one in sent if one.sweep is not None) >= 6
    assert {path.name for path in recording.iterdir()} == {"run.mcap", "scenario.yaml"}
    known = [one for one in sent if one.actual_ns is not None]
    assert len(known) > 0.8 * len(sent)  # of the last ones it is not written yet
    late = [(one.actual_ns or 0) - one.end_ns for one in known]
    assert min(late) >= 0
    assert len(set(late)) > 0.5 * len(late)
    asked = [one.start_ns for one in run.received["front", 0].payloads]
    replies = [one for one in known if one.data == b"\x06" and one.start_ns > asked[0]]
    behind = [(one.actual_ns or 0) - max(at for at in asked if at < one.start_ns) for one in replies]
    assert len(set(behind)) > 1
    process = replay(tmp_path, "rec", "--link", "front=pty:./again?speed=ignore")
    with serial.Serial(str(tmp_path / "again"), 38_400, timeout=0.2) as port:
        began, got = time.monotonic(), b""
        with contextlib.suppress(serial.SerialException):  # the terminal goes when all is sent
            while time.monotonic() - began < TIME_LIMIT_S:
                got += port.read(4096)
        elapsed = time.monotonic() - began
    out, errors = process.communicate()
    assert process.returncode == 0, errors
    assert len(got) > 3000
    assert b"".join(one.data for one in sent).startswith(got[:-2000])
    end = json.loads(out.splitlines()[-1])
    assert end["payloads"] == len(sent)
    assert end["gap_error_us"]["median"] < 20_000
    assert elapsed > 0.5 * (sent[-1].end_ns - sent[0].start_ns) * 1e-9


def test_a_replay_starts_a_driver_told_where_sensors_are_and_a_replay_is_looked_at(
    recording: Path, tmp_path: Path
) -> None:
    look = f"{sys.executable} -m emulator look pty:$LIDAREMU_FRONT --baud 38400 --scans 3 --json"
    words = ("rec", "--loop", "0", "--link", "front=pty:./again", "--json")
    done = ran("replay", *words, "--", "sh", "-c", f"{look} && exit 7", cwd=tmp_path)
    assert done.returncode == 1, done.stderr
    assert "ended with exit code 7" in done.stderr
    rows = [json.loads(line) for line in done.stderr.splitlines() if line.startswith("{")]
    assert len(rows) == 3


def test_a_replay_can_be_stepped_and_looped(recording: Path, tmp_path: Path) -> None:
    process = replay(tmp_path, "rec", "--link", "front=pty:./again?speed=ignore", "--stepped", stdin=subprocess.PIPE)
    with serial.Serial(str(tmp_path / "again"), 38_400, timeout=TIME_LIMIT_S) as port:
        time.sleep(0.2)
        assert port.in_waiting == 0
        assert process.stdin is not None
        for _ in range(3):
            process.stdin.write("\n")
            process.stdin.flush()
        assert port.read(1) == b"\x06"
        process.stdin.close()
        process.wait(timeout=TIME_LIMIT_S)
    for pipe in (process.stdout, process.stderr):
        assert pipe is not None
        pipe.close()
    fast = replay(tmp_path, "rec", "--link", "front=pty:./more", "--at-once", "--speed", "50", "--loop", "2")
    out, errors = fast.communicate(timeout=TIME_LIMIT_S)
    assert fast.returncode == 0, errors
    assert json.loads(out.splitlines()[-1])["rounds"] == 2


def test_a_recording_that_is_none_and_a_sensor_that_is_not_in_it_are_told(recording: Path, tmp_path: Path) -> None:
    for arguments, reported in ((["nothing"], "nothing"), (["rec", "--link", "rear=pty:./x"], "front")):
        done = ran("replay", *arguments, cwd=tmp_path)
        assert done.returncode == 2
        assert reported in done.stderr
        assert "Traceback" not in done.stderr


def test_a_folder_has_one_recording_and_its_removal_is_told_while_the_run_goes_on(
    daemon: Callable[..., RunningDaemon], tmp_path: Path
) -> None:
    running = daemon("flat_wall", "--record", "rec")
    status = ask(running.control, "status", {})
    assert isinstance(status, dict)
    assert status["recording"]["state"] == "on"
    before = (tmp_path / "rec" / "scenario.yaml").stat()
    second = ran("run", "flat_wall", "--link", "front=pty:./other", "--record", "rec", cwd=tmp_path)
    assert second.returncode == 2
    assert "rec: holds a recording already" in second.stderr
    assert (tmp_path / "rec" / "scenario.yaml").stat() == before

    shutil.rmtree(tmp_path / "rec")
    began = time.monotonic()
    while status["recording"]["state"] == "on":
        assert time.monotonic() - began < TIME_LIMIT_S
        time.sleep(0.05)
        status = ask(running.control, "status", {})
        assert isinstance(status, dict)
    assert status["recording"]["why"] == "run.mcap was removed"
    assert status["incident_totals"] == {"recording ended": 1}
    with LmsHost(running.path("front")) as host:  # the run goes on
        host.stream()
        assert len(host.scan()) == 361
    running.process.terminate()
    out, errors = running.process.communicate(timeout=TIME_LIMIT_S)
    assert running.process.returncode == 4, errors
    rows = [json.loads(line) for line in out.splitlines()]
    assert [row["kind"] for row in rows if row["event"] == "incident"] == ["recording ended"]
    assert rows[-1]["event"] == "stopped"
    assert rows[-1]["recording"] == status["recording"]
    assert not (tmp_path / "rec").exists()


def test_a_limit_on_files_ends_a_recording_of_a_test_with_exit_code_4(tmp_path: Path) -> None:
    words = f"{sys.executable} -m emulator test flat_wall --duration 2 --record runs --json"
    done = subprocess.run(
        ["sh", "-c", f"ulimit -f 300; exec {words}"],  # the kernel's own EFBIG
        cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(ROOT)}, capture_output=True, text=True, timeout=240,
    )  # fmt: skip
    assert done.returncode == 4, done.stderr
    row = json.loads(done.stdout)
    assert row["verdict"] == "passed"
    assert (row["recording"]["state"], row["recording"]["why"]) == ("ended", "File too large")
    assert [one["kind"] for one in row["incidents"]] == ["recording ended"]
    run = read_run(tmp_path / "runs" / "flat_wall")
    assert run.cut
    assert len(run.scans["front"]) > 10
