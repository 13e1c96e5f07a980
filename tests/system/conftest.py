"""What the system tests share: the daemon as a process, its priority, and patience with a busy machine.

Nothing here waits for a time to pass: waits are for something to happen, with a limit that only a hang exceeds.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import subprocess
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from emulator.process.waiting import realtime_allowed
from tests.system import loops_build, mrpt_build
from tests.system.nursery import NURSERY, begun

TIME_LIMIT_S = 60.0
"Limit of a wait: a machine that is busy otherwise takes seconds for what takes milliseconds."
STANDING = ("--set", "actors.0.motion.velocity_m_s=[0, 0, 0]", "--set", "actors.1.motion.at_m=[55.8, 0, 0]")
"Of the scenario bumper: the grey car stays 50 m ahead, whenever a host comes."
LONGEST_TEST_S = 300
LONGEST = ["test_mrpt.py", "test_brake.py", "test_campaign.py", "test_a_scenario_stands", "test_page_and_daemon",
           "test_view.py", "_soak_of_", "_run[record]", "test_commands_that_talk", "_run[demo]", "_run[step_out]",
           "_run[campaign]", "_soak_on_", "test_fmu.py", "test_faults.py", "test_compiled.py", "test_lost_links.py",
           "test_wheel.py", "test_process_faults.py", "test_object_lists.py", "test_look.py", "test_recording_run.py",
           "test_run.py", "test_virtual_hosts.py", "test_replay_decoded.py",
           "test_docs_commands.py", "test_soak.py"]  # fmt: skip
"Parts of names of tests, by how long those tests or their file take; a worker has two of them at a time."
APART = ("test_docs_commands.py", "test_soak.py", "test_brake.py", "test_mrpt_meets_a_bad_day", "test_page_and_daemon")
"Parts of names of tests that share nothing with the others of their file: any worker has them (--dist loadgroup)."
NICENESS = {"tests": -5, "daemons": -15}
"Whatever else the machine does, where this user may say so: what the tests judge is no other program's load."

with contextlib.suppress(PermissionError):
    os.setpriority(os.PRIO_PROCESS, 0, NICENESS["tests"])


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Longest first: no core waits for the other at the end. A limit for tests that have none of their own."""
    ours = [item for item in items if Path(__file__).parent in item.path.parents]
    for item in ours:
        if item.get_closest_marker("timeout") is None:
            item.add_marker(pytest.mark.timeout(LONGEST_TEST_S))
    if len(ours) == len(items):
        items.sort(key=lambda item: next((k for k, part in enumerate(LONGEST) if part in item.nodeid), len(LONGEST)))


def group_of(nodeid: str) -> str:
    """What goes to one worker: of most files, all tests."""
    return nodeid if any(part in nodeid for part in APART) else nodeid.partition("::")[0]


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """By `group_of` with `--dist loadgroup`: xdist 3.8 changes names of tests for its groups, which pytest 9 forbids.

    It says nothing then: each worker had every file's daemon, browser or drivers for itself.
    """
    from xdist.scheduler import LoadScopeScheduling

    class ByGroup(LoadScopeScheduling):  # type: ignore[misc]
        def _split_scope(self, nodeid: str) -> str:
            return group_of(nodeid)

    return ByGroup(config, log) if config.getvalue("dist") == "loadgroup" else None


def favoured() -> list[str]:
    """Words before a command that has to keep its time."""
    words = ["nice", "-n", str(NICENESS["daemons"] - NICENESS["tests"])]
    return [] if subprocess.run([*words, "true"], capture_output=True, check=False).stderr else words


@cache
def prompt() -> tuple[list[str], list[str]]:
    """Words before a driver that waits 50 ms for some replies, and of the daemon that it talks to.

    Both go before other programs, where this user may say so.
    """
    realtime = shutil.which("chrt") is not None and not realtime_allowed()
    return (["chrt", "-r", "1"], ["--realtime"]) if realtime else (favoured(), [])


@pytest.fixture(scope="session", autouse=True)
def _nursery() -> Iterator[None]:
    """Ends with the tests."""
    yield
    NURSERY.close()


@pytest.fixture(scope="session")
def mrpt(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of MRPT's drivers, built."""
    return mrpt_build.built(tmp_path_factory.getbasetemp().parent)


@pytest.fixture(scope="session")
def loops() -> None:
    """Compiled, for what has to end in its time with them."""
    loops_build.built()


@dataclass
class RunningDaemon:
    """`lidaremu run ... --json` as a child process."""

    process: subprocess.Popen[str]
    ready: dict[str, Any]
    end: dict[str, Any] = field(default_factory=dict)
    errors: str = ""

    def link(self, sensor: str, index: int = 0) -> str:
        """URL of one of a sensor's links."""
        return next(item for item in self.ready["sensors"] if item["id"] == sensor)["links"][index]

    @property
    def control(self) -> Path:
        """The control socket."""
        return Path(self.ready["control"].removeprefix("unix:"))

    def path(self, sensor: str, index: int = 0) -> str:
        """Path of a pty link."""
        return self.link(sensor, index).partition(":")[2]

    def stop(self, number: int = signal.SIGTERM) -> int:
        """End it with a signal; the exit code. What it printed last is in `end`."""
        if self.process.poll() is None:
            self.process.send_signal(number)
        out, self.errors = self.process.communicate(timeout=TIME_LIMIT_S)
        for line in out.splitlines():
            event = json.loads(line)
            if event["event"] == "stopped":
                self.end = {item["id"]: item for item in event["sensors"]}
        return self.process.returncode


@contextlib.contextmanager
def daemons(folder: Path) -> Iterator[Callable[..., RunningDaemon]]:
    """Starts daemons in a folder; all of them are ended with it."""
    started: list[RunningDaemon] = []

    def start(*arguments: str, forked: bool = True) -> RunningDaemon:
        nicer = NICENESS["daemons"] - NICENESS["tests"]
        process = begun("run", *arguments, "--json", cwd=folder, stdin=None, nicer=nicer, forked=forked)
        assert process.stdout is not None
        first = process.stdout.readline()
        if not first:
            _, errors = process.communicate(timeout=TIME_LIMIT_S)
            raise AssertionError(f"the daemon did not start: {errors}")
        running = RunningDaemon(process, json.loads(first))
        started.append(running)
        return running

    try:
        yield start
    finally:
        for running in started:
            if running.process.poll() is None:
                running.process.kill()
                running.process.communicate()
            for pipe in (running.process.stdout, running.process.stderr):
                if pipe is not None:
                    pipe.close()


@pytest.fixture
def daemon(tmp_path: Path) -> Iterator[Callable[..., RunningDaemon]]:
    """Starts daemons in `tmp_path`; all of them are ended after the test."""
    with daemons(tmp_path) as start:
        yield start
