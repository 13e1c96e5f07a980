"""`lidaremu run --clock virtual` where it could stand still, and both daemons beyond a thousand descriptors."""

from __future__ import annotations

import gc
import json
import os
import resource
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from emulator.errors import EmulatorError
from emulator.instrument.instrument import Instrument
from emulator.process.clock import SystemClock
from emulator.runtime import assembly
from emulator.runtime.virtual import MAX_STEPS_AT_ONCE, VirtualRun
from emulator.scenario import scenario
from tests.system.conftest import TIME_LIMIT_S
from tests.system.hosts import LmsHost
from tests.system.nursery import ran

ROOT = Path(__file__).resolve().parents[2]


def test_a_virtual_run_without_a_host_says_why_it_stands(daemon: Callable[..., object], tmp_path: Path) -> None:
    running = daemon("flat_wall", "--clock", "virtual", "--duration", "600")
    assert running.process.stderr.readline() == (
        "lidaremu: no host is connected: virtual time is stopped; --no-wait lets it advance\n"
    )
    assert running.stop() == 0
    assert running.errors == ""


def test_a_virtual_run_that_waits_for_nobody_ends_by_itself(tmp_path: Path) -> None:
    words = ("--clock", "virtual", "--no-wait", "--duration", "3600", "--json")
    done = ran("run", "flat_wall", *words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[-1])["event"] == "stopped"
    assert done.stderr == ""


def test_laws_outside_their_range_are_told_under_a_virtual_clock(tmp_path: Path) -> None:
    path = tmp_path / "haze.yaml"
    path.write_text(
        "schema: 1\nweather: {dust: {visibility_m: 30000, law: esmail}}\n"
        "sensors: [{id: front, model: sick-lms291-s05, links: ['pty:./x']}]\n",
        encoding="utf-8",
    )
    done = ran("run", str(path), "--clock", "virtual", "--no-wait", "--duration", "1", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stderr.count("lidaremu: warning: front: dust: law esmail: visibility") == 1


@pytest.fixture
def many_descriptors() -> Iterator[None]:
    """Every descriptor opened from now on has a number over 1100."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if hard != resource.RLIM_INFINITY and hard < 2048:
        pytest.skip("this machine allows fewer descriptors")
    resource.setrlimit(resource.RLIMIT_NOFILE, (2048, hard))
    gc.collect()  # what other tests have left open would close later, and leave a low number free
    taken: list[int] = []
    try:
        while not taken or taken[-1] < 1100:
            taken.append(os.open("/dev/null", os.O_RDONLY | os.O_CLOEXEC))
        yield
    finally:
        for number in taken:
            os.close(number)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


HOST = """
import sys
sys.path.insert(0, sys.argv[2])
from tests.system.hosts import LmsHost
with LmsHost(sys.argv[1]) as host:
    host.set_baud(38400)
    host.stream()
    assert all(len(host.scan()) == 361 for _ in range(3))
"""


@pytest.mark.parametrize("clock", ["real", "virtual"])
def test_hosts_are_served_beyond_a_thousand_descriptors(many_descriptors: None, tmp_path: Path, clock: str) -> None:
    loaded = scenario.load("flat_wall", links={"front": [f"pty:{tmp_path / 'front'}"]})
    if clock == "virtual":
        running, instruments = assembly.start_virtual(loaded)
    else:
        running, instruments = assembly.start(loaded, SystemClock())  # type: ignore[assignment]
    assert min(number for link in instruments[0].links for number in link.filenos()) > 1024
    running.power_on()
    thread = threading.Thread(target=running.run)
    thread.start()
    try:
        done = subprocess.run(
            [sys.executable, "-c", HOST, str(tmp_path / "front"), str(ROOT)],
            capture_output=True, text=True, timeout=4 * TIME_LIMIT_S,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        assert running.call(lambda: 7).result(TIME_LIMIT_S) == 7
    finally:
        running.call(running.stop)
        thread.join(TIME_LIMIT_S)
        running.close()


def test_looking_again_and_again_while_time_stands_is_no_restlessness(tmp_path: Path) -> None:
    """A host that reads nothing holds virtual time for as long as it likes."""
    loaded = scenario.load("flat_wall", links={"front": ["loop:a"]})
    running, _ = assembly.start_virtual(loaded)
    running.power_on()
    for _ in range(MAX_STEPS_AT_ONCE + 10):
        running.run_of.touch()
        running._here()
    running.close()


def test_a_sensor_that_never_rests_is_named() -> None:
    class Restless:
        sensor, links, poked, conditions = "front", (), False, None

        def watch(self, watcher: object) -> None: ...

        def step(self, now_ns: int) -> int:
            return now_ns

    restless: Instrument = Restless()  # type: ignore[assignment]
    with pytest.raises(EmulatorError, match="front: does not come to rest at 0 ns of virtual time"):
        VirtualRun([restless]).advance(1_000)


def test_a_host_that_holds_time_is_not_told_as_absent(daemon: Callable[..., object]) -> None:
    running = daemon("flat_wall", "--clock", "virtual")
    with LmsHost(running.path("front")) as host:
        host.set_baud(38_400)
        host.stream()
        assert len(host.scan()) == 361
    assert running.stop() == 0
    assert running.errors == ""
