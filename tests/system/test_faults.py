"""Plugs and power on real links: a pty and a socket, hosts in another process, faults by `lidaremu ctl`."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import serial

from emulator.hosts.lines import SerialLine
from emulator.hosts.lms2xx import Lms2xxHost
from emulator.runtime.control import ask
from tests.system.conftest import TIME_LIMIT_S, RunningDaemon
from tests.system.hosts import LdHost, LmsHost
from tests.system.nursery import SWITCH, ran

CASE = """\
schema: 1
world:
  - {box: {size_m: [0.3, 50, 4]}, at_m: [10, 0, 0], material: concrete}
sensors:
  - {id: front, model: sick-lms291-s05, links: ["pty:./front"], device: {delays: fast}}
  - {id: ld, model: sick-ld-lrs1000, links: ["tcp:127.0.0.1:0"], device: {delays: fast, step_deg: 2}}
"""


@pytest.fixture
def running(daemon: Callable[..., RunningDaemon], tmp_path: Path) -> RunningDaemon:
    (tmp_path / "case.yaml").write_text(CASE, encoding="utf-8")
    return daemon("case.yaml", "--control", str(tmp_path / "control"))


def fault(running: RunningDaemon, **params: object) -> int:
    reported = ask(Path(running.ready["control"].removeprefix("unix:")), "fault", params)
    assert isinstance(reported, dict)
    return int(reported["number"])


def until(holds: Callable[[], bool]) -> None:
    end = time.monotonic() + TIME_LIMIT_S
    while not holds():
        assert time.monotonic() < end, "not in time"
        time.sleep(0.02)


def after(host: LmsHost, head: bytes) -> bytes | None:
    """The next telegram whose payload begins so, whatever stands before it on the line."""
    end, data = time.monotonic() + TIME_LIMIT_S, host.seen
    while head not in data:
        assert time.monotonic() < end, data[-50:]
        data += host.port.read(max(1, host.port.in_waiting))
    host.seen = data[data.index(head) - 4 :]
    return host.next(TIME_LIMIT_S)


def hung_up(use: Callable[[], object]) -> bool:
    try:
        use()
    except (serial.SerialException, OSError, AssertionError):
        return True
    return False


def refused(address: tuple[str, int]) -> bool:
    """Whether nobody listens there. One who met a port at the moment it closed is reset: he asks again."""
    try:
        socket.create_connection(address, 1.0).close()
    except ConnectionRefusedError:
        return True
    except ConnectionResetError:
        return False
    return False


def test_a_pty_is_unplugged_and_a_device_is_switched_off_and_hosts_come_back(running: RunningDaemon) -> None:
    path = running.path("front")
    host = LmsHost(path)
    host.set_baud(38_400)
    host.stream()
    assert len(host.scan()) == 361

    fault(running, on="front", do="unplug", for_s=2.0)
    until(lambda: hung_up(lambda: host.port.read(1000)))
    assert not os.path.lexists(path)
    host.port.close()
    until(lambda: os.path.exists(path))
    with LmsHost(path, 38_400) as again:
        assert len(again.scan()) == 361, "the device has gone on all the while, at the speed it had"

        fault(running, on="front", do="power_cycle", off_s=0.3)
        again.port.baudrate = 9600
        assert after(again, b"\x90LMS291;") is not None
    ours = Lms2xxHost(SerialLine(path, 9_600), 38_400)
    assert next(scan for scan in ours.scans(TIME_LIMIT_S) if scan is not None).range_m.shape == (361,)
    ours.close()
    assert running.stop() == 0
    assert running.end["front"]["restarts"] == 2
    assert running.end["front"]["faults"] == {
        "unplug": {"begun": 1, "hits": 1},
        "power_cycle": {"begun": 1, "hits": 1},
    }
    assert running.end["front"]["scans_dropped"]["fault unplug"] > 2


def test_sockets_of_an_unplugged_and_of_a_switched_off_device(running: RunningDaemon) -> None:
    port = int(running.link("ld").rpartition(":")[2])
    with contextlib.ExitStack() as hosts:
        _sockets_go_and_come(running, port, lambda: hosts.enter_context(LdHost(port)))
    assert running.stop() == 0
    assert running.end["ld"]["restarts"] == 2


def _sockets_go_and_come(running: RunningDaemon, port: int, connect: Callable[[], LdHost]) -> None:
    host = connect()
    host.measure()

    fault(running, on="ld", do="unplug", for_s=2.0)
    until(lambda: hung_up(lambda: host.ask(0x0102)))
    until(lambda: refused(("127.0.0.1", port)))
    until(lambda: not refused(("127.0.0.1", port)))
    again = connect()
    assert again.ask(0x0102), "the device has gone on all the while"

    fault(running, on="ld", do="power_cycle", off_s=2.0)
    until(lambda: refused(("127.0.0.1", port)))
    again.socket.settimeout(0.1)
    with pytest.raises(TimeoutError):
        again.socket.recv(1)  # no FIN, no reset: the device cannot say that it has gone
    until(lambda: not refused(("127.0.0.1", port)))
    again.socket.settimeout(TIME_LIMIT_S)
    again.socket.sendall(b"\x02USP")
    with pytest.raises(ConnectionResetError):
        again.socket.recv(1)
    until(lambda: answers(port))
    connect().measure()


def answers(port: int) -> bool:
    """Whether the device has started: until then it takes a connection and says nothing."""
    with socket.create_connection(("127.0.0.1", port), 1.0) as connection:
        connection.settimeout(1.0)
        connection.sendall(b"\x02USP\0\0\0\x02\x01\x02\x03")
        try:
            return bool(connection.recv(100))
        except TimeoutError:
            return False


def test_ctl_begins_lists_and_clears(running: RunningDaemon, tmp_path: Path) -> None:
    def ctl(*words: str) -> subprocess.CompletedProcess[str]:
        return ran("ctl", *words, "--socket", running.ready["control"], cwd=tmp_path)

    assert json.loads(ctl("fault", "front", "hang").stdout)["number"] == 1
    found = json.loads(ctl("fault", "list").stdout)["faults"]
    assert [(one["number"], one["do"], one["state"]) for one in found] == [(1, "hang", "active")]
    assert json.loads(ctl("fault", "clear", "1").stdout)["faults"][0]["state"] == "over"
    wrong = ctl("fault", "front", "drop_telegrm")
    assert wrong.returncode == 2
    assert wrong.stderr.startswith("lidaremu: do: 'drop_telegrm'; want a fault: drop_telegram, ")
    running.stop()


def test_the_hostile_day_ends_well() -> None:
    command = [sys.executable, "-m", "emulator", "test", "hostile_day", "--json"]
    environment = os.environ | {SWITCH: "1"}  # thirty seconds of three sensors: a third of the time
    found = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False, env=environment)
    row = json.loads(found.stdout)
    assert [one for one in row["expect"] if not one["held"]] == []
    assert found.returncode == 0
    assert row["sensors"][0]["faults"]["power_cycle"] == {"begun": 1, "hits": 1}


def test_a_driver_in_a_test_loses_power_and_plug_on_a_virtual_clock(lidaremu: Callable[..., Any]) -> None:
    with lidaremu("flat_wall", sensors__front__device__delays="real") as rig:
        path = rig["front"].path
        with LmsHost(path) as host:
            host.stream()
            host.scan()
            rig.pause()
            number = rig.fault("front", "power_cycle", off_s=3)
            began_s = rig.now_s
            rig.advance(seconds=5)
            host.port.read(100_000)
            host.seen = b""  # half a telegram
            rig.resume()
            boot = host.next(TIME_LIMIT_S)
            assert boot is not None
            assert boot[0] == 0x90
            assert 28.0 <= rig.now_s - began_s < 29.0, "three seconds without power, twenty-five of start-up"
            host.stream()
            assert len(host.scan()) == 361
            assert rig.fault("front", "unplug") == number + 1
            until(lambda: hung_up(lambda: host.port.read(1000)))
        assert not os.path.lexists(path)
        rig.clear_fault(number + 1)
        with LmsHost(path) as again:
            assert len(again.scan()) == 361
        assert [row["state"] for row in rig.faults()] == ["over", "over"]
