"""The control socket of a running daemon, and `lidaremu ctl`."""

from __future__ import annotations

import contextlib
import json
import os
import re
import socket
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from emulator.commands.cli import main
from emulator.errors import EmulatorError, LinkError
from emulator.recording.reader import read_run
from emulator.runtime.control import LONGEST_LINE, ask
from tests.system.conftest import TIME_LIMIT_S
from tests.system.hosts import LmsHost


def connect(path: Path) -> socket.socket:
    found = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    found.settimeout(TIME_LIMIT_S)
    found.connect(str(path))
    return found


def line(connection: socket.socket) -> dict[str, Any]:
    """One answer, byte by byte: what comes behind it stays for the next call."""
    text = b""
    while not text.endswith(b"\n"):
        more = connection.recv(65_536, socket.MSG_PEEK)
        assert more, text
        text += connection.recv(more.find(b"\n") + 1 or len(more))
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
    for method in ("glance", "scans", "telegrams", "scene", "fault_clear"):  # whatever the socket offers
        assert main(["ctl", method, "--socket", str(path)]) == 0
    assert main(["ctl", "scene", "at=0", "--socket", str(path)]) == 0
    assert "plane" in json.loads(capsys.readouterr().out.splitlines()[-1])["yaml"]
    assert main(["ctl", "dance", "--socket", str(path)]) == 2
    assert "want one of status" in capsys.readouterr().err
    assert main(["ctl", "pause", "--socket", str(path)]) == 2
    assert "not possible in real time" in capsys.readouterr().err
    assert main(["ctl", "stop", "--socket", str(path)]) == 0
    assert running.process.wait(timeout=TIME_LIMIT_S) == 0
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


@pytest.mark.parametrize("clock", [(), ("--clock", "virtual")], ids=["real", "virtual"])
def test_weather_ordered_from_a_shell_changes_what_the_host_reads(
    daemon: Callable[..., object],
    path: Path,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    clock: tuple[str, ...],
) -> None:
    running = daemon("flat_wall", "--control", str(path), "--record", str(tmp_path / "kept"), *clock)

    def ctl(*words: str) -> int:
        return main(["ctl", *words, "--socket", str(path)])

    with LmsHost(running.path("front")) as host:
        host.set_baud(500_000)
        host.stream()
        assert 795 <= host.scan()[180] <= 805
        assert ctl("weather", "fog.visibility_m=-5") == 2
        assert "weather: fog.visibility_m: -5; want a number > 0" in capsys.readouterr().err
        assert ctl("weather", "fog.visibility_m=3", "fog.law=kruse") == 0
        reported = json.loads(capsys.readouterr().out)
        assert reported["now_s"] <= reported["from_s"] <= reported["now_s"] + 0.3
        assert reported["weather"]["fog"]["law"] == "kruse"
        assert any(not 790 <= host.scan()[180] <= 810 for _ in range(600))
        assert ctl("weather", "fog=null") == 0
        assert any(795 <= host.scan()[180] <= 805 for _ in range(600))
    capsys.readouterr()
    assert ctl("weather") == 0
    assert "fog" not in json.loads(capsys.readouterr().out)["weather"]
    assert running.stop() == 0
    orders = [row for _, _, row in read_run(tmp_path / "kept").events if row.get("order") == "weather"]
    assert orders[0]["change"]["t_s"] == reported["from_s"]  # type: ignore[index]
    assert orders[1]["change"]["fog"] is None  # type: ignore[index]


def test_a_virtual_run_is_stepped_by_bytes_and_to_an_instant(daemon: Callable[..., object], path: Path) -> None:
    running = daemon("two_sensors", "--clock", "virtual", "--control", str(path))
    one, other = [item["id"] for item in running.ready["sensors"]][:2]
    ask(path, "pause", {})
    with LmsHost(running.path(one)) as host:
        host.port.write(bytes.fromhex("020002003001 3118".replace(" ", "")))
        before = ask(path, "status", {})["sensors"]
        host.port.flush()
        now_s = [ask(path, "step", {"bytes": count})["now_s"] for count in (1, 4, 4)]
        after = ask(path, "status", {})["sensors"]
        moved = [b["links"][0]["bytes_out"] - a["links"][0]["bytes_out"] for a, b in zip(before, after, strict=True)]
        assert moved[0] == 9
        assert now_s[2] - now_s[1] == pytest.approx(4 * 10 / 9600, abs=1e-6)  # a byte takes ten bits
        assert ask(path, "step", {"to_s": now_s[2] + 0.25})["now_s"] == pytest.approx(now_s[2] + 0.25, abs=1e-9)
        assert ask(path, "step", {"bytes": 5, "sensor": other, "link": 0})["bytes"] == 0  # nobody asked it for anything
    for wrong, reported in (
        ({"to_s": 0}, "to_s: 0; want"),
        ({"bytes": 1, "seconds": 1}, "want one of scans, bytes, seconds, to_s"),
        ({"bytes": 1, "sensor": "nose"}, "sensor: 'nose'; want one of"),
        ({"bytes": 1, "link": 7}, "link: 7; "),
        ({"seconds": 1, "sensor": one}, "want sensor for scans and bytes"),
    ):
        with pytest.raises(EmulatorError, match=re.escape(reported)):
            ask(path, "step", wrong)
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
    for end in (b"", b"\n"):
        with connect(path) as flood:
            with contextlib.suppress(BrokenPipeError, ConnectionResetError):
                flood.sendall(b"x" * 1_000_000 + end)
            with contextlib.suppress(ConnectionResetError):
                assert f"longer than {LONGEST_LINE} bytes" in line(flood)["error"]["message"]
                assert flood.recv(10) == b""
    for half in (b"", b'{"id": 1, "meth', b'{"id": 1, "method": "status"}\n{"id"'):
        with connect(path) as gone:
            gone.sendall(half)  # and away, in the middle of a line or before the answer
    with connect(path) as eager:
        eager.sendall(b'{"id": 1, "method": "metrics"}\n' * 500)
        assert [line(eager)["id"] for _ in range(500)] == [1] * 500  # more than may wait unread, but it reads
    with contextlib.ExitStack() as crowd:
        half = [crowd.enter_context(connect(path)) for _ in range(16)]
        for one in half:
            one.sendall(b'{"id": 1, "method"')
        with connect(path) as late:
            assert "clients are connected already" in line(late)["error"]["message"]
        for one in half:
            one.sendall(b': "glance"}\n')
            assert line(one)["id"] == 1
    with connect(path) as not_reading:
        not_reading.settimeout(2.0)
        try:
            for _ in range(5_000):
                not_reading.sendall(b'{"id": 1, "method": "status"}\n')
        except (BrokenPipeError, ConnectionResetError, TimeoutError):
            pass
        assert ask(path, "status", {})["clock"] == "real"
    with LmsHost(running.path("front")) as host:
        assert host.ask(b"\x3a", 0xBA)[1:7] == b"LMS291"
    assert running.stop() == 0


def test_two_hundred_silent_clients_lock_nobody_out(daemon: Callable[..., object], path: Path) -> None:
    daemon("flat_wall", "--control", str(path))
    with contextlib.ExitStack() as crowd:
        working = crowd.enter_context(connect(path))
        working.sendall(b'{"id": 1, "method": "status"')  # the rest comes when all the others are there
        first = crowd.enter_context(connect(path))
        first.sendall(b'{"id": 2, "method": "glance"}\n')
        assert line(first)["id"] == 2
        for number in range(200):
            crowd.enter_context(connect(path))
            if number % 20 == 0:
                assert main(["ctl", "glance", "--socket", str(path)]) == 0
        assert "longest idle of 16 clients when a new one connected" in line(first)["error"]["message"]
        assert first.recv(1) == b""
        working.sendall(b"}\n")
        assert line(working)["id"] == 1


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
