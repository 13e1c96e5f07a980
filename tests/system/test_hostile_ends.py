"""kill -9 at any moment: the next start has the same links at once, workers are gone, the recording is readable."""

from __future__ import annotations

import contextlib
import json
import os
import random
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

from emulator.recording.reader import RecordingError, read_run
from tests.system.conftest import TIME_LIMIT_S
from tests.system.hosts import LmsHost

ROOT = Path(__file__).resolve().parents[2]
SCENARIO = """\
schema: 1
world:
  - {plane: {size_m: [6, 60]}, at_m: [8, 0, 1], pitch_deg: -90, material: white_plaster}
sensors:
  - {id: front, model: sick-lms291-s05, links: ["pty:./front"]}
  - {id: top, model: sick-ld-lrs1000, device: {delays: fast}, links: ["tcp:127.0.0.1:%d"]}
  - {id: objects, model: can-ars408, from: [front], links: ["socketcand:127.0.0.1:%d/can0"]}
  - {id: more, model: can-ars408, from: [front], links: ["slcan:./can"]}
"""


def free_ports(count: int) -> list[int]:
    sockets = [socket.create_server(("127.0.0.1", 0)) for _ in range(count)]
    ports = [one.getsockname()[1] for one in sockets]
    for one in sockets:
        one.close()
    return ports


def children(pid: int) -> list[int]:
    text = Path(f"/proc/{pid}/task/{pid}/children").read_text()
    return [int(word) for word in text.split()]


def alive(pid: int) -> bool:
    """Whether a process runs; one that has ended and was not waited for yet does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except FileNotFoundError:
        return False


class Bench:
    """Starts of one scenario on the same links."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.ports = free_ports(2)
        (folder / "bench.yaml").write_text(SCENARIO % tuple(self.ports))
        self.runs = 0

    def start(self) -> subprocess.Popen[str]:
        self.runs += 1
        options = ["--json", "--control", "control.sock", "--record", f"run{self.runs}"]
        return subprocess.Popen(
            [sys.executable, "-m", "emulator", "run", "bench.yaml", *options],
            cwd=self.folder,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=dict(os.environ) | {"PYTHONPATH": str(ROOT)},
        )

    def ready(self, process: subprocess.Popen[str]) -> None:
        assert process.stdout is not None
        first = process.stdout.readline()
        if not first:
            raise AssertionError(process.communicate(timeout=TIME_LIMIT_S)[1])
        assert json.loads(first)["event"] == "ready"

    def kill(self, process: subprocess.Popen[str]) -> None:
        """Kill it, and see its workers end."""
        workers = children(process.pid)
        began = time.monotonic()
        process.kill()
        while any(alive(pid) for pid in workers):
            assert time.monotonic() - began < TIME_LIMIT_S, "a worker outlives its daemon"
            time.sleep(0.01)
        process.communicate()


def test_a_killed_daemon_leaves_nothing_that_blocks_the_next(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    rng = random.Random(8)
    for _ in range(2):  # before it is ready: imports, workers, links half open
        process = bench.start()
        time.sleep(rng.uniform(0.1, 2.0))
        bench.kill(process)

    process = bench.start()  # while hosts are connected to everything, and a scan streams
    bench.ready(process)
    hosts = contextlib.ExitStack()
    with hosts:
        for port in bench.ports:
            hosts.enter_context(socket.create_connection(("127.0.0.1", port)))
        control = hosts.enter_context(socket.socket(socket.AF_UNIX))
        control.connect(str(tmp_path / "control.sock"))
        host = hosts.enter_context(LmsHost(str(tmp_path / "front")))
        host.set_baud(38_400)
        host.stream()
        for _ in range(15):  # a second of them: of the last half nothing may be on the disk
            assert len(host.scan()) == 361
        time.sleep(rng.uniform(0.0, 0.1))
        assert children(process.pid)
        bench.kill(process)

        process = bench.start()  # at once, with the hosts of the old one still there
        bench.ready(process)
    with LmsHost(str(tmp_path / "front")) as host:
        host.stream()
        assert len(host.scan()) == 361
    socket.create_connection(("127.0.0.1", bench.ports[0])).close()
    with socket.create_connection(("127.0.0.1", bench.ports[1]), timeout=TIME_LIMIT_S) as client:
        assert client.recv(100).startswith(b"< hi >")
    assert (tmp_path / "can").exists()
    process.send_signal(signal.SIGTERM)
    _, errors = process.communicate(timeout=TIME_LIMIT_S)
    assert process.returncode == 0, errors
    left = {path.name for path in tmp_path.iterdir()} - {"bench.yaml"}
    assert {name for name in left if not name.startswith("run")} == set()

    killed = read_run(tmp_path / "run3")
    assert killed.cut
    assert sum(len(wire.payloads) for wire in killed.sent.values()) > 3
    for number in (1, 2):  # nothing yet, or a readable beginning
        with contextlib.suppress(RecordingError):
            read_run(tmp_path / f"run{number}")
