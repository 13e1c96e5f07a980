"""Processes of a real run killed and stopped: rows of emulator/endurance/process_faults.py that need real ones."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from emulator.runtime.control import ask
from tests.system.conftest import TIME_LIMIT_S, RunningDaemon
from tests.system.hosts import LmsHost
from tests.system.nursery import begun

CHEAP = "physics: {rule: axis, sub_beams: 1}"
CASE = f"""\
schema: 1
world:
  - {{box: {{size_m: [0.3, 50, 4]}}, at_m: [10, 0, 0], material: concrete}}
sensors:
  - {{id: a, model: sick-lms291-s05, links: ["pty:./a"], device: {{delays: fast}}, {CHEAP}}}
  - {{id: b, model: sick-lms291-s05, links: ["pty:./b"], device: {{delays: fast}}, {CHEAP}}}
  - {{id: ld, model: sick-ld-lrs1000, links: ["tcp:127.0.0.1:0"], device: {{delays: fast, step_deg: 2}}, {CHEAP}}}
"""
READER = """\
import socket, sys
from tests.system.hosts import LdHost
host = LdHost(int(sys.argv[1]))
host.measure()
print("reads", flush=True)
while host.socket.recv(65536): pass
"""
Daemons = Callable[..., RunningDaemon]


@pytest.fixture
def case(tmp_path: Path) -> Path:
    (tmp_path / "case.yaml").write_text(CASE, encoding="utf-8")
    return tmp_path


def status(running: RunningDaemon) -> dict[str, Any]:
    found = ask(running.control, "status", {})
    assert isinstance(found, dict)
    return found


def worker_of(running: RunningDaemon, sensor: str) -> int:
    return next(int(row["pid"]) for row in status(running)["workers"] if sensor in row["sensors"])


def until(holds: Callable[[], bool]) -> None:
    end = time.monotonic() + TIME_LIMIT_S
    while not holds():
        assert time.monotonic() < end, "not in time"
        time.sleep(0.05)


def streaming(running: RunningDaemon, sensor: str) -> LmsHost:
    host = LmsHost(running.path(sensor))
    host.set_baud(500_000)
    host.stream()
    host.scan()
    return host


def late(row: dict[str, Any]) -> int:
    return int(row["scans_dropped"].get("measured too late", 0))


def late_of(running: RunningDaemon) -> dict[str, int]:
    return {row["id"]: late(row) for row in status(running)["sensors"]}


def test_killed_and_stopped_workers(daemon: Daemons, case: Path) -> None:
    running = daemon("case.yaml", "--control", str(case / "control"), "--workers", "2", forked=False)
    with streaming(running, "a") as a, streaming(running, "b") as b:
        first = worker_of(running, "a")
        assert first != worker_of(running, "b")
        os.kill(first, signal.SIGKILL)
        for host in (a, b):  # the other process measures for both
            for _ in range(20):
                assert len(host.scan()) == 361
        until(lambda: status(running)["incident_totals"].get("worker replaced") == 1)
        until(lambda: [row["state"] for row in status(running)["workers"]] == ["ready", "ready"])
        assert worker_of(running, "a") != first

        stopped, before = worker_of(running, "b"), late_of(running)
        os.kill(stopped, signal.SIGSTOP)
        for host in (a, b):
            host.port.reset_input_buffer()
            host.seen = b""
            for _ in range(100):
                assert len(host.scan()) == 361
        until(lambda: status(running)["incident_totals"].get("worker replaced") == 2)
        until(lambda: not Path(f"/proc/{stopped}").exists())
        lost = {sensor: count - before[sensor] for sensor, count in late_of(running).items()}
    os.kill(worker_of(running, "a"), signal.SIGSTOP)  # the end does not wait for it
    assert running.stop() in (0, 5)  # on a busy machine a sensor may be silent for two seconds
    # what a busy machine takes from both is not the stopped process's
    assert lost["b"] - lost["a"] < 37.5 * 4, "less than the five seconds after which a process is known to hang"


class Listener:
    """What systemd would hear."""

    def __init__(self, path: Path) -> None:
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind(str(path))
        self.socket.settimeout(TIME_LIMIT_S)

    def hear(self) -> list[str]:
        """All that has been said and not heard."""
        found = []
        self.socket.setblocking(False)
        try:
            while True:
                found.append(self.socket.recv(1000).decode())
        except BlockingIOError:
            return found
        finally:
            self.socket.settimeout(TIME_LIMIT_S)


def test_a_stopped_sender_and_stopped_onlookers(daemon: Daemons, case: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    service = Listener(case / "notify")
    monkeypatch.setenv("NOTIFY_SOCKET", str(case / "notify"))
    monkeypatch.setenv("WATCHDOG_USEC", "400000")
    running = daemon("case.yaml", "--control", str(case / "control"), "--workers", "1")
    monkeypatch.delenv("NOTIFY_SOCKET")
    assert service.socket.recv(100) == b"READY=1"
    environment = dict(os.environ) | {"PYTHONPATH": str(Path(__file__).resolve().parents[2])}
    port = running.link("ld").rpartition(":")[2]
    reader = subprocess.Popen([sys.executable, "-c", READER, port], stdout=subprocess.PIPE, env=environment)
    page = begun("view", str(case / "control"), "--no-browser", "--json", cwd=case, stderr=None)
    try:
        assert reader.stdout is not None
        assert reader.stdout.readline() == b"reads\n"
        assert page.stdout is not None
        assert "ready" in page.stdout.readline()
        with streaming(running, "a") as host:
            measuring = worker_of(running, "a")
            service.hear()
            os.kill(running.process.pid, signal.SIGSTOP)
            time.sleep(0.5)
            service.hear()
            time.sleep(1.5)
            assert service.hear() == [], "a sender that stands says nothing"
            os.kill(running.process.pid, signal.SIGCONT)
            host.port.reset_input_buffer()
            host.seen = b""
            began, sent = time.monotonic(), status(running)["sensors"][0]["scans_sent"]
            for _ in range(40):
                assert len(host.scan()) == 361
            taken_s = time.monotonic() - began
            assert status(running)["sensors"][0]["scans_sent"] - sent < 37.5 * taken_s + 12, "a storm"
            assert b"WATCHDOG=1" in [text.encode() for text in service.hear()]
            for process in (reader, page):
                os.kill(process.pid, signal.SIGSTOP)
            for _ in range(60):
                assert len(host.scan()) == 361
            for process in (reader, page):
                os.kill(process.pid, signal.SIGKILL)
            for _ in range(40):
                assert len(host.scan()) == 361
            found = status(running)
            assert worker_of(running, "a") == measuring
            assert "worker replaced" not in found["incident_totals"]
            assert late(found["sensors"][0]) >= 37.5 * 1.5
    finally:
        for process in (reader, page):
            process.kill()
            process.communicate()
            assert process.stdout is not None
            process.stdout.close()
    service.hear()
    assert running.stop() in (0, 5)  # 5: on a machine so busy that a scan came two seconds late
    assert "STOPPING=1" in service.hear()
    service.socket.close()


def test_a_killed_sender_leaves_nobody_behind(daemon: Daemons, case: Path) -> None:
    running = daemon("case.yaml", "--control", str(case / "control"), "--workers", "2")
    workers = [int(row["pid"]) for row in status(running)["workers"]]
    assert len(workers) == 2
    os.kill(workers[0], signal.SIGSTOP)
    running.process.kill()
    running.process.wait()
    for pid in workers:
        until(lambda pid=pid: not Path(f"/proc/{pid}").exists() or "Z" in state_of(pid))  # type: ignore[misc]
    again = daemon("case.yaml", "--control", str(case / "control"))
    with LmsHost(again.path("a")) as host:
        assert host.ask(b"\x3a", 0xBA)[1:7] == b"LMS291"
    assert again.stop() == 0


def state_of(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return "Z"
