"""`lidaremu run` as its users run it: a process, its ports, signals, hosts that come and go, and its exit codes."""

from __future__ import annotations

import contextlib
import csv
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.system.conftest import TIME_LIMIT_S
from tests.system.hosts import LmsHost, drift_s
from tests.system.nursery import ran


def command(*arguments: str, cwd: Path, timeout: float = 4 * TIME_LIMIT_S) -> subprocess.CompletedProcess[str]:
    return ran(*arguments, cwd=cwd, seconds=timeout)


def test_a_host_streams_at_the_rate_of_the_line_and_the_run_reports_it(daemon: Callable[..., object]) -> None:
    running = daemon("flat_wall", "--set", "sensors.front.physics.false_alarms=false")
    stamps_s, scans = [], []
    with LmsHost(running.path("front")) as host:
        host.set_baud(500_000)
        host.stream()
        for _ in range(150):
            scans.append(host.scan())
            stamps_s.append(time.monotonic())
    assert {len(scan) for scan in scans} == {361}
    assert all(795 <= scan[180] <= 805 for scan in scans)
    assert running.stop() == 0
    end = running.end["front"]
    late = end["scans_dropped"].get("measured too late", 0)  # by a busy machine: their slots stay empty
    later_s, apart_s = drift_s(stamps_s, 37.5)
    assert -0.05 * apart_s < later_s < 0.05 * apart_s + late / 37.5
    sent = end["scans_sent"]
    assert sent >= 150
    assert 37.5 * (sent - 1) / (sent - 1 + late) * (1 - 1e-3) < end["scans_per_s"] < 37.5 * (1 + 1e-3)
    assert end["scans_dropped"].get("line slower than the scan rate", 0) == 0
    assert end["lateness_us"]["median"] is not None


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_the_run_and_nothing_is_left_behind(
    daemon: Callable[..., object], tmp_path: Path, number: int
) -> None:
    running = daemon("flat_wall")
    assert (tmp_path / "lms291").is_symlink()
    assert running.stop(number) == 0
    assert list(tmp_path.iterdir()) == []


def test_after_kill_9_the_next_run_takes_the_path_over(daemon: Callable[..., object], tmp_path: Path) -> None:
    first = daemon("flat_wall")
    first.process.kill()
    first.process.wait()
    second = daemon("flat_wall")
    with LmsHost(second.path("front")) as host:
        assert host.ask(b"\x3a", 0xBA)[1:7] == b"LMS291"
    assert second.stop() == 0


def test_a_second_run_on_the_same_path_is_refused_and_the_first_goes_on(
    daemon: Callable[..., object], tmp_path: Path
) -> None:
    first = daemon("flat_wall")
    second = command("run", "flat_wall", cwd=tmp_path)
    assert second.returncode == 3
    assert "lms291" in second.stderr
    assert "Traceback" not in second.stderr
    with LmsHost(first.path("front")) as host:
        assert host.ask(b"\x3a", 0xBA)[1:7] == b"LMS291"


def test_a_host_leaves_without_a_word_and_returns(daemon: Callable[..., object]) -> None:
    running = daemon("flat_wall")
    for _ in range(3):
        with LmsHost(running.path("front")) as host:
            host.ask(b"\x20\x25", 0xA0)
            host.stream()
            assert len(host.scan()) == 361


def test_several_sensors_serve_their_hosts_at_once_and_garbage_on_one_disturbs_no_other(
    daemon: Callable[..., object],
) -> None:
    running = daemon("two_sensors")
    ids = [item["id"] for item in running.ready["sensors"] if item["links"][0].startswith("pty:")]
    assert len(ids) >= 2
    with LmsHost(running.path(ids[0])) as good, LmsHost(running.path(ids[1])) as bad:
        good.set_baud(38_400)
        good.stream()
        for _ in range(5):
            bad.port.write(os.urandom(2000) + b"\x02\x00\xff\xff" + b"\x02\x00\x08")
            assert len(good.scan()) > 100
        for _ in range(20):  # the first may be taken for the rest of a broken telegram
            bad.port.read(100_000)
            bad.seen = b""
            with contextlib.suppress(AssertionError):
                if bad.ask(b"\x3a", 0xBA, seconds=3.0)[1:4] == b"LMS":
                    break
        else:
            pytest.fail("garbage has silenced it")


def test_the_same_telegrams_are_served_over_tcp_as_behind_a_serial_device_server(
    daemon: Callable[..., object],
) -> None:
    running = daemon("flat_wall", "--link", "front=tcp:127.0.0.1:0")
    port = int(running.link("front").rpartition(":")[2])
    with socket.create_connection(("127.0.0.1", port), timeout=TIME_LIMIT_S) as host:
        host.sendall(bytes.fromhex("02000200 2025 3508".replace(" ", "")))
        got = b""
        while len(got) < 10:
            got += host.recv(100)
    assert got[:10].hex() == "06028003" + "00a0001016" + "0a"


def test_a_port_in_use_is_told_with_exit_code_3(tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        done = command("run", "flat_wall", "--link", f"front=tcp:127.0.0.1:{port}", cwd=tmp_path)
    assert done.returncode == 3
    assert str(port) in done.stderr
    assert "Traceback" not in done.stderr


def test_duration_ends_a_run_by_itself(tmp_path: Path) -> None:
    done = command("run", "flat_wall", "--duration", "0.5", cwd=tmp_path)
    assert done.returncode == 0
    assert "front: 0 scans sent" in done.stdout


def test_a_driver_given_on_the_command_line_runs_with_the_run(tmp_path: Path) -> None:
    script = "import os,sys; p=os.environ['LIDAREMU_FRONT']; sys.exit(0 if os.path.exists(p) else 5)"
    good = command("run", "flat_wall", "--", sys.executable, "-c", script, cwd=tmp_path)
    assert good.returncode == 0, good.stderr
    bad = command("run", "flat_wall", "--", sys.executable, "-c", "import sys; sys.exit(5)", cwd=tmp_path)
    assert bad.returncode == 1
    assert "ended with exit code 5" in bad.stderr
    killed = command("run", "flat_wall", "--", "sh", "-c", "kill -9 $$", cwd=tmp_path)
    assert killed.returncode == 1
    assert "sh ended with signal 9" in killed.stderr
    talking = command("run", "flat_wall", "--json", "--", "echo", "a line of the driver", cwd=tmp_path)
    assert [json.loads(line)["event"] for line in talking.stdout.splitlines()] == ["ready", "stopped"]
    assert "a line of the driver" in talking.stderr
    missing = command("run", "flat_wall", "--", "./no-such-driver", cwd=tmp_path)
    assert missing.returncode == 2
    assert "no-such-driver" in missing.stderr
    assert "Traceback" not in missing.stderr


def test_look_writes_a_picture_and_a_table(daemon: Callable[..., object], tmp_path: Path) -> None:
    running = daemon("flat_wall")
    done = command(
        "look", running.link("front"), "--scans", "3", "--png", "scan.png", "--csv", "scan.csv", cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "scan.png").read_bytes().startswith(b"\x89PNG")
    with (tmp_path / "scan.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 3 * 361
    middle = next(row for row in rows if float(row["azimuth_deg"]) == 0.0)
    assert float(middle["range_m"]) == pytest.approx(8.0, abs=0.06)


def test_look_at_nothing_is_told_with_exit_code_3(tmp_path: Path) -> None:
    done = command("look", "pty:./nobody", cwd=tmp_path)
    assert done.returncode == 3
    assert done.stderr == "lidaremu: cannot open ./nobody: No such file or directory\n"


def test_a_virtual_run_tells_the_digest_of_its_wire_as_a_test_does(tmp_path: Path) -> None:
    """Without a host nothing but the device's own sayings goes over the line: twice the same, recorded or not."""
    digests = []
    for extra in ((), ("--record", "kept")):
        done = command("run", "flat_wall", "--speed", "50", "--duration", "2", "--json", *extra, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        end = json.loads(done.stdout.splitlines()[-1])
        assert end["event"] == "stopped"
        assert len(end["sha256"]) == 64
        digests.append(end["sha256"])
    assert digests[0] == digests[1]
