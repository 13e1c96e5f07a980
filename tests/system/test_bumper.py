"""Two sensors in one bumper on the way to a grey car, each with its host: the experiment of figure 6."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

import can
import pytest

from tests.system.conftest import STANDING, TIME_LIMIT_S
from tests.system.hosts import LdHost, LmsHost
from tests.system.nursery import ran

WIDTH_M = 1.78
"Of the car's tail."
SPEED_M_S = 5.4

Seen = list[tuple[float, float, int]]
"Time of each scan, median range of its echoes (noise makes an echo anywhere now and then), their number."


def port_of(url: str) -> int:
    return int(url.rpartition(":")[2])


def watch_lms(path: str, begun: threading.Barrier, seconds: float, seen: Seen) -> None:
    with LmsHost(path) as host:
        host.set_baud(500_000)
        begun.wait(TIME_LIMIT_S)
        host.stream()
        host.scan()
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            echoes = [value / 100.0 for value in host.scan() if value < 8183]
            seen.append((time.monotonic(), median(echoes), len(echoes)))


def watch_ld(port: int, begun: threading.Barrier, seconds: float, seen: Seen) -> None:
    with LdHost(port) as host:
        host.measure()
        begun.wait(TIME_LIMIT_S)
        host.send(0x0301, 0, 0x3FFF)
        host.profile()
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            echoes = [point for point in host.profile() if min(point[0], 360.0 - point[0]) < 20.0]
            seen.append((time.monotonic(), median(echo[1] for echo in echoes), len(echoes)))
        assert host.ask(0x0302) == [0, 3]
        assert host.ask(0x0403, 0) == [0, 2]
        assert host.ask(0x0402) == [0, 1]


def speed_m_s(seen: Seen) -> float:
    """Median of the slopes between scans half the time apart: one that was read late turns none of the others."""
    half = len(seen) // 2
    pairs = zip(seen[:half], seen[-half:], strict=True)
    return median((far - near) / (ended_s - begun_s) for (begun_s, far, _), (ended_s, near, _) in pairs)


def late_s(seen: Seen, period_s: float) -> list[float]:
    """How much later than the one that came soonest each scan can have come: no two are nearer than a period."""
    late = [when - number * period_s for number, (when, _, _) in enumerate(seen)]
    soonest = [min(late[: number + 1]) for number in range(len(late))]
    return [one - first for one, first in zip(late, soonest, strict=True)]


def beams_on_the_car(range_m: float, step_deg: float) -> float:
    return math.degrees(2.0 * math.atan(WIDTH_M / 2.0 / range_m)) / step_deg


def test_both_scanners_see_the_car_come_nearer_and_their_hosts_do_not_disturb_each_other(
    daemon: Callable[..., Any],
) -> None:
    running = daemon("bumper", "--set", "actors.1.motion.at_m=[45.8, 0, 0]", "--link", "ld=tcp:127.0.0.1:0")
    begun = threading.Barrier(2)
    lms: Seen = []
    ld: Seen = []
    hosts = [
        threading.Thread(target=watch_lms, args=(running.path("lms"), begun, 3.0, lms)),
        threading.Thread(target=watch_ld, args=(port_of(running.link("ld")), begun, 3.0, ld)),
    ]
    for host in hosts:
        host.start()
    for host in hosts:
        host.join(TIME_LIMIT_S)
    assert running.stop() == 0

    # 112 and 30; fewer on a busy machine, where sweeps that come too late are passed over, and counted
    for sensor, seen, least, most in (("lms", lms, 90, 120), ("ld", ld, 24, 34)):
        late = running.end[sensor]["scans_dropped"].get("measured too late", 0)
        assert max(least - late, 4) < len(seen) < most
    for seen, step_deg in ((lms, 0.5), (ld, 0.25)):
        (_, far_m, few), (_, near_m, many) = seen[0], seen[-1]
        assert speed_m_s(seen) == pytest.approx(SPEED_M_S, rel=1.0 / (SPEED_M_S * 3.0))
        assert many == pytest.approx(beams_on_the_car(near_m, step_deg), abs=4.5)
        assert few == pytest.approx(beams_on_the_car(far_m, step_deg), abs=4.5)
        assert many > 1.3 * few
    late_lms, late_ld = late_s(lms, 2.0 / 75.0), late_s(ld, 0.1)
    for (when, range_m, _), late in zip(ld, late_ld, strict=True):
        near = min(range(len(lms)), key=lambda k: abs(lms[k][0] - when))
        # a profile tells of up to 0.2 s ago; what a busy machine reads later than that, the car goes in the meantime
        assert abs(range_m - lms[near][1]) < 1.2 + SPEED_M_S * (late + late_lms[near])
    assert sum(scan[2] for scan in ld) / len(ld) > 1.5 * sum(scan[2] for scan in lms) / len(lms)
    for sensor in ("lms", "ld"):
        end = running.end[sensor]
        assert end["scans_dropped"].get("line slower than the scan rate", 0) == 0
        assert end["input_dropped"] == {}


def test_look_draws_what_an_ld_sends_and_leaves_it_as_it_was(daemon: Callable[..., Any], tmp_path: Path) -> None:
    links = ("--link", "ld=tcp:127.0.0.1:0", "--link", "ld=pty:./ld")
    running = daemon("bumper", *STANDING, "--set", "sensors.1.device.delays=fast", *links)
    url = running.link("ld")
    command = ("look", "--family", "ld", "--scans", "2")
    done = ran(*command, url, "--csv", "ld.csv", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "LD-LRS1000" in done.stdout
    rows = [row.split(",") for row in (tmp_path / "ld.csv").read_text().splitlines()[1:]]
    assert len(rows) == 2 * 721
    assert [float(rows[0][1]), float(rows[720][1])] == [90.0, -90.0]
    ahead = [float(row[2]) for row in rows[:721] if abs(float(row[1])) < 0.3]
    assert all(20.0 < metres < 60.5 for metres in ahead)
    with LdHost(port_of(url)) as host:
        assert host.ask(0x0102) == [0, 1]
        done = ran(*command, f"pty:{running.path('ld', 1)}", "--baud", "115200", cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        assert "721 beams" in done.stdout
        assert host.ask(0x0102) == [0, 1]


def test_a_stock_can_client_gets_every_frame_of_every_profile(daemon: Callable[..., Any]) -> None:
    settings = "[{id: ld, model: sick-ld-lrs1000, device: {step_deg: 0.5, delays: fast, mode: measure},"
    running = daemon("flat_wall", "--set", f"sensors={settings} links: ['socketcand:127.0.0.1:0/can0']}}]")
    port = int(running.link("ld").rpartition(":")[2].partition("/")[0])
    with can.Bus(interface="socketcand", host="127.0.0.1", port=port, channel="can0") as bus:
        for data in ("ffff 0002 0010 0301", "0001 0000 0500"):
            bus.send(can.Message(arbitration_id=0x2AB, data=bytes.fromhex(data), is_extended_id=False))
        for _ in range(5):
            numbers, size = [], 0
            while not numbers or numbers[-1] != 1:
                frame = bus.recv(TIME_LIMIT_S)
                assert frame is not None
                assert frame.arbitration_id == 0x710
                numbers.append(int.from_bytes(frame.data[:2], "big"))
                size += len(frame.data) // 2 - 1
            assert numbers == [0xFFFF, *range(481, 0, -1)]  # 1 + ceil(1442 / 3) frames
            assert size == 2 + 3 + 2 * 720  # count of frames and ID word, header of the message, two words a point
    assert running.stop() == 0
    assert running.end["ld"]["links"][0]["payloads_dropped"] == 0
