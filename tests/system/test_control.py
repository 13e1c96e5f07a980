"""The control socket of a running daemon, and `lidaremu ctl`."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import stat
from collections.abc import Callable
from pathlib import Path

import pytest

from emulator.cli import main
from emulator.control import LONGEST_LINE, ask
from emulator.errors import EmulatorError, LinkError
from tests.system.hosts import LmsHost


def connect(path: Path) -> socket.socket:
    found = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    found.settimeout(10.0)
    found.connect(str(path))
    return found


def line(connection: socket.socket) -> dict[str, object]:
    text = b""
    while not text.endswith(b"\n"):
        text += connection.recv(65_536)
    return json.loads(text)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "control.sock"


def test_status_and_stop_of_a_real_run(
    daemon: Callable[..., object], path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    running = daemon("flat_wall", "--control", str(path))
    assert running.ready["control"] == f"unix:{path}"
    mode = path.stat().st_mode
    assert stat.S_ISSOCK(mode)
    assert mode & 0o077 == 0
    assert main(["ctl", "status", "--socket", running.ready["control"]]) == 0
    status = json.loads(capsys.readouterr().out)
    assert status["clock"] == "real"
    assert status["sensors"][0]["id"] == "front"
    assert main(["ctl", "pause", "--socket", str(path)]) == 2
    assert "real time goes on" in capsys.readouterr().err
    assert main(["ctl", "stop", "--socket", str(path)]) == 0
    assert running.process.wait(timeout=10.0) == 0
    assert not path.exists()
    assert main(["ctl", "status", "--socket", str(path)]) == 3


def test_a_virtual_run_is_paused_stepped_and_resumed(daemon: Callable[..., object], path: Path) -> None:
    running = daemon("flat_wall", "--clock", "virtual", "--control", str(path))
    with LmsHost(running.path("front")) as host:
        host.set_baud(38_400)
        host.stream()
        host.scan()
        ask(path, "pause", {})
        then = ask(path, "status", {})
        assert then["paused"] is True
        assert ask(path, "status", {})["now_s"] == then["now_s"]
        before = then["sensors"][0]["scans_sent"]
        assert ask(path, "step", {"scans": 3})["scans"] == 3
        assert ask(path, "status", {})["sensors"][0]["scans_sent"] == before + 3
        later = ask(path, "step", {"seconds": 0.5})["now_s"]
        assert later >= then["now_s"] + 0.5
        ask(path, "resume", {})
        for _ in range(8):
            host.scan()
        assert ask(path, "speed", {"x": 2})["now_s"] >= later
    assert running.stop() == 0


def test_garbage_is_answered_and_a_client_that_floods_or_never_reads_is_hung_up_on(
    daemon: Callable[..., object], path: Path
) -> None:
    running = daemon("flat_wall", "--control", str(path))
    with connect(path) as client:
        for sent, code in (
            (b"\x00\xff garbage", -32700),
            (b"[1, 2]", -32600),
            (b'{"method": 3}', -32600),
            (b'{"id": 7, "method": "fly"}', -32601),
            (b'{"id": 7, "method": "status", "params": [1]}', -32602),
            (b'{"id": 7, "method": "status", "params": {"x": 1}}', -32602),
            (b"[" * 5000, -32700),
        ):
            client.sendall(sent + b"\n")
            assert line(client)["error"]["code"] == code, sent
        client.sendall(b'{"id": 9, "method": "sta')
        client.sendall(b'tus"}\n')
        assert line(client)["id"] == 9
    with connect(path) as flood:
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):
            flood.sendall(b"x" * (2 * LONGEST_LINE))
        with contextlib.suppress(ConnectionResetError):
            assert flood.recv(10) == b""
    with connect(path) as deaf:
        deaf.settimeout(2.0)
        try:
            for _ in range(5_000):
                deaf.sendall(b'{"id": 1, "method": "status"}\n')
        except (BrokenPipeError, ConnectionResetError, TimeoutError):
            pass
        assert ask(path, "status", {})["clock"] == "real"
    with LmsHost(running.path("front")) as host:
        assert host.ask(b"\x3a", 0xBA)[1:7] == b"LMS291"
    assert running.stop() == 0


def test_an_order_without_a_daemon_and_a_socket_in_use_are_told(
    daemon: Callable[..., object], tmp_path: Path, path: Path
) -> None:
    with pytest.raises(LinkError, match="no daemon answers"):
        ask(tmp_path / "nobody.sock", "status", {})
    daemon("flat_wall", "--control", str(path))
    with pytest.raises(EmulatorError, match="want one of status"):
        ask(path, "fly", {})
    assert main(["run", "flat_wall", "--link", f"front=pty:{tmp_path / 'x'}", "--control", str(path)]) == 3
    assert ask(path, "status", {})["clock"] == "real"
    assert not os.path.lexists(tmp_path / "x")
