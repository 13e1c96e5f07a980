"""An adapter that is pulled out, and paths that are taken away, while hosts are served, in runs and in replays."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import serial

from emulator.judging.rig import Rig
from emulator.runtime.control import ask
from tests.system.conftest import TIME_LIMIT_S, RunningDaemon
from tests.system.hosts import Adapter, LmsHost
from tests.system.nursery import begun

CASE = """\
schema: 1
world:
  - {box: {size_m: [0.3, 50, 4]}, at_m: [10, 0, 0], material: concrete}
sensors:
  - {id: front, model: sick-lms291-s05, links: ["pty:./front"], device: {delays: fast}}
  - {id: rear, model: sick-lms291-s05, links: ["serial:ADAPTER"], device: {delays: fast}}
"""


@pytest.fixture
def adapter() -> Iterator[Adapter]:
    made = Adapter()
    yield made
    made.close()


@pytest.mark.parametrize("clock", ["real", "virtual"])
def test_the_other_sensor_goes_on(
    daemon: Callable[..., RunningDaemon], adapter: Adapter, tmp_path: Path, clock: str
) -> None:
    (tmp_path / "case.yaml").write_text(CASE.replace("ADAPTER", adapter.path), encoding="utf-8")
    running = daemon("case.yaml", "--clock", clock)
    adapter.opened()
    with LmsHost(running.path("front")) as host:
        host.set_baud(38_400)
        host.stream()
        assert len(host.scan()) == 361
        adapter.pull()
        said = running.process.stderr.readline()  # type: ignore[union-attr]
        assert said.startswith(f"lidaremu: serial:{adapter.path}: lost: ")
        host.seen = b""
        host.port.reset_input_buffer()
        for _ in range(20):
            assert len(host.scan()) == 361
    assert running.stop() == 3
    assert running.errors == ""  # told once
    assert running.end["front"]["scans_sent"] > 20


def test_a_test_of_a_driver_fails_at_its_end(adapter: Adapter, tmp_path: Path) -> None:
    (tmp_path / "case.yaml").write_text(CASE.replace("ADAPTER", adapter.path), encoding="utf-8")
    links = {"rear": f"serial:{adapter.path}"}

    def drive() -> None:
        with Rig(str(tmp_path / "case.yaml"), tmp_path, links=links) as rig, LmsHost(rig["front"].path) as host:
            adapter.opened()
            host.stream()
            host.scan()
            adapter.pull()
            for _ in range(20):
                assert len(host.scan()) == 361
            rig.step_scans(3, "front")

    with pytest.raises(RuntimeError, match=f"links were lost: serial:{adapter.path}: lost: "):
        drive()


def test_the_rest_of_a_replay_goes_on(daemon: Callable[..., RunningDaemon], adapter: Adapter, tmp_path: Path) -> None:
    (tmp_path / "case.yaml").write_text(CASE.replace("serial:ADAPTER", "pty:./rear"), encoding="utf-8")
    running = daemon("case.yaml", "--clock", "virtual", "--record", "rec")
    for sensor in ("front", "rear"):
        with LmsHost(running.path(sensor)) as host:
            host.stream()
            host.scan()
    assert running.stop() == 0
    links = ("--link", "front=pty:./again?speed=ignore", "--link", f"rear=serial:{adapter.path}")
    process = begun("replay", "rec", "--loop", "0", "--json", *links, cwd=tmp_path)
    try:
        assert process.stdout is not None
        assert process.stderr is not None
        assert json.loads(process.stdout.readline())["event"] == "ready"
        adapter.opened()
        with serial.Serial(str(tmp_path / "again"), 9600, timeout=TIME_LIMIT_S) as port:
            assert port.read(1)
            adapter.pull()
            assert process.stderr.readline().startswith(f"lidaremu: serial:{adapter.path}: lost: ")
            port.reset_input_buffer()
            assert len(port.read(5000)) == 5000
        process.send_signal(signal.SIGTERM)
        assert process.communicate(timeout=TIME_LIMIT_S)[1] == ""
        assert process.returncode == 3
    finally:
        process.kill()
        process.communicate()


@pytest.mark.parametrize("clock", ["real", "virtual"])
def test_paths_that_are_taken_away_are_put_back_and_told_and_the_host_goes_on(
    daemon: Callable[..., RunningDaemon], tmp_path: Path, clock: str
) -> None:
    (tmp_path / "case.yaml").write_text(CASE.replace("serial:ADAPTER", "pty:./rear"), encoding="utf-8")
    running = daemon("case.yaml", "--clock", clock, "--control", str(tmp_path / "control.sock"))
    front, rear, control = (tmp_path / name for name in ("front", "rear", "control.sock"))
    with LmsHost(running.path("front")) as host:
        host.stream()
        assert len(host.scan()) == 361
        front.unlink()
        rear.unlink()
        rear.write_text("precious")
        control.unlink()
        while not (front.is_symlink() and control.exists()):
            assert len(host.scan()) == 361
        while True:
            totals: Any = ask(control, "status", {})["incident_totals"]  # type: ignore[index]
            if totals == {"link restored": 2, "link path taken": 1}:
                break
            assert len(host.scan()) == 361
        assert rear.read_text() == "precious"
        rear.unlink()
        while not rear.is_symlink():
            assert len(host.scan()) == 361
        host.stop()
    with LmsHost(str(rear)) as host:
        host.stream()
        assert len(host.scan()) == 361
    assert running.stop() == 0, running.errors
    assert running.errors == ""
    assert not any(path.exists() for path in (front, rear, control))
