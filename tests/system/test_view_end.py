"""`lidaremu view SCENARIO` and its own daemon: each notices the end of the other, and nothing is left."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.system.conftest import TIME_LIMIT_S
from tests.system.nursery import begun

if os.environ.get("CI") != "true":
    pytest.importorskip("viser", reason="extra `view` is not installed")


@pytest.fixture
def view(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """The command, showing."""
    (tmp_path / "temporary").mkdir()
    more = {"TMPDIR": str(tmp_path / "temporary")}
    process = begun("view", "flat_wall", "--no-browser", "--json", cwd=tmp_path, more=more)
    assert process.stdout is not None
    assert json.loads(process.stdout.readline())["event"] == "ready"
    yield process
    if process.poll() is None:
        process.kill()
    process.communicate(timeout=TIME_LIMIT_S)


def daemon_of(view: subprocess.Popen[str]) -> int:
    """The daemon's number: the child that has the option which only we give."""
    for folder in Path("/proc").iterdir():
        if folder.name.isdecimal():
            try:
                words = (folder / "cmdline").read_bytes().split(b"\0")
            except OSError:
                continue
            if any(word.startswith(b"--own-folder=") and f"-own-{view.pid}-".encode() in word for word in words):
                return int(folder.name)
    raise AssertionError("no daemon")


def until(what: Callable[[], object]) -> None:
    end = time.monotonic() + TIME_LIMIT_S
    while not what():
        assert time.monotonic() < end
        time.sleep(0.02)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGHUP])
def test_with_the_page_its_daemon_and_its_folder_go(
    number: signal.Signals, view: subprocess.Popen[str], tmp_path: Path
) -> None:
    daemon = Path(f"/proc/{daemon_of(view)}")
    (folder,) = (tmp_path / "temporary").glob("lidaremu-own-*")
    assert list(folder.iterdir())
    view.send_signal(number)
    view.wait(TIME_LIMIT_S)
    until(lambda: not daemon.exists())
    until(lambda: not folder.exists())
    assert view.returncode == (-number if number == signal.SIGKILL else 0)


def test_the_end_of_the_daemon_is_told_and_the_page_stays(view: subprocess.Popen[str], tmp_path: Path) -> None:
    os.kill(daemon_of(view), signal.SIGKILL)
    assert view.stderr is not None
    until(lambda: "the daemon was ended by signal 9; the page shows the last state" in view.stderr.readline())
    assert view.poll() is None
    view.terminate()
    assert view.wait(TIME_LIMIT_S) == 3
    assert not list((tmp_path / "temporary").glob("lidaremu-own-*"))
