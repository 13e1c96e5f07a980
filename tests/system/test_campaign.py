"""Campaigns outside one process: a Dask cluster that loses and gains workers, array tasks of a stand-in for Slurm."""

from __future__ import annotations

import json
import os
import signal
import socket
import stat
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from tests.system.conftest import TIME_LIMIT_S

CAMPAIGN = """scenario: flat_wall
set: {duration_s: 0.3}
factors:
  weather.fog.visibility_m: {range: [20, 400], steps: 8, scale: log}
  world[0].at_m[0]: {range: [4, 12], steps: 4}
design: grid
expect: [{that: min(front.points) > 250}]
quantities: {near: min(front.nearest_m)}
record: none
"""
CASES = 32
SBATCH = """#!/usr/bin/env python3
import os, re, subprocess, sys
text = open(sys.argv[1]).read()
tasks = int(re.search(r"#SBATCH --array=1-(\\d+)", text)[1])
assert text.startswith("#!/bin/bash\\n") and "#SBATCH --requeue" in text
running = [subprocess.Popen(["bash", sys.argv[1]], env=os.environ | {"SLURM_ARRAY_TASK_ID": str(1 + n)})
           for n in range(tasks)]
running[0].kill()  # a node is lost ...
running[0].wait()
running[0] = subprocess.Popen(["bash", sys.argv[1]], env=os.environ | {"SLURM_ARRAY_TASK_ID": "1"})  # ... and requeued
print("Submitted batch job 4711")
sys.exit(max(one.wait() & 2 for one in running))
"""
"A stand-in: runs every task of the array at once; the first is killed and comes again, as Slurm does with --requeue."


def campaign(folder: Path, out: str, *words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "emulator", "campaign", "c.yaml", "--out", out, *words]
    return subprocess.run(
        command, cwd=folder, env=environment(), capture_output=True, text=True, timeout=4 * TIME_LIMIT_S, check=False
    )


def environment() -> dict[str, str]:
    root = str(Path(__file__).resolve().parents[2])
    return os.environ | {
        "PYTHONPATH": root,
        "LIDAREMU_COMPILED": "0",
        "DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT": "5s",
    }


def rows(folder: Path) -> dict[str, tuple[Any, ...]]:
    """Of every case in a campaign's folder what must not depend on where it was run."""
    found = {}
    for path in sorted((folder / "cases").rglob("*.json")):
        row = json.loads(path.read_text(encoding="utf-8"))
        found[row["name"]] = (row["verdict"], row["sha256"], row["quantities"], row["expect"])
    return found


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the campaign, which has been run there by processes of this machine."""
    folder = tmp_path_factory.mktemp("campaign")
    (folder / "c.yaml").write_text(CAMPAIGN, encoding="utf-8")
    done = campaign(folder, "here", "--jobs", "2", "--no-report", "--json")
    assert done.returncode == 1, done.stderr
    assert len(rows(folder / "here")) == CASES
    return folder


class Dask:
    """A scheduler and its workers, each a process."""

    def __init__(self, folder: Path) -> None:
        with closing(socket.socket()) as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.url, self.folder, self.started = f"tcp://127.0.0.1:{self.port}", folder, list[subprocess.Popen[bytes]]()

    def scheduler(self) -> subprocess.Popen[bytes]:
        return self.begin("scheduler", "--host", "127.0.0.1", "--port", str(self.port), "--no-dashboard")

    def worker(self) -> subprocess.Popen[bytes]:
        return self.begin("worker", self.url, "--nthreads", "1", "--no-dashboard", "--no-nanny", "--memory-limit", "0",
                          "--death-timeout", "60", "--local-directory", str(self.folder / "scratch"))  # fmt: skip

    def begin(self, what: str, *words: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", f"distributed.cli.dask_{what}", *words]
        with (self.folder / f"{what}-{len(self.started)}.log").open("wb") as log:
            made = subprocess.Popen(
                command, cwd=self.folder, env=environment(), stdout=log, stderr=log, start_new_session=True
            )
        self.started.append(made)
        return made

    def kill(self, process: subprocess.Popen[bytes]) -> None:
        """With the processes that a worker has for its cases: its machine is gone."""
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


@pytest.fixture
def dask(tmp_path: Path) -> Iterator[Dask]:
    made = Dask(tmp_path)
    yield made
    for process in made.started:
        if process.poll() is None:
            made.kill(process)


def until(what: Callable[[], object], why: str) -> None:
    end = time.monotonic() + 3 * TIME_LIMIT_S
    while not what():
        assert time.monotonic() < end, why
        time.sleep(0.02)


def test_a_cluster_that_loses_workers_and_its_scheduler_gives_the_same_rows(place: Path, dask: Dask) -> None:
    out = place / "dask"
    words = [sys.executable, "-m", "emulator", "campaign", "c.yaml", "--out", "dask", "--no-report", "--dask", dask.url]
    scheduler, first, second = dask.scheduler(), dask.worker(), dask.worker()
    running = subprocess.Popen(words, cwd=place, env=environment(), stderr=subprocess.PIPE, text=True)
    until(lambda: len(rows(out)) >= 3, "no case is done by the cluster")
    dask.kill(first)
    late = dask.worker()
    at = len(rows(out))
    until(lambda: len(rows(out)) >= at + 4, "no case is done after a worker was killed")
    dask.kill(scheduler)
    _, errors = running.communicate(timeout=3 * TIME_LIMIT_S)
    done = len(rows(out))
    assert (running.returncode, done < CASES) == (2, True), errors
    assert "the same command goes on from there" in errors
    for worker in (second, late):
        dask.kill(worker)

    dask.scheduler(), dask.worker()
    again = campaign(place, "dask", "--no-report", "--json", "--dask", dask.url)
    assert again.returncode == 1, again.stderr
    assert json.loads(again.stdout)["run"] <= CASES - done
    assert rows(out) == rows(place / "here")


def test_the_tasks_of_an_array_give_the_same_rows(place: Path, tmp_path: Path) -> None:
    written = campaign(place, "slurm", "--slurm", "3", "--jobs", "1")
    assert written.returncode == 0, written.stderr
    sbatch = tmp_path / "sbatch"
    sbatch.write_text(SBATCH, encoding="utf-8")
    sbatch.chmod(sbatch.stat().st_mode | stat.S_IXUSR)
    submitted = subprocess.run(
        [sbatch, place / "slurm" / "campaign.sbatch"], env=environment(), cwd=tmp_path, capture_output=True, text=True,
        timeout=4 * TIME_LIMIT_S, check=False,
    )  # fmt: skip
    assert submitted.returncode == 0, submitted.stderr
    assert rows(place / "slurm") == rows(place / "here")
    told = json.loads(campaign(place, "slurm", "--status", "--json").stdout)
    assert (told["planned"], told["done"]) == (CASES, CASES)


def test_a_driver_closes_the_loop_in_every_case(tmp_path: Path) -> None:
    examples = Path(__file__).resolve().parents[2] / "docs/examples"
    text = (examples / "campaign/braking.yaml").read_text(encoding="utf-8")
    for key, value in (
        ("{range: [10, 300], scale: log}", "{values: [15, 300]}"),
        ("{range: [0.1, 50]}", "{values: [0.1]}"),
        ("{range: [0.05, 0.9]}", "{values: [0.5]}"),
        ("{range: [7, 25]}", "{values: [14]}"),
        ("{sobol: 2048}", "grid"),
    ):
        assert key in text
        text = text.replace(key, value)
    (tmp_path / "c.yaml").write_text(text, encoding="utf-8")
    (tmp_path / "brake_target.yaml").write_bytes((examples / "campaign/brake_target.yaml").read_bytes())
    driver = f"{sys.executable} {examples / 'campaign/braking.py'}"
    done = campaign(tmp_path, "out", "--driver", driver, "--no-report", "--json")
    assert done.returncode == 1, done.stderr
    impacts = {row[0]: row[2] for row in rows(tmp_path / "out").values()}
    assert impacts["passed"]["impact_km_h"] == 0.0
    assert impacts["passed"]["braked_at_m"] > 25.0
    assert impacts["failed"]["impact_km_h"] > 20.0
