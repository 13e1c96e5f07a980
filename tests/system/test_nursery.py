"""What the nursery starts is what `python -m emulator` starts."""

from __future__ import annotations

import signal
import subprocess
from pathlib import Path

from tests.system.conftest import TIME_LIMIT_S, pytest_xdist_make_scheduler
from tests.system.nursery import Forked, begun, ran


def test_a_forked_process_has_its_own_folder_streams_and_end(tmp_path: Path) -> None:
    done = ran("check", "nothing.yaml", cwd=tmp_path)
    assert done.returncode == 2
    assert "nothing.yaml" in done.stderr
    assert done.stdout == ""
    (tmp_path / "here.yaml").write_text("schema: 1\n", encoding="utf-8")
    done = ran("check", "here.yaml", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("here.yaml: ok")


def test_its_signals_are_its_own(tmp_path: Path) -> None:
    for number, code in ((signal.SIGTERM, 0), (signal.SIGINT, 0), (signal.SIGKILL, -9)):
        with begun("run", "flat_wall", cwd=tmp_path, stdin=subprocess.DEVNULL) as running:
            assert isinstance(running, Forked)
            assert running.stdout is not None
            assert running.stdout.readline().startswith("ready")
            assert (tmp_path / "lms291").is_symlink()
            assert running.poll() is None
            running.send_signal(number)
            assert running.wait(TIME_LIMIT_S) == code
        assert (tmp_path / "lms291").is_symlink() == (number == signal.SIGKILL)


class Distributed:
    """What a scheduler asks of pytest's configuration."""

    def getvalue(self, name: str) -> object:
        return {"dist": "loadgroup", "tx": ["popen", "popen"]}[name]


def test_all_tests_of_a_file_go_to_one_worker() -> None:
    """A fixture of a file is made once: a daemon, a browser, the drivers."""
    scheduler = pytest_xdist_make_scheduler(Distributed(), None)
    scope = scheduler._split_scope
    assert scope("tests/system/test_look.py::test_a[b::c]") == scope("tests/system/test_look.py::test_d")
    assert scope("tests/system/test_soak.py::test_a") != scope("tests/system/test_soak.py::test_b")
