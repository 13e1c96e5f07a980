"""What the system tests share: the daemon as a process, and hosts that talk to it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

START_S = 30.0


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

    def path(self, sensor: str, index: int = 0) -> str:
        """Path of a pty link."""
        return self.link(sensor, index).partition(":")[2]

    def stop(self, number: int = signal.SIGTERM) -> int:
        """End it with a signal; the exit code. What it printed last is in `end`."""
        if self.process.poll() is None:
            self.process.send_signal(number)
        out, self.errors = self.process.communicate(timeout=15.0)
        for line in out.splitlines():
            event = json.loads(line)
            if event["event"] == "stopped":
                self.end = {item["id"]: item for item in event["sensors"]}
        return self.process.returncode


@pytest.fixture
def daemon(tmp_path: Path) -> Iterator[Callable[..., RunningDaemon]]:
    """Starts daemons in `tmp_path`; all of them are ended after the test."""
    started: list[RunningDaemon] = []

    def start(*arguments: str) -> RunningDaemon:
        process = subprocess.Popen(
            [sys.executable, "-m", "emulator", "run", *arguments, "--json"],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            cwd=tmp_path,
            env=dict(os.environ) | {"PYTHONPATH": str(Path(__file__).resolve().parents[2])},
        )
        assert process.stdout is not None
        first = process.stdout.readline()
        if not first:
            _, errors = process.communicate(timeout=START_S)
            raise AssertionError(f"the daemon did not start: {errors}")
        running = RunningDaemon(process, json.loads(first))
        started.append(running)
        return running

    yield start
    for running in started:
        if running.process.poll() is None:
            running.process.kill()
            running.process.communicate()
        for pipe in (running.process.stdout, running.process.stderr):
            if pipe is not None:
                pipe.close()
