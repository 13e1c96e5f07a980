"""Hosts in processes of their own on virtual time: their pace changes no byte, and the end takes nothing from them."""

from __future__ import annotations

import json
import os
import select
import time
from collections.abc import Callable
from itertools import cycle
from pathlib import Path
from shutil import rmtree
from typing import Any

from emulator.recording.reader import read_run
from tests.system.conftest import TIME_LIMIT_S, RunningDaemon
from tests.system.hosts import LmsHost, telegram


def run_with_a_host(daemon: Callable[..., RunningDaemon], name: str, chunks: list[int], *arguments: str) -> Any:
    """The end of a run whose host reads in pieces of these sizes, and is away for a while now and then."""
    running = daemon(
        *("flat_wall", "--clock", "virtual", "--duration", "6", "--record", name),
        *("--link", f"front=pty:./{name}-line", *arguments),
    )
    with LmsHost(running.path("front")) as host:
        host.set_baud(38_400)
        host.stream()
        descriptor = host.port.fd
        for number, size in enumerate(cycle(chunks)):
            if number % 50 == 49:
                time.sleep(0.03)
            if not select.select([descriptor], [], [], TIME_LIMIT_S)[0]:
                break
            if not os.read(descriptor, size):  # the terminal has gone
                break
    out, errors = running.process.communicate(timeout=TIME_LIMIT_S)
    assert running.process.returncode == 0, errors
    end = json.loads(out.splitlines()[-1])
    assert end["sensors"][0]["links"][0]["bytes_lost"] == 0
    return end


MOST_RUNS = 3
"On a busy machine a host may be kept from answering in time; the run says so."


def digest_of_a_run(daemon: Callable[..., RunningDaemon], folder: Path, name: str, *arguments: Any) -> str:
    """Of one whose host was always in time."""
    for _ in range(MOST_RUNS):
        rmtree(folder / name, ignore_errors=True)
        end = run_with_a_host(daemon, name, *arguments)
        if not end["late_answers"]:
            break
    return str(end["sha256"])


def test_pieces_pauses_and_workers_change_no_byte(daemon: Callable[..., RunningDaemon], tmp_path: Path) -> None:
    digests = {
        digest_of_a_run(daemon, tmp_path, "one", [4096]),
        digest_of_a_run(daemon, tmp_path, "two", [1, 700, 13], "--workers", "2"),
        digest_of_a_run(daemon, tmp_path, "three", [64, 3000], "--workers", "1"),
    }
    assert len(digests) == 1
    runs = [read_run(tmp_path / name) for name in ("one", "two", "three")]
    received = [[(one.start_ns, one.data) for one in run.received["front", 0].payloads] for run in runs]
    assert received[0] == received[1] == received[2]
    assert received[0][0] == (0, telegram(b"\x20\x40"))


def test_the_end_waits_until_a_host_has_read(daemon: Callable[..., RunningDaemon], tmp_path: Path) -> None:
    running = daemon("flat_wall", "--clock", "virtual", "--duration", "2", "--record", "rec")
    with LmsHost(running.path("front")) as host:
        host.set_baud(38_400)
        host.stream()
        got = b""
        while select.select([host.port.fd], [], [], TIME_LIMIT_S)[0] and (data := os.read(host.port.fd, 300)):
            got += data
            time.sleep(0.02)
        got = host.seen + got
    out, errors = running.process.communicate(timeout=TIME_LIMIT_S)
    assert running.process.returncode == 0, errors
    left = json.loads(out.splitlines()[-1])["sensors"][0]["links"][0]["bytes_out"]
    sent = b"".join(one.data for one in read_run(tmp_path / "rec").sent["front", 0].payloads)
    assert len(got) > 3000
    assert sent[:left].endswith(got)
