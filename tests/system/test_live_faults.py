"""Faults ordered while real links are served: on a serial line and by datagram they reach the wire, a delay that is
cleared lets go; and a port that was flooded takes a new host in.
"""

from __future__ import annotations

import contextlib
import select
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from emulator.runtime.control import ask
from tests.protocols.ld.reader import read_profile
from tests.system.conftest import TIME_LIMIT_S, RunningDaemon
from tests.system.hosts import Adapter, EndOfLine, LdHost, LmsHost, crc, xor

WORLD = """\
schema: 1
world:
  - {box: {size_m: [0.3, 50, 4]}, at_m: [10, 0, 0], material: concrete}
sensors:
"""
LINE = '  - {id: line, model: sick-lms291-s05, links: ["serial:ADAPTER"], device: {delays: fast}}\n'
AIR = '  - {id: air, model: sick-ld-lrs1000, links: ["udp:127.0.0.1:PORT"], device: {delays: fast, step_deg: 2}}\n'
TOP = '  - {id: top, model: sick-ld-lrs1000, links: ["tcp:127.0.0.1:0"], device: {delays: fast, step_deg: 2}}\n'


def started(daemon: Callable[..., RunningDaemon], folder: Path, sensor: str) -> RunningDaemon:
    (folder / "case.yaml").write_text(WORLD + sensor, encoding="utf-8")
    return daemon("case.yaml", "--control", str(folder / "control"))


def until(holds: Callable[[], bool]) -> None:
    end = time.monotonic() + TIME_LIMIT_S
    while not holds():
        assert time.monotonic() < end, "not in time"
        time.sleep(0.02)


def order(running: RunningDaemon, method: str, **params: object) -> dict[str, Any]:
    found: Any = ask(running.control, method, params)
    return found


def status(running: RunningDaemon) -> dict[str, Any]:
    found: dict[str, Any] = order(running, "status")["sensors"][0]
    return found


def judged(frames: Iterator[bool], wanted: int, more: int) -> list[bool]:
    """Whether each telegram's check is right, until so many were wrong, and of so many behind them."""
    found: list[bool] = []
    end = time.monotonic() + TIME_LIMIT_S
    while found.count(False) < wanted:
        assert time.monotonic() < end, f"{found.count(False)} wrong ones of {len(found)}"
        found.append(next(frames))
    return [next(frames) for _ in range(more)]


def line_frames(host: LmsHost) -> Iterator[bool]:
    """Frames of a line one behind the other, from a whole one on."""
    data = host.seen
    while True:
        if len(data) < 4 or len(data) < (length := int.from_bytes(data[2:4], "little") + 6):
            data += host.port.read(65_536)
            continue
        assert data[:2] == b"\x02\x80"
        yield crc(data[: length - 2]) == data[length - 2 : length]
        data = data[length:]


def datagrams(host: socket.socket) -> Iterator[bool]:
    """Of each datagram: it is one frame."""
    while True:
        data = host.recv(70_000)
        assert data[:4] == b"\x02USP"
        assert len(data) == 9 + int.from_bytes(data[4:8], "big")
        yield xor(data[8:-1]) == data[-1]


def test_a_fault_on_a_serial_line(daemon: Callable[..., RunningDaemon], tmp_path: Path) -> None:
    with contextlib.closing(Adapter()) as adapter:
        running = started(daemon, tmp_path, LINE.replace("ADAPTER", adapter.path))
        host = LmsHost.on(EndOfLine(adapter.host))
        host.stream()
        assert len(host.scan()) == 361
        frames = line_frames(host)
        assert next(frames)
        order(running, "fault", on="line", do="bad_checksum", count=3)
        assert judged(frames, 3, 5) == [True] * 5
        (row,) = order(running, "faults")["faults"]
        assert (row["hits"], row["state"]) == (3, "over")
        assert running.stop() == 0


def test_a_fault_by_datagram(daemon: Callable[..., RunningDaemon], tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as host:
        host.settimeout(TIME_LIMIT_S)
        host.bind(("127.0.0.1", 0))
        running = started(daemon, tmp_path, AIR.replace("PORT", str(host.getsockname()[1])))
        frames = datagrams(host)
        assert next(frames)
        order(running, "fault", on="air", do="bad_checksum", count=3)
        assert judged(frames, 3, 5) == [True] * 5
        (row,) = order(running, "faults")["faults"]
        assert (row["hits"], row["state"]) == (3, "over")
        assert running.stop() == 0


def test_a_long_delay_on_a_connection_that_is_cleared_lets_go_of_what_it_held(
    daemon: Callable[..., RunningDaemon], tmp_path: Path
) -> None:
    running = started(daemon, tmp_path, TOP)
    sent: list[int] = []
    with LdHost(int(running.link("top").rpartition(":")[2])) as host:
        host.measure()
        assert host.ask(0x0301, 0, 0x3FFF)[0] == 0x3FFF  # the first profile is the reply

        def take() -> None:
            """What has come."""
            while select.select([host.socket], [], [], 0)[0] or len(host.seen) >= 9:
                words = host.next()
                sent.append(read_profile(b"".join(word.to_bytes(2, "big") for word in words)).sent)

        def measured_more(count: int) -> None:
            before = status(running)["scans_measured"]
            until(lambda: status(running)["scans_measured"] >= before + count)

        number = order(running, "fault", on="top", do="delay_telegram", delay_s=3600)["number"]
        until(lambda: order(running, "faults")["faults"][0]["hits"] > 0)
        take()
        measured_more(5)
        assert not select.select([host.socket], [], [], 0)[0], "all behind it waits too"
        early = len(sent)
        order(running, "fault_clear", number=number)
        until(lambda: take() or len(sent) >= early + 8)
        assert running.stop() == 0
        with contextlib.suppress(AssertionError):  # the device has closed the connection
            while True:
                take()
    assert sent == sorted(set(sent))
    assert len(sent) + 1 == running.end["top"]["scans_sent"]
    assert not running.end["top"]["links"][0]["bytes_lost"]


def test_a_flooded_port_takes_a_new_host_in_when_its_floods_have_gone(
    daemon: Callable[..., RunningDaemon], tmp_path: Path
) -> None:
    running = started(daemon, tmp_path, TOP)
    port = int(running.link("top").rpartition(":")[2])
    with contextlib.ExitStack() as floods:
        for _ in range(64):
            one = floods.enter_context(socket.create_connection(("127.0.0.1", port), TIME_LIMIT_S))
            one.setblocking(False)
            with contextlib.suppress(BlockingIOError):
                while True:
                    one.send(b"\xaa" * 65_536)
        admitted(port)  # reset, or on a machine that took ten seconds until here in the place of a flood
        assert status(running)["links"][0]["hosts_refused"] > 0
    until(lambda: admitted(port))
    with LdHost(port) as host:
        host.measure()
    assert running.stop() == 0


def admitted(port: int) -> bool:
    """Whether one who comes is answered; one whose place is taken is reset."""
    try:
        with LdHost(port) as host:
            return bool(host.ask(0x0102))
    except (ConnectionResetError, BrokenPipeError):
        return False
