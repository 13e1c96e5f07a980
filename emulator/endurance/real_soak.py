"""Minutes in real time: the daemon as a process with real links, hosts that misbehave on all of them.

Belongs here: starting it, stepping the hosts, sampling, the verdict. Not: the hosts (guests, real_guests).
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from emulator.endurance.growth import Growth, cpu_s, look
from emulator.endurance.guests import COLA_TONGUE, Guestbook, LineGuests, StreamGuests
from emulator.endurance.process_guests import Saboteur
from emulator.endurance.real_guests import Endpoint, Intruders, ListReader, Terminal
from emulator.endurance.scene import soak_text
from emulator.endurance.soak import Soaked, judged
from emulator.errors import EmulatorError
from emulator.process.clock import SystemClock

TICK_S = 0.02
"Hosts are stepped this often."
BESIDE = ("control", "processes")
"Who comes beside the hosts of the links."
SAMPLES = 120
LEAST_SAMPLE_S = 0.25
SETTLED_S = 30.0
"So long a daemon on a busy machine may take to notice that its last host has gone."
CAN_WORDS = (b"< open can0 >", b"< rawmode >", b"< send 123 2 11 22 >", b"< echo >", b"< send 7FF 9 >", b"< bcmmode >")
ORDERS = (
    b'{"jsonrpc": "2.0", "id": 1, "method": "status"}\n',
    b'{"jsonrpc": "2.0", "id": 1, "method": "nothing"}\n',
    b'{"id": [[[[[\n',
)


def run_real(seconds: float, seed: int, progress: Callable[[float], None] = lambda share: None) -> Soaked:
    """A soak of that many real seconds."""
    with tempfile.TemporaryDirectory(prefix="lidaremu-soak-") as name:
        return _run_in(Path(name), seconds, seed, progress)


def _run_in(folder: Path, seconds: float, seed: int, progress: Callable[[float], None]) -> Soaked:
    text = soak_text(seed, f"pty:{folder}/front", "tcp:127.0.0.1:0", "socketcand:127.0.0.1:0/can0", "tcp:127.0.0.1:0")
    (folder / "soak.yaml").write_text(text, encoding="utf-8")
    control = folder / "control.sock"
    daemon = subprocess.Popen(
        [sys.executable, "-m", "emulator.endurance.real_daemon", str(folder / "soak.yaml"), str(control)],
        stdout=subprocess.PIPE,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
    )
    assert daemon.stdout is not None
    try:
        first = daemon.stdout.readline()
        if not first:
            raise EmulatorError("the daemon of the soak did not start")
        ready = json.loads(first)
        links = {row["id"]: row["links"][0] for row in ready["sensors"]}
        books = {name: Guestbook() for name in (*links, *BESIDE)}
        saboteur = Saboteur(daemon.pid, np.random.default_rng((seed, 5)), books["processes"].visits, seconds)
        growth, taken = _soak(daemon.pid, links, str(control), books, seconds, seed, saboteur, progress)
        cpu = cpu_s(daemon.pid)
        daemon.send_signal(signal.SIGTERM)
        out, _ = daemon.communicate(timeout=30.0)
    finally:
        if daemon.poll() is None:
            daemon.kill()
            daemon.wait()
        daemon.stdout.close()
    stopped = json.loads(out.splitlines()[-1])
    reported = saboteur.reported(stopped["incidents"])
    return _verdict(stopped, books, growth, taken, cpu, seed, reported)


def _address(link: str) -> tuple[str, int]:
    host, _, port = link.partition(":")[2].partition("/")[0].rpartition(":")
    return host, int(port)


def _soak(
    pid: int, links: dict[str, str], control: str, books: dict[str, Guestbook], seconds: float, seed: int,
    saboteur: Saboteur, progress: Callable[[float], None],
) -> tuple[Growth, float]:  # fmt: skip
    clock = SystemClock()
    draws = [np.random.default_rng((seed, number)) for number in range(4)]
    draws.append(np.random.default_rng((seed, 6)))
    names = ("top", "objects", "gate")
    places = [*(Endpoint(_address(links[name])) for name in names), Endpoint(control)]
    terminal = Terminal(links["front"].partition(":")[2])
    top, can, gate, orders = places
    stay_s = (min(3.0, seconds / 12.0), min(60.0, seconds / 8.0))
    hosts: list[Any] = [
        LineGuests(terminal, draws[0], books["front"], stay_s, np.inf),
        StreamGuests(top, draws[1], books["top"], np.inf),
        StreamGuests(gate, draws[4], books["gate"], np.inf, COLA_TONGUE),
        ListReader(can, links["objects"].rpartition("/")[2], books["objects"]),
        Intruders(can, draws[2], books["objects"].visits, CAN_WORDS),
        Intruders(orders, draws[3], books["control"].visits, ORDERS),
        saboteur,
    ]
    growth, every_s = Growth(), max(LEAST_SAMPLE_S, seconds / SAMPLES)
    before = look(0.0, pid).descriptors
    with contextlib.ExitStack() as stack:
        stack.callback(terminal.close)
        for place in places:
            stack.callback(place.close)
        _drive(hosts, clock, seconds, every_s, growth, pid, progress)
    taken_s = clock.now_ns() * 1e-9
    while (left := look(taken_s, pid).descriptors - before) > 0 and clock.now_ns() * 1e-9 < taken_s + SETTLED_S:
        select.select([], [], [], TICK_S)
    growth.descriptors_left = left
    return growth, taken_s


def _drive(
    hosts: Sequence[Any], clock: SystemClock, seconds: float, every_s: float, growth: Growth, pid: int,
    progress: Callable[[float], None],
) -> None:  # fmt: skip
    next_sample_s = every_s
    while (now_s := clock.now_ns() * 1e-9) < seconds:
        for host in hosts:
            host.step(clock.now_ns())
        # the first samples would show a daemon that still warms up: connections, caches, the devices' own boot
        if now_s >= next_sample_s:
            growth.samples.append(look(now_s, pid))
            next_sample_s = now_s + every_s
            progress(now_s / seconds)
        select.select([], [], [], TICK_S)


def _verdict(
    stopped: dict[str, Any], books: dict[str, Guestbook], growth: Growth, taken_s: float, cpu: float, seed: int,
    reported: Sequence[str],
) -> Soaked:  # fmt: skip
    sensors, lateness = {}, {}
    for row in stopped["sensors"]:
        lateness[row["id"]] = {key: row["lateness_us"][key] for key in ("median", "p99", "worst")}
        sensors[row["id"]] = row["account"] | {
            "measured_again": row["measured_again"],
            "scans_per_s": row["scans_per_s"],
            "replies": row["replies_sent"],
            "input_dropped": row["input_dropped"],
            "restarts": row["restarts"],
            "lateness_us": lateness[row["id"]],
            "links": row["links"],
        }
    hosts = {
        name: {"visits": dict(book.visits), "clean_scans": book.clean_scans, "faults": dict(book.faults)}
        for name, book in books.items()
    }
    memory = growth.reported() | {"cpu_s": round(cpu, 2), "cpu_share": round(cpu / taken_s, 4)}
    faults = judged(sensors, {name: one for name, one in hosts.items() if name not in BESIDE}, memory)
    failures = tuple(f"daemon: {text}: {count} times" for text, count in stopped["failures"].items())
    hosts["processes"]["incidents"] = stopped["incidents"]
    return Soaked("real", taken_s, taken_s, seed, sensors, hosts, memory, faults + failures + tuple(reported))
