"""Ten sensors flooded at once, an attacker each, and the control socket: a victim keeps its rate, memory stays.

`python -m tests.system.test_flood [SECONDS]` prints the victim's scans, lateness, memory and processor time without
and with the attack. Judge them by `waits`: the share of time in which a thread wanted a core and had none.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from emulator.endurance.growth import look
from tests.system.hosts import LmsHost

LMS = "model: sick-lms291-s05, physics: {sub_beams: 1, rule: axis}"
LD = "model: sick-ld-lrs1000, device: {delays: fast}, physics: {sub_beams: 1, rule: axis}"
LIST = "model: can-ars408, from: [front]"
SCENARIO = f"""\
schema: 1
world:
  - {{plane: {{size_m: [6, 60]}}, at_m: [8, 0, 1], pitch_deg: -90, material: white_plaster}}
sensors:
  - {{id: front, {LMS}, device: {{interrupt: finish}}, links: ["pty:./front"]}}
  - {{id: line1, {LMS}, links: ["pty:./line1"]}}
  - {{id: line2, {LMS}, links: ["pty:./line2"]}}
  - {{id: served, {LMS}, links: ["tcp:127.0.0.1:0"]}}
  - {{id: top1, {LD}, links: ["tcp:127.0.0.1:0"]}}
  - {{id: top2, {LD}, links: ["tcp:127.0.0.1:0"]}}
  - {{id: top3, {LD}, links: ["udp:127.0.0.1:9?listen=0"]}}
  - {{id: list1, {LIST}, links: ["socketcand:127.0.0.1:0/can0"]}}
  - {{id: list2, {LIST}, links: ["socketcand:127.0.0.1:0/can0?bitrate=1000000"]}}
  - {{id: list3, {LIST}, links: ["slcan:./can1"]}}
  - {{id: list4, {LIST}, links: ["slcan:./can2"]}}
"""
ATTACKERS = [
    ("line", "line1", 1),
    ("line", "line2", 1),
    ("stream", "served", 8),
    ("stream", "top1", 8),
    ("stream", "top2", 64),
    ("datagrams", "top3", 1),
    ("bus", "list1", 8),
    ("deaf", "list2", 64),
    ("adapter", "list3", 1),
    ("adapter", "list4", 1),
    ("control", "", 4),
    ("deaf-control", "", 12),
]
"Kind, sensor (none: the control socket), connections."
MOST_MB_MORE = 16.0
"""What the attack may add to the daemon's memory. 3 to 6 MB are measured: a megabyte for all deaf hosts of a socket,
64 frames for each of 64 clients, a megabyte of answers that nobody reads, and what Python keeps of all that."""
MOST_OF_A_CORE = 0.9
"Of the sending thread: its own work, a fifth for what all strangers want, a tenth for orders."
LEAST = 0.5
"Of the scans that the machine left time for. Measured beside other programs on both cores: 1.2 and more."


@dataclass
class Shares:
    """Processor time of a thread, and time in which it waited for a core, as shares."""

    cpu: float
    waits: float

    @property
    def left(self) -> float:
        """Of the time that it wanted a core it had one."""
        return self.cpu / max(1e-9, self.cpu + self.waits)


class Threads:
    """What the sender, the control's thread and the worker take, since this was made."""

    def __init__(self, pid: int) -> None:
        worker, *_ = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()  # loops may be being built, too
        self._stats = {
            "sender": Path(f"/proc/{pid}/task/{pid}/schedstat"),
            "worker": Path(f"/proc/{worker}/task/{worker}/schedstat"),
        }
        self._before = self._now()
        self._began_s = time.monotonic()

    def _now(self) -> dict[str, tuple[int, int]]:
        rows = {name: path.read_text().split() for name, path in self._stats.items()}
        return {name: (int(cpu), int(waits)) for name, (cpu, waits, _) in rows.items()}

    def shares(self) -> dict[str, Shares]:
        took_ns = (time.monotonic() - self._began_s) * 1e9
        now = self._now()
        return {
            name: Shares(*((now[name][k] - self._before[name][k]) / took_ns for k in (0, 1))) for name in self._stats
        }


def place_of(url: str) -> str:
    """Path or port of a link."""
    kind, _, rest = url.partition(":")
    if kind in ("pty", "slcan"):
        return rest
    return rest.partition("/")[0].replace("?listen=", ":").rpartition(":")[2]


@contextlib.contextmanager
def attack(ready: dict[str, Any], seconds: float) -> Iterator[Callable[[], bool]]:
    """All attackers for so long, each a process; what is given tells whether any of them is still there."""
    links = {row["id"]: row["links"][0] for row in ready["sensors"]}
    places = {name: place_of(url) for name, url in links.items()} | {"": ready["control"].partition(":")[2]}
    started = [
        subprocess.Popen(
            [sys.executable, "-m", "tests.system.attackers", kind, str(seconds), places[name], str(count)],
            cwd=Path(__file__).resolve().parents[2],
            stdout=subprocess.PIPE,
            text=True,
        )
        for kind, name, count in ATTACKERS
    ]
    try:
        yield lambda: any(one.poll() is None for one in started)
        for one in started:
            assert json.loads(one.communicate(timeout=60)[0])["written"] > 0
    finally:
        for one in started:
            one.kill()
            one.communicate()


@dataclass
class Outcome:
    """What the victim's host and the kernel say of a while."""

    scans: int
    took_s: float
    mb: tuple[float, float]
    "Before, and the most of during and after."
    shares: dict[str, Shares]


def outcome(ready: dict[str, Any], pid: int, host: LmsHost, seconds: float, attacked: bool) -> Outcome:
    before = look(0.0, pid).rss_bytes / 1e6
    threads, began_s, scans, peak = Threads(pid), time.monotonic(), 0, before
    with attack(ready, seconds) if attacked else contextlib.nullcontext(lambda: False) as goes_on:
        while time.monotonic() - began_s < seconds or goes_on():  # a host that stops reading loses bytes
            scans += len(host.scan()) == 361
            peak = max(peak, look(0.0, pid).rss_bytes / 1e6)
        took_s, shares = time.monotonic() - began_s, threads.shares()
    return Outcome(scans, took_s, (before, max(peak, look(0.0, pid).rss_bytes / 1e6)), shares)


def test_ten_attackers_on_ten_sensors_leave_the_victim_what_the_machine_leaves(
    daemon: Callable[..., Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "flood.yaml").write_text(SCENARIO)
    running = daemon("flood.yaml", "--control", str(tmp_path / "control.sock"))
    with LmsHost(running.path("front")) as host:
        host.set_baud(500_000)
        host.stream()
        whole = int(len(host.scan()) == 361)
        found = outcome(running.ready, running.process.pid, host, 4.0, attacked=True)
        whole += found.scans + host.stop()
    with capsys.disabled():
        sys.stdout.write(f"\n{found}\n")
    assert running.stop() == 0, running.errors
    assert "Traceback" not in running.errors
    front = running.end["front"]
    assert whole == front["scans_sent"]
    assert front["scans_dropped"].keys() <= {"measured too late", "withdrawn by a changed setting"}
    assert not front["input_dropped"]
    assert found.mb[1] - found.mb[0] < MOST_MB_MORE
    assert found.shares["sender"].cpu < MOST_OF_A_CORE
    left = found.shares["sender"].left * found.shares["worker"].left
    assert found.scans >= LEAST * 37.5 * found.took_s * left
    assert sum(running.end["list2"]["links"][0][key] for key in ("bytes_in", "hosts_refused")) > 0


def main(folder: Path, seconds: float) -> None:
    """The table."""
    (folder / "flood.yaml").write_text(SCENARIO)
    for attacked in (False, True, False, True):
        process = subprocess.Popen(
            [
                sys.executable,
                "-m",
                "emulator",
                "run",
                "flood.yaml",
                "--json",
                "--control",
                str(folder / "control.sock"),
            ],
            cwd=folder,
            stdout=subprocess.PIPE,
            text=True,
            env=dict(os.environ) | {"PYTHONPATH": str(Path(__file__).resolve().parents[2])},
        )
        assert process.stdout is not None
        ready = json.loads(process.stdout.readline())
        load = os.getloadavg()[0]
        with LmsHost(str(folder / "front")) as host:
            host.set_baud(500_000)
            host.stream()
            host.scan()
            found = outcome(ready, process.pid, host, seconds, attacked)
        process.terminate()
        end = json.loads(process.communicate()[0].splitlines()[-1])
        front = next(row for row in end["sensors"] if row["id"] == "front")
        late = {name: front["lateness_us"][name] / 1e3 for name in ("median", "p99", "worst")}
        cores = "; ".join(
            f"{name} {one.cpu:.0%} of a core, waits {one.waits:.0%}" for name, one in found.shares.items()
        )
        sys.stdout.write(
            f"{'attack' if attacked else 'quiet '}: load {load:.1f}; {found.scans} of {37.5 * found.took_s:.0f} scans"
            f" read, dropped {front['scans_dropped']}; late median {late['median']:.2f} ms, p99 {late['p99']:.1f},"
            f" worst {late['worst']:.1f}; {found.mb[0]:.1f} MB, then {found.mb[1]:.1f}; {cores}\n"
        )


if __name__ == "__main__":
    import tempfile

    with tempfile.TemporaryDirectory() as name:
        main(Path(name), float(sys.argv[1]) if len(sys.argv) > 1 else 8.0)
