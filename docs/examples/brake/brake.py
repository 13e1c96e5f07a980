"""Does it stop? A car brakes on the ranges of an emulated LMS291, read from its pseudo-terminal.

python docs/examples/brake/brake.py                                the sweep, in virtual time: table, brake.html
python docs/examples/brake/brake.py --real --weather fog_40 --speed 50   one drive in real time
python docs/examples/brake/brake.py --real --speed 50 --mrpt FOLDER/mrpt_host   the same on the ranges of MRPT's driver
"""

from __future__ import annotations

import argparse
import io
import json
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from car import FRICTION, Brake, Car
from lms_host import LmsHost
from mrpt_host import MrptHost
from stepping import AHEAD, STEP, TIME_LIMIT, Virtual, World, begin

from emulator.live.client import Feeder

STOPPED_X = 122.0 - 2.26 - 3.6
"Rear bumper of the stopped car, less the front of ours before its rear axle. [m]"
SPEEDS = (30, 50, 70, 90)
"[km/h]"
FOGS = (200, 100, 70, 50, 40, 30, 20, 15, 10)
"Visibility. [m]"
WEATHER: dict[str, tuple[str, tuple[str, ...]]] = {
    "clear": ("dry", ()),
    **{f"fog_{one}": ("dry", (f"weather.fog.visibility_m={one}",)) for one in FOGS},
    "rain_35": ("wet", ("weather.rain.rate_mm_h=35",)),
    "snow_3": ("snow", ("weather.snow.rate_mm_h=3",)),
}
"The road in it, and what the scenario is told. Numbers: visibility in m, rate in mm/h."


@dataclass(frozen=True)
class Drive:
    """How one ended."""

    weather: str
    speed: float
    "At the begin. [km/h]"
    braked_at: float | None
    "Distance from which it braked. [m]"
    impact: float
    "Speed at impact; 0: it has stopped. [km/h]"
    left: float
    "Distance left when it stood. [m]"

    def row(self) -> str:
        """Of the page's table."""
        at = "-" if self.braked_at is None else f"{self.braked_at:.1f}"
        end = f"{self.left:.1f} | 0" if not self.impact else f"- | {self.impact:.0f}"
        return f"| {self.weather} | {self.speed:g} | {at} | {end} |"


HEAD = "| weather | speed (km/h) | braked at (m) | left (m) | speed at impact (km/h) |\n|---|---|---|---|---|"


class Real(World):
    """By the clock, poses by UDP."""

    def __init__(self, host: LmsHost | MrptHost, feed: str) -> None:
        super().__init__(host)
        self.feeder = Feeder(feed)
        self.began = time.monotonic()

    def step(self, car: Car, jump: bool = False) -> list[list[tuple[float, float]]]:
        """The same."""
        self.t = round(self.t + STEP, 6)
        time.sleep(max(0.0, self.began + self.t - time.monotonic()))
        self.feeder.send([self.actor(car, jump)], self.t)
        return self.host.scans()


@contextmanager
def running(settings: tuple[str, ...], real: bool, mrpt: Path | None = None) -> Iterator[World]:
    """The daemon, a host on its pseudo-terminal, and the feed."""
    with tempfile.TemporaryDirectory() as folder:
        feed = "json-udp://127.0.0.1:0" if real else f"lockstep:unix:{folder}/feed"
        words = ["--link", f"front=pty:{folder}/lms291", "--set", f"live.feed={feed}", "--json"]
        words += [] if real else ["--clock", "virtual", "--workers", "1"]
        for key in settings:
            words += ["--set", key]
        command = [sys.executable, "-m", "emulator", "run", "emergency_brake", *words]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as daemon:
            try:
                ready = next((one for one in map(json.loads, daemon.stdout) if "ready" in json.dumps(one)), None)
                if ready is None:
                    raise SystemExit("the run has ended")
                port = f"{folder}/lms291"
                host = LmsHost(port, 100, 0.5) if mrpt is None else MrptHost(mrpt, port, 100, 0.5)
                try:
                    yield (Real if real else Virtual)(host, str(ready["feed"]))
                finally:
                    host.close()
            finally:
                daemon.terminate()
                daemon.wait(TIME_LIMIT)


def drive(world: World, weather: str, km_h: float) -> Drive:
    """From far away until it stands or has hit."""
    car, brake = Car(km_h / 3.6, FRICTION[WEATHER[weather][0]], STOPPED_X - 5.0 - AHEAD * km_h / 3.6), Brake()
    for _ in range(5):  # scans of the drive before are over
        world.step(car, jump=True)
    began = world.t
    while car.speed > 0 and car.x < STOPPED_X:
        t = world.t - began
        for points in world.step(car):
            if brake.see(points, car.speed):
                car.demand(t, math.inf)
        car.move(t, STEP)
    hit = car.x >= STOPPED_X
    return Drive(weather, km_h, brake.at, car.speed * 3.6 if hit else 0.0, 0.0 if hit else STOPPED_X - car.x)


def drives(weather: str, speeds: Sequence[float] = SPEEDS, real: bool = False, mrpt: Path | None = None) -> list[Drive]:
    """At these speeds, one after the other in one run."""
    with running(WEATHER[weather][1], real, mrpt) as world:
        begin(world)
        return [drive(world, weather, one) for one in speeds]


def picture(found: Sequence[Drive]) -> str:
    """Speed at impact over visibility, a line for each speed, as SVG."""
    from emulator.studies.drawing import COLOURS, figure

    made, (axes,) = figure(size=(8.0, 4.5))
    places = {"clear": 400} | {f"fog_{one}": one for one in FOGS}
    for speed, colour in zip(SPEEDS, COLOURS, strict=False):
        mine = [one for one in found if one.speed == speed and one.weather in places]
        axes.plot([places[one.weather] for one in mine], [one.impact for one in mine], "o-", color=colour, label=speed)
    axes.set_xscale("log")
    axes.set_xticks(list(places.values()), ["clear", *map(str, FOGS)])
    axes.minorticks_off()
    axes.set_xlabel("visibility [m]")
    axes.set_ylabel("speed at impact [km/h]")
    axes.legend(title="speed [km/h]")
    out = io.StringIO()
    made.savefig(out, format="svg", metadata={"Date": None})
    return out.getvalue()


def page(found: Sequence[Drive]) -> str:
    """Picture and table in one file."""
    lines = [HEAD.partition("\n")[0], *(one.row() for one in found)]
    rows = "".join("<tr>" + "".join(f"<td>{one}" for one in line.strip("| ").split(" | ")) for line in lines)
    drawn = picture(found)
    return f"<!doctype html><meta charset=utf-8><title>Does it stop?</title>{drawn[drawn.index('<svg') :]}<table>{rows}"


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--real", action="store_true", help="in real time")
    parser.add_argument("--weather", choices=WEATHER, action="append", help="default: all")
    parser.add_argument("--speed", type=float, action="append", help=f"km/h; default: {SPEEDS}")
    parser.add_argument("--mrpt", type=Path, help="program mrpt_host, as host in place of pyserial; with --real")
    parser.add_argument("--page", type=Path, default=Path("brake.html"), help="written by the whole sweep")
    args = parser.parse_args()
    if args.mrpt and not args.real:
        parser.error("--mrpt: without --real; want both: MRPT's driver has time limits of its own clock")
    began = time.monotonic()
    print(HEAD)
    with ThreadPoolExecutor(1 if args.real else os.cpu_count()) as pool:
        many = pool.map(lambda one: drives(one, args.speed or SPEEDS, args.real, args.mrpt), args.weather or WEATHER)
        found = []
        for rows in many:
            found += rows
            print(*(one.row() for one in rows), sep="\n", flush=True)
    print(f"{len(found)} drives in {time.monotonic() - began:.0f} s", file=sys.stderr)
    if not (args.weather or args.speed or args.real):
        args.page.write_text(page(found), encoding="utf-8")


if __name__ == "__main__":
    main()
