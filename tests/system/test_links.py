"""Links between real processes: a stranger's serial library, the wall clock, kill -9."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import serial

from tests.system.conftest import TIME_LIMIT_S, favoured
from tests.system.hosts import drift_s

SCRIPT = Path(__file__).with_name("link_process.py")
ROOT = SCRIPT.parent.parent.parent


@contextlib.contextmanager
def serving(url: str, baud: int = 9600, what: str = "echo") -> Iterator[tuple[subprocess.Popen[str], str]]:
    process = subprocess.Popen(
        [*favoured(), sys.executable, str(SCRIPT), url, str(baud), what],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert process.stdout is not None
    try:
        yield process, process.stdout.readline().strip()
    finally:
        process.terminate()
        process.communicate(timeout=TIME_LIMIT_S)


def ask(path: Path | str, data: bytes, baud: int = 9600) -> bytes:
    with serial.Serial(str(path), baud, timeout=TIME_LIMIT_S) as host:
        host.write(data)
        return bytes(host.read(len(data)))


def test_pyserial_talks_to_it_leaves_and_returns(tmp_path: Path) -> None:
    port = tmp_path / "front"
    with serving(f"pty:{port}") as (process, url):
        assert url == f"pty:{port}"
        for number in range(5):
            assert ask(port, b"hello %d" % number) == b"hello %d" % number
        process.terminate()
        assert process.wait(timeout=TIME_LIMIT_S) == 0
    assert os.listdir(tmp_path) == []


def test_killed_at_any_moment_it_leaves_nothing_that_blocks_the_next_start(tmp_path: Path) -> None:
    port = tmp_path / "front"
    for turn in range(3):
        with serving(f"pty:{port}") as (process, _):
            if turn:
                assert ask(port, b"alive") == b"alive"
            process.send_signal(signal.SIGKILL)
            process.wait(timeout=TIME_LIMIT_S)
        assert os.path.islink(port)
    with serving(f"pty:{port}"):
        assert ask(port, b"again") == b"again"
    assert os.listdir(tmp_path) == []


def test_a_second_process_on_the_same_path_is_refused_while_the_first_serves_on(tmp_path: Path) -> None:
    port = tmp_path / "front"
    with serving(f"pty:{port}") as (first, _):
        with serving(f"pty:{port}") as (second, url):
            assert url == ""
            _, errors = second.communicate(timeout=TIME_LIMIT_S)
            assert f"in use by a running emulator (process {first.pid})" in errors
        assert ask(port, b"still") == b"still"


def test_a_host_that_hung_up_in_the_middle_of_the_stream_finds_whole_telegrams_when_it_returns(tmp_path: Path) -> None:
    port = tmp_path / "front"
    with serving(f"pty:{port}", 500_000, "stream"):
        for _ in range(3):
            with serial.Serial(str(port), 500_000, timeout=TIME_LIMIT_S) as host:
                data = host.read(4 * 732)
            assert len(data) == 4 * 732


def test_732_bytes_at_500_kbd_take_14_64_ms_by_the_wall_clock(tmp_path: Path) -> None:
    port = tmp_path / "front"
    telegram = bytes(range(244)) * 3
    with serving(f"pty:{port}", 500_000), serial.Serial(str(port), 500_000, timeout=TIME_LIMIT_S) as host:
        took = [1.0]
        end = time.perf_counter() + TIME_LIMIT_S
        while len(took) < 6 or (min(took) >= 0.050 and time.perf_counter() < end):  # a busy machine makes it later
            began = time.perf_counter()
            host.write(telegram)
            assert host.read(732) == telegram
            took.append(time.perf_counter() - began)
        # the server's step may have begun some microseconds before we wrote: to it that was the instant of our request
        assert 0.0145 < min(took) < 0.050


def test_the_stream_keeps_its_rate(tmp_path: Path) -> None:
    port = tmp_path / "front"
    with serving(f"pty:{port}", 500_000, "stream"), serial.Serial(str(port), 500_000, timeout=TIME_LIMIT_S) as host:
        time.sleep(0.2)
        host.reset_input_buffer()
        stamps = []
        data = b""
        for _ in range(100):
            while len(data) < 732:
                select.select([host.fileno()], [], [], TIME_LIMIT_S)
                data += host.read(host.in_waiting)
            data = data[732:]
            stamps.append(time.perf_counter())
        later_s, apart_s = drift_s(stamps, 37.5)
        assert abs(later_s) < 0.03 * apart_s


def test_a_serial_device_server_is_reached_over_tcp() -> None:
    with serving("tcp:127.0.0.1:0", 38_400) as (_, url):
        port = int(url.rpartition(":")[2])
        with serial.serial_for_url(f"socket://127.0.0.1:{port}", timeout=TIME_LIMIT_S) as host:
            host.write(b"through the server")
            assert host.read(18) == b"through the server"


def test_half_open_connections_by_the_hundred_do_not_keep_a_host_out() -> None:
    with serving("tcp:127.0.0.1:0", 500_000) as (_, url), contextlib.ExitStack() as stack:
        place = ("127.0.0.1", int(url.rpartition(":")[2]))
        for _ in range(300):
            stack.enter_context(socket.create_connection(place, TIME_LIMIT_S))
        host = stack.enter_context(socket.create_connection(place, TIME_LIMIT_S))
        host.sendall(b"hello")
        assert host.recv(5) == b"hello"
