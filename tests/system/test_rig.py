"""The pytest fixture as a driver's repository uses it, and real hosts on a virtual clock."""

from __future__ import annotations

import re
import shutil
import socket
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from emulator.commands.cli import main
from emulator.errors import ScenarioError
from emulator.recording.can_logs import read_with_library
from tests.system.conftest import TIME_LIMIT_S
from tests.system.hosts import LmsHost, telegram


def test_driver_sees_the_car(lidaremu: Callable[..., object]) -> None:
    with lidaremu("crossing_car", weather__fog__visibility_m=50) as rig:
        with LmsHost(rig["front"].path) as host:
            host.set_baud(38_400)
            host.stream()
            rig.advance(seconds=2)
            assert len(host.scan()) == 361
        assert rig.now_s >= 2.0
        assert rig.value("max(front.points_on(car))") > 5


def test_nothing_is_lost_of_what_a_host_reads_late(lidaremu: Callable[..., object]) -> None:
    with lidaremu("flat_wall", sensors__front__physics__false_alarms=False) as rig, LmsHost(rig["front"].path) as host:
        host.set_baud(500_000)
        host.stream()
        rig.advance(seconds=3)
        scans = [host.scan() for _ in range(100)]
        assert {len(scan) for scan in scans} == {361}
        assert all(795 <= scan[180] <= 805 for scan in scans)
        link = rig.instruments[0].links[0]
        assert link.stats.bytes_lost == 0


def test_time_stands_while_the_host_does_not_read_and_while_paused(lidaremu: Callable[..., object]) -> None:
    with lidaremu("flat_wall") as rig, LmsHost(rig["front"].path) as host:
        host.stream()
        host.scan()
        then, end = -1.0, time.monotonic() + TIME_LIMIT_S
        while rig.now_s != then:  # what the terminal holds is filled first
            assert time.monotonic() < end, "time does not stand"
            then = rig.now_s
            time.sleep(0.3)
        rig.pause()
        rig.advance(seconds=0.25)
        assert rig.now_s == pytest.approx(then + 0.25, abs=0.05)
        assert rig.step_scans(2) == 2


def test_two_rigs_at_once_do_not_collide_and_tcp_ports_are_free(lidaremu: Callable[..., object]) -> None:
    links = {"front": ["tcp:127.0.0.1:0"]}
    alone = {"front": "tcp:127.0.0.1:0"}
    with lidaremu("flat_wall", links=links) as one, lidaremu("flat_wall", links=alone) as two:
        assert one["front"].port != two["front"].port
        with socket.create_connection(("127.0.0.1", two["front"].port), timeout=TIME_LIMIT_S) as host:
            host.sendall(telegram(b"\x20\x25"))
            got = b""
            while len(got) < 10:
                got += host.recv(100)
        assert got[:1] == b"\x06"


def test_the_scenarios_faults_reach_the_test(lidaremu: Callable[..., object]) -> None:
    with pytest.raises(ScenarioError, match="visibility_m"):
        lidaremu("flat_wall", weather__fog__visibility_m=-1)
    with lidaremu("flat_wall") as rig, pytest.raises(KeyError, match="front"):
        rig["rear"]


OBJECTS = """\
schema: 1
world:
  - {plane: {size_m: [6, 60]}, at_m: [8, 0, 1], pitch_deg: -90, material: white_plaster}
sensors:
  - {id: front, model: sick-lms291-s05, mount: {at_m: [0, 0, 1]}, device: {resolution_deg: 1, field_deg: 100}}
  - {id: list, model: can-ars408, from: [front]}
"""


def test_a_can_host_gets_every_frame_on_virtual_time_and_the_logs_have_them(
    lidaremu: Callable[..., object], tmp_path: Path
) -> None:
    path = tmp_path / "objects.yaml"
    path.write_text(OBJECTS, encoding="utf-8")
    with lidaremu(path) as rig, socket.create_connection(("127.0.0.1", rig["list"].port), timeout=TIME_LIMIT_S) as host:
        host.sendall(b"< open list >< rawmode >")
        text = b""
        while text.count(b"< frame") < 60:
            text += host.recv(65_536)
        rig.pause()
        rig.advance(seconds=0.5)
        folder = rig.recording
    heard = [tuple(match) for match in re.findall(rb"< frame ([0-9A-F]+) [0-9.]+ ([0-9A-F]*) >", text)]
    log = [re.match(r"\(\S+\) list (\S+)#(\S*)$", line) for line in (folder / "list.log").read_text().splitlines()]
    logged = [(int(match[1], 16), match[2]) for match in log if match is not None]
    reported = [(int(identifier, 16), data.decode()) for identifier, data in heard]
    first = next(index for index in range(len(logged)) if logged[index : index + len(reported)] == reported)
    assert first >= 0
    for name in ("list.blf", "list.asc"):
        assert [(one.peer, one.data.hex().upper()) for one in read_with_library(folder / name)] == logged
        assert main(["diff", str(folder / name), str(folder / name)]) == 0
    assert main(["diff", str(folder / "list.log"), str(folder)]) == 2


def test_a_rig_whose_recording_ends_early_fails_at_its_end_and_only_then(lidaremu: Callable[..., object]) -> None:
    def without_its_folder(then: Callable[[], object]) -> None:
        with lidaremu("flat_wall") as rig:
            shutil.rmtree(rig.recording)
            rig.advance(seconds=0.1)
            then()

    with pytest.raises(RuntimeError, match=r"recording: the recording ended early: .* was removed"):
        without_its_folder(lambda: None)
    with pytest.raises(ZeroDivisionError):  # the block's own error is the one that counts
        without_its_folder(lambda: 1 // 0)
