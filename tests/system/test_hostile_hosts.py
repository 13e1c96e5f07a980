"""Hosts that attack every link at once: others get their scans, memory stays, refusals are counted.

`python tests/system/test_hostile_hosts.py` prints the lateness with and without the attack.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import socket
import stat
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from emulator.endurance.growth import cpu_s, look
from emulator.runtime.control import ask
from tests.system.conftest import TIME_LIMIT_S
from tests.system.hosts import LmsHost, telegram

SCENARIO = """\
schema: 1
world:
  - {plane: {size_m: [6, 60]}, at_m: [8, 0, 1], pitch_deg: -90, material: white_plaster}
sensors:
  - id: front
    model: sick-lms291-s05
    device: {interrupt: finish}
    physics: {sub_beams: 1, rule: axis}
    links: ["pty:./front"]
  - {id: line, model: sick-lms291-s05, physics: {sub_beams: 1, rule: axis}, links: ["tcp:127.0.0.1:0", "pty:./line"]}
  - {id: top, model: sick-ld-lrs1000, device: {delays: fast}, links: ["tcp:127.0.0.1:0", "udp:127.0.0.1:9?listen=0"]}
  - {id: objects, model: can-ars408, from: [front], links: ["socketcand:127.0.0.1:0/can0"]}
  - {id: more, model: can-ars408, from: [front], links: ["slcan:./can"]}
"""
MOST_MB_MORE = 40.0
"What an attack may add to the daemon's memory: buffers of 64 hosts a listening socket, and Python's own arenas."
ATTACK = """
import contextlib, json, os, random, socket, sys, time
rng = random.Random(4)
tcp, ptys, udp, control, seconds = json.loads(sys.argv[1])
USP = bytes.fromhex("02555350000000020101") + b"\\0"
WORDS = (b"< open can0 >< rawmode >", b"< send 123 8 1 2 3 4 5 6 7 8 >", USP, bytes.fromhex("020001003131") + b"\\x12",
         b"\\x02U", b"\\x02\\x00", b"\\r", b"t12380011223344556677\\r", b'{"method": "status", "id": 1}\\n')
ends, flooders = [], []
for port in tcp:
    for _ in range(4):
        one = socket.create_connection(("127.0.0.1", port)); one.setblocking(False); flooders.append(one)
for path in ptys:
    flooders.append(os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK))
for _ in range(4):
    one = socket.socket(socket.AF_UNIX); one.connect(control); one.setblocking(False); flooders.append(one)
datagrams = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
end = time.monotonic() + seconds
count = 0
while time.monotonic() < end or count <= 300:
    for one in flooders:
        word = rng.choice(WORDS)
        data = rng.randbytes(2000) if rng.random() < 0.4 else word * (2000 // len(word))
        with contextlib.suppress(OSError):
            one.send(data) if isinstance(one, socket.socket) else os.write(one, data)
    datagrams.sendto(rng.randbytes(500), ("127.0.0.1", udp))
    for port in tcp:  # connections that say nothing, and never read
        with contextlib.suppress(OSError):
            one = socket.socket(); one.setblocking(False); one.connect_ex(("127.0.0.1", port)); count += 1
            ends.append(one)
    if len(ends) > 800:
        for one in ends[:400]:
            one.close()
        del ends[:400]
    time.sleep(0.002)
for one in flooders:
    one.close() if isinstance(one, socket.socket) else os.close(one)
print(count, flush=True)
sys.stdin.read()
"""
"Those that say nothing stay until somebody closes its input."


def port_of(url: str) -> int:
    return int(url.partition("/")[0].rpartition(":")[2])


class Battle:
    """A daemon under attack, and a host that behaves on another link."""

    def __init__(self, ready: dict[str, Any], pid: int, folder: Path) -> None:
        self.links = {row["id"]: row["links"] for row in ready["sensors"]}
        self.control = Path(ready["control"].partition(":")[2])
        self.pid, self.folder = pid, folder

    def status(self) -> dict[str, Any]:
        found: Any = ask(self.control, "status", {})
        return {row["id"]: row for row in found["sensors"]}

    @contextlib.contextmanager
    def attack(self, seconds: float) -> Iterator[list[int]]:
        """Attack for so long, and until the daemon has met it; holds the number of connections once it is over."""
        tcp = [port_of(self.links[name][0]) for name in ("line", "top", "objects")]
        ptys = [str(self.folder / name) for name in ("line", "can")]
        reported = json.dumps((tcp, ptys, port_of(self.links["top"][1]), str(self.control), seconds))
        words = [sys.executable, "-c", ATTACK, reported]
        with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
            opened: list[int] = []
            yield opened
            assert process.stdout is not None
            opened.append(int(process.stdout.readline()))
            end = time.monotonic() + TIME_LIMIT_S
            while not all(turned_away(self.status())) and time.monotonic() < end:  # a starved daemon is behind
                time.sleep(0.05)

    def answers(self, sensor: str, seconds: float) -> bool:
        """Whether a new host on the sensor's TCP port gets the status of an LMS within that time."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            with (
                contextlib.suppress(OSError),
                socket.create_connection(("127.0.0.1", port_of(self.links[sensor][0])), timeout=2.0) as connection,
            ):
                connection.sendall(telegram(b"\x31"))
                seen = b""
                while data := connection.recv(4096):
                    seen += data
                    if re.search(b"\x02\x80..\xb1", seen, re.DOTALL):
                        return True
        return False

    def scans(self, host: LmsHost, seconds: float) -> int:
        """Scans with a good CRC that a host reads in that time, each whole."""
        count, end = 0, time.monotonic() + seconds
        while time.monotonic() < end:
            count += len(host.scan()) == 361
        return count


def listeners(pid: int) -> dict[str, list[str]]:
    """Addresses on which a process listens (TCP) or receives (UDP), as the kernel tells."""
    inodes = set()
    for name in os.listdir(f"/proc/{pid}/fd"):
        with contextlib.suppress(FileNotFoundError):
            target = os.readlink(f"/proc/{pid}/fd/{name}")
            if target.startswith("socket:["):
                inodes.add(target[8:-1])
    found: dict[str, list[str]] = {}
    for kind, wanted in (("tcp", "0A"), ("tcp6", "0A"), ("udp", "07"), ("udp6", "07")):
        for row in Path(f"/proc/{pid}/net/{kind}").read_text().splitlines()[1:]:
            words = row.split()
            if words[3] == wanted and words[9] in inodes:
                found.setdefault(kind, []).append(words[1].partition(":")[0])
    return found


def turned_away(status: dict[str, Any]) -> tuple[int, int, int]:
    """Hosts that `top` has refused, and what was dropped of the input of `line` and `top`."""
    dropped = [sum(status[name]["input_dropped"].values()) for name in ("line", "top")]
    return sum(link["hosts_refused"] for link in status["top"]["links"]), dropped[0], dropped[1]


def test_an_attack_on_every_link_costs_the_others_nothing_but_time(
    daemon: Callable[..., Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "battle.yaml").write_text(SCENARIO)
    running = daemon("battle.yaml", "--control", str(tmp_path / "control.sock"))
    battle = Battle(running.ready, running.process.pid, tmp_path)
    with LmsHost(battle.links["front"][0].partition(":")[2]) as host:
        host.set_baud(500_000)
        host.stream()
        whole = int(len(host.scan()) == 361)
        before, cpu_before = look(0.0, battle.pid), cpu_s(battle.pid)
        with battle.attack(3.0) as opened:
            began = time.monotonic()
            got = battle.scans(host, 3.0)
            took = time.monotonic() - began
            peak = look(0.0, battle.pid)
            whole += got + host.stop()
        assert battle.answers("line", 30.0), "the flood is over: a newcomer is heard"
        share = (cpu_s(battle.pid) - cpu_before) / took
        after, status = look(0.0, battle.pid), battle.status()
    mb = [one.rss_bytes / 1e6 for one in (before, peak, after)]
    with capsys.disabled():
        sys.stdout.write(
            f"\nattack: {opened[0]} connections, {got} scans read in {took:.1f} s, daemon {mb[0]:.1f} MB before,"
            f" {mb[1]:.1f} in, {mb[2]:.1f} after; {share:.0%} of a core\n"
        )
    front = status["front"]
    dropped = sum(front["scans_dropped"].values())
    assert whole == front["scans_sent"]  # whatever the machine let the daemon send, the host has
    assert front["scans_dropped"].keys() <= {"measured too late", "withdrawn by a changed setting"}
    assert got + dropped >= 0.8 * 37.5 * took
    assert not front["input_dropped"]
    assert max(mb) - mb[0] < MOST_MB_MORE
    assert opened[0] > 300
    refused, line, top = turned_away(status)
    assert refused > 0
    assert line > 0
    assert top > 0
    assert running.stop() == 0, running.errors
    assert "Traceback" not in running.errors


def test_nothing_listens_beyond_this_machine_and_control_is_its_owners(
    daemon: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "runtime"))
    (tmp_path / "runtime").mkdir()
    (tmp_path / "battle.yaml").write_text(SCENARIO)
    running = daemon("battle.yaml")
    heard = listeners(running.process.pid)
    assert set(heard) == {"tcp", "udp"}
    assert len(heard["tcp"]) == 3
    assert set(heard["tcp"]) == {"0100007F"}  # 127.0.0.1
    assert set(heard["udp"]) == {"0100007F"}
    path = Path(running.ready["control"].partition(":")[2])
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700
    assert path.stat().st_uid == os.getuid()
    assert running.stop() == 0


def main(folder: Path) -> None:
    """Lateness of a sensor without and with the attack."""
    (folder / "battle.yaml").write_text(SCENARIO)
    for attacked in (False, True, False, True):
        options = ["--json", "--control", str(folder / "control.sock")]
        process = subprocess.Popen(
            [sys.executable, "-m", "emulator", "run", "battle.yaml", *options],
            cwd=folder,
            stdout=subprocess.PIPE,
            text=True,
            env=dict(os.environ) | {"PYTHONPATH": str(Path(__file__).resolve().parents[2])},
        )
        assert process.stdout is not None
        battle = Battle(json.loads(process.stdout.readline()), process.pid, folder)
        with LmsHost(str(folder / "front")) as host:
            host.set_baud(500_000)
            host.stream()
            host.scan()
            before = cpu_s(process.pid)
            with battle.attack(8.0) if attacked else contextlib.nullcontext():
                got = battle.scans(host, 8.0)
            share = (cpu_s(process.pid) - before) / 8.0
        process.terminate()
        out = process.communicate()[0].splitlines()[-1]
        front = next(row for row in json.loads(out)["sensors"] if row["id"] == "front")
        late = front["lateness_us"]
        sys.stdout.write(
            f"{'attack' if attacked else 'quiet '}: {got} scans, dropped {front['scans_dropped']}, lateness median"
            f" {late['median']:.0f} us, p99 {late['p99']:.0f} us, worst {late['worst']:.0f} us; {share:.0%} of a core\n"
        )


if __name__ == "__main__":
    import tempfile

    with tempfile.TemporaryDirectory() as name:
        main(Path(name))
