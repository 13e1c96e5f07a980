"""`lidaremu run` as its users run it: a process, its ports, signals, hosts that come and go, and its exit codes."""

from __future__ import annotations

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

from tests.system.hosts import LmsHost

ROOT = Path(__file__).resolve().parents[2]


def command(*arguments: str, cwd: Path, timeout: float = 60.0) -> subprocess.CompletedProcess[str]:
    words = [sys.executable, "-m", "emulator", *arguments]
    environment = dict(os.environ) | {"PYTHONPATH": str(ROOT)}
    return subprocess.run(words, capture_output=True, text=True, cwd=cwd, timeout=timeout, env=environment, check=False)


def test_a_host_streams_at_the_rate_of_the_line_and_the_run_reports_it(daemon: Callable[..., object]) -> None:
    running = daemon("flat_wall")
    with LmsHost(running.path("front")) as host:
        host.set_baud(500_000)
        host.stream()
        start = time.monotonic()
        scans = [host.scan() for _ in range(150)]
        elapsed = time.monotonic() - start
    assert {len(scan) for scan in scans} == {361}
    assert all(795 <= scan[180] <= 805 for scan in scans)
    assert elapsed == pytest.approx(150 / 37.5, rel=0.05)
    assert running.stop() == 0
    end = running.end["front"]
    assert end["scans_sent"] >= 150
    assert end["scans_per_s"] == pytest.approx(37.5, rel=1e-3)
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
        bad.seen = b""
        time.sleep(1.0)
        bad.port.reset_input_buffer()
        assert bad.ask(b"\x3a", 0xBA, seconds=6.0)[1:4] == b"LMS"


def test_the_same_telegrams_are_served_over_tcp_as_behind_a_serial_device_server(
    daemon: Callable[..., object],
) -> None:
    running = daemon("flat_wall", "--link", "front=tcp:127.0.0.1:0")
    port = int(running.link("front").rpartition(":")[2])
    with socket.create_connection(("127.0.0.1", port), timeout=5.0) as host:
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


def test_the_demo_draws_what_the_sensor_sees(tmp_path: Path) -> None:
    done = command("demo", "--scenario", "flat_wall", "--duration", "4", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "LMS291" in done.stdout
    assert "361 beams" in done.stdout
    assert "scans sent" in done.stdout


def test_look_writes_a_picture_and_a_table(daemon: Callable[..., object], tmp_path: Path) -> None:
    running = daemon("flat_wall")
    done = command(
        "look", running.link("front"), "--scans", "3", "--png", "scan.png", "--csv", "scan.csv", cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "scan.png").read_bytes().startswith(b"\x89PNG")
    rows = (tmp_path / "scan.csv").read_text().splitlines()
    assert rows[0] == "scan,azimuth_deg,range_m"
    assert len(rows) == 1 + 3 * 361
    middle = next(row for row in rows[1:] if row.split(",")[1] == "0.0000")
    assert float(middle.split(",")[2]) == pytest.approx(8.0, abs=0.06)


def test_look_at_nothing_is_told_with_exit_code_3(tmp_path: Path) -> None:
    done = command("look", "pty:./nobody", cwd=tmp_path)
    assert done.returncode == 3
    assert done.stderr == "lidaremu: cannot open ./nobody: No such file or directory\n"
