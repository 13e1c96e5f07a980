"""A daemon on a leash: it ends with the standard input, takes its folder along, and what it says is read."""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from emulator.commands.cli import main
from emulator.runtime import own_daemon
from emulator.runtime.own_daemon import DaemonError, Leash, OwnDaemon, clear_up, ending_signals, leashed

FOLDER = "lidaremu-own-1-abc"


@pytest.fixture
def pipe() -> Iterator[tuple[int, list[int]]]:
    reader, writer = os.pipe()
    ends = [writer]
    yield reader, ends
    os.close(reader)
    for end in ends:
        os.close(end)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    made = tmp_path / FOLDER
    made.mkdir()
    (made / "front").symlink_to("/dev/null")
    return made


def test_the_end_of_the_input_stops_the_run(pipe: tuple[int, list[int]], folder: Path) -> None:
    reader, ends = pipe
    done, asked = threading.Event(), []
    leash = Leash(reader, folder)
    os.write(ends[0], b"words are no end")
    leash.watch(lambda: asked.append("stop"), lambda action: done.set(), lambda: asked.append("kill"))
    assert asked == []
    os.close(ends.pop())
    assert done.wait(20.0)
    leash.close()
    assert asked == ["stop"]
    assert folder.is_dir()


def test_a_run_that_does_not_stop_is_killed_and_its_folder_removed(pipe: tuple[int, list[int]], folder: Path) -> None:
    reader, ends = pipe
    killed = threading.Event()
    Leash(reader, folder, time_limit_s=0.0).watch(lambda: None, lambda action: None, killed.set)
    os.close(ends.pop())
    assert killed.wait(20.0)
    assert not folder.exists()


@pytest.mark.parametrize("over", [True, False])
def test_at_its_end_a_run_removes_the_folder_if_nobody_is_left_who_would(
    over: bool, pipe: tuple[int, list[int]], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reader, ends = pipe
    with open(os.dup(reader)) as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        with leashed(True, folder) as leash:
            assert leash is not None
            if over:
                os.close(ends.pop())
    assert folder.exists() is not over


def test_no_other_folder_is_removed(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    Leash(0, tmp_path / "mine").remove()
    assert (tmp_path / "mine").is_dir()


def test_without_the_option_the_input_is_not_touched() -> None:
    with leashed(False, None) as leash:
        assert leash is None


def test_the_input_is_not_shared_with_a_driver(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "crossing_car", "--until-eof", "--", "true"]) == 2
    assert "both read the standard input" in capsys.readouterr().err


def test_folders_of_the_dead_are_cleared_up_and_no_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    dead = subprocess.Popen(["true"])
    dead.wait()
    monkeypatch.setattr(own_daemon.tempfile, "gettempdir", lambda: str(tmp_path))
    names = [f"lidaremu-own-{dead.pid}-x", f"lidaremu-own-{os.getpid()}-x", "lidaremu-own-x-x", f"lidaremu-{dead.pid}"]
    for name in names:
        (tmp_path / name).mkdir()
    (tmp_path / f"lidaremu-own-{dead.pid}-y").symlink_to(tmp_path / names[3])
    clear_up()
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([*names[1:], f"lidaremu-own-{dead.pid}-y"])


class Ended:
    """A daemon that has said all that it will."""

    def __init__(self, words: str, code: int) -> None:
        self.stdout, self.stdin, self.returncode = io.StringIO(words), None, code

    def wait(self, time_limit_s: float | None = None) -> int:
        return self.returncode

    poll = wait


def test_all_that_it_says_is_read_and_its_end_is_told_in_words() -> None:
    heard: list[Any] = []
    rows = [{"event": "incident", "text": "x"}, {"event": "stopped", "sensors": []}]
    process: Any = Ended("".join(json.dumps(row) + "\n" for row in rows) + '{"event": "cu', -9)
    daemon = OwnDaemon(process, {"control": "unix:/x"}, heard.append)
    daemon.stop()
    assert (heard, daemon.last) == ([rows[0]], rows[1])
    assert (daemon.code(), daemon.how, str(daemon.control)) == (-9, "the daemon was ended by signal 9", "/x")
    process.returncode = 4
    assert daemon.how == "the daemon ended with exit code 4"


def test_a_daemon_that_does_not_start_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(own_daemon.tempfile, "tempdir", str(tmp_path))
    with pytest.raises(DaemonError, match="did not start"):
        with own_daemon.own_daemon("no_such_scenario", [], lambda folder: []):
            raise AssertionError("it did")
    assert list(tmp_path.iterdir()) == []


def test_a_closed_terminal_ends_in_order_unless_it_is_to_be_outlived() -> None:
    assert signal.SIGHUP in ending_signals()
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        assert signal.SIGHUP not in ending_signals()
    finally:
        signal.signal(signal.SIGHUP, before)


class Slow(Ended):
    """It takes 45 s to end: a busy machine, or a recording."""

    ended = False
    killed = False

    def poll(self) -> int | None:  # type: ignore[override]
        return self.returncode if self.ended else None

    def terminate(self) -> None:
        pass

    def kill(self) -> None:
        self.killed = True

    def wait(self, time_limit_s: float | None = None) -> int:
        if time_limit_s is not None and time_limit_s < 45.0:
            raise subprocess.TimeoutExpired("run", time_limit_s)
        self.ended = True
        return self.returncode


def test_a_daemon_that_is_slow_to_end_is_not_killed_before_it_has_said_its_last_event() -> None:
    process: Any = Slow('{"event": "stopped"}\n', 0)
    daemon = OwnDaemon(process, {}, lambda row: None)
    daemon.stop()
    assert not process.killed
    assert daemon.last == {"event": "stopped"}
