"""A stranger as judge: MRPT's CSickLaserSerial, unmodified, as Debian ships it (libmrpt-hwdrivers-dev 2.5.8)."""

from __future__ import annotations

import math
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from emulator.runtime.control import ask
from tests.system.conftest import TIME_LIMIT_S, RunningDaemon, daemons, prompt
from tests.system.hosts import drift_s

pytestmark = pytest.mark.timeout(900)  # the first who wants the drivers builds them, perhaps on a busy machine
WALL_M = 8.0
"flat_wall: the wall's distance straight ahead."
NOISE_M = 0.010
"The device's statistical error, one sigma, 1 to 20 m (data sheet)."
SIGMAS = 6
"So far from it no echo of a run comes: 40 000 ranges, 1 in 500 000 000 beyond."
DIVERGENCE_RAD = 12.9e-3
"Full angle of a beam."


RATE_TOLERANCE = 0.03
HOST, DAEMON = prompt()
CONNECTING = threading.Lock()
"One driver at a time: loading its libraries takes a core for as long as it would wait for a reply."
SENSORS = """\
schema: 1
seed: 1
world:
  - {plane: {size_m: [6, 60]}, at_m: [8, 0, 1], pitch_deg: -90, material: white_plaster}
sensors:
"""
SENSOR = """\
  - id: %s
    model: sick-lms291-s05
    mount: {at_m: [0, 0, 1]}
    physics: {false_alarms: false}
    links: ["pty:./%s"]
"""
"""The scene of flat_wall before one scanner a case: each is found as it is when switched on. Without echoes of noise
alone: in so many beams there would be some."""


class Case(NamedTuple):
    """What the driver is told to do, and what comes of it."""

    baud: int
    mm: bool
    field: int
    step: int
    beams: int
    scans: int
    rate_hz: float
    "Section 4.2 of the device's manual tables."

    @property
    def sensor(self) -> str:
        return "lms" + "_".join(str(int(value)) for value in self[:4])


CASES = [
    Case(9_600, False, 180, 50, 361, 6, 1.2931),
    Case(38_400, False, 180, 50, 361, 12, 4.6875),
    Case(38_400, False, 180, 100, 181, 20, 9.375),
    Case(38_400, True, 180, 100, 181, 20, 9.375),
    Case(38_400, False, 100, 50, 201, 15, 7.5),
    Case(38_400, False, 100, 100, 101, 30, 15.0),
    Case(500_000, False, 180, 50, 361, 100, 37.5),
    Case(500_000, True, 180, 50, 361, 100, 37.5),
    Case(500_000, True, 180, 100, 181, 200, 75.0),
    Case(500_000, False, 180, 100, 181, 200, 75.0),
]
LEFT = [Case(500_000, False, 180, 50, 361, 10, 37.5), Case(38_400, False, 180, 50, 361, 5, 4.6875),
        Case(500_000, True, 180, 100, 181, 20, 75.0)]  # fmt: skip
"One after the other on one scanner, which each leaves at its own speed."


@dataclass(frozen=True)
class Judgement:
    """What the driver printed, and what the daemon says of the scanner after that."""

    ranges_m: np.ndarray
    "(scans, beams), -1 where the driver marks a beam invalid"
    stamps_s: list[float]
    "When it had each scan, since it connected."
    late: int
    "Scans that were measured too late and not sent."


def judge(program: Path, running: RunningDaemon, sensor: str, case: Case) -> Judgement:
    reported = [str(int(value)) for value in (case.baud, case.mm, case.field, case.step, case.scans)]
    words = [*HOST, str(program), running.path(sensor), *reported, str(TIME_LIMIT_S)]
    printed: list[str] = []
    with CONNECTING:
        driver = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        assert driver.stdout is not None
        while not printed or not printed[-1].startswith(("connected", "hardware error", "failed")):
            printed.append(driver.stdout.readline() or "failed: it has ended")
    with driver:
        printed += driver.stdout
    assert driver.returncode == 0, "".join(printed)[-2000:]
    seen = [line.split() for line in printed if line.startswith("scan ")]
    status: Any = ask(running.control, "status", {})
    (row,) = (row for row in status["sensors"] if row["id"] == sensor)
    return Judgement(
        np.array([[float(word) for word in line[5:]] for line in seen]),
        [float(line[1]) for line in seen],
        row["scans_dropped"].get("measured too late", 0),
    )


@pytest.fixture(scope="module")
def judged(
    mrpt: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Callable[[Case], Judgement | list[Judgement]]]:
    """Judgements on one daemon. Slow lines at once, as the driver mostly waits there; fast ones one after the other."""
    folder = tmp_path_factory.mktemp("lines")
    names = [case.sensor for case in CASES] + ["left"]
    (folder / "lines.yaml").write_text(SENSORS + "".join(SENSOR % (name, name) for name in names), encoding="utf-8")
    with daemons(folder) as start, ThreadPoolExecutor(len(CASES)) as at_once, ThreadPoolExecutor(1) as in_turn:
        running = start("lines.yaml", "--control", str(folder / "control"), *DAEMON)
        begun: dict[Case, Future[Any]] = {}
        for case in CASES:
            pool = at_once if case.baud < 100_000 else in_turn
            begun[case] = pool.submit(judge, mrpt / "mrpt_host", running, case.sensor, case)
        begun[LEFT[0]] = in_turn.submit(lambda: [judge(mrpt / "mrpt_host", running, "left", case) for case in LEFT])
        yield lambda case: begun[case].result()


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.sensor)
def test_mrpt_connects_streams_and_sees_the_wall(judged: Callable[[Case], Judgement], case: Case) -> None:
    found = judged(case)
    assert found.ranges_m.shape == (case.scans, case.beams)
    later_s, apart_s = drift_s(found.stamps_s, case.rate_hz)
    assert later_s > -RATE_TOLERANCE * apart_s
    assert later_s < RATE_TOLERANCE * apart_s + found.late / case.rate_hz

    azimuth = np.radians(np.arange(case.beams) * case.step / 100.0 - case.field / 2.0)
    truth = WALL_M / np.cos(azimuth)
    # In mm the driver's mode reaches 32.7 m, in cm 81 m; where the wall is too dark or too far there is no echo.
    near = truth < 20.0
    seen = found.ranges_m[:, near]
    unit_m = 0.001 if case.mm else 0.01
    nearest_m, farthest_m = footprint_m(azimuth[near])
    assert np.all(seen > nearest_m - SIGMAS * NOISE_M - unit_m)
    assert np.all(seen < farthest_m + SIGMAS * NOISE_M + unit_m)

    # Straight ahead the footprint is flat: what is left is the device's noise and the rounding to its unit.
    straight = np.abs(azimuth) < math.radians(10.0)
    error = found.ranges_m[:, straight] - truth[straight]
    spread_m = math.hypot(NOISE_M, unit_m / math.sqrt(12.0))
    count = error.size
    assert error.std() == pytest.approx(spread_m, rel=0.1 + 4.0 / math.sqrt(2.0 * count))
    # The leading edge comes up to a few millimetres early, and a unit's rounding may lean to one side.
    assert abs(error.mean()) < 0.005 + unit_m / 2.0 + 4.0 * spread_m / math.sqrt(count)


def footprint_m(azimuth_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nearest and farthest range of the wall inside the light of each beam."""
    inner = np.maximum(np.abs(azimuth_rad) - DIVERGENCE_RAD / 2.0, 0.0)
    outer = np.abs(azimuth_rad) + DIVERGENCE_RAD / 2.0
    return WALL_M / np.cos(inner), WALL_M / np.cos(outer)


def test_mrpt_finds_a_device_left_at_another_speed(judged: Callable[[Case], list[Judgement]]) -> None:
    found = judged(LEFT[0])
    assert [one.ranges_m.shape for one in found] == [(case.scans, case.beams) for case in LEFT]


def fault(running: Any, **params: object) -> None:
    ask(running.control, "fault", {"on": "front", **params})


class Carrying:
    """`mrpt_recover`: the driver, made anew whenever it reports an error."""

    def __init__(self, program: Path, port: str, log: Path) -> None:
        self.log = log
        with log.open("wb") as out:
            words = [*HOST, str(program), port, "38400", str(5 * TIME_LIMIT_S)]
            self.process = subprocess.Popen(words, stdout=out, stderr=subprocess.STDOUT)

    def lines(self, head: str) -> list[str]:
        """Whole lines that begin so."""
        return [line for line in self.log.read_text(errors="replace").split("\n")[:-1] if line.startswith(head)]

    def more(self, count: int, head: str = "scan ", seconds: float = TIME_LIMIT_S) -> bool:
        """Whether so many more such lines come in time."""
        wanted, end = len(self.lines(head)) + count, time.monotonic() + seconds
        while len(self.lines(head)) < wanted:
            if time.monotonic() > end or self.process.poll() is not None:
                return False
            time.sleep(0.05)
        return True

    def __enter__(self) -> Carrying:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.wait()


def test_mrpt_meets_a_bad_day(daemon: Callable[..., object], mrpt: Path, tmp_path: Path) -> None:
    options = ("--control", str(tmp_path / "control"), "--set", "sensors.front.device.delays=fast",
               "--set", "sensors.front.physics.false_alarms=false")  # fmt: skip
    running: Any = daemon("flat_wall", *options, *DAEMON)
    program, port = mrpt / "mrpt_recover", running.path("front")
    with Carrying(program, port, tmp_path / "first") as driver:
        assert driver.more(3)
        # checksums: the driver says so, each time, and goes on with the next telegram
        fault(running, do="bad_checksum", count=5, of="scans")
        assert driver.more(5, "[CSickLaserSerial::waitContinuousSampleFrame] bad CRC")
        assert driver.more(3)
        # bytes between telegrams: passed over
        fault(running, do="garbage", count=5, number=64, value=0x55)
        assert driver.more(8)
        assert driver.lines("hardware error") == []
        # the plug: an error, and a new driver finds the port where it was
        fault(running, do="unplug", for_s=1.0)
        assert driver.more(1, "hardware error")
        assert driver.more(3)
        # the power: a driver in the middle of a telegram waits for its rest for ever (its loop has no time-out), one
        # between two telegrams reports an error after some time; neither sets the device up again by itself
        errors = len(driver.lines("hardware error"))
        fault(running, do="power_cycle", off_s=0.3)
        for _ in range(20):  # what was on its way comes first
            if not driver.more(1, seconds=4.0) or len(driver.lines("hardware error")) > errors:
                break
        else:
            pytest.fail("scans after a power cut, and nobody asked for them")
        scans = [line.split() for line in driver.lines("scan ")]
    with Carrying(program, port, tmp_path / "second") as driver:
        assert driver.more(3), "whoever restarts the program has scans again"
        scans += [line.split() for line in driver.lines("scan ")]
    assert {int(count) for _, count, _ in scans} == {181}
    assert max(abs(float(ahead_m) - WALL_M) for *_, ahead_m in scans) < 0.1
    assert running.stop() == 0
    counted = running.end["front"]
    assert counted["scans_dropped"]["fault bad_checksum"] == 5
    assert counted["restarts"] == 2
    assert "Traceback" not in running.errors
